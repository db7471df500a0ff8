"""The benchmark of the extractors on points, on a small simulated scene."""

import json

import pytest
from simulated import scenes
from simulated.files import write_points
from support.processes import BENCHMARKS, run_script

SCRIPT = BENCHMARKS / "detectors"


@pytest.mark.campaign
def test_every_method_is_timed_at_the_size_asked_for(tmp_path):
    """Copies make up the size, and rates follow from the seconds."""
    cloud = scenes.row_houses(density=2.0).points
    path = write_points(tmp_path / "houses.laz", cloud)
    points = 2 * len(cloud) + 7
    done = run_script(SCRIPT, path, "--points", points, "--json")
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert [row["name"] for row in found] == ["area3d", "area3d, as written", "adaptive"]
    for row in found:
        assert row["points"] == points
        assert row["points_per_second"] == pytest.approx(points / row["seconds"])
        assert row["seconds"] == pytest.approx(row["ground_s"] + row["extract_s"])
        assert row["times_the_paper"] is None
    assert found[0]["regions"] > 0
    assert found[2]["regions"] > 0


def test_wrong_arguments_are_explained():
    """Before any work is done."""
    done = run_script(SCRIPT, "--method", "multiscale")
    assert done.returncode == 2
    assert "invalid choice: 'multiscale'" in done.stderr
