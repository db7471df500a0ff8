"""Ground, eaves and ridge of a building from classified points alone: no lattice, no terrain model, no gaps filled."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

STEP_M, STEEP = 1.0, 1.5
"""Neighbours of one roof differ by at most this height, or by this much a metre between them."""

STEEPER = 2.0
"""The same for points that are in no roof by STEEP: the gables of an old town rise by 60 degrees."""

LINK, AROUND = 2.0, 3.0
"""Reach of the links of a roof, and of the neighbours that show its edge, in point spacings."""

INNER = 0.8
"""A point links roofs where this share of its neighbours is of its own level."""

GAP = np.deg2rad(130.0)
"""A point whose neighbours leave a wider angle free lies at the edge of its roof."""

EAVES, RIDGE = 0.2, 0.98
"""Shares of the edge below the eaves, and of the roof below the ridge."""

MIDDLE = (0.25, 0.75)
"""The middle half of the roofs of a building, by area."""

WEIGHT_M2, WEIGHT, LEAST_M2 = 50.0, 0.1, 10.0
"""A roof counts from this area on, or from this share of its building and from a least area on."""

REACHES_M = (3.0, 6.0, 12.0)
LEAST_POINTS = 10

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Roof:
    """A roof that counts: its level at the eaves, its share of the building, and its points."""

    eaves: float
    share: float
    points: Floats


@dataclass(frozen=True)
class Levels:
    """Levels in the source's vertical reference, metres."""

    ground: float
    eaves: float
    ridge: float
    main: float
    """Share of the main roof, up to whose eaves half of the area lies, with the points that are nearest to it."""
    roofs: tuple[Roof, ...]
    """The roofs that count."""


def levels(roof: Floats, ground: Floats, area_m2: float) -> Levels | None:
    """Return ground, eaves and ridge of one building.

    Parameters
    ----------
    roof : (N, 3) ndarray of float64
        Its first echoes of class 6: easting, northing and height, metres.
    ground : (M, 3) ndarray of float64
        Points of class 2 around it.
    area_m2 : float
        Its area, from which the spacing of the points follows.

    Returns
    -------
    Levels or None
        None where there is too little roof or ground.

    Notes
    -----
    Points beneath others are of walls and go. The rest is linked to roofs by steps between neighbours; what is in no
    roof of `LEAST_M2` then is linked again, as a steeper one. A point is at the edge of its roof where its neighbours
    leave a wide angle free. The eaves are the mean level of the roofs that count over the middle half of the points,
    lowest roofs first, each by the points to which it is the nearest. The ridge is the highest of them.
    """
    if len(roof) < LEAST_POINTS or len(ground) < LEAST_POINTS:
        return None
    distance = cKDTree(roof[:, :2]).query(ground[:, :2])[0]
    near = next((distance <= reach for reach in REACHES_M if (distance <= reach).sum() >= LEAST_POINTS), None)
    if near is None:
        return None
    spacing = float(np.sqrt(area_m2 / len(roof)))
    roof = _upper(roof, spacing)
    member = _linked(roof, LINK * spacing, STEEP)
    lost = (np.bincount(member) < LEAST_M2 / area_m2 * len(roof))[member]
    member[lost] = len(roof) + _linked(roof[lost], LINK * spacing, STEEPER)
    member = np.unique(member, return_inverse=True)[1]
    shares = np.bincount(member) / len(roof)
    least = min(WEIGHT_M2, max(LEAST_M2, WEIGHT * area_m2)) / area_m2
    found: list[Roof] = []
    for number in np.flatnonzero(shares >= min(least, shares.max())).tolist():
        own = roof[member == number]
        edge = own[_at_edge(own, AROUND * spacing)]
        edge = edge if len(edge) else own
        found.append(Roof(float(np.quantile(edge[:, 2], EAVES)), float(shares[number]), own))
    found.sort(key=lambda one: (one.eaves, one.share))
    # Points beside a step link no roofs, and are half of a small house: each counts for the nearest roof.
    ends = np.cumsum([len(one.points) for one in found])
    nearest = cKDTree(np.concatenate([one.points[:, :2] for one in found])).query(roof[:, :2])[1]
    weights = np.bincount(np.searchsorted(ends, nearest, side="right"), minlength=len(found))
    reached = np.cumsum(weights) / len(roof)
    main = int(np.argmax(reached >= 0.5))
    middle = np.diff(np.clip(reached, *MIDDLE), prepend=MIDDLE[0])
    eaves = float(np.average([one.eaves for one in found], weights=middle))
    ridge = max(float(np.quantile(one.points[:, 2], RIDGE)) for one in found)
    share = float(weights[main] / len(roof))
    return Levels(float(np.median(ground[near, 2])), eaves, ridge, share, tuple(found))


def _linked(roof: Floats, reach_m: float, steep: float) -> NDArray[np.int64]:
    """Return the number of the roof of each point: neighbours that differ by little are of one."""
    pairs = cKDTree(roof[:, :2]).query_pairs(reach_m, output_type="ndarray")
    apart = np.hypot(*(roof[pairs[:, 0], :2] - roof[pairs[:, 1], :2]).T)
    alike = np.abs(roof[pairs[:, 0], 2] - roof[pairs[:, 1], 2]) <= np.maximum(STEP_M, steep * apart)
    # A point beside a wall links no roofs: the wall's own points would be a ladder.
    beside, same = (np.bincount(ends.ravel(), minlength=len(roof)) for ends in (pairs, pairs[alike]))
    inner = same >= INNER * beside
    linked = pairs[alike & inner[pairs].all(axis=1)]
    graph = coo_matrix((np.ones(len(linked)), linked.T), shape=(len(roof), len(roof)))
    return np.asarray(connected_components(graph, directed=False)[1], dtype=np.int64)


def _upper(roof: Floats, spacing: float) -> Floats:
    """Leave out the points of walls: another point is above, and another one beneath or none beside."""
    pairs = cKDTree(roof[:, :2]).query_pairs(spacing, output_type="ndarray")
    pairs = np.concatenate([pairs, pairs[:, ::-1]])
    rise = roof[pairs[:, 1], 2] - roof[pairs[:, 0], 2]
    above, level, beneath = (np.bincount(pairs[chosen, 0], minlength=len(roof)) for chosen in (
        rise > STEP_M, np.abs(rise) <= STEP_M, rise < -STEP_M,
    ))  # fmt: skip
    return roof[~((above > 0) & ((beneath > 0) | (level < above)))]


def _at_edge(roof: Floats, reach_m: float) -> NDArray[np.bool_]:
    """Return which points have a wide free angle between their neighbours in plan."""
    pairs = cKDTree(roof[:, :2]).query_pairs(reach_m, output_type="ndarray")
    one, other = np.concatenate([pairs, pairs[:, ::-1]]).T
    east, north = (roof[other, :2] - roof[one, :2]).T
    angle = np.arctan2(north, east)
    order = np.lexsort((angle, one))
    one, angle = one[order], angle[order]
    free = np.full(len(roof), 2 * np.pi)
    if not one.size:
        return free > GAP
    starts = np.flatnonzero(np.diff(one, prepend=-1))
    following = np.append(angle[1:], 0.0)
    ends = np.append(starts[1:], one.size) - 1
    following[ends] = angle[starts] + 2 * np.pi
    free[one[starts]] = np.maximum.reduceat(following - angle, starts)
    return free > GAP
