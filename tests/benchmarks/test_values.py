"""Values that are chosen on all places but one, and judged on that one: on a simulated place."""

from dataclasses import replace

import laspy
import numpy as np
import pytest
from cases.labelled import Place, reference_of
from cases.measures import OWN, Case, build, detected
from simulated import scenes
from simulated.files import write_points
from support.processes import BENCHMARKS, load_script

from msbdb import surveyplan
from msbdb.run.compose import fuse_and_decompose
from msbdb.run.reports import Stages


@pytest.fixture(scope="module")
def values():
    """Return scripts/benchmarks/values."""
    return load_script(BENCHMARKS / "values")


@pytest.fixture(scope="module")
def case(tmp_path_factory):
    """Return a simulated place with its reference."""
    data = tmp_path_factory.mktemp("data")
    houses = scenes.row_houses(density=4.0)
    write_points(data / "points.laz", houses.points)
    cloud = laspy.read(data / "points.laz")
    cloud.classification = houses.labels
    place = Place("town", (), "EPSG:32633")
    return Case("town_1", place.crs, [cloud], reference_of(place, [cloud], data, 0.5), {})


def quality_of(case, sections):
    """Build a case as a whole with other values."""
    scene, regions, params = detected(case, OWN, sections)
    forest = fuse_and_decompose(scene, regions, params, Stages(None)).forest
    return case.reference.quality(forest.root_labels > 0, scene.heights.spec)


def test_a_detector_that_runs_again_alone_gives_the_whole_build(values, case):
    """Values of detectors, of the ground and of the survey each give the quality of a build with them."""
    absurd = (
        (("adaptive", "least_odds", 40.0), ("area3d", "max_curvature", 1e-6), ("flatregions", "ratio", 50.0)),
        (("ground", "wall_low_m", 0.5), ("flatregions", "ratio", 50.0)),
        (("survey", "even", 0.2),),
    )
    found = values.judge(case, [(), *absurd])
    scene, _, forest = build(case, OWN)
    assert found[0] == case.reference.quality(forest.root_labels > 0, scene.heights.spec)
    assert found[1] == quality_of(case, values.sections_of(absurd[0])) < found[0] - 5
    assert found[2] == quality_of(case, values.sections_of(absurd[1]))
    # Cells of five spacings: the value is in force, and afterwards it is as it was.
    assert found[3] < found[0] - 1
    assert surveyplan.EVEN == 1.5
    assert values.judge(case, []) == []


def test_values_are_chosen_on_the_other_places_alone(values):
    """A place that is best with another value moves the choice for the others alone; ties keep the default."""
    group = values.Group("", "", {}, {"ground": {"wall_low_m": (0.6, 1.0)}})
    low, high = ((("ground", "wall_low_m", value),) for value in (0.6, 1.0))
    found = {
        "town_1": values.Found("places", {(): 80.0, low: 90.0, high: 70.0}),
        "town_2, 1": values.Found("thinned", {(): 80.0, low: 90.0, high: 80.0}),
        "village": values.Found("places", {(): 80.0, low: 80.0, high: 80.0}),
    }
    assert values.chosen(group, found, "town") == ()
    assert values.chosen(group, found, "village") == low
    assert group.single() == [(), low, high]


def test_the_page_has_all_cases_and_is_built_once(values, case, monkeypatch, tmp_path):
    """Two towns, with and without what the values are about; what the folder has is not built again."""
    calls = []

    def judge(each, wanted):
        calls.append((each.name, wanted))
        return [90.0 if value and each.name.startswith("b") else 80.0 for value in wanted]

    def table(_data, names):
        return iter(replace(case, name=name) for name in sorted(names))

    steps = {"ground": {"wall_low_m": (0.6,)}}
    group = values.Group("Walls", "Some.", {"all": table}, steps, {"all": table})
    monkeypatch.setattr(values, "GROUPS", {"walls": group})
    monkeypatch.setattr(values, "WORKERS", 1)
    monkeypatch.setattr(values, "judge", judge)
    page = values.section_of("walls", tmp_path, tmp_path / "kept", ["a", "b"])
    lines = page.splitlines()
    assert "| a | 80.0 | 80.0 | 80.0 | `wall_low_m` 0.6 |" in lines
    assert "| b | 80.0 | 80.0 | 80.0 |  |" in lines
    assert "| mean, all | 80.00 | 80.00 | 80.00 | |" in lines
    assert "| `ground.wall_low_m` 0.8 | 0.6 | +5.00 | +0.00 | +10.00 |" in lines
    built = [name for name, wanted in calls if wanted]
    assert built == ["a", "b", "a", "b"]
    assert values.section_of("walls", tmp_path, tmp_path / "kept", ["a", "b"]) == page
    assert [name for name, wanted in calls if wanted] == built


def test_a_case_without_colours_has_none(values, case):
    """Colours of the points are black, orthophotos and pictures are gone, and all else is as it was."""
    cloud = laspy.create(point_format=7)
    cloud.points = laspy.ScaleAwarePointRecord.zeros(len(case.clouds[0].points), header=cloud.header)
    cloud.x, cloud.y, cloud.z = case.clouds[0].x, case.clouds[0].y, case.clouds[0].z
    cloud.red = cloud.green = cloud.blue = np.full(len(cloud.points), 99, dtype=np.uint16)
    painted = replace(case, clouds=[cloud], ortho=(BENCHMARKS,), picture=(np.zeros((3, 1, 1)), case.reference.spec))
    bare = values._colourless(painted)
    assert not bare.ortho
    assert bare.picture is None
    assert not np.asarray(bare.clouds[0].red).any()
    np.testing.assert_array_equal(bare.clouds[0].x, cloud.x)
    assert np.asarray(cloud.red).all()
