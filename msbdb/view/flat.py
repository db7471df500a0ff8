"""Pictures of the flat regions: their zones, and the surface before and after denoising (Mongus et al. 2013)."""

from pathlib import Path

import geopandas as gpd
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.collections import PathCollection
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from msbdb.grid import Grid
from msbdb.view.colourbar import colour_bar
from msbdb.view.figure import draw_relief, furnish, require_png, sheet, write_picture
from msbdb.view.outlines import outlines

ZONES = "viridis"
"""Ordered for every eye, and in grey."""


def draw_zones(regions: gpd.GeoDataFrame, relief: Grid, out: Path, *, title: str, subtitle: str = "") -> None:
    """Draw the flat regions, coloured by the number i of their attribute-zone, as in the paper's Fig. 2.

    Parameters
    ----------
    regions : GeoDataFrame
        Column ``zone`` (from 1) and polygons, in metres. May be empty.
    relief : Grid
        Heights, metres, for the hillshade.
    out : Path
        The picture, ``.png``.
    title, subtitle : str
        What is shown; when, and in which CRS.

    Raises
    ------
    InputError
        When the file is no ``.png``.
    FileError
        When it cannot be written.
    """
    require_png(out)
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
        The picture, ``.png``.
    title : str
        What is shown.

    Raises
    ------
    InputError
        When the file is no ``.png``.
    FileError
        When it cannot be written.
    """
    require_png(out)
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
