"""Outlines of regions that are points: alpha shape or concave hull; then Douglas-Peucker (S7)."""

from typing import Literal

import numpy as np
import shapely
from numpy.typing import NDArray

from msbdb.errors import InputError, ParameterError
from msbdb.labels import Labels, sizes
from msbdb.order import order_of_points
from msbdb.outline.alphashape import alpha_shapes
from msbdb.outline.polygons import Geometries
from msbdb.params import VectorParams

Floats = NDArray[np.float64]
Method = Literal["alpha", "hull"]

METHODS = ("alpha", "hull")

ALPHA_SPACINGS = 2.0
"""Radius 1/alpha where none is given, in spacings."""

GROW_SPACINGS = 0.6
"""Growth where none is given, in spacings: a roof ends about half a spacing beyond its last points."""

RESIDUAL_M2 = 4.0
"""Smaller pieces and holes of an outline are residuals, where no area is given."""

MITRE = 2.0
"""Corners that are grown stay sharp up to this multiple of the growth."""

SLIVER = 1e-6
"""Common area of two outlines that counts as rounding, as a share of the squared spacing."""

SPARSE = 4.0
"""Outlines with more area than so many squares a point are rejected. A square is as wide as the double alpha radius, or
as the spacing for a convex hull."""


def outline_regions(
    x: Floats, y: Floats, labels: Labels, count: int, *, spacing_m: float, params: VectorParams
) -> Geometries:
    """Return the outlines of regions of points by a build's parameters; see `outline_points`."""
    return outline_points(
        x,
        y,
        labels,
        count,
        method=params.outline,  # type: ignore[arg-type]  # one of the declared choices
        spacing_m=spacing_m,
        simplify_m=params.outline_simplify * spacing_m,
        radius_m=max(params.alpha_factor * spacing_m, params.alpha_least_m),
        grow_m=params.outline_grow * spacing_m,
        residual_m2=params.residual_m2,
    )


def outline_points(
    x: Floats,
    y: Floats,
    labels: Labels,
    count: int,
    *,
    method: Method,
    spacing_m: float,
    simplify_m: float,
    radius_m: float | None = None,
    grow_m: float | None = None,
    residual_m2: float = RESIDUAL_M2,
) -> Geometries:
    """Return the outline of every region of points.

    Parameters
    ----------
    x, y : (N,) ndarray of float64, metres
        Finite; those of no region are ignored.
    labels : (N,) ndarray of int32
        1 to ``count``, each with a point at least; 0 for points of no region.
    count : int
        Number of regions.
    method : {'alpha', 'hull'}
        Alpha shape with holes, or concave hull without holes (the "modified convex hull").
    spacing_m : float
        Mean spacing of the points, metres.
    simplify_m : float
        Tolerance of Douglas-Peucker, metres; 0 keeps all vertices.
    radius_m : float, optional
        1/alpha, metres; edges of the hull are at most twice as long. `ALPHA_SPACINGS` unless given.
    grow_m : float, optional
        By how much alpha shapes and hulls grow, metres; `GROW_SPACINGS` unless given.
    residual_m2 : float
        Smaller pieces and holes are left out, but not the largest piece, m2.

    Returns
    -------
    (count,) ndarray of MultiPolygon
        Valid and never empty; of label i + 1 at index i.

    Raises
    ------
    InputError
        When arrays differ in length, coordinates are not finite, or a label is out of range or has no point.
    ParameterError
        For an unknown method, or a size that cannot be.

    Notes
    -----
    A region whose points span no shape (too few, on one line, too sparse) becomes its convex hull, grown by half of
    the spacing. Outlines do not overlap by more than rounding. Alpha shapes of different regions are disjoint;
    overlaps that growth, simplification and hulls make stay with the smaller outline (of equal ones, the lower label),
    which may lie in a bay of the larger. The order of the points has no effect.

    References
    ----------
    Edelsbrunner, Kirkpatrick, Seidel (1983), doi:10.1109/TIT.1983.1056714.
    """
    radius_m = ALPHA_SPACINGS * spacing_m if radius_m is None else radius_m
    grow_m = GROW_SPACINGS * spacing_m if grow_m is None else grow_m
    _check(method, (spacing_m, radius_m), (simplify_m, grow_m, residual_m2))
    x, y, labels = _members(x, y, labels, count)
    if count == 0:
        return np.empty(0, dtype=np.object_)
    is_alpha = method == "alpha"
    shapes = alpha_shapes(x, y, labels, count, radius_m) if is_alpha else _hulls(x, y, labels, 2 * radius_m)
    shapes = simplified(without_residuals(shapes, residual_m2), simplify_m)
    if grow_m:
        shapes = shapely.buffer(shapes, grow_m, join_style="mitre", mitre_limit=MITRE)
    size = sizes(labels, count)
    bare = ~_has_area(shapes) | (shapely.area(shapes) > SPARSE * size * (2 * radius_m) ** 2)
    if bare.any():
        shapes[bare] = _buffered(x, y, labels, np.flatnonzero(bare), spacing_m / 2)
    shapes = _apart(shapes, SLIVER * spacing_m**2)
    shapes[~bare] = without_residuals(shapes[~bare], residual_m2)
    return _as_multi(shapes)


def without_residuals(shapes: Geometries, residual_m2: float) -> Geometries:
    """Leave out pieces and holes below an area, m2, except for the largest piece; None stays."""
    parts, owner = shapely.get_parts(shapes, return_index=True)
    # Holes first, so that a ring of a piece counts with what it encloses.
    rings, ring_owner = shapely.get_rings(parts, return_index=True)
    is_shell = np.diff(ring_owner, prepend=-1) > 0
    size = shapely.area(shapely.polygons(rings))
    kept = is_shell | (size >= residual_m2)
    if not kept.all():
        parts = _rebuilt(rings[kept], ring_owner[kept])
    area = shapely.area(parts)
    order = np.lexsort((-area, owner))
    largest = np.zeros(len(parts), dtype=np.bool_)
    largest[order[np.flatnonzero(np.diff(owner[order], prepend=-1))]] = True
    left = largest | (area >= residual_m2)
    found = np.full(len(shapes), None, dtype=np.object_)
    if left.any():
        present, place = np.unique(owner[left], return_inverse=True)
        found[present] = shapely.multipolygons(parts[left], indices=place)
    return found


def simplified(shapes: Geometries, tolerance_m: float) -> Geometries:
    """Simplify by Douglas-Peucker with the rings kept; a shape that would become invalid does not change."""
    if tolerance_m == 0:
        return shapes
    found = shapely.simplify(shapes, tolerance_m, preserve_topology=True)
    return np.where(shapely.is_valid(found) & _has_area(found), found, shapes)


def _check(method: str, positive: tuple[float, ...], at_least_0: tuple[float, ...]) -> None:
    """Refuse an unknown method and sizes that cannot be."""
    if method not in METHODS:
        msg = f"There is no outline method '{method}'; the methods are {', '.join(METHODS)}."
        raise ParameterError(msg)
    if not all(value > 0 for value in positive) or not all(value >= 0 for value in at_least_0):
        msg = (
            f"The spacing and the alpha radius must be above 0, the tolerance, growth and residual area 0 or more; "
            f"got {positive} and {at_least_0}."
        )
        raise ParameterError(msg)


def _members(x: Floats, y: Floats, labels: Labels, count: int) -> tuple[Floats, Floats, Labels]:
    """Return the points of regions in canonical order, checked."""
    if not len(x) == len(y) == len(labels):
        msg = f"There must be a label a point; got {len(x)} eastings, {len(y)} northings and {len(labels)} labels."
        raise InputError(msg)
    inside = np.flatnonzero(labels != 0)
    x, y, labels = x[inside], y[inside], labels[inside]
    present = _present(labels, count)
    if not np.array_equal(present, np.arange(1, count + 1)):
        msg = f"The labels must be 1 to {count}, each with a point; got {len(present)} labels: {present[:5]}..."
        raise InputError(msg)
    if not (np.isfinite(x).all() and np.isfinite(y).all()):
        msg = "The coordinates of the regions' points must be finite; leave out NaN and infinity first."
        raise InputError(msg)
    order = order_of_points(x, y, group=labels)
    return x[order], y[order], labels[order]


def _present(labels: Labels, count: int) -> NDArray[np.integer]:
    """Return the labels that occur, ascending; without sorting where all are in range."""
    if labels.size and labels.min() >= 1 and labels.max() <= count:
        return np.flatnonzero(np.bincount(labels, minlength=count + 1))
    return np.unique(labels)


def _gathered(x: Floats, y: Floats, labels: Labels) -> Geometries:
    """Return the points of each label, which are in its order, as a MultiPoint."""
    _, place = np.unique(labels, return_inverse=True)
    return np.asarray(shapely.multipoints(np.column_stack((x, y)), indices=place), dtype=np.object_)


def _hulls(x: Floats, y: Floats, labels: Labels, edge_m: float) -> Geometries:
    """Return concave hulls whose edges are no longer than a length where the shape allows it; None without area.

    GEOS takes the length as a share between those of the shortest and the longest edge of the triangulation.
    """
    points = _gathered(x, y, labels)
    found = np.full(len(points), None, dtype=np.object_)
    lines, owner = shapely.get_parts(shapely.delaunay_triangles(points, only_edges=True), return_index=True)
    if not len(lines):
        return found
    length = shapely.length(lines)
    start = np.flatnonzero(np.diff(owner, prepend=-1))
    shortest, longest = np.minimum.reduceat(length, start), np.maximum.reduceat(length, start)
    share = np.clip((edge_m - shortest) / np.maximum(longest - shortest, 1e-9), 0, 1)
    spanned = owner[start]
    hulls = [shapely.concave_hull(region, ratio=ratio) for region, ratio in zip(points[spanned], share, strict=True)]
    found[spanned] = hulls
    found[~_has_area(found)] = None
    return found


def _buffered(x: Floats, y: Floats, labels: Labels, which: NDArray[np.intp], reach_m: float) -> Geometries:
    """Return the convex hulls of regions, or their single points where those lie far apart, grown by a reach."""
    start = np.searchsorted(labels, which + 1)
    stop = np.searchsorted(labels, which + 1, side="right")
    member = np.concatenate([np.arange(a, b) for a, b in zip(start, stop, strict=True)])
    points = _gathered(x[member], y[member], labels[member])
    hulls = shapely.convex_hull(points)
    sparse = shapely.area(hulls) > SPARSE * (stop - start) * (2 * reach_m) ** 2
    return np.asarray(shapely.buffer(np.where(sparse, points, hulls), reach_m, quad_segs=2), dtype=np.object_)


def _apart(shapes: Geometries, sliver_m2: float) -> Geometries:
    """Remove the common area of two outlines from the larger one, unless that is all of it."""
    one, other = shapely.STRtree(shapes).query(shapes, predicate="intersects")
    one, other = one[one < other], other[one < other]
    common = shapely.area(shapely.intersection(shapes[one], shapes[other])) > sliver_m2
    one, other = one[common], other[common]
    if not one.size:
        return shapes
    area = shapely.area(shapes)
    loses = np.where(area[one] > area[other], one, other)
    keeps = one + other - loses
    result = shapes.copy()
    for region in np.unique(loses):
        cut = shapely.difference(shapes[region], shapely.union_all(shapes[keeps[loses == region]]))
        if shapely.area(cut) > sliver_m2:
            result[region] = _polygonal(cut)
    return result


def _polygonal(shape: shapely.Geometry) -> shapely.Geometry:
    """Return the polygons of a geometry, without lines and points that a difference may leave."""
    parts = shapely.get_parts(shape)
    polygons: shapely.Geometry = shapely.multipolygons(
        parts[shapely.get_type_id(parts) == shapely.GeometryType.POLYGON]
    )
    return polygons


def _has_area(shapes: Geometries) -> NDArray[np.bool_]:
    """Return which geometries are there, polygonal and of an area."""
    return np.asarray(shapely.area(shapes) > 0)


def _rebuilt(rings: Geometries, owner: NDArray[np.int64]) -> Geometries:
    """Return polygons of rings in order of their owners, the shell first."""
    first = np.flatnonzero(np.diff(owner, prepend=-1))
    stop = np.append(first[1:], len(rings))
    polygons = np.asarray(shapely.polygons(rings[first]), dtype=np.object_)
    for place in np.flatnonzero(stop - first > 1):
        polygons[place] = shapely.polygons(rings[first[place]], rings[first[place] + 1 : stop[place]])
    return polygons


def _as_multi(shapes: Geometries) -> Geometries:
    """Return polygons and multipolygons as multipolygons whose shells run counter-clockwise."""
    parts, owner = shapely.get_parts(shapes, return_index=True)
    return np.asarray(shapely.orient_polygons(shapely.multipolygons(parts, indices=owner)), dtype=np.object_)
