"""Surveys of which one half is far sparser: cells and links of points follow that half, and its roofs are found."""

from dataclasses import replace

import numpy as np
import pytest
from simulated import scenes
from simulated.files import write_points

import msbdb
from msbdb.database import canonical_dump, open_database
from msbdb.errors import collected_notices
from msbdb.points.lots import drawn
from msbdb.points.spacing import index_squares, sparse_spacing
from msbdb.run.preparation.pointfacts import DENSER, UNEVEN, evenly_dense, with_facts
from msbdb.surveyplan import EVEN, Plan

TIMES = 9
"""How many times denser the western half is."""


@pytest.fixture(scope="module")
def even():
    """Return a quarter of the same density everywhere, without numbers of echoes."""
    return scenes.city(density=9.0).points


@pytest.fixture(scope="module")
def uneven(even):
    """Return the same quarter, in whose eastern half a share of the points is left."""
    return even.take((even.x < middle(even)) | drawn(even, 1 / TIMES))


def middle(cloud):
    """Return the border of the halves."""
    return (cloud.bounds[0] + cloud.bounds[2]) / 2


def shown(cloud):
    """Return the points that detectors are shown, with heights that tell them apart, and the notices."""
    known = with_facts(cloud, 0.0)
    with collected_notices() as notices:
        shown_points, heights = evenly_dense(known, np.arange(len(known), dtype=np.float64))
    return shown_points, heights, [str(notice) for notice in notices]


def test_the_sparser_parts_decide_where_they_are_a_fifth_of_the_ground():
    """Neither water without points nor the border makes a survey sparse, and a smaller part decides nothing."""

    def sparse(x, y, spacing_m):
        return sparse_spacing(x, y, index_squares(x, y, spacing_m))

    random = np.random.default_rng(1)
    x, y = random.uniform(0, 100, (2, 40_000))
    for sparse_m, expected in ((0, 0.5), (10, 0.5), (30, 1.5)):
        kept = (x >= sparse_m) | (random.random(len(x)) < 1 / 9)
        found = sparse(x[kept], y[kept], (1e4 / kept.sum()) ** 0.5)
        assert found == pytest.approx(expected, rel=0.12)
    dry = np.abs(x - 50) > 15
    assert sparse(x[dry], y[dry], 0.5) == pytest.approx(0.5, rel=0.1)
    few = np.arange(5.0)
    assert sparse(few, few, 1.3) == 1.3


def test_an_even_survey_stays_as_it_is(even):
    """Its spacing is the mean, all points are shown, and nothing is said."""
    known = with_facts(even, 0.0)
    assert known.facts.even_m == known.facts.spacing_m
    cloud, heights, notices = shown(even)
    assert len(cloud) == len(heights) == len(even)
    assert cloud.facts == known.facts
    assert not notices


def test_detectors_are_shown_an_evenly_dense_survey(even, uneven):
    """All points of the sparse half stay; the dense one keeps a share, and each point its height."""
    known = with_facts(uneven, 0.0)
    cloud, heights, notices = shown(uneven)
    assert notices == [UNEVEN]
    assert cloud.facts.spacing_m == known.facts.even_m == known.facts.sparse_m / EVEN
    border = middle(even)
    assert np.count_nonzero(cloud.x >= border) == np.count_nonzero(uneven.x >= border)
    first = cloud.first_echo & (cloud.x < border)
    assert np.count_nonzero(first) / 2e4 == pytest.approx(DENSER / known.facts.even_m**2, rel=0.1)
    np.testing.assert_array_equal(known.x[heights.astype(int)], cloud.x)


def test_roofs_of_the_sparser_half_are_found(even, uneven, tmp_path):
    """By `area3d` and `adaptive`, too: by the mean spacing, the points of these roofs are not linked."""
    db = tmp_path / "town.sqlite"
    report = msbdb.build(write_points(tmp_path / "town.laz", uneven), db=db)
    assert report.notices.count(UNEVEN) == 1
    houses = msbdb.open(db).buildings()
    east = houses[(houses.geometry.centroid.x > middle(even)) & (houses["area_m2"] > 80) & (houses["area_m2"] < 200)]
    assert len(east) == 8
    for method in ("area3d", "adaptive"):
        assert (east[f"{method}_share"] > 0.4).all()
        assert east[f"{method}_share"].mean() > 0.5


def test_tiles_of_an_uneven_survey_give_the_content_of_the_whole(uneven, tmp_path):
    """A tile that lies in one half follows the spacing of the survey."""
    part = uneven.take((uneven.y > 5_821_090) & (uneven.y < 5_821_170))
    file = write_points(tmp_path / "town.laz", part)
    found = []
    for name, tile in (("whole", None), ("tiles", 100.0)):
        db = tmp_path / f"{name}.sqlite"
        assert msbdb.build(file, db=db, survey="town", tile=tile).notices.count(UNEVEN) == 1
        engine = open_database(db)
        found.append([line for line in canonical_dump(engine) if not line.startswith('["run", ')])
        engine.dispose()
    assert found[0] == found[1]


def test_a_plan_of_before_knows_no_sparser_parts(uneven, tmp_path):
    """It is read, and its survey is built by the mean spacing, as it was."""
    plan = msbdb.plan(write_points(tmp_path / "town.laz", uneven))
    assert plan.points.even_m > plan.points.spacing_m
    kept = plan.as_dict()
    del kept["points"]["sparse_m"]
    before = Plan.from_dict(kept)
    assert before.points.even_m == before.points.spacing_m == plan.points.spacing_m
    assert replace(before.points, sparse_m=plan.points.sparse_m) == plan.points
