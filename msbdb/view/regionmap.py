"""Maps of regions: candidate regions, flat regions by zone, and the surface before and after denoising."""

from pathlib import Path

import geopandas as gpd
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.collections import PathCollection
from matplotlib.colors import LogNorm, Normalize, to_rgba_array
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from msbdb.grid import Grid
from msbdb.view.buildingmap import draw_relief, furnish, require_picture, sheet, write_picture
from msbdb.view.furniture import colour_bar, legend_beside, outlines

SCALES = ("#fde725", "#5ec962", "#21918c", "#31688e", "#440154")
"""Height scales from the lowest up, with rising darkness also in grey; scales above the last have its colour."""

HEIGHTS = ZONES = "viridis"
"""Colours of rising brightness, which colour-blind readers can order."""


def draw_candidates(regions: gpd.GeoDataFrame, relief: Grid, out: Path, *, title: str, subtitle: str = "") -> None:
    """Draw candidate regions on a hillshade.

    Those of the 3-D area morphology are coloured by the height scale h_j that accepted them, as in the paper's Figs. 6
    and 7; others by their median height.

    Parameters
    ----------
    regions : GeoDataFrame
        ``tables.CANDIDATE_REGION`` of one method, with polygons in metres. May be empty.
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
    require_picture(out)
    figure, axes = sheet(relief)
    draw_relief(axes, relief)
    scales = regions["height_scale_m"].to_numpy(dtype=np.float64)
    heights = regions["h_p50"].to_numpy(dtype=np.float64)
    by_scale = bool(len(regions)) and bool(np.isfinite(scales).all())
    mapper = ScalarMappable(Normalize(0, max(float(heights.max(initial=0.0)), 1.0)), HEIGHTS)
    levels = np.unique(scales[np.isfinite(scales)])
    if by_scale:
        which = np.minimum(np.searchsorted(levels, scales), len(SCALES) - 1)
        colours = to_rgba_array([SCALES[number] for number in which])
    else:
        colours = mapper.to_rgba(heights)
    paths = outlines(regions.geometry.to_numpy())
    fills = PathCollection(paths, facecolors=colours, edgecolors="black", linewidths=0.5, zorder=2)
    axes.add_collection(fills, autolim=False)
    if by_scale:
        patches = [
            Patch(facecolor=SCALES[min(n, len(SCALES) - 1)], edgecolor="black", label=f"{level:.2f} m")
            for n, level in enumerate(levels)
        ]
        legend_beside(figure, axes, patches, "Height scale h")
    elif len(regions):
        colour_bar(figure, axes, mapper, "Height, m")
    furnish(figure, axes, title, subtitle)
    write_picture(figure, out)


def draw_zones(regions: gpd.GeoDataFrame, relief: Grid, out: Path, *, title: str, subtitle: str = "") -> None:
    """Draw the flat regions, coloured by the number i of their attribute-zone, as in the paper's Fig. 2.

    Parameters
    ----------
    regions : GeoDataFrame
        Column ``zone`` (from 1) and polygons, in metres. May be empty.
    relief, out, title, subtitle
        As for `draw_candidates`, which raises the same errors.
    """
    require_picture(out)
    figure, axes = sheet(relief)
    draw_relief(axes, relief)
    if len(regions):
        norm = LogNorm(1, max(int(regions["zone"].max()), 2))
        mapper = ScalarMappable(norm, ZONES)
        colours = mapper.to_rgba(regions["zone"].to_numpy(dtype=np.float64))
        paths = outlines(regions.geometry.to_numpy())
        fills = PathCollection(paths, facecolors=colours, edgecolors="black", linewidths=0.5, zorder=2)
        axes.add_collection(fills, autolim=False)
        colour_bar(figure, axes, mapper, "Zone i")
    furnish(figure, axes, title, subtitle)
    write_picture(figure, out)


def draw_denoising(before: Grid, after: Grid, out: Path, *, title: str) -> None:
    """Draw the surface before and after denoising side by side, as in the paper's Fig. 1.

    Parameters
    ----------
    before, after : Grid
        Heights on one lattice, metres.
    out : Path
        The picture, ``.png``, ``.svg`` or ``.pdf``.
    title : str
        What is shown.

    Raises
    ------
    InputError
        When the file has another ending.
    FileError
        When it cannot be written.
    """
    require_picture(out)
    rows, cols = before.spec.shape
    figure = Figure(figsize=(12.0, max(6.0 * rows / cols, 2.0) + 0.6), dpi=150, layout="constrained")
    FigureCanvasAgg(figure)
    changed = int(np.count_nonzero(before.valid & (np.asarray(before.values) != np.asarray(after.values))))
    figure.suptitle(f"{title}: {changed:,} cells refilled", fontweight="bold", parse_math=False)
    west, south, east, north = before.spec.bounds
    for axes, grid, name in zip(figure.subplots(1, 2), (before, after), ("before", "after"), strict=True):
        axes.set_xlim(west, east)
        axes.set_ylim(south, north)
        axes.set_aspect("equal")
        axes.set_title(name)
        axes.set_axis_off()
        draw_relief(axes, grid)
        axes.set_aspect("equal")
    write_picture(figure, out)
