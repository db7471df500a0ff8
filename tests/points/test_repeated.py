"""Points that are there more than once: one of each place is left, whatever their order and their files' offsets."""

from collections import Counter

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from pyproj import CRS

from msbdb.points.cloud import PointCloud
from msbdb.points.repeated import repeated, without_repeated

SCALES = (0.001, 0.01, 0.0001, 0.00025)


def columns_of(count, seed, scale, side):
    """Return places of whole steps, many of them equal, and what else is known of the points."""
    random = np.random.default_rng(seed)
    steps = random.integers(-side, side, (3, count))
    places = tuple(axis * scale + offset for axis, offset in zip(steps, (7e5, 6.6e6, 0.0), strict=True))
    number = random.integers(1, 3, count).astype(np.uint8)
    classes = random.choice([0, 1, 2, 6], count).astype(np.uint8)
    return steps, places, number, classes, random.integers(0, 4, count).astype(np.uint16)


@settings(deadline=None, max_examples=60)
@given(st.integers(0, 600), st.integers(0, 2**32 - 1), st.sampled_from((*SCALES, 0.3048 * 0.01)), st.integers(1, 40))
def test_one_of_each_place_and_echo_is_left(count, seed, scale, side):
    """As many points stay as there are different steps and echo numbers; it is the one with the least class."""
    steps, places, number, classes, intensity = columns_of(count, seed, scale, side)
    again = repeated(places, number, classes, [intensity])
    keys = list(zip(*steps.tolist(), number.tolist(), strict=True))
    left = np.setdiff1d(np.arange(count), again)
    assert Counter(keys[i] for i in left) == Counter(dict.fromkeys(keys, 1))
    assert (np.diff(again) > 0).all()
    best = {}
    for key, name, value in zip(keys, classes.tolist(), intensity.tolist(), strict=True):
        best[key] = min(best.get(key, (999, 0)), (name if name > 1 else 255, value))
    for i in left:
        assert (classes[i] if classes[i] > 1 else 255, intensity[i]) == best[keys[i]]


@settings(deadline=None, max_examples=40)
@given(st.integers(1, 400), st.integers(0, 2**32 - 1), st.sampled_from(SCALES))
def test_the_order_of_points_and_the_offsets_of_files_mean_nothing(count, seed, scale):
    """A copy whose coordinates were counted from another offset differs in the last digits; all of it is repeated."""
    _, places, number, classes, intensity = columns_of(count, seed, scale, 10**6)
    cloud = PointCloud(*places, CRS.from_epsg(2154), None, classes, number, number, intensity)
    once = without_repeated(cloud)
    shifted = tuple(
        (axis - origin) + origin for axis, origin in zip(places, (689_123.456, 6_612_345.678, 77.7), strict=True)
    )
    copy = PointCloud(*shifted, cloud.crs, None, classes, number, number, intensity)
    both = {name: np.concatenate((values, copy.arrays()[name])) for name, values in cloud.arrays().items()}
    mixed = np.random.default_rng(seed).permutation(2 * count)
    twice = without_repeated(PointCloud(**{name: values[mixed] for name, values in both.items()}, crs=cloud.crs))
    assert len(twice) == len(once)
    for name, values in once.arrays().items():
        found = np.sort(twice.arrays()[name])
        np.testing.assert_allclose(found, np.sort(values), rtol=0, atol=1e-6)
    assert without_repeated(once) is once
