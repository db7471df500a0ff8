"""The normal form of geometries, for digests: GEOS's own, written by a kernel in a third of its time."""

import numpy as np
import shapely
from numpy.typing import NDArray

from msbdb.database.runs.wkbrings import (
    MOST_RINGS,
    MULTIPOLYGON,
    POINT,
    POLYGON,
    Bytes,
    Ints,
    Mask,
    Rings,
    joined,
    rings_of,
    side_of,
    whole_at,
)
from msbdb.threads import kernel


def normal_form(wkb: NDArray[np.object_]) -> bytes:
    """Return geometries one after another in the normal form of GEOS, as little-endian WKB; points are in it already.

    Rings begin at their vertex furthest west, of these the one furthest south. Shells go clockwise, holes the other
    way. Rings with more vertices come first, among as many those further east.

    Parameters
    ----------
    wkb : (N,) ndarray of bytes
        Points or multipolygons, as little-endian WKB in two dimensions. GEOS writes what the kernel is not sure of.

    Examples
    --------
    >>> square = shapely.from_wkt("MULTIPOLYGON (((1 1, 0 1, 0 0, 1 0, 1 1)))")
    >>> shapely.from_wkb(normal_form(np.array([shapely.to_wkb(square, byte_order=1)], dtype=object))).wkt
    'MULTIPOLYGON (((0 0, 0 1, 1 1, 1 0, 0 0)))'
    """
    data, begins = joined(wkb)
    rings, vertices = rings_of(data, begins)
    normal, sure = _normal(data, begins, vertices, rings)
    # GEOS leaves out vertices that are repeated at the end of a ring, so that what it writes may be shorter.
    pieces, written = [], 0
    for g in np.flatnonzero(~sure).tolist():
        pieces += [normal[written : begins[g]].tobytes(), _by_geos(wkb[g])]
        written = begins[g + 1]
    return b"".join([*pieces, normal[written:].tobytes()])


def _by_geos(wkb: bytes) -> bytes:
    """Return the normal form of one geometry."""
    found: bytes = shapely.to_wkb(shapely.normalize(shapely.from_wkb(wkb)), byte_order=1)
    return found


@kernel
def _normal(data: Bytes, begins: Ints, vertices: Bytes, rings: Rings) -> tuple[Bytes, Mask]:
    """Return the bytes of the normal form, and for which geometries they are certain."""
    starts, polygons, bounds = rings.starts, rings.polygons, rings.bounds
    normal, sure = data.copy(), np.ones(bounds.size - 1, dtype=np.bool_)
    # The vertex at which each ring begins, and its direction.
    way = np.zeros((2, polygons.size), dtype=np.int64)
    for g in range(sure.size):
        kind, first, end = whole_at(data, begins[g] + 1), bounds[g], bounds[g + 1]
        if kind == POINT:
            continue
        is_shell = np.ones(end - first, dtype=np.bool_)
        is_shell[1:] = polygons[first + 1 : end] != polygons[first : end - 1]
        sure[g] = kind == MULTIPOLYGON and end - first <= MOST_RINGS
        for r in range(first, end):
            sure[g] = sure[g] and _oriented(rings, r, is_shell[r - first], way)
        if not sure[g]:
            continue
        at = begins[g] + 9
        for shell in _sorted(first + np.flatnonzero(is_shell), rings, way):
            holes = shell + 1
            while holes < end and polygons[holes] == polygons[shell]:
                holes += 1
            normal[at] = 1
            _write(normal, at + 1, POLYGON)
            _write(normal, at + 5, holes - shell)
            at = _draw(normal, at + 9, vertices, (starts[shell], starts[shell + 1]), (way[0, shell], way[1, shell]))
            for r in _sorted(np.arange(shell + 1, holes), rings, way):
                at = _draw(normal, at, vertices, (starts[r], starts[r + 1]), (way[0, r], way[1, r]))
    return normal, sure


@kernel
def _oriented(rings: Rings, r: int, is_shell: bool, way: Ints) -> bool:
    """Write the first vertex and the direction of a ring; return whether they are certain."""
    x, y, begin, end = rings.x, rings.y, rings.starts[r], rings.starts[r + 1] - 1
    if end - begin < 3:
        return False
    low = begin
    for v in range(begin + 1, end):
        if x[v] < x[low] or (x[v] == x[low] and y[v] < y[low]):
            low = v
    before = low - 1 if low > begin else end - 1
    turn = side_of((x[before], y[before]), (x[low], y[low]), (x[low + 1], y[low + 1]))
    way[0, r], way[1, r] = low, -turn if is_shell else turn
    return turn != 0


@kernel
def _write(data: Bytes, at: int, number: int) -> None:
    """Write a number in four bytes."""
    for k in range(4):
        data[at + k] = number >> 8 * k & 255


@kernel
def _vertex(begin: int, end: int, way: tuple[int, int], k: int) -> int:
    """Return the vertex of a ring that comes after k others on its way."""
    v = way[0] + way[1] * k
    return int(v + end - begin if v < begin else v if v < end else v - end + begin)


@kernel
def _draw(data: Bytes, at: int, vertices: Bytes, bounds: tuple[int, int], way: tuple[int, int]) -> int:
    """Write a ring, whose vertices lie between bounds; return where it ends."""
    begin, end = bounds
    _write(data, at, end - begin)
    at += 4
    for k in range(end - begin):
        v = _vertex(begin, end - 1, way, k) if k < end - begin - 1 else way[0]
        for byte in range(16):
            data[at + byte] = vertices[16 * v + byte]
        at += 16
    return at


@kernel
def _sorted(order: Ints, rings: Rings, way: Ints) -> Ints:
    """Return rings in descending order."""
    for i in range(1, order.size):
        ring, j = order[i], i
        while j > 0 and _is_less(rings, way, order[j - 1], ring):
            order[j] = order[j - 1]
            j -= 1
        order[j] = ring
    return order


@kernel
def _is_less(rings: Rings, way: Ints, one: int, other: int) -> bool:
    """Return whether a ring has fewer vertices than another, or as many that come first, from west and from south."""
    begin, end, begins, ends = rings.starts[one], rings.starts[one + 1], rings.starts[other], rings.starts[other + 1]
    if end - begin != ends - begins:
        return bool(end - begin < ends - begins)
    for k in range(end - begin - 1):
        a = _vertex(begin, end - 1, (way[0, one], way[1, one]), k)
        b = _vertex(begins, ends - 1, (way[0, other], way[1, other]), k)
        if rings.x[a] != rings.x[b]:
            return bool(rings.x[a] < rings.x[b])
        if rings.y[a] != rings.y[b]:
            return bool(rings.y[a] < rings.y[b])
    return False
