"""Class maps: land-cover classes on a lattice, which classifiers write and detectors read."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from msbdb.errors import GridMismatchError, InputError
from msbdb.grid import GridSpec
from msbdb.tables import CLASS_LABELS

LABELS = CLASS_LABELS
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
        unlabelled = set(range(1, int(self.index.max(initial=0)) + 1)) - set(self.labels)
        unknown = sorted(index for index in unlabelled if (self.index == index).any())
        if wrong or unknown:
            msg = (
                f"Every class needs one of the labels {', '.join(LABELS)}; "
                f"got the labels {wrong} and the unlabelled classes {unknown}."
            )
            raise InputError(msg)
        self.index.flags.writeable = False

    def labelled(self, *labels: str) -> NDArray[np.bool_]:
        """Return the (H, W) mask of the cells whose class has one of the labels."""
        return self.among(index for index, label in self.labels.items() if label in labels)

    def among(self, indices: Iterable[int]) -> NDArray[np.bool_]:
        """Return the (H, W) mask of the cells with one of these indices."""
        found = np.zeros(self.index.shape, dtype=np.bool_)
        for index in indices:
            found |= self.index == index
        return found


def overlay(
    structure: ClassMap, spectral: ClassMap | None, *, operator: Mapping[int, str], green_decides: bool = False
) -> ClassMap:
    """Put the structural cover and the spectral classes into one map.

    The structure separates roofs from vegetation, the colours give the class of a roof. Spectral classes keep their
    numbers 1 to K. A roof by structure keeps its spectral class where that is labelled building, and gets class K + 1
    otherwise. Vegetation by structure gets class K + 2. Where the operator has labelled a spectral class, its roofs
    and vegetation keep that class: the operator's label is above the structure.

    Parameters
    ----------
    structure : ClassMap
        Roofs ('building') and vegetation by texture and echoes; 0 elsewhere.
    spectral : ClassMap, optional
        Spectral classes on the same lattice; K is 0 without.
    operator : mapping of int to str
        Labels by the operator, of any class up to K + 2.
    green_decides : bool
        Let spectral vegetation be vegetation even where there is a roof by structure.

    Returns
    -------
    ClassMap
    """
    count = max(spectral.labels, default=0) if spectral else 0
    roof, crown = count + 1, count + 2
    labels = {**(spectral.labels if spectral else {}), roof: "building", crown: "vegetation", **operator}
    index = np.zeros(structure.spec.shape, dtype=np.uint8)
    is_roof, is_crown = structure.labelled("building"), structure.labelled("vegetation")
    index[is_roof] = roof
    index[is_crown] = crown
    if spectral is not None:
        kept = {k for k, label in labels.items() if k <= count and (label == "building" or k in operator)}
        if green_decides:
            kept |= {k for k, label in labels.items() if k <= count and label == "vegetation"}
        colour = spectral.among(kept)
        labelled = spectral.among(k for k in operator if k <= count)
        index = np.where((is_roof & colour) | ((is_roof | is_crown) & labelled), spectral.index, index)
    return ClassMap(index, labels, structure.spec)
