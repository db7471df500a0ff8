"""The area filter of the bands (V34)."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from pyproj import CRS
from support.sizes import examples

from msbdb.grid import Bands, lattice
from msbdb.morphology.area import area_open_close
from msbdb.spectral.model import filter_bands

UTM = CRS.from_epsg(32633)


def _bands(*layers):
    """Bands of 1 m cells."""
    values = np.stack([np.asarray(layer, dtype=np.float32) for layer in layers])
    spec = lattice((0.1, 0.1, values.shape[2] - 0.1, values.shape[1] - 0.1), 1.0, UTM)
    names = tuple(f"band {n}" for n in range(len(layers)))
    return Bands(values, names, np.ones(spec.shape, dtype=bool), spec)


def test_without_a_mask_it_is_the_open_close_of_each_band():
    """On the whole image the paper's filter and this one agree."""
    rng = np.random.default_rng(0)
    layers = rng.integers(0, 6, (2, 12, 15)).astype(np.float32)
    bands = _bands(*layers)
    filtered = filter_bands(bands, bands.valid, 5.0)
    for band, layer in zip(filtered.values, layers, strict=True):
        np.testing.assert_array_equal(band, area_open_close(layer, 5))


def test_a_small_bright_object_takes_the_roof_value_and_not_the_streets():
    """A chimney vanishes within its roof; the street outside of the mask has no say."""
    image = np.full((8, 8), 200.0)
    image[1:7, 1:7] = 90
    image[3, 3] = 250
    inside = np.zeros((8, 8), dtype=bool)
    inside[1:7, 1:7] = True
    filtered = filter_bands(_bands(image), inside, 4.0)
    assert (filtered.values[0][inside] == 90).all()
    assert not filtered.values[0][~inside].any()
    np.testing.assert_array_equal(filtered.valid, inside)


def test_an_island_below_the_area_keeps_its_values():
    """There is nothing to compare it with; it is not painted with a value from outside."""
    image = np.arange(36.0).reshape(6, 6)
    inside = np.zeros((6, 6), dtype=bool)
    inside[0, 0:2] = inside[3:6, 3:6] = True
    filtered = filter_bands(_bands(image), inside, 5.0)
    assert filtered.values[0][0, :2].tolist() == [0, 1]


def test_an_area_below_two_cells_changes_nothing():
    """filter_share 0 turns the filter off."""
    bands = _bands(np.random.default_rng(1).random((5, 5)))
    np.testing.assert_array_equal(filter_bands(bands, bands.valid, 0.0).values, bands.values)


@examples(60)
@given(hnp.arrays(np.int64, (9, 9), elements=st.integers(0, 4)), hnp.arrays(bool, (9, 9)), st.integers(2, 6))
def test_islands_are_filtered_apart(image, inside, area):
    """An island's result is the same when it is alone on the map, so tiles of whole islands give the whole."""
    inside = inside.copy()
    inside[:, 4] = False
    bands = _bands(image)
    whole = filter_bands(bands, inside, float(area)).values[0]
    for side in (slice(0, 4), slice(5, 9)):
        alone = np.zeros_like(inside)
        alone[:, side] = inside[:, side]
        part = filter_bands(bands, alone, float(area)).values[0]
        np.testing.assert_array_equal(part[:, side], whole[:, side])
    assert set(np.unique(whole[inside])) <= set(np.unique(image[inside]).astype(float))
