"""The support of buildings by the detectors: shares, probability and state."""

import numpy as np
import pandas as pd
import pytest

from msbdb.fuse.buildings import with_support
from msbdb.params import FuseParams

NAMES = ("multiscale", "flatregions", "area3d", "adaptive")


def supported(*rows, params=None, area_m2=50.0):
    """Return buildings with shares, a row each."""
    buildings = pd.DataFrame(
        {"state": "confirmed", "probability": np.nan, "area_m2": np.broadcast_to(area_m2, len(rows))}
    )
    return with_support(buildings, dict(zip(NAMES, np.array(rows).T, strict=True)), params=params or FuseParams())


def test_the_mean_share_gives_the_log_odds():
    """Even odds at s₀, and k log-odds for each unit of share beyond it."""
    params = FuseParams(support_even=0.5, support_slope=8.0)
    found = supported([0.5] * 4, [1, 1, 0.5, 0.5], [0, 0, 0.5, 0.5], params=params)
    assert found["probability"].tolist() == pytest.approx([0.5, 1 / (1 + np.exp(-2)), 1 / (1 + np.exp(2))])
    assert found["multiscale_share"].tolist() == [0.5, 1, 0]


def test_a_larger_area_adds_log_odds():
    """A factor e of area beyond 50 m² adds a; at 50 m² it adds nothing."""
    params = FuseParams(support_even=0.5, support_slope=8.0, area_slope=0.5)
    found = supported([0.5] * 4, [0.5] * 4, area_m2=np.array([50.0, 50 * np.e]), params=params)
    assert found["probability"].tolist() == pytest.approx([0.5, 1 / (1 + np.exp(-0.5))])


def test_the_state_follows_from_the_probability():
    """Confirmed from p₁, refuted up to 1 - p₁."""
    found = supported([1, 1, 1, 1], [1, 1, 0.3, 0.3], [0.3, 0.3, 0.05, 0.05])
    assert found["state"].tolist() == ["confirmed", "unsure", "refuted"]
    surer = supported([0.8] * 4, params=FuseParams(sure=0.99))
    assert surer["state"].tolist() == ["unsure"]


def test_more_support_never_makes_a_building_less_probable():
    """The probability rises with each detector's share."""
    rng = np.random.default_rng(5)
    rows = rng.random((200, 4))
    more = np.minimum(rows + rng.random((200, 4)) * (np.arange(4) == rng.integers(0, 4, (200, 1))), 1)
    assert (supported(*more)["probability"] >= supported(*rows)["probability"]).all()


def test_without_votes_there_is_no_probability():
    """One detector besides multiscale is no majority: the classes and its share decide."""
    buildings = pd.DataFrame({"state": ["confirmed", "confirmed"], "probability": np.nan})
    found = with_support(buildings, {"multiscale": np.ones(2), "flatregions": np.array([0.9, 0.0])})
    assert found["probability"].isna().all()
    assert found["state"].tolist() == ["confirmed", "unsure"]
