"""What differs between two surveys: their offset, the pieces built or gone, and the links between footprints."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import geopandas as gpd
import numpy as np
import shapely
from numpy.typing import NDArray
from skimage.morphology import isotropic_dilation

from msbdb.change.thickness import Mask, bands, thick
from msbdb.errors import PassingNotice, give_notice
from msbdb.grid import Grid, GridSpec
from msbdb.labels import Labels, boxes, shared_cells, sizes
from msbdb.params import ChangeParams

Shapes = NDArray[np.object_]

LIKE_OVERLAP = 0.6
"""Two footprints are taken for one building, to measure the offset, when they share this much of both."""

ALIGNED_M = 1.0
"""Walls that moved by this much more or less than most count as if by this much: about two cells."""

ALIGNED_PAIRS = 100
"""The largest pairs are enough to align the rest."""

HALVINGS = 8
"""Each halves a reach of two metres; the last is below a centimetre."""

AGREEMENT_M = 0.5
"""Differences of height within this of one agree: a few times the noise of two surveys, far below a storey."""

MEDIAN_FACTOR = 1.4826
"""Times the median absolute deviation gives the standard deviation of normal errors."""


@dataclass(frozen=True, slots=True)
class Offset:
    """The offset of a survey: a place (x, y, h) of the inventory is (x + dx, y + dy, h + dz) there.

    ``dx_m``, ``dy_m`` and ``dz_m`` are 0 where there are too few pairs; ``pairs`` counts the pairs of like buildings;
    ``spread_m`` is the robust standard deviation of a single pair's shift, NaN without pairs.
    """

    dx_m: float
    dy_m: float
    dz_m: float
    pairs: int
    spread_m: float


@dataclass(frozen=True, slots=True, eq=False)
class Epochs:
    """Both sides of a comparison in a window of the later survey, the inventory shifted onto its lattice.

    Parameters
    ----------
    before, after : (H, W) ndarray of int32
        Footprints: 0 for none, otherwise row number + 1 of the frame.
    surveyed : (H, W) ndarray of bool
        Where the later survey has heights, within the area of interest.
    whole : GridSpec
        The lattice of the survey; all others here are windows of it.
    rise : Grid
        Height above ground now less that of before, without the vertical offset, metres; invalid where the earlier one
        is not known.
    heights, earlier : Grid
        Height above ground now and before, metres; the latter is invalid where it is not known.
    """

    before: Labels
    after: Labels
    surveyed: Mask
    whole: GridSpec
    rise: Grid
    heights: Grid
    earlier: Grid


@dataclass(frozen=True, slots=True, eq=False)
class Pieces:
    """Labelled pieces of change, each thick and of at least ``least_m2``: ``gain``, ``loss`` and ``lift``, 0 for none.

    ``fallen`` has all cells of the earlier footprints whose heights are gone, ``rose`` and ``sank`` those that are
    higher or lower than before, thick or not.
    """

    gain: Labels
    loss: Labels
    lift: Labels
    fallen: Mask
    rose: Mask
    sank: Mask


def estimate_offset(before: gpd.GeoDataFrame, after: gpd.GeoDataFrame, *, least_pairs: int) -> Offset:
    """Estimate the offset of a survey by the buildings that both sides have.

    Parameters
    ----------
    before, after : GeoDataFrame
        Footprints with their heights ``h_p90`` (metres), in one CRS; NaN heights do not count.
    least_pairs : int
        With fewer pairs the offset is zero.

    Returns
    -------
    Offset

    Notes
    -----
    The first estimate is the median shift of the centres of bounds, over pairs of footprints that share most of both.
    A few changed buildings do not move a median. The pairs are formed again after a first shift, because the offset
    itself keeps some footprints apart. Bounds lie on cells, and so does their median. So the offset is then the mean
    shift of all walls, weighted by their length: the place from which the pairs lose as much shared area by a step of a
    metre forth as by one back. Walls that moved farther count as a metre.

    Heights change by whole storeys. So the vertical offset is the difference on which most pairs agree. It is 0, with a
    notice, where fewer than ``least_pairs`` agree, and fewer than half of all.

    Examples
    --------
    Three houses lie 0.3 m farther east and 0.1 m higher; the third one has a storey more:

    >>> houses = shapely.box([0, 20, 40], [0, 0, 0], [10, 30, 50], [10, 10, 10])
    >>> before = gpd.GeoDataFrame({"h_p90": [6.0, 6.0, 6.0]}, geometry=houses)
    >>> after = gpd.GeoDataFrame({"h_p90": [6.1, 6.1, 9.1]}, geometry=moved(houses, 0.3, 0))
    >>> offset = estimate_offset(before, after, least_pairs=3)
    >>> round(offset.dx_m, 2), round(offset.dy_m, 2), round(offset.dz_m, 2), offset.pairs
    (0.3, 0.0, 0.1, 3)
    """
    dx = dy = 0.0
    pairs = np.zeros((2, 0), dtype=np.int64)
    shift = np.zeros((0, 2))
    for _ in range(2):
        pairs = _like(before.geometry.to_numpy(), after.geometry.to_numpy(), dx, dy)
        if pairs.shape[1] < least_pairs:
            return Offset(0.0, 0.0, 0.0, pairs.shape[1], float("nan"))
        shift = _middles(after.geometry.to_numpy()[pairs[1]]) - _middles(before.geometry.to_numpy()[pairs[0]])
        dx, dy = (float(middle) for middle in np.median(shift, axis=0))
    dx, dy = _aligned(before.geometry.to_numpy()[pairs[0]], after.geometry.to_numpy()[pairs[1]], (dx, dy))
    rise = after["h_p90"].to_numpy(dtype=np.float64)[pairs[1]] - before["h_p90"].to_numpy(dtype=np.float64)[pairs[0]]
    known = rise[np.isfinite(rise)]
    dz = _agreed(known, least_pairs) if len(known) >= least_pairs else 0.0
    spread = MEDIAN_FACTOR * float(np.median(np.abs(shift - (dx, dy))))
    return Offset(dx, dy, dz, pairs.shape[1], spread)


def _aligned(before: Shapes, after: Shapes, start: tuple[float, float]) -> tuple[float, float]:
    """Return the shift, within a step of the first one, from which steps forth and back share the same area."""
    largest = np.argsort(-shapely.area(before), kind="stable")[:ALIGNED_PAIRS]
    before, after = before[largest], after[largest]
    place = np.array(start)
    for axis in (0, 1, 0, 1):
        step = ALIGNED_M * np.eye(2)[axis]
        low, high = place - step, place + step
        for _ in range(HALVINGS):
            place = (low + high) / 2
            forth, back = (
                shapely.area(shapely.intersection(moved(before, *to), after)).sum()
                for to in (place + step, place - step)
            )
            low, high = (place, high) if forth > back else (low, place)
        place = (low + high) / 2
    return float(place[0]), float(place[1])


def _agreed(rise: NDArray[np.float64], least_pairs: int) -> float:
    """Return the median of the largest group of like differences, of equal groups the lowest; 0 for a small group."""
    ordered = np.sort(rise)
    alike = np.searchsorted(ordered, rise + AGREEMENT_M, "right") - np.searchsorted(ordered, rise - AGREEMENT_M, "left")
    middle = rise[np.lexsort((np.abs(rise), -alike))[0]]
    near = np.abs(rise - middle) <= AGREEMENT_M
    count = int(near.sum())
    if count < least_pairs and 2 * count < len(rise):
        msg = (
            f"The heights of the survey and of the inventory agree on no offset: of {len(rise)} buildings that are "
            f"alike, {count} differ by the same. The offset of heights is not measured, and taken as 0."
        )
        give_notice(msg, PassingNotice)
        return 0.0
    return float(np.median(rise[near]))


def _like(before: NDArray[np.object_], after: NDArray[np.object_], dx: float, dy: float) -> NDArray[np.int64]:
    """Return the pairs (2, N) of footprints that share most of both, once the inventory is shifted."""
    shifted = moved(before, dx, dy)
    found = shapely.STRtree(after).query(shifted, predicate="intersects")
    shared = shapely.area(shapely.intersection(shifted[found[0]], after[found[1]]))
    larger = np.maximum(shapely.area(shifted[found[0]]), shapely.area(after[found[1]]))
    return np.asarray(found[:, shared >= LIKE_OVERLAP * larger])


def _middles(shapes: NDArray[np.object_]) -> NDArray[np.float64]:
    """Return the centres of the geometries' bounds, (N, 2)."""
    bounds = shapely.bounds(shapes)
    return np.asarray((bounds[:, :2] + bounds[:, 2:]) / 2)


def moved(shapes: NDArray[np.object_], dx: float, dy: float) -> NDArray[np.object_]:
    """Return geometries shifted in plan by metres."""
    return np.asarray(shapely.transform(shapes, lambda xy: xy + np.array([dx, dy])))


def earlier_heights(grids: Sequence[Grid], spec: GridSpec, offset: Offset) -> Grid:
    """Return the heights above ground that the inventory knows, on another lattice, by the nearest cell.

    Parameters
    ----------
    grids : sequence of Grid
        Heights of earlier surveys in the same CRS; at each place the first valid one counts.
    spec : GridSpec
        The later survey's lattice.
    offset : Offset
        The offset of the later survey to them.
    """
    values = np.zeros(spec.shape, dtype=np.float32)
    valid = np.zeros(spec.shape, dtype=np.bool_)
    east, north = spec.centres()
    for rows in bands(spec.shape):
        places = east - offset.dx_m, north[rows] - offset.dy_m
        for grid in grids:
            new = grid.spec.sample(grid.valid, *places, outside=False) & ~valid[rows]
            np.copyto(values[rows], grid.spec.sample(np.asarray(grid.values), *places, outside=0), where=new)
            valid[rows] |= new
    return Grid(values, valid, spec)


def find_pieces(epochs: Epochs, params: ChangeParams) -> Pieces:
    """Find the pieces of change.

    A cell of one footprint alone counts where its height changed as well. Where the earlier height is not known, an
    earlier footprint is gone where its place is open now, and a later footprint alone was built. A difference between
    two builds without a change of height (a crown beside a roof, a courtyard) is no change, and neither is a sliver
    along an outline.
    """
    rise, values, heights = epochs.rise, np.asarray(epochs.rise.values), np.asarray(epochs.heights.values)
    gains = find_gains(epochs, params)
    high, stood = heights >= params.rise_m, _stood(epochs, params)
    # Where the earlier height is not known, a building is gone only where its place is open now.
    fell = np.where(rise.valid, values <= -params.rise_m, heights < params.rise_m)
    loss = (epochs.before > 0) & ~((epochs.after > 0) & high) & epochs.surveyed & fell
    del fell
    losses = thick(loss, rise.spec, params)
    # A roof that was raised rises as a whole, also where the later footprint lacks a part of it.
    still = high & stood & epochs.surveyed & rise.valid
    # Raised and sunken parts may touch, but are not one piece.
    higher, lower = still & (values >= params.rise_m) & (values > 0), still & (values <= -params.rise_m) & (values < 0)
    del high, stood, still
    up, lifts = (thick(side, rise.spec, params) for side in (higher, lower))
    lifts[lifts > 0] += up.max(initial=0)
    np.copyto(lifts, up, where=up > 0)
    return Pieces(gains, losses, lifts, loss, higher, lower)


def find_gains(
    epochs: Epochs, params: ChangeParams, ended: Collection[int] = (), known: Collection[int] = ()
) -> Labels:
    """Find the pieces of ground that was built on, as in `find_pieces`.

    Of the ground of buildings that ended, what has another level than they had was built since. So was what the survey
    draws with a building that stands: the footprints in ``known`` are of those.
    """
    rise, values = epochs.rise, np.asarray(epochs.rise.values)
    covered = (epochs.after > 0) & (np.asarray(epochs.heights.values) >= params.rise_m) & epochs.surveyed
    gain = covered & ~_stood(epochs, params) & (~rise.valid | (values >= params.rise_m))
    if ended:
        other = ~rise.valid | (np.abs(values) >= params.rise_m) | np.isin(epochs.after, list(known))
        gain |= covered & np.isin(epochs.before, list(ended)) & other
    return thick(gain, rise.spec, params)


def _stood(epochs: Epochs, params: ChangeParams) -> Mask:
    """Return the cells of earlier footprints; a courtyard that the area closing filled has no roof."""
    low = epochs.earlier.valid & (np.asarray(epochs.earlier.values) < params.rise_m)
    return np.asarray((epochs.before > 0) & ~low)


def touching(piece: Labels, other: Labels, reach_m: float, cell_m: float) -> dict[int, set[int]]:
    """Return, for each piece, the other labels within reach of it, except those that it touches only by a corner.

    A label counts when it has at least a third as many cells within reach as the label with most of them.
    """
    count = int(piece.max(initial=0))
    found: dict[int, set[int]] = {number: set() for number in range(1, count + 1)}
    reach = reach_m / cell_m
    margin = int(np.ceil(reach)) + 1
    for number, (rows, cols) in boxes(piece).items():
        box = (
            slice(max(rows.start - margin, 0), rows.stop + margin),
            slice(max(cols.start - margin, 0), cols.stop + margin),
        )
        near = isotropic_dilation(piece[box] == number, reach)  # type: ignore[no-untyped-call]  # scikit-image
        labels, cells = np.unique(other[box][near & (other[box] > 0)], return_counts=True)
        found[number] = set(labels[3 * cells >= cells.max(initial=0)].tolist())
    return found


@dataclass(eq=False)
class Links:
    """The buildings of both sides, numbered by row + 1, and what links them.

    - ``cells`` and ``seen``: cells of each building of the inventory, all and surveyed;
    - ``shared``: area that each pair shares;
    - ``ended``: the buildings that are gone, though a little may stand; they have no footprints, and nothing is built
      onto them;
    - ``own``: the survey's footprints of each other building, the one with the largest share first;
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
        standing, self.ended = self.epochs.before, self._ended()
        if self.ended:
            self.own = {i: own for i, own in self.own.items() if i not in self.ended}
            known = {a for own in self.own.values() for a in own}
            self.pieces = replace(self.pieces, gain=find_gains(self.epochs, self.params, self.ended, known))
            standing = np.where(np.isin(standing, list(self.ended)), np.int32(0), standing)
        gain_by = touching(self.pieces.gain, standing, reach, spec.cell_m)
        self.loss_by = touching(self.pieces.loss, self.epochs.after, reach, spec.cell_m)
        self.gain_after = _within(self.pieces.gain, self.epochs.after)
        self.gains = self._gains_of(gain_by)

    @property
    def spec(self) -> GridSpec:
        """The window's lattice."""
        return self.epochs.rise.spec

    def is_surveyed(self, i: int) -> bool:
        """Return whether a building can be judged: most of it is in the surveyed area, or the border cuts it.

        Of a building that the border cuts, a part as large as a change is judged, and the rest stays as it is.
        """
        shape = self.shifted[i - 1]
        seen = self.seen[i - 1] * self.spec.cell_area_m2
        is_cut = not shapely.box(*self.epochs.whole.bounds).contains(shape)
        return bool(seen >= self.params.surveyed_share * shape.area > 0 or (is_cut and seen >= self.params.least_m2))

    def _linked(self) -> dict[int, list[int]]:
        """Return the survey's footprints of each building, the one with the largest share first."""
        area_b, area_a = self.before.geometry.area.to_numpy(), self.after.geometry.area.to_numpy()
        links: dict[int, list[int]] = {}
        for (i, a), overlap in sorted(self.shared.items(), key=lambda item: (-item[1], item[0])):
            if overlap >= self.params.link_share * min(area_b[i - 1], area_a[a - 1]):
                links.setdefault(i, []).append(a)
        return links

    def _ended(self) -> set[int]:
        """Return the surveyed buildings that are gone: by thick pieces, or all cells where no footprint is theirs."""
        thick_cells, cells = (
            sizes(np.where(gone, self.epochs.before, np.int32(0)), len(self.before))
            for gone in (self.pieces.loss > 0, self.pieces.fallen)
        )
        # A slender building leaves no thick piece; without any later footprint its cells decide.
        has_own = np.isin(np.arange(1, len(self.before) + 1), list(self.own))
        gone = np.where(has_own, thick_cells, cells) >= self.params.gone_share * np.maximum(self.seen, 1)
        return {i for i in (np.flatnonzero(gone) + 1).tolist() if self.is_surveyed(i)}

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
