"""The benchmark of ground on hills, on a simulated town."""

import laspy
import numpy as np
import pytest
from cases.labelled import Place
from simulated import scenes
from simulated.files import write_points
from support.processes import BENCHMARKS, load_script, run_script

RELIEFS = ("slope of 30 %", "treads of 25 m, walls of 7 m")


@pytest.fixture(scope="module")
def hills():
    """Return scripts/benchmarks/hills."""
    return load_script(BENCHMARKS / "hills")


@pytest.fixture(scope="module")
def errors(hills, tmp_path_factory):
    """Return the errors on a town as it is and over two reliefs."""
    data = tmp_path_factory.mktemp("data")
    town = scenes.row_houses(density=4.0)
    write_points(data / "points.laz", town.points)
    cloud = laspy.read(data / "points.laz")
    cloud.classification = town.labels
    cloud.write(data / "points.laz")
    place = Place("town", ("points.laz",), "EPSG:32633")

    def copies(data, name):
        [plain] = place.read(data)
        yield "as it is", "all echoes", [plain], [plain]
        for relief in RELIEFS:
            laid = [hills.laid_over(plain, hills.STEEPER[relief])]
            yield relief, "all echoes", laid, laid

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(hills, "NAMED", {"town": place})
        patch.setattr(hills, "copies", copies)
        return hills.measure("town", data, ("walls", "progressive"))


def test_a_filter_that_sees_no_classes_is_right_on_flat_land(errors):
    """Hardly any terrain or roof of the town as it is is wrong, and all roofs are counted."""
    lost, taken, roofs = errors["as it is", "all echoes", "walls"]
    assert roofs > 300
    assert lost + taken < 0.02 * roofs


def test_each_choice_of_values_is_measured_and_the_default_one_is_the_filter_itself(hills, errors):
    """All pairs of values are there; the default pair gives what the filter does."""
    assert {key[2] for key in errors} == {"walls", "progressive", *hills.product(hills.SEEN, hills.STAYS)}
    for relief in ("as it is", *RELIEFS):
        key = (relief, "all echoes")
        np.testing.assert_array_equal(errors[*key, (0.4, 0.3)], errors[*key, "walls"])


def test_a_town_is_judged_by_the_values_that_are_best_on_the_others(hills):
    """The halves of a town are one place: neither may choose for the other."""
    good, bad, worst = np.array([1.0, 1, 100]), np.array([9.0, 9, 100]), np.array([50.0, 50, 100])

    def town(best):
        values = {value: good if value == best else bad for value in hills.product(hills.SEEN, hills.STAYS)}
        return {("as it is", "all echoes", key): each for key, each in {**values, "walls": worst}.items()}

    one, other = (0.3, 0.5), (0.5, 0.1)
    page = hills.held_out({"delft_1": town(one), "delft_2": town(one), "amsterdam": town(other)})
    rows = {line.split(" | ")[0].strip("| "): line for line in page.splitlines()[2:]}
    assert "| 50.0 + 50.0 | 9.0 + 9.0 | 0.5, 0.1 |" in rows["delft_1"]
    assert "| 50.0 + 50.0 | 9.0 + 9.0 | 0.3, 0.5 |" in rows["amsterdam"]


def test_a_part_of_the_page_is_not_written():
    """The page has one table of all filters and places."""
    done = run_script(BENCHMARKS / "hills", "--write", "--filters", "walls")
    assert done.returncode == 2
    assert "--write needs all filters and all places" in done.stderr
