"""The benchmark of growth builds towns of the area that it is asked for, and a country can be simulated."""

import json

import pytest
from support.processes import BENCHMARKS, run_script


def told(script, *options):
    """Return what a script prints as JSON."""
    done = run_script(BENCHMARKS / script, *options, "--json")
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.mark.campaign
def test_towns_have_their_area_and_are_built():
    """A larger town has more points in proportion, and buildings."""
    one, two = told("growth", "--areas", "0.02", "0.08", "--density", "1")
    assert one["points"] / 20_000 == pytest.approx(1.3, abs=0.3)
    assert two["points"] / one["points"] == pytest.approx(4, rel=0.15)
    assert two["buildings"] > one["buildings"] > 0
    assert min(one["cpu_seconds"], one["peak_gb"], one["database_mb"]) > 0


def test_a_country_takes_less_time_with_more_workers():
    """The work is the same, the time about half; the last merge and the start are left."""
    few, many = (told("country", "--area", "4000", "--workers", str(n)) for n in (50, 100))
    assert few["told"]["points"] == many["told"]["points"] == 4000e6 * 8
    assert few["told"]["tiles"] == 4000
    assert 1.6 < few["told"]["hours"] / many["told"]["hours"] < 2.0
    assert many["told"]["worker_hours"] == pytest.approx(few["told"]["worker_hours"], rel=0.02)


def test_workers_without_losses_repeat_nothing():
    """Without spread, losses and towns the hours follow from the seconds alone."""
    asked = ("--area", "100", "--workers", "1", "--spread", "0", "--town-share", "0", "--start-minutes", "0")
    found = told("country", *asked, "--loss-hours", "1e9", "--reading-seconds", "0", "--merge-seconds", "0")["told"]
    assert found["repeated"] == 0
    assert found["tile_hours"] == pytest.approx(100 * 58 * 1.44 / 3600, abs=0.06)
