"""The benchmark of ground on simulated estates."""

import numpy as np
import pytest
from simulated.estates import estate
from support.processes import BENCHMARKS, load_script

from msbdb.ground import choice


@pytest.fixture(scope="module")
def estates():
    """Return scripts/benchmarks/estates."""
    return load_script(BENCHMARKS / "estates")


def test_an_estate_is_the_same_each_time():
    """Halls stand above the terrain and apart from each other."""
    town, again = estate(3, 0.5), estate(3, 0.5)
    assert all(np.array_equal(getattr(town, name), getattr(again, name)) for name in ("x", "y", "z", "on", "bare"))
    assert len(town.halls) > 1
    assert not town.bare[town.on >= 0].any()
    assert town.bare[town.on < 0].mean() > 0.8


@pytest.mark.parametrize(("kept", "expected"), [(True, (1.0, 1.0, 0.0)), (False, (0.0, 0.0, 1.0))])
def test_what_a_filter_loses_is_counted(estates, monkeypatch, kept, expected):
    """One that keeps all as ground loses all roofs, and one that keeps nothing all of the open ground."""

    def decide(surface, *_):
        return np.full(surface.values.shape, kept)

    monkeypatch.setitem(choice.FILTERS, "walls", decide)
    roofs, of_roofs, lost, halls, off, open_ = estates.measured(estate(3, 0.5), 0.5, "walls")
    assert min(of_roofs, halls, open_) > 0
    assert (roofs / of_roofs, lost / halls, off / open_) == expected


def test_a_row_has_the_filter_and_its_shares(estates):
    """Of the default filter few roofs are lost."""
    density, name, roofs, halls, open_ = estates.row_of(1.0, "walls", 1).strip("| ").split(" | ")
    assert (density, name) == ("1", "`walls`")
    assert float(roofs) < 10
    assert halls.endswith(f"of {len(estate(estates.FIRST, 1.0).halls)}")
    assert float(open_) < 5
