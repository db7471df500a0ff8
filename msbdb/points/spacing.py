"""How the points of a survey are spread in plan: their spacing, their links, and the area of each."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.cluster.hierarchy import linkage
from scipy.spatial import cKDTree

from msbdb.labels import look_up
from msbdb.points.aside import let_go
from msbdb.points.cellindex import CellIndex, cell_of_each, index_cells
from msbdb.surveyplan import PointFacts

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
    """Return mean and median spacing of the first echoes, and their least link, metres; see `Density`.

    All points count where none is a first echo.
    """
    chosen = first_echo if first_echo.any() else np.ones(len(x), dtype=np.bool_)
    return measure_spacings(x[chosen], y[chosen])[:3]


def measure_spacings(x: NDArray[np.float64], y: NDArray[np.float64]) -> tuple[float, float, float, float]:
    """Return mean and median spacing of points, their least link, and the spacing of the sparser parts, metres.

    All are 1 m where there is no point. `Density`, `least_link` and `sparse_spacing` define them.
    """
    if not len(x):
        return 1.0, 1.0, 1.0, 1.0
    cells = _covered(x, y)
    squares = index_squares(x, y, _spacing(cells))
    link_m = least_link(x, y, squares)
    if cells.cell_m < link_m:
        cells = _covered(x, y, link_m)
        squares = index_squares(x, y, _spacing(cells))
    return _spacing(cells), _typical_spacing(cells), link_m, sparse_spacing(x, y, squares)


def index_squares(x: NDArray[np.float64], y: NDArray[np.float64], spacing_m: float) -> CellIndex:
    """Sort points into the squares in which links and sparser parts are measured; ``spacing_m`` is the mean one."""
    return index_cells(x, y, SQUARE_SPACINGS * spacing_m)


def least_link(x: NDArray[np.float64], y: NDArray[np.float64], squares: CellIndex) -> float:
    """Return the least link by which most points of a place are connected, metres.

    Points that are spread evenly or by chance need 1 to 1.4 mean spacings. Those on scan lines need the distance of the
    lines, however dense they are along them.

    Parameters
    ----------
    x, y : (N,) ndarray of float64, metres
        At least one point.
    squares : CellIndex
        What `index_squares` returns for them.

    Returns
    -------
    float
        The mean spacing where no square has points enough.

    Notes
    -----
    The median over at most `SQUARES` squares of the longest edge that the tree of nearest pairs needs to connect half
    of the points. Walls, water and strips of other density change single squares. Squares of less than half or over
    four times the mean number of points are left out. It does not depend on the direction of the lines.

    Examples
    --------
    Points 0.3 m apart on lines that lie 3 m apart, and as many at random places:

    >>> along, line = (place.ravel() for place in np.meshgrid(np.arange(0, 60, 0.3), np.arange(0, 60, 3.0)))
    >>> least_link(along, line, index_squares(along, line, 0.95))
    3.0
    >>> x, y = np.random.default_rng(0).uniform(0, 60, (2, 4000))
    >>> round(least_link(x, y, index_squares(x, y, 0.95)), 1)
    1.1
    """
    count = np.diff(squares.starts)
    full = np.flatnonzero((count >= SQUARE_SPACINGS**2 / 2) & (count <= 4 * SQUARE_SPACINGS**2))
    if not len(full):
        return squares.cell_m / SQUARE_SPACINGS
    links_m = []
    for square in full[:: math.ceil(len(full) / SQUARES)]:
        points = squares.order[squares.starts[square] : squares.starts[square + 1]]
        tree = linkage(np.column_stack((x[points], y[points])), "single")
        links_m.append(tree[np.argmax(2 * tree[:, 3] >= len(points)), 2])
    return float(np.median(links_m))


def sparse_spacing(x: NDArray[np.float64], y: NDArray[np.float64], squares: CellIndex) -> float:
    """Return the spacing of the sparser parts of a place, metres: four fifths of the ground are denser.

    Parameters
    ----------
    x, y : (N,) ndarray of float64, metres
        First echoes.
    squares : CellIndex
        What `index_squares` returns for them.

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
    >>> round(sparse_spacing(x, y, index_squares(x, y, 0.63)), 1)
    1.1
    """
    full = np.flatnonzero(np.diff(squares.starts) >= 2 * NEIGHBOURS)
    if not len(full):
        return squares.cell_m / SQUARE_SPACINGS
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
