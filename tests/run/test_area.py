"""An area of interest: what lies in it is built as without it, and nothing beyond is read or written."""

import json
from dataclasses import replace

import geopandas as gpd
import laspy
import numpy as np
import pytest
import shapely
from simulated import scenes
from simulated.files import write_heights, write_points
from support.copcfile import write_copc
from support.rangeserver import serving

import msbdb
from msbdb.database import open_database, read_rasters
from msbdb.errors import GridMismatchError, MsbdbError
from msbdb.grid import Grid
from msbdb.io.las import read_points
from msbdb.io.vector import Area
from msbdb.params import Params, with_values
from msbdb.run.inputs import Inputs
from msbdb.run.preparation.drafts import make_draft
from msbdb.run.reports import Stages

CELL = with_values(Params(), {"surface": {"cell_m": 0.8}})
STREET_M = 100.0
"""Width of the street between the tower and the trees: wider than the margin."""


@pytest.fixture(scope="module")
def scene():
    """Return a podium with a tower."""
    return scenes.podium_tower(density=2.0)


@pytest.fixture(scope="module")
def files(scene, tmp_path_factory):
    """Return the file of the tower, and that of a house among trees beyond a street."""
    folder = tmp_path_factory.mktemp("tiles")
    trees = scenes.under_trees(density=2.0).points
    east = replace(trees, x=trees.x - trees.bounds[0] + np.ceil(scene.points.bounds[2]) + STREET_M)
    return write_points(folder / "tower.laz", scene.points), write_points(folder / "trees.laz", east)


def district(path, shape, crs, to="EPSG:4326"):
    """Write a polygon in another CRS."""
    gpd.GeoDataFrame(geometry=[shape], crs=crs).to_crs(to).to_file(path)
    return path


def test_a_build_reads_its_area_alone_from_a_server(scene, files, tmp_path):
    """Of a virtual point cloud of COPC files: the content is that of the files, and the record has no address."""
    links = []
    for file in files:
        write_copc(tmp_path / f"{file.stem}.copc.laz", laspy.read(file))
        data, picture = {"href": f"{file.stem}.copc.laz", "roles": ["data"]}, {"href": "a.png", "roles": ["thumbnail"]}
        links.append({"type": "Feature", "assets": {"data": data, "picture": picture}})
    west, south, east, north = scene.points.bounds
    area = district(tmp_path / "district.gpkg", shapely.box(west - 5, south - 5, east + 5, north + 5), scene.points.crs)
    given = {"survey": "town", "params": CELL, "extract": "multiscale", "aoi": area}
    cloud = tmp_path / "town.vpc"
    cloud.write_text(json.dumps({"type": "FeatureCollection", "features": links}))
    msbdb.build(cloud, db=tmp_path / "files.sqlite", **given)
    with serving(tmp_path) as sent:
        for link in links:
            link["assets"]["data"]["href"] = f"{sent.url}/{link['assets']['data']['href']}?key=secret"
        cloud.write_text(json.dumps({"type": "FeatureCollection", "features": links}))
        msbdb.build(cloud, db=tmp_path / "server.sqlite", **given)
        assert not msbdb.build(cloud, db=tmp_path / "server.sqlite", **given).changed
    with msbdb.open(tmp_path / "files.sqlite") as one, msbdb.open(tmp_path / "server.sqlite") as other:
        assert (
            other.buildings()
            .drop(columns="run_id", errors="ignore")
            .equals(one.buildings().drop(columns="run_id", errors="ignore"))
        )
    said = json.dumps(msbdb.info(tmp_path / "server.sqlite"), default=str)
    assert "tower.copc.laz" in said
    assert "secret" not in said


def test_only_what_lies_in_the_area_is_built(scene, files, tmp_path):
    """Buildings are those of a build of the whole that lie inside; cells beyond have no value."""
    crs = scene.points.crs
    west, south, east, north = scene.points.bounds
    shape = shapely.box(west - 5, south - 5, east + 10, north + 5)
    area = district(tmp_path / "district.geojson", shape, crs)
    msbdb.build(files, db=tmp_path / "all.sqlite", survey="town", params=CELL, extract="multiscale")
    msbdb.build(files, db=tmp_path / "some.sqlite", survey="town", params=CELL, extract="multiscale", aoi=area)
    with msbdb.open(tmp_path / "all.sqlite") as town, msbdb.open(tmp_path / "some.sqlite") as part:
        every, some = town.buildings(), part.buildings()
    inside = every[every.within(shape)]
    assert 0 < len(inside) < len(every)
    assert some["building_id"].tolist() == inside["building_id"].tolist()
    assert some["area_m2"].to_numpy() == pytest.approx(inside["area_m2"].to_numpy(), rel=0.01)
    record = msbdb.info(tmp_path / "some.sqlite")["runs"][0]["survey_record"]
    assert ("district.geojson", "aoi") in {(source["name"], source["role"]) for source in record["sources"]}
    assert record["bounds"][2] < east + 61, "the trees were read"
    engine = open_database(tmp_path / "some.sqlite")
    rasters = read_rasters(engine)
    engine.dispose()
    columns = np.flatnonzero(rasters.valid.any(axis=0))
    assert (columns[-1] + 1) * 0.8 + record["bounds"][0] <= shape.bounds[2] + 0.8


def test_all_detectors_see_only_the_area(scene, files, tmp_path):
    """Points beyond the area are read for the terrain, and give no region, no building and no rejection."""
    west, south, east, north = scene.points.bounds
    half = (west + east) / 2
    area = district(tmp_path / "half.geojson", shapely.box(west, south, half, north), scene.points.crs)
    msbdb.build(files[:1], db=tmp_path / "half.sqlite", survey="town", params=CELL, aoi=area)
    with msbdb.open(tmp_path / "half.sqlite") as part:
        found = [part.buildings(), part.candidates(), part.flat_regions()]
    assert all(len(frame) for frame in found)
    for frame in found:
        assert frame.total_bounds[2] <= half + 4, "an outline may grow by a few cells"
    assert set(found[1]["method"]) == {"adaptive", "area3d"}


def test_the_edge_of_an_area_cuts_a_building(scene, tmp_path):
    """Cells are inside by their centres, so that two areas share no cell and leave none out."""
    crs, spec = scene.points.crs, scene.spec
    file = write_heights(tmp_path / "ndsm.tif", Grid(scene.heights, np.ones(spec.shape, bool), spec))
    west, south, east, north = spec.bounds
    column = round(np.flatnonzero((scene.heights > 3).any(axis=0)).mean())
    found = []
    for left, right in ((west, west + (column + 0.4) * spec.cell_m), (west + (column + 0.4) * spec.cell_m, east)):
        shape = district(tmp_path / f"{len(found)}.gpkg", shapely.box(left, south, right, north), crs, crs)
        inputs = Inputs.of(ndsm=file, aoi=shape)
        found.append(make_draft(inputs, None, Params(), Stages(None)).surface.ndsm)
    first, other = (each.valid for each in found)
    assert np.array_equal(first, np.arange(spec.shape[1]) < column + np.zeros((spec.shape[0], 1)))
    assert np.array_equal(other, ~first)
    assert all((np.asarray(each.values) > 3).any() for each in found)


def test_an_area_elsewhere_is_refused(scene, files, tmp_path):
    """Before the points are read where the bounds show it, else by the cells."""
    crs = scene.points.crs
    west, south, _, _ = scene.points.bounds
    far = district(tmp_path / "far.geojson", shapely.box(west - 900, south, west - 800, south + 50), crs)
    with pytest.raises(GridMismatchError, match=r"far\.geojson"):
        msbdb.build(files, db=tmp_path / "town.sqlite", aoi=far)
    beside = shapely.union_all([shapely.box(west - 30, south, west - 10, south + 50), shapely.box(0, 0, 1, 1)])
    near = district(tmp_path / "near.gpkg", beside, crs, crs)
    with pytest.raises(MsbdbError, match=r"near\.gpkg"):
        msbdb.build(files, db=tmp_path / "town.sqlite", aoi=near)
    assert not (tmp_path / "town.sqlite").exists()


def test_points_of_a_turned_area_are_those_that_it_holds(scene, files):
    """The mask is that of shapely, on any number of chunks and files."""
    cloud = scene.points
    west, south, east, north = cloud.bounds
    shape = shapely.Point((west + east) / 2, (south + north) / 2).buffer(17.0)
    found = read_points(files, area=Area(gpd.GeoSeries([shape], crs=cloud.crs), 3.0, "a disc"))
    expected = shapely.intersects_xy(shape.buffer(3.0), cloud.x.round(3), cloud.y.round(3))
    assert len(found) == pytest.approx(expected.sum(), abs=3)
    assert 0 < len(found) < len(cloud)
    assert shapely.distance(shapely.points(found.x, found.y), shape).max() <= 3.0 + 1e-9
