"""The extraction by clustering as a whole: clouds with known answers, bad input, and real tiles."""

import os
from dataclasses import replace
from functools import cache
from itertools import pairwise
from pathlib import Path

import geopandas as gpd
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pyproj import CRS
from simulated.scenes import BUILDING, courtyard, under_trees
from support.notices import with_notices

from msbdb.detect.adaptive.bathurst import extract_adaptive, ladder
from msbdb.detect.adaptive.offground import OffGround, classify_vegetation, off_ground, structure
from msbdb.detect.adaptive.surroundings import plane_residuals
from msbdb.errors import InputError
from msbdb.evaluate import PointReference, evaluate
from msbdb.grid import lattice
from msbdb.ground.choice import terrain
from msbdb.io.las import read_points
from msbdb.outline.pointoutlines import outline_regions
from msbdb.params import Params, profile, with_values
from msbdb.points.cloud import PointCloud
from msbdb.surface.gridding import cell_size, density
from msbdb.surface.heights import heights_above
from msbdb.surveyplan import LEAST_TRUST
from msbdb.tables import CANDIDATE_REGION, REJECTION

UTM = CRS.from_epsg(32633)
SPACING = 0.5
WEST, SOUTH = 389_000.0, 5_821_000.0


def plane(west, south, width, depth, height, *, seed=0, slope=0.0):
    """Return jittered points of a plane roof or of the ground: x, y, z."""
    rng = np.random.default_rng(seed)
    x, y = np.meshgrid(np.arange(0, width, SPACING), np.arange(0, depth, SPACING))
    x, y = x.ravel() + rng.uniform(0, SPACING, x.size), y.ravel() + rng.uniform(0, SPACING, x.size)
    z = height + slope * x + rng.normal(0, 0.02, x.size)
    inside = (x <= width) & (y <= depth)
    return np.column_stack((west + x, south + y, z))[inside]


def crown(west, south, radius, height, *, seed=0):
    """Return points scattered all through a ball."""
    rng = np.random.default_rng(seed)
    count = int(4 * np.pi * radius**2 * 3)
    points = rng.normal(size=(count, 3))
    points *= radius * rng.uniform(0.2, 1, (count, 1)) ** (1 / 3) / np.linalg.norm(points, axis=1, keepdims=True)
    return points + np.array([west, south, height])


def cloud_of(roofs, crowns=(), *, ground=(0, 0, 60, 50), echoes=True, shift=(WEST, SOUTH)):
    """Return a cloud of level ground, roofs and crowns; the pulses of crowns have several echoes."""
    parts = [plane(*ground, 0.0, seed=99), *roofs, *crowns]
    several = np.repeat([False, *[False for _ in roofs], *[True for _ in crowns]], [len(p) for p in parts])
    points = np.concatenate(parts)
    returns = np.where(several, 3, 1).astype(np.uint8) if echoes else None
    first = np.ones(len(points), dtype=np.uint8) if echoes else None
    x, y = points[:, 0] + shift[0], points[:, 1] + shift[1]
    return PointCloud(x, y, points[:, 2], UTM, return_number=first, number_of_returns=returns)


def extract(cloud, params=None, *, heights=None, ndvi=None):
    """Extract on a lattice of half a metre; the ground is level at 0."""
    heights = cloud.z if heights is None else heights
    spec = lattice(cloud.bounds, 0.5, cloud.crs)
    return extract_adaptive(cloud, heights, spec=spec, survey="test", params=params or Params(), ndvi=ndvi)


def outlines_of(cloud, found, params=None):
    """Return the outlines of candidates."""
    inside = np.flatnonzero(found.labels)
    return outline_regions(
        cloud.x[inside],
        cloud.y[inside],
        found.labels[inside],
        len(found.regions),
        spacing_m=1 / np.sqrt(density(cloud)),
        params=(params or Params()).vector,
    )


def check(cloud, found):
    """Check what holds of every result: declared tables, labels that fit the rows, and ledger that balance."""
    for frame, table in ((found.regions, CANDIDATE_REGION), (found.rejections, REJECTION)):
        assert list(frame.columns) == table.names
        assert {c.name: c.dtype for c in table.columns if c.dtype != "str"}.items() <= {
            name: str(dtype) for name, dtype in frame.dtypes.items()
        }.items()
    regions = found.regions
    assert found.labels.shape == (len(cloud),)
    assert (np.bincount(found.labels, minlength=len(regions) + 1)[1:] == regions["points"]).all()
    assert regions["candidate_id"].is_unique
    assert regions["candidate_id"].is_monotonic_increasing
    large = found.rejections["area_m2"] >= Params().fuse.piece_m2
    assert found.rejections["region_id"][large].is_unique
    assert ((found.rejections["region_id"] > 0) == large).all()
    counts = list(found.counts.values())
    assert set(found.rejections["method"]) <= {"adaptive"}
    assert all(count["in"] == count["kept"] + count["dropped"] for count in counts)
    assert all(a["kept"] + b["pieces"] == b["in"] for a, b in pairwise(counts))
    assert counts[-1]["kept"] == len(regions)
    assert sum(count["dropped"] for count in counts) == len(found.rejections)


HOUSE = plane(10, 10, 12, 9, 6.0, seed=1)
ELL = np.concatenate([plane(30, 10, 16, 6, 5.0, seed=2), plane(30, 16, 6, 10, 5.0, seed=3)])
TREE = crown(20, 38, 4, 7, seed=4)


def test_a_roof_is_one_region_with_its_attributes():
    """Number of points, area, height and rectangularity are those of the house."""
    cloud = cloud_of([HOUSE])
    found = extract(cloud)
    check(cloud, found)
    (row,) = found.regions.itertuples()
    assert (row.method, row.rule, row.perimeter) == ("adaptive", "clustering", 0)
    assert abs(row.points - len(HOUSE)) <= 2
    assert abs(row.area_m2 / (12 * 9) - 1) < 0.6  # ground below the roof is seen as well, and shares its area
    assert abs(row.mbr_m2 / (12 * 9) - 1) < 0.15
    assert abs(row.h_p50 - 6.0) < 0.05
    assert abs(row.xcen - WEST - 16) < 0.3
    assert abs(row.ycen - SOUTH - 14.5) < 0.3
    assert np.isnan([row.height_scale_m, row.compactness, row.linearity, row.direction_1, row.ndvi]).all()


def test_areas_are_those_of_the_roofs_where_they_hide_the_ground():
    """Without points below the roofs, the local density gives the roofs' areas."""
    cloud = cloud_of([HOUSE, ELL])
    hidden = (cloud.z < 1) & ((abs(cloud.x - WEST - 16) < 6) & (abs(cloud.y - SOUTH - 14.5) < 4.5))
    cloud = cloud.take(~hidden)
    areas = extract(cloud).regions
    house = areas[abs(areas["xcen"] - WEST - 16) < 1]
    assert abs(house["area_m2"].iloc[0] / 108 - 1) < 0.1


def test_a_courtyard_stays_open_in_the_outline():
    """A roof around a court is one region, whose outline has the court as a hole."""
    wings = [plane(10, 10, 24, 7, 6, seed=1), plane(10, 27, 24, 7, 6, seed=2)]
    wings += [plane(10, 17, 7, 10, 6, seed=3), plane(27, 17, 7, 10, 6, seed=4)]
    cloud = cloud_of(wings)
    found = extract(cloud)
    check(cloud, found)
    (outline,) = outlines_of(cloud, found)
    assert sum(len(part.interiors) for part in outline.geoms) == 1
    assert abs(outline.area / (24 * 24 - 100) - 1) < 0.1


@pytest.mark.parametrize("echoes", [True, False])
def test_a_tree_is_no_region_but_a_row_of_the_ledger(echoes):
    """A crown is vegetation by its echoes and its surface, or by its surface alone."""
    cloud = cloud_of([HOUSE], [TREE], echoes=echoes)
    found = extract(cloud)
    check(cloud, found)
    assert len(found.regions) == 1
    near = found.rejections[np.hypot(found.rejections["xcen"] - WEST - 20, found.rejections["ycen"] - SOUTH - 38) < 3]
    assert len(near)
    assert near["stage"].isin(list(found.counts)).all()


def off_ground_points(points, split, spacing_m=SPACING, typical_m=0.0, step_m=0.0):
    """Return (N, 3) points as off-ground points."""
    x, y, z = points.T
    some = np.zeros(len(x), dtype=np.int64)
    area = np.full(len(x), spacing_m**2)
    known = (
        some,
        x,
        y,
        z,
        np.zeros(2),
        z,
        area,
        np.broadcast_to(split, len(x)),
        np.ones(1, dtype=np.float32),
        None,
        None,
        some,
    )
    return OffGround(*known, spacing_m, typical_m or spacing_m, step_m)


@pytest.mark.parametrize("trust", [0.0, 0.5, 1.0])
def test_single_echoes_of_leaves_are_a_roof_only_where_they_are_trusted(trust):
    """A plane is a roof by any sensor; a crown without a split echo passes for one where crowns split pulses."""
    params = Params().adaptive
    kinds = []
    for points in (HOUSE, TREE):
        known = replace(off_ground_points(points, split=False), echo_trust=np.float32([trust]))
        kinds.append(np.mean(classify_vegetation(known, structure(known, params), params) > 0))
    assert kinds == [0, float(trust < 1)]


def test_split_echoes_count_for_more_by_a_sensor_that_splits_fewer():
    """By half of the trust a fifth of split echoes counts as two fifths; below `LEAST_TRUST` no more than by that."""
    params, split = Params().adaptive, np.arange(len(TREE)) % 5 == 0
    shares = []
    for trust in (1.0, 0.5, LEAST_TRUST, 0.0):
        known = replace(off_ground_points(TREE, split=split), echo_trust=np.float32([trust]))
        shares.append(structure(known, params).split)
    assert shares[0].max() < 0.4  # so that half of the trust reaches no more than all
    np.testing.assert_allclose(shares[1], 2 * shares[0], rtol=1e-6)
    np.testing.assert_allclose(shares[2], np.minimum(shares[0] / LEAST_TRUST, 1), rtol=1e-6)
    np.testing.assert_array_equal(shares[3], shares[2])


def test_single_echoes_are_trusted_where_later_ones_are_recorded():
    """Each off-ground point has the trust of its own place, whatever the order; without the map all have the same."""
    x, y, z = (np.random.default_rng(3).uniform(0, most, 400) for most in (50, 50, 9))
    echoes = {"return_number": np.ones(400, np.uint8), "number_of_returns": np.repeat(np.uint8([2, 1]), 200)}
    cloud = PointCloud(x + WEST, y + SOUTH, z, UTM, **echoes)
    given = {"spec": lattice(cloud.bounds, 0.5, UTM), "mask_m": 2.0}
    recorded = (x / 50).astype(np.float32)
    points = off_ground(cloud, z, None, None, recorded=recorded, **given)
    np.testing.assert_allclose(points.echo_trust, (points.x + points.origin[0] - WEST) / 50, atol=1e-5)
    assert set(off_ground(cloud, z, None, None, **given).echo_trust) == {1}


def test_noise_makes_no_roof_rough_and_no_crown_smooth():
    """With 0.16 m of noise a roof scatters as a crown. What bare ground shows of it is taken off; a crown stays one."""
    noise_m, params = np.float32(0.16), Params().adaptive
    level = []
    for points in (HOUSE, TREE):
        noisy = points + np.random.default_rng(7).normal(0, noise_m, (len(points), 1)) * (0, 0, 1)
        alone = off_ground_points(noisy, split=False)
        known = replace(alone, noise_m=np.full(len(points), noise_m))
        level.append([float(np.median(structure(each, params).level)) for each in (alone, known)])
    (roof_alone, roof), (_, leaves) = level
    assert roof_alone < 0.4
    assert roof > 0.8
    assert leaves < 0.5


def test_split_echoes_count_on_rough_surfaces_alone():
    """A plane of which each echo is split is glass and stays; a crown of the same echoes goes."""
    params = Params().adaptive
    roof, leaves = off_ground_points(HOUSE, split=True), off_ground_points(TREE, split=True)
    assert not classify_vegetation(roof, structure(roof, params), params).any()
    assert (classify_vegetation(leaves, structure(leaves, params), params) > 0).all()
    # With limits that no surface reaches, the plane would go as well.
    leafy = replace(params, leaf_level=1.0, glass_level=2.0)
    assert np.mean(classify_vegetation(roof, structure(roof, leafy), leafy) > 0) > 0.9


def test_narrow_gables_are_level_in_small_spheres_alone():
    """Most points of a roof 5 m wide lie farther from ridge and eaves than 0.8 m, but few farther than 2 m."""
    rng = np.random.default_rng(1)
    x, y = rng.uniform(0, 20, 3200), rng.uniform(0, 20, 3200)
    gables, crown = (
        off_ground_points(np.column_stack((x, y, z)), split=False, spacing_m=0.35)
        for z in (6 + np.abs(y % 5 - 2.5), 6 + rng.uniform(0, 2, x.size))
    )
    params = Params().adaptive
    assert structure(gables, params).level.mean() > 0.6
    assert structure(crown, params).level.mean() < 0.05
    assert structure(gables, replace(params, surface_least_m=2.0)).level.mean() < 0.35


def test_a_gable_of_sparse_points_is_level_and_a_crown_of_them_is_not():
    """Two metres apart, neighbours lie on both sides of the ridge of a house 10 m wide."""
    rng = np.random.default_rng(1)
    x, y = rng.uniform(0, 40, 200), rng.uniform(0, 20, 200)
    params = Params().adaptive
    levels = []
    for z in (6 + 0.25 * np.abs(y % 10 - 5), 6 + rng.uniform(0, 4, x.size)):
        points = off_ground_points(np.column_stack((x, y, z)), split=False, spacing_m=2.0)
        levels.append(structure(points, params).level.mean())
    assert levels[0] > 0.7
    assert levels[1] < 0.2


def test_a_roof_in_the_sparse_part_of_a_survey_is_level():
    """A dense strip elsewhere halves the mean spacing: spheres of it hold too few points for a plane."""
    x, y = (place.ravel() for place in np.meshgrid(np.arange(0.0, 20, 2), np.arange(0.0, 20, 2)))
    roof = np.column_stack((x, y, np.full(x.size, 6.0)))
    params = Params().adaptive
    lost, found = (off_ground_points(roof, split=False, spacing_m=1.0, typical_m=spacing) for spacing in (1.0, 2.0))
    assert structure(lost, params).level.max() == 0
    assert structure(found, params).level.min() == 1


def test_a_crown_on_scan_lines_far_apart_is_rough():
    """The points of one line lie on an upright plane, whatever they hit; spheres must reach the next line."""
    x, y = (place.ravel() for place in np.meshgrid(np.arange(0.0, 20, 0.2), np.arange(0.0, 20, 2)))
    crown = np.column_stack((x, y, np.random.default_rng(1).uniform(6, 9, x.size)))
    params = Params().adaptive
    passed, found = (off_ground_points(crown, split=False, spacing_m=0.63, step_m=step) for step in (0.0, 2.4))
    assert structure(passed, params).level.min() > 0.9
    assert structure(found, params).level.max() < 0.1


def test_points_without_a_plane_are_not_rough():
    """On two lines of a scanner, far apart, few points have neighbours enough; these alone decide the level."""
    lines = np.array([(x, y, 6.0) for y in (0.0, 2.0) for x in np.arange(0, 20, 1.0)])
    patch = np.array([(x, y, 6.0) for y in (0.8, 1.0, 1.2) for x in (9.0, 9.3, 9.6)])
    points = off_ground_points(np.concatenate([lines, patch]), split=False)
    params = Params().adaptive
    found = structure(points, params)
    near = np.hypot(points.x - 9.3, points.y - 1.0) < 1.5
    np.testing.assert_allclose(found.level[near], 1.0)
    # Nothing is known where no point around has a plane.
    np.testing.assert_array_equal(found.level[points.x < 4], 0.0)


def test_roofs_are_one_region_or_two_by_the_distance_between_them():
    """Nearer than the last step's distance they are joined, farther they are not."""
    cloud = cloud_of([HOUSE])
    distance_m = ladder(Params().adaptive, 1 / np.sqrt(density(cloud)))[-1].distance_m
    for gap, regions in ((distance_m * 0.4, 1), (distance_m * 2.5, 2)):
        cloud = cloud_of([plane(10, 10, 10, 8, 6, seed=1), plane(20 + gap, 10, 10, 8, 6, seed=2)])
        assert len(extract(cloud).regions) == regions


def test_each_step_is_at_least_as_hard_as_the_one_before():
    """Distances fall, and thresholds rise, from the first given value to the last."""
    steps = ladder(Params().adaptive, 0.8)
    assert len(steps) == Params().adaptive.steps
    for one, other in pairwise(steps):
        assert other.distance_m <= one.distance_m
        for name in ("points", "area_m2", "height_m", "level", "level_per_split"):
            assert getattr(other, name) >= getattr(one, name)


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"area_m2": [4.0, 500.0]}, "m2"),
        ({"height_m": [2.0, 9.0]}, "lower than"),
        ({"points": [3.0, 900_000.0]}, "points"),
        ({"width_m": [0.0, 50.0]}, "narrower"),
        ({"level_shares": [0.0, 1.0], "level_m": 0.02, "least_odds": -50.0}, "level to less"),
    ],
)
def test_the_ledger_says_which_step_and_threshold(changes, reason):
    """A roof that fails a threshold is recorded under its step, with the threshold in words."""
    cloud = cloud_of([HOUSE])
    found = extract(cloud, with_values(Params(), {"adaptive": changes}))
    check(cloud, found)
    assert found.regions.empty
    assert found.rejections["reason"].str.contains(reason).any()
    assert found.rejections["stage"].str.startswith("step").any()


def test_ndvi_removes_a_smooth_hedge_and_spares_a_planted_roof():
    """Green points go where the surface is not level; NDVI is given in the rows."""
    rng = np.random.default_rng(8)
    hedge = plane(35, 25, 12, 8, 3.0, seed=5) + np.column_stack(
        (np.zeros(384), np.zeros(384), rng.normal(0, 0.08, 384))
    )
    planted = plane(10, 30, 12, 9, 6.0, seed=6)
    cloud = cloud_of([HOUSE, hedge, planted])
    green = np.zeros(len(cloud), dtype=np.float32) - 0.1
    start = len(cloud) - len(planted) - len(hedge)
    green[start:] = 0.6
    without, found = extract(cloud), extract(cloud, ndvi=green + rng.normal(0, 0.02, len(cloud)).astype(np.float32))
    check(cloud, found)
    assert len(without.regions) == 3
    assert len(found.regions) == 2
    assert found.rejections["reason"].str.contains("NDVI").any()
    assert sorted(found.regions["ndvi"].round(1)) == [-0.1, 0.6]
    unknown = extract(cloud, ndvi=np.full(len(cloud), np.nan, dtype=np.float32))
    assert (unknown.labels == without.labels).all()


@pytest.mark.parametrize("radius_m", [1.2, 2.0, 5.0])
def test_noise_is_as_rough_among_few_points_as_among_many(radius_m):
    """Noise of 0.05 m over a slope has a mean squared residual of 0.0025 m2 among five points and among eighty."""
    rng = np.random.default_rng(4)
    x, y = rng.uniform(0, 100, (2, 10_000))
    residual = plane_residuals(x, y, 0.2 * x + rng.normal(0, 0.05, x.size), radius_m)
    # Across the slope the noise is shorter by its cosine, and the best plane of few points tilts a little towards it.
    assert np.mean(residual[np.isfinite(residual)] ** 2) == pytest.approx(0.0025 / 1.04, rel=0.08)


def test_the_order_of_points_does_not_matter():
    """Shuffled, duplicates included: the same rows, ledger and labels of the points."""
    cloud = cloud_of([HOUSE, ELL], [TREE])
    cloud = cloud.take(np.concatenate((np.arange(len(cloud)), np.arange(0, len(cloud), 7))))
    ndvi = np.random.default_rng(1).uniform(-0.2, 0.1, len(cloud)).astype(np.float32)
    order = np.random.default_rng(2).permutation(len(cloud))
    one, other = extract(cloud, ndvi=ndvi), extract(cloud.take(order), ndvi=ndvi[order])
    assert one.regions.equals(other.regions)
    assert one.rejections.equals(other.rejections)
    assert one.counts == other.counts
    assert (one.labels[order] == other.labels).all()


@pytest.mark.parametrize("shift", [(0.0, 0.0), (10_000_000.0, 10_000_000.0)])
def test_offsets_change_no_region(shift):
    """At ten million metres the regions have the same points as at the usual place."""
    near, far = (cloud_of([HOUSE, ELL], [TREE], shift=at) for at in ((WEST, SOUTH), shift))
    assert ((extract(near).labels > 0) == (extract(far).labels > 0)).mean() > 0.999


def test_two_far_islands_are_extracted_as_each_alone():
    """Islands a thousand kilometres apart cost nothing, and both have their house."""
    near = cloud_of([HOUSE])
    far = cloud_of([HOUSE], shift=(WEST + 1e6, SOUTH + 1e6))
    fields = ("x", "y", "z", "return_number", "number_of_returns")
    both = replace(near, **{name: np.concatenate((getattr(near, name), getattr(far, name))) for name in fields})
    found = extract(both)
    check(both, found)
    assert len(found.regions) == 2
    assert found.regions["points"].nunique() == 1


@pytest.mark.parametrize(
    "points",
    [
        [(0, 0, 5)],
        [(0, 0, 5)] * 50,
        [(i * 0.3, 0, 5) for i in range(60)],
        [(0, 0, 0), (1, 0, 0), (0, 1, 0)],
        [(3 * i, 3 * j, 6) for i in range(5) for j in range(5)],
    ],
    ids=["one point", "one point 50 times", "on a line", "ground alone", "sparse"],
)
def test_clouds_without_a_building_give_an_empty_table(points):
    """Whatever is too little for a building is recorded, and never an error."""
    x, y, z = np.array(points, dtype=np.float64).T
    cloud = PointCloud(x + WEST, y + SOUTH, z, UTM)
    found = extract(cloud)
    check(cloud, found)
    assert len(found.regions) <= (len(points) == 25)


def test_an_empty_cloud_gives_empty_tables():
    """No point: no region, and the declared columns."""
    empty = cloud_of([HOUSE]).take(np.zeros(0, dtype=np.int64))
    spec = lattice((WEST, SOUTH, WEST + 1, SOUTH + 1), 0.5, UTM)
    found = extract_adaptive(empty, empty.z, spec=spec, survey="test", params=Params())
    check(empty, found)
    assert found.regions.empty


def test_trees_alone_give_nothing():
    """A wood holds no region."""
    trees = [crown(9 + 8 * i, 9 + 8 * j, 3.5, 7, seed=10 * i + j) for i in range(5) for j in range(4)]
    cloud = cloud_of([], trees)
    found = extract(cloud)
    check(cloud, found)
    assert found.regions.empty


def test_a_cloud_of_one_plane_is_one_region():
    """All points on one roof, without any ground, are one region."""
    x, y, z = plane(0, 0, 30, 20, 8.0).T
    cloud = PointCloud(x + WEST, y + SOUTH, z, UTM)
    found = extract(cloud)
    check(cloud, found)
    assert len(found.regions) == 1
    assert (found.labels == 1).mean() > 0.99
    assert abs(found.regions["area_m2"].iloc[0] / 600 - 1) < 0.1
    assert abs(found.regions["rectangularity"].iloc[0] - 1) < 0.1


@pytest.mark.parametrize("what", ["heights", "x", "z", "length", "ndvi length"])
def test_what_is_not_finite_or_does_not_fit_is_refused(what):
    """The error says what is wrong and how many points it concerns."""
    cloud = cloud_of([HOUSE])
    heights, ndvi, words = cloud.z.copy(), None, "1 of"
    if what == "heights":
        heights[3] = np.nan
    elif what in ("x", "z"):
        values = getattr(cloud, what).copy()
        values[5] = np.inf
        spec = lattice(cloud.bounds, 0.5, UTM)
        with pytest.raises(InputError, match=words):
            extract_adaptive(replace(cloud, **{what: values}), heights, spec=spec, survey="t", params=Params())
        return
    elif what == "length":
        heights, words = heights[1:], "one a point"
    else:
        ndvi, words = np.zeros(4, dtype=np.float32), "one a point"
    with pytest.raises(InputError, match=words):
        extract(cloud, heights=heights, ndvi=ndvi)


@settings(max_examples=10)
@given(st.integers(0, 1000), st.integers(1, 3), st.floats(2.5, 20))
def test_separate_roofs_are_found_one_by_one(seed, count, height):
    """So many roofs far apart, so many regions, whatever their height; nothing of the ground."""
    roofs = [plane(5 + 18 * i, 12, 9, 7, height, seed=seed + i, slope=0.2) for i in range(count)]
    cloud = cloud_of(roofs)
    found = extract(cloud)
    check(cloud, found)
    assert len(found.regions) == count
    assert (cloud.z[found.labels > 0] > 2).all()


def test_the_profile_takes_the_slides_own_ground():
    """The profile of the slides filters ground as they do."""
    assert profile("adaptive").ground.ground_filter == "adaptive"


@pytest.mark.parametrize("scene", [courtyard, under_trees])
def test_simulated_scenes_are_found(scene):
    """On scanned scenes of four points a square metre, most of the roofs' points are found, and few others."""
    made = scene(density=4.0)
    dtm, _ = terrain(made.points, made.spec, Params().ground)
    heights = heights_above(made.points, dtm)
    found = extract(made.points, heights=heights)
    check(made.points, found)
    truth = (made.labels == BUILDING) & (heights >= 2)
    both = np.count_nonzero(truth & (found.labels > 0))
    assert both > 0.85 * truth.sum()
    assert both > 0.85 * np.count_nonzero(found.labels)


FLOORS = {
    ("beziers", None): (0.84, 0.70),
    ("delft_2", 4.0): (0.90, 0.95),
    ("delft_2", 2.0): (0.87, 0.95),
    ("montpellier", 4.0): (0.80, 0.65),
}
"""Area quality, and that of objects of at least 50 m2: a little below what was measured."""

FILES = {
    "beziers": ("beziers/points_left.laz", "beziers/points_right.laz"),
    "delft_2": ("delft/delft_2.laz",),
    "montpellier": ("montpellier/points.laz",),
}


@cache
def tile(name):
    """Return the points of a real tile."""
    folder = Path(os.environ["MSBDB_DATA"])
    crs = "EPSG:28992" if name.startswith("delft") else None
    return with_notices(read_points, [folder / file for file in FILES[name]], crs=crs)[0]


@pytest.mark.data
@pytest.mark.skipif("MSBDB_DATA" not in os.environ, reason="needs the real tiles")
@pytest.mark.parametrize(("name", "points_m2"), FLOORS, ids=str)
def test_real_tiles_reach_their_floors(name, points_m2):
    """At the density that the slides' method was made for, areas and large objects agree as measured."""
    full = tile(name)
    cloud = replace(full, classification=None)
    if points_m2 is not None:
        all_m2 = density(full) * len(full) / np.count_nonzero(full.first_echo)
        cloud = cloud.take(np.random.default_rng(0).random(len(full)) < points_m2 / all_m2)
    dtm, _ = terrain(cloud, lattice(cloud.bounds, cell_size(density(cloud)), cloud.crs), Params().ground)
    found = extract(cloud, heights=heights_above(cloud, dtm))
    check(cloud, found)
    frame = gpd.GeoDataFrame(geometry=list(outlines_of(cloud, found)), crs=cloud.crs)
    truth = PointReference(full.x, full.y, np.equal(full.classification, 6), full.crs, full.first_echo)
    score = evaluate(frame, truth)
    assert score.area.rates.quality > FLOORS[name, points_m2][0]
    assert score.large_objects.rates.quality > FLOORS[name, points_m2][1]
