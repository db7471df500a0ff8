"""Parcels of the user divide touching houses: in a build, after labels by hand, and in an update."""

import shutil

import geopandas as gpd
import numpy as np
import pytest
import shapely
from simulated.files import write_points
from simulated.scenes import SCENES

import msbdb
from msbdb.api import advance, relabel
from msbdb.database import read_parts, read_rasters, read_survey
from msbdb.errors import InputError
from msbdb.kept import lattice_of
from msbdb.outline.polygons import rasterise

SCENE = "under_trees"


@pytest.fixture(scope="module")
def town(tmp_path_factory):
    """Return the points of a scene, and parcels that cut its largest building in two."""
    folder = tmp_path_factory.mktemp("parcels")
    points = write_points(folder / "town.laz", SCENES[SCENE]().points)
    msbdb.build([points], db=folder / "plain.sqlite", survey="town", date="2020-01-01")
    with msbdb.open(folder / "plain.sqlite") as opened:
        largest = opened.buildings().sort_values("area_m2").iloc[-1]
        crs = opened.buildings().crs
    west, south, east, north = largest.geometry.bounds
    middle = (west + east) / 2
    halves = [shapely.box(west - 2, south - 2, middle, north + 2), shapely.box(middle, south - 2, east + 2, north + 2)]
    gpd.GeoDataFrame({"number": [1, 2]}, geometry=halves, crs=crs).to_crs(4326).to_file(folder / "parcels.geojson")
    return folder, points, largest


def test_a_building_on_two_parcels_is_two(town, tmp_path):
    """With outlines that share their border, parts that reach into one house each, and the file among the sources."""
    folder, points, largest = town
    db = tmp_path / "town.sqlite"
    msbdb.build([points], db=db, survey="town", date="2021-01-01", parcels=folder / "parcels.geojson")
    with msbdb.open(db) as opened:
        buildings, survey, rasters = opened.buildings(), read_survey(opened.engine), read_rasters(opened.engine)
        parts = read_parts(opened.engine)
    halves = buildings[buildings.representative_point().within(largest.geometry.buffer(1))]
    assert halves["divided_by"].tolist() == ["parcel", "parcel"]
    assert halves["area_m2"].sum() == pytest.approx(largest.area_m2, rel=0.05)
    assert shapely.relate_pattern(*halves.geometry, "F***1****")
    assert [source.name for source in survey.sources if source.role == "parcels"] == ["parcels.geojson"]
    assert set(np.unique(rasters.parcels)) == {0, 1, 2}
    ids = set(buildings["building_id"])
    assert len(ids) == len(buildings)
    footprint = np.asarray(buildings.set_index("building_id").geometry.loc[parts["building_id"]])
    inner = shapely.points(parts["xin"], parts["yin"])
    assert (shapely.distance(inner, footprint) < lattice_of(survey).cell_m).all()
    assert rasterise(halves.geometry, lattice_of(survey)).max() == 2


def test_labels_by_hand_divide_in_the_same_way(town, tmp_path):
    """The roofs' class goes and comes back: the same buildings, without the file."""
    folder, points, _ = town
    db = tmp_path / "town.sqlite"
    msbdb.build([points], db=db, survey="town", parcels=folder / "parcels.geojson")
    with msbdb.open(db) as opened:
        before, classes = opened.buildings(), opened.classes()
    roofs = classes.loc[classes["label"] == "building", "speindex"].tolist()
    for label in ("vegetation", "building"):
        relabel(db, dict.fromkeys(roofs, label))
    with msbdb.open(db) as opened:
        after = opened.buildings()
    assert after[["building_id", "divided_by", "area_m2"]].equals(before[["building_id", "divided_by", "area_m2"]])


def test_an_inventory_of_whole_blocks_is_unchanged_by_a_division(town, tmp_path):
    """Change is of ground, not of cutting: nothing is split, new or demolished."""
    folder, points, _ = town
    db = tmp_path / "town.sqlite"
    msbdb.update([points], db=db, survey="before", date="2020-01-01")
    msbdb.update([points], db=db, survey="after", date="2021-01-01", parcels=folder / "parcels.geojson")
    assert set(advance(db, "after").counts) == {"unchanged", "versions"}


def test_parcels_elsewhere_are_refused(town, tmp_path):
    """The message says what to check."""
    _, points, largest = town
    west, south, east, north = largest.geometry.bounds
    away = gpd.GeoSeries([shapely.box(west + 9000, south, east + 9000, north)], crs=32631)
    away.to_file(tmp_path / "away.gpkg")
    with pytest.raises(InputError, match=r"not of the same place.*away\.gpkg"):
        msbdb.build([points], db=tmp_path / "town.sqlite", parcels=tmp_path / "away.gpkg")


def test_parcels_that_a_survey_did_not_have_are_named_as_a_change_of_its_houses(town, tmp_path):
    """The build is refused before the work, and the message names what changes and the option."""
    folder, points, _ = town
    db = tmp_path / "town.sqlite"
    shutil.copy(folder / "plain.sqlite", db)
    before = db.read_bytes()
    with pytest.raises(InputError, match=r"adds parcels.geojson. Parcels divide touching houses.*--replace"):
        msbdb.build([points], db=db, survey="town", date="2020-01-01", parcels=folder / "parcels.geojson")
    assert db.read_bytes() == before
