"""The furniture of a map: colour bar, scale bar and north arrow; and polygons as drawing paths."""

import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import shapely
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Polygon, Rectangle
from matplotlib.path import Path as Outline
from numpy.typing import NDArray

BELOW_INCHES = 0.75
"""Margin of a sheet below the map: for the coordinates, the scale bar and the north arrow."""


def colour_bar(figure: Figure, axes: Axes, mapper: ScalarMappable, title: str) -> None:
    """Draw the bar that explains the colours, to the right of the map's upper right corner.

    Parameters
    ----------
    figure : Figure
        With a margin to the right of the map, as `msbdb.view.buildingmap.sheet` leaves.
    axes : Axes
        The map.
    mapper : ScalarMappable
        From values to colours.
    title : str
        What the values are.
    """
    box = axes.get_position()
    width, height = figure.get_figwidth(), figure.get_figheight()
    length = min(2.4 / height, box.y1)
    bar = figure.add_axes((box.x1 + 0.2 / width, box.y1 - length - 0.4 / height, 0.16 / width, length))
    figure.colorbar(mapper, cax=bar)
    bar.tick_params(labelsize=8)
    bar.set_title(title, fontsize=9, loc="left", pad=8)


def legend_beside(figure: Figure, axes: Axes, handles: Sequence[Line2D | Patch], title: str) -> None:
    """Explain lines and fills beside the map, from its upper right corner down; figure and axes as for `colour_bar`."""
    box = axes.get_position()
    figure.legend(
        handles=list(handles),
        title=title,
        loc="upper left",
        bbox_to_anchor=(box.x1 + 0.15 / figure.get_figwidth(), box.y1),
        borderaxespad=0.0,
        frameon=False,
        alignment="left",
        fontsize=8,
        title_fontsize=9,
    )


def round_length(longest: float) -> float:
    """Return the greatest of 1, 2 and 5 times a power of ten that is no longer than a length.

    Parameters
    ----------
    longest : float
        Above 0, metres.

    Examples
    --------
    >>> round_length(99.0), round_length(460.0), round_length(0.3)
    (50.0, 200.0, 0.2)
    """
    power = 10.0 ** math.floor(math.log10(longest))
    return float(max(step * power for step in (1, 2, 5) if step * power <= longest))


def scale_bar(figure: Figure, axes: Axes, *, share: float = 0.22) -> None:
    """Draw a bar of a round length below the map's lower right corner.

    Parameters
    ----------
    figure : Figure
        The sheet of `msbdb.view.buildingmap.sheet`.
    axes : Axes
        Its map, in metres, whose limits are final.
    share : float
        Longest length of the bar as a share of the map's width.
    """
    west, east = axes.get_xlim()
    length = round_length((east - west) * share)
    box = axes.get_position()
    width, height = figure.get_figwidth(), figure.get_figheight()
    drawn = (box.x1 - box.x0) * width * length / (east - west)
    x, y = box.x1 * width - drawn - 0.6, box.y0 * height - BELOW_INCHES + 0.12
    for half, colour in ((0, "black"), (1, "white")):
        bar = Rectangle((x + half * drawn / 2, y), drawn / 2, 0.06, facecolor=colour, edgecolor="black", linewidth=0.8)
        bar.set_transform(figure.dpi_scale_trans)
        figure.add_artist(bar)
    label = f"{length / 1000:g} km" if length >= 1000 else f"{length:g} m"
    for position, words in ((0.0, "0"), (1.0, label)):
        figure.text(
            x + position * drawn, y + 0.09, words,
            ha="center", va="bottom", fontsize=8, transform=figure.dpi_scale_trans,
        )  # fmt: skip


def north_arrow(figure: Figure, axes: Axes) -> None:
    """Draw an arrow to grid north below the map's lower right corner, beside the scale bar."""
    box = axes.get_position()
    x = box.x1 * figure.get_figwidth() - 0.12
    top = box.y0 * figure.get_figheight() - BELOW_INCHES + 0.42
    for side, colour in ((-1, "black"), (1, "white")):
        corners = [(x, top), (x + side * 0.1, top - 0.3), (x, top - 0.23)]
        half = Polygon(corners, closed=True, facecolor=colour, edgecolor="black", linewidth=0.8)
        half.set_transform(figure.dpi_scale_trans)
        figure.add_artist(half)
    figure.text(
        x - 0.12, top, "N", ha="right", va="top", fontsize=9, fontweight="bold", transform=figure.dpi_scale_trans
    )


def outlines(geometries: NDArray[np.object_]) -> list[Outline]:
    """Return polygons as drawing paths, with holes left open.

    Parameters
    ----------
    geometries : (N,) ndarray of shapely Polygon or MultiPolygon
        Empty ones give empty paths.

    Returns
    -------
    list of matplotlib.path.Path
        One a geometry. Shells and holes turn in opposite senses, as the non-zero fill rule requires.
    """
    if not len(geometries):
        return []
    oriented = shapely.orient_polygons(geometries)
    whole = np.array(
        [shapely.MultiPolygon(shapely.get_parts(geometry).tolist()) for geometry in oriented], dtype=object
    )
    _, xy, (rings, polygons, wholes) = shapely.to_ragged_array(whole, include_z=False)
    codes = np.full(len(xy), Outline.LINETO, dtype=Outline.code_type)
    codes[rings[:-1]] = Outline.MOVETO
    codes[rings[1:] - 1] = Outline.CLOSEPOLY
    stops = rings[polygons[wholes]]
    return [Outline(xy[a:b], codes[a:b]) for a, b in pairwise(stops)]
