"""Polygons of labelled cells with shared edges: labels are tidied before, and polygons become labels again."""

import threading
from collections.abc import Iterable
from itertools import chain

import numpy as np
import rasterio.features
import shapely
from affine import Affine
from numpy.typing import NDArray

from msbdb.errors import GridMismatchError, InputError
from msbdb.grid import GridSpec
from msbdb.labels import Box, Islands, Labels, label_zones, look_up, sizes
from msbdb.threads import kernel

Geometries = NDArray[np.object_]
"""An array of shapely geometries."""

Ints = NDArray[np.int64]


def tidied(labels: Labels, least_px: float) -> Labels:
    """Return labels whose outlines have no rings below a least area, and no pieces that touch at a corner alone.

    Parameters
    ----------
    labels : (H, W) ndarray of int32
        0 where there is no object. Not modified.
    least_px : float
        Least size of a court, and of a second piece of a label, cells.

    Returns
    -------
    (H, W) ndarray of int32
        Every label is still there.

    Notes
    -----
    First, where two cells of a label touch at a corner and an empty cell lies beside both, that cell joins them. Then
    pieces below the least size go, but for the largest of each label. At last, empty zones below the least size that
    do not reach the border are filled: by the label along most of their edge, of equal ones the lower. Pieces and
    empty zones are 4-connected, as rings are. Invalid cells count as empty.

    Examples
    --------
    >>> labels = np.array([[1, 1, 1, 0], [1, 0, 1, 0], [1, 1, 1, 0], [0, 0, 0, 1]], dtype=np.int32)
    >>> tidied(labels, 2)
    array([[1, 1, 1, 0],
           [1, 1, 1, 0],
           [1, 1, 1, 1],
           [0, 0, 0, 1]], dtype=int32)
    """
    found = with_joined_corners(labels)
    zones, count = label_zones(found, connectivity=4)
    cells = sizes(zones, count)
    owner = np.zeros(count + 1, dtype=np.int64)
    inside = np.flatnonzero(zones > 0)
    owner[zones.ravel()[inside]] = found.ravel()[inside]
    order = np.lexsort((np.arange(count), -cells, owner[1:]))
    largest = np.zeros(count, dtype=np.bool_)
    largest[order[np.diff(owner[1:][order], prepend=0) > 0]] = True
    crumb = np.concatenate(([False], (cells < least_px) & ~largest))
    found.ravel()[inside[crumb[zones.ravel()[inside]]]] = 0
    return _without_small_holes(found, least_px)


def with_joined_corners(labels: Labels) -> Labels:
    """Return labels with the empty cells filled beside which two cells of a label touch at a corner alone."""
    found = np.ascontiguousarray(labels, dtype=np.int32).copy()
    _join_corners(found)
    return found


@kernel
def _join_corners(labels: Labels) -> None:
    """Give an empty cell to a label whose cells touch at a corner only, until no such cell is left."""
    changed = True
    while changed:
        changed = False
        for row in range(labels.shape[0] - 1):
            for col in range(labels.shape[1] - 1):
                for side in range(2):
                    own = labels[row, col + side]
                    if own == 0 or labels[row + 1, col + 1 - side] != own:
                        continue
                    above, below = labels[row, col + 1 - side], labels[row + 1, col + side]
                    if own in (above, below):
                        continue
                    if above == 0:
                        labels[row, col + 1 - side] = own
                        changed = True
                    elif below == 0:
                        labels[row + 1, col + side] = own
                        changed = True


def _without_small_holes(labels: Labels, least_px: float) -> Labels:
    """Fill the small empty zones inside."""
    zones, count = label_zones(labels == 0, connectivity=4)
    small = np.concatenate(([False], sizes(zones, count) < least_px))
    for border in (zones[0], zones[-1], zones[:, 0], zones[:, -1]):
        small[border] = False
    if not small.any():
        return labels
    # A small zone does not reach the border, so each of its cells has four neighbours.
    cells = np.flatnonzero(look_up(small, zones))
    width = labels.shape[1]
    zone = np.tile(zones.ravel()[cells], 4).astype(np.int64)
    label = np.concatenate([labels.ravel()[cells + step] for step in (1, -1, width, -width)]).astype(np.int64)
    zone, label = zone[label > 0], label[label > 0]
    key, edges = np.unique(zone * (int(labels.max()) + 1) + label, return_counts=True)
    zone, label = np.divmod(key, int(labels.max()) + 1)
    order = np.lexsort((label, -edges, zone))
    first = order[np.diff(zone[order], prepend=0) > 0]
    winner = np.zeros(count + 1, dtype=np.int32)
    winner[zone[first]] = label[first]
    filled = labels.copy()
    filled.ravel()[cells] = winner[zones.ravel()[cells]]
    return filled


def polygonise(labels: NDArray[np.int32], spec: GridSpec, count: int, *, islands: Islands | None = None) -> Geometries:
    """Return the outline of every label, exactly along the cells' edges (V47, V49).

    Parameters
    ----------
    labels : (H, W) ndarray of int32
        1 to ``count``; 0 where there is no object. A label may occur in several places.
    spec : GridSpec
        The lattice of the labels.
    count : int
        Number of labels, those that do not occur included.
    islands : Islands, optional
        Those on whose sheet the labels are; without it the labels are on the lattice itself. Outlines of a sheet take
        as long as it is large, and other threads wait for them.

    Returns
    -------
    (count,) ndarray of MultiPolygon
        The outline of the label i + 1 at index i, empty where it does not occur. Shells run counter-clockwise.

    Raises
    ------
    GridMismatchError
        When the labels do not have the shape of the lattice or the sheet.
    InputError
        When a label lies outside of 0 to ``count``.

    Notes
    -----
    Cells that touch only at a corner are polygons of their own within the MultiPolygon, so that every outline is
    valid; holes are kept. A vertex lies at each corner, and wherever three labels meet (0 counts as one), so that
    neighbours share whole edges. Cells at the border of the array are outlined along the border.

    Examples
    --------
    Two cells of 1 m side by side share the edge from (1, 0) to (1, 1):

    >>> from affine import Affine
    >>> from pyproj import CRS
    >>> spec = GridSpec((1, 2), Affine(1, 0, 0, 0, -1, 1), CRS.from_epsg(25832))
    >>> for outline in polygonise(np.array([[1, 2]], dtype=np.int32), spec, 2):
    ...     print(outline)
    MULTIPOLYGON (((0 1, 0 0, 1 0, 1 1, 0 1)))
    MULTIPOLYGON (((1 1, 1 0, 2 0, 2 1, 1 1)))
    """
    shape = spec.shape if islands is None else islands.sheet
    if labels.shape != shape:
        msg = f"The labels have the shape {labels.shape}; the lattice has {shape}."
        raise GridMismatchError(msg)
    if labels.min() < 0 or labels.max() > count:
        msg = f"Labels must lie between 0 and {count}; got {labels.min()} to {labels.max()}."
        raise InputError(msg)
    owner, rings, ring_sizes, corners = _traced(np.ascontiguousarray(labels, dtype=np.int32))
    vertices, ring_sizes = _with_nodes(corners, ring_sizes, labels)
    vertices = vertices if islands is None else islands.corners_on_lattice(vertices)
    world = np.column_stack(spec.corners(vertices[:, 1], vertices[:, 0]))
    offsets = (_offsets(ring_sizes), _offsets(rings), _offsets(sizes(owner, count)))
    outlines = shapely.from_ragged_array(shapely.GeometryType.MULTIPOLYGON, world, offsets)
    return np.asarray(shapely.orient_polygons(outlines), dtype=np.object_)


_ONE_AT_A_TIME = threading.Lock()
"""rasterio hides a warning of its own by filters that all threads share: the first to finish would restore them."""


def rasterise(geometries: Iterable[shapely.Geometry], spec: GridSpec) -> NDArray[np.int32]:
    """Return the cells whose centre lies in a geometry: its index + 1, or 0; the later one wins a cell.

    Parameters
    ----------
    geometries : iterable of polygonal geometries
        In the CRS of the lattice; empty ones cover nothing, and what lies outside of the lattice is cut off.
    spec : GridSpec
        The lattice.

    Returns
    -------
    (H, W) ndarray of int32
    """
    shapes = [(geometry, index + 1) for index, geometry in enumerate(geometries) if not shapely.is_empty(geometry)]
    labels = np.zeros(spec.shape, dtype=np.int32)
    if shapes:
        with _ONE_AT_A_TIME:
            rasterio.features.rasterize(shapes, out=labels, transform=spec.transform)
    return labels


def rasterise_window(geometries: Geometries, spec: GridSpec, window: Box) -> Labels:
    """Return the cells of a window as `rasterise` gives them for the whole lattice.

    An edge may run through centres of cells, as diagonals of traced outlines do. There the last digit decides, which
    depends on the columns, counted from the first one of the raster. So all columns up to the window's last are drawn.

    Parameters
    ----------
    geometries : (N,) ndarray of polygonal geometries
        In the CRS of the lattice.
    spec : GridSpec
        The whole lattice.
    window : tuple of slice
        Rows and columns.

    Returns
    -------
    (H, W) ndarray of int32
        Of the window's shape.
    """
    rows, cols = window
    of = spec.transform
    # Columns, and rows upwards: turned over, a ring would turn the other way, which decides on its horizontal edges.
    scale, shift = (1 / of.a, -1 / of.e), (-of.c / of.a, of.f / of.e)
    counted = shapely.transform(geometries, lambda places: places * scale + shift)
    strip = GridSpec((rows.stop - rows.start, cols.stop), Affine(1, 0, 0, 0, -1, -rows.start), spec.crs)
    return np.ascontiguousarray(rasterise(counted, strip)[:, cols])


def _traced(
    labels: NDArray[np.int32],
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Trace the 4-connected components.

    Returns the label and the number of rings of each component, in order of the label; the number of vertices of
    each ring; and all vertices as (column, row) of the lattice.
    """
    shapes = sorted(
        ((int(value), shape["coordinates"]) for shape, value in rasterio.features.shapes(labels, labels > 0)),
        key=lambda found: found[0],
    )
    owner = np.array([value for value, _ in shapes], dtype=np.int64)
    rings = np.array([len(rings) for _, rings in shapes], dtype=np.int64)
    flat = list(chain.from_iterable(rings for _, rings in shapes))
    sizes = np.array([len(ring) for ring in flat], dtype=np.int64)
    numbers = chain.from_iterable(chain.from_iterable(flat))
    vertices = np.fromiter(numbers, dtype=np.float64, count=2 * int(sizes.sum()))
    return owner, rings, sizes, np.rint(vertices).astype(np.int64).reshape(-1, 2)


def _are_nodes(labels: NDArray[np.int32], col: NDArray[np.int64], row: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Return whether three labels or more meet at vertices of the lattice."""
    padded = np.pad(labels, 1)
    a, b, c, d = padded[row, col], padded[row, col + 1], padded[row + 1, col], padded[row + 1, col + 1]
    distinct = (b != a).astype(np.int8)
    distinct += (c != a) & (c != b)
    distinct += (d != a) & (d != b) & (d != c)
    return np.asarray(distinct >= 2, dtype=np.bool_)


def _with_nodes(
    corners: NDArray[np.int64], sizes: NDArray[np.int64], labels: NDArray[np.int32]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Add the labels' nodes on the rings' edges as vertices; the rings are closed and run along the lattice."""
    ring = np.repeat(np.arange(len(sizes)), sizes)
    step = np.zeros_like(corners)
    step[:-1] = np.where((ring[1:] == ring[:-1])[:, None], corners[1:] - corners[:-1], 0)
    # The last vertex of a ring has no step; it still counts once.
    length = np.maximum(np.abs(step).sum(axis=1), 1)
    index = np.repeat(np.arange(len(corners)), length)
    along = np.arange(len(index)) - np.repeat(np.cumsum(length) - length, length)
    dense = corners[index] + np.sign(step)[index] * along[:, None]
    keep = (along == 0) | _are_nodes(labels, *dense.T)
    return dense[keep], np.bincount(ring[index[keep]], minlength=len(sizes))


def _offsets(sizes: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return where each group starts, and the end of the last."""
    return np.concatenate(([0], np.cumsum(sizes)))
