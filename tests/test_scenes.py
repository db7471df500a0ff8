"""The simulated scenes keep their own promises; every test of the pipeline stands on them."""

import numpy as np
import pytest
from simulated import scenes

FAST = [name for name in scenes.SCENES if name != "city"]


@pytest.fixture(scope="module", params=list(scenes.SCENES))
def scene(request):
    """Every scene once."""
    return scenes.SCENES[request.param]()


def test_density_is_as_asked(scene):
    """First echoes a square metre equal the density of pulses, on average and in nearly every 5 m square."""
    points = scene.points.take(scene.points.first_echo)
    width, depth = scene.world.size
    asked = 2.0 if scene.name == "large_building" else 4.0
    assert len(points) / (width * depth) == pytest.approx(asked, rel=0.02)
    counts, _, _ = np.histogram2d(points.x, points.y, bins=(int(width / 5), int(depth / 5)))
    assert abs(np.median(counts) / 25 - asked) < 0.1 * asked
    assert counts.min() > 0.5 * asked * 25


def test_echo_numbers_are_consistent(scene):
    """Echoes of a pulse are numbered 1..n from the top down, all at one position, and n is how many there are."""
    points = scene.points
    start = np.flatnonzero(points.return_number == 1)
    pulse = np.cumsum(points.return_number == 1) - 1
    assert (points.number_of_returns == np.diff(np.append(start, len(points)))[pulse]).all()
    assert (points.return_number == np.arange(len(points)) - start[pulse] + 1).all()
    later = np.flatnonzero(points.return_number > 1)
    assert (points.z[later] < points.z[later - 1]).all()
    assert (points.x[later] == points.x[later - 1]).all()
    assert (points.y[later] == points.y[later - 1]).all()


def test_truth_lies_where_the_points_are(scene):
    """Points labelled ground are on the true ground, and those labelled building on the true roof of their cell."""
    points, spec = scene.points, scene.spec
    above = points.z - scene.ground(points.x, points.y)
    on_ground = scene.labels == scenes.GROUND
    steep = {"plateau": 0.9, "attached_to_slope": 0.2}.get(scene.name, 0.0)
    assert np.abs(above[on_ground]).max() < 0.2 + steep
    row, col = spec.rowcol(points.x, points.y)
    assert row.min() >= 0
    assert col.min() >= 0
    assert row.max() < spec.shape[0]
    assert col.max() < spec.shape[1]
    roof = scene.labels == scenes.BUILDING
    inside = scene.buildings[row, col] > 0
    if roof.any():
        assert inside[roof].mean() > 0.95
        error = np.abs(above - scene.heights[row, col])[roof & inside]
        assert np.percentile(error, 90) < 0.4
    assert ((scene.heights > 0) == (scene.buildings > 0)).all()


def test_forest_agrees_with_the_raster(scene):
    """Every root shows its area above 2 m in the truth raster, and every father is itself listed and larger."""
    by_name = {fact.name: fact for fact in scene.forest}
    cell = scene.spec.cell_area_m2
    for fact in scene.forest:
        if fact.father is None:
            standing = (scene.buildings == fact.building) & (scene.heights >= 2.0)
            assert standing.sum() * cell == pytest.approx(fact.area_m2, rel=0.01)
        else:
            assert by_name[fact.father].area_m2 > fact.area_m2
            assert by_name[fact.father].height_m < fact.height_m


@pytest.mark.parametrize("name", FAST)
def test_seed_fixes_the_scene(name):
    """The same seed gives the same points; another seed gives others, with the same truth."""
    first, again, other = (scenes.SCENES[name](seed=seed) for seed in (1, 1, 2))
    for key, values in first.points.arrays().items():
        np.testing.assert_array_equal(values, again.points.arrays()[key])
    assert not np.array_equal(first.points.x[:100], other.points.x[:100])
    np.testing.assert_array_equal(first.buildings, other.buildings)
    np.testing.assert_array_equal(first.heights, other.heights)


def test_density_and_cell_are_options():
    """A sparser scan has fewer pulses; the truth's cell is free and keeps the areas."""
    scene = scenes.podium_tower(density=1.0, cell_m=1.0)
    assert scene.points.first_echo.sum() == 100 * 100
    assert scene.spec.shape == (100, 100)
    assert (scene.buildings == 1).sum() == 1200


def test_classes_are_given_only_on_demand():
    """Points come unclassified; asked for, the classes are the truth."""
    assert scenes.flat_field().points.classification is None
    scene = scenes.podium_tower(classified=True)
    np.testing.assert_array_equal(scene.points.classification, scene.labels)


def test_crowns_scatter_several_echoes_and_let_some_pulses_through():
    """Pulses in crowns have up to three echoes or more, and some reach ground or roof beneath."""
    scene = scenes.under_trees()
    points, spec = scene.points, scene.spec
    row, col = spec.rowcol(points.x, points.y)
    in_crown = scene.cover[row, col] == scenes.VEGETATION
    assert points.number_of_returns[in_crown].max() >= 4
    first = in_crown & points.first_echo
    assert 0.3 < (points.number_of_returns[first] > 1).mean() < 0.95
    assert (scene.labels[in_crown] == scenes.GROUND).mean() > 0.05
    assert (scene.labels[in_crown & (scene.buildings[row, col] > 0)] == scenes.BUILDING).any()


def test_gap_of_row_houses_is_one_spacing():
    """Between neighbouring houses lies a gap of one mean pulse spacing, or as wide as asked."""
    west = sorted(b.west for b in scenes.row_houses(density=1.0).world.blocks if b.south < 40)
    assert np.diff(west) == pytest.approx(9.0)
    scene = scenes.row_houses()
    columns = (scene.buildings > 0).any(axis=0)
    inner = columns[columns.argmax() : columns.size - columns[::-1].argmax()]
    assert (~inner).sum() == 5


def test_large_building_is_cut_by_every_usual_tile_grid():
    """The hall covers a whole kilometre's corner, so tiles of any divisor of 1 km meet inside it."""
    scene = scenes.large_building()
    row, col = scene.spec.rowcol(np.array([scenes.ORIGIN[0]]), np.array([scenes.ORIGIN[1]]))
    assert scene.buildings[row[0] - 1 : row[0] + 1, col[0] - 1 : col[0] + 1].all()


def test_ortho_shows_the_roofs_on_any_lattice():
    """The orthophoto has four bands, its NIR tells crowns and lawns from roofs, and its seed fixes it."""
    scene = scenes.green_roof()
    image = scene.ortho(scene.spec)
    assert image.shape == (4, *scene.spec.shape)
    assert image.dtype == np.float32
    ndvi = (image[3] - image[0]) / (image[3] + image[0])
    assert ndvi[scene.cover == scenes.VEGETATION].mean() > 0.3
    rim = scene.spec.rowcol(scene.world.origin[0] + np.array([36.0]), scene.world.origin[1] + np.array([50.0]))
    lawn = scene.spec.rowcol(scene.world.origin[0] + np.array([50.0]), scene.world.origin[1] + np.array([50.0]))
    assert ndvi[rim][0] < 0.1 < ndvi[lawn][0]
    np.testing.assert_array_equal(image, scene.ortho(scene.spec))
