"""Agreement by point: the paper's figures, and the matching of two files' points."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from pyproj import CRS

from msbdb.errors import CRSError, InputError, NodataError
from msbdb.evaluate import PointEvaluation, PointScores, match_points, score_points
from msbdb.points.cloud import PointCloud

LAMBERT = CRS.from_epsg(2154)
MASKS = arrays(np.bool_, st.integers(0, 40))


def cloud(xyz, crs=LAMBERT):
    """Return points of (N, 3) coordinates."""
    return PointCloud(*np.asarray(xyz, dtype=np.float64).T.copy(), crs=crs)


def scattered(count=500, seed=2):
    """Return distinct coordinates far from the origin, decimetres apart."""
    rng = np.random.default_rng(seed)
    return rng.permutation(np.stack(np.unravel_index(np.arange(count), (10, 10, 10)), 1)) * 0.1 + [7e5, 6.6e6, 20.0]


@pytest.mark.parametrize(
    ("tp", "fn", "fp", "expected"),
    [
        (76474, 1663, 2090, (0.9787, 0.9734, 0.9532)),
        (42150, 4291, 1237, (0.9076, 0.9715, 0.8841)),
        (54957, 23180, 1984, (0.7033, 0.9652, 0.6859)),
        (42111, 4330, 1247, (0.9068, 0.9712, 0.8831)),
    ],
)
def test_the_counts_of_cao_and_wu_give_their_figures(tp, fn, fp, expected):
    """C21: multi-scale and single-scale on both sites, counted from points; the paper's columns are swapped (A16)."""
    predicted = np.repeat([True, False, True, False], [tp, fn, fp, 1000])
    truth = np.repeat([True, True, False, False], [tp, fn, fp, 1000])
    score = score_points(predicted, truth)
    assert (score.tp, score.fn, score.fp, score.tn) == (tp, fn, fp, 1000)
    rates = score.rates
    assert (rates.completeness, rates.correctness, rates.quality) == pytest.approx(expected, abs=1e-4)
    assert score.cao_wu_columns.correctness == rates.completeness == tp / (tp + fn)
    assert score.cao_wu_columns.completeness == rates.correctness == tp / (tp + fp)
    assert rates.quality == pytest.approx(tp / (tp + fn + fp))


@given(MASKS.flatmap(lambda mask: st.tuples(st.just(mask), arrays(np.bool_, mask.shape))))
def test_counts_are_whole_and_mirror_each_other(sides):
    """All points are counted once; with the sides swapped, so are both kinds of errors and both rates."""
    predicted, truth = sides
    one, other = score_points(predicted, truth), score_points(truth, predicted)
    assert one.tp + one.fp + one.fn + one.tn == len(truth)
    assert (one.tp, one.fp, one.fn, one.tn) == (other.tp, other.fn, other.fp, other.tn)
    assert one.rates.completeness == pytest.approx(other.rates.correctness, nan_ok=True)
    assert one.tp == sum(p and t for p, t in zip(predicted, truth, strict=True))


def test_what_cannot_be_divided_is_none_in_the_report():
    """No building on either side: no rate, and JSON has no NaN; rows name every measure once."""
    report = PointEvaluation("order", PointScores.of(tp=0, fp=0, fn=0, tn=9))
    assert math.isnan(report.points.rates.quality)
    assert report.as_dict()["points"]["rates"]["quality"] is None
    names = [name for _, name, _ in report.rows()]
    assert names[:7] == ["tp", "fp", "fn", "tn", "completeness", "correctness", "quality"]
    assert names[-2:] == ["cao_wu_columns.correctness", "cao_wu_columns.completeness"]
    assert len(set(names)) == len(names)


def test_other_lengths_are_refused():
    """With both numbers."""
    with pytest.raises(InputError, match="3 points, the truth 2"):
        score_points(np.ones(3, np.bool_), np.ones(2, np.bool_))


def test_points_in_order_are_matched_by_order():
    """Within the rounding of another scale, also where points coincide."""
    xyz = np.repeat(scattered(), 2, axis=0)
    index, matched = match_points(cloud(xyz), cloud(np.round(xyz, 2) + 0.004))
    assert matched == "order"
    np.testing.assert_array_equal(index, np.arange(1000))


def test_points_in_another_order_are_matched_by_coordinates():
    """Each finds itself."""
    xyz = scattered()
    order = np.random.default_rng(4).permutation(len(xyz))
    index, matched = match_points(cloud(xyz[order]), cloud(xyz))
    assert matched == "coordinates"
    np.testing.assert_array_equal(order[index], np.arange(len(xyz)))


def test_points_without_a_partner_are_an_error_that_counts_them():
    """On either side, and beyond a centimetre in height as well."""
    xyz = scattered()
    with pytest.raises(InputError, match=r"^3 of 500 points of the reference .* and 0 of 497 the other way"):
        match_points(cloud(xyz[3:]), cloud(xyz))
    with pytest.raises(InputError, match=r"^0 of 497 points of the reference .* and 3 of 500 the other way"):
        match_points(cloud(xyz), cloud(xyz[3:]))
    moved = xyz.copy()
    moved[7, 2] += 0.011
    with pytest.raises(InputError, match=r"^1 of 500 .* and 1 of 500"):
        match_points(cloud(moved), cloud(xyz))


def test_other_crs_and_no_points_are_refused():
    """Nothing is compared across places."""
    xyz = scattered()
    with pytest.raises(CRSError, match="RGF93"):
        match_points(cloud(xyz), cloud(xyz, CRS.from_epsg(32631)))
    with pytest.raises(NodataError, match="no points"):
        match_points(cloud(xyz), cloud(np.empty((0, 3))))
