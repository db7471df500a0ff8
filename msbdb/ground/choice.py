"""The choice of the ground filter, and the terrain that it gives: all filters behind one interface."""

from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt, median_filter, uniform_filter

from msbdb.errors import NodataError
from msbdb.grid import Grid, GridSpec, lattice
from msbdb.ground.adaptivewindows import adaptive_ground
from msbdb.ground.interpolation import interpolate_ground, refine
from msbdb.ground.progressive import progressive_ground
from msbdb.ground.quadratic import quadratic_ground
from msbdb.ground.walls import walled_ground
from msbdb.ground.wavelet import wavelet_ground
from msbdb.params import GroundParams
from msbdb.points.cloud import GROUND_CLASS, PointCloud
from msbdb.surface.gridding import lowest

MIN_GROUND_SHARE = 0.02
"""Below this share of class 2 the given classes are not taken for a classification of the ground."""

VOID_M = 10.0
"""Cells farther than this from all points are a void: water, or beyond the survey. Sparse scan lines lie nearer."""


class GroundFilter(Protocol):
    """Detects the ground cells of a grid of lowest points."""

    def __call__(self, surface: Grid, params: GroundParams, /) -> NDArray[np.bool_]:
        """Return the (H, W) mask of ground cells.

        Parameters
        ----------
        surface : Grid
            Lowest heights, gap-free, metres. Valid are the cells near points; the values of others are mere guesses.
        params : GroundParams
            The filter's parameters.
        """


class PointGroundFilter(Protocol):
    """Detects the ground points of a cloud, without a grid."""

    def __call__(self, points: PointCloud, params: GroundParams, /) -> NDArray[np.bool_]:
        """Return the (N,) mask of ground points.

        Parameters
        ----------
        points : PointCloud
            N points, all echoes.
        params : GroundParams
            The filter's parameters.
        """


FILTERS: dict[str, GroundFilter] = {
    "progressive": progressive_ground,
    "walls": walled_ground,
    "wavelet": wavelet_ground,
}

POINT_FILTERS: dict[str, PointGroundFilter] = {"quadratic": quadratic_ground, "adaptive": adaptive_ground}


def terrain(points: PointCloud, spec: GridSpec, params: GroundParams) -> tuple[Grid, str]:
    """Return the DTM on a lattice, and the name of the ground filter.

    The filter detects the ground among points or cells. The terrain is interpolated under the other ones on cells of
    ``ground_cell_m``, or of half the lattice's where those are larger, and taken bilinearly at the lattice's cells.
    Walls are steps between cells: on cells as large as the spacing of sparse points, low houses would have none.

    Parameters
    ----------
    points : PointCloud
        All echoes.
    spec : GridSpec
        Lattice of the DTM.
    params : GroundParams
        ``ground_filter`` names the filter; ``auto`` trusts class 2 where at least 2 % of the points have it.

    Raises
    ------
    NodataError
        When class 2 is asked for and no point has it.
    """
    name = _resolve(points, params.ground_filter)
    coarse = lattice(spec.bounds, max(params.ground_cell_m, spec.cell_m / 2), spec.crs)
    if name == "class2":
        return refine(_through(points, points.in_class(GROUND_CLASS), coarse), spec), name
    if name in POINT_FILTERS:
        return refine(_through(points, POINT_FILTERS[name](points, params), coarse), spec), name
    surface = lowest_surface(points, coarse, params)
    ground = FILTERS[name](surface, params)
    return refine(interpolate_ground(surface.values, ground, coarse), spec), name


def _through(points: PointCloud, ground: NDArray[np.bool_], spec: GridSpec) -> Grid:
    """Lay the terrain through the lowest ground point of each cell."""
    found = lowest(points, spec, ground)
    return interpolate_ground(found.values, found.valid, spec)


def lowest_surface(points: PointCloud, spec: GridSpec, params: GroundParams) -> Grid:
    """Grid the lowest points without gaps, with isolated low outliers raised to their neighbourhood.

    All cells have values; valid are those within `VOID_M` of a cell with points.
    """
    found = lowest(points, spec)
    supported = _supported(found.valid)
    filled = interpolate_ground(found.values, supported, spec, nearest=True).values
    floor = median_filter(filled, size=5, mode="nearest") - np.float32(params.low_outlier_m)
    near = distance_transform_edt(~supported) * spec.cell_m <= max(VOID_M, 2 * spec.cell_m)
    return Grid(np.maximum(filled, floor), near, spec)


def _supported(observed: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Leave out cells alone in a void, where a single false echo would decide the terrain of all of it.

    Such a cell has fewer than two observed others among the 24 around it; where that is most cells, all of them stay.
    """
    around = uniform_filter(observed.astype(np.float32), 5, mode="constant") * 25
    supported = observed & (around > 2.5)
    return supported if 2 * np.count_nonzero(supported) > np.count_nonzero(observed) else observed


def _resolve(points: PointCloud, name: str) -> str:
    """Turn ``auto`` into the filter that fits the points, and check that class 2 is there when asked for."""
    known = points.facts
    own = float(np.count_nonzero(points.in_class(GROUND_CLASS))) / max(len(points), 1)
    share = own if known is None else known.ground_share
    if name == "auto":
        return "class2" if share >= MIN_GROUND_SHARE else "walls"
    if name == "class2" and share == 0.0:
        msg = "The ground filter 'class2' needs points of class 2, and no point has it; take 'walls' or 'progressive'."
        raise NodataError(msg)
    return name
