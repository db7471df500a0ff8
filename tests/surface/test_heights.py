"""Heights above ground: of grids, and of the points themselves."""

import numpy as np
import pytest
from pyproj import CRS

from msbdb.errors import GridMismatchError
from msbdb.grid import Grid, lattice
from msbdb.points.cloud import PointCloud
from msbdb.surface import heights_above, normalise

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
