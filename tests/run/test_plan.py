"""The plan of a survey: it is what a build finds by itself, and a tile that is built by it takes all of its values."""

import json
from dataclasses import replace

import geopandas as gpd
import numpy as np
import pytest
import shapely
from click.testing import CliRunner
from simulated import scenes
from simulated.files import write_heights, write_image, write_points

import msbdb
from msbdb.cli.main import cli
from msbdb.database import canonical_dump, open_database
from msbdb.detect.adaptive.offground import ndvi_threshold
from msbdb.detect.area3d.heightscales import height_scales
from msbdb.errors import FileError, InputError, ParameterError
from msbdb.grid import Grid
from msbdb.params import Params, with_values
from msbdb.points.cloud import PointCloud
from msbdb.run.preparation import samples
from msbdb.surveyplan import Plan

AUTO = with_values(Params(), {"scale": {"scales_m2": ()}})
"""With the scales that granulometry finds."""


@pytest.fixture(scope="module")
def tile():
    """Return a tile without vegetation and without second echoes, denser than the rest: a podium with a tower."""
    points = scenes.podium_tower(density=9.0).points
    near = (points.x < points.bounds[0] + 65) & (points.y < points.bounds[1] + 65)
    first = points.take(points.first_echo & near)
    return replace(first, number_of_returns=np.ones(len(first), dtype=np.uint8))


@pytest.fixture(scope="module")
def files(tile, tmp_path_factory):
    """Return the file of the tile, and that of a house among trees beside it."""
    folder = tmp_path_factory.mktemp("tiles")
    trees = scenes.under_trees().points
    east = replace(trees, x=trees.x - trees.bounds[0] + np.ceil(tile.bounds[2]))
    return write_points(folder / "tower.laz", tile), write_points(folder / "trees.laz", east)


@pytest.fixture(scope="module")
def city(files):
    """Return the plan of both."""
    return msbdb.plan(files, params=AUTO)


@pytest.fixture(scope="module")
def alone(files, tmp_path_factory):
    """Return a database of the tile, built by itself."""
    db = tmp_path_factory.mktemp("alone") / "tower.sqlite"
    msbdb.build(files[0], db=db, params=AUTO)
    return db


def dump(db):
    """Return the whole content."""
    engine = open_database(db)
    lines = list(canonical_dump(engine, provenance=True))
    engine.dispose()
    return lines


def test_a_build_by_the_plan_of_its_own_files_has_the_same_content(files, alone, tmp_path):
    """The plan of the command is the one that the build kept, also as a file, and gives the same dump."""
    shown = CliRunner().invoke(cli, ["plan", "--points", str(files[0]), "--scales", "auto", "--json"])
    kept = CliRunner().invoke(cli, ["plan", str(alone), "--json"])
    assert (shown.exit_code, kept.exit_code) == (0, 0), shown.stderr + kept.stderr
    assert shown.stdout == kept.stdout
    (tmp_path / "tower.json").write_text(shown.stdout)
    db = tmp_path / "tower.sqlite"
    msbdb.build(files[0], db=db, plan=tmp_path / "tower.json", params=AUTO)
    assert dump(db) == dump(alone)
    words = CliRunner().invoke(cli, ["plan", str(alone)])
    assert "first echoes" in words.stdout


def test_a_tile_takes_the_values_of_the_city(files, alone, city, tmp_path):
    """Cells, spacing, echoes, scales, thresholds and classes are the city's, where the tile's own are others."""
    own = msbdb.read_plan(alone)
    assert own.points.echoes != city.points.echoes
    for name in ("cell_m", "density", "points", "scales_m2", "heights_m", "classes"):
        assert getattr(own, name) != getattr(city, name), name
    db = tmp_path / "tile.sqlite"
    msbdb.build(files[0], db=db, plan=city, params=AUTO)
    assert msbdb.read_plan(db) == city
    run = msbdb.info(db)["runs"][0]
    assert run["chosen"]["spectral"]["centres"] == [list(centre) for centre in city.classes.centres]
    assert tuple(run["chosen"]["scales_m2"]) == city.scales_m2
    assert (run["survey_record"]["cell_m"], run["density"]) == (city.cell_m, pytest.approx(city.density, abs=1e-6))
    found = msbdb.classes(db)
    colours = found[found["source"] == "spectral"]
    assert tuple(colours["label"]) == city.classes.labels
    assert (colours["cells"] == 0).any(), "the tile has no vegetation, and keeps the number of its classes"


def test_a_large_survey_is_planned_from_blocks(monkeypatch, tmp_path):
    """Blocks are drawn by their place, whatever the order of the files; the build of all points takes their plan."""
    monkeypatch.setattr(samples, "MOST_POINTS", 12_000)
    monkeypatch.setattr(samples, "BLOCK_M", 40.0)
    cloud = scenes.under_trees(density=2.0).points
    west = cloud.x < cloud.bounds[0] + 50
    halves = [write_points(tmp_path / f"{n}.laz", cloud.take(half)) for n, half in enumerate((west, ~west))]
    found = msbdb.plan(halves)
    assert found == msbdb.plan(halves[::-1])
    assert found.block_m == 40
    assert 6_000 < found.points.points < 18_000 < len(cloud)
    assert len(found.blocks) == len(set(found.blocks)) > 1
    assert all(place % 40 == 0 for corner in found.blocks for place in corner)
    db = tmp_path / "all.sqlite"
    msbdb.build(halves, db=db, extract="multiscale")
    assert msbdb.read_plan(db) == found
    bounds = msbdb.info(db)["runs"][0]["survey_record"]["bounds"]
    assert bounds[2] - bounds[0] > 99, "the build is of all blocks"


def test_a_stray_point_hides_no_town_from_the_plan(monkeypatch, tmp_path):
    """The box of a header that it widens to tens of kilometres draws no blocks; the points that are read do."""
    monkeypatch.setattr(samples, "MOST_POINTS", 12_000)
    monkeypatch.setattr(samples, "BLOCK_M", 40.0)
    monkeypatch.setattr(samples, "LEAST_BLOCK_M", 20.0)
    p = scenes.under_trees(density=2.0).points
    far = np.arange(len(p)) == 500
    x, y = np.where(far, p.x - 9e4, p.x), np.where(far, p.y - 9e4, p.y)
    file = write_points(tmp_path / "stray.laz", replace(p, x=x, y=y))
    found = msbdb.plan(file)
    west, south, east, north = p.bounds
    assert len(found.blocks) > 1
    assert all(west - 40 < x < east and south - 40 < y < north for x, y in found.blocks)
    assert found.cell_m == msbdb.plan(write_points(tmp_path / "sound.laz", p.take(~far))).cell_m


def test_cells_bound_the_plan_as_points_do(monkeypatch, tmp_path):
    """A survey of few points on many cells is planned from blocks that hold as many cells as the memory takes."""
    monkeypatch.setattr(samples, "BLOCK_M", 40.0)
    monkeypatch.setattr(samples, "LEAST_BLOCK_M", 20.0)
    file = write_points(tmp_path / "sparse.laz", scenes.under_trees(density=2.0).points)
    every = msbdb.plan(file)
    fine = with_values(Params(), {"surface": {"cell_m": 0.25}})
    assert every.blocks == msbdb.plan(file, params=fine).blocks == ()
    monkeypatch.setattr(samples, "MOST_BYTES", samples.bytes_to_plan(every.points.points, 70.0**2, 0.25, fine))
    found = msbdb.plan(file, params=fine)
    assert found.block_m == 20, "a block takes a quarter of the memory at most"
    cells = len(found.blocks) * found.block_m**2 / 0.25**2
    assert len(found.blocks) > 2
    assert cells * samples.CELL_BYTES < samples.MOST_BYTES + samples.bytes_to_plan(0, 40.0**2, 0.25, fine)
    assert msbdb.plan(file).blocks == (), "cells of a metre are few enough"


def test_a_lattice_that_is_wide_beside_its_points_is_planned_from_blocks(monkeypatch, tmp_path):
    """Points in two far corners of one file span more cells than the header tells; the build has that plan, too."""
    monkeypatch.setattr(samples, "BLOCK_M", 40.0)
    monkeypatch.setattr(samples, "LEAST_BLOCK_M", 20.0)
    cloud = scenes.under_trees(density=2.0).points
    places = {name: np.append(getattr(cloud, name), getattr(cloud, name) + 600 * (name != "z")) for name in "xyz"}
    twice = {name: np.append(value, value, axis=0) for name, value in cloud.arrays().items() if name not in places}
    file = write_points(tmp_path / "two.laz", replace(cloud, **places, **twice))
    monkeypatch.setattr(samples, "MOST_BYTES", samples.bytes_to_plan(2 * len(cloud), 400.0**2, 1.0, Params()))
    found = msbdb.plan(file)
    assert found.blocks
    for tile in (None, 1000):
        db = tmp_path / f"{tile}.sqlite"
        msbdb.build(file, db=db, extract="multiscale", tile=tile)
        assert msbdb.read_plan(db) == found


def test_a_sample_lies_in_the_area_of_interest(monkeypatch, tmp_path):
    """Of a large area the plan draws blocks, and looks at nothing outside; a small one it sees as a whole."""
    monkeypatch.setattr(samples, "BLOCK_M", 20.0)
    cloud = scenes.under_trees(density=2.0).points
    file = write_points(tmp_path / "all.laz", cloud)
    west, south, _, north = cloud.bounds
    shape = shapely.box(west, south, west + 50, north)
    area = tmp_path / "half.gpkg"
    gpd.GeoDataFrame(geometry=[shape], crs=cloud.crs).to_file(area)
    assert msbdb.plan(file, aoi=area).blocks == ()
    monkeypatch.setattr(samples, "MOST_POINTS", 3_000)
    found = msbdb.plan(file, aoi=area)
    assert len(found.blocks) > 1
    assert all(shape.intersects(shapely.box(x, y, x + 20, y + 20)) for x, y in found.blocks)


def test_points_of_a_part_keep_what_the_whole_has(city):
    """Whether attributes hold information, and what is lone, is decided by the whole."""
    single = np.ones(4, dtype=np.uint8)
    few = PointCloud(
        np.arange(4.0), np.zeros(4), np.zeros(4), scenes.podium_tower().points.crs,
        return_number=single, number_of_returns=single,
    )  # fmt: skip
    assert not few.has_echoes
    assert replace(few, facts=city.points).has_echoes


def test_a_plan_is_the_same_after_json(city):
    """Values, unknown ones included, come back to the last bit, and the text has one order."""
    again = Plan.from_json(city.as_json())
    assert again == city
    shuffled = dict(reversed(list(json.loads(city.as_json()).items())))
    assert Plan.from_dict(shuffled).as_json() == city.as_json()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"form": 2}, "has the form 2"),
        ({"cell_m": "wide"}, "no plan"),
        ({"more": 1}, "more"),
        ({"points": {"density": 1.0}}, "lacks"),
    ],
)
def test_what_is_no_plan_is_refused(city, change, words):
    """The message says what is wrong with it."""
    with pytest.raises(InputError, match=words):
        Plan.from_dict(city.as_dict() | change)


def test_a_plan_in_a_file_that_cannot_be_read_is_refused(tmp_path):
    """A missing file and one that is no JSON are named."""
    with pytest.raises(FileError, match=r"missing\.json cannot be read"):
        msbdb.read_plan(tmp_path / "missing.json")
    (tmp_path / "text.json").write_text("no plan")
    with pytest.raises(InputError, match="no plan"):
        msbdb.read_plan(tmp_path / "text.json")


def test_other_parameters_than_the_plans_are_refused(files, city, tmp_path):
    """Values that follow from parameters hold only for these; nothing is written."""
    finer = with_values(AUTO, {"surface": {"cell_m": 0.25}})
    with pytest.raises(ParameterError, match=r"surface\.cell_m = 0\.0; the build has 0\.25"):
        msbdb.build(files[0], db=tmp_path / "town.sqlite", plan=city, params=finer)
    assert not (tmp_path / "town.sqlite").exists()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"crs": "EPSG:25832"}, "EPSG:25832"),
        ({"points": None}, "rasters"),
        ({"ground_filter": "given"}, "a given terrain"),
        ({"cell_m": 7.0}, "cells of 7 m"),
    ],
)
def test_a_plan_of_another_kind_of_survey_is_refused(files, city, tmp_path, change, words):
    """CRS, source, terrain and lattice must be the plan's."""
    with pytest.raises(InputError, match=words):
        msbdb.build(files[0], db=tmp_path / "town.sqlite", plan=replace(city, **change), params=AUTO)


def test_rasters_have_a_plan_without_points(tmp_path):
    """It holds what their cells give, also the heights at which area3d looks at them."""
    scene = scenes.podium_tower()
    file = write_heights(tmp_path / "ndsm.tif", Grid(scene.heights, np.ones(scene.spec.shape, bool), scene.spec))
    found = msbdb.plan(ndsm=file)
    assert (found.points, found.classes, found.ground_filter) == (None, None, "given")
    assert found.cell_m == scene.spec.cell_m
    heights = height_scales(scene.heights.ravel(), Params().area3d, mask_m=Params().surface.mask_m)
    assert found.heights_m == pytest.approx(heights)
    assert len(found.heights_m) > 1


@pytest.mark.parametrize("names", [("nir", "red", "green"), ("red", "green", "blue")])
def test_rasters_with_near_infrared_have_its_threshold(tmp_path, names):
    """That of the cells above the mask, as of points; without near infrared there is none."""
    scene = scenes.podium_tower()
    file = write_heights(tmp_path / "ndsm.tif", Grid(scene.heights, np.ones(scene.spec.shape, bool), scene.spec))
    picture = np.random.default_rng(1).integers(100, 200, (3, *scene.spec.shape)).astype(np.uint8)
    picture[0] += 40
    ortho = write_image(tmp_path / "picture.tif", picture, scene.spec, names)
    found = msbdb.plan(ndsm=file, ortho=ortho)
    if "nir" not in names:
        assert found.ndvi_threshold is None
        return
    nir, red = picture[:2].astype(np.float64)
    high = scene.heights >= Params().surface.mask_m
    expected = ndvi_threshold(((nir - red) / (nir + red))[high], Params().adaptive)
    assert found.ndvi_threshold == pytest.approx(expected, abs=1e-3)
    assert 0 < expected < 0.2
