"""Pieces of roofs joined again, the weakest border first, until each border that is left has a reason."""

import heapq
import math

import numpy as np
from numpy.typing import NDArray

from msbdb.fuse.houses.roofdirections import CLEAR
from msbdb.fuse.houses.roofpieces import KINDS, RoofPieces, Touches, spread
from msbdb.params import TouchingParams

PARCEL, MATERIAL = "parcel", "material"
*ROOFS, DIRECTION = KINDS
REASONS = (PARCEL, *KINDS, MATERIAL)
"""Why touching houses are divided."""

OTHER_PARCEL = 0.4
"""A sliver goes to a piece of its own parcel, unless evidence along this share of the border more is against it."""

BENT = 0.4
"""A valley runs along one line where it is this much wider than long; the two valleys beside a wing are 0.5."""

DEVIATIONS = 0.5
"""Standard deviations above the mean of a border's heights at which its upper end lies."""

LATE = 3.0
"""Pieces of one parcel are joined after all slivers have found their roof."""

LOWER_FIRST = 1e-3
"""Of two borders that are alike otherwise, the one with the lower step goes first: this much a metre."""

PAIRS, SHOWN, FIRST_KIND, DIFFER, LOWEST, SQUARED, MOMENTS = 0, 1, 2, 6, 7, 8, 9
"""The columns of ``Touches.counts``."""

Counts = list[float]
"""A row of ``Touches.counts``: single values are read from lists quicker than from arrays."""


class Joining:
    """The pieces as a graph, whose nodes are joined two at a time.

    Parameters
    ----------
    pieces : RoofPieces
        The nodes.
    touches : Touches
        The edges.
    params : TouchingParams
        What a house and a reason are.
    cell_m : float
        Side of a cell, metres.
    """

    def __init__(self, pieces: RoofPieces, touches: Touches, params: TouchingParams, cell_m: float) -> None:
        self.params, self.cell_m = params, cell_m
        self.cells, self.heights, self.tops = (
            values.tolist() for values in (pieces.cells, pieces.heights, pieces.tops)
        )
        self.moments = pieces.moments.tolist()
        self.directions = pieces.directions.tolist()
        self.owners = pieces.owners.tolist()
        self.small = [self._is_small(node) for node in range(len(self.cells))]
        self.beside: list[dict[int, Counts]] = [{} for _ in self.cells]
        rows = zip(touches.one.tolist(), touches.other.tolist(), touches.counts.tolist(), strict=True)
        for one, other, counts in rows:
            self.beside[one][other] = self.beside[other][one] = counts
        self.around = [
            rim + sum(counts[PAIRS] for counts in beside.values())
            for rim, beside in zip(pieces.rims.tolist(), self.beside, strict=True)
        ]
        self.version = [0] * len(self.cells)
        self.into = np.arange(len(self.cells))
        self.waiting: list[tuple[float, int, int, int, int]] = []
        # Ascending, thus a heap: the nodes of which some pair may have changed since they were looked at.
        self.changed = list(range(len(self.cells)))
        self.is_changed = [True] * len(self.cells)

    def run(self) -> NDArray[np.int64]:
        """Join until nothing is left to join; return the row number of the piece into which each piece went."""
        for one, beside in enumerate(self.beside):
            for other in beside:
                if one < other:
                    self._wait(one, other)
        self._join_waiting()
        while (pair := self._two_on_one()) is not None:
            self._join(*pair)
            self._join_waiting()
        while (self.into != self.into[self.into]).any():
            self.into = self.into[self.into]
        return self.into

    def borders(self) -> dict[tuple[int, int], int]:
        """Return the index in `REASONS` of the border of each two nodes that are left, the smaller one first."""
        found = {}
        for one, beside in enumerate(self.beside):
            for other in beside:
                reason = self._reason(one, other) if one < other else None
                if reason is not None:
                    found[one, other] = REASONS.index(reason)
        return found

    def _wait(self, one: int, other: int) -> None:
        """Let two nodes wait until their turn to be joined, unless there is a reason for their border."""
        counts = self.beside[one][other]
        # Evidence is as wide as its profiles; the difference of neighbouring cells shows the place itself.
        differ_m = counts[DIFFER] / counts[PAIRS]
        sharp = min(differ_m / self.params.step_m, 1)
        # Of clear steps the lower goes first: a podium is whole before the tower on it is joined.
        cost = (counts[SHOWN] / counts[PAIRS] + sharp) / 2 + LOWER_FIRST * differ_m
        owners = {self.owners[one], self.owners[other]} - {0}
        sliver = self.small[one] or self.small[other]
        reason = self._reason(one, other)
        if reason is not None and not sliver:
            if len(owners) != 1 or 0 in (self.owners[one], self.owners[other]):
                return
            cost = LATE
        if reason is not None:
            cost += 1
        if len(owners) == 2:
            cost += OTHER_PARCEL
        # Of equal borders the longer one goes first.
        cost -= 1e-6 * counts[PAIRS]
        one, other = min(one, other), max(one, other)
        heapq.heappush(self.waiting, (cost, one, other, self.version[one], self.version[other]))

    def _join_waiting(self) -> None:
        """Join the nodes that wait, the weakest border first."""
        while self.waiting:
            _, one, other, *versions = heapq.heappop(self.waiting)
            if [self.version[one], self.version[other]] == versions:
                self._join(one, other)

    def _two_on_one(self) -> tuple[int, int] | None:
        """Return two nodes beside each other that a third one encloses together, as halves of a tower on a podium.

        Of several pairs that of the first nodes. A join changes the pairs of its node and of those beside it alone.
        """
        while self.changed:
            one = heapq.heappop(self.changed)
            self.is_changed[one] = False
            beside = self.beside[one]
            for other in sorted(node for node in beside if node > one):
                outline = self.around[one] + self.around[other] - 2 * beside[other][PAIRS]
                for third in sorted(beside.keys() & self.beside[other].keys()):
                    shared = beside[third][PAIRS] + self.beside[other][third][PAIRS]
                    owners = {self.owners[node] for node in (one, other, third)} - {0}
                    if shared >= self.params.enclosed_share * outline and len(owners) <= 1:
                        return one, other
        return None

    def _join(self, one: int, other: int) -> None:
        """Join two nodes: the larger one goes on, of equal ones the first."""
        if self.cells[other] > self.cells[one]:
            one, other = other, one
        self.into[other] = one
        self.version[one] += 1
        self.version[other] = -1
        if not self.small[other]:
            self.tops[one] = max(self.tops[one], self.tops[other])
        self.around[one] += self.around[other] - 2 * self.beside[one][other][PAIRS]
        self.cells[one] += self.cells[other]
        self.heights[one] += self.heights[other]
        self.moments[one] = _summed(self.moments[one], self.moments[other])
        self.directions[one] = _summed(self.directions[one], self.directions[other])
        if not self.small[other]:
            self.owners[one] = self.owners[one] or self.owners[other]
        self.small[one] = self._is_small(one)
        for node, counts in self.beside[other].items():
            del self.beside[node][other]
            if node != one:
                both = self.beside[one].get(node)
                self.beside[one][node] = self.beside[node][one] = counts if both is None else _summed(both, counts)
        self.beside[other] = {}
        self._look_again(one)
        for node in self.beside[one]:
            self._look_again(node)
            self._wait(one, node)

    def _look_again(self, node: int) -> None:
        """Let the pairs of a node be looked at again."""
        if not self.is_changed[node]:
            self.is_changed[node] = True
            heapq.heappush(self.changed, node)

    def _reason(self, one: int, other: int) -> str | None:
        """Return why two nodes are two houses; None for no reason."""
        owners = self.owners[one], self.owners[other]
        if all(owners) and owners[0] != owners[1]:
            return PARCEL
        counts = self.beside[one][other]
        if counts[PAIRS] >= self.params.enclosed_share * min(self.around[one], self.around[other]):
            return None
        return self._reason_of_roofs(one, other, counts) or self._reason_of_directions(one, other, counts)

    def _reason_of_roofs(self, one: int, other: int, counts: Counts) -> str | None:
        """Return which step, valley or wall divides two nodes; None for none."""
        if counts[SHOWN] < self.params.share * counts[PAIRS]:
            return None
        kinds = counts[FIRST_KIND : FIRST_KIND + len(ROOFS)]
        for shown, kind in sorted(zip(kinds, ROOFS, strict=True), key=lambda each: -each[0]):
            if 2 * shown >= self.params.share * counts[PAIRS] and self._holds(kind, one, other, counts):
                return kind
        return None

    def _holds(self, kind: str, one: int, other: int, counts: Counts) -> bool:
        """Return whether the roofs beside a step or a valley fit it; a wall needs no more."""
        if kind == "step":
            levels = self.heights[one] / self.cells[one], self.heights[other] / self.cells[other]
            return bool(abs(levels[0] - levels[1]) >= self.params.level_m)
        if kind == "valley":
            mean_m, square_m2 = counts[LOWEST] / counts[PAIRS], counts[SQUARED] / counts[PAIRS]
            # The upper end of the border: a valley that climbs to a ridge has a high one.
            upper_m = mean_m + DEVIATIONS * math.sqrt(max(square_m2 - mean_m**2, 0))
            rise = min(self.tops[one], self.tops[other]) - upper_m
            return rise >= self.params.rise_m and self._is_straight(counts)
        return True

    def _reason_of_directions(self, one: int, other: int, counts: Counts) -> str | None:
        """Return DIRECTION where two nodes bend along their whole border, and each has one direction."""
        if counts[FIRST_KIND + len(ROOFS)] < self.params.share * counts[PAIRS]:
            return None
        angles = []
        for cosine, sine, weight in (self.directions[one], self.directions[other]):
            if math.hypot(cosine, sine) < CLEAR * weight:
                return None
            angles.append(math.degrees(math.atan2(sine, cosine)) / 4)
        differ = abs((angles[0] - angles[1] + 45) % 90 - 45)
        return DIRECTION if differ >= self.params.turn_deg else None

    def _is_straight(self, counts: Counts) -> bool:
        """Return whether a border runs along one line: the two valleys beside a wing do not."""
        width, length = spread(counts[PAIRS], counts[MOMENTS:])
        return width <= BENT * length

    def _is_small(self, node: int) -> bool:
        """Return whether a node is too small, or too narrow, for a house."""
        cells, params = self.cells[node], self.params
        of_parcel = self.owners[node] > 0
        area_m2, width_m = (params.parcel_m2, params.parcel_width_m) if of_parcel else (params.house_m2, params.width_m)
        if cells * self.cell_m**2 < area_m2:
            return True
        return spread(cells, self.moments[node])[0] * self.cell_m < width_m


def _summed(one: Counts, other: Counts) -> Counts:
    """Return the sums of two rows."""
    return [a + b for a, b in zip(one, other, strict=True)]
