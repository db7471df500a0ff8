"""K-means on a sample that no tiling and no order can change (V35)."""

import numpy as np
from pyproj import CRS

from msbdb.grid import Bands, lattice
from msbdb.spectral.kmeans import draw_sample, fit_centres, lattice_keys, nearest_class, predict

UTM = CRS.from_epsg(32633)


def _image(height=20, width=30, west=1000.0, south=5000.0, seed=0):
    """Bands of four plain colours with noise, on a lattice far from its origin."""
    spec = lattice((west + 0.1, south + 0.1, west + width - 0.1, south + height - 0.1), 1.0, UTM)
    rng = np.random.default_rng(seed)
    truth = (np.arange(width)[None] * 4 // width) + np.zeros((height, 1), dtype=int)
    values = np.array([[10, 60, 110, 200], [200, 20, 120, 90]])[:, truth] + rng.normal(0, 2, (2, height, width))
    return Bands(values.astype(np.float32), ("red", "nir"), np.ones(spec.shape, dtype=bool), spec), truth


def _crop(bands, rows, cols):
    """Cut a tile of the bands."""
    return Bands(
        bands.values[:, rows, cols].copy(), bands.names, bands.valid[rows, cols].copy(), bands.spec.crop(rows, cols)
    )


def _draw(bands, count=100, seed=0):
    """Draw a sample of unfiltered bands on flat ground."""
    return draw_sample(bands, bands, np.zeros(bands.spec.shape), None, count=count, seed=seed)


def test_keys_are_distinct_and_depend_on_the_seed():
    """No two cells of a large area share a key, negative lattice rows included."""
    row, col = np.divmod(np.arange(200_000), 500)
    keys = lattice_keys(row - 6_000_000, col + 400_000, 0)
    assert np.unique(keys).size == keys.size
    assert not (keys == lattice_keys(row - 6_000_000, col + 400_000, 1)).any()


def test_tiles_give_the_sample_of_the_whole():
    """The smallest keys of the samples of overlapping tiles are the sample that one draw gives."""
    bands, _ = _image()
    whole = _draw(bands)
    tiles = [_draw(_crop(bands, slice(0, 20), cols)) for cols in (slice(18, 30), slice(0, 11), slice(9, 20))]
    keys, first = np.unique(np.concatenate([tile.keys for tile in tiles]), return_index=True)
    np.testing.assert_array_equal(keys[:100], whole.keys)
    filtered = np.concatenate([tile.filtered for tile in tiles])
    np.testing.assert_array_equal(filtered[first[:100]], whole.filtered)
    assert len(whole) == 100


def test_sample_spreads_over_the_whole_area():
    """Cells are picked evenly, not from one end."""
    bands, truth = _image(40, 60)
    row, col = np.indices(truth.shape)
    keys = lattice_keys(row + bands.spec.origin[0], col + bands.spec.origin[1], 0)
    picked = np.isin(keys, _draw(bands, 400).keys)
    assert picked.sum() == 400
    assert np.abs(np.bincount(truth[picked]) - 100).max() < 40


def test_plain_colours_are_told_apart():
    """Four well separated colours become four classes, whatever the seed."""
    bands, truth = _image()
    for seed in (0, 7):
        centres = fit_centres(_draw(bands, seed=seed), classes=4, seed=seed, tail_percent=2.0)
        index = predict(bands, centres)
        for colour in range(4):
            assert np.unique(index[truth == colour]).size == 1
        assert np.unique(index).tolist() == [1, 2, 3, 4]


def test_fit_is_repeatable_to_the_last_bit():
    """The same sample gives the same centres."""
    bands, _ = _image()
    first, again = (fit_centres(_draw(bands), classes=6, seed=0, tail_percent=2.0) for _ in range(2))
    np.testing.assert_array_equal(first.values, again.values)


def test_fewer_distinct_cells_than_classes_give_fewer_classes():
    """No warning, no empty class."""
    bands, _ = _image()
    flat = Bands(np.full_like(bands.values, 5), bands.names, bands.valid.copy(), bands.spec)
    centres = fit_centres(_draw(flat), classes=15, seed=0, tail_percent=2.0)
    assert len(centres) == 1
    assert (predict(flat, centres) == 1).all()


def test_nearest_class_is_the_nearest(monkeypatch):
    """Against the definition by all distances; and chunks do not change the prediction."""
    bands, _ = _image()
    centres = fit_centres(_draw(bands), classes=9, seed=0, tail_percent=2.0)
    rows = bands.values.reshape(2, -1).T
    scaled = centres.scaling.apply(rows)
    expected = ((scaled[:, None] - centres.values[None]) ** 2).sum(axis=2).argmin(axis=1) + 1
    np.testing.assert_array_equal(nearest_class(rows, centres), expected)
    whole = predict(bands, centres)
    monkeypatch.setattr("msbdb.spectral.kmeans.CHUNK", 7)
    np.testing.assert_array_equal(predict(bands, centres), whole)
