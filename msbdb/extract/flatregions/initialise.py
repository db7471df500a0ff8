"""Initialisation: the lowest point of each cell, and inverse distance weighting between them (Mongus et al., §3.1)."""

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt
from scipy.spatial import cKDTree

from msbdb.errors import NodataError
from msbdb.grid import Grid, GridSpec
from msbdb.pointcloud import PointCloud
from msbdb.threads import kernel

NEAREST = 3
"""No fewer than the three nearest points (M8)."""

POWER = 2
"""r, the power of the distance (M8)."""

MOST = 24
"""Cells looked at for those as near as the third; a circle of cells' centres up to 12 cells wide holds fewer."""

REACH = 6
"""Distance in cells within which the nearest known cells are searched for cell by cell."""

BATCH = 1 << 17
"""Cells filled at once, which bounds the memory."""


def initialise(points: PointCloud, spec: GridSpec, *, max_gap_m: float = 0.0) -> Grid:
    """Take the lowest point of each cell, and fill the other cells from those around (M7, M8).

    Parameters
    ----------
    points : PointCloud
        All echoes; outliers beyond reason are gone.
    spec : GridSpec
        The survey's lattice. Its cell is the mean spacing 1/sqrt(density) on a ladder of round values, our reading of
        R_g (A10); so all extractors share one lattice.
    max_gap_m : float
        Cells farther than this from one with a point, and than two cells, stay invalid. 0 fills all, as the paper
        does: over water, too, where the surface would slope from quay to quay and be flat.

    Returns
    -------
    Grid
        float32 metres.

    Raises
    ------
    NodataError
        When no point lies on the lattice.
    """
    row, col = spec.rowcol(points.x, points.y)
    inside = spec.inside(row, col)
    if not inside.any():
        msg = f"None of the {len(points)} points lies on the lattice {spec.bounds}; check the CRS and the extent."
        raise NodataError(msg)
    lowest = np.full(spec.shape, np.inf)
    np.minimum.at(lowest.ravel(), (row * spec.shape[1] + col)[inside], points.z[inside])
    known = np.isfinite(lowest)
    wanted = ~known
    if max_gap_m > 0 and wanted.any():
        wanted &= distance_transform_edt(wanted) <= max(max_gap_m / spec.cell_m, 2.0)
    values = fill_by_idw(np.where(known, lowest, 0.0), known, wanted)
    return Grid(values.astype(np.float32), known | wanted, spec)


def fill_by_idw(
    values: NDArray[np.float64], known: NDArray[np.bool_], wanted: NDArray[np.bool_]
) -> NDArray[np.float64]:
    """Interpolate cells from the nearest known ones by inverse distance weighting (Eq. 6; M8).

    Parameters
    ----------
    values : (H, W) ndarray of float64
        Heights where known. Not modified.
    known : (H, W) ndarray of bool
        The cells p_n of the neighbourhoods.
    wanted : (H, W) ndarray of bool
        The cells p* to interpolate; none of them known.

    Returns
    -------
    (H, W) ndarray of float64
        Interpolated where wanted, the values elsewhere.

    Raises
    ------
    NodataError
        When cells are wanted but none is known.

    Notes
    -----
    g[p*] = Σ g[p] d^-2 / Σ d^-2 over the three nearest known cells and all that are as near as the third; so no
    direction is preferred, and the order in which cells are found does not count. With fewer known cells, over all of
    them. Distances are between centres. Cells with three known ones within ``REACH`` are filled by a search from near
    to far; the others, O(n log n), by a KD-tree.
    """
    if not wanted.any():
        return values.copy()
    if not known.any():
        msg = "No cell has a value from which others could be interpolated."
        raise NodataError(msg)
    filled, far = fill_near(values, known, wanted, _offsets(REACH))
    return _fill_far(filled, known, far) if far.any() else filled


def _fill_far(values: NDArray[np.float64], known: NDArray[np.bool_], wanted: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Interpolate cells that are far from the known ones, by a KD-tree."""
    targets = np.argwhere(wanted)
    sources = np.argwhere(known)
    tree = cKDTree(sources, balanced_tree=False, compact_nodes=False)
    heights = values[known]
    filled = values.copy()
    found = np.empty(len(targets))
    for start in range(0, len(targets), BATCH):
        batch = targets[start : start + BATCH]
        found[start : start + BATCH] = _weighted(tree, heights, sources, batch)
    filled[wanted] = found
    return filled


def _offsets(reach: int) -> NDArray[np.int64]:
    """Return (N, 3) row offset, column offset and squared distance, from near to far and then in row order."""
    row, col = np.mgrid[-reach : reach + 1, -reach : reach + 1].reshape(2, -1)
    squared = row**2 + col**2
    order = np.argsort(squared, kind="stable")
    order = order[(squared[order] > 0) & (squared[order] <= reach**2)]
    return np.stack([row[order], col[order], squared[order]], axis=1)


@kernel
def fill_near(
    values: NDArray[np.float64],
    known: NDArray[np.bool_],
    wanted: NDArray[np.bool_],
    offsets: NDArray[np.int64],
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Fill the wanted cells that have three known ones among the offsets; return the values, and the other cells."""
    height, width = values.shape
    filled, far = values.copy(), np.zeros(values.shape, dtype=np.bool_)
    for row in range(height):
        for col in range(width):
            if not wanted[row, col]:
                continue
            found, limit, total, weights = 0, 0, 0.0, 0.0
            for i in range(len(offsets)):
                squared = offsets[i, 2]
                if found >= NEAREST and squared > limit:
                    break
                r, c = row + offsets[i, 0], col + offsets[i, 1]
                if r < 0 or c < 0 or r >= height or c >= width or not known[r, c]:
                    continue
                found, limit = found + 1, squared
                total += values[r, c] / squared
                weights += 1.0 / squared
            if found < NEAREST:
                far[row, col] = True
            else:
                filled[row, col] = total / weights
    return filled, far


def _weighted(
    tree: cKDTree, heights: NDArray[np.float64], sources: NDArray[np.int64], targets: NDArray[np.int64]
) -> NDArray[np.float64]:
    """Return the weighted mean of the nearest known cells of each target."""
    most = min(MOST, len(sources))
    _, near = tree.query(targets, k=np.arange(1, most + 1), workers=-1)
    near.sort(axis=1)  # sums in row-major order of the cells, whatever the order of equally near ones
    squared = ((sources[near] - targets[:, None, :]) ** 2).sum(axis=2)
    limit = np.partition(squared, min(NEAREST, most) - 1, axis=1)[:, min(NEAREST, most) - 1]
    weight = np.where(squared <= limit[:, None], squared.astype(np.float64) ** (-POWER / 2), 0.0)
    mean: NDArray[np.float64] = (weight * heights[near]).sum(axis=1) / weight.sum(axis=1)
    return mean
