"""Rings of polygons as WKB, and which polygons are valid: a kernel accepts nearly all, GEOS decides about the others.

GEOS alone took a third of the client's time for a load, most of it for objects of its own.
"""

from typing import NamedTuple

import numpy as np
import shapely
from numpy.typing import NDArray

from msbdb.threads import kernel

Bytes = NDArray[np.uint8]
Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Mask = NDArray[np.bool_]
Point = tuple[float, float]

FEW = 64
"""Segments up to which all pairs are looked at, which is quicker than sorting them."""

MOST_RINGS = 500
"""Rings of a geometry above which GEOS decides, because the kernels compare each ring with each."""

UNSURE = (3.0 + 16.0 * 2.0**-53) * 2.0**-53
"""Shewchuk's bound of the relative error of an orientation; below it the sign is not certain."""

POINT, POLYGON, MULTIPOLYGON = 1, 3, 6
"""Types in WKB, in two dimensions."""

HEAD = b"\x01\x06\0\0\0\x01\0\0\0"
"""The beginning of a multipolygon of one polygon, as little-endian WKB."""


class Rings(NamedTuple):
    """Rings of polygons.

    Attributes
    ----------
    x, y : (V,) ndarray
        Vertices, the last one of a ring again its first.
    starts : (R + 1,) ndarray of int64
        The first vertex of each ring.
    polygons : (R,) ndarray of int64
        The number of each ring's polygon, whose first ring is its shell.
    bounds : (N + 1,) ndarray of int64
        The first ring of each geometry. One that is no polygon has none.
    """

    x: Floats
    y: Floats
    starts: Ints
    polygons: Ints
    bounds: Ints


def as_multipolygons(wkb: NDArray[np.object_]) -> NDArray[np.object_]:
    """Return (N,) little-endian WKB with each polygon as a multipolygon; other geometries stay."""
    return np.array([HEAD + one if one[1] == POLYGON else one for one in wkb.tolist()], dtype=object)


def are_valid(wkb: NDArray[np.object_]) -> Mask:
    """Return which geometries are valid, as ``shapely.is_valid`` does, in half of its time.

    Parameters
    ----------
    wkb : (N,) ndarray of bytes
        Geometries as little-endian WKB. GEOS decides about all that are no polygons in two dimensions.

    Returns
    -------
    (N,) ndarray of bool
        By the rules of OGC: rings do not cross or touch themselves, they touch each other at single points, and the
        interior of each polygon is connected.

    Examples
    --------
    >>> shapes = shapely.from_wkt(["POLYGON ((0 0, 1 0, 1 1, 0 0))", "POLYGON ((0 0, 1 1, 1 0, 0 1, 0 0))"])
    >>> are_valid(shapely.to_wkb(shapes, byte_order=1)).tolist()
    [True, False]
    """
    valid = surely_valid(wkb)
    unsure = np.flatnonzero(~valid)
    if unsure.size:
        valid[unsure] = shapely.is_valid(shapely.from_wkb(wkb[unsure]))
    return valid


def surely_valid(wkb: NDArray[np.object_]) -> Mask:
    """Return which geometries, as little-endian WKB, are valid polygons for certain."""
    return _surely_valid(rings_of(*joined(wkb))[0])


def joined(wkb: NDArray[np.object_]) -> tuple[Bytes, Ints]:
    """Return all bytes of (N,) geometries, and the (N + 1,) places where each begins."""
    begins = np.zeros(wkb.size + 1, dtype=np.int64)
    np.cumsum(np.fromiter(map(len, wkb), dtype=np.int64, count=wkb.size), out=begins[1:])
    return np.frombuffer(b"".join(wkb), dtype=np.uint8), begins


def rings_of(data: Bytes, begins: Ints) -> tuple[Rings, Bytes]:
    """Return the rings of geometries (`joined`), and the bytes of their vertices."""
    found, starts, polygons, bounds = _rings(data, begins)
    vertices = found.view(np.float64)
    return Rings(vertices[::2].copy(), vertices[1::2].copy(), starts, polygons, bounds), found


@kernel
def whole_at(data: Bytes, at: int) -> int:
    """Return the number in four bytes."""
    return int(np.int64(data[at]) | data[at + 1] << 8 | data[at + 2] << 16 | data[at + 3] << 24)


@kernel
def _rings(data: Bytes, begins: Ints) -> tuple[Bytes, Ints, Ints, Ints]:
    """Return the bytes of all vertices, and `Rings` without them."""
    xy = np.empty(data.size, dtype=np.uint8)
    starts = np.zeros(data.size // 4 + 2, dtype=np.int64)
    polygons = np.empty(data.size // 4 + 1, dtype=np.int64)
    bounds = np.zeros(begins.size, dtype=np.int64)
    vertices, rings, polygon = 0, 0, 0
    for g in range(begins.size - 1):
        at, many = begins[g], 1
        if whole_at(data, at + 1) == MULTIPOLYGON:
            many = whole_at(data, at + 5)
            at += 9
        for _ in range(many):
            if whole_at(data, at + 1) != POLYGON:
                break
            holding = whole_at(data, at + 5)
            at += 9
            for _ in range(holding):
                size = whole_at(data, at)
                xy[16 * vertices : 16 * (vertices + size)] = data[at + 4 : at + 4 + 16 * size]
                at += 4 + 16 * size
                vertices += size
                polygons[rings] = polygon
                rings += 1
                starts[rings] = vertices
            polygon += 1
        bounds[g + 1] = rings
    return xy[: 16 * vertices], starts[: rings + 1].copy(), polygons[:rings].copy(), bounds


@kernel
def _surely_valid(rings: Rings) -> Mask:
    """Decide about geometries."""
    starts, bounds = rings.starts, rings.bounds
    valid = np.zeros(bounds.size - 1, dtype=np.bool_)
    touched = np.zeros(rings.x.size, dtype=np.bool_)
    most = 0
    for g in range(valid.size):
        most = max(most, starts[bounds[g + 1]] - starts[bounds[g]])
    edges, box = np.empty((2, most), dtype=np.int64), np.empty((4, most))
    for g in range(valid.size):
        own = bounds[g], bounds[g + 1]
        if 0 < own[1] - own[0] <= MOST_RINGS:
            valid[g] = _edges(rings, own, edges, box) and _apart(rings, own, edges, box, touched)
            valid[g] = valid[g] and (own[1] - own[0] == 1 or _nested(rings, own, touched))
    return valid


@kernel
def side_of(a: Point, b: Point, c: Point) -> int:
    """Return 1 where c is left of the line from a to b, -1 where it is right, and 0 where this is not certain."""
    one, other = (b[0] - a[0]) * (c[1] - a[1]), (b[1] - a[1]) * (c[0] - a[0])
    bound = UNSURE * (abs(one) + abs(other))
    return int(one - other > bound) - int(other - one > bound)


@kernel
def _edges(rings: Rings, own: tuple[int, int], edges: Ints, box: Floats) -> bool:
    """Write the first vertex, the ring and the box of each edge of a geometry.

    Return whether each edge has a length and does not fold back on the one before for certain.
    """
    x, y, starts = rings.x, rings.y, rings.starts
    n = 0
    for r in range(own[0], own[1]):
        if starts[r + 1] - starts[r] < 4:
            return False
        before = starts[r + 1] - 2
        for v in range(starts[r], starts[r + 1] - 1):
            east, north, back_east, back_north = x[v + 1] - x[v], y[v + 1] - y[v], x[before] - x[v], y[before] - y[v]
            one, other = east * back_north, north * back_east
            folds = abs(one - other) <= UNSURE * (abs(one) + abs(other)) and east * back_east + north * back_north >= 0
            # Neither of no length, nor infinite, nor no number.
            if folds or not 0.0 < abs(east) + abs(north) < np.inf:
                return False
            edges[0, n], edges[1, n] = v, r
            box[0, n], box[1, n] = min(x[v], x[v + 1]), max(x[v], x[v + 1])
            box[2, n], box[3, n] = min(y[v], y[v + 1]), max(y[v], y[v + 1])
            n += 1
            before = v
    return True


@kernel
def _apart(rings: Rings, own: tuple[int, int], edges: Ints, box: Floats, touched: Mask) -> bool:
    """Return whether edges meet only where they follow each other, or at single vertices of two rings.

    Two rings of a polygon that touch twice, also by way of others, may cut its interior in two.

    Marks the vertices that touch.
    """
    n = rings.starts[own[1]] - rings.starts[own[0]] - (own[1] - own[0])
    if n > FEW:
        order = np.argsort(box[0, :n])
        for row in range(4):
            box[row, :n] = box[row, :n][order]
        edges[0, :n], edges[1, :n] = edges[0, :n][order], edges[1, :n][order]
    x, y, group = rings.x, rings.y, np.arange(own[1] - own[0])
    for p in range(n):
        low, high, bottom, top = box[0, p], box[1, p], box[2, p], box[3, p]
        for q in range(p + 1, n):
            if n > FEW and box[0, q] > high:
                break
            # One branch in place of four.
            if (box[2, q] > top) | (bottom > box[3, q]) | (low > box[1, q]) | (box[0, q] > high):
                continue
            u, v, one, other = edges[0, p], edges[0, q], edges[1, p], edges[1, q]
            size = rings.starts[one + 1] - rings.starts[one] - 1
            if one == other and (abs(u - v) == 1 or abs(u - v) == size - 1):
                continue
            a, b, c, d = (x[u], y[u]), (x[u + 1], y[u + 1]), (x[v], y[v]), (x[v + 1], y[v + 1])
            if side_of(a, b, c) * side_of(a, b, d) > 0 or side_of(c, d, a) * side_of(c, d, b) > 0:
                continue
            if one == other or not _touch(rings, (one, other), u, v):
                return False
            if a == c:
                touched[u], touched[v] = True, True
                if rings.polygons[one] == rings.polygons[other] and not _join(group, one - own[0], other - own[0]):
                    return False
    return True


@kernel
def _touch(rings: Rings, of: tuple[int, int], u: int, v: int) -> bool:
    """Return whether edges of two rings share a vertex, and the rings do not cross there for certain."""
    x, y, starts = rings.x, rings.y, rings.starts
    at, b, d = (x[u], y[u]), (x[u + 1], y[u + 1]), (x[v + 1], y[v + 1])
    if at != (x[v], y[v]):
        # The edges that begin at this vertex are looked at, too.
        return at == d or b == (x[v], y[v]) or b == d
    u = u - 1 if u > starts[of[0]] else starts[of[0] + 1] - 2
    v = v - 1 if v > starts[of[1]] else starts[of[1] + 1] - 2
    a, c = (x[u], y[u]), (x[v], y[v])
    ab, ac, ad, cb, db = _before(at, a, b), _before(at, a, c), _before(at, a, d), _before(at, c, b), _before(at, d, b)
    if ab * ac * ad * cb * db * _before(at, c, d) == 0:
        return False
    # Two of these three hold where c lies on the way from a to b: a before c, c before b, b before a.
    return bool((ac + cb - ab > 0) == (ad + db - ab > 0))


@kernel
def _before(at: Point, a: Point, b: Point) -> int:
    """Return 1 where the way to a comes before that to b, from east and counterclockwise, -1 after, 0 if unsure."""
    lower_a = a[1] < at[1] or (a[1] == at[1] and a[0] < at[0])
    lower_b = b[1] < at[1] or (b[1] == at[1] and b[0] < at[0])
    if lower_a != lower_b:
        return 1 if lower_b else -1
    return side_of(at, a, b)


@kernel
def _join(group: Ints, one: int, other: int) -> bool:
    """Join the groups of two rings; return False where they are one already."""
    while group[one] != one:
        one = group[one]
    while group[other] != other:
        other = group[other]
    group[one] = other
    return bool(one != other)


@kernel
def _nested(rings: Rings, own: tuple[int, int], touched: Mask) -> bool:
    """Return whether holes lie in their polygon and not in each other, and no polygon in another one's interior."""
    starts, polygons, first = rings.starts, rings.polygons, own[0]
    count = own[1] - first
    box = np.empty((4, count))
    spot, shell = np.empty(count, dtype=np.int64), np.empty(count, dtype=np.int64)
    for r in range(count):
        begin, end = starts[first + r], starts[first + r + 1]
        box[0, r], box[1, r] = rings.x[begin:end].min(), rings.x[begin:end].max()
        box[2, r], box[3, r] = rings.y[begin:end].min(), rings.y[begin:end].max()
        shell[r] = shell[r - 1] if r > 0 and polygons[first + r] == polygons[first + r - 1] else r
        free = np.flatnonzero(~touched[begin : end - 1])
        if free.size == 0:
            return False
        spot[r] = begin + free[0]
    for r in range(count):
        # A hole lies in its own shell alone, and each ring in as many holes of other polygons as in their shells.
        depth, around = 0, 0
        for s in range(count):
            is_out = (box[0, r] < box[0, s]) | (box[1, r] > box[1, s])
            if s == r or is_out or box[2, r] < box[2, s] or box[3, r] > box[3, s]:
                continue
            inside = _inside(rings, first + s, spot[r])
            if inside == 0 or (inside > 0 and shell[s] == shell[r] != s):
                return False
            if inside > 0 and s == shell[r]:
                around = 1
            elif inside > 0:
                depth += 1 if shell[s] == s else -1
        if depth != 0 or around != int(shell[r] != r):
            return False
    return True


@kernel
def _inside(rings: Rings, ring: int, point: int) -> int:
    """Return 1 where a vertex that is not on a ring lies inside, -1 where outside, and 0 where this is not certain."""
    x, y = rings.x, rings.y
    is_in, place = -1, (x[point], y[point])
    for k in range(rings.starts[ring], rings.starts[ring + 1] - 1):
        if (y[k] > place[1]) != (y[k + 1] > place[1]):
            side = side_of((x[k], y[k]), (x[k + 1], y[k + 1]), place)
            if side == 0:
                return 0
            if (side > 0) == (y[k + 1] > y[k]):
                is_in = -is_in
    return is_in
