"""Towns under trees: real crowns of another tile are planted beside and over the houses of a real tile."""

from dataclasses import dataclass

import laspy
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt, gaussian_filter, maximum_filter
from skimage.segmentation import watershed

GROUND, TREE, BUILDING = 2, 5, 6

CELL_M = 0.5
"""Cells on which crowns are parted and planted."""

LEAST_M, TALL_M = 3.0, 5.0
"""Least height of a crown's cells, and of its top."""

CROWNS_M2 = (12.0, 150.0)
"""Least and largest area of a crown that is planted."""

OVER_ROOF = 0.4
"""Largest share of a crown that may lie over a house."""

REACH_CELLS = 4
"""Farther from any echo nothing is planted."""

TRIES = 100
"""So many places are tried for each tree."""

LOW_M = 1.0
"""Echoes below this height are of the ground and of what grows on it: they follow it under a crown."""

SEED = 7

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class Crown:
    """The echoes in the column of a tree, from its centre and from the ground beneath."""

    east: Array
    north: Array
    height: Array
    fields: dict[str, NDArray[np.generic]]
    """Echo numbers, pulses and intensity; the intensity is a ratio to that of the ground."""
    cells: NDArray[np.intp]
    """(N, 2) rows to the north and columns to the east of the cells that it covers."""


def crowns_of(cloud: laspy.LasData, share: float) -> list[Crown]:
    """Return the trees of a tile with classes that stand apart from its houses, with a share of their pulses.

    Crowns are the basins of the height above ground of vegetation; a column has all echoes that lie in the cells of its
    basin, those of the ground beneath among them.
    """
    x, y, z = (np.asarray(cloud[axis], dtype=np.float64) for axis in "xyz")
    classes = np.asarray(cloud.classification)
    row, col = _cells(cloud, x.min(), y.min())
    shape = (int(row.max()) + 1, int(col.max()) + 1)
    ground = _filled_mean(shape, row, col, z, classes == GROUND)
    height = z - ground[row, col]
    tops = np.zeros(shape)
    green = (classes >= 3) & (classes <= TREE)
    np.maximum.at(tops, (row[green], col[green]), height[green])
    smooth = gaussian_filter(tops, 1.5)
    peaks = (smooth == maximum_filter(smooth, 7)) & (smooth > TALL_M)
    basins = watershed(-smooth, np.cumsum(peaks.ravel()).reshape(shape) * peaks, mask=tops > LEAST_M)
    basins[:1] = basins[-1:] = basins[:, :1] = basins[:, -1:] = 0
    built = np.unique(basins[row[classes == BUILDING], col[classes == BUILDING]])
    _, pulse = np.unique(np.asarray(cloud.gps_time), return_inverse=True)
    kept = np.random.default_rng(SEED).random(pulse.max() + 1)[pulse] < share
    bright = np.median(np.asarray(cloud.intensity)[classes == GROUND])
    of = basins[row, col]
    crowns = []
    for basin in range(1, basins.max() + 1):
        cells = np.argwhere(basins == basin)
        area_m2 = len(cells) * CELL_M**2
        if basin in built or not CROWNS_M2[0] <= area_m2 <= CROWNS_M2[1]:
            continue
        inside = np.flatnonzero((of == basin) & kept & (classes != BUILDING))
        centre = np.round(cells.mean(axis=0)).astype(np.intp)
        fields = {
            "return_number": np.asarray(cloud.return_number)[inside],
            "number_of_returns": np.asarray(cloud.number_of_returns)[inside],
            "pulse": pulse[inside],
            "intensity": np.asarray(cloud.intensity)[inside] / bright,
            "classification": np.where(classes[inside] == GROUND, GROUND, TREE),
        }
        east = x[inside] - x.min() - centre[1] * CELL_M
        north = y[inside] - y.min() - centre[0] * CELL_M
        crowns.append(Crown(east, north, np.maximum(height[inside], 0), fields, cells - centre))
    return crowns


@dataclass(frozen=True)
class Town:
    """The cells of a tile with classes: where trees can stand, and on what."""

    west: float
    south: float
    ground: Array
    """Height of the ground, metres; other cells take the nearest."""
    roofs: Array
    """Height of the roofs, metres; -inf beside them. A cell without an echo is as the nearest echo."""
    covered: Mask
    """Cells near an echo."""

    @classmethod
    def of(cls, cloud: laspy.LasData) -> "Town":
        """Describe a tile."""
        z, classes = np.asarray(cloud.z, dtype=np.float64), np.asarray(cloud.classification)
        west, south = float(np.min(cloud.x)), float(np.min(cloud.y))
        row, col = _cells(cloud, west, south)
        shape = (int(row.max()) + 1, int(col.max()) + 1)
        roofs = np.full(shape, -np.inf)
        np.maximum.at(roofs, (row[classes == BUILDING], col[classes == BUILDING]), z[classes == BUILDING])
        seen = np.zeros(shape, dtype=np.bool_)
        seen[row, col] = True
        far, nearest = distance_transform_edt(~seen, return_indices=True)
        ground = _filled_mean(shape, row, col, z, classes == GROUND)
        return cls(west, south, ground, roofs[tuple(nearest)], far <= REACH_CELLS)

    def stands(self, crowns: list[Crown], per_hectare: float) -> list[tuple[Crown, NDArray[np.intp]]]:
        """Return so many crowns a hectare with the cell of their stem: beside houses, and hardly over their roofs."""
        random = np.random.default_rng(SEED)
        shape, built = self.ground.shape, np.isfinite(self.roofs)
        wanted = round(per_hectare * np.count_nonzero(self.covered) * CELL_M**2 / 10_000)
        free, found = self.covered.copy(), list[tuple[Crown, NDArray[np.intp]]]()
        for _ in range(TRIES * wanted):
            crown = crowns[random.integers(len(crowns))]
            stem = np.array([random.integers(shape[0]), random.integers(shape[1])])
            cells = crown.cells + stem
            if len(found) == wanted or built[tuple(stem)] or (cells < 0).any() or (cells >= shape).any():
                continue
            here = tuple(cells.T)
            if free[here].all() and built[here].mean() <= OVER_ROOF:
                free[here] = False
                found.append((crown, stem))
        return found


def planted(cloud: laspy.LasData, crowns: list[Crown], per_hectare: float) -> laspy.LasData:
    """Return a tile with so many more trees a hectare; what lies under a crown is seen as the crown's pulses saw it.

    A crown stands on the ground, wholly or mostly beside houses. Its echoes that would lie below a roof hit the roof.
    """
    town, classes = Town.of(cloud), np.asarray(cloud.classification)
    row, col = _cells(cloud, town.west, town.south)
    taken, parts = np.zeros(town.ground.shape, dtype=np.bool_), []
    bright, last = np.median(np.asarray(cloud.intensity)[classes == GROUND]), float(np.max(cloud.gps_time))
    for number, (crown, stem) in enumerate(town.stands(crowns, per_hectare)):
        taken[tuple((crown.cells + stem).T)] = True
        tree = _tree(cloud, town, crown, stem)
        tree.intensity = np.clip(crown.fields["intensity"] * bright, 0, 65535).astype(np.uint16)
        tree.gps_time = last + 1 + number + 1e-6 * crown.fields["pulse"]
        parts.append(tree.points.array)
    kept = cloud.points[~taken[row, col]]
    record = laspy.ScaleAwarePointRecord(
        np.concatenate([kept.array, *parts]), cloud.point_format, cloud.header.scales, cloud.header.offsets
    )
    return laspy.LasData(cloud.header, record)


def _tree(cloud: laspy.LasData, town: Town, crown: Crown, stem: NDArray[np.intp]) -> laspy.LasData:
    """Return the echoes of a crown at a stem, in the format of a tile and with colours of its vegetation."""
    tree = laspy.LasData(cloud.header, laspy.ScaleAwarePointRecord.zeros(len(crown.east), header=cloud.header))
    tree.x, tree.y = town.west + stem[1] * CELL_M + crown.east, town.south + stem[0] * CELL_M + crown.north
    rows, cols = _cells(tree, town.west, town.south)
    at = np.clip(rows, 0, town.ground.shape[0] - 1), np.clip(cols, 0, town.ground.shape[1] - 1)
    foot = town.ground[tuple(stem)]
    level = crown.height + np.where(crown.height < LOW_M, town.ground[at], foot)
    hit = level < town.roofs[at]
    tree.z = np.where(hit, town.roofs[at], level)
    tree.classification = np.where(hit, BUILDING, crown.fields["classification"]).astype(np.uint8)
    # Older formats count to 7.
    for name in ("return_number", "number_of_returns"):
        tree[name] = np.minimum(crown.fields[name], cloud.point_format.dimension_by_name(name).max)
    leaves = np.flatnonzero(np.asarray(cloud.classification) == TREE)
    if len(leaves):
        like = np.random.default_rng(SEED).choice(leaves, len(crown.east))
        for name in {"red", "green", "blue"} & set(cloud.point_format.dimension_names):
            tree[name] = np.asarray(cloud[name])[like]
    return tree


def _cells(cloud: laspy.LasData, west: float, south: float) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the row to the north and the column to the east of each point."""
    row, col = (
        np.floor((np.asarray(axis, dtype=np.float64) - least) / CELL_M).astype(np.intp)
        for axis, least in ((cloud.y, south), (cloud.x, west))
    )
    return row, col


def _filled_mean(shape: tuple[int, int], row: NDArray[np.intp], col: NDArray[np.intp], z: Array, chosen: Mask) -> Array:
    """Return (H, W) the mean height of the chosen points in each cell; other cells take the nearest."""
    cell = row[chosen] * shape[1] + col[chosen]
    count = np.bincount(cell, minlength=shape[0] * shape[1]).reshape(shape)
    total = np.bincount(cell, z[chosen], minlength=count.size).reshape(shape)
    nearest = distance_transform_edt(count == 0, return_distances=False, return_indices=True)
    return np.asarray((total / np.maximum(count, 1))[tuple(nearest)])
