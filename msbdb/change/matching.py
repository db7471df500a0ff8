"""Links between the footprints of two surveys that are one building, and the pieces built onto each."""

from dataclasses import dataclass

import geopandas as gpd
import numpy as np
import shapely
from numpy.typing import NDArray

from msbdb.change.differences import Epochs, Pieces, touching
from msbdb.grid import GridSpec
from msbdb.labels import Labels, shared_cells, sizes
from msbdb.params import ChangeParams


@dataclass(eq=False)
class Links:
    """The buildings of both sides, numbered by row + 1, and what links them.

    - ``cells`` and ``seen``: cells of each building of the inventory, all and surveyed;
    - ``shared``: area that each pair shares;
    - ``own``: the survey's footprints of each building, the one with the largest share first;
    - ``loss_by``: the survey's footprints that each piece of loss touches;
    - ``gain_after``: the survey's footprints in which each piece of gain lies;
    - ``gains``: the pieces of gain that were built onto each building.
    """

    before: gpd.GeoDataFrame
    after: gpd.GeoDataFrame
    shifted: NDArray[np.object_]
    epochs: Epochs
    pieces: Pieces
    params: ChangeParams

    def __post_init__(self) -> None:
        """Count cells, link footprints, and find what each piece touches."""
        spec, reach = self.spec, self.params.thickness_m + self.spec.cell_m
        self.cells = sizes(self.epochs.before, len(self.before))
        inside = np.where(self.epochs.surveyed, self.epochs.before, 0)
        self.seen = sizes(inside, len(self.before))
        self.shared = _shared(self.epochs, spec.cell_area_m2)
        self.own = self._linked()
        gain_by = touching(self.pieces.gain, self.epochs.before, reach, spec.cell_m)
        self.loss_by = touching(self.pieces.loss, self.epochs.after, reach, spec.cell_m)
        self.gain_after = _within(self.pieces.gain, self.epochs.after)
        self.gains = self._gains_of(gain_by)

    @property
    def spec(self) -> GridSpec:
        """The survey's lattice."""
        return self.epochs.rise.spec

    def is_surveyed(self, i: int) -> bool:
        """Return whether most of a building's whole footprint lies in the surveyed area."""
        whole = float(shapely.area(self.shifted[i - 1]))
        return bool(self.seen[i - 1] * self.spec.cell_area_m2 >= self.params.surveyed_share * whole > 0)

    def _linked(self) -> dict[int, list[int]]:
        """Return the survey's footprints of each building, the one with the largest share first."""
        area_b, area_a = self.before.geometry.area.to_numpy(), self.after.geometry.area.to_numpy()
        links: dict[int, list[int]] = {}
        for (i, a), overlap in sorted(self.shared.items(), key=lambda item: (-item[1], item[0])):
            if overlap >= self.params.link_share * min(area_b[i - 1], area_a[a - 1]):
                links.setdefault(i, []).append(a)
        return links

    def _gains_of(self, gain_by: dict[int, set[int]]) -> dict[int, list[int]]:
        """Return the pieces built onto each building: those that it touches, in a footprint that is its own as well."""
        found: dict[int, list[int]] = {}
        for piece, buildings in gain_by.items():
            own = self.gain_after[piece]
            for i in sorted(buildings):
                if own & set(self.own.get(i, ())):
                    found.setdefault(i, []).append(piece)
        return found

    def merging(self) -> dict[int, tuple[int, ...]]:
        """Return, for each building that a piece joined with others, all of them."""
        joined: dict[int, set[int]] = {}
        by_piece: dict[int, list[int]] = {}
        for i, pieces in self.gains.items():
            for piece in pieces:
                by_piece.setdefault(piece, []).append(i)
        for members in by_piece.values():
            if len(members) < 2:
                continue
            group: set[int] = set(members).union(*(joined.get(i, {i}) for i in members))
            for i in group:
                joined[i] = group
        return {i: tuple(sorted(group)) for i, group in joined.items()}


def _shared(epochs: Epochs, cell_area_m2: float) -> dict[tuple[int, int], float]:
    """Return the area that each pair of footprints shares."""
    shared = (part.tolist() for part in shared_cells(epochs.before, epochs.after))
    return {(i, a): cells * cell_area_m2 for i, a, cells in zip(*shared, strict=True)}


def _within(piece: Labels, other: Labels) -> dict[int, set[int]]:
    """Return the other labels inside each piece."""
    found: dict[int, set[int]] = {number: set() for number in range(1, int(piece.max(initial=0)) + 1)}
    numbers, labels, _ = shared_cells(piece, other)
    for number, label in zip(numbers.tolist(), labels.tolist(), strict=True):
        found[number].add(label)
    return found
