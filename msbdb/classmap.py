"""A map of land-cover classes on a lattice: what the classifiers write and the extractors read."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from msbdb.errors import GridMismatchError, InputError
from msbdb.grid import GridSpec

LABELS = ("building", "vegetation", "shadow", "water", "other")
"""The information classes (V36)."""


@dataclass(frozen=True, slots=True, eq=False)
class ClassMap:
    """Spectral (or structural) indices of the cells, and the information class of each index.

    Parameters
    ----------
    index : (H, W) ndarray of uint8
        Class of a cell, 1 to K; 0 where the cell was not classified.
    labels : mapping of int to str
        Information class of every index that occurs, one of ``LABELS``.
    spec : GridSpec
        The lattice.
    """

    index: NDArray[np.uint8]
    labels: Mapping[int, str]
    spec: GridSpec

    def __post_init__(self) -> None:
        """Check shape and labels, and freeze the indices."""
        if self.index.shape != self.spec.shape:
            msg = f"The class map has the shape {self.index.shape}; the lattice has {self.spec.shape}."
            raise GridMismatchError(msg)
        wrong = sorted(set(self.labels.values()) - set(LABELS))
        unknown = sorted(set(np.unique(self.index).tolist()) - {0} - set(self.labels))
        if wrong or unknown:
            msg = (
                f"Every class needs one of the labels {', '.join(LABELS)}; "
                f"got the labels {wrong} and the unlabelled classes {unknown}."
            )
            raise InputError(msg)
        self.index.flags.writeable = False

    def labelled(self, *labels: str) -> NDArray[np.bool_]:
        """Return the (H, W) mask of the cells whose class has one of the labels."""
        wanted = np.zeros(256, dtype=np.bool_)
        for index, label in self.labels.items():
            wanted[index] = label in labels
        return wanted[self.index]
