"""A comparison by windows: every island lies whole in one window, and the result is that of a single window."""

import geopandas as gpd
import numpy as np
import pytest
import shapely
from geopandas.testing import assert_geodataframe_equal
from hypothesis import given, settings
from hypothesis import strategies as st
from pandas.testing import assert_frame_equal
from pyproj import CRS
from shapely.affinity import rotate, translate

from msbdb.change.comparison import compare
from msbdb.change.decisions import KINDS
from msbdb.change.surveywindows import Heights, islands, read_around, windows
from msbdb.grid import Grid, lattice
from msbdb.outline.polygons import rasterise

UTM = CRS.from_epsg(32631)
WEST, SOUTH, SIDE = 500_000.0, 4_000_000.0, 160.0
SPEC = lattice((WEST, SOUTH, WEST + SIDE, SOUTH + SIDE), 0.5, UTM)
SHIFT = (0.2, -0.1)

Side = tuple[gpd.GeoDataFrame, Heights]
"""The buildings of a survey, and its ground."""


def streets(seed: int) -> list[tuple[list[shapely.Polygon], list[float]]]:
    """Return houses and heights of two surveys: rows and single houses that stay, grow, rise, join, come and go."""
    random = np.random.default_rng(seed)
    sides: list[tuple[list[shapely.Polygon], list[float]]] = [([], []), ([], [])]
    for x in np.arange(WEST - 5, WEST + SIDE, 24):
        y = SOUTH - 6.0
        while y < SOUTH + SIDE:
            width, length, height, kind = random.uniform((6, 5, 4, 0), (18, 16, 15, 1))
            house = rotate(shapely.box(x, y, x + width, y + length), random.choice([0, 0, 30]))
            grown = shapely.union(house, translate(house, 5)) if 0.12 < kind < 0.2 else house
            y += length + random.choice([0, 0, 1.0, 2.5, 5])
            if kind > 0.06:
                sides[0][0].append(house)
                sides[0][1].append(height)
            if 0.06 < kind < 0.12:
                continue
            joined = shapely.union(sides[1][0][-1], grown) if sides[1][0] else shapely.MultiPolygon()
            if random.random() < 0.1 and joined.geom_type == "Polygon":
                sides[1][0][-1] = joined
                continue
            sides[1][0].append(grown)
            sides[1][1].append(height + 4 * (0.2 < kind < 0.25))
    return sides


def surveyed(seed: int) -> tuple[Side, Side]:
    """Return both surveys of a town, with noise, gaps and another zero; the first ends before the eastern border."""
    random = np.random.default_rng(seed)
    found = []
    for number, (shapes, heights) in enumerate(streets(seed)):
        placed = [translate(shape, *SHIFT) if number else shape for shape in shapes]
        values = np.append(0, heights).astype(np.float32)[rasterise(placed, SPEC)]
        values += random.normal(0, 0.05, values.shape).astype(np.float32)
        valid = random.random(values.shape) > 0.002
        valid[:, -90:] &= number == 1
        values[~valid] = 0
        terrain = np.linspace(0, 5, SPEC.shape[0], dtype=np.float32)[:, None] + 30 * number
        levels = Grid(np.where(valid, values + terrain, 0).astype(np.float32), valid, SPEC)
        frame = gpd.GeoDataFrame({"h_p90": heights}, geometry=placed, crs=UTM)
        found.append((frame, Heights(Grid(values, valid, SPEC), levels)))
    return found[0], found[1]


@given(st.integers(0, 2**32 - 1), st.integers(20, 200))
@settings(max_examples=8)
def test_windows_of_any_size_give_what_one_gives(seed: int, side: int) -> None:
    """Changes, new states and their order are equal to the last bit, on rows of houses that windows cut everywhere."""
    (before, earlier), (after, survey) = surveyed(seed)
    whole, part = (
        compare(before, after, survey=survey, earlier=[earlier], window_cells=cells) for cells in (10_000, side)
    )
    assert repr(whole.offset) == repr(part.offset)
    assert_frame_equal(whole.changes, part.changes, check_exact=True)
    assert_geodataframe_equal(whole.versions, part.versions)
    assert shapely.equals_exact(whole.versions.geometry.to_numpy(), part.versions.geometry.to_numpy(), 0).all()


def test_the_random_towns_have_all_kinds_of_change() -> None:
    """What the property above is tried on: all but the split, which towns have elsewhere."""
    kinds: set[str] = set()
    for seed in range(3):
        (before, earlier), (after, survey) = surveyed(seed)
        kinds |= set(compare(before, after, survey=survey, earlier=[earlier]).changes["kind"])
    assert kinds >= {*KINDS} - {"split"}


@given(st.integers(0, 2**32 - 1), st.integers(5, 400), st.sampled_from([0.0, 1.0, 30.0]))
def test_each_island_lies_whole_in_one_window(seed: int, side: int, around_m: float) -> None:
    """Also islands beyond the border of the lattice, as far as they reach into it; those beside it have none."""
    random = np.random.default_rng(seed)
    west, south = random.uniform(WEST - 60, WEST + SIDE + 60, (2, 30)) - [[0], [WEST - SOUTH]]
    shapes = shapely.box(west, south, west + random.uniform(1, 40, 30), south + random.uniform(1, 40, 30))
    island = islands(shapes, 2.0)
    found = list(windows(shapes, island, SPEC, around_m=around_m, side=side))
    every = np.concatenate([np.zeros(0, dtype=np.int64), *(rows for rows, _ in found)])
    assert len(every) == len(set(every.tolist()))
    for rows, box in found:
        assert (np.diff(rows) > 0).all()
        assert set(np.flatnonzero(np.isin(island, island[rows]))) == set(rows)
        seen = rasterise(shapes[rows], SPEC) > 0
        assert np.count_nonzero(seen) == np.count_nonzero(seen[box])
    left = np.setdiff1d(np.arange(30), every)
    assert not rasterise(shapes[left], SPEC).any()


def test_a_window_is_no_larger_than_its_squares_islands() -> None:
    """Houses of 10 m: with squares of 50 m windows reach at most 61 m, however far the town goes on."""
    grid = np.arange(0, SIDE, 20)
    east, north = (axis.ravel() for axis in np.meshgrid(WEST + grid, SOUTH + grid))
    shapes = shapely.box(east, north, east + 10, north + 10)
    found = list(windows(shapes, np.arange(len(shapes)), SPEC, around_m=0.5, side=100))
    assert len(found) == 9
    assert all(part.stop - part.start <= 122 for _, box in found for part in box)


def test_a_survey_is_read_around_a_place_and_not_beside_it() -> None:
    """Of a place at the border the cells on the survey are read."""
    ground = Heights(Grid(np.zeros(SPEC.shape, dtype=np.float32), np.ones(SPEC.shape, dtype=np.bool_), SPEC))
    found = read_around(ground, (WEST - 5, SOUTH + 10.1, WEST + 2, SOUTH + 11.9))
    assert found is not None
    assert found.spec.bounds == pytest.approx((WEST, SOUTH + 10, WEST + 2.5, SOUTH + 12))
    assert read_around(ground, (WEST - 5, SOUTH, WEST - 1, SOUTH + 9)) is None
