"""Strings of the GEM Building Taxonomy, versions 3.3 and 4.0, of what is known about a building.

A string has the known attributes, such as ``HAPP:3+HHT:9.5/Y:1950/PLFR+BP1/RES``. An attribute that is not known is
left out, as these versions have no atom for it; a building about which nothing is known is ``UNK``.

The shape of a plan comes from its bays: what the rectangle around it has, and the plan lacks. One bay in a corner
makes an L, one in the middle of a side a U, two in neighbouring corners a T, and so on.
"""

import math
import re
from dataclasses import dataclass
from itertools import combinations

import numpy as np
import shapely
from numpy.typing import NDArray

UNKNOWN = "UNK"
"""What is not known."""

OCCUPANCIES = {
    "RES": ("residential", "housing", "house", "apartments", "dwelling"),
    "COM": ("commercial", "retail", "office", "public"),
    "IND": ("industrial", "industry"),
    "AGR": ("agriculture", "agricultural", "farm"),
    "GOV": ("government", "administration"),
    "EDU": ("education", "school", "university"),
    "HEA": ("health", "healthcare", "hospital"),
    "TRT": ("transport", "transportation"),
    "NONRES": ("non-residential", "nonresidential"),
    "OCO": ("other",),
}
"""The classes of occupancy, with words that mean the same."""

_OCCUPANCY = re.compile(r"(RES|COM|IND|AGR|GOV|EDU|HEA|TRT)(:[0-9]+[A-Z]?)?|NONRES|OCO|MIX\([A-Z]{3,6}(;[A-Z]{3,6})+\)")

_YEAR = re.compile(r"[0-9]{4}(-[0-9]{4})?|[<>][0-9]{4}")

_ATOMS = re.compile(r"[A-Z][A-Z0-9]*(\+[A-Z][A-Z0-9]*)*")

CONVEX = 0.95
"""Share of its convex hull from which a plan has no bays (ours)."""

FULL = 0.9
"""Share of the rectangle around it from which a plan without bays is a rectangle (ours)."""

SQUARE = 0.85
"""Ratio of the sides from which a rectangle is a square: sides "approximately equal in length" (ours)."""

ROUND = 0.85
"""4πA/P² of its hull from which a plan is curved: a square has 0.79, a circle 1 (ours)."""

TRIANGLE = 0.85
"""Share of its hull that the largest triangle of its corners has, from which a plan is a triangle (ours)."""

BAY = 0.08
"""Share of the rectangle from which a bay or a courtyard counts (ours)."""

NOTCH = 0.25
"""Share of a bay within the hull of the plan, below which it is a slanting wall (ours)."""

TOUCH_M = 0.25
"""Gap over which buildings adjoin each other, metres (ours)."""

SIDE = 1 / 3
"""Share of a side along which a building must adjoin another (ours)."""

BAYS = {
    ("corner",): "PLFL",
    ("side",): "PLFU",
    ("corner", "corner", "neighbours"): "PLFT",
    ("corner", "corner", "opposite"): "PLFS",
    ("side", "side", "same"): "PLFE",
    ("side", "side", "opposite"): "PLFH",
    ("corner", "corner", "corner", "corner"): "PLFX",
}
"""The shape for the places of the bays; any others are irregular, PLFI."""

Corners = NDArray[np.float64]


def plan_shape(geometry: shapely.Geometry) -> str:
    """Return the atom of the shape of a plan, from PLFSQ to PLFI.

    Parameters
    ----------
    geometry : Polygon or MultiPolygon
        An outline, metres.

    Examples
    --------
    >>> plan_shape(shapely.box(0, 0, 10, 20)), plan_shape(shapely.box(0, 0, 10, 20) - shapely.box(5, 5, 10, 20))
    ('PLFR', 'PLFL')
    """
    parts = sorted(shapely.get_parts(geometry), key=lambda part: part.area)
    largest = parts[-1]
    if largest.area < CONVEX * geometry.area:
        return "PLFI"
    filled = shapely.Polygon(largest.exterior)
    corners, (short, long) = _rectangle(filled)
    opening = "O" if filled.area - largest.area >= BAY * short * long else ""
    if filled.area >= CONVEX * shapely.convex_hull(filled).area:
        return _convex_shape(filled, short, long, opening)
    return _bay_shape(filled, corners, short, long)


def _rectangle(geometry: shapely.Geometry) -> tuple[Corners, tuple[float, float]]:
    """Return the corners (4, 2) of the rectangle around a plan along its walls, counter-clockwise, and its sides.

    The direction of the walls is that of the sum of L e^{4iφ} over walls of length L and direction φ. Walls at right
    angles have the same e^{4iφ}. The rectangle of the smallest area would lie across a plan like an X.
    """
    walls = [np.diff(shapely.get_coordinates(part.exterior), axis=0) for part in shapely.get_parts(geometry)]
    dx, dy = np.concatenate(walls).T
    length, direction = np.hypot(dx, dy), np.arctan2(dy, dx)
    angle = np.angle((length * np.exp(4j * direction)).sum()) / 4
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    along = shapely.get_coordinates(geometry) @ turn.T
    (west, south), (east, north) = along.min(axis=0), along.max(axis=0)
    corners = np.array([[west, south], [east, south], [east, north], [west, north]]) @ turn
    sides = sorted((float(east - west), float(north - south)))
    return corners, (sides[0], sides[1])


def _convex_shape(filled: shapely.Polygon, short: float, long: float, opening: str) -> str:
    """Return the shape of a plan without bays."""
    if filled.area >= FULL * short * long:
        return f"PLF{'SQ' if short >= SQUARE * long else 'R'}{opening}"
    hull = shapely.convex_hull(filled)
    if 4 * math.pi * hull.area >= ROUND * hull.length**2:
        return f"PLFC{opening}"
    corners = shapely.get_coordinates(shapely.simplify(hull, 0.03 * math.sqrt(hull.area)))[:-1]
    first, second, third = corners[np.array(list(combinations(range(len(corners)), 3))).T]
    largest = np.abs(np.linalg.det(np.stack([second - first, third - first], axis=1))).max() / 2
    if largest >= TRIANGLE * hull.area:
        return f"PLFD{opening}"
    return "PLFI"


def _bay_shape(filled: shapely.Polygon, corners: Corners, short: float, long: float) -> str:
    """Return the shape of a plan with bays; narrow ones are no bays."""
    narrow = 0.05 * short
    missing = shapely.difference(shapely.Polygon(corners), filled)
    opened = shapely.buffer(shapely.buffer(missing, -narrow, join_style="mitre"), narrow, join_style="mitre")
    hull = shapely.convex_hull(filled)
    large = [bay for bay in shapely.get_parts(opened) if bay.area >= BAY * short * long]
    # What a slanting wall leaves in a corner lies outside of the hull; of a bay between two walls, half lies inside.
    bays = [bay for bay in large if shapely.intersection(bay, hull).area >= NOTCH * bay.area]
    if not bays:
        return "PLFI" if filled.area < FULL * short * long else f"PLF{'SQ' if short >= SQUARE * long else 'R'}"
    sides = shapely.linestrings([[corners[number], corners[(number + 1) % 4]] for number in range(4)])
    at_corners = [np.flatnonzero(shapely.distance(bay, shapely.points(corners)) <= 2 * narrow) for bay in bays]
    at_sides = [np.flatnonzero(shapely.distance(bay, sides) <= 2 * narrow) for bay in bays]
    if any(len(own) > 1 for own in at_corners) or any(len(own) == 0 for own in at_sides):
        return "PLFI"
    places = ["corner" if len(own) else "side" for own in at_corners]
    if places in (["corner"] * 2, ["side"] * 2):
        which = at_corners if places[0] == "corner" else at_sides
        apart = (int(which[1][0]) - int(which[0][0])) % 4
        names = {0: "same", 2: "opposite"} if places[0] == "side" else {1: "neighbours", 3: "neighbours", 2: "opposite"}
        places.append(names.get(apart, ""))
    return BAYS.get(tuple(places), "PLFI")


def positions(geometries: NDArray[np.object_]) -> list[str]:
    """Return the position of each building in its block: BPD for detached, BP1, BP2, or BP3 for three sides or more.

    The walls are grouped by the side of the rectangle that they face. A side adjoins where another building is
    within 25 cm of a third of its length.

    Parameters
    ----------
    geometries : (N,) ndarray of object
        Outlines, metres.

    Examples
    --------
    >>> positions(np.array([shapely.box(0, 0, 9, 9), shapely.box(9, 0, 18, 9), shapely.box(30, 0, 39, 9)]))
    ['BP1', 'BP1', 'BPD']
    """
    if len(geometries) == 0:
        return []
    own, other = shapely.STRtree(geometries).query(geometries, predicate="dwithin", distance=TOUCH_M)
    near: dict[int, list[int]] = {}
    for one, another in zip(own.tolist(), other.tolist(), strict=True):
        if one != another:
            near.setdefault(one, []).append(another)
    found = ["BPD"] * len(geometries)
    for one, others in near.items():
        sides = _adjoining(geometries[one], shapely.union_all(geometries[others]))
        found[one] = f"BP{min(sides, 3)}" if sides else "BPD"
    return found


def _adjoining(geometry: shapely.Geometry, others: shapely.Geometry) -> int:
    """Return on how many of its four sides a building adjoins others."""
    corners, _ = _rectangle(geometry)
    along = np.roll(corners, -1, axis=0) - corners
    length = np.linalg.norm(along, axis=1)
    reach = shapely.buffer(others, TOUCH_M)
    shared = np.zeros(4)
    for polygon in shapely.get_parts(shapely.orient_polygons(geometry)):
        xy = shapely.get_coordinates(polygon.exterior)
        walls = shapely.linestrings(np.stack([xy[:-1], xy[1:]], axis=1))
        facing = ((xy[1:] - xy[:-1]) @ (along / length[:, None]).T).argmax(axis=1)
        np.add.at(shared, facing, shapely.length(shapely.intersection(walls, reach)))
    return int((shared >= SIDE * length).sum())


@dataclass(frozen=True, slots=True)
class Described:
    """What is known about a building, as atoms of the taxonomy; `UNKNOWN` for what is not.

    Parameters
    ----------
    material, llrs : str
        Material and type of the lateral load-resisting system, such as MUR and LWAL.
    height : str
        Storeys and height: HAPP and HHT.
    year : str
        Date of construction: Y.
    shape, position : str
        Shape of the plan and position within the block.
    occupancy : str
        Its class.
    """

    material: str = UNKNOWN
    llrs: str = UNKNOWN
    height: str = UNKNOWN
    year: str = UNKNOWN
    shape: str = UNKNOWN
    position: str = UNKNOWN
    occupancy: str = UNKNOWN

    @property
    def string(self) -> str:
        """The taxonomy string.

        Examples
        --------
        >>> Described(height=height_atoms(3, 9.46), shape="PLFR", position="BPD").string
        'HAPP:3+HHT:9.5/PLFR+BPD'
        >>> Described().string
        'UNK'
        """
        plan = "+".join(atom for atom in (self.shape, self.position) if atom != UNKNOWN) or UNKNOWN
        attributes = (self.material, self.llrs, self.height, self.year, plan, self.occupancy)
        return "/".join(own for own in attributes if own != UNKNOWN) or UNKNOWN


def height_atoms(storeys: int | None, height_m: float | None) -> str:
    """Return HAPP with the number of storeys, as an estimate, and HHT with the height in metres, from 1 m on."""
    atoms = [] if not storeys else [f"HAPP:{storeys}"]
    if height_m is not None and height_m >= 1:
        atoms.append(f"HHT:{height_m:.1f}")
    return "+".join(atoms) or UNKNOWN


def occupancy_atom(value: str) -> str:
    """Return the class of occupancy that a value names, or `UNKNOWN`.

    Examples
    --------
    >>> occupancy_atom("RES:2"), occupancy_atom("School"), occupancy_atom("castle")
    ('RES:2', 'EDU', 'UNK')
    """
    text = value.strip()
    if _OCCUPANCY.fullmatch(text.upper()):
        return text.upper()
    return next((code for code, words in OCCUPANCIES.items() if text.lower() in words), UNKNOWN)


def year_atom(value: str) -> str:
    """Return the date of construction: a year, a date, a range such as 1950-1960, or a limit such as <1950.

    Examples
    --------
    >>> year_atom("1950"), year_atom("1950-06-01"), year_atom("1950-1960"), year_atom("old")
    ('Y:1950', 'Y:1950', 'Y:1950-1960', 'UNK')
    """
    text = value.strip().removesuffix(".0")
    if re.match(r"[0-9]{4}-[0-9]{2}(-|$)", text):
        text = text[:4]
    return f"Y:{text}" if _YEAR.fullmatch(text) else UNKNOWN


def other_atoms(value: str) -> str:
    """Return atoms of another attribute as they are given, or `UNKNOWN` where the value has not their form."""
    text = value.strip().upper()
    return text if _ATOMS.fullmatch(text) else UNKNOWN
