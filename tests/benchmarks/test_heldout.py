"""The fusion on places that its values were not chosen on: cases, tables and the fit; on a simulated place."""

from dataclasses import replace

import laspy
import numpy as np
import pytest
from cases.fusion import Islands, islands_of, seen
from cases.labelled import Place, reference_of
from cases.measures import GIVEN, OWN, Case
from simulated import scenes
from simulated.files import write_points
from support.processes import BENCHMARKS, load_script

from msbdb.params import DETECTORS, FuseParams


@pytest.fixture(scope="module")
def heldout():
    """Return scripts/benchmarks/heldout."""
    return load_script(BENCHMARKS / "heldout")


@pytest.fixture(scope="module")
def judged(tmp_path_factory, heldout):
    """Return a simulated place as it is, a second case of it, and a third one of another town."""
    data = tmp_path_factory.mktemp("data")
    houses = scenes.row_houses(density=4.0)
    write_points(data / "points.laz", houses.points)
    cloud = laspy.read(data / "points.laz")
    cloud.classification = houses.labels
    cloud.write(data / "points.laz")
    place = Place("town", ("points.laz",), "EPSG:32633")
    clouds = place.read(data)
    case = Case("town_1", place.crs, clouds, reference_of(place, clouds, data, 0.5), {})
    own, given = (seen(case, ground, data / "kept") for ground in (OWN, GIVEN))
    np.testing.assert_array_equal(seen(case, OWN, data / "kept").heights.values, own.heights.values)
    assert len(list((data / "kept").iterdir())) == 2
    return [
        heldout.Judged("places", "town_1", case.reference, own, given),
        heldout.Judged("lifted", "town_2, hills", case.reference, own, given),
        heldout.Judged("places", "village", case.reference, own, own),
    ]


def test_the_copies_of_a_town_are_one_place(judged):
    """The name up to its number, its half or its kind."""
    assert [case.place for case in judged] == ["town", "town", "village"]


def test_what_was_kept_fuses_as_a_build_does(judged, heldout):
    """The houses are found; all four detectors are there, and each can be left out."""
    case, default = judged[0], FuseParams()
    assert set(case.own.covered) == set(DETECTORS)
    assert heldout.quality(case, case.own, default) > 80
    assert heldout.quality(case, case.own, default, "multiscale") > 50


def test_values_are_chosen_on_the_other_places_alone(judged, heldout):
    """A place that is best with another value moves the choice for the others, but not its own."""

    class Known(heldout.Qualities):
        """Of the village, cheap edges are best; all else is alike."""

        def of(self, case, params):
            return 90.0 if case.place == "village" and params.edge_cost == 0.25 else 80.0

    default = FuseParams()
    assert heldout.chosen(judged[:2], Known()) == default
    assert heldout.chosen(judged[2:], Known()) == replace(default, edge_cost=0.25)


def test_the_tables_have_all_cases_and_all_pieces(judged, heldout):
    """A row each; the village has no other ground than its own."""
    table = heldout.held_out(judged)
    assert [line.split(" | ")[0] for line in table.splitlines() if line.startswith("| town")] == [
        "| town_1",
        "| town_2, hills",
    ]
    assert [line.split(" | ")[0] for line in table.splitlines()[-3:]] == [
        "| mean, places",
        "| mean, lifted",
        "| mean, all",
    ]
    pieces = heldout.ablation(judged)
    assert "| | mean | town | village |" in pieces
    assert all(f"| without {name} | " in pieces for name in DETECTORS)
    assert all(f"| {name} | " in pieces for name in heldout.RULES)
    given = next(line for line in pieces.splitlines() if line.startswith("| with the ground"))
    assert given.endswith("| +0.0 |")
    # The rules are in force again.
    assert heldout.ablation(judged) == pieces


def test_islands_are_true_where_the_reference_has_them(judged):
    """All of the reference's own cells are; none where it has nothing, and none is scored where nothing is."""
    case = judged[0]
    spec = case.reference.spec
    onto_own = case.own.heights.spec
    rows, cols = np.indices(onto_own.shape)
    east, north = onto_own.xy(rows.ravel(), cols.ravel())
    built = spec.sample(case.reference.built, east, north, outside=False).reshape(onto_own.shape)
    params = FuseParams()
    found = islands_of(built, case.own, case.reference, params)
    assert found.true[found.kept].all()
    assert np.count_nonzero(found.kept) > 0
    assert not found.true[~found.kept].any()
    assert ((found.support >= 0) & (found.support <= 1)).all()
    none = islands_of(~built, case.own, case.reference, params)
    assert not none.true[none.kept].any()
    # Where nothing is taken, the houses are refused, and true.
    refused = islands_of(np.zeros_like(built), case.own, case.reference, params)
    assert not refused.kept.any()
    assert refused.true.any()
    unscored = replace(case.reference, scored=np.zeros_like(case.reference.scored))
    assert len(islands_of(built, case.own, unscored, params).true) == 0


def test_the_fit_finds_the_odds_that_objects_were_drawn_from(heldout):
    """Also where one place has many more objects than the others."""
    rng = np.random.default_rng(7)
    islands = []
    for place, count in (("a", 6000), ("b", 1500), ("c", 1500)):
        support = rng.random(count)
        drawn = Islands(np.ones(count, dtype=bool), support, support > 0, rng.uniform(10, 900, count))
        true = rng.random(count) < heldout.Odds(0.6, 15, 0.7).probability(drawn)
        islands.append((place, replace(drawn, true=true)))
    odds = heldout.fitted(islands)
    assert odds.even == pytest.approx(0.6, abs=0.02)
    assert odds.slope == pytest.approx(15, abs=2)
    assert odds.area == pytest.approx(0.7, abs=0.2)
    # Objects of a place whose detectors take everything count as one place of three.
    taken = np.ones(90_000, dtype=bool)
    loud = ("c", Islands(taken, np.ones(90_000), taken, np.full(90_000, 50.0)))
    assert heldout.fitted([*islands[:2], loud]).even == pytest.approx(0.6, abs=0.05)


def test_the_reliability_counts_each_object_once(heldout, tmp_path):
    """The bins add up, and the picture is drawn."""
    rng = np.random.default_rng(3)
    islands = []
    for place in ("a", "b", "c"):
        support = rng.random(400)
        true = support > 0.6 + 0.1 * rng.standard_normal(400)
        islands.append((place, Islands(support > 0.5, support, true, np.full(400, 60.0))))
    text = heldout.reliability(islands, tmp_path / "plot.png")
    rows = [line.split(" | ") for line in text.splitlines() if " to " in line and line.startswith("| 0")]
    assert len(rows) == len(heldout.BINS) - 1
    assert sum(int(row[1]) for row in rows) == sum(int(row[4]) for row in rows) == 1200
    states = [line.split(" | ") for line in text.splitlines() if line.startswith(("| conf", "| ref", "| uns"))]
    assert sum(float(row[1]) for row in states) == pytest.approx(100, abs=0.2)
    assert (tmp_path / "plot.png").stat().st_size > 1000


def test_an_unknown_table_is_explained(heldout, monkeypatch, capsys):
    """Before any data is asked for."""
    monkeypatch.setattr("sys.argv", ["heldout", "--tables", "places,thick"])
    with pytest.raises(SystemExit) as ended:
        heldout.main()
    assert ended.value.code == 2
    assert "got thick" in capsys.readouterr().err
