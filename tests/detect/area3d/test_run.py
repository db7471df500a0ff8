"""The 3-D area morphology as a whole: on hand-made clouds, on simulated scenes, on real tiles, and on bad input."""

import os
from dataclasses import replace
from functools import cache
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from pyproj import CRS
from simulated.files import write_points
from simulated.scenes import city, flat_field, podium_tower, under_trees
from support.notices import with_notices

import msbdb
from msbdb.detect.area3d.caowu import extract_area3d
from msbdb.errors import InputError, NodataError
from msbdb.grid import lattice
from msbdb.io.las import read_points
from msbdb.params import Params, profile, with_values
from msbdb.points.cloud import PointCloud
from msbdb.run.preparation.drafts import build_surface
from msbdb.run.preparation.pointfacts import with_facts
from msbdb.surface import heights_above
from msbdb.surveyplan import USUAL_SPLIT
from msbdb.tables import CANDIDATE_REGION, REJECTION, validate

UTM = CRS.from_epsg(32633)
ORIGIN = (389_000.0, 5_821_000.0)
PAPER = profile("cao-wu")
DATA = os.environ.get("MSBDB_DATA", "")
BUILDING, DECK = 6, 17


def scan(*parts, size=(60.0, 60.0), density=4.0, seed=0, origin=ORIGIN):
    """Scan level ground with things on it: each part is a function of x and y that gives heights, NaN beside it."""
    rng = np.random.default_rng(seed)
    count = int(size[0] * size[1] * density)
    x, y = rng.uniform(0, size[0], count), rng.uniform(0, size[1], count)
    z = rng.normal(0, 0.02, count)
    for part in parts:
        above = part(x, y)
        z = np.where(np.isnan(above), z, above + rng.normal(0, 0.02, count))
    return np.column_stack([x + origin[0], y + origin[1], z])


def box(corner, size, height, slope=0.0):
    """Return a flat roof, or a gabled one with its ridge along x."""
    (x0, y0), (width, depth) = corner, size

    def heights(x, y):
        inside = (x >= x0) & (x < x0 + width) & (y >= y0) & (y < y0 + depth)
        return np.where(inside, height - slope * np.abs(y - y0 - depth / 2), np.nan)

    return heights


def ball(x0, y0, height, count, seed=0, *, radius=4.0):
    """Return the points of a crown that fill a ball."""
    rng = np.random.default_rng(seed)
    inside = rng.uniform(-1, 1, (4 * count, 3))
    inside = inside[(inside**2).sum(axis=1) < 1][:count] * radius
    return inside + np.array([x0 + ORIGIN[0], y0 + ORIGIN[1], height])


def cloud_of(points, **attributes):
    """Return a point cloud whose ground lies at 0."""
    return PointCloud(*(np.ascontiguousarray(points[:, k]) for k in range(3)), UTM, **attributes)


def extract(points, params=None, *, heights=None, ndvi=None, noise_m=None, recorded=None, cell_m=0.5, **attributes):
    """Extract the regions of points over level ground."""
    cloud = cloud_of(points, **attributes) if isinstance(points, np.ndarray) else points
    heights = cloud.z if heights is None else heights
    spec = lattice(cloud.bounds, cell_m, cloud.crs) if len(cloud) else lattice((0, 0, 9, 9), 1.0, UTM)
    given = {"spec": spec, "survey": "test", "params": params or Params(), "ndvi": ndvi, "noise_m": noise_m}
    return extract_area3d(cloud, heights, recorded=recorded, **given)


def with_area3d(**changes):
    """Return the default parameters with some of this extractor replaced."""
    return with_values(Params(), {"area3d": changes})


def quality(found, truth):
    """Return TP / (TP + FN + FP) by point."""
    return np.count_nonzero(found & truth) / max(np.count_nonzero(found | truth), 1)


@pytest.mark.parametrize("params", [Params(), PAPER, profile("cao-wu-ss")], ids=["default", "cao-wu", "cao-wu-ss"])
def test_a_roof_is_one_region_with_all_of_its_points(params):
    """A hall alone is found by rule 1, whatever the profile, with its area, height and place."""
    points = scan(box((15, 20), (30, 20), 6.5))
    found = extract(points, params)
    assert len(found.regions) == 1
    assert ((found.labels == 1) == (points[:, 2] > 3)).all()
    row = found.regions.iloc[0]
    assert row["rule"] == "rule 1"
    assert row["area_m2"] == pytest.approx(600, rel=0.06)
    assert row["rectangularity"] == pytest.approx(1, abs=0.07)
    assert row["h_p50"] == pytest.approx(6.5, abs=0.05)
    assert (row["xcen"] - ORIGIN[0], row["ycen"] - ORIGIN[1]) == pytest.approx((30, 30), abs=0.5)
    assert abs(abs(row["direction_1"] - row["direction_2"]) - 90) < 10
    validate(found.regions, replace(CANDIDATE_REGION, geometry=None))
    validate(found.rejections, replace(REJECTION, geometry=None))


@pytest.mark.parametrize("density", [0.5, 2.0, 16.0])
def test_a_gabled_roof_is_one_region_at_any_density(density):
    """Ridge and both slopes belong together."""
    points = scan(box((15, 20), (24, 14), 9.0, slope=0.6), density=density)
    found = extract(points)
    assert len(found.regions) == 1
    assert quality(found.labels > 0, points[:, 2] > 2) > 0.97


LADDER = {"heights_m": (3.0,), "rectangularity_2": 0.75, "foot_m": 2.9, "areas_m2": (10.0, 450.0)}
TERRACE = (box((15, 15), (30, 30), 3.2), box((20, 20), (20, 20), 2.5))
"""A roof with a lower terrace of 400 m2 in its middle, which is above ground but below the height scale of 3 m."""


def test_the_ladder_of_areas_closes_what_one_area_leaves_open():
    """A ring fills too little of its rectangle; the next area scale closes the terrace within it (C7)."""
    points = scan(*TERRACE)
    assert len(extract(points, with_area3d(**{**LADDER, "areas_m2": ()})).regions) == 0
    found = extract(points, with_area3d(**LADDER))
    assert found.regions["area_m2"].tolist() == pytest.approx([900], rel=0.06)


def test_one_area_scale_is_the_smallest_building():
    """A ladder of one area, T_a, is the extraction without a ladder."""
    points = scan(box((15, 20), (24, 14), 9.0, slope=0.6), box((45, 5), (8, 8), 4.0))
    one, none = extract(points, with_area3d(areas_m2=(10.0,))), extract(points)
    assert one.regions.equals(none.regions)
    assert one.rejections.equals(none.rejections)


def test_a_build_takes_the_ladder_of_areas(tmp_path):
    """From the point file to the database: the region is there with the ladder, and not without."""
    file = write_points(tmp_path / "terrace.laz", cloud_of(scan(*TERRACE)))
    found = []
    for name, areas in (("one", ()), ("ladder", LADDER["areas_m2"])):
        params = with_area3d(**{**LADDER, "areas_m2": areas})
        msbdb.build([file], db=tmp_path / f"{name}.sqlite", params=params, extract=["area3d"])
        with msbdb.open(tmp_path / f"{name}.sqlite") as opened:
            found.append(opened.candidates()["area_m2"].tolist())
    assert found[0] == []
    assert found[1] == pytest.approx([900], rel=0.06)


def test_an_l_shape_passes_by_rule_2_of_the_paper():
    """Two wings at a right angle fill too little of their rectangle for rule 1."""
    found = extract(scan(box((10, 10), (40, 14), 6.0), box((10, 10), (14, 40), 6.0)), PAPER)
    assert list(found.regions["rule"]) == ["rule 2"]


def test_buildings_farther_apart_than_t_c_are_two_regions():
    """Two halls 2 m apart stay apart, as their roofs are connected by nothing."""
    points = scan(box((8, 20), (20, 20), 6.5), box((30, 20), (20, 20), 6.5))
    found = extract(points)
    assert len(found.regions) == 2
    east = points[:, 0] - ORIGIN[0]
    assert len(set(found.labels[(points[:, 2] > 3) & (east < 29)])) == 1
    assert len(np.unique(found.labels[points[:, 2] > 3])) == 2


@pytest.mark.parametrize("params", [Params(), PAPER], ids=["default", "cao-wu"])
def test_crowns_are_no_regions_and_are_in_the_ledger(params):
    """Of balls of leaves none remains, and each of them is recorded."""
    crowns = [ball(15 + 15 * i, 15 + 15 * j, 8.0, 900, seed=3 * i + j) for i in range(3) for j in range(3)]
    found = extract(np.concatenate([scan(), *crowns]), params)
    assert len(found.regions) == 0
    assert (found.labels == 0).all()
    assert (found.rejections["stage"] == "curvature").sum() >= 9


def test_a_crown_beside_a_roof_leaves_the_roof_alone():
    """A crown that touches a hall is cut off, and the hall keeps its points."""
    points = np.concatenate([scan(box((15, 15), (24, 20), 6.5)), ball(42.5, 25, 7.5, 1500)])
    truth = np.arange(len(points)) < len(points) - 1500
    truth &= points[:, 2] > 3
    found = extract(points, with_area3d(max_curvature=0.03))
    assert quality(found.labels > 0, truth) > 0.95


def test_echoes_tell_a_smooth_crown():
    """A level hedge is a roof by its shape; that its pulses gave several echoes makes it none."""
    points = scan(box((20, 20), (20, 10), 5.0))
    several = np.where(points[:, 2] > 3, 2, 1).astype(np.uint8)
    first = np.ones(len(points), dtype=np.uint8)
    assert len(extract(points).regions) == 1
    assert len(extract(points, number_of_returns=several, return_number=first).regions) == 0


def test_the_less_single_echoes_are_trusted_the_smoother_a_region_must_be():
    """A hedge as rough as a crown, of single echoes: a roof by a sensor that splits crowns, and a crown by others."""
    points = scan(box((20, 20), (20, 10), 5.0))
    high = points[:, 2] > 3
    several = np.where(np.arange(len(points)) < 5, 2, 1).astype(np.uint8)
    echoes = {"number_of_returns": several, "return_number": np.ones(len(points), dtype=np.uint8)}
    facts = with_facts(cloud_of(points, **echoes), 0.0).facts

    def found(rough_m, trust):
        rougher = points.copy()
        rougher[high, 2] += np.random.default_rng(1).normal(0, rough_m, np.count_nonzero(high))
        survey = replace(facts, crown_split=(trust * USUAL_SPLIT,) * 6)
        return len(extract(rougher, facts=survey, **echoes).regions)

    trusts = (0.0, 0.3, 0.6, 1.0)
    assert [found(0.05, trust) for trust in trusts] == [1, 1, 1, 1]
    assert [found(0.2, trust) for trust in trusts] == [0, 1, 1, 1]
    assert [found(0.3, trust) for trust in trusts] == [0, 0, 1, 1]


def test_single_echoes_are_trusted_where_later_ones_are_recorded():
    """Of two hedges as rough as crowns, of single echoes, one is a roof: that by a sensor of several echoes."""
    points = scan(box((10, 20), (15, 10), 5.0), box((35, 20), (15, 10), 5.0))
    high, west = points[:, 2] > 3, points[:, 0] < ORIGIN[0] + 30
    points[high, 2] += np.random.default_rng(1).normal(0, 0.3, np.count_nonzero(high))
    several = np.where(np.arange(len(points)) < 5, 2, 1).astype(np.uint8)
    echoes = {"number_of_returns": several, "return_number": np.ones(len(points), dtype=np.uint8)}
    facts = replace(with_facts(cloud_of(points, **echoes), 0.0).facts, crown_split=(USUAL_SPLIT,) * 6)
    assert len(extract(points, facts=facts, **echoes).regions) == 2
    for kept in (west, ~west):
        found = extract(points, facts=facts, recorded=kept.astype(np.float32), **echoes).regions
        assert len(found) == 1
        assert (found["xcen"][0] < ORIGIN[0] + 30) == (kept is west)


def test_noise_that_is_known_hides_no_roof():
    """With 0.25 m of noise a roof is as rough as a crown; what is known of it is taken off, at each point its own."""
    points = scan(box((10, 20), (15, 15), 5.0), box((35, 20), (15, 15), 5.0))
    noise_m = np.where(points[:, 0] > ORIGIN[0] + 30, np.float32(0.25), np.float32(0))
    points[:, 2] += np.random.default_rng(3).normal(0, noise_m)
    found = extract(points).regions
    assert len(found) == 1
    assert found["xcen"][0] < ORIGIN[0] + 30
    assert len(extract(points, noise_m=noise_m).regions) == 2
    assert len(extract(points, noise_m=np.float32(0.25) - noise_m).regions) == 1


def test_ndvi_tells_a_green_region():
    """A region of a high mean NDVI is a crown, one of unknown or low NDVI is not, and its mean is stored."""
    points = scan(box((20, 20), (20, 10), 5.0))
    green = np.full(len(points), 0.6, dtype=np.float32)
    assert len(extract(points, ndvi=green).regions) == 0
    assert extract(points, ndvi=green).rejections["reason"].str.contains("NDVI").any()
    assert extract(points, ndvi=green - np.float32(0.5)).regions["ndvi"][0] == pytest.approx(0.1)
    assert extract(points, ndvi=green * np.nan).regions["ndvi"].isna().all()


def test_a_tower_on_a_podium_is_absorbed():
    """The tower lies within the podium's region, which is accepted lower down, and the ledger says so."""
    points = scan(box((10, 10), (40, 40), 6.0), box((20, 20), (14, 14), 20.0))
    found = extract(points, with_area3d(heights_m=[3.0, 10.0], link_spacings=4.0))
    assert (found.regions["height_scale_m"] == 3.0).all()
    absorbed = found.rejections[found.rejections["stage"] == "fusion"]
    assert len(absorbed)
    assert (absorbed["scale"] == 2).all()


def test_a_higher_scale_finds_what_is_joined_lower_down():
    """A hall at a bank is one with it at 3 m and is rejected; at 8 m it stands free: what MS gains over SS."""

    def bank(x, y):
        inside = (x < 60) & (y < 16) & ((x % 8 < 2.5) | (y < 3))
        return np.where(inside, 5.0, np.nan)

    points = scan(bank, box((20, 12), (20, 20), 10.0), size=(60, 60))
    base = {"rectangularity_2": 0.6, "linearity": 1.0, "perpendicular_deg": 0.0}
    single = extract(points, with_area3d(heights_m=[3.0], link_spacings=11.0, **base))
    multi = extract(points, with_area3d(heights_m=[3.0, 8.0], link_spacings=11.0, **base))
    assert len(single.regions) == 0
    assert list(multi.regions["height_scale_m"]) == [8.0]
    assert (multi.labels[points[:, 2] > 9] == 1).all()


def test_sheds_below_t_a_are_recorded_with_their_area():
    """A roof of 6 m2 is smaller than the smallest building, one of 25 m2 is not."""
    points = scan(box((10, 10), (2.4, 2.4), 3.0), box((30, 30), (5, 5), 3.0))
    found = extract(points, with_area3d(grow_m=0.0, grow_spacings=0.0))
    assert len(found.regions) == 1
    small = found.rejections[found.rejections["reason"] == "smaller than T_a"]
    assert small["area_m2"].max() == pytest.approx(5.8, rel=0.4)


def test_what_the_opening_takes_away_is_recorded_at_one_height_only():
    """A mast of 6 m2 and 12 m reaches three height scales; the ledger has it once, at the lowest."""
    found = extract(scan(box((20, 20), (2.4, 2.4), 12.0)), with_area3d(heights_m=[2.5, 5.0, 9.0]))
    small = found.rejections[found.rejections["stage"] == "opening"]
    assert small["scale"].tolist() == [1]
    assert found.counts["opening"]["pieces"] == -2


def test_loose_points_near_each_other_share_a_row():
    """Points without two neighbours are no regions: those of a sparse crown share a row, and a bird has its own."""
    ground = scan()
    corner = ground[:, :2].min(axis=0)
    twigs = np.array([[20, 20, 8.0], [20.5, 20.2, 12.0], [20.2, 20.6, 16.0]])
    bird = np.array([[40, 40, 25.0]])
    flying = np.concatenate([twigs, bird])
    flying[:, :2] += corner
    found = extract(np.concatenate([ground, flying]))
    loose = found.rejections[found.rejections["reason"].str.startswith("loose points")]
    assert len(found.rejections) == len(loose) == 2
    middles = loose[["xcen", "ycen"]].to_numpy() - corner
    assert np.allclose(sorted(middles.tolist()), [[20.233, 20.267], [40, 40]], atol=0.01)


def test_the_order_of_the_points_changes_nothing():
    """Shuffled points give the same regions, ledger and counts, and each point its own label."""
    scene = city(density=2.0)
    cloud = scene.points
    base = extract(cloud, heights=cloud.z - cloud.z.min())
    mixed = np.random.default_rng(7).permutation(len(cloud))
    other = extract(cloud.take(mixed), heights=(cloud.z - cloud.z.min())[mixed])
    assert (other.labels == base.labels[mixed]).all()
    assert other.regions.equals(base.regions)
    assert other.rejections.equals(base.rejections)
    assert other.counts == base.counts


@pytest.mark.parametrize("scene", [city, under_trees, podium_tower], ids=lambda f: f.__name__)
def test_the_ledger_balances(scene):
    """At each stage in = kept + dropped, and each stage takes in what the one before kept."""
    cloud = scene(density=2.0).points
    found = extract(cloud, heights=heights_above(cloud, build_surface(cloud, Params()).dtm))
    stages = list(found.counts)
    assert stages == ["fusion", "opening", "curvature", "crowns", "rules"]
    for name, count in found.counts.items():
        assert count["in"] == count["kept"] + count["dropped"]
        assert count["dropped"] == (found.rejections["stage"] == name).sum()
    for before, after in pairwise(stages):
        assert found.counts[before]["kept"] == found.counts[after]["in"] - found.counts[after]["pieces"]
    assert found.counts["rules"]["kept"] == len(found.regions)
    large = found.rejections["area_m2"] >= Params().fuse.piece_m2
    assert (found.regions["candidate_id"] > 0).all()
    assert ((found.rejections["region_id"] > 0) == large).all()
    assert not found.regions["candidate_id"].duplicated().any()
    assert not found.rejections[large].duplicated(["region_id", "stage", "reason"]).any()


@pytest.mark.parametrize(("scene", "least"), [(city, 0.97), (under_trees, 0.9), (podium_tower, 0.97)])
def test_simulated_buildings_are_found(scene, least):
    """On simulated scenes with trees, walls and slopes buildings are found, and little else but bridges' decks."""
    made = scene(density=4.0)
    found = extract(made.points, heights=heights_above(made.points, build_surface(made.points, Params()).dtm))
    judged = made.labels != DECK
    assert quality((found.labels > 0)[judged], (made.labels == BUILDING)[judged]) > least


def test_a_meadow_has_no_region():
    """Where nothing stands on the ground nothing is found."""
    cloud = flat_field().points
    assert len(extract(cloud, heights=heights_above(cloud, build_surface(cloud, Params()).dtm)).regions) == 0


def test_regions_have_ids_of_their_place():
    """Shifting the lattice's extent does not change ids; another survey or place does."""
    points = scan(box((15, 20), (30, 20), 6.5))
    cloud = cloud_of(points)
    west, south, east, north = cloud.bounds
    base = extract(points)
    wider = lattice((west - 40, south - 20, east + 10, north + 30), 0.5, UTM)
    other = extract_area3d(cloud, cloud.z, spec=wider, survey="test", params=Params())
    assert list(other.regions["candidate_id"]) == list(base.regions["candidate_id"])
    renamed = extract_area3d(cloud, cloud.z, spec=wider, survey="other", params=Params())
    assert renamed.regions["candidate_id"][0] != base.regions["candidate_id"][0]


@pytest.mark.parametrize(
    "points",
    [
        np.array([[0.0, 0.0, 5.0]]),
        np.tile([1.0, 2.0, 5.0], (300, 1)),
        np.column_stack([np.arange(200.0), np.zeros(200), np.full(200, 5.0)]),
        np.column_stack([np.arange(300.0), np.arange(300.0) * 0.5, np.arange(300.0) * 0.1 + 3]),
    ],
    ids=["one", "duplicates", "in a row", "a sloping row"],
)
@pytest.mark.parametrize("params", [Params(), PAPER], ids=["default", "cao-wu"])
def test_degenerate_clouds_go_through(points, params):
    """One point, one place, and points in a row have an answer, and all points an entry somewhere."""
    found = extract(points, params)
    assert found.labels.shape == (len(points),)
    assert len(found.regions) + len(found.rejections) >= 1
    assert np.isfinite(found.regions[["area_m2", "mbr_m2", "rectangularity"]]).all(axis=None)


def test_doubled_points_share_a_label():
    """Every point twice: both have one label, and areas do not double."""
    points = scan(box((15, 20), (30, 20), 6.5))
    found = extract(np.concatenate([points, points]))
    assert (found.labels[: len(points)] == found.labels[len(points) :]).all()
    assert 480 < found.regions["area_m2"].sum() < 640


def test_all_points_in_one_plane_above_ground_are_one_region():
    """A tile within one roof is that roof."""
    points = scan(size=(30, 30)) + np.array([0, 0, 8.0])
    found = extract(points)
    assert (found.labels == 1).all()


def test_far_islands_cost_nothing():
    """Two scenes 2000 km apart give the regions of both."""
    near = scan(box((15, 20), (30, 20), 6.5))
    far = scan(box((15, 20), (30, 20), 6.5), origin=(ORIGIN[0] + 1e6, ORIGIN[1] + 2e6))
    found = extract(np.concatenate([near, far]))
    assert len(found.regions) == 2
    assert found.regions["area_m2"].to_numpy() == pytest.approx(600, rel=0.06)


def test_a_huge_offset_changes_no_point():
    """Ten million metres off, where squares of coordinates lose their digits, the same points are found."""
    scene = scan(box((15, 20), (24, 14), 9.0, slope=0.6))
    scene[:, :2] = np.round(scene[:, :2] - ORIGIN, 2)
    base = extract(scene)
    moved = extract(scene + np.array([1e7, 1e7, 0]))
    assert (moved.labels == base.labels).all()
    numbers = ["area_m2", "mbr_m2", "linearity", "compactness"]
    assert moved.regions[numbers].to_numpy() == pytest.approx(base.regions[numbers].to_numpy(), rel=0.02)


def test_input_that_is_none_is_refused():
    """NaN heights and coordinates, arrays of another length and clouds without points raise, and say what to do."""
    points = scan(size=(10, 10))
    broken = points[:, 2].copy()
    broken[3] = np.nan
    with pytest.raises(InputError, match="height above ground is NaN or infinite at 1 of 400 points"):
        extract(points, heights=broken)
    cloud = cloud_of(points)
    bad = replace(cloud, x=np.where(np.arange(len(cloud)) == 0, np.nan, cloud.x))
    with pytest.raises(InputError, match="x is NaN"):
        extract_area3d(bad, cloud.z, spec=lattice(cloud.bounds, 1.0, UTM), survey="t", params=Params())
    with pytest.raises(InputError, match="heights must be one a point"):
        extract(points, heights=points[:5, 2])
    with pytest.raises(InputError, match="ndvi must be one a point"):
        extract(points, ndvi=np.zeros(3, dtype=np.float32))
    with pytest.raises(NodataError, match="no point"):
        extract(points[:0])


@cache
def real_tile(path, epsg, density):
    """Return a real tile thinned to a density of first echoes, its classes wiped, and which points are building."""
    cloud, _ = with_notices(read_points, Path(DATA) / path, crs=epsg)
    truth = cloud.classification == BUILDING
    if density:
        share = density * np.ptp(cloud.x) * np.ptp(cloud.y) / np.count_nonzero(cloud.first_echo)
        chosen = np.random.default_rng(1).random(len(cloud)) < share
        cloud, truth = cloud.take(chosen), truth[chosen]
    cloud = replace(cloud, classification=None)
    surface = build_surface(cloud, Params())
    return cloud, heights_above(cloud, surface.dtm), surface.dtm.spec, truth


@pytest.mark.data
@pytest.mark.skipif(not DATA, reason="set MSBDB_DATA to the folder of the real tiles")
@pytest.mark.parametrize(
    ("path", "epsg", "density", "least"),
    [
        ("beziers/points_right.laz", 2154, None, 0.90),
        ("delft/delft_1.laz", 28992, 2.0, 0.85),
        ("delft/delft_2.laz", 28992, 4.0, 0.91),
        ("montpellier/points.laz", 2154, 2.0, 0.84),
    ],
)
def test_real_buildings_are_found_by_point(path, epsg, density, least):
    """At the densities the method was made for, with classes wiped, quality by point stays above a floor."""
    cloud, heights, spec, truth = real_tile(path, epsg, density)
    found = extract_area3d(cloud, heights, spec=spec, survey="t", params=Params())
    assert quality(found.labels > 0, truth) > least
