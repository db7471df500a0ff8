"""The cases of the places: references, copies, towns over hills, and the page; on a simulated place."""

import laspy
import numpy as np
import pytest
from cases.copies import (
    first_only,
    mirrored,
    of_two_sensors,
    of_two_strips,
    pulses,
    razed,
    seen_from_aside,
    shaken,
    taken,
    thinned,
    thinned_east_of,
    with_class_alone,
    with_echoes_apart,
    with_echoes_on_walls,
    with_fewer_later,
    with_outliers,
)
from cases.labelled import Objects, Place, cell_for, first_density, reference_of
from cases.measures import GIVEN, OWN, Case, measure
from cases.othergrounds import smrf
from cases.rasters import as_rasters
from scipy.spatial import KDTree
from simulated import hills, scenes, scrub, trees
from simulated.files import write_points
from support.processes import BENCHMARKS, load_script

from msbdb.grid import Grid, lattice
from msbdb.io.raster import read_grid
from msbdb.points.cloud import BUILDING_CLASS, GROUND_CLASS, UNCLASSIFIED_CLASS

HOUSES = scenes.row_houses(density=4.0)


@pytest.fixture(scope="module")
def places():
    """Return scripts/benchmarks/places."""
    return load_script(BENCHMARKS / "places")


@pytest.fixture(scope="module")
def town(tmp_path_factory):
    """Return a simulated place in a folder: its description, its points and the folder."""
    data = tmp_path_factory.mktemp("data")
    points = HOUSES.points
    write_points(data / "points.laz", points)
    cloud = laspy.read(data / "points.laz")
    cloud.classification = HOUSES.labels
    # As a scanner writes it: a new time with each first echo.
    cloud.gps_time = np.cumsum(points.return_number == 1).astype(float)
    cloud.write(data / "points.laz")
    place = Place("town", ("points.laz",), "EPSG:32633")
    return place, place.read(data), data


def test_the_truth_against_itself_is_perfect_and_half_of_it_is_half(town):
    """Quality and objects of the reference's own cells, and of those of its western half."""
    place, clouds, data = town
    reference = reference_of(place, clouds, data, 0.5)
    spec, built = reference.spec, reference.built
    every = reference.found_objects(built, spec)
    assert reference.quality(built, spec) == 100
    assert every.covered == every.all > 0
    half = built & (np.cumsum(built.any(axis=0)) <= built.any(axis=0).sum() / 2)
    assert 30 < reference.quality(half, spec) < 70
    assert reference.true_objects(half, spec).covered == reference.true_objects(half, spec).all > 0
    assert reference.true_objects(~built, spec) == Objects(0, 1)
    assert reference.found_objects(~built, spec) == Objects(0, every.all)


def test_the_reference_lies_where_the_scene_has_buildings(town):
    """Cells of first echoes of class 6 are the scene's own buildings, but for their edges."""
    place, clouds, data = town
    reference = reference_of(place, clouds, data, 0.5)
    assert reference.quality(HOUSES.buildings > 0, HOUSES.spec) > 90
    assert first_density(clouds) == pytest.approx(4.0, rel=0.1)
    assert [cell_for(density) for density in (8, 3, 2, 1, 0.5)] == [0.5, 0.5, 1.0, 1.0, 2.0]


def test_cells_beyond_the_outermost_points_are_not_scored(town):
    """Of a survey that is cut at whole metres, a row of cells has points on its outer edge alone."""
    place, (cloud,), data = town
    x, y = np.asarray(cloud.x), np.asarray(cloud.y)
    east, south = np.floor(x.max()) - 5, np.ceil(y.min()) + 5
    cut = taken(cloud, (x <= east) & (y >= south))
    cut.x[0], cut.y[1] = east, south
    reference = reference_of(place, [cut], data, 1.0)
    assert not reference.scored[:, -1].any()
    assert not reference.scored[-1].any()
    assert reference.scored[1:-1, 1:-1].mean() > 0.9


def test_thinned_copies_keep_whole_pulses(town):
    """All echoes of a kept pulse stay, and the same ones each time; the copy has about the share."""
    _, (cloud,), _ = town
    copy = thinned(cloud, 0.3)
    assert len(copy.points) / len(cloud.points) == pytest.approx(0.3, abs=0.05)
    kept = np.isin(np.asarray(cloud.gps_time), np.asarray(copy.gps_time))
    np.testing.assert_array_equal(np.asarray(cloud.x)[kept], np.asarray(copy.x))
    np.testing.assert_array_equal(np.asarray(thinned(cloud, 0.3).x), np.asarray(copy.x))


def test_a_copy_that_is_sparser_in_the_east_keeps_all_of_the_west(town):
    """East of the line it has the pulses of the thinned copy."""
    _, (cloud,), _ = town
    x = np.asarray(cloud.x)
    line = float(np.median(x))
    copy, few = thinned_east_of(cloud, line, 0.2), thinned(cloud, 0.2)
    east, few_x = np.asarray(copy.x), np.asarray(few.x)
    np.testing.assert_array_equal(east[east < line], x[x < line])
    np.testing.assert_array_equal(east[east >= line], few_x[few_x >= line])


def test_echoes_on_walls_stand_between_the_ground_and_the_edge_of_a_roof(town):
    """As many as asked, single ones, at the edges of roofs; a build finds the houses with them as without."""
    place, (cloud,), data = town
    density, count = first_density([cloud]), len(cloud.points)
    copy = with_echoes_on_walls(cloud, 0.5, density)
    assert not moved(cloud, taken(copy, np.arange(count))).any()
    assert set(np.asarray(copy.return_number)[count:]) == set(np.asarray(copy.number_of_returns)[count:]) == {1}
    places, classes = np.column_stack((cloud.x, cloud.y, cloud.z)), np.asarray(cloud.classification)
    new = np.column_stack((copy.x, copy.y, copy.z))[count:]
    roofs, ground = (places[classes == number] for number in (BUILDING_CLASS, GROUND_CLASS))
    assert KDTree(roofs[:, :2]).query(new[:, :2])[0].max() <= 0.11
    assert KDTree(ground[:, :2]).query(new[:, :2])[0].max() <= 1.1
    assert (new[:, 2] > ground[:, 2].min()).all()
    assert (new[:, 2] < roofs[:, 2].max()).all()
    few = with_echoes_on_walls(cloud, 0.1, density)
    assert (len(copy.points) - count) / (len(few.points) - count) == pytest.approx(5, rel=0.2)
    reference = reference_of(place, [cloud], data, 0.5)
    without, with_walls = (
        measure(Case("town", place.crs, [each], reference, {}), (OWN,))["buildings"] for each in (cloud, copy)
    )
    assert with_walls > without - 1


def moved(cloud, copy):
    """How far the echoes of a copy lie from their places, (3, N), metres."""
    return np.stack([np.asarray(copy[axis]) - np.asarray(cloud[axis]) for axis in "xyz"])


def test_shaken_echoes_are_off_by_so_much(town):
    """In plan, in height, or both; the same at each call, and not the given points themselves."""
    _, (cloud,), _ = town
    before = np.asarray(cloud.z).copy()
    for plan_m, height_m in ((0.2, 0.0), (0.0, 0.1), (0.2, 0.1)):
        off = moved(cloud, shaken(cloud, plan_m=plan_m, height_m=height_m))
        np.testing.assert_allclose(off.std(axis=1), [plan_m, plan_m, height_m], rtol=0.1, atol=1e-6)
        np.testing.assert_array_equal(off, moved(cloud, shaken(cloud, plan_m=plan_m, height_m=height_m)))
    np.testing.assert_array_equal(cloud.z, before)


def test_of_two_strips_half_of_the_pulses_lie_elsewhere(town):
    """With all echoes of a pulse."""
    _, (cloud,), _ = town
    x, y, z = moved(cloud, of_two_strips(cloud, aside_m=0.3, up_m=0.1))
    other = z > 0.05
    assert 0.4 < other.mean() < 0.6
    np.testing.assert_allclose([x, y, z], [0.3 * other, 0 * other, 0.1 * other], atol=0.002)
    _, pulse = np.unique(pulses(cloud), return_inverse=True)
    share = np.bincount(pulse, weights=other) / np.bincount(pulse)
    assert set(share) == {0.0, 1.0}


def test_outliers_lie_below_and_above(town):
    """So many of them as asked, and all others stay."""
    _, (cloud,), _ = town
    x, y, z = moved(cloud, with_outliers(cloud, 0.1, low_m=10, high_m=50))
    assert not x.any()
    assert not y.any()
    assert 0.08 < np.mean(z != 0) < 0.12
    assert -10 <= z.min() < -5
    assert 45 < z.max() <= 50


@pytest.mark.parametrize(("azimuth_deg", "east", "north"), [(90.0, 1, 0), (180.0, 0, -1)])
def test_buildings_hide_what_is_behind_them_from_a_strip_that_looks_aside(town, azimuth_deg, east, north):
    """Ground beside walls is hidden where the roof is between it and the sensor, as far as roofs are high."""
    _, (cloud,), _ = town
    slope = 0.5
    copy = seen_from_aside(cloud, slope, azimuth_deg)
    x, y, z, roof = (np.asarray(cloud[name], dtype=float) for name in ("x", "y", "z", "classification"))
    roof = roof == BUILDING_CLASS
    gone = ~np.isin(np.asarray(cloud.gps_time), np.asarray(copy.gps_time))
    assert len(copy.points) == np.count_nonzero(~gone) < len(cloud.points)
    ground = (np.asarray(cloud.classification) == GROUND_CLASS) & (np.asarray(cloud.return_number) == 1)
    roofs = KDTree(np.column_stack((x, y))[roof])
    high_m = z[roof].max() - z[ground].min()
    away_m, _ = roofs.query(np.column_stack((x, y))[ground & gone])
    assert away_m.max() < slope * high_m + 1
    # Two metres beside a wall, away from the sensor, next to nothing is seen of the ground; towards it all is.
    edge = np.column_stack((x, y))[roof]
    for side, most, least in ((-1, 1.0, 0.7), (1, 0.1, 0.0)):
        beside = edge + side * 1.5 * np.array([east, north])
        beside = beside[roofs.query(beside)[0] > 1.2]
        distance, of = KDTree(np.column_stack((x, y))[ground]).query(beside)
        share = gone[ground][of[distance < 0.5]].mean()
        assert least <= share <= most


def test_without_times_each_echo_is_a_pulse(town):
    """A file whose times are all alike is thinned point by point."""
    _, (cloud,), _ = town
    other = with_class_alone(cloud, None)
    other.gps_time = np.zeros(len(cloud.points))
    assert len(np.unique(pulses(other))) == len(cloud.points)
    assert len(np.unique(pulses(cloud))) == np.count_nonzero(cloud.return_number == 1)


def test_a_sensor_of_one_echo_numbers_all_as_one_of_one(town):
    """Later echoes are gone, and nothing tells that they were."""
    _, (cloud,), _ = town
    copy = first_only(cloud)
    assert len(copy.points) == np.count_nonzero(cloud.return_number == 1) < len(cloud.points)
    assert set(copy.return_number) == set(copy.number_of_returns) == {1}
    assert set(with_class_alone(cloud, 2).classification) == {1, 2}
    assert 6 in cloud.classification


def test_a_weaker_sensor_keeps_all_first_echoes_and_a_share_of_the_others(town):
    """Pulses that keep their later echoes keep all of them; the others are numbered 1 of 1."""
    _, (cloud,), _ = town
    for share in (0.0, 0.4, 1.0):
        copy = with_fewer_later(cloud, share)
        first = np.asarray(copy.return_number) == 1
        assert np.count_nonzero(first) == np.count_nonzero(cloud.return_number == 1)
        split = [np.mean(np.asarray(each.number_of_returns)[each.return_number == 1] > 1) for each in (copy, cloud)]
        assert split[0] == pytest.approx(share * split[1], abs=0.02)
        _, of_pulse = np.unique(copy.gps_time, return_counts=True)
        assert sorted(np.asarray(copy.number_of_returns)[first]) == sorted(of_pulse)


def test_echoes_nearer_than_a_sensor_separates_are_lost(town):
    """Echoes too near below the last one recorded are gone; the rest of the pulse is numbered anew, from above."""
    _, (cloud,), _ = town
    for least_m in (0.0, 2.0, 5.0):
        copy = with_echoes_apart(cloud, least_m)
        order = np.lexsort((copy.return_number, copy.gps_time))
        times, z = np.asarray(copy.gps_time)[order], np.asarray(copy.z)[order]
        same = times[1:] == times[:-1]
        assert same.any()
        assert (z[:-1] - z[1:])[same].min() >= least_m
        assert (np.diff(np.asarray(copy.return_number)[order].astype(int))[same] == 1).all()
        last = np.append(~same, True)
        assert (np.asarray(copy.return_number)[order][last] == np.asarray(copy.number_of_returns)[order][last]).all()
    assert len(with_echoes_apart(cloud, 0.0).points) == len(cloud.points)


def test_a_town_over_hills_keeps_its_roofs_level_and_lays_its_ground_on_the_relief():
    """The ground rises by the relief; a house by its mean, as one."""
    x, y = (place.ravel().astype(float) for place in np.meshgrid(np.arange(60), np.arange(40)))
    house = (x >= 20) & (x < 30) & (y >= 10) & (y < 22)
    classes = np.where(house, 6, 2).astype(np.uint8)
    z = np.where(house, 5.0, 0.0)
    for relief in (*hills.RELIEFS.values(), *hills.STEEPER.values()):
        laid = hills.lifted(x, y, z, classes, relief)
        np.testing.assert_allclose(laid[~house], relief(x, y)[~house])
        np.testing.assert_allclose(laid[house], 5.0 + relief(x, y)[house].mean())
    assert hills.TERRACES(x, y).max() > 10
    # A block beyond the largest size goes up the slope in steps.
    block = np.where((x > 5) & (y > 2), 6, 2).astype(np.uint8)
    assert len(np.unique(hills.lifted(x, y, z * 0, block, hills.slope)[block == 6].round(6))) > 2


@pytest.fixture(scope="module")
def orchard():
    """Return a meadow with a tree of 8 m, a pulse each 0.25 m; a second echo lies beneath the crown."""
    x, y = (place.ravel() for place in np.meshgrid(np.arange(0, 30, 0.25), np.arange(0, 30, 0.25)))
    away = np.hypot(x - 15, y - 15)
    header = laspy.LasHeader(version="1.4", point_format=6)
    header.scales = [0.001] * 3
    cloud = laspy.LasData(header, laspy.ScaleAwarePointRecord.zeros(2 * len(x), header=header))
    crown = away < 3
    kept = np.concatenate([np.ones(len(x), dtype=bool), crown])
    cloud.x, cloud.y = np.tile(x, 2), np.tile(y, 2)
    cloud.z = np.concatenate([np.where(crown, 8 - away, 0), np.zeros(len(x))])
    cloud.classification = np.concatenate([np.where(crown, 5, 2), np.full(len(x), 2)]).astype(np.uint8)
    cloud.return_number = np.repeat([1, 2], len(x)).astype(np.uint8)
    cloud.number_of_returns = np.tile(np.where(crown, 2, 1), 2).astype(np.uint8)
    cloud.gps_time, cloud.intensity = np.tile(np.arange(len(x)), 2).astype(float), np.full(2 * len(x), 100, np.uint16)
    return taken(cloud, kept)


@pytest.mark.parametrize("kind", scrub.PLANTS)
def test_low_plants_stand_on_bare_ground_alone(town, kind):
    """They hide the ground for most pulses, and no other echo moves."""
    _, (cloud,), _ = town
    copy = scrub.overgrown(cloud, kind)
    x, y, z = moved(cloud, copy)
    grown = z > 0.2
    assert not x.any()
    assert not y.any()
    np.testing.assert_array_equal(z[~grown], 0)
    assert (np.asarray(cloud.classification)[grown] == GROUND_CLASS).all()
    assert (np.asarray(cloud.return_number)[grown] == 1).all()
    assert (np.asarray(copy.classification)[grown] == UNCLASSIFIED_CLASS).all()
    bare = (np.asarray(cloud.classification) == GROUND_CLASS) & (np.asarray(cloud.return_number) == 1)
    assert 0.05 < grown.sum() / bare.sum() < 0.4
    assert 2.4 < np.median(z[grown]) < 3.0
    _, rough_m, _ = scrub.PLANTS[kind]
    assert z[grown].std() > 0.9 * rough_m
    np.testing.assert_array_equal(scrub.overgrown(cloud, kind).z, copy.z)


def test_trees_of_another_place_are_planted_with_their_columns(town, orchard):
    """They stand beside houses, on the ground, with all their echoes; beneath them nothing else is left."""
    _, (cloud,), _ = town
    [crown] = trees.crowns_of(orchard, 1.0)
    assert len(crown.cells) * trees.CELL_M**2 == pytest.approx(np.pi * 9, rel=0.2)
    copy = trees.planted(cloud, [crown], 40.0)
    old = np.isin(np.asarray(copy.gps_time), np.asarray(cloud.gps_time))
    there = trees.Town.of(cloud)
    stands = there.stands([crown], 40.0)
    assert len(stands) >= 3
    assert np.count_nonzero(~old) == len(stands) * len(crown.east)
    assert not any(np.isfinite(there.roofs[tuple(stem)]) for _, stem in stands)
    tall = ~old & (copy.classification == 5) & (copy.return_number == 1)
    assert np.asarray(copy.z)[tall].max() == pytest.approx(8 + there.ground.mean(), abs=1.0)
    own = {tuple(cell) for _, stem in stands for cell in (crown.cells + stem).tolist()}
    cells = np.floor((np.column_stack((copy.y, copy.x)) - [there.south, there.west]) / trees.CELL_M).astype(int)
    assert not own & {tuple(cell) for cell in cells[old].tolist()}
    np.testing.assert_array_equal(np.asarray(trees.planted(cloud, [crown], 40.0).z), np.asarray(copy.z))
    assert len(trees.crowns_of(orchard, 0.5)[0].east) < 0.7 * len(crown.east)


@pytest.mark.parametrize("share", [0.0, 0.5, 1.0])
def test_of_a_razed_town_few_houses_are_left_on_bare_ground(town, share):
    """What is left stays where it was; what goes leaves single echoes of the ground around it."""
    _, (cloud,), _ = town
    copy = razed(cloud, share)
    roofs, left = (np.asarray(each.classification) == BUILDING_CLASS for each in (cloud, copy))
    assert share * 0.3 <= left.sum() / roofs.sum() <= share + 0.05
    old, kept = (
        {tuple(echo) for echo in np.column_stack((each.X, each.Y, each.Z))[chosen].tolist()}
        for each, chosen in ((cloud, roofs), (copy, left))
    )
    assert kept <= old
    ground = np.asarray(cloud.z)[np.asarray(cloud.classification) == GROUND_CLASS]
    bare = np.asarray(copy.classification) == GROUND_CLASS
    assert np.asarray(copy.z)[bare].max() <= ground.max() + 0.3
    if share == 1:
        np.testing.assert_array_equal(np.asarray(copy.z), np.asarray(cloud.z))
    else:
        before = {tuple(echo) for echo in np.column_stack((cloud.X, cloud.Y, cloud.Z)).tolist()}
        moved_down = [tuple(echo) not in before for echo in np.column_stack((copy.X, copy.Y, copy.Z)).tolist()]
        assert (np.asarray(copy.return_number)[moved_down] <= 1).all()
        assert (np.asarray(copy.number_of_returns)[moved_down] == 1).all()
        assert bare.sum() >= len(ground) + 0.3 * roofs.sum()


def test_a_mirrored_town_meets_itself_at_its_edges(town):
    """Four copies have four times the points, and the second is the first from its other side."""
    _, (cloud,), _ = town
    four, count = mirrored(cloud, 2), len(cloud.points)
    assert len(four.points) == 4 * count
    x = np.asarray(cloud.X, dtype=np.int64)
    # Copies go by columns, and in them by rows.
    east = np.asarray(four.X, dtype=np.int64)[2 * count : 3 * count]
    assert len(np.unique(east + x)) == 1
    assert east.min() == x.max() + 1
    np.testing.assert_array_equal(np.asarray(four.X)[:count], x)


def test_a_real_relief_begins_at_its_south_western_corner_and_is_mirrored():
    """Beyond the border it comes back, without a step."""
    spec = lattice((0, 0.1, 2.9, 1.9), 1.0, scenes.UTM33)
    values = np.array([[5, 6, 8], [1, 2, 3]], dtype=np.float32)
    relief = hills.relief_of(Grid(values, np.ones((2, 3), dtype=bool), spec))
    assert relief(np.array([0.5, 2.5, 3.5, 5.5, 0.5]), np.array([0.5, 0.5, 0.5, 1.5, 2.5])).tolist() == [0, 2, 2, 4, 4]


def test_a_case_is_measured_on_each_ground(town, places):
    """Detectors, buildings and objects have figures; the houses are found, and the page says so."""
    place, clouds, data = town
    reference = reference_of(place, clouds, data, 0.5)
    # The library of the cloth simulation is not among those of the tests.
    known = {"pdal": None, "whitebox": 50.0, "cloth": None}
    row = measure(Case("town", place.crs, clouds, reference, known), (OWN, "smrf", GIVEN))
    assert min(row["buildings"], row["smrf"], row[GIVEN]) > 80
    assert row["found"].covered == row["found"].all == row["true"].covered == row["true"].all > 0
    assert all(50 < row[name] <= 100 for name in ("multiscale", "flatregions", "area3d", "adaptive"))
    text = places.section(places.TABLES["places"], [row, row])
    header, _, first, _, mean = text.splitlines()[4:]
    assert header.startswith("| case | density | pdal |")
    assert first.startswith("| town | 4.")
    assert f"| {2 * row['found'].all}/{2 * row['found'].all} |" in mean
    assert mean.startswith("| mean | \N{EN DASH} | \N{EN DASH} | 50.0 |")


def test_smrf_finds_the_ground_of_a_town(town):
    """Nearly all true ground, and no roof; the points of two files are filtered together."""
    _, (cloud,), _ = town
    classes = np.asarray(cloud.classification)
    (ground,) = smrf([cloud])
    assert ground[classes == GROUND_CLASS].mean() > 0.95
    assert ground[classes == BUILDING_CLASS].mean() < 0.05
    west = np.asarray(cloud.x) < np.median(cloud.x)
    halves = smrf([taken(cloud, west), taken(cloud, ~west)])
    np.testing.assert_array_equal(np.concatenate(halves), np.concatenate((ground[west], ground[~west])))


def test_tables_that_were_not_measured_stay_on_the_page(places):
    """The others are replaced; the order is that of the script."""
    before = "\n".join(["# Places", "", "## Thinned copies", "", "old thin", "", "## The places", "", "old places", ""])
    after = places.page({"places": "## The places\n\nnew\n"}, before)
    assert "old places" not in after
    assert after.index("new") < after.index("old thin")
    assert places.page({}, after) == after


def test_rows_of_places_that_were_not_measured_stay_in_a_table(places):
    """The page can be read back as it was written; means are those of all rows, and new cases come last."""
    table = places.TABLES["first"]
    facts = dict.fromkeys(table.columns, 80.0) | {"density": 3.0, "true": Objects(2, 3), "class 2": None}
    old = [facts | {"case": "a"}, facts | {"case": "b", "buildings": 90.0}]
    page = places.page({"first": places.section(table, old)}, "")
    assert places.with_others(table, [], page) == old
    both = places.with_others(table, [facts | {"case": "c"}, facts | {"case": "b"}], page)
    assert [row["case"] for row in both] == ["a", "b", "c"]
    assert places.mean([row["buildings"] for row in both], "buildings") == 80
    assert places.mean([row["true"] for row in both], "true") == Objects(6, 9)


def test_wrong_arguments_are_explained(places, monkeypatch, capsys):
    """Before any data is asked for."""
    monkeypatch.setattr("sys.argv", ["places", "--tables", "thinned,thick"])
    with pytest.raises(SystemExit) as ended:
        places.main()
    assert ended.value.code == 2
    assert "got thick" in capsys.readouterr().err


@pytest.mark.parametrize("gaps", [False, True])
def test_rasters_have_gaps_where_no_echo_lies_or_none(town, tmp_path, gaps):
    """Cells with an echo have the highest first one, either way."""
    place, [cloud], data = town
    inputs = as_rasters(tuple(data / file for file in place.files), place.crs, 0.3, tmp_path, gaps=gaps)
    dsm = read_grid(inputs.dsm)
    first = np.asarray(cloud.return_number) == 1
    row, col = dsm.spec.rowcol(np.asarray(cloud.x)[first], np.asarray(cloud.y)[first])
    highest = np.full(dsm.spec.shape, -np.inf, dtype=np.float32)
    np.maximum.at(highest, (row, col), np.asarray(cloud.z)[first].astype(np.float32))
    seen = np.isfinite(highest)
    assert 0.1 < 1 - seen.mean() < 0.9
    np.testing.assert_array_equal(dsm.values[seen], highest[seen])
    np.testing.assert_array_equal(dsm.valid, seen if gaps else True)


def test_two_sensors_meet_at_a_line(town):
    """West of it lie the echoes of the weaker one, and east of it all, with their times and numbers."""
    _, [cloud], _ = town
    middle = float(np.median(np.asarray(cloud.x)))
    found = of_two_sensors(cloud, first_only(cloud), middle)
    x = np.asarray(found.x)
    assert np.asarray(found.number_of_returns)[x < middle].max() == 1
    east = np.asarray(cloud.x) >= middle
    assert np.count_nonzero(x >= middle) == np.count_nonzero(east)
    assert np.count_nonzero(x < middle) == np.count_nonzero(~east & (np.asarray(cloud.return_number) == 1))
    for field in ("gps_time", "return_number", "z"):
        np.testing.assert_array_equal(np.asarray(found[field])[x >= middle], np.asarray(cloud[field])[east])
