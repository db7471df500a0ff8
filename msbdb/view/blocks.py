"""Buildings and parts as blocks side by side, for each step from coarse to fine: what a 3-D view extrudes."""

from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray

SLIVER_M = 0.1
"""Pieces nowhere wider than this are left out, metres (ours): they are gaps between outlines, not roofs."""

Geometries = NDArray[np.object_]
"""An array of shapely geometries."""


@dataclass(frozen=True, slots=True, eq=False)
class Blocks:
    """Blocks with flat roofs, each for the levels from ``low`` to ``high``; on one level they do not overlap.

    Parameters
    ----------
    row : (N,) ndarray of int64
        The part of each block.
    low, high : (N,) ndarray of int64
        First and last scale on which it is shown, 1 = coarsest.
    height_m : (N,) ndarray of float64
        Mean height above ground of its cells, metres.
    geometry : (N,) ndarray of MultiPolygon
        Its outline.
    """

    row: NDArray[np.int64]
    low: NDArray[np.int64]
    high: NDArray[np.int64]
    height_m: NDArray[np.float64]
    geometry: Geometries


def blocks_of(
    scale: NDArray[np.int64],
    father: NDArray[np.int64],
    area_m2: NDArray[np.float64],
    height_m: NDArray[np.float64],
    geometry: Geometries,
    *,
    finest: int,
) -> Blocks:
    """Return what of each part is seen on each scale: its outline without those of its children that exist by then.

    Parameters
    ----------
    scale : (N,) ndarray of int64
        Scale of each part, 1 = coarsest.
    father : (N,) ndarray of int64
        Row of its father; -1 for a root.
    area_m2, height_m : (N,) ndarray of float64
        Area of its cells, and their mean height above ground.
    geometry : (N,) ndarray of MultiPolygon
        Its outline, metres.
    finest : int
        The last scale.

    Returns
    -------
    Blocks
        In the order of the parts, from coarse to fine. A part that its children cover has none on these levels.

    Notes
    -----
    The height of what is left of a part is the mean of its own cells: A h = A₀ h₀ + Σ Aᵢ hᵢ over its children. So all
    levels have one volume.

    Examples
    --------
    A podium of 10 x 10 m and 7 m mean height, with a tower of 5 x 10 m and 10 m on scale 3:

    >>> found = blocks_of(
    ...     np.array([1, 3]), np.array([-1, 0]), np.array([100.0, 50.0]), np.array([7.0, 10.0]),
    ...     np.array([shapely.box(0, 0, 10, 10), shapely.box(0, 0, 5, 10)]), finest=4,
    ... )
    >>> for row, low, high, metres in zip(found.row, found.low, found.high, found.height_m):
    ...     print(f"part {row} on scales {low} to {high}: {metres} m")
    part 0 on scales 1 to 2: 7.0 m
    part 0 on scales 3 to 4: 4.0 m
    part 1 on scales 3 to 4: 10.0 m
    """
    children: dict[int, list[int]] = {}
    for row, own in enumerate(father.tolist()):
        if own >= 0:
            children.setdefault(own, []).append(row)
    found: list[tuple[int, int, int, float]] = []
    less: list[shapely.Geometry | None] = []
    for row in range(len(scale)):
        inner = children.get(row, [])
        begins = [int(scale[row]), *sorted({int(scale[child]) for child in inner})]
        for low, after in zip(begins, [*begins[1:], finest + 1], strict=True):
            gone = [child for child in inner if scale[child] <= low]
            found.append((row, low, after - 1, _rest_height(row, gone, area_m2, height_m)))
            less.append(shapely.union_all(geometry[gone]) if gone else None)
    rows = np.array([own[0] for own in found], dtype=np.int64)
    outlines = np.array(geometry[rows], dtype=object)
    cut = np.array([own is not None for own in less], dtype=np.bool_)
    if cut.any():
        outlines[cut] = shapely.difference(outlines[cut], np.array([own for own in less if own is not None]))
        outlines[cut] = _without_slivers(outlines[cut])
    there = ~shapely.is_empty(outlines)
    low = np.array([own[1] for own in found], dtype=np.int64)[there]
    high = np.array([own[2] for own in found], dtype=np.int64)[there]
    heights = np.array([own[3] for own in found], dtype=np.float64)[there]
    return Blocks(rows[there], low, high, heights, outlines[there])


def _rest_height(row: int, gone: list[int], area_m2: NDArray[np.float64], height_m: NDArray[np.float64]) -> float:
    """Return the mean height of a part's cells that are no child's; where hardly a cell is left, the part's own."""
    area = area_m2[row] - area_m2[gone].sum()
    volume = area_m2[row] * height_m[row] - (area_m2[gone] * height_m[gone]).sum()
    return float(volume / area) if area > 0 and volume > 0 else float(height_m[row])


def _without_slivers(geometry: Geometries) -> Geometries:
    """Return multipolygons of those polygons that are wider than ``SLIVER_M`` somewhere."""
    parts, owner = shapely.get_parts(geometry, return_index=True)
    wide = (shapely.get_dimensions(parts) == 2) & ~shapely.is_empty(
        shapely.buffer(parts, -SLIVER_M / 2, join_style="mitre")
    )
    parts, owner = parts[wide], owner[wide]
    found = np.full(len(geometry), shapely.MultiPolygon(), dtype=object)
    begins = np.flatnonzero(np.diff(owner, prepend=-1))
    for begin, end in zip(begins, np.append(begins[1:], len(owner))[: len(begins)], strict=True):
        found[owner[begin]] = shapely.multipolygons(parts[begin:end])
    return found
