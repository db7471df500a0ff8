"""Classified points from end to end: what changes, what stays, and how well it fits the truth."""

import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import laspy
import numpy as np
import pytest
from click.testing import CliRunner
from simulated.files import write_heights, write_points
from simulated.scenes import SCENES
from support.processes import environment

from msbdb.cli.main import cli
from msbdb.grid import Grid

GROUND, UNCLASSIFIED, BUILDING, NOISE = 2, 1, 6, 7


def run(*args):
    """Run the program."""
    return CliRunner().invoke(cli, [str(arg) for arg in args])


def classified(*args):
    """Classify; return what --json tells."""
    result = run("classify", *args, "--json")
    assert result.exit_code == 0, result.stderr
    return json.loads(result.stdout)


def scored(*args):
    """Evaluate; return what --json tells."""
    result = run("evaluate", *args, "--json")
    assert result.exit_code == 0, result.stderr
    return json.loads(result.stdout)


def classes_of(path):
    """Return the classes of a file's points."""
    return np.asarray(laspy.read(path).classification)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Return a folder with a scene as truth.laz, without its classes as plain.laz, and classified as found.laz."""
    made = tmp_path_factory.mktemp("town")
    cloud = SCENES["under_trees"](classified=True).points
    write_points(made / "truth.laz", cloud)
    write_points(made / "plain.laz", replace(cloud, classification=None))
    classified(made / "plain.laz", made / "found.laz", "--extract", "multiscale")
    return made


def test_roofs_get_class_6_and_nothing_else_changes(folder, tmp_path):
    """The house is found among the trees; every other field of every point is the source's."""
    report = classified(folder / "plain.laz", tmp_path / "out.laz", "--extract", "multiscale")
    old, new, truth = (laspy.read(path) for path in (folder / "plain.laz", tmp_path / "out.laz", folder / "truth.laz"))
    is_building = np.asarray(new.classification) == BUILDING
    assert set(np.unique(new.classification)) == {UNCLASSIFIED, BUILDING}
    for name in old.point_format.dimension_names:
        if name != "classification":
            np.testing.assert_array_equal(old[name], new[name], err_msg=name)
    both = np.count_nonzero(is_building & (np.asarray(truth.classification) == BUILDING))
    assert both > 0.85 * np.count_nonzero(np.asarray(truth.classification) == BUILDING)
    assert both > 0.85 * np.count_nonzero(is_building)
    assert (report["points"], report["read"], report["regions"]) == (len(old), len(old), {"multiscale": 1})
    assert report["building_points"] == report["changed"] == np.count_nonzero(is_building)
    assert report["demoted"] == 0


def test_the_same_points_give_the_same_file(folder, tmp_path):
    """To the byte, run by run; and each point its class, whatever their order."""
    classified(folder / "plain.laz", tmp_path / "again.laz", "--extract", "multiscale")
    assert (tmp_path / "again.laz").read_bytes() == (folder / "found.laz").read_bytes()
    las = laspy.read(folder / "plain.laz")
    order = np.random.default_rng(1).permutation(len(las))
    las.points = las.points[order]
    las.write(tmp_path / "mixed.laz")
    classified(tmp_path / "mixed.laz", tmp_path / "out.laz", "--extract", "multiscale")
    np.testing.assert_array_equal(classes_of(tmp_path / "out.laz"), classes_of(folder / "found.laz")[order])


def test_several_extractors_take_what_any_of_them_takes(folder, tmp_path):
    """The union, with the regions of each."""
    classified(folder / "plain.laz", tmp_path / "flat.laz", "--extract", "flatregions")
    report = classified(folder / "plain.laz", tmp_path / "both.laz", "--extract", "flatregions,multiscale")
    parts, flat, both = (
        classes_of(path) == BUILDING for path in (folder / "found.laz", tmp_path / "flat.laz", tmp_path / "both.laz")
    )
    np.testing.assert_array_equal(both, parts | flat)
    assert (parts ^ flat).any()
    assert report["regions"] == {"flatregions": 1, "multiscale": 1}


def test_by_default_all_detectors_decide_together_as_in_a_build(folder, tmp_path):
    """The points of class 6 are those in the build's buildings, and fewer than what any detector takes."""
    report = classified(folder / "plain.laz", tmp_path / "all.laz")
    assert set(report["regions"]) == {"adaptive", "area3d", "flatregions", "multiscale"}
    assert run("build", "--points", folder / "plain.laz", "--db", tmp_path / "town.sqlite").exit_code == 0
    agreed = scored(tmp_path / "town.sqlite", "--reference", tmp_path / "all.laz", "--by", "point")
    assert agreed["points"]["rates"]["quality"] > 0.95
    taken = classes_of(tmp_path / "all.laz") == BUILDING
    classified(folder / "plain.laz", tmp_path / "one.laz", "--extract", "flatregions")
    assert (classes_of(tmp_path / "one.laz")[~taken] == BUILDING).any()


def test_a_user_takes_the_ground_away_as_class_2(folder, tmp_path):
    """Most points of the ground and few others; class 2 that is no ground becomes 1, with --keep it stays."""
    las, truth = laspy.read(folder / "truth.laz"), classes_of(folder / "truth.laz")
    wrong = (truth != GROUND) & (truth != BUILDING)
    las.classification = np.where(wrong & (np.arange(len(las)) % 50 == 0), GROUND, UNCLASSIFIED)
    las.write(tmp_path / "in.laz")
    options = ("--extract", "multiscale", "--ground", "--set", "ground.ground_filter=walls")
    report = classified(tmp_path / "in.laz", tmp_path / "out.laz", *options)
    is_ground = classes_of(tmp_path / "out.laz") == GROUND
    assert report["ground_points"] == np.count_nonzero(is_ground)
    both = np.count_nonzero(is_ground & (truth == GROUND))
    assert both > 0.97 * np.count_nonzero(truth == GROUND)
    assert both > 0.97 * np.count_nonzero(is_ground)
    assert set(np.unique(classes_of(tmp_path / "out.laz"))) == {UNCLASSIFIED, GROUND, BUILDING}
    classified(tmp_path / "in.laz", tmp_path / "kept.laz", *options, "--keep")
    kept = classes_of(tmp_path / "kept.laz")
    assert (kept[(classes_of(tmp_path / "in.laz") == GROUND) & (kept != BUILDING)] == GROUND).all()


def test_former_buildings_are_demoted_or_kept(folder, tmp_path):
    """Class 6 of crowns becomes 1, with --keep it stays; ground stays ground; noise and withheld points stay."""
    las, found = laspy.read(folder / "truth.laz"), classes_of(folder / "found.laz") == BUILDING
    number, truth = np.arange(len(las)), np.asarray(las.classification)
    las.classification = np.where(truth == GROUND, GROUND, np.where(truth == BUILDING, UNCLASSIFIED, BUILDING))
    las.classification[number % 100 == 1] = NOISE
    withheld = number % 100 == 2
    las.withheld = withheld
    las.write(tmp_path / "in.laz")
    report = classified(tmp_path / "in.laz", tmp_path / "out.laz", "--extract", "multiscale")
    kept = classified(tmp_path / "in.laz", tmp_path / "kept.laz", "--extract", "multiscale", "--keep")
    before, after, with_keep = (classes_of(tmp_path / name) for name in ("in.laz", "out.laz", "kept.laz"))
    passed = (before == NOISE) | withheld
    np.testing.assert_array_equal(after[passed], before[passed])
    taken = (after == BUILDING) & ~passed
    assert np.count_nonzero(taken & found) > 0.95 * np.count_nonzero(found & ~passed)
    rest = ~taken & ~passed
    np.testing.assert_array_equal(after[rest], np.where(before[rest] == BUILDING, UNCLASSIFIED, before[rest]))
    np.testing.assert_array_equal(with_keep, np.where(taken, BUILDING, before))
    assert report["read"] == np.count_nonzero(~passed)
    assert report["demoted"] == np.count_nonzero((before == BUILDING) & rest) > 500
    assert report["changed"] == np.count_nonzero(before != after)
    assert (kept["demoted"], kept["changed"]) == (0, np.count_nonzero(before != with_keep))


def test_a_user_classifies_with_a_terrain_of_his_own(folder, tmp_path):
    """Above the true ground the same roofs are found; above a ground higher than the roofs none is."""
    scene = SCENES["under_trees"]()
    truth = scene.ground(*np.broadcast_arrays(*scene.spec.centres())).astype(np.float32)
    for name, ground in (("true", truth), ("high", truth + 50)):
        terrain = write_heights(tmp_path / f"{name}.tif", Grid(ground, np.ones(ground.shape, bool), scene.spec))
        args = (folder / "plain.laz", tmp_path / f"{name}.laz", "--dtm", terrain, "--extract", "multiscale")
        report = classified(*args)
        if name == "high":
            assert report["building_points"] == 0
            assert any("below the given DTM" in notice for notice in report["notices"])
        else:
            alike = classes_of(tmp_path / "true.laz") == classes_of(folder / "found.laz")
            assert alike.mean() > 0.99
            assert report["building_points"] > 100


def test_refusals_come_before_the_work(folder, tmp_path):
    """Nothing is read when the output cannot be written, or an extractor does not exist."""
    there = tmp_path / "there.laz"
    there.write_text("mine")
    cases = {
        ("plain.laz", there): "exists already",
        ("plain.laz", folder / "plain.laz", "--overwrite"): "is the source itself",
        ("plain.laz", tmp_path / "out.copc.laz"): "not as COPC",
        ("plain.laz", tmp_path / "out.gpkg"): "written as .las or .laz",
        ("plain.laz", tmp_path / "no" / "out.laz"): "does not exist",
        ("plain.laz", tmp_path / "out.laz", "--extract", "magic"): "got magic",
    }
    for (source, *rest), says in cases.items():
        result = run("classify", folder / source, *rest[:1], "--extract", "multiscale", *rest[1:])
        assert result.exit_code == 1
        assert says in result.stderr
        assert "Traceback" not in result.stderr
    assert there.read_text() == "mine"
    assert list(tmp_path.iterdir()) == [there]
    assert run("classify", folder / "plain.laz", there, "--extract", "multiscale", "--overwrite").exit_code == 0
    np.testing.assert_array_equal(classes_of(there), classes_of(folder / "found.laz"))


def test_scores_by_point_are_those_of_the_classes(folder):
    """Counted by hand; with the sides swapped, so are the errors."""
    found, truth = (classes_of(folder / name) == BUILDING for name in ("found.laz", "truth.laz"))
    points = scored(folder / "found.laz", "--reference", folder / "truth.laz")["points"]
    assert (points["tp"], points["fp"]) == (np.count_nonzero(found & truth), np.count_nonzero(found & ~truth))
    assert (points["fn"], points["tn"]) == (np.count_nonzero(~found & truth), np.count_nonzero(~found & ~truth))
    swapped = scored(folder / "truth.laz", "--reference", folder / "found.laz")["points"]
    assert (swapped["fp"], swapped["fn"]) == (points["fn"], points["fp"])
    assert points["rates"]["quality"] > 0.75
    text = run("evaluate", folder / "found.laz", "--reference", folder / "truth.laz").stdout
    assert f"tp {points['tp']}" in " ".join(text.split())


def test_a_reference_in_another_order_and_with_noise(folder, tmp_path):
    """Points find each other by their coordinates; what the reference calls noise is not scored."""
    las = laspy.read(folder / "truth.laz")
    order = np.random.default_rng(3).permutation(len(las))
    las.points = las.points[order]
    las.write(tmp_path / "mixed.laz")
    result = scored(folder / "found.laz", "--reference", tmp_path / "mixed.laz")
    assert result["matched"] == "coordinates"
    assert result["points"] == scored(folder / "found.laz", "--reference", folder / "truth.laz")["points"]
    truth = np.asarray(las.classification) == BUILDING
    las.classification[truth] = NOISE
    las.write(tmp_path / "noise.laz")
    points = scored(folder / "found.laz", "--reference", tmp_path / "noise.laz")["points"]
    assert (points["tp"], points["fn"]) == (0, 0)
    assert points["fp"] == result["points"]["fp"]
    assert points["tn"] == result["points"]["tn"]


def test_other_points_and_other_files_are_refused(folder, tmp_path):
    """The numbers of points without a partner; a reference that holds no points."""
    las = laspy.read(folder / "truth.laz")
    las.z = np.asarray(las.z) + np.where(np.arange(len(las)) < 5, 0.5, 0.0)
    las.write(tmp_path / "moved.laz")
    result = run("evaluate", folder / "found.laz", "--reference", tmp_path / "moved.laz")
    assert result.exit_code == 1
    assert f"5 of {len(las)} points of the reference have no point within 1 cm" in result.stderr
    (tmp_path / "truth.gpkg").touch()
    result = run("evaluate", folder / "found.laz", "--reference", tmp_path / "truth.gpkg")
    assert result.exit_code == 1
    assert "By point, the reference must be a LAS or LAZ file" in result.stderr


def test_a_database_is_scored_by_point_as_its_points_would_be(folder, tmp_path):
    """By the outlines and heights that it keeps, nearly the same points are taken as were classified."""
    db = tmp_path / "town.sqlite"
    result = run("build", "--points", folder / "plain.laz", "--db", db, "--extract", "multiscale")
    assert result.exit_code == 0, result.stderr
    agreed = scored(db, "--reference", folder / "found.laz", "--by", "point", "--of", "parts")
    assert agreed["matched"] == "footprints"
    assert agreed["points"]["rates"]["quality"] > 0.95
    points = scored(db, "--reference", folder / "truth.laz", "--by", "point")["points"]
    assert points["rates"]["quality"] > 0.75
    las = laspy.read(folder / "truth.laz")
    assert sum(points[name] for name in ("tp", "fp", "fn", "tn")) == len(las)
    las.header.vlrs.clear()
    las.write(tmp_path / "elsewhere.laz")
    how = ("--reference", tmp_path / "elsewhere.laz", "--by", "point", "--crs", "EPSG:32632")
    result = run("evaluate", db, *how)
    assert result.exit_code == 1
    assert "reproject one" in result.stderr


STOPPED = """
import signal, sys
from disturbance import forks
from msbdb.cli.main import cli
from msbdb.io import laswrite
laswrite.CHUNK_BYTES = 20_000
forks.stop_in("msbdb.io.laswrite:_set_classes", 3, signal.SIGINT)
cli(["classify", sys.argv[1], sys.argv[2], "--extract", "flatregions", "--overwrite"])
"""


@pytest.mark.long
def test_ctrl_c_while_writing_leaves_what_was_there(folder, tmp_path):
    """The former file, one line, and no stray."""
    out = tmp_path / "out.laz"
    out.write_text("the former file")
    command = [sys.executable, "-c", STOPPED, folder / "plain.laz", out]
    done = subprocess.run(command, env=environment(), capture_output=True, text=True, check=False)
    assert done.returncode == 130, done.stderr
    assert done.stderr.strip().splitlines()[-1].startswith("Interrupted.")
    assert out.read_text() == "the former file"
    assert list(tmp_path.iterdir()) == [out]


def _hostile_files():
    """Return the real hostile files, where they are at hand."""
    return sorted(Path(os.environ.get("MSBDB_DATA", "none"), "hostile").glob("*.la[sz]"))


@pytest.mark.data
@pytest.mark.parametrize("path", _hostile_files(), ids=lambda path: path.name)
def test_real_hostile_files_end_well(tmp_path, path):
    """A whole file, or one line that says why not, and no file."""
    out = tmp_path / "out.las"
    result = run("classify", path, out, "--extract", "flatregions")
    assert result.exit_code in (0, 1)
    assert "bug in msbdb" not in result.stderr
    assert list(tmp_path.iterdir()) == [out] * (result.exit_code == 0)
