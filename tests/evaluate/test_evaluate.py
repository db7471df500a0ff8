"""Hand-made scenes with known answers."""

import json
import math

import geopandas as gpd
import numpy as np
import pytest
import shapely
from affine import Affine
from pyproj import CRS
from shapely import affinity, box

from msbdb.errors import CRSError, InputError, NodataError, ParameterError
from msbdb.evaluate import PointReference, PolygonReference, evaluate
from msbdb.grid import Grid, GridSpec
from msbdb.params.parts import EvaluateParams

RD = CRS.from_epsg(28992)
E0, N0 = 85_000.0, 447_000.0


def frame(*shapes, crs=RD, **columns):
    """Return polygons, given near the origin, in the Dutch grid."""
    moved = [affinity.translate(shape, E0, N0) for shape in shapes]
    return gpd.GeoDataFrame(columns, geometry=gpd.GeoSeries(moved, crs=RD)).to_crs(crs)


def score(extracted, reference, **options):
    """Evaluate two lists of shapes."""
    return evaluate(frame(*extracted), PolygonReference(frame(*reference)), **options)


def test_equal_sides_are_perfect():
    """A side against itself: every rate 1, every difference 0."""
    houses = [box(0, 0, 10, 10), box(20, 0, 28, 6), box(0, 20, 30, 40) - box(10, 25, 20, 35)]
    result = score(houses, houses)
    for rates in (result.area.rates, result.objects.rates, result.large_objects.rates):
        assert (rates.completeness, rates.correctness, rates.quality) == (1, 1, 1)
        assert (rates.omission, rates.commission) == (0, 0)
    assert (result.objects.found, result.large_objects.found) == (3, 2)
    assert (result.objects.fusion, result.objects.fission) == (0, 0)
    assert result.shape.dissimilarity.micro == result.shape.dissimilarity.macro == 0
    assert result.boundary.rms_m.micro == pytest.approx(0, abs=1e-6)
    assert result.boundary.left_out == 0
    assert result.heights is None


def test_a_shifted_square():
    """A square of 20 m, 2 m to the east: 18/22 of the union is common; the sides that moved are 2 m away."""
    result = score([box(2, 0, 22, 20)], [box(0, 0, 20, 20)])
    area = result.area
    assert (area.reference_m2, area.extracted_m2, area.both_m2) == (400, 400, 360)
    assert (area.reference_only_m2, area.extracted_only_m2) == (40, 40)
    assert area.rates.quality == pytest.approx(18 / 22)
    assert (result.objects.found, result.objects.true) == (1, 1)
    assert result.shape.difference_m2 == 0
    assert result.shape.relative_difference.micro == 0
    assert result.shape.dissimilarity.macro == pytest.approx(80 / 400)
    # Of each outline's 160 samples, the outer side's 40 are 2 m away, and the inner side's but for those nearer to the
    # ends; so are the 2 m of two sides that stick out.
    ends = (np.arange(0.25, 2, 0.5) ** 2).sum()
    expected = math.sqrt((40 * 4 + 32 * 4 + 2 * ends + 2 * ends) / 160)
    assert result.boundary.rms_m.micro == pytest.approx(expected, rel=1e-3)
    assert result.boundary.samples == 320


def test_a_larger_prediction_has_the_differences_of_table_3():
    """V57 for two buildings: means in m2, and relative measures as ratio of sums and as mean of ratios."""
    reference = [box(0, 0, 10, 10), box(50, 0, 70, 20)]
    extracted = [box(0, 0, 12, 10), box(50, 0, 68, 20)]
    shape = score(extracted, reference).shape
    assert shape.buildings == 2
    assert shape.reference_m2 == 250
    assert shape.difference_m2 == 30
    assert shape.reference_only_m2 == 20
    assert shape.extracted_only_m2 == 10
    assert shape.relative_difference.micro == pytest.approx(60 / 500)
    assert shape.relative_difference.macro == pytest.approx((0.2 + 0.1) / 2)
    assert shape.dissimilarity.micro == pytest.approx(60 / 500)
    assert shape.completeness.micro == pytest.approx(460 / 500)
    assert shape.completeness.macro == pytest.approx((1 + 0.9) / 2)
    assert shape.correctness.macro == pytest.approx((100 / 120 + 1) / 2)


def test_a_merged_row_is_found_and_counts_as_fusion():
    """Three houses in one polygon: all found, one of one extracted is fused, and they are one building by shape."""
    row = [box(0, 0, 8, 10), box(8, 0, 16, 10), box(16, 0, 24, 10)]
    result = score([box(0, 0, 24, 10)], row)
    assert (result.objects.found, result.objects.missed, result.objects.true, result.objects.false) == (3, 0, 1, 0)
    assert (result.objects.fused, result.objects.fusion) == (1, 1.0)
    assert (result.objects.split, result.objects.fission) == (0, 0.0)
    assert result.shape.buildings == 1
    assert result.shape.dissimilarity.micro == 0
    assert result.boundary.rms_m.micro == pytest.approx(0, abs=1e-6)


def test_a_split_house_is_found_and_counts_as_fission():
    """One house in two polygons, beside a good one: found, both true, one of two reference objects is split."""
    result = score([box(0, 0, 10, 10), box(10, 0, 20, 10), box(40, 0, 50, 10)], [box(0, 0, 20, 10), box(40, 0, 50, 10)])
    assert (result.objects.found, result.objects.true) == (2, 3)
    assert (result.objects.split, result.objects.fission) == (1, 0.5)
    assert (result.objects.fused, result.objects.fusion) == (0, 0.0)


def test_a_grazing_neighbour_is_no_fusion():
    """A polygon that takes a corner of the next house is not fused with it."""
    result = score([box(0, 0, 13, 10)], [box(0, 0, 10, 10), box(10, 0, 20, 10)])
    assert (result.objects.found, result.objects.missed, result.objects.fused) == (1, 1, 0)
    assert result.shape.buildings == 1


def test_the_overlap_criterion_decides():
    """Just half covered counts at 0.5, and not at 0.6."""
    extracted, reference = [box(0, 0, 10, 10)], [box(5, 0, 15, 10)]
    assert score(extracted, reference).objects.rates.quality == 1
    stricter = score(extracted, reference, params=EvaluateParams(overlap=0.6)).objects
    assert (stricter.found, stricter.missed, stricter.true, stricter.false) == (0, 1, 0, 1)
    assert stricter.rates.quality == 0


def test_small_objects_are_left_out_of_the_large_ones():
    """Of a hall, a missed shed and a false shed, only the hall is of 50 m2 or more."""
    result = score([box(0, 0, 20, 20), box(40, 0, 44, 4)], [box(0, 0, 20, 20), box(60, 0, 64, 4)])
    assert (result.objects.found, result.objects.missed, result.objects.false) == (1, 1, 1)
    assert (result.large_objects.found, result.large_objects.missed, result.large_objects.false) == (1, 0, 0)
    assert result.objects.rates.quality == pytest.approx(1 / 3)
    assert result.large_objects.rates.quality == 1


def test_large_is_judged_against_all_objects():
    """A large object that small ones cover is found."""
    halves = [box(0, 0, 6, 8), box(6, 0, 12, 8)]
    assert score(halves, [box(0, 0, 12, 8)]).large_objects.found == 1


def test_no_prediction_and_no_reference():
    """Nothing extracted is completeness 0; nothing there is correctness 0; undefined values are None in JSON."""
    house = [box(0, 0, 10, 10)]
    missed = score([], house).as_dict()
    assert (missed["area"]["rates"]["completeness"], missed["area"]["rates"]["correctness"]) == (0, None)
    assert (missed["objects"]["missed"], missed["objects"]["rates"]["quality"]) == (1, 0)
    assert missed["boundary"]["rms_m"] == {"micro": None, "macro": None}
    assert missed["shape"]["difference_m2"] is None
    false = score(house, []).as_dict()
    assert (false["area"]["rates"]["completeness"], false["area"]["rates"]["correctness"]) == (None, 0)
    assert false["objects"]["false"] == 1
    both = score([], [], aoi=frame(box(0, 0, 9, 9))).as_dict()
    assert both["area"]["scored_m2"] == 81
    assert both["area"]["rates"]["quality"] is None
    json.dumps([missed, false, both], allow_nan=False)


def test_only_the_area_of_interest_is_scored():
    """Areas stop at its edge; an object counts with at least half of its area inside."""
    reference = [box(0, 0, 10, 10), box(20, 0, 30, 10), box(36, 0, 46, 10), box(80, 0, 90, 10)]
    result = score(reference[:1] + reference[2:3], reference, aoi=frame(box(0, 0, 40, 10)))
    assert result.area.scored_m2 == 400
    assert (result.area.reference_m2, result.area.both_m2) == (240, 140)
    assert (result.objects.found, result.objects.missed) == (1, 1)
    assert result.objects.true == 1
    # The edge of the area of interest cuts the third house; no sample lies on the cut or next to it.
    assert result.boundary.rms_m.micro == pytest.approx(0, abs=1e-6)


def test_a_validity_mask_leaves_cells_out():
    """Where the survey has no data nothing is scored, on whatever lattice the validity is."""
    spec = GridSpec((10, 20), Affine(2, 0, E0, 0, -2, N0 + 20), RD)
    valid = np.ones(spec.shape, dtype=np.bool_)
    valid[:, 5:] = False
    survey = Grid(np.zeros(spec.shape, dtype=np.float32), valid, spec)
    result = score([box(0, 0, 10, 10)], [box(0, 0, 10, 10), box(20, 0, 30, 10)], valid=survey)
    assert result.area.rates.quality == 1
    assert (result.area.scored_m2, result.objects.missed) == (110, 0)


def test_nothing_to_score_is_an_error():
    """Neither side, an area of interest elsewhere, or no valid cell: NodataError."""
    house = [box(0, 0, 10, 10)]
    with pytest.raises(NodataError, match="Neither side has a building"):
        score([], [])
    spec = GridSpec((5, 5), Affine(2, 0, E0 + 900, 0, -2, N0), RD)
    elsewhere = Grid(np.zeros(spec.shape, dtype=np.float32), np.ones(spec.shape, dtype=np.bool_), spec)
    with pytest.raises(NodataError, match="No cell can be scored"):
        score(house, house, valid=elsewhere)
    with pytest.raises(NodataError, match="No first echo"):
        evaluate(frame(*house), points([box(0, 0, 10, 10)]), aoi=frame(box(500, 0, 600, 90)))


def test_reprojected_references_agree():
    """A reference in degrees and an area of interest in another zone come to the footprints' CRS."""
    houses = [box(0, 0, 20, 20), box(40, 0, 60, 30)]
    result = evaluate(
        frame(*houses), PolygonReference(frame(*houses, crs=4326)), aoi=frame(box(-5, -5, 90, 40), crs=32631)
    )
    assert result.area.rates.quality > 0.99
    assert result.boundary.rms_m.micro < 0.01
    compound = evaluate(frame(*houses).set_crs(7415, allow_override=True), PolygonReference(frame(*houses)))
    assert compound.area.rates.quality == 1


def test_broken_and_foreign_geometries_are_repaired_or_left_out():
    """A bow tie is repaired; null, empty and point geometries do not count."""
    bow_tie = shapely.Polygon([(0, 0), (10, 10), (10, 0), (0, 10)])
    reference = gpd.GeoDataFrame(
        geometry=[affinity.translate(bow_tie, E0, N0), None, shapely.Polygon(), shapely.Point(E0, N0)], crs=RD
    )
    result = evaluate(frame(box(0, 0, 10, 10)), PolygonReference(reference))
    assert result.area.reference_m2 == pytest.approx(50, abs=3)
    assert result.objects.found + result.objects.missed == 1
    with pytest.raises(InputError, match="1 geometries but no polygon"):
        evaluate(frame(box(0, 0, 9, 9)), PolygonReference(reference[3:]))


def test_overlapping_references_share_no_cell():
    """Where two footprints overlap the smaller one has the cells, and the area counts once."""
    result = score([box(0, 0, 20, 20)], [box(0, 0, 20, 20), box(0, 0, 5, 5)])
    assert result.area.reference_m2 == 400
    assert result.objects.found == 2
    assert result.objects.fused == 1


def test_heights_are_compared_where_the_reference_has_them():
    """RMSE and bias over matched objects; the fused one is compared with both of its references."""
    extracted = frame(box(0, 0, 20, 10), box(40, 0, 50, 10), h_p90=[9.0, 4.0])
    reference = frame(
        box(0, 0, 10, 10), box(10, 0, 20, 10), box(40, 0, 50, 10), box(70, 0, 80, 10), top=[10, 6, None, 5]
    )
    result = evaluate(extracted, PolygonReference(reference, height="top"))
    assert result.heights.objects == 2
    assert result.heights.rmse_m == pytest.approx(math.sqrt((1 + 9) / 2))
    assert result.heights.bias_m == pytest.approx(1.0)
    with pytest.raises(InputError, match="no column 'height'; it has top"):
        evaluate(extracted, PolygonReference(reference, height="height"))


def test_far_samples_are_left_out_and_counted():
    """A courtyard that the extraction closed has no counterpart: its ring does not enter the RMS."""
    block = box(0, 0, 40, 40)
    result = score([block], [block - box(10, 10, 30, 30)])
    assert result.boundary.rms_m.micro == pytest.approx(0, abs=1e-6)
    assert result.boundary.left_out == pytest.approx(80 / (160 + 160 + 80))


def points(buildings, size=(40.0, 20.0), spacing=0.25, every=1.0):
    """Return classified points on a regular raster, of which every n-th is a first echo."""
    east, north = np.meshgrid(np.arange(spacing / 2, size[0], spacing), np.arange(spacing / 2, size[1], spacing))
    east, north = east.ravel() + E0, north.ravel() + N0
    inside = np.zeros(len(east), dtype=np.bool_)
    for shape in buildings:
        inside |= shapely.contains_xy(affinity.translate(shape, E0, N0), east, north)
    return PointReference(east, north, inside, RD, np.arange(len(east)) % every == 0)


def test_classified_points_are_a_reference():
    """Dense points give back the truth by area and by object; a tiny cluster is area but no object."""
    houses = [box(2, 2, 12, 12), box(20, 2, 30, 12), box(36, 2, 37, 3)]
    result = evaluate(frame(*houses), points(houses))
    assert (result.area.reference_m2, result.area.rates.quality) == (201, 1)
    assert (result.objects.found, result.objects.missed, result.objects.true) == (2, 0, 3)
    assert result.boundary.rms_m.micro < 0.05


def test_cells_far_from_points_are_not_scored():
    """A house over a gap in the points is neither right nor wrong where the gap is wider than 1 m."""
    reference = points([box(2, 2, 12, 12)])
    kept = ~((reference.easting > E0 + 20) & (reference.easting < E0 + 30))
    gappy = PointReference(reference.easting[kept], reference.northing[kept], reference.building[kept], RD)
    result = evaluate(frame(box(2, 2, 12, 12), box(21, 2, 29, 12)), gappy)
    assert result.area.rates.quality == 1
    assert (result.objects.true, result.objects.false) == (1, 0)
    observed = {(int(x // 0.5), int(y // 0.5)) for x, y in zip(gappy.easting, gappy.northing, strict=True)}
    assert result.area.scored_m2 == pytest.approx(len(observed) * 0.25), (
        "areas count where there are points, no further"
    )


def test_first_echoes_alone_decide():
    """A cell of a building first echo and two other ground echoes is building; a tie of first echoes is, too."""
    east = np.full(3, E0 + 5.1)
    north = np.full(3, N0 + 5.1)
    building = np.array([True, False, False])
    params = EvaluateParams(max_gap_m=0, min_object_m2=0)
    first = PointReference(east, north, building, RD, np.array([True, False, False]))
    assert evaluate(frame(box(0, 0, 9, 9)), first, params=params).area.reference_m2 == 0.25
    other = PointReference(east, north, building, RD, np.array([False, True, True]))
    assert evaluate(frame(box(0, 0, 9, 9)), other, params=params).area.reference_m2 == 0
    half = PointReference(east[:2], north[:2], building[:2], RD)
    assert evaluate(frame(box(0, 0, 9, 9)), half, params=params).area.reference_m2 == 0.25
    none = PointReference(east, north, building, RD, np.zeros(3, dtype=np.bool_))
    with pytest.raises(NodataError, match="No first echo"):
        evaluate(frame(box(0, 0, 9, 9)), none, params=params)


def test_components_that_touch_at_a_corner_are_one_object():
    """Reference objects are 8-connected."""
    result = evaluate(frame(box(2, 2, 12, 12)), points([box(2, 2, 7, 7), box(7, 7, 12, 12)]))
    assert result.objects.found + result.objects.missed == 1


def test_point_references_are_checked():
    """No points, unequal lengths and another CRS are errors."""
    house = frame(box(0, 0, 9, 9))
    good = points([box(0, 0, 9, 9)])
    with pytest.raises(CRSError, match="reproject one"):
        evaluate(house, PointReference(good.easting, good.northing, good.building, CRS.from_epsg(32631)))
    with pytest.raises(InputError, match="different lengths"):
        evaluate(house, PointReference(good.easting, good.northing[:5], good.building, RD))
    nothing = np.empty(0)
    with pytest.raises(NodataError, match="no points"):
        evaluate(house, PointReference(nothing, nothing, nothing.astype(np.bool_), RD))


def test_crs_size_and_bounds_are_checked():
    """A missing or geographic CRS, an area beyond the grid's limit and parameters out of bounds are errors."""
    house = frame(box(0, 0, 9, 9))
    with pytest.raises(CRSError, match="reference has no CRS"):
        evaluate(house, PolygonReference(house.set_crs(None, allow_override=True)))
    with pytest.raises(CRSError, match="detected buildings have no CRS"):
        evaluate(house.set_crs(None, allow_override=True), PolygonReference(house))
    with pytest.raises(CRSError, match="projected"):
        evaluate(house.to_crs(4326), PolygonReference(house))
    with pytest.raises(InputError, match="Give an area of interest"):
        evaluate(house, PolygonReference(frame(box(0, 0, 1, 1), box(90_000, 90_000, 90_009, 90_009))))
    with pytest.raises(ParameterError, match="overlap must lie between"):
        EvaluateParams(overlap=0)
    with pytest.raises(ParameterError, match="cell_m"):
        EvaluateParams(cell_m=float("nan"))


def test_rows_name_every_measure_once():
    """The table has one row a measure, without the parameters, and the same values as the dictionary."""
    result = score([box(0, 0, 10, 10)], [box(0, 0, 10, 10)])
    rows = result.rows()
    names = [(section, name) for section, name, _ in rows]
    assert len(names) == len(set(names))
    values = {(section, name): value for section, name, value in rows}
    assert values["area", "quality"] == 1
    assert values["large_objects", "completeness"] == 1
    assert values["shape", "dissimilarity.macro"] == 0
    assert "heights" not in {section for section, _ in names}
    assert result.as_dict()["params"]["cell_m"] == 0.5


def test_the_order_of_the_objects_does_not_matter():
    """Shuffled frames and points give the same evaluation."""
    rng = np.random.default_rng(4)
    houses = [
        box(x, y, x + w, y + 9)
        for x, y, w in zip(range(0, 300, 15), rng.integers(0, 30, 20), rng.integers(5, 20, 20), strict=True)
    ]
    moved = [affinity.translate(house, rng.uniform(-2, 2), rng.uniform(-2, 2)) for house in houses]
    first = score(moved, houses)
    again = score(moved[::-1], houses[::-1])
    assert first.as_dict()["objects"] == again.as_dict()["objects"]
    assert [value for *_, value in first.rows()] == pytest.approx([value for *_, value in again.rows()])
    cloud = points(houses[:3])
    order = rng.permutation(len(cloud.easting))
    shuffled = PointReference(
        cloud.easting[order], cloud.northing[order], cloud.building[order], RD, cloud.first_echo[order]
    )
    assert evaluate(frame(*moved[:3]), cloud).as_dict() == evaluate(frame(*moved[:3]), shuffled).as_dict()
