"""Limits between which something rises: what is refused, and what the message says."""

import re

import pytest

from msbdb.errors import ParameterError
from msbdb.params import Params, with_values
from msbdb.params.declare import require_rising

RISING = [
    ("ground", "wall_low_m", "wall_high_m"),
    ("cover", "glass_m", "leaf_m"),
    ("adaptive", "leaf_level", "glass_level"),
]


@pytest.mark.parametrize(("section", "lower", "upper"), RISING)
def test_limits_in_the_wrong_order_are_refused_when_they_are_set(section, lower, upper):
    """Equal ones as well, as nothing rises between them; the message has names, values and what to do."""
    high = getattr(getattr(Params(), section), upper)
    message = f"'{section}.{lower}' must be below '{section}.{upper}'; got {high} and {high}. Set both, or a smaller"
    with pytest.raises(ParameterError, match=re.escape(message)):
        with_values(Params(), {section: {lower: high}})
    # Both together may go beyond what either could alone.
    moved = with_values(Params(), {section: {lower: high / 2, upper: high * 0.75}})
    assert getattr(getattr(moved, section), lower) == high / 2


def test_just_rising_is_allowed():
    """There is no least distance between two limits."""
    high = Params().cover.leaf_m
    with_values(Params(), {"cover": {"glass_m": high * (1 - 1e-9)}})
    require_rising("cover", Params().cover, "glass_m", "leaf_m")
