"""The benchmark of a suburb that its own build with all points and colours judges."""

from types import SimpleNamespace

import laspy
import numpy as np
import pytest
from pyproj import CRS
from support.masks import block
from support.processes import BENCHMARKS, load_script

from msbdb.grid import lattice

SHAPE = (200, 200)
SPEC = lattice((0, 0.1, 199.9, 200), 1.0, CRS.from_epsg(2154))
HOUSE, OTHER, FACTORY = (
    block(SHAPE, (10, 20), (10, 20)),
    block(SHAPE, (40, 50), (40, 50)),
    block(SHAPE, (90, 170), (90, 170)),
)


@pytest.fixture
def suburb(monkeypatch):
    """Return scripts/benchmarks/suburb, whose builds find what the name of the case says."""
    script = load_script(BENCHMARKS / "suburb")
    found = {"all": HOUSE | OTHER | FACTORY, "1": HOUSE | block(SHAPE, (60, 65), (10, 30)), "2": HOUSE | OTHER}

    def build(case, ground):
        assert ground == "walls"
        scene = SimpleNamespace(heights=SimpleNamespace(spec=SPEC), survey=SimpleNamespace(density=3.0))
        return scene, {}, SimpleNamespace(root_labels=found[case.name].astype(np.int32))

    monkeypatch.setattr(script, "build", build)
    return script


def test_the_factory_and_what_is_near_to_it_are_not_scored(suburb):
    """Houses are, and the density is that of the survey."""
    truth, density = suburb.reference_of_all(None)
    assert density == 3.0
    assert truth.scored[HOUSE | OTHER].all()
    assert not truth.scored[FACTORY].any()
    assert not truth.scored[80, 120]
    assert truth.scored[60, 120]


def test_a_row_has_what_is_false_missing_found_and_true(suburb):
    """Of two houses one is found, and as much beside them."""
    truth, _ = suburb.reference_of_all(None)
    assert suburb.row_of(1.0, "all", None, truth) == "| 1 | all | 33.3 | 50.0 | 50.0 | 1 of 2 | 1 of 2 |"
    assert suburb.row_of(2.0, "first only", None, truth) == "| 2 | first only | 100.0 | 0.0 | 0.0 | 2 of 2 | 2 of 2 |"


def test_a_copy_without_colours_has_all_else(suburb):
    """The colours are 0, those of the cloud itself stay."""
    header = laspy.LasHeader(point_format=2, version="1.2")
    cloud = laspy.LasData(header)
    cloud.x, cloud.y, cloud.z = (np.arange(3.0) for _ in range(3))
    cloud.red = cloud.green = cloud.blue = np.full(3, 200, dtype=np.uint16)
    copy = suburb.without_colours(cloud)
    assert not any(copy[name].any() for name in ("red", "green", "blue"))
    assert cloud.red.all()
    np.testing.assert_array_equal(copy.x, cloud.x)
