"""A point cloud in memory, and how its points are spread: mean spacing, the area of each point, and lone points."""

import math
from dataclasses import dataclass, field, fields, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from pyproj import CRS
from scipy.cluster.hierarchy import linkage
from scipy.spatial import cKDTree

from msbdb.errors import InputError
from msbdb.grid import Bounds, require_metric
from msbdb.labels import look_up
from msbdb.points.aside import let_go, set_aside
from msbdb.points.cellindex import CellIndex, cell_of_each, index_cells
from msbdb.surveyplan import PointFacts

UNCLASSIFIED_CLASS, GROUND_CLASS, BUILDING_CLASS = 1, 2, 6

NOISE_CLASSES = (7, 18)
"""Classes of points by the ASPRS LAS specification; noise is low or high."""

FIRST_CELL_M = 2.0
"""Cells on which the covered area is counted first; smaller ones would count the street beside a roof as empty."""

LEAST_A_CELL = 4.0
"""With fewer points a cell on average, cells without any would be many by chance: they are taken larger."""

BLOCK_CELLS = 5
"""Cells to the side of a block, whose density is counted: ten metres are less than the width of a strip's overlap."""

SQUARE_SPACINGS = 16
"""Side of the squares in which links are measured, in mean spacings: 256 points on average."""

SQUARES = 100
"""Most such squares; their median settles long before."""

NEIGHBOURS = 8
"""The distance to so many neighbours is that of a density, also where scan lines lie a few spacings apart."""

SPARSE_SHARE = 0.8
"""Ours: this share of the ground is denser than the sparser parts. Less may be water, and decides nothing for all."""

BEYOND_LINK = 1.2
"""Steps from point to point reach so many links, so that they also cross between lines that waver."""

LARGEST_CELL_M = 100.0
"""Beyond it there is no survey, but single points."""

LONE_GAP_Z_M, LONE_GAP_XY_M = 500.0, 50_000.0
"""A gap of this width without any point separates lone points from the main body, in height or in position."""

LONE_SHARE = 0.01
"""Points are lone if they are at most this share of all; one point always may be."""


@dataclass(frozen=True, slots=True, eq=False)
class PointCloud:
    """Points of one survey; arrays of equal length, None where the source has no such attribute.

    Parameters
    ----------
    x, y, z : (N,) ndarray of float64, metres
        Finite coordinates.
    crs : CRS
        Horizontal CRS, projected and in metres.
    vertical_crs : CRS, optional
        The heights' CRS, when the source names one.
    classification : (N,) ndarray of uint8, optional
        ASPRS classes.
    return_number, number_of_returns : (N,) ndarray of uint8, optional
        None when the source holds no echo information (all zero).
    intensity : (N,) ndarray of uint16, optional
        None when constant.
    colours : (N, B) ndarray of uint16, optional
        None when the source has none, or all are zero.
    colour_names : tuple of str
        Of ``red, green, blue, nir``, one a column of ``colours``.
    facts : PointFacts, optional
        What holds for the whole survey that the points are of; None where they are all of it, or nobody knows.
    """

    x: NDArray[np.float64]
    y: NDArray[np.float64]
    z: NDArray[np.float64]
    crs: CRS
    vertical_crs: CRS | None = None
    classification: NDArray[np.uint8] | None = None
    return_number: NDArray[np.uint8] | None = None
    number_of_returns: NDArray[np.uint8] | None = None
    intensity: NDArray[np.uint16] | None = None
    colours: NDArray[np.uint16] | None = None
    colour_names: tuple[str, ...] = field(default=())
    facts: PointFacts | None = None

    def __post_init__(self) -> None:
        """Check the lengths and the CRS."""
        require_metric(self.crs)
        for name, values in self.arrays().items():
            if len(values) != len(self.x):
                msg = f"The attribute {name} has {len(values)} values for {len(self.x)} points."
                raise InputError(msg)

    def __len__(self) -> int:
        """Return the number of points."""
        return len(self.x)

    def arrays(self) -> dict[str, NDArray[np.generic]]:
        """Return the arrays that are present, by name."""
        found = {f.name: getattr(self, f.name) for f in fields(self)}
        return {name: value for name, value in found.items() if isinstance(value, np.ndarray)}

    def in_class(self, *classes: int) -> NDArray[np.bool_]:
        """Return (N,) bool, which points have one of the ASPRS classes; none where the source holds no classes."""
        if self.classification is None:
            return np.zeros(len(self), dtype=np.bool_)
        return np.isin(self.classification, classes)

    def take(self, index: NDArray[np.generic]) -> "PointCloud":
        """Return the points that a boolean or integer index selects, with all their attributes."""
        # Of rows of colours a boolean index takes ten times as long as their numbers do.
        places = np.flatnonzero(index) if index.dtype == np.bool_ else index
        return replace(self, **{name: each.take(places, axis=0) for name, each in self.arrays().items()})  # type: ignore[arg-type]  # as they were

    def places(self) -> "PointCloud":
        """Return the points with their places and echoes alone, all that detectors take."""
        return replace(self, classification=None, intensity=None, colours=None, colour_names=())

    def aside(self) -> "PointCloud":
        """Return the points as files hold them where memory is bounded (`msbdb.points.aside.set_aside`)."""
        return replace(self, **{name: set_aside(values) for name, values in self.arrays().items()})  # type: ignore[arg-type]  # as they were

    @property
    def bounds(self) -> Bounds:
        """West, south, east and north, metres."""
        return (float(self.x.min()), float(self.y.min()), float(self.x.max()), float(self.y.max()))

    @property
    def first_echo(self) -> NDArray[np.bool_]:
        """Which points are first echoes (V15); all of them where the source holds no echo information."""
        if self.return_number is None:
            return np.ones(len(self), dtype=np.bool_)
        return np.equal(self.return_number, 1)

    @property
    def has_echoes(self) -> bool:
        """Whether some pulse of the survey gave more than one echo, so that the echoes hold information."""
        if self.number_of_returns is None:
            return False
        return bool((self.number_of_returns > 1).any()) if self.facts is None else self.facts.echoes


@dataclass(frozen=True, slots=True, eq=False)
class Density:
    """How dense a cloud is.

    Parameters
    ----------
    spacing_m : float
        Mean spacing of the points in plan, 1/sqrt(density).
    area_m2 : (N,) ndarray of float64
        Area of each point: one over the local density (A17).
    typical_m : float
        Median of the spacing over the covered ground. Where strips of a flight overlap, or one is denser, more than
        half of the ground may be sparser than the mean says.
    link_m : float
        Least link by which most points of a place are connected (`least_link`). Scan lines that lie far apart need
        links of their distance.
    """

    spacing_m: float
    area_m2: NDArray[np.float64]
    typical_m: float
    link_m: float

    @property
    def step_m(self) -> float:
        """Least length of a step that reaches other points on all sides, metres."""
        return BEYOND_LINK * self.link_m


def measure_density(
    x: NDArray[np.float64], y: NDArray[np.float64], first_echo: NDArray[np.bool_], facts: PointFacts | None = None
) -> Density:
    """Measure the spacing of the first echoes, and share the ground out among all points (A17).

    Parameters
    ----------
    x, y : (N,) ndarray of float64, metres
    first_echo : (N,) ndarray of bool
        The points that decide the spacing: later echoes of a pulse lie at the same place and make nothing denser. All
        points count where none is a first echo.
    facts : PointFacts, optional
        Where they are known, the spacing is that of the whole survey.

    Returns
    -------
    Density
        Of spacing 1 m where there is no point.

    Notes
    -----
    The density is that of the covered cells of 2 m, or of larger ones where these hold fewer than four points. The
    area of a point is that of its cell, of side two spacings, divided by the number of points in the cell. So the
    areas of all points sum up to the covered area: a strip scanned twice, walls, and all echoes of a crown count the
    ground once. T_a is compared in m2, at any density of the survey.

    Examples
    --------
    Sixteen points a metre apart, and a second echo at the place of the first:

    >>> x, y = (place.ravel() for place in np.meshgrid(np.arange(0.5, 4), np.arange(0.5, 4)))
    >>> found = measure_density(np.append(x, 0.5), np.append(y, 0.5), np.append(np.ones(16, dtype=bool), False))
    >>> found.spacing_m, float(found.area_m2.sum())
    (1.0, 16.0)
    >>> found.area_m2[[0, 15, 16]]
    array([0.8, 1. , 0.8])
    """
    spacing_m, typical_m, link_m = (
        measure_spacing(x, y, first_echo) if facts is None else (facts.spacing_m, facts.typical_m, facts.link_m)
    )
    if not len(x):
        return Density(spacing_m, np.zeros(0), typical_m, link_m)
    cells = index_cells(x, y, max(2 * spacing_m, link_m))
    let_go()
    return Density(spacing_m, _areas(cells), typical_m, link_m)


def measure_spacing(
    x: NDArray[np.float64], y: NDArray[np.float64], first_echo: NDArray[np.bool_]
) -> tuple[float, float, float]:
    """Return mean and median spacing of the first echoes, and their least link, metres; see `Density`."""
    chosen = first_echo if first_echo.any() else np.ones(len(x), dtype=np.bool_)
    return measure_spacings(x[chosen], y[chosen])[:3]


def measure_spacings(x: NDArray[np.float64], y: NDArray[np.float64]) -> tuple[float, float, float, float]:
    """Return mean and median spacing of first echoes, their least link, and the spacing of sparser parts, metres.

    Of no points all are 1 m. See `Density` and `sparse_spacing`.
    """
    if not len(x):
        return 1.0, 1.0, 1.0, 1.0
    cells = _covered(x, y)
    squares = _squares(x, y, _spacing(cells))
    link_m = _link(x, y, squares, _spacing(cells))
    if cells.cell_m < link_m:
        cells = _covered(x, y, link_m)
        squares = _squares(x, y, _spacing(cells))
    return _spacing(cells), _typical_spacing(cells), link_m, _sparse(x, y, squares, _spacing(cells))


def _squares(x: NDArray[np.float64], y: NDArray[np.float64], spacing_m: float) -> CellIndex:
    """Return the squares in which links and sparser parts are measured."""
    return index_cells(x, y, SQUARE_SPACINGS * spacing_m)


def least_link(x: NDArray[np.float64], y: NDArray[np.float64], spacing_m: float = 0.0) -> float:
    """Return the least link by which most points of a place are connected, metres.

    Points that are spread evenly or by chance need 1 to 1.4 mean spacings. Those on scan lines need the distance of the
    lines, however dense they are along them.

    Parameters
    ----------
    x, y : (N,) ndarray of float64, metres
        At least one point.
    spacing_m : float
        Their mean spacing; 0 measures it.

    Returns
    -------
    float
        The mean spacing where no place has points enough.

    Notes
    -----
    The median over at most `SQUARES` squares of the longest edge that the tree of nearest pairs needs to connect half
    of the points. Walls, water and strips of other density change single squares. Squares of less than half or over
    four times the mean number of points are left out. It does not depend on the direction of the lines.

    Examples
    --------
    Points 0.3 m apart on lines that lie 3 m apart, and as many at random places:

    >>> along, line = (place.ravel() for place in np.meshgrid(np.arange(0, 60, 0.3), np.arange(0, 60, 3.0)))
    >>> least_link(along, line)
    3.0
    >>> x, y = np.random.default_rng(0).uniform(0, 60, (2, 4000))
    >>> round(least_link(x, y), 1)
    1.1
    """
    spacing_m = spacing_m or _spacing(_covered(x, y))
    return _link(x, y, _squares(x, y, spacing_m), spacing_m)


def _link(x: NDArray[np.float64], y: NDArray[np.float64], squares: CellIndex, spacing_m: float) -> float:
    """Return the least link of points in squares."""
    count = np.diff(squares.starts)
    full = np.flatnonzero((count >= SQUARE_SPACINGS**2 / 2) & (count <= 4 * SQUARE_SPACINGS**2))
    if not len(full):
        return spacing_m
    links_m = []
    for square in full[:: math.ceil(len(full) / SQUARES)]:
        points = squares.order[squares.starts[square] : squares.starts[square + 1]]
        tree = linkage(np.column_stack((x[points], y[points])), "single")
        links_m.append(tree[np.argmax(2 * tree[:, 3] >= len(points)), 2])
    return float(np.median(links_m))


def sparse_spacing(x: NDArray[np.float64], y: NDArray[np.float64], spacing_m: float) -> float:
    """Return the spacing of the sparser parts of a place, metres: four fifths of the ground are denser.

    Parameters
    ----------
    x, y : (N,) ndarray of float64, metres
        First echoes.
    spacing_m : float
        Their mean spacing.

    Returns
    -------
    float
        The mean spacing where no square has points enough.

    Notes
    -----
    It is a quantile over at most `SQUARES` squares. The density of a square follows from the median distance of its
    points to their eighth neighbour. So neither water nor the border of the survey makes a square sparse. Squares of
    fewer than twice as many points do not count.

    Examples
    --------
    Two strips of one width, one with a point a square metre and one with four:

    >>> random = np.random.default_rng(0)
    >>> x = np.append(random.uniform(0, 50, 2500), random.uniform(50, 100, 10_000))
    >>> y = random.uniform(0, 50, 12_500)
    >>> round(sparse_spacing(x, y, 0.63), 1)
    1.1
    """
    return _sparse(x, y, _squares(x, y, spacing_m), spacing_m)


def _sparse(x: NDArray[np.float64], y: NDArray[np.float64], squares: CellIndex, spacing_m: float) -> float:
    """Return the spacing of the sparser parts of points in squares."""
    full = np.flatnonzero(np.diff(squares.starts) >= 2 * NEIGHBOURS)
    if not len(full):
        return spacing_m
    reach_m = []
    for square in full[:: math.ceil(len(full) / SQUARES)]:
        points = squares.order[squares.starts[square] : squares.starts[square + 1]]
        places = np.column_stack((x[points], y[points]))
        distances, _ = cKDTree(places).query(places, k=[NEIGHBOURS + 1])  # the nearest one is the point itself
        reach_m.append(np.median(distances))
    return float(np.quantile(reach_m, SPARSE_SHARE)) * math.sqrt(math.pi / NEIGHBOURS)


def _covered(x: NDArray[np.float64], y: NDArray[np.float64], link_m: float = 0.0) -> CellIndex:
    """Return the cells that points cover: large enough for four points in each, and no smaller than a link."""
    cell_m = FIRST_CELL_M
    cells = index_cells(x, y, cell_m)
    while (cells.order.size < LEAST_A_CELL * cells.keys.size or cell_m < link_m) and cell_m < LARGEST_CELL_M:
        cell_m *= 1.5
        cells = index_cells(x, y, cell_m)
    return cells


def _spacing(cells: CellIndex) -> float:
    """Return the mean spacing of the points in the covered cells, metres."""
    return cells.cell_m * math.sqrt(cells.keys.size / cells.order.size)


def _typical_spacing(cells: CellIndex) -> float:
    """Return the median of the spacing over the covered cells, each as dense as its block."""
    row, col = np.divmod(cells.keys, cells.shape[1])
    columns = cells.shape[1] // BLOCK_CELLS + 1
    _, block, covered = np.unique(
        row // BLOCK_CELLS * columns + col // BLOCK_CELLS, return_inverse=True, return_counts=True
    )
    points = np.bincount(block, np.diff(cells.starts))
    return float(np.median(cells.cell_m * np.sqrt(covered / points)[block]))


def _areas(cells: CellIndex) -> NDArray[np.float64]:
    """Share the area of each cell among its points."""
    points = np.diff(cells.starts)
    return look_up(cells.cell_m**2 / points, cell_of_each(cells))


def lone_points(
    x: NDArray[np.float64], y: NDArray[np.float64], z: NDArray[np.float64], facts: PointFacts | None = None
) -> NDArray[np.bool_]:
    """Return (N,) bool, which points are lone by their height or by their position: birds, planes, faults of a file.

    Where facts are known, the heights of the whole survey decide.
    """
    lone = lone_values(z, LONE_GAP_Z_M) if facts is None else _beyond(z, facts)
    lone |= lone_values(x, LONE_GAP_XY_M) | lone_values(y, LONE_GAP_XY_M)
    return lone


def levels_of(z: NDArray[np.float64]) -> tuple[tuple[float, float], ...]:
    """Return the lowest and highest value of each group of elevations, between which are wide gaps, metres."""
    if not len(z):
        return ()
    low, high = float(z.min()), float(z.max())
    if high - low <= LONE_GAP_Z_M:
        return ((low, high),)
    ordered = np.sort(z)
    starts = np.flatnonzero(np.diff(ordered) > LONE_GAP_Z_M) + 1
    edges = [0, *starts.tolist(), len(z)]
    return tuple((float(ordered[start]), float(ordered[end - 1])) for start, end in pairwise(edges))


def _beyond(z: NDArray[np.float64], facts: PointFacts) -> NDArray[np.bool_]:
    """Return which elevations lie a wide gap away from all groups of the survey."""
    near = np.zeros(len(z), dtype=np.bool_)
    for low, high in facts.levels_m:
        near |= (z >= low - LONE_GAP_Z_M) & (z <= high + LONE_GAP_Z_M)
    return ~near


def lone_values(values: NDArray[np.float64], gap: float) -> NDArray[np.bool_]:
    """Return which values are lone: few, and separated from the main body by a wide gap.

    Parameters
    ----------
    values : (N,) ndarray of float64
        Finite.
    gap : float
        Width without any value that separates two groups, in the values' unit.

    Returns
    -------
    (N,) ndarray of bool
        True in every group of at most ``LONE_SHARE`` of the values (or of one value) besides the largest group.
        It depends on the values alone, not on their order.

    Examples
    --------
    >>> lone_values(np.array([12.0, 14.0, 2900.0, 13.0]), 500.0)
    array([False, False,  True, False])
    """
    lone = np.zeros(len(values), dtype=np.bool_)
    if len(values) < 3 or values.max() - values.min() <= gap:
        return lone
    ordered = np.sort(values)
    starts = np.flatnonzero(np.diff(ordered) > gap) + 1
    edges = [0, *starts.tolist(), len(values)]
    largest = max(end - start for start, end in pairwise(edges))
    few = max(1, int(LONE_SHARE * len(values)))
    for start, end in pairwise(edges):
        if end - start <= few and end - start < largest:
            lone |= (values >= ordered[start]) & (values <= ordered[end - 1])
    return lone
