"""Many point files: which ones a folder, a pattern and a virtual point cloud stand for, and those that do not fit."""

import json

import laspy
import numpy as np
import pytest
from pyproj import CRS
from simulated.files import write_points
from support.notices import with_notices

import msbdb
from msbdb.database import read_survey
from msbdb.errors import CRSError, FileError, GridMismatchError, NodataError
from msbdb.io.pointfiles import point_files, sound_files
from msbdb.points.cloud import PointCloud
from msbdb.run.inputs import Inputs

LAMBERT, UTM = 2154, 32631


def tile(path, column, crs=LAMBERT):
    """Write a small tile of points, one of a row of tiles."""
    x, y = (axis.ravel().astype(np.float64) for axis in np.meshgrid(np.arange(8), np.arange(8)))
    return write_points(path, PointCloud(800_000 + 8 * column + x, 6_300_000 + y, 0.1 * x, CRS.from_epsg(crs)))


@pytest.fixture
def folder(tmp_path):
    """Return a folder of three tiles, one of them deeper down, and a file of another kind."""
    (tmp_path / "south").mkdir()
    tile(tmp_path / "b.laz", 1)
    tile(tmp_path / "a.LAS", 0)
    tile(tmp_path / "south" / "c.laz", 2)
    (tmp_path / "notes.txt").write_text("of the flight")
    return tmp_path


def test_a_folder_stands_for_its_point_files(folder):
    """In the order of their names, of any case, and without those of folders beneath."""
    assert point_files([folder]) == (folder / "a.LAS", folder / "b.laz")
    assert Inputs.of(folder).points == (folder / "a.LAS", folder / "b.laz")


def test_many_tiles_are_named_after_their_folder(tmp_path):
    """So that a tile before the first one changes no name; a folder named like any gets the one around it."""
    for name in ("east", "tiles"):
        (tmp_path / "town" / name).mkdir(parents=True)
        for column in (1, 2):
            tile(tmp_path / "town" / name / f"t_{column}.laz", column)
    assert Inputs.of(tmp_path / "town" / "east").default_survey() == "east"
    assert Inputs.of(tmp_path / "town" / "tiles").default_survey() == "town-tiles"
    assert Inputs.of(tmp_path / "town" / "*" / "t_2.laz").default_survey() == "t_2"
    assert Inputs.of(tmp_path / "town" / "east" / "t_2.laz").default_survey() == "t_2"


def test_a_pattern_stands_for_what_it_matches(folder, monkeypatch):
    """Absolute or relative, with folders beneath by two stars; a file with such signs in its name is itself."""
    assert point_files([folder / "**" / "*.laz"]) == (folder / "b.laz", folder / "south" / "c.laz")
    monkeypatch.chdir(folder)
    assert [path.name for path in point_files(["*.laz"])] == ["b.laz"]
    odd = tile(folder / "[x].laz", 3)
    assert point_files([odd]) == (odd,)


def test_a_virtual_point_cloud_stands_for_what_it_lists(folder):
    """Relative names begin in its folder."""
    names = ["./b.laz", "south/c.laz", str(folder / "a.LAS")]
    features = [{"type": "Feature", "assets": {"data": {"href": name}}} for name in names]
    index = folder / "town.vpc"
    index.write_text(json.dumps({"type": "FeatureCollection", "features": features}))
    assert [path.resolve() for path in point_files([index])] == [(folder / name).resolve() for name in names]
    for damaged in ("[]", "{", '{"features": []}', '{"features": [{"assets": 1}]}'):
        index.write_text(damaged)
        with pytest.raises(FileError, match=r"virtual point cloud"):
            point_files([index])


def test_a_folder_or_pattern_without_points_is_refused(folder):
    """The message names another way."""
    (folder / "empty").mkdir()
    with pytest.raises(FileError, match=r"has no LAS, LAZ or COPC file"):
        point_files([folder / "empty"])
    with pytest.raises(FileError, match=r"No file matches"):
        point_files([folder / "*.copc"])


@pytest.fixture
def mixed(folder):
    """Return a folder in which a file is damaged, one empty, one in another CRS, and one there twice."""
    whole = (folder / "b.laz").read_bytes()
    (folder / "damaged.laz").write_bytes(whole[: len(whole) // 3])
    (folder / "twice.laz").write_bytes(whole)
    tile(folder / "utm.laz", 5, UTM)
    laspy.LasData(laspy.LasHeader(version="1.4", point_format=6)).write(folder / "empty.laz")
    return folder


def test_all_files_that_do_not_fit_are_named(mixed):
    """Before one is read, with their reasons and the option that leaves them out."""
    with pytest.raises((FileError, CRSError, NodataError)) as caught:
        Inputs.of(mixed)
    said = str(caught.value)
    assert said.startswith("3 of 6 files of points cannot be used")
    for name in ("damaged.laz", "empty.laz", "utm.laz", "--skip-bad"):
        assert name in said


def test_the_others_are_used_on_request(mixed):
    """With a notice that names what is left out: a second copy of points, too."""
    inputs, (notice,) = with_notices(Inputs.of, mixed, skip_bad=True)
    assert inputs.points == (mixed / "a.LAS", mixed / "b.laz")
    assert "4 of 6 files of points are left out" in notice
    assert "twice.laz" in notice


def test_a_file_of_another_place_is_named(folder):
    """One of three lies a hundred kilometres away; the lattice of all would not fit into memory."""
    tile(folder / "far.laz", 12_500)
    with pytest.raises(GridMismatchError, match=r"far.laz lies 10 km and more from a.LAS"):
        Inputs.of(folder)


def test_no_sound_file_is_an_error(mixed):
    """There is nothing to build from."""
    bad = [mixed / "damaged.laz", mixed / "empty.laz"]
    with pytest.raises(FileError, match=r"2 of 2 files of points cannot be used"):
        sound_files(bad, skip_bad=True)


def test_a_long_list_is_cut(folder):
    """Ten files are named, and the rest counted."""
    missing = [folder / f"{number}.laz" for number in range(14)]
    with pytest.raises(FileError, match=r"And 4 more") as caught:
        Inputs.of([folder / "a.LAS", *missing])
    assert str(caught.value).count(".laz") == 10


def test_a_build_takes_a_folder_and_leaves_bad_files_out(mixed, tmp_path):
    """The sources are the sound files; the notice is the run's; and the same build again changes nothing."""
    db = tmp_path / "town.sqlite"
    report = msbdb.build(mixed, db=db, survey="town", skip_bad=True)
    assert any("4 of 6 files of points are left out" in notice for notice in report.notices)
    with msbdb.open(db) as opened:
        names = {source.name for source in read_survey(opened.engine).sources}
    assert names == {"a.LAS", "b.laz"}
    assert not msbdb.build(mixed, db=db, survey="town", skip_bad=True).changed
