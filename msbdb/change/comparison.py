"""Comparison of a survey with the inventory: what happened to each building, and the new states."""

from collections.abc import Sequence
from dataclasses import dataclass

import geopandas as gpd
import numpy as np
import pandas as pd
import shapely
from numpy.typing import NDArray

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
from msbdb.change.thickness import Mask
from msbdb.detect.scene import Elevations
from msbdb.fuse.roofheights import measure_heights
from msbdb.grid import Grid, GridSpec
from msbdb.labels import Labels
from msbdb.outline.polygons import rasterise
from msbdb.params import ChangeParams, Params
from msbdb.tables import HEIGHTS

Rise = NDArray[np.float32]

ENOUGH_CELLS = 1_000_000
"""An even choice of this many cells gives the vertical offset of two surveys; more add nothing but time."""


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
    heights: Grid,
    earlier: Sequence[Grid] = (),
    levels: Grid | None = None,
    earlier_levels: Sequence[Grid | None] = (),
    surveyed: Mask | None = None,
    params: ChangeParams | None = None,
) -> Comparison:
    """Compare the buildings of a survey with those of the inventory.

    Parameters
    ----------
    before : GeoDataFrame
        Current buildings of the inventory that may lie in the survey, with ``h_p90`` (NaN where unknown).
    after : GeoDataFrame
        Buildings of the survey, with ``h_p90``.
    heights : Grid
        Heights above ground of the survey, metres.
    earlier : sequence of Grid
        Heights above ground that the inventory has of the place, the latest first; none where it began from
        footprints alone.
    levels : Grid, optional
        Levels of the survey above sea, metres, on the lattice of ``heights``; None where its terrain is not known.
    earlier_levels : sequence of Grid or None, optional
        The same of each of ``earlier``; by default none is known.
    surveyed : (H, W) ndarray of bool, optional
        The area of interest on the survey's lattice; all of it by default.
    params : ChangeParams, optional
        Thresholds of change.

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
    """
    params = params or ChangeParams()
    offset = estimate_offset(before, after, least_pairs=params.offset_pairs)
    spec = heights.spec
    known = earlier_heights(earlier, spec, offset)
    rise = np.asarray(heights.values, dtype=np.float32) - np.asarray(known.values)
    rise -= np.float32(offset.dz_m)
    if levels is not None:
        known_levels = [*earlier_levels, *[None] * (len(earlier) - len(earlier_levels))]
        _put_level_rise(rise, levels, earlier, known_levels, offset)
    inside = heights.valid if surveyed is None else heights.valid & surveyed
    shifted = moved(before.geometry.to_numpy(), offset.dx_m, offset.dy_m)
    epochs = Epochs(
        _painted(shifted, spec),
        _painted(after.geometry.to_numpy(), spec),
        inside,
        Grid(rise, known.valid & heights.valid, spec),
        heights,
        known,
    )
    links = Links(before, after, shifted, epochs, find_pieces(epochs, params), params)
    decisions = Decisions(links, offset)
    decisions.decide()
    return Comparison(offset, decisions.changes(), decisions.new_versions())


def _put_level_rise(
    rise: Rise, levels: Grid, earlier: Sequence[Grid], earlier_levels: Sequence[Grid | None], offset: Offset
) -> None:
    """Put the change of level into the given rise above ground, in each cell with an earlier level.

    Two surveys may count their levels from different zeros. Their vertical offset is the change on which most cells
    agree, streets included.
    """
    left = levels.valid.copy()
    for heights, known in zip(earlier, earlier_levels, strict=True):
        before = earlier_heights([heights if known is None else known], levels.spec, offset)
        both = levels.valid & before.valid
        if known is not None and both.any():
            change = np.asarray(levels.values) - np.asarray(before.values)
            change -= _agreed(change[both])
            np.copyto(rise, change, where=both & left)
        left &= ~before.valid


def _agreed(change: Rise) -> np.float32:
    """Return the median of the largest group of changes that lie close together, of equal groups the lowest."""
    ordered = np.sort(change[:: -(-len(change) // ENOUGH_CELLS)])
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
    near = Grid(np.asarray(heights.values)[rows, cols], heights.valid[rows, cols], heights.spec.crop(rows, cols))
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
