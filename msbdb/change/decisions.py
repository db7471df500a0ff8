"""Decisions of a comparison: the kind of change of each building, and its new state."""

from dataclasses import dataclass, field, replace

import geopandas as gpd
import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from msbdb.change.decided import Decided, Rank
from msbdb.change.differences import Epochs, Links, Offset, Pieces
from msbdb.change.owners import part_ground
from msbdb.change.thickness import core, thick, without_slivers
from msbdb.grid import GridSpec
from msbdb.labels import Box, Labels, boxes, sizes
from msbdb.outline.polygons import polygonise
from msbdb.params import ChangeParams
from msbdb.tables import FIRST_SURVEY

KINDS = ("unchanged", "modified", "new", "demolished", "merged", "split")
"""The kinds of change of a surveyed building; a building outside of the survey has no row."""

NO_FOOTPRINT = "not distinguished from its surroundings this time, but its heights do not show that it is gone"

STOOD_BEFORE = "existed before, and is distinguished from its surroundings for the first time"

LEVEL_CHANGE = "not distinguished from its surroundings this time, but its level changed as a whole"

PART_GONE = "not distinguished from its surroundings this time, but a part of it is gone"

BEYOND_BORDER = "it reaches beyond the border of the earlier surveys, and is known as a whole for the first time"


@dataclass(eq=False)
class Decisions:
    """The decisions, building by building; 0 is no building, otherwise row number + 1.

    ``rows_before`` and ``rows_after`` are the rows of the window's buildings in the whole frames, and ``first`` has row
    and column of the window's first cell.
    """

    links: Links
    offset: Offset
    rows_before: NDArray[np.int64]
    rows_after: NDArray[np.int64]
    first: tuple[int, int]
    decided: Decided = field(default_factory=Decided)
    rank: Rank = (0, 0, 0)

    def __post_init__(self) -> None:
        """Find where each building and piece lies."""
        self.rise = np.asarray(self.epochs.rise.values)
        self.box_before, self.box_after, self.box_gain = map(
            boxes, (self.epochs.before, self.epochs.after, self.pieces.gain)
        )
        self.beyond = self._divide_beyond()
        self.box_gain = boxes(self.pieces.gain)
        self.known = {a for own in self.links.own.values() for a in own}
        self.arriving = [a for a in self.box_after if a not in self.known and self._arrives(a)]
        for pieces in self.links.gains.values():
            pieces[:] = [piece for piece in pieces if self._is_extension(piece)]

    @property
    def before(self) -> gpd.GeoDataFrame:
        """The inventory's buildings."""
        return self.links.before

    @property
    def after(self) -> gpd.GeoDataFrame:
        """The survey's buildings."""
        return self.links.after

    @property
    def epochs(self) -> Epochs:
        """Both sides on the survey's lattice."""
        return self.links.epochs

    @property
    def pieces(self) -> Pieces:
        """The pieces of change."""
        return self.links.pieces

    @property
    def params(self) -> ChangeParams:
        """The thresholds of change."""
        return self.links.params

    @property
    def spec(self) -> GridSpec:
        """The window's lattice."""
        return self.links.spec

    def decide(self) -> Decided:
        """Decide on every building that was surveyed, then on what is new."""
        merged = self.links.merging()
        done: set[int] = set()
        for i in range(1, len(self.before) + 1):
            if i in done or not self.links.is_surveyed(i):
                continue
            self.rank = (0, self._row(i, self.rows_before), 0)
            group = merged.get(i, (i,))
            if len(group) > 1:
                self._merge(group)
                done.update(group)
            else:
                self._alone(i)
        self._newcomers()
        part_ground(self.decided, self.rows_before, self.links.shifted, self.params.thickness_m / 2)
        return self.decided

    def _row(self, number: int, rows: NDArray[np.int64]) -> int:
        """Return the row of a building in the whole frame; -1 for none."""
        return int(rows[number - 1]) if number else -1

    def _merge(self, group: tuple[int, ...]) -> None:
        """Join buildings into one, which keeps the identity of the largest."""
        keeper = max(group, key=lambda i: (self.links.cells[i - 1], -i))
        a = self.links.own[keeper][0]
        shape, adopted = self._outline(group, a)
        version = self._enter(keeper, a, shape, adopted=adopted)
        for i in group:
            self._note("merged", i, a, version=version, outline=True, height=self._lifted(i) > 0)

    def _alone(self, i: int) -> None:
        """Decide on one building that was joined with no other."""
        own = self.links.own.get(i, [])
        box = self.box_before[i]
        stood = self.epochs.before[box] == i
        lost = self._own(self.pieces.loss, i)
        if i in self.links.ended:
            unseen = self._unseen((i,))
            if unseen is None:
                self._note("demolished", i, 0)
            else:
                self._note("modified", i, 0, version=self._enter(i, 0, unseen, adopted=False), outline=True)
            return
        parted = [a for a in own if any(a in self.links.loss_by[piece] for piece in lost)]
        if len(parted) > 1:
            self._split(
                i, [a for a in own if a in parted or self._sharing(a) == {i} or self._part_cells(i, a)[0].any()]
            )
            return
        lifted = self._lifted(i)
        gains = self.links.gains.get(i, [])
        outline = bool(lost) or not self.beyond.issuperset(gains)
        height = lifted > 0 or (bool(own) and self._rose_by_attributes(i, own[0]))
        if not own and (height or lost):
            shape = self._traced((i,), [])[0] if lost else self.links.shifted[i - 1]
            version, note = self._enter(i, 0, shape, adopted=False), PART_GONE if lost else LEVEL_CHANGE
            self._note("modified", i, 0, version=version, outline=bool(lost), height=height, note=note)
        elif not own:
            self._note("unchanged", i, 0, note=NO_FOOTPRINT)
        elif outline or height:
            common = int(np.count_nonzero(stood & (np.asarray(self.epochs.heights.values)[box] >= self.params.rise_m)))
            # Where its ground is as it was, a building keeps its outline, however the survey draws it.
            is_kept = not lost and not gains
            shape, adopted = (self.links.shifted[i - 1], False) if is_kept else self._outline((i,), own[0])
            in_part = 0 < lifted < self.params.gone_share * common
            version = self._enter(i, own[0], shape, adopted=adopted)
            self._note("modified", i, own[0], version=version, outline=outline, height=height, parts=bool(in_part))
        elif gains:
            shape, adopted = self._outline((i,), own[0])
            version = self._enter(i, own[0], shape, adopted=adopted)
            self._note("unchanged", i, own[0], version=version, note=BEYOND_BORDER)
        else:
            self._note("unchanged", i, own[0])

    def _lifted(self, i: int) -> int:
        """Count the cells of a building that rose or sank: in thick pieces, or of a slender building as a whole.

        A crown that grew over its roof is no part of it: a piece counts where later footprints cover a share of it.
        Where they do not, the building counts as a whole if its cells changed alike, as those of a crown do not.
        """
        box, least = self.box_before[i], self.params.link_share
        stood, under = self.epochs.before[box] == i, self.epochs.after[box] > 0
        held = sizes(self.pieces.lift[box][stood & under], int(self.pieces.lift.max(initial=0)))
        lifted = sum(n for piece, n in self._own(self.pieces.lift, i).items() if held[piece - 1] >= least * n)
        if lifted:
            return lifted
        sides = (stood & self.pieces.rose[box], stood & self.pieces.sank[box])
        counts = [int(np.count_nonzero(side)) for side in sides]
        whole, count = sides[int(np.argmax(counts))], max(counts)
        # Cells at walls may change the other way, and say nothing of the roof.
        roof = int(self.links.seen[i - 1]) - min(counts)
        if not count or count < self.params.gone_share * roof or count * self.spec.cell_area_m2 < self.params.least_m2:
            return 0
        low, high = np.quantile(self.rise[box][whole], [0.25, 0.75])
        is_alike = high - low <= self.params.rise_m / 2
        return count if is_alike or np.count_nonzero(whole & under) >= least * count else 0

    def _divide_beyond(self) -> set[int]:
        """Give each building what of it lies beyond the earlier surveys, and return these pieces of gain.

        What no earlier survey has measured may have stood before, so it joins no buildings. Of several that were
        measured each gets the nearest cells, without parts that no disc fits into.
        """
        links, gain = self.links, self.pieces.gain.copy()
        linked: dict[int, list[int]] = {}
        for i, pieces in sorted(links.gains.items()):
            for piece in pieces:
                linked.setdefault(piece, []).append(i)
        beyond: set[int] = set()
        count = int(gain.max(initial=0))
        for piece, group in linked.items():
            if not self._is_beyond(piece, group):
                continue
            for i in group:
                links.gains[i].remove(piece)
            del links.gain_after[piece]
            around = _around([self.box_gain[piece], *(self.box_before[i] for i in group)])
            cells, houses = gain[around] == piece, self.epochs.before[around]
            nearest = distance_transform_edt(~np.isin(houses, group), return_distances=False, return_indices=True)
            gain[around][cells] = 0
            for i in group:
                own = cells & (houses[tuple(nearest)] == i)
                if core(own, self.spec, self.params).any():
                    count += 1
                    gain[around][own] = count
                    links.gains[i].append(count)
                    beyond.add(count)
        links.pieces = replace(self.pieces, gain=gain)
        return beyond

    def _is_beyond(self, piece: int, group: list[int]) -> bool:
        """Return whether a piece of gain lies beyond the earlier surveys, though they have measured its buildings."""
        known, least = self.epochs.earlier.valid, self.params.surveyed_share
        box = self.box_gain[piece]
        if known[box][self.pieces.gain[box] == piece].mean() >= least:
            return False
        places = ((self.box_before[i], i) for i in group)
        return all(known[place][self.epochs.before[place] == i].mean() >= least for place, i in places)

    def _own(self, pieces: Labels, i: int) -> dict[int, int]:
        """Count the cells of each piece inside a building, where they are thick and many in it alone.

        A change of its neighbour reaches a strip along the wall that both share.
        """
        box = self.box_before[i]
        inside = np.where(self.epochs.before[box] == i, pieces[box], 0)
        if not inside.any():
            return {}
        numbers, cells = np.unique(inside[thick(inside > 0, self.spec, self.params) > 0], return_counts=True)
        return {int(n): int(count) for n, count in zip(numbers, cells, strict=True)}

    def _split(self, i: int, own: list[int]) -> None:
        """Split a building into its footprints of the survey; the one with the largest share keeps its identity."""
        height = self._lifted(i) > 0
        for n, a in enumerate(own):
            shape, adopted = self._part(i, a)
            shape, adopted = self._with_unseen((i,) if n == 0 else (), shape, adopted=adopted)
            version = self._enter(i if n == 0 else 0, a, shape, adopted=adopted)
            self._note("split", i, a, version=version, outline=True, height=height)

    def _part(self, i: int, a: int) -> tuple[shapely.Geometry, bool]:
        """Return the outline of a part of a split building, and whether it is the survey's, which the old one holds.

        Where the survey's footprint covers other buildings, too, the part has what of it stood in this one, or was
        built onto it.
        """
        cells, box = self._part_cells(i, a)
        if self._sharing(a) == {i} or not cells.any():
            return self.after.geometry.iloc[a - 1], True
        cells = without_slivers(cells, self.spec, self.params)
        return polygonise(cells.astype(np.int32), self.spec.crop(*box), 1)[0], False

    def _part_cells(self, i: int, a: int) -> tuple[NDArray[np.bool_], Box]:
        """Return the cells of a footprint that stood in a building or were built onto it, and their box."""
        gains = [piece for piece in self.links.gains.get(i, ()) if a in self.links.gain_after[piece]]
        box = _around([self.box_before[i], *(self.box_gain[piece] for piece in gains)])
        stood = (self.epochs.before[box] == i) & (self.pieces.loss[box] == 0)
        return (stood | np.isin(self.pieces.gain[box], gains or [-1])) & (self.epochs.after[box] == a), box

    def _sharing(self, a: int) -> set[int]:
        """Return the buildings of the inventory that a footprint of the survey is linked to."""
        return {i for i, own in self.links.own.items() if a in own}

    def _rose_by_attributes(self, i: int, a: int) -> bool:
        """Return whether a building rose by its attributes, where the earlier lattice has no heights."""
        box = self.box_before[i]
        both = (self.epochs.before[box] == i) & (self.epochs.after[box] == a)
        if not both.any() or self.epochs.rise.valid[box][both].mean() >= self.params.surveyed_share:
            return False
        rise = self.after["h_p90"].iloc[a - 1] - self.before["h_p90"].iloc[i - 1] - self.offset.dz_m
        return bool(abs(rise) >= self.params.rise_m)

    def _newcomers(self) -> None:
        """Decide on footprints that share no known building, and on pieces that were built apart from those."""
        stood: set[int] = set()
        for a in self.arriving:
            self.rank = (1, self._row(a, self.rows_after), 0)
            if self._arrive(a):
                stood.add(a)
        taken = {piece for pieces in self.links.gains.values() for piece in pieces}
        for piece, own in self.links.gain_after.items():
            if piece not in taken and (own <= self.known or (len(own) == 1 and own <= stood)):
                self._detached(piece, min(own))

    def _arrives(self, a: int) -> bool:
        """Return whether a footprint that the inventory does not know is a building of its own.

        It is none where it was not built since, and half of it or more lies on known buildings: the inventory divides
        this ground in another way, and its houses still stand.
        """
        box, place = self.box_after[a], self._place(a)
        if not place.any():
            return False
        known = self.epochs.before[box][place]
        standing = (known > 0) & ~np.isin(known, list(self.links.ended))
        on_known = 2 * np.count_nonzero(standing) >= np.count_nonzero(place)
        return not on_known or not self._is_measured(a) or self._is_built(a)

    def _is_extension(self, piece: int) -> bool:
        """Return whether a piece of gain is large enough without the houses that arrive by themselves."""
        box = self.box_gain[piece]
        cells = (self.pieces.gain[box] == piece) & ~np.isin(self.epochs.after[box], self.arriving)
        is_large = np.count_nonzero(cells) * self.spec.cell_area_m2 >= self.params.least_m2
        return bool(is_large and core(cells, self.spec, self.params).any())

    def _place(self, a: int) -> NDArray[np.bool_]:
        """Return the surveyed cells of a footprint of the survey, in its box."""
        box = self.box_after[a]
        return np.asarray((self.epochs.after[box] == a) & self.epochs.surveyed[box])

    def _is_measured(self, a: int) -> bool:
        """Return whether earlier surveys have measured the ground of a footprint."""
        share = self.epochs.earlier.valid[self.box_after[a]][self._place(a)].mean()
        return bool(share >= self.params.surveyed_share)

    def _is_built(self, a: int) -> bool:
        """Return whether most of a footprint was built since."""
        share = np.mean(self.pieces.gain[self.box_after[a]][self._place(a)] > 0)
        return bool(share >= self.params.surveyed_share)

    def _arrive(self, a: int) -> bool:
        """Enter a footprint that the inventory does not know, and return whether it stood before."""
        shape, is_measured = self.after.geometry.iloc[a - 1], self._is_measured(a)
        if not is_measured or self._is_built(a):
            version = self._enter(0, a, shape, adopted=True)
            self._note("new", 0, a, version=version, note="" if is_measured else FIRST_SURVEY)
            return False
        # What was built onto it is new by itself.
        box, place = self.box_after[a], self._place(a)
        gain = self.pieces.gain[box]
        built = [piece for piece in np.unique(gain[place]).tolist() if self.links.gain_after.get(piece) == {a}]
        if built:
            rest = without_slivers(place & ~np.isin(gain, built), self.spec, self.params)
            shape = polygonise(rest.astype(np.int32), self.spec.crop(*box), 1)[0]
        self._note("unchanged", 0, a, version=self._enter(0, a, shape, adopted=not built), note=STOOD_BEFORE)
        return True

    def _detached(self, piece: int, a: int) -> None:
        """Enter a new building that its footprint joins with others, or with what stood before."""
        box = self.box_gain[piece]
        cells = self.pieces.gain[box] == piece
        self.rank = (2, self.first[0] + box[0].start, self.first[1] + box[1].start + int(cells[0].argmax()))
        shape = polygonise(cells.astype(np.int32), self.spec.crop(*box), 1)[0]
        self._note("new", 0, a, version=self._enter(0, a, shape, adopted=False))

    def _outline(self, group: tuple[int, ...], a: int) -> tuple[shapely.Geometry, bool]:
        """Return the buildings' new outline: the survey's where it covers only them, else the old with the change."""
        if self._sharing(a) == set(group) and all(len(self.links.own[i]) == 1 for i in group):
            return self._with_unseen(group, self.after.geometry.iloc[a - 1], adopted=True)
        return self._traced(group, [piece for i in group for piece in self.links.gains.get(i, ())])

    def _traced(self, group: tuple[int, ...], gains: list[int]) -> tuple[shapely.Geometry, bool]:
        """Return the old outline of buildings with the change; it is never the survey's."""
        box = _around([self.box_before[i] for i in group] + [self.box_gain[piece] for piece in gains])
        kept = np.isin(self.epochs.before[box], group) & (self.pieces.loss[box] == 0)
        # What the survey draws as a house by itself arrives as one.
        built = np.isin(self.pieces.gain[box], gains or [-1]) & ~np.isin(self.epochs.after[box], self.arriving)
        cells = without_slivers(kept | built, self.spec, self.params)
        return self._with_unseen(group, polygonise(cells.astype(np.int32), self.spec.crop(*box), 1)[0], adopted=False)

    def _with_unseen(
        self, group: tuple[int, ...], shape: shapely.Geometry, *, adopted: bool
    ) -> tuple[shapely.Geometry, bool]:
        """Return an outline with what of the buildings lies beyond the survey, and whether it is adopted as it was."""
        unseen = self._unseen(group)
        return (shape, adopted) if unseen is None else (shapely.union(shape, unseen), False)

    def _unseen(self, group: tuple[int, ...]) -> shapely.Geometry | None:
        """Return the part of buildings that lies beyond the whole survey; None where no disc fits into it."""
        shapes = shapely.union_all(self.links.shifted[[i - 1 for i in group]])
        unseen = shapely.difference(shapes, shapely.box(*self.epochs.whole.bounds))
        parts = [part for part in shapely.get_parts(unseen) if not part.buffer(-self.params.thickness_m).is_empty]
        return shapely.union_all(parts) if parts else None

    def _enter(self, i: int, a: int, shape: shapely.Geometry, *, adopted: bool) -> int:
        """Write a new state and return its row number; 0 is a building that begins with it."""
        rows = self._row(i, self.rows_before), self._row(a, self.rows_after)
        self.decided.versions.append((self.rank, *rows, adopted, shape))
        return len(self.decided.versions) - 1

    def _note(
        self,
        kind: str,
        i: int,
        a: int,
        *,
        version: int = -1,
        outline: bool = False,
        height: bool = False,
        parts: bool = False,
        note: str = "",
    ) -> None:
        """Write a row of the changes; 0 is no building on that side."""
        overlap = self.links.shared.get((i, a), 0.0)
        area_b = float(self.before.geometry.iloc[i - 1].area) if i else 0.0
        area_a = float(self.after.geometry.iloc[a - 1].area) if a else 0.0
        box = self.box_before[i] if i else self.box_after[a]
        cells = self.epochs.before[box] == i if i else self.epochs.after[box] == a
        known = self.rise[box][cells & self.epochs.rise.valid[box] & self.epochs.surveyed[box]]
        row = {
            "kind": kind,
            "before": self._row(i, self.rows_before),
            "after": self._row(a, self.rows_after),
            "version": version,
            "outline": outline,
            "height": height,
            "parts": parts,
            "overlap_m2": overlap,
            "iou": overlap / (area_b + area_a - overlap) if i and a else 0.0,
            "dh_m": float(np.median(known)) if known.size else float("nan"),
            # A footprint may cover several buildings; the version has the part of this one.
            "darea_m2": (float(shapely.area(self.decided.versions[version][4])) if version >= 0 else area_a) - area_b,
            "note": note,
        }
        self.decided.rows.append((self.rank, row))


def _around(found: list[Box]) -> Box:
    """Return the box around boxes."""
    rows, cols = zip(*found, strict=True)
    return tuple(slice(min(s.start for s in side), max(s.stop for s in side)) for side in (rows, cols))  # type: ignore[return-value]  # two slices
