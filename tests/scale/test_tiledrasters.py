"""A build in tiles from rasters of heights: the content of the build of the whole, by windows of their own cells."""

import random
from dataclasses import replace
from functools import partial
from pathlib import Path

import geopandas as gpd
import numpy as np
import pytest
import rasterio
import shapely
from affine import Affine
from simulated.files import write_heights
from simulated.scenes import DATUM_M
from support.tiledtown import TILE_M, town, write_rasters, write_vrt

import msbdb
from msbdb.database import canonical_dump, check_database, opened, read_run
from msbdb.errors import FileError, NodataError, TilesError, collected_notices
from msbdb.grid import Grid, GridSpec
from msbdb.io.raster import align_grid, read_grid
from msbdb.params import Params
from msbdb.run.inputs import Inputs
from msbdb.run.preparation import cellblocks, rastersurface
from msbdb.run.preparation.prepare import Label, prepare
from msbdb.run.preparation.rastersurface import NARROW_GAPS, NO_TERRAIN
from msbdb.run.reports import Stages
from msbdb.scale import cluster, tiledbuild, tilework
from msbdb.surface import without_narrow_gaps

GIVEN = {"survey": "town", "tile": TILE_M}


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """Return DSM, DTM and orthophoto of the town by role."""
    return write_rasters(tmp_path_factory.mktemp("town"))


@pytest.fixture(scope="module")
def whole(files, tmp_path_factory):
    """Return a database of the town that is built in one piece."""
    db = tmp_path_factory.mktemp("whole") / "town.sqlite"
    msbdb.build(**files, db=db, survey="town")
    return db


@pytest.fixture(scope="module")
def quick(files, tmp_path_factory):
    """Return a database of the town that is built in tiles, in one go."""
    db = tmp_path_factory.mktemp("quick") / "town.sqlite"
    msbdb.build(**files, db=db, **GIVEN)
    return db


def lines(db):
    """Return the lines of the dump of a sound database."""
    with opened(db) as engine:
        found = list(canonical_dump(engine))
        assert not check_database(engine)
    return found


def content(db, *without):
    """Return the lines without the counts of the run, and without other tables."""
    return [line for line in lines(db) if not line.startswith(tuple(f'["{name}", ' for name in ("run", *without)))]


def notices(db):
    """Return the notices of the run."""
    with opened(db) as engine:
        return read_run(engine).notices


@pytest.mark.parametrize("tile", [TILE_M, 75.3])
def test_windows_that_hold_the_whole_give_its_content(files, whole, tmp_path, tile):
    """All rows and all rasters are equal, beside the absolute lattice too; edges of tiles are those of cells."""
    db = tmp_path / "town.sqlite"
    report = msbdb.build(**files, db=db, survey="town", tile=tile)
    assert content(db) == content(whole)
    assert report.buildings == 5
    assert set(notices(whole)) <= set(notices(db))
    assert NARROW_GAPS not in notices(db)
    with rasterio.open(files["dsm"]) as image:
        west, north, cells = image.transform.c, image.transform.f, image.read(1)
    held = msbdb.tiles(db)
    assert len(held) > 3
    for one in held:
        for along in (one.west - west, one.east - west, one.north - north, one.south - north):
            assert along == pytest.approx(round(along), abs=1e-6)
    assert sum(one.points for one in held) == np.count_nonzero((cells > -9999) & (cells < 1e5))


@pytest.mark.parametrize(("cell_m", "ground_m"), [(0.7, 0.7), (0.9144018288, 3.0)])
def test_cells_without_a_round_side_are_counted_alike(tmp_path, cell_m, ground_m):
    """Places of cells are equal to the last bit in every window, for a DTM on the same cells and on others."""
    files = write_rasters(tmp_path / "files", cell_m=cell_m, ground_m=ground_m)
    given = {name: files[name] for name in ("dsm", "dtm")} | {"survey": "town"}
    msbdb.build(**given, db=tmp_path / "one.sqlite")
    msbdb.build(**given, db=tmp_path / "tiles.sqlite", tile=TILE_M)
    assert content(tmp_path / "tiles.sqlite") == content(tmp_path / "one.sqlite")


def write_ndsm(files, path):
    """Write the heights of the town above ground."""
    dsm, dtm = (read_grid(files[role], role=role.upper()) for role in ("dsm", "dtm"))
    with collected_notices():
        ground = align_grid(dtm, dsm.spec)
    valid = dsm.valid & ground.valid
    return write_heights(path, Grid(np.where(valid, dsm.values - ground.values, 0), valid, dsm.spec))


def with_gaps(path, gaps):
    """Write a raster of heights without six in ten of the cells of its western half, and one in ten of the others."""
    with rasterio.open(path) as image:
        heights, profile, nodata = image.read(1), image.profile, image.nodata
    share = np.where(np.arange(heights.shape[1]) < heights.shape[1] / 2, 0.6, 0.1)
    heights[np.random.default_rng(2).random(heights.shape) < share] = nodata
    with rasterio.open(gaps, "w", **profile) as image:
        image.write(heights, 1)
    return gaps


@pytest.mark.parametrize("role", ["dsm", "ndsm"])
def test_cells_that_fill_gaps_are_no_samples(files, tmp_path, role):
    """They have a height, but the texture is that of the measured ones."""
    full = files["dsm"] if role == "dsm" else write_ndsm(files, tmp_path / "full.tif")
    gaps = with_gaps(full, tmp_path / "gaps.tif")
    inputs = Inputs(dsm=gaps, dtm=files["dtm"]) if role == "dsm" else Inputs(ndsm=gaps)
    with collected_notices() as given:
        surface = rastersurface.surface_of_rasters(inputs, 1.0)
    assert NARROW_GAPS in map(str, given)
    measured = read_grid(gaps).valid
    np.testing.assert_array_equal(surface.samples.observed, measured)
    assert np.count_nonzero(surface.ndsm.valid) > 1.4 * np.count_nonzero(surface.ndsm.valid & measured)


@pytest.mark.parametrize("role", ["dsm", "ndsm"])
def test_a_raster_that_nobody_interpolated_gives_the_same_houses(files, tmp_path, role):
    """In tiles, of which some have hardly a gap, and as a whole; with the gaps they fall to pieces."""
    given = {"dtm": files["dtm"], "dsm": files["dsm"]}
    if role == "ndsm":
        given = {"ndsm": write_ndsm(files, tmp_path / "full.tif")}
    msbdb.build(**given, survey="town", db=tmp_path / "full.sqlite")
    given[role] = with_gaps(given[role], tmp_path / "gaps.tif")
    for name, tile in (("one", None), ("tiles", TILE_M)):
        report = msbdb.build(**given, survey="town", db=tmp_path / f"{name}.sqlite", tile=tile)
        assert report.buildings == 5
        assert NARROW_GAPS in report.notices
    assert content(tmp_path / "tiles.sqlite") == content(tmp_path / "one.sqlite")
    found, full = (msbdb.open(tmp_path / f"{name}.sqlite").buildings().geometry.union_all() for name in ("one", "full"))
    assert found.intersection(full).area > 0.8 * found.union(full).area


def test_heights_above_ground_are_cut_in_tiles(files, tmp_path):
    """An nDSM in tiles gives what it gives as a whole."""
    ndsm = write_ndsm(files, tmp_path / "ndsm.tif")
    msbdb.build(ndsm=ndsm, db=tmp_path / "one.sqlite", survey="town")
    msbdb.build(ndsm=ndsm, db=tmp_path / "tiles.sqlite", **GIVEN)
    assert content(tmp_path / "tiles.sqlite") == content(tmp_path / "one.sqlite")


def test_the_order_of_tiles_does_not_matter(files, quick, tmp_path, monkeypatch):
    """The dump is the same to the byte."""
    shuffled = partial(random.Random(3).sample)
    monkeypatch.setattr(
        tiledbuild, "one_by_one", lambda tasks, begin: tilework.one_by_one(shuffled(list(tasks), len(tasks)), begin)
    )
    db = tmp_path / "town.sqlite"
    msbdb.build(**files, db=db, **GIVEN)
    assert lines(db) == lines(quick)


def test_workers_give_the_content_of_one_process(files, quick, tmp_path, monkeypatch):
    """The dump is the same to the byte; these are threads, which open no port."""
    pytest.importorskip("distributed")
    monkeypatch.setattr("distributed.comm.inproc.get_ip", lambda: "127.0.0.1")
    monkeypatch.setattr(cluster, "cluster_of", partial(cluster.cluster_of, processes=False))
    db = tmp_path / "town.sqlite"
    msbdb.build(**files, db=db, **GIVEN, workers=2)
    assert lines(db) == lines(quick)


def test_each_tile_reads_its_window_alone(files, whole, tmp_path, monkeypatch):
    """With a narrow halo no tile reads the whole; the buildings have the same ids and nearly the same areas."""
    monkeypatch.setattr(tiledbuild, "HALO_M", 25.0)
    monkeypatch.setattr(tiledbuild, "MOST_HALO_M", 40.0)
    original, read = read_grid, []

    def counted(path, **given):
        found = original(path, **given)
        read.append((Path(path).stem, found.spec.shape, given.get("within")))
        return found

    monkeypatch.setattr(rastersurface, "read_grid", counted)
    db = tmp_path / "town.sqlite"
    msbdb.build(**files, db=db, **GIVEN)
    assert len(notices(db)) == len(set(notices(db))), "a tile that is built again says all twice"
    windows = [shape for role, shape, within in read if role == "dsm" and within is not None]
    assert len(windows) >= 4
    most = max(rows * columns for rows, columns in windows)
    assert most <= (TILE_M + 80) ** 2
    assert min(rows * columns for rows, columns in windows) < 100 * 100
    ground = [shape for role, shape, _ in read if role == "dtm"]
    assert sum(shape < (60, 60) for shape in ground) >= 2
    with msbdb.open(whole) as one, msbdb.open(db) as other:
        before, after = one.buildings(), other.buildings()
    assert after["building_id"].tolist() == before["building_id"].tolist()
    assert after["area_m2"].to_numpy() == pytest.approx(before["area_m2"].to_numpy(), rel=0.02)


def test_after_a_failure_the_rest_is_built(files, quick, tmp_path, monkeypatch):
    """The tile is named, the others complete, and --resume builds this one alone."""
    db = tmp_path / "town.sqlite"
    original, built = tilework.find_regions, []

    def fails(job, plan, stages, window):
        built.append(window.own)
        if broken and len(built) == 2:
            msg = "the disk is on fire"
            raise OSError(msg)
        return original(job, plan, stages, window)

    monkeypatch.setattr(tilework, "find_regions", fails)
    broken = True
    with pytest.raises(TilesError, match=r"1 tile of \d+ of 'town' failed.*the disk is on fire.*--resume"):
        msbdb.build(**files, db=db, **GIVEN)
    broken, built[:] = False, []
    assert msbdb.build(**files, db=db, **GIVEN, resume=True).changed
    assert len(built) == 1
    assert lines(db) == lines(quick)


def test_the_size_of_tiles_is_found_by_the_cells(files, whole, tmp_path):
    """Resumed, the small town is one tile of the largest size."""
    db = tmp_path / "town.sqlite"
    msbdb.build(**files, db=db, survey="town", resume=True)
    [tile] = msbdb.tiles(db)
    assert tile.east - tile.west == 2000
    assert content(db) == content(whole)


def test_a_large_raster_is_planned_from_blocks(files, tmp_path, monkeypatch):
    """A seeded sample decides, for tiles and the whole alike; a block without a value counts for nothing."""
    monkeypatch.setattr(cellblocks, "MOST_CELLS", 5000)
    monkeypatch.setattr(cellblocks, "MOST_SIDE", 50)
    plan = msbdb.plan(**files)
    assert plan.block_m == 50
    assert 2 <= len(plan.blocks) < 9
    assert all((west - 0.3) % 50 == pytest.approx(0, abs=1e-6) for west, _ in plan.blocks)
    assert plan.classes is not None
    assert plan == msbdb.plan(**files)
    db = tmp_path / "tiles.sqlite"
    msbdb.build(**files, db=db, **GIVEN)
    msbdb.build(**files, db=tmp_path / "one.sqlite", survey="town")
    assert content(db) == content(tmp_path / "one.sqlite")
    assert sum("The DTM has no value" in notice for notice in notices(db)) == 1
    assert len(notices(db)) == len(set(notices(db)))


def test_a_plan_of_blocks_knows_how_many_cells_were_measured(files, tmp_path, monkeypatch):
    """In all blocks together; the whole and its tiles go by that."""
    monkeypatch.setattr(cellblocks, "MOST_CELLS", 5000)
    monkeypatch.setattr(cellblocks, "MOST_SIDE", 50)
    given = {"dsm": with_gaps(files["dsm"], tmp_path / "gaps.tif"), "dtm": files["dtm"]}
    plan = msbdb.plan(**given)
    measured = read_grid(given["dsm"])
    filled = without_narrow_gaps(measured, 1.0)
    inside = [measured.spec.holding((west, south, west + 50, south + 50)) for west, south in plan.blocks]
    cells, covered = (np.array([np.count_nonzero(grid.valid[one]) for one in inside]) for grid in (measured, filled))
    assert min(cells / covered) < 0.5
    assert max(cells / covered) > 0.75
    assert plan.density == pytest.approx(cells.sum() / covered.sum(), abs=0.01)
    with collected_notices():
        part, _, _ = prepare(
            Inputs(**given), None, Params(), Stages(None), Label("town"), plan=replace(plan, density=0.5)
        )
    assert part.require_surface().density == part.survey.density == 0.5
    for name, tile in (("one", None), ("tiles", TILE_M)):
        msbdb.build(**given, survey="town", db=tmp_path / f"{name}.sqlite", tile=tile)
    assert content(tmp_path / "tiles.sqlite") == content(tmp_path / "one.sqlite")


def test_an_area_of_interest_is_cut_in_tiles(files, tmp_path):
    """Rasters are read in the box of the area and its margin, as a whole and in tiles."""
    shape, area = shapely.box(389_095.0, 5_821_075.0, 389_155.0, 5_821_135.0), tmp_path / "district.geojson"
    gpd.GeoDataFrame(geometry=[shape], crs=town().points.crs).to_crs("EPSG:4326").to_file(area)
    msbdb.build(**files, db=tmp_path / "one.sqlite", survey="town", aoi=area)
    msbdb.build(**files, db=tmp_path / "tiles.sqlite", **GIVEN, aoi=area)
    assert content(tmp_path / "tiles.sqlite") == content(tmp_path / "one.sqlite")
    west, south, _, _ = msbdb.info(tmp_path / "one.sqlite")["runs"][0]["survey_record"]["bounds"]
    assert (west, south) == pytest.approx((389_045, 5_821_025), abs=1.5)
    far = tmp_path / "far.geojson"
    gpd.GeoDataFrame(geometry=[shapely.box(0, 0, 1, 1)], crs="EPSG:4326").to_file(far)
    with pytest.raises(msbdb.MsbdbError, match=r"far\.geojson"):
        msbdb.build(**files, db=tmp_path / "far.sqlite", **GIVEN, aoi=far)


def test_a_dsm_that_is_larger_than_its_dtm_is_built_where_both_are(files, tmp_path, monkeypatch):
    """A tile that sees no terrain has no building, and does not fail; the notice says so."""
    monkeypatch.setattr(tiledbuild, "HALO_M", 5.0)
    monkeypatch.setattr(tiledbuild, "MOST_HALO_M", 5.0)
    dsm = read_grid(files["dsm"])
    west, south, _, north = dsm.spec.bounds
    spec = GridSpec((round(north - south), 40), Affine(1, 0, west, 0, -1, north), dsm.spec.crs)
    ground = np.full(spec.shape, DATUM_M, np.float32)
    dtm = write_heights(tmp_path / "dtm.tif", Grid(ground, np.ones(spec.shape, bool), spec))
    db = tmp_path / "town.sqlite"
    report = msbdb.build(dsm=files["dsm"], dtm=dtm, db=db, survey="town", tile=50)
    assert NO_TERRAIN in report.notices
    assert {tile.state for tile in msbdb.tiles(db)} == {"done"}
    assert 0 < report.buildings < 5


def test_rasters_without_a_value_are_refused(files, tmp_path):
    """As in one piece, no database is made."""
    with rasterio.open(files["dsm"]) as image:
        profile = image.profile
    with rasterio.open(tmp_path / "dsm.tif", "w", **profile) as image:
        image.write(np.full(image.shape, -9999, np.float32), 1)
    with pytest.raises(NodataError, match="has no valid cell"):
        msbdb.build(dsm=tmp_path / "dsm.tif", dtm=files["dtm"], db=tmp_path / "town.sqlite", **GIVEN)
    assert not (tmp_path / "town.sqlite").exists()


def test_a_virtual_raster_over_pieces_serves_as_one_file(files, quick, tmp_path):
    """The content is that of the raster; the checksum is that of the pieces, so that other ones are another survey."""
    given = files | {"dsm": write_vrt(files["dsm"], tmp_path / "dsm"), "dtm": write_vrt(files["dtm"], tmp_path / "dtm")}
    db = tmp_path / "town.sqlite"
    msbdb.build(**given, db=db, **GIVEN)
    assert content(db, "source") == content(quick, "source")
    assert not msbdb.build(**given, db=db, **GIVEN).changed
    before = {source.name: source for source in Inputs.of(**given).sources()}
    pieces = sorted((tmp_path / "dsm").glob("*.tif"))
    assert before["dsm.vrt"].bytes == sum(file.stat().st_size for file in (*pieces, given["dsm"]))
    with rasterio.open(pieces[0], "r+") as image:
        image.write(image.read() + 1)
    after = {source.name: source for source in Inputs.of(**given).sources()}
    assert after["dsm.vrt"].sha256 != before["dsm.vrt"].sha256
    assert after["dtm.vrt"] == before["dtm.vrt"]
    for piece in pieces:
        piece.unlink()
    with pytest.raises(FileError, match=r"0-0\.tif cannot be read"):
        msbdb.build(**given, db=db, **GIVEN)


def test_an_inventory_is_updated_by_rasters_in_tiles(tmp_path):
    """A house was pulled down: the inventory is that of rasters in one piece, and a repetition changes nothing."""
    epochs = [
        write_rasters(tmp_path / name, without=without) | {"survey": name, "date": date}
        for name, date, without in (("older", "2015", ""), ("newer", "2020", "west"))
    ]
    for given in epochs:
        msbdb.update(**given, db=tmp_path / "one.sqlite")
        report = msbdb.update(**given, db=tmp_path / "tiles.sqlite", tile=TILE_M)
    assert report.inventory.counts["demolished"] == 1
    assert content(tmp_path / "tiles.sqlite") == content(tmp_path / "one.sqlite")
    assert msbdb.update(**given, db=tmp_path / "tiles.sqlite", tile=TILE_M).build is None
