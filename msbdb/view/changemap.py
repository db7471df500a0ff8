"""A map of the changes of the buildings between surveys."""

from pathlib import Path

import geopandas as gpd
from matplotlib.axes import Axes
from matplotlib.collections import PathCollection
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from msbdb.grid import Grid
from msbdb.view.buildingmap import draw_relief, furnish, require_png, sheet, write_picture
from msbdb.view.furniture import outlines

KINDS = {
    "unchanged": "#c4c4c4",
    "not surveyed": "#ffffff",
    "modified": "#e69f00",
    "merged": "#56b4e9",
    "split": "#0072b2",
    "new": "#009e73",
    "demolished": "#d55e00",
}
"""Colours by Okabe and Ito, which colour-blind readers can distinguish, in the order in which they are drawn."""


def draw_changes(changes: gpd.GeoDataFrame, relief: Grid, out: Path, *, title: str, subtitle: str = "") -> None:
    """Draw buildings coloured by kind of change, on a hillshade.

    Parameters
    ----------
    changes : GeoDataFrame
        Column ``kind`` and polygons, in metres. May be empty.
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
    for order, (kind, colour) in enumerate(KINDS.items()):
        chosen = changes[changes["kind"] == kind]
        paths = outlines(chosen.geometry.to_numpy())
        is_quiet = kind in ("unchanged", "not surveyed")
        fills = PathCollection(
            paths, facecolors=colour, edgecolors="#555555" if is_quiet else "black",
            linewidths=0.4 if is_quiet else 1.0, joinstyle="round", zorder=2 + order / 100,
        )  # fmt: skip
        axes.add_collection(fills, autolim=False)
    furnish(figure, axes, title, subtitle)
    _legend(figure, axes, changes)
    write_picture(figure, out)


def _legend(figure: Figure, axes: Axes, changes: gpd.GeoDataFrame) -> None:
    """Explain the colours beside the map, with the number of rows of each kind that occurs."""
    counts = changes["kind"].value_counts()
    handles = [
        Patch(facecolor=colour, edgecolor="black", linewidth=0.6, label=f"{kind}: {counts[kind]}")
        for kind, colour in reversed(KINDS.items())
        if kind in counts.index
    ]
    box = axes.get_position()
    figure.legend(
        handles=handles,
        title="Buildings",
        loc="upper left",
        bbox_to_anchor=(box.x1 + 0.15 / figure.get_figwidth(), box.y1),
        borderaxespad=0.0,
        frameon=False,
        alignment="left",
        fontsize=8,
        title_fontsize=9,
    )
