"""Comparison of a survey with the inventory: what happened to each building, and the new states."""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import geopandas as gpd
import numpy as np
import pandas as pd
import shapely
from numpy.typing import NDArray

from msbdb.change.decided import joined
from msbdb.change.decisions import Decisions
from msbdb.change.differences import (
    AGREEMENT_M,
    Epochs,
    Links,
    Offset,
    earlier_heights,
    estimate_offset,
    find_pieces,
    moved,
)
from msbdb.change.surveywindows import WINDOW_CELLS, Ground, Heights, islands, read_around, windows
from msbdb.detect.scene import Elevations
from msbdb.fuse.roofheights import measure_heights
from msbdb.grid import Grid, GridSpec
from msbdb.labels import Labels
from msbdb.outline.polygons import rasterise
from msbdb.params import ChangeParams, Params
from msbdb.tables import HEIGHTS

Rise = NDArray[np.float32]

ENOUGH_CELLS = 1_000_000
"""About as many cells, evenly chosen, give the vertical offset of two surveys; more add nothing but time."""


@dataclass(frozen=True, slots=True, eq=False)
class Comparison:
    """The changes that a survey shows in the inventory.

    Parameters
    ----------
    offset : Offset
        The systematic offset of the survey to the inventory.
    changes : DataFrame
        A row a building, or a pair of buildings for ``merged`` and ``split``:

        - ``kind``; ``before`` and ``after``, row numbers of the two frames or -1;
        - ``version``, row number of the building's new state in ``versions`` or -1;
        - ``outline``, ``height``, ``parts``: which of these were modified;
        - ``overlap_m2`` and ``iou`` of the pair; ``dh_m``, median change of height on the footprint; ``darea_m2``;
        - ``note``.
    versions : GeoDataFrame
        The new state of every building that changed, with its geometry in the survey's place:

        - ``before``: row whose identity it continues, or -1 for a new one;
        - ``after``: row whose attributes it has;
        - ``adopted``: whether its outline is that of this row, not one made here.
    """

    offset: Offset
    changes: pd.DataFrame
    versions: gpd.GeoDataFrame


def compare(
    before: gpd.GeoDataFrame,
    after: gpd.GeoDataFrame,
    *,
    survey: Ground,
    earlier: Sequence[Ground] = (),
    area: shapely.Geometry | None = None,
    params: ChangeParams | None = None,
    window_cells: int = WINDOW_CELLS,
) -> Comparison:
    """Compare the buildings of a survey with those of the inventory.

    Parameters
    ----------
    before : GeoDataFrame
        Current buildings of the inventory that may lie in the survey, with ``h_p90`` (NaN where unknown).
    after : GeoDataFrame
        Buildings of the survey, with ``h_p90``.
    survey : Ground
        Heights above ground of the survey, and above sea where its terrain is known.
    earlier : sequence of Ground
        The same of the surveys that the inventory has of the place, the latest first; none where it began from
        footprints alone.
    area : Polygon or MultiPolygon, optional
        The area of interest, in the survey's CRS; all of it by default.
    params : ChangeParams, optional
        Thresholds of change.
    window_cells : int
        Side of the windows, cells. The result does not depend on it.

    Returns
    -------
    Comparison
        The order of its rows is that of the frames.

    Notes
    -----
    Buildings are compared by the pieces of ground that were built or are gone (`find_pieces`), not by how each build
    divides a block into buildings. A row of houses that is one building in one survey is unchanged while nothing was
    built or pulled down. A piece belongs to the buildings that it touches within the thickness that counts.

    A roof rose or sank where its level above sea changed. The ground beneath a block is interpolated, so
    two surveys differ there although nothing changed. Heights above ground decide where a level is not known.

    Nothing depends on footprints farther off than the thickness that counts and two cells. So footprints that are
    nearer to each other, of both sides, are an island, and each island is compared as a whole in one window. A window
    holds the heights, not the survey. The offsets between both surveys are those of the whole.
    """
    params = params or ChangeParams()
    offset = estimate_offset(before, after, least_pairs=params.offset_pairs)
    zeros = _zeros(survey, earlier, offset, window_cells)
    shifted = moved(before.geometry.to_numpy(), offset.dx_m, offset.dy_m)
    shapes = np.concatenate([shifted, after.geometry.to_numpy()])
    cell_m = survey.spec.cell_m
    island = islands(shapes, params.thickness_m + 2 * cell_m)
    found = []
    for rows, box in windows(shapes, island, survey.spec, around_m=2 * cell_m, side=window_cells):
        one, other = rows[rows < len(before)], rows[rows >= len(before)] - len(before)
        here, known = survey.read(*box), [_beneath(ground, survey.spec.crop(*box), offset) for ground in earlier]
        inside = here.above_ground.valid
        if area is not None:
            inside = inside & (rasterise([area], here.spec) > 0)
        rise, earlier_here = _rise(here, known, zeros, offset)
        epochs = Epochs(
            _painted(shifted[one], here.spec),
            _painted(shapes[rows[rows >= len(before)]], here.spec),
            inside,
            survey.spec,
            rise,
            here.above_ground,
            earlier_here,
        )
        links = Links(before.iloc[one], after.iloc[other], shifted[one], epochs, find_pieces(epochs, params), params)
        found.append(Decisions(links, offset, one, other, (box[0].start, box[1].start)).decide())
    return Comparison(offset, *joined(found, after.crs))


def _beneath(ground: Ground, spec: GridSpec, offset: Offset) -> Heights | None:
    """Return the window of an earlier survey that lies beneath a lattice of the survey; None beside it."""
    x, y = spec.centres()
    place = np.array([x[0], y[-1, 0], x[-1], y[0, 0]]) - (offset.dx_m, offset.dy_m) * 2
    return read_around(ground, tuple(place.tolist()))


def _rise(
    here: Heights, earlier: Sequence[Heights | None], zeros: Sequence[np.float32 | None], offset: Offset
) -> tuple[Grid, Grid]:
    """Return what rose in a window, and the earlier heights above ground.

    The rise is the change of level in each cell with an earlier level, and else that of the height above ground.
    """
    spec, valid = here.spec, here.above_ground.valid
    there = [(known, zero) for known, zero in zip(earlier, zeros, strict=True) if known is not None]
    earlier_here = earlier_heights([known.above_ground for known, _ in there], spec, offset)
    rise = np.asarray(here.above_ground.values, dtype=np.float32) - np.asarray(earlier_here.values)
    rise -= np.float32(offset.dz_m)
    if here.above_sea is not None:
        left = here.above_sea.valid.copy()
        for known, zero in there:
            before = earlier_heights([known.above_ground if known.above_sea is None else known.above_sea], spec, offset)
            if zero is not None:
                change = np.asarray(here.above_sea.values) - np.asarray(before.values)
                change -= zero
                np.copyto(rise, change, where=here.above_sea.valid & before.valid & left)
            left &= ~before.valid
    return Grid(rise, earlier_here.valid & valid, spec), earlier_here


def _zeros(survey: Ground, earlier: Sequence[Ground], offset: Offset, window_cells: int) -> list[np.float32 | None]:
    """Return the vertical offset of the survey's levels to those of each earlier one; None where one has no levels.

    Two surveys may count their levels from different zeros. Their vertical offset is the change on which most cells
    agree, streets included. Every n-th row and column of the whole survey is looked at.
    """
    spec = survey.spec
    step = math.ceil(math.sqrt(spec.shape[0] * spec.shape[1] / ENOUGH_CELLS))
    changes: list[list[Rise]] = [[] for _ in earlier]
    for top, left in itertools.product(*(range(0, size, window_cells) for size in spec.shape)):
        box = slice(top, min(top + window_cells, spec.shape[0])), slice(left, min(left + window_cells, spec.shape[1]))
        levels = survey.read(*box).above_sea
        if levels is None:
            break
        some = slice(-top % step, None, step), slice(-left % step, None, step)
        x, y = levels.spec.centres()
        places = x[some[1]] - offset.dx_m, y[some[0]] - offset.dy_m
        for ground, found in zip(earlier, changes, strict=True):
            beneath = _beneath(ground, levels.spec, offset)
            if beneath is not None and beneath.above_sea is not None:
                known = beneath.above_sea
                both = levels.valid[some] & known.spec.sample(known.valid, *places, outside=False)
                change = np.asarray(levels.values)[some] - known.spec.sample(
                    np.asarray(known.values), *places, outside=0
                )
                found.append(change[both])
    every = [np.concatenate([np.zeros(0, dtype=np.float32), *found]) for found in changes]
    return [_agreed(change) if len(change) else None for change in every]


def _agreed(change: Rise) -> np.float32:
    """Return the median of the largest group of changes that lie close together, of equal groups the lowest."""
    ordered = np.sort(change)
    ends = np.searchsorted(ordered, ordered + np.float32(2 * AGREEMENT_M), side="right")
    first = int(np.argmax(ends - np.arange(len(ordered))))
    return np.float32(np.median(ordered[first : ends[first]]))


def _painted(shapes: NDArray[np.object_], spec: GridSpec) -> Labels:
    """Return the cells of footprints by row number + 1; of two that overlap the smaller lies on top."""
    order = np.argsort(-shapely.area(shapes), kind="stable")
    number = np.concatenate([[0], order + 1]).astype(np.int32)
    return np.asarray(number[rasterise(shapes[order], spec)])


def measure(shape: shapely.MultiPolygon, heights: Grid) -> dict[str, float]:
    """Measure an outline on heights above ground.

    Parameters
    ----------
    shape : Polygon or MultiPolygon
        In the lattice's CRS.
    heights : Grid
        Heights above ground, metres.

    Returns
    -------
    dict of str to float
        ``area_m2`` of the outline itself; ``h_max``, ``h_mean``, ``h_p50`` and ``h_p90`` in metres, and ``volume_m3``,
        of the valid cells whose centre lies inside, heights below 0 counting as 0 in the volume; empty where the
        outline has no such cell.
    """
    spec, (rows, cols) = heights.spec, _box(shape, heights.spec)
    if rows.stop <= rows.start or cols.stop <= cols.start:
        return {}
    inside = (rasterise([shape], spec.crop(rows, cols)) > 0) & heights.valid[rows, cols]
    found = np.asarray(heights.values)[rows, cols][inside].astype(np.float64)
    if not found.size:
        return {}
    middle, high = np.percentile(found, [50, 90])
    return {
        "area_m2": float(shape.area),
        "h_max": float(found.max()),
        "h_mean": float(found.mean()),
        "h_p50": float(middle),
        "h_p90": float(high),
        "volume_m3": float(np.maximum(found, 0).sum() * spec.cell_area_m2),
    }


def measure_roofs(
    shape: shapely.MultiPolygon, heights: Grid, elevations: Elevations, params: Params
) -> dict[str, float | int]:
    """Measure ground, eaves, ridge and storeys in an outline, as in a building.

    Parameters
    ----------
    shape : Polygon or MultiPolygon
        In the lattice's CRS.
    heights : Grid
        Heights above ground, metres.
    elevations : Elevations
        The terrain above sea, where it is known.
    params : Params
        Sections ``heights`` and ``surface``.

    Returns
    -------
    dict
        ``tables.HEIGHTS``; empty where no valid cell has its centre in the outline.
    """
    rows, cols = _box(shape, heights.spec, params.heights.far_ring_m)
    if rows.stop <= rows.start or cols.stop <= cols.start:
        return {}
    near = heights.crop(rows, cols)
    labels = rasterise([shape], near.spec)
    if not (near.valid & (labels > 0)).any():
        return {}
    terrain_cm = None if elevations.terrain_cm is None else elevations.terrain_cm[rows, cols]
    found = measure_heights(labels, 1, near, Elevations(terrain_cm), params=params.heights, surface=params.surface)
    return {name: found[name].iloc[0].item() for name in HEIGHTS}


def _box(shape: shapely.MultiPolygon, spec: GridSpec, around_m: float = 0.0) -> tuple[slice, slice]:
    """Return the rows and columns that an outline may cover, and those around it."""
    west, south, east, north = shapely.box(*shape.bounds).buffer(around_m, join_style="mitre").bounds
    row, col = spec.rowcol(np.array([west, east]), np.array([north, south]))
    limits = zip((row, col), spec.shape, strict=True)
    top, left = (slice(max(int(first), 0), min(int(last) + 1, size)) for (first, last), size in limits)
    return top, left
