"""Tiles on the absolute lattice: they share no ground and leave none out, and know which islands their window cuts."""

import numpy as np
import pandas as pd
import pytest
from affine import Affine
from hypothesis import given
from hypothesis import strategies as st
from pyproj import CRS

from msbdb.errors import ParameterError
from msbdb.grid import GridSpec, lattice
from msbdb.scale.tiling import GUARD_M, Tile, cut_islands, first_cells, over_cells, owned_buildings, tiles_over

UTM = CRS.from_epsg(32633)


@given(
    places=st.lists(st.tuples(st.floats(-900, 900), st.floats(-900, 900)), min_size=1, max_size=20),
    side=st.floats(50, 400),
)
def test_each_place_is_of_one_tile(places, side):
    """The tiles of a box own each of its places exactly once."""
    x, y = np.array(places).T
    tiles = tiles_over([(x.min(), y.min(), x.max(), y.max())], side)
    owners = np.sum([tile.owns(x, y) for tile in tiles], axis=0)
    # A place may lie between the edge of a tile and the same edge counted from the other side, by rounding.
    near = np.minimum(np.abs(x / side - np.round(x / side)), np.abs(y / side - np.round(y / side))) < 1e-9
    assert (owners[~near] == 1).all()
    assert list(tiles) == sorted(set(tiles))


def test_tiles_that_are_too_small_are_refused():
    """The message names a sensible size."""
    with pytest.raises(ParameterError, match="500 or 1000"):
        tiles_over([(0, 0, 100, 100)], 10.0)


def test_a_region_begins_at_its_first_cell():
    """The first cell in row order, from the north; a label without cells has none."""
    spec = lattice((0, 0.1, 3.9, 1.9), 1.0, UTM)
    labels = np.array([[0, 2, 2, 0], [1, 1, 2, 0]], dtype=np.int32)
    x, y = first_cells(labels, 3, spec)
    assert x[:2].tolist() == [0.5, 1.5]
    assert y[:2].tolist() == [0.5, 1.5]
    assert np.isnan(x[2])


def test_an_island_near_the_edge_of_the_window_is_cut():
    """It counts where it reaches into the tile, and where the survey goes on beyond the edge."""
    tile, survey = Tile(0, 0, 100.0), (-500.0, -500.0, 500.0, 500.0)
    window = tile.window(50.0)
    spec = lattice((window[0], window[1] + 0.1, window[2] - 0.1, window[3]), 1.0, UTM)
    built = spec.holding((60.0, 40.0, 150.0 - GUARD_M + 1, 50.0))
    assert cut_islands(tile, built, spec, window, survey) == 1
    assert cut_islands(tile, built, spec, window, (-500.0, -500.0, 150.0, 500.0)) == 0
    whole = spec.holding((60.0, 40.0, 150.0 - GUARD_M, 50.0))
    beyond = spec.holding((105.0, 60.0, 150.0, 70.0))
    assert cut_islands(tile, whole | beyond, spec, window, survey) == 0


def test_a_building_belongs_to_the_tile_of_its_first_cell():
    """Of all its roots, not of the largest one, which a tile whose window cuts the building may not know."""
    tile, beside = Tile(0, 0, 100.0), Tile(0, 1, 100.0)
    roots = {"building_id": [7, 7, 9], "part_id": [7, 8, 9], "supid": 0, "xo": [150.0, 50.0, 120.0]}
    parts = pd.DataFrame({**roots, "yo": [60.0, 90.0, 20.0]})
    assert owned_buildings(tile, parts).tolist() == [7]
    assert owned_buildings(beside, parts).tolist() == [9]
    child = pd.DataFrame({"building_id": [9], "part_id": [10], "supid": [9], "xo": [50.0], "yo": [95.0]})
    assert owned_buildings(beside, pd.concat([parts, child])).tolist() == [9]


def test_the_number_of_a_building_counts_in_place_of_its_island():
    """Of two houses that touch, the one that ends near the edge counts; the other does not make it longer."""
    tile, survey = Tile(0, 0, 100.0), (-500.0, -500.0, 500.0, 500.0)
    window = tile.window(50.0)
    spec = lattice((window[0], window[1] + 0.1, window[2] - 0.1, window[3]), 1.0, UTM)
    within, far = (spec.holding((west, 40.0, east, 50.0)) for west, east in ((60.0, 110.0), (110.0, 140.0)))
    assert cut_islands(tile, within | far, spec, window, survey) == 1
    assert cut_islands(tile, within + 2 * far.astype(np.int32), spec, window, survey) == 0
    assert cut_islands(tile, np.int32(3) * (within | far), spec, window, survey) == 1


@given(
    corner=st.tuples(st.floats(-900, 900), st.floats(-900, 900)),
    shape=st.tuples(st.integers(1, 300), st.integers(1, 300)),
    cell_m=st.sampled_from([0.3, 0.5, 0.7, 1.0, 1200 / 3937]),
    side_m=st.floats(50, 400),
)
def test_each_cell_of_a_raster_is_of_one_tile(corner, shape, cell_m, side_m):
    """Wherever the raster lies, edges of tiles lie on edges of its cells, also for windows of it."""
    cells = GridSpec(shape, Affine(cell_m, 0, corner[0], 0, -cell_m, corner[1]), UTM)
    tiles = over_cells(cells, side_m)
    held = np.zeros(shape, int)
    for tile in tiles:
        rows, columns = cells.within(tile.bounds)
        assert rows.stop > rows.start
        held[rows, columns] += 1
        part = cells.crop(rows, columns)
        assert part.holding(tile.bounds).all()
        for edge, first in zip(tile.bounds[:2], (part.frame.east_m, part.frame.north_m), strict=True):
            along = (edge - first) / cell_m
            assert abs(along - round(along)) < 1e-6
    assert (held == 1).all()
    assert tiles[0].side_m >= side_m - 1e-6
