"""Touching houses: the cells of buildings divided where there is a reason, and the reason kept (decision 0031)."""

import math
from dataclasses import dataclass
from functools import partial

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy import ndimage
from scipy.ndimage import binary_fill_holes, distance_transform_edt, median_filter

from msbdb.fuse.houses.joining import MATERIAL, REASONS, Joining
from msbdb.fuse.houses.roofborders import find_roof_borders, reach_m
from msbdb.fuse.houses.roofdirections import find_directions
from msbdb.fuse.houses.roofmaterials import cut_rows
from msbdb.fuse.houses.roofpieces import SMOOTH_M, TRUNCATE, cut_bends, cut_pieces, measure_pieces, measure_touches
from msbdb.grid import Grid
from msbdb.labels import CellList, Labels, boxes, label_zones, look_up, touching_pairs, widened
from msbdb.params import TouchingParams
from msbdb.threads import together


@dataclass(frozen=True, slots=True, eq=False)
class Division:
    """Cells of buildings divided into houses.

    Parameters
    ----------
    houses : (H, W) ndarray of int32
        0 outside of buildings; otherwise the house, numbered in row order of the first cells. Each is connected.
    borders : dict
        By the numbers of two houses that touch, the smaller first: the index in `REASONS` of what divides them.
    """

    houses: Labels
    borders: dict[tuple[int, int], int]

    def reasons_of(self, labels: Labels, count: int) -> NDArray[np.object_]:
        """Return why each building is divided from those beside it: reasons with commas, empty for none.

        Parameters
        ----------
        labels : (H, W) ndarray of int32
            Buildings, each within one house: 0 for none, otherwise 1 to ``count``.
        count : int
            Number of buildings.
        """
        house = np.zeros(count + 1, dtype=np.int64)
        house[labels[labels > 0]] = self.houses[labels > 0]
        found: list[set[int]] = [set() for _ in range(count)]
        for one, other in zip(*(side.tolist() for side in touching_pairs(labels)), strict=True):
            reason = self.borders.get((min(house[one], house[other]), max(house[one], house[other])))
            if reason is not None:
                found[one - 1].add(reason)
                found[other - 1].add(reason)
        return np.array([",".join(REASONS[reason] for reason in sorted(own)) for own in found], dtype=object)


def divide(
    heights: Grid,
    built: NDArray[np.bool_],
    params: TouchingParams,
    *,
    spacing_m: float,
    parcels: Labels | None = None,
    intensity: NDArray[np.uint8] | None = None,
) -> Division:
    """Divide the cells of buildings into houses.

    Parameters
    ----------
    heights : Grid
        Heights above ground, metres.
    built : (H, W) ndarray of bool
        Cells of buildings; valid in the heights.
    params : TouchingParams
        What counts as evidence, and the least house.
    spacing_m : float
        Mean distance of the points, metres; of a raster, its cell.
    parcels : (H, W) ndarray of int32, optional
        The parcel of each cell; 0 for none.
    intensity : (H, W) ndarray of uint8, optional
        Of the first echoes, in steps of its logarithm; 0 where unknown.

    Returns
    -------
    Division
        Without any reason a connected island of cells is one house.

    Notes
    -----
    The cells are cut into far too many pieces (`cut_pieces`). Pieces are joined again, the weakest border first, until
    each border that is left has a reason:

    - *parcel*: the pieces lie in two parcels;
    - *step*, *valley* or *wall*: at least ``share`` of the border has evidence, and most of it of this kind. Beside a
      step the two roofs differ by ``level_m`` in their mean heights; so the teeth of a saw-tooth roof stay together. On
      both sides of a valley the roofs rise ``rise_m`` above the upper end of the border, which runs along one line:
      wings that meet at a ridge stay together;
    - *direction*: along ``share`` of the border the directions of roofs and walls turn by ``turn_deg`` within a few
      metres, and so do the mean directions of the pieces. Right angles are no turn, as wings of one house have them.

    - *material*: a roof goes on along a row, and the intensity changes along a line from front to back (`cut_rows`).

    An island that has ``round_share`` in common with an ellipse, without its courts, is one structure: nothing but
    parcels divides an arena or a tank.

    An island up to ``single_m2`` is one house with its garage and wings, unless its pieces are alike, as pairs and rows
    of houses are. The smallest piece then has ``alike_share`` of the largest one's area, and their mean heights differ
    by less than ``level_m``. Parcels divide it in any case.

    A piece that shares ``enclosed_share`` or more of its outline with one other piece lies on it or in it. It is no
    house of its own, unless the two lie in two parcels. The same holds for two pieces beside each other and their
    common outline. So a tower and its podium stay together, also where the tower is cut beside its plant room.

    A piece smaller than ``house_m2``, or narrower than ``width_m``, is no house; in a parcel, the limits are
    ``parcel_m2`` and ``parcel_width_m``. It is joined with the neighbour behind its weakest border. Its width is
    that of a rectangle with its second moments: √12 times the smaller standard deviation of its cells.

    Parcels: a sliver may cross the line of a parcel where the evidence is on another line. So a house keeps its wall
    where parcels are shifted by less than ``parcel_width_m``. Strips outside of all parcels, narrower than ``width_m``,
    belong to the nearest parcel, cell by cell. What is wider is divided by the evidence.

    Border: roofs end at the lattice. Complexity: n log n in the cells, and in the pieces.
    """
    cells = CellList.covering(built)
    of_cells, count = cells.zones(np.ones(cells.numbers.size, dtype=np.uint8))
    islands = cells.image(of_cells)
    if not count or not (params.divide or parcels is not None):
        return Division(islands, {})
    cell_m = heights.spec.cell_m
    smooth = _without_outliers(np.asarray(heights.values, dtype=np.float32), islands, cell_m, spacing_m)
    least = (params.step_m, params.valley_m, params.wall_m, params.turn_deg)
    directions = None
    evidence: tuple[NDArray[np.float32], ...]
    if params.divide:
        # A round structure, such as an arena, is one: its tiers and stairs are no houses.
        divisible = built & ~_round(islands, params.round_share)
        borders, directions = together(
            partial(find_roof_borders, smooth, divisible, cell_m=cell_m, spacing_m=spacing_m),
            partial(find_directions, smooth, np.where(divisible, islands, 0), cell_m=cell_m),
        )
        evidence = (borders.step_m, borders.valley_m, borders.wall_m, directions.turn_deg)
        strength = np.maximum.reduce([found / limit for found, limit in zip(evidence[:3], least, strict=False)])
        labels = cut_pieces(smooth, built, strength, cell_m=cell_m, core_m=params.core_m)
        labels = cut_bends(labels, directions.turn_deg, params.turn_deg)
    else:
        evidence, labels = (np.zeros_like(smooth),) * len(least), islands
    if parcels is not None:
        parcels = _with_strips(parcels, islands, params.width_m / cell_m)
        both = labels.astype(np.int64) * (int(parcels.max()) + 1) + parcels
        labels, _ = label_zones(np.where(built, both, 0), connectivity=4)
    pieces = measure_pieces(labels, smooth, parcels, directions)
    touches = measure_touches(labels, smooth, evidence, least)
    joining = Joining(pieces, touches, params, cell_m)
    into = joining.run()
    piece = cells.of(labels)
    of_cells, _ = cells.zones(look_up(np.concatenate([[0], into + 1]), piece))
    houses = cells.image(of_cells)
    house = np.zeros(len(into), dtype=np.int64)
    house[into[piece[piece > 0] - 1]] = of_cells[piece > 0]
    found = {}
    for (one, other), reason in joining.borders().items():
        pair = int(house[one]), int(house[other])
        found[min(pair), max(pair)] = reason
    if directions is None:
        return Division(houses, found)
    cut = houses
    if intensity is not None:
        kept = ~divisible
        if parcels is not None:
            kept |= np.isin(houses, np.unique(houses[parcels > 0]))
        rows = cut_rows(np.where(kept, 0, houses), smooth, intensity, directions, params, cell_m=cell_m)
        both = of_cells.astype(np.int64) * (int(rows.max(initial=0)) + 1) + cells.of(rows)
        cut = cells.image(cells.zones(both)[0])
    small = _small_and_unlike(islands, cut, smooth, params, cell_m)
    if parcels is not None:
        small &= ~np.isin(islands, np.unique(islands[parcels > 0]))
    joined = np.where(cells.of(small), cells.of(islands).astype(np.int64) + int(cut.max()), cells.of(cut))
    whole = cells.image(cells.zones(joined)[0])
    return Division(whole, _borders_of(whole, houses, found))


def _small_and_unlike(
    islands: Labels, houses: Labels, heights: NDArray[np.float32], params: TouchingParams, cell_m: float
) -> NDArray[np.bool_]:
    """Return the cells of islands that are one house with its garage and wings: small, and of unlike pieces."""
    inside = np.flatnonzero(houses > 0)
    house = houses.ravel()[inside]
    numbers, first = np.unique(house, return_index=True)
    found = pd.DataFrame(
        {
            "area": np.bincount(house)[numbers],
            "height": ndimage.mean(heights.ravel()[inside], house, numbers),
        },
        index=pd.Index(islands.ravel()[inside[first]], name="island"),
    ).groupby("island")
    area, height = found["area"], found["height"]
    unlike = (area.min() < params.alike_share * area.max()) | (height.max() - height.min() >= params.level_m)
    small = area.sum() * cell_m**2 <= params.single_m2
    whole = np.zeros(int(islands.max()) + 1, dtype=np.bool_)
    whole[area.sum().index] = unlike & small
    whole[0] = False
    return look_up(whole, islands)


def _borders_of(cut: Labels, houses: Labels, borders: dict[tuple[int, int], int]) -> dict[tuple[int, int], int]:
    """Return the borders of houses that were divided further; a new border is one of materials."""
    house = np.zeros(int(cut.max(initial=0)) + 1, dtype=np.int64)
    house[cut[cut > 0]] = houses[cut > 0]
    found = {}
    for one, other in zip(*(side.tolist() for side in touching_pairs(cut)), strict=True):
        pair = min(house[one], house[other]), max(house[one], house[other])
        reason = REASONS.index(MATERIAL) if pair[0] == pair[1] else borders.get(pair)
        if reason is not None:
            found[one, other] = reason
    return found


def _without_outliers(
    heights: NDArray[np.float32], islands: Labels, cell_m: float, spacing_m: float
) -> NDArray[np.float32]:
    """Return heights freed of single outliers, in buildings and as far around them as anything is read."""
    margin = math.ceil(max(reach_m(spacing_m), TRUNCATE * SMOOTH_M) / cell_m) + 1
    smooth = heights.copy()
    for window in boxes(islands).values():
        near, around = widened(window, margin), widened(window, margin + 1)
        found = median_filter(heights[around], 3, mode="nearest")
        # The median of the outermost cells lacks what lies beyond, except at the border of the lattice.
        rows, cols = (slice(one.start - other.start, None) for one, other in zip(near, around, strict=True))
        inside = smooth[near]
        inside[...] = found[rows, cols][: inside.shape[0], : inside.shape[1]]
    return smooth


def _round(islands: Labels, share: float) -> NDArray[np.bool_]:
    """Return the cells of islands that, without their courts, have this share in common with an ellipse.

    The ellipse has the second moments of the island. A square has 0.83 in common with it, a hexagon
    0.92, an octagon 0.96; so has whatever an affine map makes of them.
    """
    found = np.zeros(islands.shape, dtype=np.bool_)
    for number, window in boxes(islands).items():
        own = islands[window] == number
        filled = binary_fill_holes(own)
        places = np.stack([place.astype(np.float64) for place in np.nonzero(filled)])
        places -= places.mean(axis=1, keepdims=True)
        # A cell itself has the variance 1/12.
        moments = places @ places.T / places.shape[1] + np.eye(2) / 12
        ellipse = 4 * math.pi * math.sqrt(np.linalg.det(moments))
        common = np.count_nonzero((np.linalg.solve(moments, places) * places).sum(axis=0) <= 4)
        if common >= share * (places.shape[1] + ellipse - common):
            found[window] |= own
    return found


def _with_strips(parcels: Labels, islands: Labels, width: float) -> Labels:
    """Give narrow strips of buildings outside of all parcels to the nearest parcel on their island.

    Strips are what an opening by a disc of this width, in cells, removes.
    """
    outside = (islands > 0) & (parcels == 0)
    core = distance_transform_edt(outside) >= width / 2
    wide = outside & (distance_transform_edt(~core) <= width / 2) if core.any() else core
    near = distance_transform_edt((islands == 0) | (parcels == 0), return_distances=False, return_indices=True)
    strips = outside & ~wide & (islands[tuple(near)] == islands)
    found: Labels = np.where(strips, parcels[tuple(near)], parcels)
    return found
