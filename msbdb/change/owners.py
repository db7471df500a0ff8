"""Whose ground it is: the new outlines of a comparison are cut, so that no ground has two owners."""

from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray

from msbdb.change.decided import Decided, Version

COMMON_M2 = 1.0
"""Less ground in two outlines is none: fitted walls of two surveys differ by centimetres over some metres."""

KNOWN, SURVEYED, MADE = range(3)
"""Where an outline is from, in the order in which they own their ground: the inventory, the survey, or made here."""


def part_ground(decided: Decided, rows: NDArray[np.int64], shapes: NDArray[np.object_], least_m: float) -> None:
    """Take from each new outline the ground of those before it: of the inventory, of the survey, and made earlier.

    Parameters
    ----------
    decided : Decided
        What was decided in a window. New states that are cut get other outlines, and their rows other areas.
    rows : (N,) ndarray of int64
        Rows of the window's buildings in the whole frame of the inventory.
    shapes : (N,) ndarray of geometries
        Their outlines in the survey's place.
    least_m : float
        Radius of a disc that fits into what is left of an outline; thinner pieces go.

    Notes
    -----
    An outline that has no other ground keeps it, and those of the survey are cut: the survey draws the ground with
    another building, but it was decided to be this one's. Known buildings are never cut.
    """
    place = {row: n for n, row in enumerate(rows.tolist())}
    ended = {row["before"] for _, row in decided.rows if row["kind"] in ("demolished", "merged")}
    stays = sorted(set(place) - ended - {version[1] for version in decided.versions})
    known = [shapes[place[row]] for row in stays]
    owners = _Owners(
        [*known, *(version[4] for version in decided.versions)],
        [KNOWN] * len(known) + [_origin(version, place, shapes) for version in decided.versions],
        least_m,
    )
    for n, shape in owners.parted().items():
        decided.replace_outline(n - len(known), shape)


def _origin(version: Version, place: dict[int, int], shapes: NDArray[np.object_]) -> int:
    """Return where the outline of a new state is from; one that rose or sank may have the inventory's."""
    _, before, _, adopted, shape = version
    if before >= 0 and shape is shapes[place[before]]:
        return KNOWN
    return SURVEYED if adopted else MADE


@dataclass(frozen=True, slots=True)
class _Owners:
    """Outlines, and where each is from."""

    shapes: list[shapely.Geometry]
    origins: list[int]
    least_m: float

    def parted(self) -> dict[int, shapely.Geometry]:
        """Return the outlines that were cut, by their number."""
        tree, cut = shapely.STRtree(self.shapes), {}
        order = [(origin, n) for n, origin in enumerate(self.origins)]
        for _, n in sorted(place for place in order if place[0] != KNOWN):
            before = [m for m in tree.query(self.shapes[n]).tolist() if order[m] < order[n]]
            shared = [m for m in before if self._common_m2(n, m) >= COMMON_M2]
            if not shared:
                continue
            left = self._without(n, shared)
            if left is not None:
                cut[n] = self.shapes[n] = left
                continue
            for m in shared:
                left = None if self.origins[m] == KNOWN else self._without(m, [n])
                if left is not None:
                    cut[m] = self.shapes[m] = left
        return cut

    def _common_m2(self, n: int, m: int) -> float:
        """Return the area that two outlines share."""
        return float(shapely.area(shapely.intersection(self.shapes[n], self.shapes[m])))

    def _without(self, n: int, others: list[int]) -> shapely.Geometry | None:
        """Return an outline without the ground of others; None where nothing is left."""
        left = shapely.difference(self.shapes[n], shapely.union_all([self.shapes[m] for m in others]))
        pieces = [piece for piece in shapely.get_parts(left) if not piece.buffer(-self.least_m).is_empty]
        return shapely.union_all(pieces) if pieces else None
