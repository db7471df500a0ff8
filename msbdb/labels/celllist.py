"""A list of cells of a lattice: work on images that are 0 in all other cells passes these over."""

from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from msbdb.labels.numbering import Labels, as_compiled, require_connectivity
from msbdb.labels.statistics import measure_runs

T = TypeVar("T", bound=np.generic)


@dataclass(frozen=True, slots=True, eq=False)
class CellList:
    """A list of cells of a lattice. Most cells of a survey belong to no building, and need no work.

    Parameters
    ----------
    numbers : (K,) ndarray of int
        Flat indices, ascending.
    shape : (int, int)
        Rows and columns of the lattice.

    Examples
    --------
    >>> image = np.array([[5, 0, 0], [0, 5, 7]])
    >>> cells = CellList.covering(image > 0)
    >>> cells.of(image)
    array([5, 5, 7])
    >>> cells.zones(cells.of(image), connectivity=8)
    (array([1, 1, 2], dtype=int32), 2)
    >>> cells.image(np.array([1, 0, 2]))
    array([[1, 0, 0],
           [0, 0, 2]])
    """

    numbers: NDArray[np.intp]
    shape: tuple[int, int]

    @classmethod
    def covering(cls, covered: NDArray[np.bool_]) -> "CellList":
        """List the cells of an (H, W) mask."""
        rows, cols = covered.shape
        return cls(np.flatnonzero(covered), (rows, cols))

    def of(self, image: NDArray[T]) -> NDArray[T]:
        """Return the (K,) values of an (H, W) image."""
        return image.ravel()[self.numbers]

    def image(self, values: NDArray[T]) -> NDArray[T]:
        """Return the (H, W) image of (K,) values, 0 elsewhere."""
        image = np.zeros(self.shape, dtype=values.dtype)
        image.ravel()[self.numbers] = values
        return image

    def places(self, numbers: NDArray[np.integer]) -> NDArray[np.intp]:
        """Return the places in the list, (N,), of flat indices that are all in it."""
        return np.searchsorted(self.numbers, numbers)

    def zones(self, values: NDArray[Any], *, connectivity: int = 8) -> tuple[Labels, int]:
        """Label the flat zones of (K,) values as `msbdb.labels.label_zones` does those of the image.

        Returns
        -------
        labels : (K,) ndarray of int32
            0 where the value is 0, otherwise 1 to ``count`` in row-major order of the zones' first cells.
        count : int
            Number of zones.
        """
        from msbdb.labels.cellkernels import label_listed

        require_connectivity(connectivity)
        labels, count = label_listed(as_compiled(values), self.numbers, self.shape[1], connectivity == 8)
        return labels, int(count)

    def measure(self, labels: Labels, count: int) -> pd.DataFrame:
        """Measure (K,) labelled regions as `msbdb.labels.measure` does those of the image."""
        change = np.ones(labels.size, dtype=np.bool_)
        begins_row = self.numbers[1:] % self.shape[1] == 0
        change[1:] = (labels[1:] != labels[:-1]) | (np.diff(self.numbers) != 1) | begins_row
        start = np.flatnonzero(change)
        length = np.diff(start, append=labels.size)
        inside = labels[start] > 0
        label, first = labels[start][inside].astype(np.int64) - 1, self.numbers[start][inside]
        return measure_runs(label, first, length[inside], width=self.shape[1], count=count)
