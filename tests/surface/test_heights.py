"""Heights above ground: of grids, and of the points themselves."""

import numpy as np
import pytest
from affine import Affine
from pyproj import CRS

from msbdb.errors import GridMismatchError
from msbdb.grid import Grid, GridSpec, lattice
from msbdb.morphology.windows import dilation, erosion
from msbdb.points.cloud import PointCloud
from msbdb.surface import (
    density_of_cells,
    heights_above,
    heights_of_cells,
    normalise,
    points_of_cells,
    surface_from_rasters,
    without_narrow_gaps,
)

UTM = CRS.from_epsg(32631)
SPEC = lattice((500_000.0, 4_000_000.0, 500_020.0, 4_000_030.0), 2.0, UTM)


def sloping() -> Grid:
    """Return terrain that rises by 0.1 to the east and 0.2 to the north, given at cell centres."""
    rows, cols = np.indices(SPEC.shape)
    east, north = SPEC.xy(rows, cols)
    values = 50 + 0.1 * (east - 500_000) + 0.2 * (north - 4_000_000)
    return Grid(values.astype(np.float32), np.ones(SPEC.shape, dtype=np.bool_), SPEC)


def points(x: list[float], y: list[float], z: list[float]) -> PointCloud:
    """Return a bare cloud."""
    return PointCloud(np.array(x), np.array(y), np.array(z), UTM)


def test_points_stand_above_a_plane_by_what_was_added() -> None:
    """Bilinear terrain is exact on a plane, between the outermost centres."""
    x, y = 500_000 + np.array([1.0, 7.3, 19.0]), 4_000_000 + np.array([1.0, 14.9, 29.0])
    added = np.array([0.0, 12.5, -3.0])
    z = 50 + 0.1 * (x - 500_000) + 0.2 * (y - 4_000_000) + added
    np.testing.assert_allclose(heights_above(PointCloud(x, y, z, UTM), sloping()), added, atol=1e-4)


def test_beyond_the_outermost_centres_the_terrain_is_held() -> None:
    """The corner of a cell takes the terrain of its centre."""
    west, south, _, _ = SPEC.bounds
    found = heights_above(points([west, west + 1], [south, south + 1], [60.0, 60.0]), sloping())
    assert found[0] == pytest.approx(found[1])


def test_grids_of_other_lattices_are_refused() -> None:
    """A surface and a terrain must share their cells."""
    other = lattice((500_000.0, 4_000_000.0, 500_020.0, 4_000_030.0), 1.0, UTM)
    dsm = Grid(np.zeros(other.shape, dtype=np.float32), np.ones(other.shape, dtype=np.bool_), other)
    with pytest.raises(GridMismatchError, match="share one lattice"):
        normalise(dsm, sloping())


def raster_surface(side_m, shape=(41, 37)):
    """Return a surface of a raster beside the absolute lattice, whose terrain has a gap, with random heights."""
    random = np.random.default_rng(5)
    spec = GridSpec(shape, Affine(side_m, 0, 450_001.3, 0, -side_m, 5_400_000.7), CRS.from_epsg(32633))
    valid = random.random(shape) > 0.1
    dsm = Grid(random.uniform(90, 110, shape).astype(np.float32), valid, spec)
    ground = np.ones(shape, dtype=bool)
    ground[:3] = False
    return surface_from_rasters(dsm, Grid(np.full(shape, 88.0, dtype=np.float32), ground, spec))


@pytest.mark.parametrize("side_m", [0.1, 0.25, 0.7, 2.0])
def test_cells_stand_for_points(side_m):
    """One in the middle of each cell with a height above ground, in row order, at the height of the surface."""
    surface = raster_surface(side_m)
    points, spec, valid = points_of_cells(surface), surface.ndsm.spec, surface.ndsm.valid
    assert not valid[:3].any()
    rows, cols = np.nonzero(valid)
    np.testing.assert_array_equal(spec.rowcol(points.x, points.y), (rows, cols))
    east, north = spec.xy(rows, cols)
    aside = np.concatenate((points.x - east, points.y - north)) / side_m
    assert 0.004 < np.abs(aside).max() <= 0.00501
    assert abs(aside.mean()) < 0.0005
    assert abs(np.corrcoef(points.x - east, points.y - north)[0, 1]) < 0.1
    np.testing.assert_array_equal(points.z, surface.dsm.values[valid].astype(np.float64))
    np.testing.assert_array_equal(heights_of_cells(surface), surface.ndsm.values[valid].astype(np.float64))
    assert points.first_echo.all()
    assert not points.has_echoes
    assert points.facts.spacing_m == points.facts.link_m == side_m


def test_windows_see_the_same_points():
    """To the bit, where they share cells; and no two distances between neighbours are equal."""
    surface = raster_surface(0.2)
    rows, cols = slice(5, 30), slice(11, 37)
    spec = surface.ndsm.spec.crop(rows, cols)

    def cut(grid):
        return Grid(grid.values[rows, cols], grid.valid[rows, cols], spec)

    window = points_of_cells(surface_from_rasters(cut(surface.dsm), cut(surface.dtm)))
    whole = points_of_cells(surface)
    row, col = np.nonzero(surface.ndsm.valid)
    inside = (row >= rows.start) & (row < rows.stop) & (col >= cols.start) & (col < cols.stop)
    for axis in ("x", "y", "z"):
        np.testing.assert_array_equal(getattr(window, axis), getattr(whole, axis)[inside])
    beside = np.hypot(np.diff(window.x), np.diff(window.y))
    assert len(np.unique(beside.round(8))) == len(beside)


@pytest.mark.parametrize("cell_m", [0.25, 0.5, 2.0])
def test_narrow_gaps_of_a_raster_are_filled_and_wide_ones_stay(cell_m):
    """By the nearest measured cell, the lower of two; neither water nor what lies beyond the survey changes."""
    random, shape = np.random.default_rng(8), (60, 70)
    reach = max(2, round(1 / cell_m))
    spec = GridSpec(shape, Affine(cell_m, 0, 450_001.3, 0, -cell_m, 5_400_000.7), CRS.from_epsg(32633))
    wide = np.zeros(shape, dtype=bool)
    wide[:, : 2 * reach + 1] = wide[20 : 20 + 2 * reach + 1, 40 : 40 + 2 * reach + 1] = True
    narrow = random.random(shape) < 0.3
    narrow[45 : 45 + 2 * reach, 30:60] = True
    valid = ~(wide | narrow)
    heights = np.where(valid, random.uniform(90, 110, shape), 0).astype(np.float32)
    measured = Grid(heights, valid, spec)
    filled = without_narrow_gaps(measured, 1.0)
    # Lone gaps at the edge of a wide one may belong to it.
    inner = wide & (erosion(wide.astype(np.float32), 3, None) > 0)
    assert not filled.valid[inner].any()
    assert filled.valid[dilation(wide.astype(np.float32), 2 * reach + 1, None) == 0].all()
    np.testing.assert_array_equal(filled.values[valid], heights[valid])
    rows, cols = np.nonzero(valid)
    for row, col in np.argwhere(filled.valid & ~valid):
        distance = (rows - row) ** 2 + (cols - col) ** 2
        assert filled.values[row, col] == heights[valid][distance == distance.min()].min()
    other = Grid(np.where(valid, heights, 1e6).astype(np.float32), valid, spec)
    np.testing.assert_array_equal(without_narrow_gaps(other, 1.0).values, filled.values)
    whole = Grid(heights, ~wide, spec)
    assert without_narrow_gaps(whole, 1.0) is whole


@pytest.mark.parametrize(("share", "single"), [(0.5, True), (0.8, True), (0.95, False)])
def test_where_cells_are_hardly_more_than_echoes_the_measured_ones_stand_for_points(share, single):
    """They are farther apart then. Otherwise all cells with a height do, and are a cell apart."""
    surface = raster_surface(0.5)
    measured = np.random.default_rng(1).random(surface.dsm.spec.shape) < share
    found = surface_from_rasters(surface.dsm, surface.dtm, measured=measured)
    np.testing.assert_array_equal(found.samples.observed, measured)
    np.testing.assert_array_equal(found.ndsm.valid, surface.ndsm.valid)
    chosen = found.ndsm.valid & measured if single else found.ndsm.valid
    points = points_of_cells(found)
    np.testing.assert_array_equal(found.ndsm.spec.rowcol(points.x, points.y), np.nonzero(chosen))
    np.testing.assert_array_equal(heights_of_cells(found), found.ndsm.values[chosen].astype(np.float64))
    density = 4 * np.count_nonzero(chosen) / np.count_nonzero(found.ndsm.valid)
    assert found.density == points.facts.density == pytest.approx(density)
    assert points.facts.spacing_m == points.facts.link_m == pytest.approx(density**-0.5)


def test_parts_of_a_raster_have_the_density_of_the_whole():
    """A part in which all cells were measured, and one with gaps: all their cells count together."""
    surface = raster_surface(0.5)
    cells = np.random.default_rng(1).random(surface.dsm.spec.shape)
    full, half = (surface_from_rasters(surface.dsm, surface.dtm, measured=cells < share) for share in (1, 0.5))
    valid = np.count_nonzero(surface.ndsm.valid)
    few = np.count_nonzero(surface.ndsm.valid & (cells < 0.5))
    assert density_of_cells([full]) == density_of_cells([full, full, full, full, half]) == 4
    assert density_of_cells([half]) == half.density == pytest.approx(4 * few / valid)
    assert density_of_cells([full, half]) == pytest.approx(2 * (valid + few) / valid)
