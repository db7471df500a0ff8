"""The benchmark of the main job, on a small simulated scene."""

import json
import shutil

import laspy
import numpy as np
import pytest
from simulated import scenes
from support.processes import BENCHMARKS, load_script, run_script

SCRIPT = BENCHMARKS / "build"
STAGES = [
    "read",
    "surface",
    "cover",
    "bands",
    "classes",
    "adaptive",
    "area3d",
    "flatregions",
    "multiscale",
    "fusion",
    "houses",
    "parts",
    "outlines",
    "write",
]


def run(*arguments):
    """Run the script."""
    return run_script(SCRIPT, *arguments)


@pytest.fixture(scope="module")
def tile(tmp_path_factory):
    """Return a LAZ file of a row of houses, and its number of points."""
    points = scenes.row_houses(density=2.0).points
    header = laspy.LasHeader(point_format=6, version="1.4")
    header.scales, header.offsets = [0.01] * 3, [float(points.x.min()), float(points.y.min()), 0.0]
    header.add_crs(points.crs)
    las = laspy.LasData(header)
    las.x, las.y, las.z = points.x, points.y, points.z
    las.return_number, las.number_of_returns = points.return_number, points.number_of_returns
    path = tmp_path_factory.mktemp("bench") / "houses.laz"
    las.write(path)
    return path, len(points)


@pytest.mark.long
def test_all_figures_come_from_one_run(tile):
    """A repeated file has as many points as asked, in whole copies; rates and shares follow from the seconds."""
    path, count = tile
    done = run(path, "--repeat", 3 * count - 5, "--no-cold", "--json")
    assert done.returncode == 0, done.stderr
    figures = json.loads(done.stdout)
    assert figures["points"] == 3 * count
    # Detectors run side by side, so that any of them may begin first.
    assert sorted(figures["stages"]) == sorted(STAGES)
    assert sorted(figures["stages_cpu"]) == sorted(STAGES)
    assert sum(figures["stages"].values()) <= figures["seconds"] <= figures["process_seconds"]
    assert figures["points_per_second"] == pytest.approx(3 * count / figures["seconds"])
    assert figures["ratio_to_reading"] == pytest.approx(figures["seconds"] / figures["read_seconds"])
    assert figures["peak_mb"] > figures["start_mb"] > 10
    assert figures["peak_mb_per_million"] == pytest.approx(figures["peak_mb"] / (3 * count / 1e6))
    assert figures["buildings"] > 0
    assert figures["cold_seconds"] is None


def test_copies_lie_side_by_side(tile, tmp_path):
    """None upon another, each with the same heights."""
    path, count = tile
    job = {"files": [str(path)], "points": 4 * count, "out": str(tmp_path / "many.laz")}
    done = run("--child", "repeat", json.dumps(job))
    assert done.returncode == 0, done.stderr
    one, many = laspy.read(path), laspy.read(tmp_path / "many.laz")
    assert len(many.points) == 4 * count
    np.testing.assert_array_equal(many.Z, np.tile(one.Z, 4))
    width, height = np.ptp(one.x), np.ptp(one.y)
    for copy in range(4):
        part = slice(copy * count, (copy + 1) * count)
        east = np.unique(np.round(many.x[part] - one.x, 2))
        north = np.unique(np.round(many.y[part] - one.y, 2))
        assert len(east) == len(north) == 1
        assert east[0] >= (copy % 2) * width
        assert north[0] >= (copy // 2) * height
        assert east[0] % 10 == north[0] % 10 == 0


@pytest.fixture
def pdal(tmp_path, monkeypatch):
    """Return the path of a program named ``pdal`` that keeps the pipeline it is given, and fails on demand."""
    program = tmp_path / "pdal"
    program.write_text(
        f'#!/bin/sh\n[ "$1" = pipeline ] && cp "$2" {tmp_path}/given.json && [ ! -e {tmp_path}/broken ]\n'
    )
    program.chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path), prepend=":")
    return program


def test_peers_work_on_the_same_files(pdal, tile, tmp_path):
    """An installed program gets all files and is timed, and one that fails is said to have failed."""
    bench, files = load_script(SCRIPT), [str(tile[0]), "other.laz"]
    found = bench.measure_peers(files, None, tmp_path)["pdal"]
    assert found["seconds"] > 0
    assert set(found) == {"seconds", "cpu_seconds", "peak_mb"}
    *given, written = json.loads((tmp_path / "given.json").read_text())
    assert given == [*files, {"type": "filters.merge"}, *bench.planar(1.0)]
    assert written["type"] == "writers.las"
    (tmp_path / "broken").touch()
    assert bench.measure_peers(files, None, tmp_path)["pdal"] == {}
    pdal.unlink()
    if shutil.which("pdal") is None:
        assert bench.measure_peers(files, None, tmp_path)["pdal"] is None


def test_peers_measure_in_the_units_of_the_file(tile):
    """A window of 30 m has 98.4 feet, and a roof is 8.2 feet above ground."""
    bench = load_script(SCRIPT)
    assert bench.unit_m(str(tile[0]), None) == 1.0
    foot = bench.unit_m(str(tile[0]), "EPSG:2994")
    steps = {each["type"]: each for each in bench.planar(foot)}
    assert steps["filters.smrf"]["window"] == pytest.approx(98.425, abs=0.001)
    assert "HeightAboveGround > 8.202 " in steps["filters.assign"]["value"]


def test_the_table_names_every_peer():
    """With its cost, or why there is none."""
    figures = {
        **dict.fromkeys(("points", "seconds", "cpu_seconds", "points_per_second", "points_per_cpu_second"), 1.0),
        **dict.fromkeys(("read_seconds", "read_cpu_seconds", "ratio_to_reading", "cpu_ratio_to_reading"), 2.0),
        **dict.fromkeys(("peak_mb", "start_mb", "peak_mb_per_million", "buildings", "parts", "file_mb", "cores"), 3),
        "files": ["a.laz"], "load_before": 0.0, "extract": "multiscale", "cold_seconds": None, "stages": {},
        "peers": {"one": {"seconds": 5.0, "cpu_seconds": 6.0, "peak_mb": 7.0}, "two": {}, "three": None},
    }  # fmt: skip
    lines = load_script(SCRIPT).table(figures).splitlines()
    assert any(line.startswith("one") and line.endswith("5.0   CPU 6.0, 7 MB, 2.5 times reading") for line in lines)
    assert any(line.split() == ["two", "failed"] for line in lines)
    assert any(line.split() == ["three", "not", "installed"] for line in lines)


def test_wrong_arguments_are_explained(tile, tmp_path):
    """Before any work is done."""
    assert "there is no file" in run(tmp_path / "none.laz").stderr
    assert "--repeat takes one file" in run(tile[0], tile[0], "--repeat", 10).stderr
    assert run("--help").returncode == 0
