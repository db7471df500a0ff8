"""Change of curvature, which separates crowns from roofs, and the points that return to regions (Cao & Wu, Eq. 7).

The change of curvature also takes the edges and walls of a roof; `grow_regions` gives these points back (ours).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from msbdb.grid import cell_along
from msbdb.labels import look_up
from msbdb.points.aside import let_go
from msbdb.points.nearest import nearest, nearest_in_plan
from msbdb.surface.noise import UNSEEN
from msbdb.threads import in_threads, kernel

BATCH = 1 << 13
"""Points worked on at once: their neighbours' coordinates stay in the processor's cache."""

NEAREST = 3
"""The height of the roof beside a point comes from so many points of regions."""

MOST_CUBES = 2**62
"""Cubes beyond which they cannot be numbered in 64 bits, unless only those that hold points count."""


@dataclass(frozen=True, slots=True, eq=False)
class PointStructure:
    """The neighbourhood of each point.

    Parameters
    ----------
    curvature : (N,) ndarray of float64
        COC of Eq. 7, from 0 on a plane to 1/3 where points fill the space evenly.
    echo_share : (N,) ndarray of float64
        Share of the neighbours whose pulse gave several echoes; 0 without echo numbers.
    """

    curvature: NDArray[np.float64]
    echo_share: NDArray[np.float64]


def measure_structure(
    points: NDArray[np.float64],
    several: NDArray[np.bool_] | None,
    noise_m: NDArray[np.float32] | None = None,
    *,
    neighbours: int,
    thin_m: float,
) -> PointStructure:
    """Measure the change of curvature of points, and their share of several echoes (C16, A18).

    Parameters
    ----------
    points : (N, 3) ndarray of float64, metres
        Points of the on-set, from an origin nearby, so that squares keep their digits.
    several : (N,) ndarray of bool, optional
        Which points are of pulses with several echoes; None without echo numbers.
    noise_m : (N,) ndarray of float32, optional
        Noise of the heights, metres. Its variance is taken off λ3, but for a ninth, in which no relief is seen.
    neighbours : int
        K; the point itself is one of them. Of fewer points, all.
    thin_m : float
        Side of a cube. The first point in each cube is measured, and all points in it get its values; 0 measures all.

    Notes
    -----
    The paper's Eq. 7 defines COC by itself; our reading (A18): the eigenvalues λ1 >= λ2 >= λ3 of the K nearest points'
    covariance give λ3 / (λ1 + λ2 + λ3), and a point's COC is the least of its K nearest points'. So the edge of a roof
    is as smooth as the roof beside it, and a crown has no smooth part. Equal points alone have COC 0.

    The cubes lie on an absolute lattice from the points' origin. Of equally near neighbours the first ones count, in
    the points' order. O(n log n) for the cubes, and O(n K) at a bounded density.
    """
    if len(points) == 0:
        return PointStructure(np.zeros(0), np.zeros(0))
    first, of = _one_a_cube(points, thin_m)
    points = points[first]  # if nobody else holds the others, they are freed
    let_go()
    x, y, z = (np.ascontiguousarray(each) for each in points.T)
    around = nearest(x, y, z, neighbours)
    own = _variation((x, y, z), around, None if noise_m is None else noise_m[first])
    curvature, share = np.empty(len(points)), np.zeros(len(points))
    echoes = None if several is None else several[first]

    def spread(start: int) -> None:
        part = slice(start, start + BATCH)
        curvature[part] = look_up(own, around[part]).min(axis=1)
        if echoes is not None:
            share[part] = look_up(echoes, around[part]).mean(axis=1)

    in_threads(spread, range(0, len(points), BATCH))
    return PointStructure(curvature[of], share[of])


def _one_a_cube(points: NDArray[np.float64], side_m: float) -> tuple[NDArray[np.intp], NDArray[np.int32]]:
    """Return the first point of each cube, and the number of each point's cube; cubes of no size have a point each."""
    if side_m <= 0:
        return np.arange(len(points)), np.arange(len(points), dtype=np.int32)
    cube, most = np.zeros(len(points), dtype=np.int64), 1
    for values in points.T:
        number = cell_along(values, side_m).astype(np.int64)
        number -= number.min()
        span = int(number.max()) + 1
        if most * span > MOST_CUBES:
            occurring, cube = np.unique(cube, return_inverse=True)
            most = len(occurring)
        cube *= span
        cube += number
        most *= span
    # Cubes are numbered in the points' own order, so that neighbours lie together in memory.
    first, of = _leaders(cube, np.argsort(cube, kind="stable"))
    return np.flatnonzero(first), of


@kernel
def _leaders(cube: NDArray[np.int64], order: NDArray[np.intp]) -> tuple[NDArray[np.bool_], NDArray[np.int32]]:
    """Return which points are the first ones of their cubes, and the number of each point's first point among these."""
    first, of = np.zeros(cube.size, dtype=np.bool_), np.empty(cube.size, dtype=np.int32)
    leader = 0
    for place in range(order.size):
        if place == 0 or cube[order[place]] != cube[leader]:
            leader = order[place]
            first[leader] = True
        of[order[place]] = leader
    number = np.empty(cube.size, dtype=np.int32)
    found = 0
    for point in range(cube.size):
        if first[point]:
            number[point] = found
            found += 1
        of[point] = number[of[point]]  # a leader is no later than its points
    return first, of


def _variation(
    places: tuple[NDArray[np.float64], ...], around: NDArray[np.int32], noise_m: NDArray[np.float32] | None
) -> NDArray[np.float64]:
    """Return λ3 / (λ1 + λ2 + λ3) of the covariance of each (N, K) set of points, given as x, y and z."""
    found = np.empty(len(around))

    def work(start: int) -> None:
        of = slice(start, start + BATCH)
        x, y, z = (look_up(axis, around[of]) for axis in places)
        for values in (x, y, z):
            values -= values.mean(axis=1, keepdims=True)
        pairs = ((x, x), (y, y), (z, z), (x, y), (x, z), (y, z))
        moments = np.stack([np.einsum("nk,nk->n", a, b) for a, b in pairs])
        found[of] = smallest_share(moments)
        if noise_m is not None:
            noise = (around.shape[1] - 1) * noise_m[of].astype(np.float64) ** 2
            found[of] = _without_noise(found[of], moments[:3].sum(axis=0), noise)

    in_threads(work, range(0, len(around), BATCH))
    return found


def _without_noise(
    share: NDArray[np.float64], sums: NDArray[np.float64], noise: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return λ3 / (λ1 + λ2 + λ3) without noise of the heights; as much of λ3 as is not seen in noise stays."""
    least = np.maximum(share * sums - noise, np.minimum(share * sums, UNSEEN**2 * noise))
    whole = sums - share * sums + least
    return np.divide(least, whole, out=np.zeros_like(least), where=whole > 0)


def smallest_share(matrices: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the smallest eigenvalue of positive semidefinite symmetric 3 x 3 matrices over their trace.

    Parameters
    ----------
    matrices : (6, N) ndarray of float64
        Their elements xx, yy, zz, xy, xz and yz.

    Returns
    -------
    (N,) ndarray of float64
        From 0 to 1/3; 0 for the matrix 0.

    Notes
    -----
    In closed form, by the trigonometric solution of the cubic [1]_: six times as fast as LAPACK's general solver, and
    within 1e-7 of the trace of its answer, far below the thresholds of 1e-3 to 1e-2.

    References
    ----------
    .. [1] Smith, O.K., 1961. Eigenvalues of a symmetric 3 x 3 matrix. Communications of the ACM 4 (4), 168.
       doi:10.1145/355578.366316.

    Examples
    --------
    Points on a level plane have no spread in z; points that fill a ball spread alike in x, y and z:

    >>> plane_and_ball = np.array([[2, 1], [2, 1], [0, 1], [0, 0], [0, 0], [0, 0]], dtype=float)
    >>> smallest_share(plane_and_ball).round(3)
    array([0.   , 0.333])
    """
    trace = matrices[:3].sum(axis=0)
    a, b, c, f, g, h = matrices / np.where(trace > 0, trace, 1.0)
    a, b, c = a - 1 / 3, b - 1 / 3, c - 1 / 3
    p = np.sqrt((a * a + b * b + c * c + 2 * (f * f + g * g + h * h)) / 6)
    determinant = a * (b * c - h * h) - f * (f * c - h * g) + g * (f * h - b * g)
    cube = 2 * p**3
    ratio = np.clip(determinant / np.where(cube > 0, cube, 1.0), -1, 1)
    smallest = 1 / 3 + 2 * p * np.cos(np.arccos(ratio) / 3 + 2 * np.pi / 3)
    return np.where(trace > 0, np.maximum(smallest, 0), 0.0)


@dataclass(frozen=True, slots=True)
class Reach:
    """The distances within which points return to a region.

    Parameters
    ----------
    level_m : float
        Largest distance in plan to a point of a region; 0 gives nothing back.
    step_m : float
        Points within this of the roof's height are of its level.
    wall_factor : float
        Only echoes below that level return within so many times the distance, at least the distance itself.
    mask_m : float
        Points lower than this above ground return only as feet of walls.
    """

    level_m: float
    step_m: float
    wall_factor: float
    mask_m: float

    def of(
        self, above_roof_m: NDArray[np.float64], heights: NDArray[np.float64], several: NDArray[np.bool_]
    ) -> NDArray[np.float64]:
        """Return (N,) the distances within which points return, by their height above roof and ground; 0: never."""
        level, half = self.level_m, self.level_m / 2
        wall = np.where(several, level, self.wall_factor * level)
        reach = np.where(above_roof_m <= 2 * self.step_m, half, 0.0)
        reach[above_roof_m <= self.step_m] = level
        below = above_roof_m < -self.step_m
        reach[below] = wall[below]
        low = heights < self.mask_m
        reach[low] = np.where(below[low], half, 0.0)
        return reach


def grow_regions(
    points: NDArray[np.float64],
    labels: NDArray[np.int32],
    free: NDArray[np.bool_],
    *,
    heights: NDArray[np.float64],
    several: NDArray[np.bool_] | None,
    reach: Reach,
) -> NDArray[np.int32]:
    """Return labels in which the points beside, below and on a region belong to it.

    Parameters
    ----------
    points : (N, 3) ndarray of float64, metres
        From an origin nearby.
    labels : (N,) ndarray of int32
        Regions; 0 for none. Not modified.
    free : (N,) ndarray of bool
        Points without a region that may return to one.
    heights : (N,) ndarray of float64, metres
        Above ground.
    several : (N,) ndarray of bool, optional
        Which points are of pulses with several echoes; None without echo numbers.
    reach : Reach
        How far they may lie from a region.

    Returns
    -------
    (N,) ndarray of int32
        A point that returns belongs to the region of the point nearest to it in plan.

    Notes
    -----
    The neighbourhood of an eave, a ridge with chimneys or a wall fills the space as a crown does. So Eq. 7 removes them
    where a roof is no wider than the neighbourhood. The height of the roof is that of the highest of the three nearest
    points of regions. A crown over a roof is higher. A lower point is a wall or a lower roof where its pulse ends
    there. Lower points of pulses with several echoes are leaves in half of the cases, so only near ones return. Below
    the mask little is building, but points right below a roof's edge are the feet of its walls.
    """
    members, asking = np.flatnonzero(labels > 0), np.flatnonzero(free & (labels == 0))
    if reach.level_m <= 0 or not members.size or not asking.size:
        return labels
    tree = cKDTree(points[members, :2], balanced_tree=False, compact_nodes=False)
    farthest_m = np.nextafter(max(1.0, reach.wall_factor) * reach.level_m, np.inf)
    roofs = np.append(points[members, 2], -np.inf)
    grown = labels.copy()
    for some, distance, near in nearest_in_plan(tree, (points[:, 0], points[:, 1]), asking, NEAREST, farthest_m):
        split = np.zeros(len(some), dtype=np.bool_) if several is None else several[some]
        highest = np.maximum.reduce([roofs[each] for each in near.T])  # the maximum over short rows takes far longer
        within = reach.of(points[some, 2] - highest, heights[some], split)
        returns = (within > 0) & (distance[:, 0] <= within)
        grown[some[returns]] = labels[members[near[returns, 0]]]
    return grown
