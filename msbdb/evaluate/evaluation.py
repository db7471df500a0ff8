"""The evaluation as a whole: both sides on one grid, all measures, one record."""

from dataclasses import asdict, dataclass
from typing import Any

import geopandas as gpd
import numpy as np
import shapely
from numpy.typing import NDArray
from pyproj import CRS
from scipy import ndimage

from msbdb.errors import CRSError, InputError, NodataError, counted
from msbdb.evaluate.agreement import AreaScore, flat, percent, plain, score_area
from msbdb.evaluate.byobject import (
    BoundaryScore,
    HeightScore,
    ObjectScore,
    ShapeScore,
    groups,
    overlaps,
    score_boundary,
    score_heights,
    score_objects,
    score_shape,
    united,
)
from msbdb.evaluate.reference import (
    PointReference,
    PolygonReference,
    Reference,
    Side,
    grid_over,
    horizontal,
    point_side,
    polygon_side,
    polygons,
)
from msbdb.grid import Bounds, Grid, GridSpec, require_metric
from msbdb.labels import EIGHT, sizes
from msbdb.outline.polygons import Geometries, rasterise
from msbdb.params import EvaluateParams

Mask = NDArray[np.bool_]

HEIGHT = "h_p90"
"""Column of ``BUILDING`` that is compared with the reference's heights: the one that gives the storeys."""


@dataclass(frozen=True, slots=True)
class Evaluation:
    """All measures of one comparison.

    Attributes
    ----------
    params : EvaluateParams
        What counted as agreement.
    area : AreaScore
        By area, within the scored cells.
    objects, large_objects : ObjectScore
        By object: all, and those of at least ``params.large_m2``.
    shape : ShapeScore
        Differences in shape between matched buildings.
    boundary : BoundaryScore
        Distances between the outlines of matched buildings.
    heights : HeightScore or None
        None where the reference states no heights.
    """

    params: EvaluateParams
    area: AreaScore
    objects: ObjectScore
    large_objects: ObjectScore
    shape: ShapeScore
    boundary: BoundaryScore
    heights: HeightScore | None

    def as_dict(self) -> dict[str, Any]:
        """Return the measures as nested plain values for JSON; None where a measure is not defined."""
        values: dict[str, Any] = plain(asdict(self))
        return values

    @property
    def sentences(self) -> tuple[str, str, str]:
        """How good it is, for people: by area, by building, and how true outlines and heights are."""
        area, found = self.area.rates, self.objects
        shape = "Outlines: no building of both sides is alike enough to compare outlines."
        if self.shape.buildings:
            far, cap_m = percent(self.boundary.left_out), self.params.cap_m
            shape = (
                f"Outlines: {self.boundary.rms_m.micro:.1f} m off (RMS); {far} of them are farther than {cap_m:g} m."
            )
        if self.heights is not None and self.heights.objects:
            bias_m = self.heights.bias_m
            way = "above" if bias_m >= 0 else "below"
            shape += f" Heights: RMSE {self.heights.rmse_m:.1f} m, on average {abs(bias_m):.1f} m {way} the reference."
        several = (
            f"; {counted(found.fused, 'object')} hold{'s' if found.fused == 1 else ''} several" if found.fused else ""
        )
        return (
            f"Area: {percent(area.quality)} quality. {percent(area.completeness)} of the reference is found, and "
            f"{percent(area.correctness)} of what is found is in the reference.",
            f"Buildings: {found.found:,} of {found.found + found.missed:,} are found, "
            f"{percent(found.rates.completeness)}. {found.false:,} of {found.true + found.false:,} found objects are "
            f"none{several}.",
            shape,
        )

    def rows(self) -> list[tuple[str, str, float | None]]:
        """Return (section, measure, value) of every measure, in order, for tables; the names end in their unit."""
        result: list[tuple[str, str, float | None]] = []
        for section, values in self.as_dict().items():
            if section != "params" and values is not None:
                result += [(section, name, value) for name, value in flat(values)]
        return result


def evaluate(
    extracted: gpd.GeoDataFrame,
    reference: Reference,
    *,
    aoi: gpd.GeoDataFrame | gpd.GeoSeries | None = None,
    valid: Grid | None = None,
    params: EvaluateParams | None = None,
) -> Evaluation:
    """Compare extracted footprints with a reference.

    Parameters
    ----------
    extracted : GeoDataFrame
        Footprints with a projected CRS; heights are read from its column ``h_p90`` where it has one. May be empty.
    reference : PolygonReference or PointReference
        The truth. Polygons and the area of interest are reprojected to the CRS of the footprints; points must be in
        it.
    aoi : GeoDataFrame or GeoSeries, optional
        Only cells whose centre lies in these polygons are scored. Without it, the bounds of both sides (of the
        points, where the reference is points).
    valid : Grid, optional
        Only cells whose centre lies in a valid cell are scored: where the survey has data.
    params : EvaluateParams, optional
        What counts as agreement.

    Returns
    -------
    Evaluation

    Raises
    ------
    CRSError
        When a CRS is missing, not metric, or the points' is another.
    NodataError
        When no cell can be scored.
    InputError
        When the area is too large for the cell, or a side holds no polygon.

    Notes
    -----
    Areas are counted in cells. Of each object the scored part is compared. Objects with less than half of their area in
    scored cells cover others, but are not counted.
    """
    params = params or EvaluateParams()
    crs = _projected(extracted)
    outlines, height = polygons(extracted, crs, "extraction", HEIGHT if HEIGHT in extracted.columns else None)
    area = None if aoi is None else polygons(aoi, crs, "area of interest")[0]
    truth, spec, scored, observed = _truth(reference, outlines, area, crs, params)
    if area is not None:
        scored &= rasterise(area, spec) > 0
    if valid is not None:
        scored &= _sampled(valid, spec)
    if not scored.any():
        msg = "No cell can be scored; check that the reference, the area of interest and the survey overlap."
        raise NodataError(msg)
    return _compared(polygon_side(outlines, height, spec), truth, (scored, scored & observed), spec, params)


def _projected(extracted: gpd.GeoDataFrame) -> CRS:
    """Return the CRS of the footprints, which must be in metres."""
    if extracted.crs is None:
        msg = "The detected buildings have no CRS. Set one before the comparison."
        raise CRSError(msg)
    crs = CRS.from_user_input(extracted.crs)
    require_metric(crs)
    return crs


def _truth(
    reference: Reference, outlines: Geometries, area: Geometries | None, crs: CRS, params: EvaluateParams
) -> tuple[Side, GridSpec, Mask, Mask]:
    """Return the reference's side, the grid, and the cells in which it can judge objects, and areas."""
    if isinstance(reference, PolygonReference):
        footprints, height = polygons(reference.frame, crs, "reference", reference.height)
        bounds = _bounds([outlines, footprints] if area is None else [area])
        spec = grid_over(bounds, params, crs)
        every = np.ones(spec.shape, dtype=np.bool_)
        return polygon_side(footprints, height, spec), spec, every, every.copy()
    _check_points(reference, crs)
    if area is None:
        x, y = reference.easting, reference.northing
        bounds = (float(x.min()), float(y.min()), float(x.max()), float(y.max()))
    else:
        bounds = _bounds([area])
    spec = grid_over(bounds, params, crs)
    side, known, observed = point_side(reference, spec, params)
    return side, spec, known, observed


def _check_points(reference: PointReference, crs: CRS) -> None:
    """Refuse reference points that are none, of unequal lengths, or in another CRS."""
    arrays = (reference.northing, reference.building, reference.first_echo)
    lengths = {len(reference.easting)} | {len(array) for array in arrays if array is not None}
    if len(lengths) > 1:
        msg = f"The reference points' attributes have different lengths: {sorted(lengths)}."
        raise InputError(msg)
    if lengths == {0}:
        msg = "The reference holds no points."
        raise NodataError(msg)
    if horizontal(reference.crs) != horizontal(crs):
        msg = f"The reference points are in '{reference.crs.name}', the extraction in '{crs.name}'; reproject one."
        raise CRSError(msg)


def _bounds(sides: list[Geometries]) -> Bounds:
    """Return the bounds of all geometries."""
    outlines = np.concatenate(sides)
    if not len(outlines):
        msg = "Neither side has a building, and no area of interest with cells is given. Give such an area."
        raise NodataError(msg)
    west, south, east, north = (float(bound) for bound in shapely.total_bounds(outlines))
    return (west, south, east, north)


def _sampled(valid: Grid, spec: GridSpec) -> Mask:
    """Return the cells whose centre lies in a valid cell of another grid."""
    if horizontal(valid.spec.crs) != horizontal(spec.crs):
        msg = f"The validity is in '{valid.spec.crs.name}', the extraction in '{spec.crs.name}'; they must agree."
        raise CRSError(msg)
    return valid.spec.sample(valid.valid, *spec.centres(), outside=False)


def _compared(
    extracted: Side, truth: Side, judged: tuple[Mask, Mask], spec: GridSpec, params: EvaluateParams
) -> Evaluation:
    """Take all measures of two sides on a grid, whose cells judge objects and areas."""
    scored, observed = judged
    labels_e, labels_r = np.where(scored, extracted.labels, 0), np.where(scored, truth.labels, 0)
    counts = (len(extracted.outlines), len(truth.outlines))
    found = overlaps(labels_e, labels_r, counts, spec.cell_area_m2)
    covered = (
        _covered(labels_e, truth.mask, counts[0], spec.cell_area_m2),
        _covered(labels_r, extracted.mask, counts[1], spec.cell_area_m2),
    )
    counted = (extracted.counted(found.extracted_m2), truth.counted(found.reference_m2))
    large = (
        counted[0] & (extracted.area_m2 >= params.large_m2),
        counted[1] & (truth.area_m2 >= params.large_m2),
    )
    group_e, group_r, count = groups(found, params.overlap)
    # Beside a cell that is not scored, an outline may be the edge of the data.
    inner = ndimage.binary_erosion(scored, EIGHT)
    has_heights = np.isfinite(truth.height_m).any()
    return Evaluation(
        params=params,
        area=score_area(extracted.mask, truth.mask, observed, spec.cell_area_m2),
        objects=score_objects(found, counted, covered, params.overlap),
        large_objects=score_objects(found, large, covered, params.overlap),
        shape=score_shape(found, group_e, group_r, count),
        boundary=score_boundary(
            united(extracted.outlines, group_e, count),
            united(truth.outlines, group_r, count),
            inner,
            spec,
            step_m=params.step_m,
            cap_m=params.cap_m,
        ),
        heights=score_heights(found, extracted.height_m, truth.height_m, params.overlap) if has_heights else None,
    )


def _covered(labels: NDArray[np.int32], mask: Mask, count: int, cell_area_m2: float) -> NDArray[np.float64]:
    """Return the area of each object that lies in a mask."""
    return sizes(labels[mask], count).astype(np.float64) * cell_area_m2
