"""Maps of what is known of buildings: heights, detectors, probability; and why there is none elsewhere."""

import textwrap
from collections.abc import Mapping, Sequence
from pathlib import Path

import geopandas as gpd
import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import PathCollection
from matplotlib.colors import Normalize, to_hex, to_rgba
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from numpy.typing import NDArray

from msbdb.grid import Grid, GridSpec
from msbdb.tables import CONFIRMING_COVER, REASONS, Reason
from msbdb.view.buildingmap import (
    HEIGHTS,
    LARGEST_RELIEF,
    draw_outlines,
    draw_relief,
    furnish,
    height_bar,
    height_range,
    require_picture,
    sheet,
    thinness,
    write_picture,
)
from msbdb.view.furniture import colour_bar, legend_beside, outlines
from msbdb.view.groundimages import REASON_COLOURS, reasons_on

CHANCES = "cividis"
"""Colours of probabilities: of rising brightness, made for colour-blind readers."""

SUPPORT = "viridis"
"""Colours of the number of detectors, bright for many."""

UNKNOWN = "#ffffff"

LINE = 0.7
"""Width of outlines, points."""


def draw_heights(buildings: gpd.GeoDataFrame, relief: Grid, out: Path, *, title: str, subtitle: str = "") -> None:
    """Draw footprints, filled by the height of the building.

    Parameters
    ----------
    buildings : GeoDataFrame
        Column ``h_p90`` (metres) and polygons, in metres. May be empty.
    relief : Grid
        Heights, metres, for the hillshade.
    out : Path
        The picture, ``.png``, ``.svg`` or ``.pdf``.
    title, subtitle : str
        What is shown; when, and in which CRS.

    Raises
    ------
    InputError
        When the file has another ending.
    FileError
        When it cannot be written.
    """
    figure, axes = _begin(relief, out)
    norm = height_range(buildings)
    heights = buildings["h_p90"].to_numpy(dtype=np.float64)
    _fill(axes, buildings, HEIGHTS(norm(np.nan_to_num(heights))))
    if len(buildings):
        height_bar(figure, axes, norm)
    _end(figure, axes, out, title, subtitle)


def draw_support(
    buildings: gpd.GeoDataFrame,
    shares: Mapping[str, str],
    relief: Grid,
    out: Path,
    *,
    title: str,
    subtitle: str = "",
) -> None:
    """Draw footprints, filled by the number of detectors whose regions support the building.

    Parameters
    ----------
    buildings : GeoDataFrame
        The columns of ``shares``, null where a detector was not run, and polygons. May be empty.
    shares : mapping of str to str
        The detectors with their columns, shares of the footprint.
    relief, out, title, subtitle
        As for `draw_heights`, which raises the same errors.
    """
    figure, axes = _begin(relief, out)
    found = {name: buildings[column].to_numpy(dtype=np.float64) for name, column in shares.items()}
    supports = {name: own >= CONFIRMING_COVER for name, own in found.items() if np.isfinite(own).any()}
    count = np.zeros(len(buildings), dtype=np.int64)
    for own in supports.values():
        count += own
    most = max(len(supports), 1)
    colours = [to_hex(colormaps[SUPPORT](level / most)) for level in range(most + 1)]
    _fill(axes, buildings, [colours[level] for level in count.tolist()])
    labels = [f"{level}: {np.count_nonzero(count == level)}" for level in range(most + 1)]
    handles: list[Line2D | Patch] = [_key(colours[level], labels[level]) for level in reversed(range(most + 1))]
    handles += [
        Line2D([], [], linestyle="none", label=f"{name}: {np.count_nonzero(own)}") for name, own in supports.items()
    ]
    legend_beside(figure, axes, handles, "Buildings by the number\nof detectors, and by detector")
    _end(figure, axes, out, title, subtitle)


def draw_probability(buildings: gpd.GeoDataFrame, relief: Grid, out: Path, *, title: str, subtitle: str = "") -> None:
    """Draw footprints, filled by the probability of the building.

    Parameters
    ----------
    buildings : GeoDataFrame
        Column ``probability``, null where it is not known, and polygons. May be empty.
    relief, out, title, subtitle
        As for `draw_heights`, which raises the same errors.
    """
    figure, axes = _begin(relief, out)
    chances = buildings["probability"].to_numpy(dtype=np.float64)
    mapper = ScalarMappable(Normalize(0.0, 1.0), CHANCES)
    known = np.isfinite(chances)
    colours = colormaps[CHANCES](np.where(known, chances, 0.0))
    colours[~known] = to_rgba(UNKNOWN)
    _fill(axes, buildings, colours)
    if known.any():
        colour_bar(figure, axes, mapper, "Probability")
    if not known.all():
        legend_beside(figure, axes, [_key(UNKNOWN, "not known")], "")
    _end(figure, axes, out, title, subtitle)


def draw_reasons(
    buildings: gpd.GeoDataFrame,
    rasters: Sequence[tuple[GridSpec, NDArray[np.uint8]]],
    relief: Grid,
    out: Path,
    *,
    title: str,
    subtitle: str = "",
) -> None:
    """Draw why there is no building in each cell, with the outlines of the buildings.

    Parameters
    ----------
    buildings : GeoDataFrame
        Polygons. May be empty.
    rasters : sequence of (GridSpec, (H, W) ndarray of uint8)
        Numbers of `msbdb.tables.Reason`, the first one on top.
    relief, out, title, subtitle
        As for `draw_heights`, which raises the same errors.
    """
    figure, axes = _begin(relief, out)
    step = -(-max(relief.spec.shape) // LARGEST_RELIEF)
    found = reasons_on(relief, rasters, step)
    colours = np.zeros((len(Reason), 4), dtype=np.uint8)
    for reason, colour in REASON_COLOURS.items():
        colours[reason] = np.round(255 * np.array(to_rgba(colour)))
    limits, cell = axes.axis(), relief.spec.cell_m * step
    west, _, _, north = relief.spec.bounds
    rows, cols = found.shape
    extent = (west, west + cols * cell, north - rows * cell, north)
    axes.imshow(colours[found], extent=extent, aspect="auto", interpolation="none", zorder=2.0)
    axes.axis(limits)  # an image sets the limits to its own
    draw_outlines(axes, buildings, thinness(buildings, axes))
    handles: list[Line2D | Patch] = [Line2D([], [], color="black", linewidth=1.5, label="building")]
    handles += [
        Patch(facecolor=REASON_COLOURS[own], label=_broken(REASONS[own]))
        for own in Reason
        if own in REASON_COLOURS and (found == own).any()
    ]
    legend_beside(figure, axes, handles, "Why there is no building")
    _end(figure, axes, out, title, subtitle)


def _begin(relief: Grid, out: Path) -> tuple[Figure, Axes]:
    """Return a sheet with its hillshade."""
    require_picture(out)
    figure, axes = sheet(relief)
    draw_relief(axes, relief)
    return figure, axes


def _key(colour: str, label: str) -> Patch:
    """Return the key of a fill."""
    return Patch(facecolor=colour, edgecolor="black", linewidth=LINE, label=label)


def _fill(axes: Axes, buildings: gpd.GeoDataFrame, colours: Sequence[str] | NDArray[np.float64]) -> None:
    """Fill and outline footprints."""
    if len(buildings):
        paths = outlines(buildings.geometry.to_numpy())
        width = LINE * thinness(buildings, axes)
        fills = PathCollection(paths, facecolors=colours, edgecolors="black", linewidths=width, zorder=2.5)
        axes.add_collection(fills, autolim=False)


def _end(figure: Figure, axes: Axes, out: Path, title: str, subtitle: str) -> None:
    """Furnish a sheet, and write it."""
    furnish(figure, axes, title, subtitle)
    write_picture(figure, out)


def _broken(words: str) -> str:
    """Return words in lines that the margin holds."""
    return "\n".join(textwrap.wrap(words, 30))
