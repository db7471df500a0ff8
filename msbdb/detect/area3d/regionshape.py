"""The shape of regions of points, measured at their edge points, and the rules that accept a shape (Cao & Wu).

Edge points come from the 8-directional neighbourhood (definitions 6 and 7), the rules from Eq. 8 and 9.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import shapely
from numpy.typing import NDArray

from msbdb.detect.area3d.edgelines import main_directions, measure_lines
from msbdb.detect.pointregions import strings_of_points
from msbdb.labels import sizes, sums
from msbdb.params import Area3dParams
from msbdb.points.cellindex import CellIndex, cell_place, index_cells, parts_of, strip
from msbdb.threads import in_threads, kernel

ALL_SECTORS = 255
"""A bit for each of the eight sectors."""

WIDER = 1 + 1e-6
"""Cells are this much wider than the reach, so that rounding puts no neighbour beyond the next cell."""


@dataclass(frozen=True, slots=True, eq=False)
class Shapes:
    """Shape of M regions, float64 unless said otherwise, in the labels' order.

    Parameters
    ----------
    points, perimeter : (M,) ndarray of int64
        Number of points, and of edge points (C3, C10).
    area_m2, mbr_m2 : (M,) ndarray
        Area of the points and of their minimum bounding rectangle.
    rectangularity, compactness, linearity : (M,) ndarray
        C17, C12.
    directions : (M, 2) ndarray
        Main directions, degrees from east, 0 to 180; NaN without one.
    """

    points: NDArray[np.int64]
    perimeter: NDArray[np.int64]
    area_m2: NDArray[np.float64]
    mbr_m2: NDArray[np.float64]
    rectangularity: NDArray[np.float64]
    compactness: NDArray[np.float64]
    linearity: NDArray[np.float64]
    directions: NDArray[np.float64]

    def columns(self) -> dict[str, NDArray[np.generic]]:
        """Return the columns of ``tables.CANDIDATE_REGION`` that describe the shape."""
        return {
            "perimeter": self.perimeter,
            "mbr_m2": self.mbr_m2,
            "rectangularity": self.rectangularity,
            "compactness": self.compactness,
            "linearity": self.linearity,
            "direction_1": self.directions[:, 0],
            "direction_2": self.directions[:, 1],
        }


def measure_shapes(
    x: NDArray[np.float64],
    y: NDArray[np.float64],
    labels: NDArray[np.int32],
    count: int,
    *,
    area_m2: NDArray[np.float64],
    spacing_m: float,
    params: Area3dParams,
) -> Shapes:
    """Measure the shape of labelled regions (C10 to C12, C17).

    Parameters
    ----------
    x, y : (N,) ndarray of float64, metres
        From an origin nearby.
    labels : (N,) ndarray of int32
        1 to ``count`` without a gap; 0 for none.
    area_m2 : (N,) ndarray of float64
        Area of each point.
    spacing_m : float
        Mean point spacing.

    Notes
    -----
    Rectangularity is the area in m2 over that of the minimum bounding rectangle. The rectangle's sides are at least a
    spacing, so that points in a row have one. Compactness is the number of points over the number of edge points. The
    points grow with the density d and the edge points with its root, so the ratio of one roof grows with sqrt(d). With
    a ``compactness_density`` D it is multiplied by sqrt(D / d), and T_comp means the same at any density (C17).
    """
    edge = find_edges(x, y, labels, radius_m=params.sector_spacings * spacing_m, gap_m=params.gap_spacings * spacing_m)
    at = np.flatnonzero(edge)
    member = labels[at] - np.int32(1)
    points = sizes(labels, count)
    perimeter = np.bincount(member, minlength=count)
    area = sums(labels, area_m2, count)
    mbr = bounding_rectangles(x[at], y[at], member, least_m=spacing_m)
    scale = np.sqrt(params.compactness_density) * spacing_m if params.compactness_density > 0 else 1.0
    linearity, direction = measure_lines(
        x[at],
        y[at],
        member,
        most=params.line_most,
        least=params.line_least,
        tolerance_m=params.line_error_spacings * spacing_m,
    )
    return Shapes(
        points=points,
        perimeter=perimeter.astype(np.int64),
        area_m2=area,
        mbr_m2=mbr,
        rectangularity=area / mbr,
        compactness=points / np.maximum(perimeter, 1) * scale,
        linearity=np.bincount(member, linearity, count) / np.maximum(perimeter, 1),
        directions=main_directions(direction, member, count),
    )


def judge(shapes: Shapes, params: Area3dParams) -> NDArray[np.int8]:
    """Return (M,) the rule that accepts each region, 1 or 2; 0 for none (Eq. 8 and 9; C18).

    Notes
    -----
    Rule 1: rectangularity ≥ T_rect^1 and compactness ≥ T_comp. Rule 2, asked where rule 1 does not hold:
    rectangularity ≥ T_rect^2 and compactness ≥ T_comp, and either the linearity ≥ T_line or the main directions are
    perpendicular.
    """
    compact = shapes.compactness >= params.compactness
    first = (shapes.rectangularity >= params.rectangularity_1) & compact
    straight = shapes.linearity >= params.linearity
    straight |= perpendicular(shapes.directions, params.perpendicular_deg)
    second = (shapes.rectangularity >= params.rectangularity_2) & compact & straight
    return np.where(first, 1, np.where(second, 2, 0)).astype(np.int8)


def reasons_against(shapes: Shapes, rule: NDArray[np.int8], params: Area3dParams) -> NDArray[np.object_]:
    """Return (M,) why each region is rejected, the first condition of rule 2 that fails; empty where it is accepted."""
    found = np.full(len(rule), "neither straight nor perpendicular", dtype=object)
    found[shapes.rectangularity < params.rectangularity_2] = "not rectangular enough"
    found[shapes.compactness < params.compactness] = "not compact enough"
    found[rule > 0] = ""
    return found


def perpendicular(directions: NDArray[np.float64], tolerance_deg: float) -> NDArray[np.bool_]:
    """Return (M,) whether the two main directions of (M, 2) are at a right angle, within a tolerance; NaN never is."""
    between = np.abs(directions[:, 0] - directions[:, 1])
    square: NDArray[np.bool_] = np.abs(np.minimum(between, 180 - between) - 90) <= tolerance_deg
    return square


def bounding_rectangles(
    x: NDArray[np.float64], y: NDArray[np.float64], member: NDArray[np.int32], *, least_m: float
) -> NDArray[np.float64]:
    """Return (M,) the areas of the minimum bounding rectangles of groups of points, m2.

    Groups are 0 to M - 1, each with a point; sides shorter than ``least_m`` count as that.
    """
    rectangle = shapely.minimum_rotated_rectangle(strings_of_points(x, y, member))
    half_perimeter, area = shapely.length(rectangle) / 2, shapely.area(rectangle)
    # A rectangle of no width comes back as a line, whose length is one side and not two.
    half_perimeter = np.where(shapely.get_dimensions(rectangle) < 2, shapely.length(rectangle), half_perimeter)
    root = np.sqrt(np.maximum(half_perimeter**2 / 4 - area, 0))
    found: NDArray[np.float64] = np.maximum(half_perimeter / 2 + root, least_m) * np.maximum(
        half_perimeter / 2 - root, least_m
    )
    return found


def find_edges(
    x: NDArray[np.float64],
    y: NDArray[np.float64],
    labels: NDArray[np.int32],
    *,
    radius_m: float,
    gap_m: float,
) -> NDArray[np.bool_]:
    """Return which points are edge points of their region (C8, C9).

    Parameters
    ----------
    x, y : (N,) ndarray of float64, metres
        Places of the points; heights do not count.
    labels : (N,) ndarray of int32
        Regions; 0 for none.
    radius_m : float
        R, radius of the eight sectors of 45 degrees around a point, the first of them north of east.
    gap_m : float
        E_s.

    Returns
    -------
    (N,) ndarray of bool
        True for edge points; False for inner points and for points of no region.

    Notes
    -----
    An edge point has (1) a sector without any point of its region, or (2) a sector whose nearest such point is farther
    than E_s. Points at the very same place lie in no sector.

    A sector holds its first side, counter-clockwise, and not its second. Both conditions together ask for a point in
    each sector no farther than the smaller of R and E_s. O(n) at a bounded density.

    Examples
    --------
    Of a roof of 4 by 4 points the inner four are no edge points:

    >>> y, x = np.mgrid[:4, :4].reshape(2, -1).astype(float)
    >>> find_edges(x, y, np.ones(16, dtype=np.int32), radius_m=2.0, gap_m=2.0).reshape(4, 4).astype(int)
    array([[1, 1, 1, 1],
           [1, 0, 0, 1],
           [1, 0, 0, 1],
           [1, 1, 1, 1]])
    """
    reach = min(radius_m, gap_m)
    edge = np.zeros(len(x), dtype=np.bool_)
    inside = np.flatnonzero(labels > 0)
    x, y = x[inside], y[inside]
    index = index_cells(x, y, reach * WIDER)
    points = Members(index, x[index.order], y[index.order], labels[inside][index.order], reach**2)
    found = np.empty(inside.size, dtype=np.bool_)
    in_threads(lambda part: _open_sector(points, part, found), parts_of(index))
    edge[inside[index.order]] = found
    return edge


class Members(NamedTuple):
    """Points of regions in the order of their cells, and the square of their reach; for kernels."""

    cells: CellIndex
    x: NDArray[np.float64]
    y: NDArray[np.float64]
    labels: NDArray[np.int32]
    reach_squared: float


@kernel
def _open_sector(points: Members, part: tuple[int, int], found: NDArray[np.bool_]) -> None:
    """Write which points of a range of cells have a sector without a point of their region within reach."""
    # Cells are a little wider than the reach, so all points within it lie in the 3 by 3 cells around. Each part
    # writes only the points of its own cells, so threads share nothing.
    index, x, y, labels, reach_squared = points
    for cell in range(part[0], part[1]):
        row, col = cell_place(index, cell)
        # The point's own row first: there its sectors are filled soonest.
        near = (
            strip(index, row, col - 1, col + 1),
            strip(index, row + 1, col - 1, col + 1),
            strip(index, row - 1, col - 1, col + 1),
        )
        for point in range(index.starts[cell], index.starts[cell + 1]):
            # One bit for each sector with a point of the region within reach; a point is inner once all are set.
            seen = 0
            for first, stop in near:
                for other in range(first, stop):
                    east, north = x[other] - x[point], y[other] - y[point]
                    squared = east * east + north * north
                    if squared == 0 or squared > reach_squared or labels[other] != labels[point]:
                        continue
                    seen |= 1 << _sector(east, north)
                    if seen == ALL_SECTORS:
                        break
                if seen == ALL_SECTORS:
                    break
            found[point] = seen != ALL_SECTORS


@kernel
def _sector(east: float, north: float) -> int:
    """Return the sector of 45 degrees that holds a direction, counted from east over north."""
    sector = 0
    if north < 0 or (north == 0 and east < 0):  # turned by half a circle into the upper half
        east, north, sector = -east, -north, 4
    if east <= 0:  # turned back by a quarter into the first one
        east, north, sector = north, -east, sector + 2
    return sector + 1 if north >= east else sector
