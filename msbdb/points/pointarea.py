"""Area opening, area closing and AOC on the graph of connected points, for all heights at once (Cao & Wu, C1 to C7).

The on-set at a height h is S_h = {z >= h}; the other points are the off-set. An area opening removes from the on-set
the connected components of less area than T_a, an area closing removes those of the off-set. One sweep over the points
in the order of their heights, which joins them by union-find, does so for every h. The result is a function over the
points; its on-set at h is the filtered on-set of h.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from msbdb.errors import InputError, ParameterError
from msbdb.labels import chosen_cells, sums
from msbdb.labels.cellkernels import find_root
from msbdb.order import order_of
from msbdb.points.graph import PointGraph, components
from msbdb.points.linkage import linked, near_others
from msbdb.threads import kernel

T = TypeVar("T", bound=np.generic)

NONE, SMALL, LARGE = -1, -2, -3
"""Marks instead of a point's parent: not entered yet, or root of a component of too little or of enough area.

In a result, ``NONE`` marks a point that takes the value of no other.
"""


def area_opening(
    values: NDArray[T], graph: PointGraph, threshold: float, *, weights: NDArray[np.float64] | None = None
) -> NDArray[T]:
    """Lower each point to the highest level at which its component of the on-set has at least the area T_a.

    Parameters
    ----------
    values : (N,) ndarray
        The function z over the points: booleans (an on-set), integers or floats without NaN. Not modified.
    graph : PointGraph
        The connected points, from `connect`.
    threshold : float
        T_a, above 0: components of just that area stay. Points, or the unit of the weights.
    weights : (N,) ndarray of float64, optional
        Area of each point, finite and not negative. By default 1: area is the number of points (C3).

    Returns
    -------
    (N,) ndarray
        Of the values' dtype; each value is one of the input's.

    Raises
    ------
    InputError
        When the values or weights are not one for each point, or no numbers; NaN.
    ParameterError
        When T_a is no number above 0.

    Notes
    -----
    {γ(z) ≥ h} = {p in S_i : Area(S_i) ≥ T_a} for the connected components S_i of S_h (C4, Eq. 1), for every h above
    the lowest value. Where an island of points, connected to no others, has less area than T_a, no height keeps it:
    it takes the lowest value of all. An on-set of booleans is filtered just so: such an island is off.

    The area of a component with weights is summed in 64 bits in the order of the heights; for weights that are whole
    multiples of a power of two, as counts are, no order of the points matters.

    Complexity: O(N log N) to sort the heights, or O(N) where 32 bits hold them, and nearly O(N + E) for the sweep.
    Memory: 20 to 30 bytes a point in passing.

    References
    ----------
    .. [1] Cao, Z., Wu, Y.: A novel multi-scale 3D area morphological filtering method for airborne LiDAR building
       extraction. Definitions 1 to 5.

    Examples
    --------
    >>> from msbdb.points.graph import connect
    >>> graph = connect(np.arange(5.0), np.zeros(5), np.zeros(5), 1.5)
    >>> area_opening(np.array([0, 5, 0, 3, 3]), graph, 2)
    array([0, 0, 0, 3, 3])
    """
    return _filter(values, graph, threshold, weights, from_top=True)


def area_closing(
    values: NDArray[T], graph: PointGraph, threshold: float, *, weights: NDArray[np.float64] | None = None
) -> NDArray[T]:
    """Raise each point to the lowest level at which its component of points no higher has at least the area T_a.

    Parameters, errors, complexity and rules are those of `area_opening`. This is its dual: φ(z) = -γ(-z).

    Notes
    -----
    {φ(z) ≥ h} is the on-set S_h together with the components of the off-set of less area than T_a (C5; Eq. 2 gives
    the off-set that remains), for every h up to the highest value. An island of less area than T_a is on at every
    height: it takes the highest value of all.

    Examples
    --------
    >>> from msbdb.points.graph import connect
    >>> graph = connect(np.arange(5.0), np.zeros(5), np.zeros(5), 1.5)
    >>> area_closing(np.array([4, 0, 4, 1, 1]), graph, 2)
    array([4, 4, 4, 1, 1])
    """
    return _filter(values, graph, threshold, weights, from_top=False)


def area_open_close(
    values: NDArray[T], graph: PointGraph, threshold: float, *, weights: NDArray[np.float64] | None = None
) -> NDArray[T]:
    """Open, then close with the same T_a: the AOC operator (C6).

    Parameters, errors, complexity and rules are those of `area_opening`.

    Notes
    -----
    AOC(z) = φ(γ(z)). The on-set of the result at h is AOC of the on-set S_h. This holds for every h above the lowest
    value, up to the highest value after the opening. As the closing comes last, an island of less area than T_a is on
    at all these heights, be it a bird or a patch of ground. To get regions, drop the components of less area than T_a
    afterwards.

    Examples
    --------
    A peak of one point goes, a pit of one point is filled, a step of two points stays:

    >>> from msbdb.points.graph import connect
    >>> graph = connect(np.arange(9.0), np.zeros(9), np.zeros(9), 1.5)
    >>> area_open_close(np.array([0, 0, 5, 0, 4, 4, 1, 4, 4]), graph, 2)
    array([0, 0, 0, 0, 4, 4, 4, 4, 4])
    """
    opened = area_opening(values, graph, threshold, weights=weights)
    return area_closing(opened, graph, threshold, weights=weights)


def open_close_on_sets(
    values: NDArray[Any],
    graph: PointGraph,
    threshold: float,
    heights: Sequence[float],
    *,
    weights: NDArray[np.float64],
    lowest: tuple[NDArray[np.bool_], NDArray[np.bool_]] | None = None,
) -> NDArray[np.float64]:
    """Open, then close the on-sets of a few heights: as `area_open_close` does, faster, and without its small islands.

    Parameters
    ----------
    values, graph, threshold, weights
        As for `area_opening`. The graph may hold each pair from one end alone.
    heights : sequence of float
        h_j, ascending.
    lowest : two (N,) ndarrays of bool, optional
        What is on at the lowest height, and which of these points are connected to one that is off: from
        `open_close_linked`. Then the points may be those that are on alone, with others or without.

    Returns
    -------
    (N,) ndarray of float64
        The highest of the heights at which each point is on; minus infinity without one. A point is on at all lower
        ones as well. Islands of less area than T_a, for which no height decides, are never on.

    Notes
    -----
    What is off at the lowest height, in a component of enough area, is off in a component of enough area at all higher
    ones. So these are filtered among the points that are on at the lowest height: a component that holds a point of
    their rim, which is connected to one that is off, is large enough. Four heights take a sixth of the time of one
    sweep, on four million points in the order of their places. The sweep goes by heights, and its neighbours lie all
    over the memory.
    """
    _require_threshold(threshold)
    found = np.full(values.size, -np.inf)
    if not len(heights):
        return found
    if lowest is None:
        on = ~_large(~_large(values >= heights[0], graph, threshold, weights), graph, threshold, weights)
        rim = graph.with_neighbours(~on) & on
    else:
        on, rim = lowest
    found[on] = heights[0]
    for height in heights[1:]:
        off = on & ~_large((values >= height) & on, graph, threshold, weights)
        found[on & ~_large(off, graph, threshold, weights, rim)] = height
    found[on & ~_large(on, graph, threshold, weights, rim)] = -np.inf
    return found


def open_close_linked(
    on: NDArray[np.bool_],
    points: Sequence[NDArray[np.float64]],
    distance_m: float,
    threshold: float,
    *,
    weights: NDArray[np.float64],
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Open, then close a set of points by area, without a graph of them: in a fraction of its memory.

    Parameters
    ----------
    on : (N,) ndarray of bool
        The on-set.
    points : sequence of (N,) ndarray of float64
        x, y and z of all points, metres.
    distance_m : float
        T_c, below which points are connected, metres.
    threshold : float
        T_a, above 0, in the unit of the weights.
    weights : (N,) ndarray of float64
        Area of each point.

    Returns
    -------
    on : (N,) ndarray of bool
        Of islands of less area than T_a, too, what the definition says: as the closing comes last, they are on.
    rim : (N,) ndarray of bool
        Which of these points are connected to one that is off.
    """

    def large(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
        labels, count = linked(x, y, z, distance_m, mask)
        return chosen_cells(labels, sums(labels, weights, count) >= threshold)

    x, y, z = points
    on = ~large(~large(on))
    return on, near_others(x, y, z, distance_m, on)


def _large(
    mask: NDArray[np.bool_],
    graph: PointGraph,
    threshold: float,
    weights: NDArray[np.float64],
    rim: NDArray[np.bool_] | None = None,
) -> NDArray[np.bool_]:
    """Return the points of a set whose components are large enough, as those are that hold a point of the rim."""
    labels, count = components(mask, graph)
    enough = sums(labels, weights, count) >= threshold
    if rim is not None:
        enough[labels[rim & mask] - 1] = True
    return chosen_cells(labels, enough)


@dataclass(frozen=True, slots=True, eq=False)
class PointScaleSpace:
    """A function over points at rising area thresholds; the array is read-only.

    Parameters
    ----------
    levels : (S, N) ndarray
        The function at each area scale, finest first.
    thresholds : tuple of float
        Ta_k of each level, ascending.
    """

    levels: NDArray[Any]
    thresholds: tuple[float, ...]

    def __post_init__(self) -> None:
        """Check that there is one level a threshold, and freeze the array."""
        if self.levels.ndim != 2 or len(self.levels) != len(self.thresholds):
            msg = f"There must be one level a threshold; got {self.levels.shape} and {self.thresholds}."
            raise InputError(msg)
        self.levels.flags.writeable = False

    def on_set(self, level: int, height: float) -> NDArray[np.bool_]:
        """Return which points are in SP_k^j: the on-set of an area scale at a height h_j, (N,) booleans."""
        on: NDArray[np.bool_] = self.levels[level] >= height
        return on


def build_point_scale_space(
    values: NDArray[Any],
    graph: PointGraph,
    thresholds: Sequence[float],
    *,
    weights: NDArray[np.float64] | None = None,
) -> PointScaleSpace:
    """Filter a function over points by AOC with rising thresholds, each scale fed by the one before (C7).

    Parameters
    ----------
    values, graph, weights
        As for `area_opening`. SP_0 = P is the function itself.
    thresholds : sequence of float
        Ta_1 < Ta_2 < ..., each above 0.

    Returns
    -------
    PointScaleSpace
        Of the values' dtype.

    Raises
    ------
    InputError
        As for `area_opening`.
    ParameterError
        When there is no threshold, one is no number above 0, or they do not ascend.

    Notes
    -----
    SP_k^j = φ_k(γ_k(SP_{k-1}^j)) for each height h_j (Eq. 3), with SP_0^j the on-set of P at h_j. The heights need
    not be known: `PointScaleSpace.on_set` gives any of them. "SP_k^j is a subset of SP_{k-1}^j" holds when only
    openings are applied; a closing adds points (C15).
    """
    for threshold in thresholds:
        _require_threshold(threshold)
    if not thresholds or any(a >= b for a, b in pairwise(thresholds)):
        msg = f"The area thresholds must be one or more ascending numbers; got {tuple(thresholds)}."
        raise ParameterError(msg)
    levels = np.empty((len(thresholds), len(graph)), dtype=values.dtype)
    current = values
    for index, threshold in enumerate(thresholds):
        current = levels[index] = area_open_close(current, graph, threshold, weights=weights)
    return PointScaleSpace(levels, tuple(float(threshold) for threshold in thresholds))


def _filter(
    values: NDArray[T], graph: PointGraph, threshold: float, weights: NDArray[np.float64] | None, *, from_top: bool
) -> NDArray[T]:
    """Open from the top or close from the bottom: each point takes the value of another, or the extreme of all."""
    _require_threshold(threshold)
    _require_function(values, graph)
    areas, enough = _areas(values.size, weights, threshold)
    order = order_of(values, descending=from_top)
    source = _absorb(order, graph.indptr, graph.indices, areas, enough)
    result = values[source] if values.size else values.copy()
    lost = source == NONE
    if lost.any():
        result[lost] = _extreme(values, lowest=from_top)
    return result


def _areas(count: int, weights: NDArray[np.float64] | None, threshold: float) -> tuple[NDArray[Any], Any]:
    """Return an area for each point, to be overwritten, and what is enough: as integers where points are counted."""
    if weights is None:
        # A threshold beyond the points acts like one of a point more than there are, and fits into 32 bits.
        return np.ones(count, dtype=np.int32), np.int32(min(math.ceil(threshold), count + 1))
    areas = np.array(weights, dtype=np.float64)
    if areas.shape != (count,) or not np.isfinite(areas).all() or (areas < 0).any():
        msg = f"The weights must be {count} finite numbers from 0, one a point; got the shape {areas.shape}."
        raise InputError(msg)
    return areas, np.float64(threshold)


def _extreme(values: NDArray[Any], *, lowest: bool) -> Any:  # noqa: ANN401 (a scalar of the values' dtype)
    """Return the value of islands that are too small at every height: the bottom or the top of the function."""
    if values.dtype == np.bool_:
        return not lowest
    return values.min() if lowest else values.max()


def _require_threshold(threshold: float) -> None:
    """Refuse an area that is no finite number above 0."""
    number = isinstance(threshold, int | float | np.integer | np.floating) and not isinstance(threshold, bool)
    if not number or not math.isfinite(threshold) or threshold <= 0:
        msg = f"The area threshold T_a must be a finite number above 0; got {threshold!r}."
        raise ParameterError(msg)


def _require_function(values: NDArray[Any], graph: PointGraph) -> None:
    """Refuse what is no function over the points: not one value a point, no real numbers, or NaN."""
    if values.shape != (len(graph),) or values.dtype.kind not in "biuf":
        msg = (
            f"The function must be of {len(graph)} booleans, integers or floats, one a point of the graph; "
            f"got {values.dtype} of the shape {values.shape}."
        )
        raise InputError(msg)
    if values.dtype.kind == "f" and np.isnan(values).any():
        msg = f"The function is NaN at {np.isnan(values).sum()} points, which have no order. Drop these points."
        raise InputError(msg)


@kernel
def _absorb(
    order: NDArray[np.int32], indptr: NDArray[np.int64], indices: NDArray[np.int32], areas: NDArray[Any], enough: float
) -> NDArray[np.int32]:
    """Return for each point the point whose value it takes, or ``NONE``: no component around it is large enough.

    Points enter in the order given. Each absorbs the components that it is connected to and that are still too small.
    These take its value, or the value of the point that absorbs it later. A component of enough area keeps its value;
    whatever is connected to it has enough too.

    Invariant: ``node`` holds a point's parent, ``SMALL`` or ``LARGE`` for a root, or ``NONE``. ``areas`` holds the area
    of the component at a root that is ``SMALL``, and the point's own area before it enters.
    """
    node = np.full(order.size, NONE, dtype=np.int32)
    for point in order:
        node[point] = SMALL
        area = areas[point]
        for place in range(indptr[point], indptr[point + 1]):
            other = indices[place]
            if node[other] == NONE:
                continue
            root = find_root(node, other)
            if node[root] == LARGE:
                area = enough  # joined in area only: its points keep their own value
            elif root != point:
                area += areas[root]
                node[root] = point
        if area >= enough:
            node[point] = LARGE
        else:
            areas[point] = area
    # A parent entered later than its children, so in reverse order it has its source before they ask for it.
    for place in range(order.size - 1, -1, -1):
        point = order[place]
        if node[point] >= 0:
            node[point] = node[node[point]]
        else:
            node[point] = point if node[point] == LARGE else NONE
    return node
