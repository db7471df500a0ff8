"""Layers out: arrays give the files that frames do, whole or not at all, and no library of frames is loaded."""

import errno
import sqlite3
import subprocess
import sys
from contextlib import closing
from dataclasses import replace

import geopandas as gpd
import numpy as np
import pandas as pd
import pyogrio
import pytest
import shapely
from pyproj import CRS
from shapely import MultiPolygon, box
from support.processes import environment

from msbdb.errors import FileError
from msbdb.io import layers
from msbdb.io.layers import Layer, texts, write_layers
from msbdb.io.vector import read_polygons

LAMBERT = CRS.from_epsg(2154)
HOUSE = MultiPolygon([box(10, 10, 20, 20)])


def columns_of_each_kind():
    """Return a column of each dtype that the tables have, with a null where it may hold one."""
    return {
        "whole": pd.Series([2**59 - 1, -1]),
        "no_whole": pd.Series([2**59 - 1, None], dtype="Int64"),
        "number": pd.Series([1.5, np.nan]),
        "no_number": pd.Series([1.5, None], dtype="Float64"),
        "true": pd.Series([True, False]),
        "no_true": pd.Series([True, None], dtype="boolean"),
        "text": pd.Series(["é", None], dtype="str"),
        "no_text": pd.Series(["é", None], dtype=object),
        "nothing": pd.Series([None, None], dtype=object),
    }


@pytest.mark.parametrize(("ending", "driver"), [("gpkg", "GPKG"), ("geojson", "GeoJSON"), ("shp", "ESRI Shapefile")])
@pytest.mark.parametrize("rows", [0, 2])
def test_a_layer_is_written_as_its_frame(tmp_path, ending, driver, rows):
    """Types, values, nulls and CRS are those that pyogrio writes from the frame itself."""
    frame = gpd.GeoDataFrame(columns_of_each_kind(), geometry=[HOUSE, HOUSE], crs=LAMBERT)[:rows]
    one, other = tmp_path / f"layer.{ending}", tmp_path / "frame" / f"layer.{ending}"
    other.parent.mkdir()
    write_layers(one, {"layer": Layer.of(frame)}, driver)
    pyogrio.write_dataframe(frame, other, layer="layer", driver=driver, geometry_type="MultiPolygon")
    assert len(Layer.of(frame)) == rows
    for value, expected in zip(pyogrio.read_info(one).items(), pyogrio.read_info(other).items(), strict=True):
        assert str(value) == str(expected)
    back, expected = gpd.read_file(one), gpd.read_file(other)
    pd.testing.assert_frame_equal(pd.DataFrame(back), pd.DataFrame(expected))
    assert back.crs == expected.crs


def test_numbers_become_texts_with_all_their_digits():
    """A masked number is null."""
    ids = np.ma.MaskedArray([2**59 - 1, 0], mask=[False, True])
    assert texts(ids).tolist() == ["576460752303423487", None]


def test_a_written_layer_replaces_the_old_file_whole(tmp_path):
    """Nothing else is left in the folder."""
    path = tmp_path / "parts.gpkg"
    path.write_text("old")
    write_layers(path, {"parts": Layer({"part_id": np.array([1])}, np.array([HOUSE]), "EPSG:2154")}, "GPKG")
    frame = read_polygons(path, layer="parts")
    assert list(frame["part_id"]) == [1]
    assert [file.name for file in tmp_path.iterdir()] == ["parts.gpkg"]


@pytest.mark.parametrize("size", [1, 2, 5])
def test_a_layer_in_pieces_is_the_layer_in_one(tmp_path, monkeypatch, size):
    """Schema, rows, their order and the index are equal, also where a first piece has nulls alone; WKB serves, too."""
    frame = gpd.GeoDataFrame(pd.concat([pd.DataFrame(columns_of_each_kind())[::-1]] * 4, ignore_index=True))
    frame = frame.set_geometry([HOUSE.buffer(n) for n in range(8)], crs=LAMBERT)
    layer = Layer.of(frame.assign(geometry=[MultiPolygon([shape]) for shape in frame.geometry[:-1]] + [HOUSE]))
    write_layers(tmp_path / "one.gpkg", {"a": layer, "b": layer}, "GPKG")
    monkeypatch.setattr(layers, "ROWS_AT_A_TIME", size)
    encoded = replace(layer, geometry=shapely.to_wkb(layer.geometry))
    write_layers(tmp_path / "more.gpkg", {"a": layer, "b": encoded}, "GPKG")
    one, more = (file_content(tmp_path / name) for name in ("one.gpkg", "more.gpkg"))
    assert one == more
    assert len(more["a"]) == len(more["b"]) == len(more["rtree_a_geom"]) == 8


def file_content(path):
    """Return the schema and all rows of a GeoPackage, without its times and the nodes of its indexes."""
    with closing(sqlite3.connect(path)) as file:
        tables = dict(file.execute("SELECT name, sql FROM sqlite_master WHERE name NOT GLOB 'rtree_*_*_[nrp]*'"))
        found = {"": tables}
        for name, sql in tables.items():
            if sql and sql.startswith(("CREATE TABLE", "CREATE VIRTUAL TABLE")):
                rows = file.execute(f'SELECT * FROM "{name}"').fetchall()
                found[name] = [[value for value in row if not str(value).endswith("Z")] for row in rows]
        return found


def test_a_failure_in_a_later_piece_leaves_the_old_file(tmp_path, monkeypatch):
    """Nothing of the new one is there."""
    path, done = tmp_path / "parts.gpkg", []
    path.write_text("old")
    layer = Layer({"n": np.arange(3)}, np.array([HOUSE] * 3), "EPSG:2154")

    def full(piece):
        done.append(len(piece))
        if len(done) == 3:
            raise OSError(errno.ENOSPC, "No space left on device")
        return piece

    monkeypatch.setattr(layers, "ROWS_AT_A_TIME", 1)
    with pytest.raises(FileError, match="No space left"):
        write_layers(path, {"parts": layer}, "GPKG", None, full)
    assert done == [1, 1, 1]
    assert path.read_text() == "old"
    assert [file.name for file in tmp_path.iterdir()] == ["parts.gpkg"]


def test_the_way_gdal_writes_is_restored(tmp_path, monkeypatch):
    """No layer waits for the disk, because the whole file does; afterwards GDAL's option is as before."""
    option, layer = "OGR_SQLITE_SYNCHRONOUS", Layer({}, np.array([HOUSE]), "EPSG:2154")
    seen = []

    def fail(*_args, **_options):
        seen.append(pyogrio.get_gdal_config_option(option))
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(pyogrio.raw, "write", fail)
    with pytest.raises(FileError, match="No space left"):
        write_layers(tmp_path / "houses.gpkg", {"houses": layer}, "GPKG")
    assert seen == [False]
    assert pyogrio.get_gdal_config_option(option) is None


BESIDE_OTHERS = """
import sys
from pathlib import Path
import numpy as np
import shapely
from msbdb.io.layers import DEFERRED, Layer, write_layers
house = shapely.multipolygons([shapely.box(10, 10, 20, 20)])
layer = Layer({"n": np.array([1])}, np.array([house]), "EPSG:2154")
write_layers(Path(sys.argv[1]), {"a": layer}, "GPKG")
assert not set(DEFERRED) & set(sys.modules)
import pyogrio
kept = [getattr(pyogrio._compat, name) for name in DEFERRED]  # as pyogrio holds them
frame = pyogrio.read_dataframe(sys.argv[1])
import geopandas, pandas, pyproj
assert type(frame) is geopandas.GeoDataFrame and frame["n"].tolist() == [1] and frame.crs == pyproj.CRS(2154)
assert [one.__version__ for one in kept] == [one.__version__ for one in (geopandas, pandas, pyproj)]
assert kept[1].DataFrame is pandas.DataFrame
pyogrio.write_dataframe(frame, sys.argv[1])
"""

INSIDE = """
import sys
from msbdb.io.layers import _Deferred
sys.modules["pandas"] = stand_in = _Deferred("pandas")
import pandas as named
from pandas import DataFrame
from pandas.api import types
import pandas
assert named is stand_in and pandas is sys.modules["pandas"] is not stand_in
assert named.DataFrame is DataFrame is pandas.DataFrame and types is pandas.api.types
"""


@pytest.mark.parametrize("code", [BESIDE_OTHERS, INSIDE])
def test_other_users_of_a_process_have_the_libraries_themselves(tmp_path, code):
    """What is left out while pyogrio is imported is loaded when somebody uses it, by whatever name."""
    command = [sys.executable, "-W", "error", "-c", code, tmp_path / "a.gpkg"]
    done = subprocess.run(command, env=environment(), capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
