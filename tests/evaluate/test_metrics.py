"""The definitions give back the figures that the papers print."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from msbdb.evaluate.agreement import averages, quality, rates


@pytest.mark.parametrize(
    ("true", "extracted", "found", "reference", "expected"),
    [
        (39, 47, 43, 54, (0.8298, 0.7963, 0.6845)),
        (31, 46, 44, 60, (0.6739, 0.7333, 0.5413)),
    ],
)
def test_objects_of_vu_table_2(true, extracted, found, reference, expected):
    """V55: each side counts its own true positives."""
    score = rates(found=found, missed=reference - found, true=true, false=extracted - true)
    assert (score.correctness, score.completeness, score.quality) == pytest.approx(expected, abs=5e-5)


@pytest.mark.parametrize(("complete", "correct", "expected"), [(0.8264, 0.9665, 0.8034), (0.7819, 0.9194, 0.7317)])
def test_pixel_quality_of_vu_table_3(complete, correct, expected):
    """V57: 80.34 % and 73.17 % follow from the printed completeness and correctness."""
    assert quality(complete, correct) == pytest.approx(expected, abs=5e-5)


@pytest.mark.parametrize(
    ("tp", "fn", "fp", "expected"),
    [
        (76474, 1663, 2090, (0.9787, 0.9734, 0.9532)),
        (42150, 4291, 1237, (0.9076, 0.9715, 0.8841)),
        (54957, 23180, 1984, (0.7033, 0.9652, 0.6859)),
        (42111, 4330, 1247, (0.9068, 0.9712, 0.8831)),
    ],
)
def test_points_of_cao_and_wu(tp, fn, fp, expected):
    """C21 by the usual definitions, which are the paper's columns swapped."""
    score = rates(found=tp, missed=fn, true=tp, false=fp)
    assert (score.completeness, score.correctness, score.quality) == pytest.approx(expected, abs=1e-4)
    assert score.quality == pytest.approx(tp / (tp + fn + fp))


@pytest.mark.parametrize(
    ("complete", "correct", "expected"),
    [
        (0.99, 0.94, 0.931),
        (0.98, 0.98, 0.961),
        (0.99, 0.98, 0.970),
        (0.96, 0.97, 0.932),
    ],
)
def test_quality_of_mongus_table_2(complete, correct, expected):
    """M25: the harmonic form (1/Comp + 1/Corr - 1)^-1 is the same number."""
    assert quality(complete, correct) == pytest.approx(1 / (1 / complete + 1 / correct - 1))
    assert quality(complete, correct) == pytest.approx(expected, abs=1e-3)


@pytest.mark.parametrize(
    ("complete", "correct", "expected"),
    [
        (0.9634, 0.9846, 0.9491),
        (0.9429, 0.9273, 0.8780),
        (0.8828, 0.9135, 0.8147),
        (0.8632, 0.8883, 0.7787),
    ],
)
def test_quality_of_the_slides(complete, correct, expected):
    """S10 and S11: by object and by area."""
    assert quality(complete, correct) == pytest.approx(expected, abs=2e-4)


def test_omission_and_commission_of_the_slides():
    """S11 and A20: commission is what is false of the extracted, omission what is missed of the reference."""
    score = rates(found=88.28, missed=11.72, true=91.35, false=8.65)
    assert (score.commission, score.omission) == pytest.approx((0.0865, 0.1172))


def test_micro_and_macro_differ_as_in_vu_table_3():
    """A21: the ratio of the sums is not the mean of the ratios."""
    score = averages(np.array([10.0, 90.0]), np.array([20.0, 380.0]))
    assert score.micro == pytest.approx(0.25)
    assert score.macro == pytest.approx((0.5 + 90 / 380) / 2)
    assert math.isnan(averages(np.empty(0), np.empty(0)).macro)


def test_nothing_found_is_0_and_nothing_to_find_is_undefined():
    """Empty sides: the rates that divide by nothing are NaN, and the quality is 0 as long as either side has any."""
    nothing_extracted = rates(found=0, missed=5, true=0, false=0)
    assert (nothing_extracted.completeness, nothing_extracted.quality) == (0, 0)
    assert math.isnan(nothing_extracted.correctness)
    nothing_there = rates(found=0, missed=0, true=0, false=5)
    assert (nothing_there.correctness, nothing_there.quality) == (0, 0)
    assert math.isnan(nothing_there.completeness)
    assert math.isnan(rates(found=0, missed=0, true=0, false=0).quality)


@given(st.integers(1, 10**6), st.integers(0, 10**6), st.integers(0, 10**6))
def test_quality_is_the_intersection_over_the_union(tp, fn, fp):
    """With the same true positives on both sides it never exceeds either rate."""
    score = rates(found=tp, missed=fn, true=tp, false=fp)
    assert score.quality == pytest.approx(tp / (tp + fn + fp))
    assert score.quality <= min(score.completeness, score.correctness) + 1e-12
