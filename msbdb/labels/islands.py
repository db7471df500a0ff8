"""Islands of an image, gathered on a sheet that has little room between them: most of a survey is no building."""

import math
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from msbdb.labels.numbering import Labels, boxes, label_zones

T = TypeVar("T", bound=np.generic)

Ints = NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class Islands:
    """Islands of a lattice, and where each of them lies on a sheet.

    An island are 8-connected cells together with all that they enclose. So cells of two islands never touch, and what
    lies in a court is of the island around it.

    Parameters
    ----------
    zones : (H, W) ndarray of int32
        The island of each cell, 1 to N; 0 outside of all.
    first : (N, 2) ndarray of int64
        First row and column of each island on the lattice.
    extent : (N, 2) ndarray of int64
        Its rows and columns.
    place : (N, 2) ndarray of int64
        Its first row and column on the sheet.
    sheet : (int, int)
        Rows and columns of the sheet. An empty row and column lie around each island.
    """

    zones: Labels
    first: Ints
    extent: Ints
    place: Ints
    sheet: tuple[int, int]

    def gather(self, image: NDArray[T]) -> NDArray[T]:
        """Return the (H, W) image of the lattice on the sheet, 0 between the islands."""
        from msbdb.labels.cellkernels import gathered

        found = np.zeros(self.sheet, dtype=image.dtype)
        gathered(np.ascontiguousarray(image), self.zones, (self.first, self.extent, self.place), found)
        return found

    def corners_on_lattice(self, corners: Ints) -> Ints:
        """Return where corners of islands' cells, (N, 2) of column and row on the sheet, lie on the lattice."""
        owner = np.zeros((self.sheet[0] + 1, self.sheet[1] + 1), dtype=np.int32)
        moved = self.first - self.place
        for number, (place, extent) in enumerate(zip(self.place.tolist(), self.extent.tolist(), strict=True)):
            owner[place[0] : place[0] + extent[0] + 1, place[1] : place[1] + extent[1] + 1] = number
        own = owner[corners[:, 1], corners[:, 0]]
        return np.asarray(corners + moved[own, ::-1])


def islands_of(covered: NDArray[np.bool_]) -> Islands:
    """Find the islands of covered cells, and lay them out in rows on a sheet, the tallest first.

    Parameters
    ----------
    covered : (H, W) ndarray of bool

    Notes
    -----
    Border: what reaches the border of the lattice is not enclosed.

    Examples
    --------
    >>> image = np.array([[1, 0, 0, 0, 0, 2], [0, 0, 0, 0, 0, 0], [0, 0, 0, 0, 0, 0], [3, 3, 0, 0, 0, 0]])
    >>> islands_of(image > 0).gather(image)
    array([[0, 0, 0, 0, 0],
           [0, 1, 0, 2, 0],
           [0, 0, 0, 0, 0],
           [0, 3, 3, 0, 0],
           [0, 0, 0, 0, 0]])
    """
    zones, count = label_zones(~_outside(covered))
    found = list(boxes(zones).values())
    first = np.array([[side.start for side in box] for box in found], dtype=np.int64).reshape(-1, 2)
    extent = np.array([[side.stop - side.start for side in box] for box in found], dtype=np.int64).reshape(-1, 2)
    room = extent + 1
    width = max(int(room[:, 1].max(initial=0)), math.isqrt(int(room.prod(axis=1).sum())) + 1) + 1
    place = np.zeros((count, 2), dtype=np.int64)
    row, col, below = 1, 1, 1
    for number in np.argsort(-extent[:, 0], kind="stable").tolist():
        rows, cols = room[number].tolist()
        if col + cols > width:
            row, col = below, 1
        place[number] = row, col
        col, below = col + cols, max(below, row + rows)
    return Islands(zones, first, extent, place, (below, width))


def _outside(covered: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the empty cells from which the border of the lattice is reached over edges of empty cells."""
    empty, count = label_zones(~covered, connectivity=4)
    reached = np.zeros(count + 1, dtype=np.bool_)
    for border in (empty[0], empty[-1], empty[:, 0], empty[:, -1]):
        reached[border] = True
    reached[0] = False
    return reached[empty]
