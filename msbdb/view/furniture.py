"""The furniture of a map: colour bar, scale bar and north arrow; and polygons as drawing paths."""

import math
from itertools import pairwise

import numpy as np
import shapely
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.figure import Figure
from matplotlib.patches import Polygon, Rectangle
from matplotlib.path import Path as Outline
from matplotlib.patheffects import Normal, Stroke, withStroke
from matplotlib.transforms import IdentityTransform
from numpy.typing import NDArray

HALO = [withStroke(linewidth=3, foreground="white", alpha=0.9)]
"""A white edge that keeps letters legible on any background."""

EDGE = [Stroke(linewidth=3.2, foreground="white"), Normal()]
"""The same for shapes."""


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


def scale_bar(axes: Axes, *, share: float = 0.22) -> None:
    """Draw a bar of a round length in the map's lower left corner.

    Parameters
    ----------
    axes : Axes
        A map in metres whose limits are final.
    share : float
        Longest length of the bar as a share of the map's width.
    """
    west, east = axes.get_xlim()
    length = round_length((east - west) * share)
    box = axes.get_window_extent()
    per_metre = box.width / (east - west)
    point = axes.figure.dpi / 72
    x, y, height = box.x0 + 14 * point, box.y0 + 14 * point, 4.5 * point
    for half, colour in ((0, "black"), (1, "white")):
        axes.add_patch(
            Rectangle(
                (x + half * length * per_metre / 2, y),
                length * per_metre / 2,
                height,
                transform=IdentityTransform(),
                facecolor=colour,
                edgecolor="black",
                linewidth=0.8,
                zorder=10,
                path_effects=EDGE,
            )
        )
    label = f"{length / 1000:g} km" if length >= 1000 else f"{length:g} m"
    for position, words in ((0.0, "0"), (1.0, label)):
        axes.text(
            x + position * length * per_metre,
            y + height + 3 * point,
            words,
            transform=IdentityTransform(),
            ha="center",
            va="bottom",
            fontsize=8,
            zorder=11,
            path_effects=HALO,
        )


def north_arrow(axes: Axes) -> None:
    """Draw an arrow to grid north in the map's upper right corner."""
    box = axes.get_window_extent()
    point = axes.figure.dpi / 72
    x, top, size = box.x1 - 18 * point, box.y1 - 14 * point, 24 * point
    for side, colour in ((-1, "black"), (1, "white")):
        corners = [(x, top), (x + side * size / 3, top - size), (x, top - 0.78 * size)]
        axes.add_patch(
            Polygon(
                corners,
                closed=True,
                transform=IdentityTransform(),
                facecolor=colour,
                edgecolor="black",
                linewidth=0.8,
                zorder=10,
                path_effects=EDGE,
            )
        )
    axes.text(
        x,
        top - size - 2 * point,
        "N",
        transform=IdentityTransform(),
        ha="center",
        va="top",
        fontsize=10,
        fontweight="bold",
        zorder=11,
        path_effects=HALO,
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
