"""Kernels over label images: the value of each cell's label, and the sums of each label's cells, in one pass.

Indexing and counting by numpy turn the labels into 64 bits first, which takes several times as long.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from msbdb.threads import kernel


@kernel
def looked_up(table: NDArray[Any], labels: NDArray[np.int32]) -> NDArray[Any]:
    """Return (N,) the value in the table of each of (N,) labels."""
    found = np.empty(labels.size, dtype=table.dtype)
    for place in range(labels.size):
        found[place] = table[labels[place]]
    return found


@kernel
def counted(labels: NDArray[np.int32], count: int) -> NDArray[np.int64]:
    """Return (count + 1,) how often each label from 0 on occurs among (N,) labels."""
    found = np.zeros(count + 1, dtype=np.int64)
    for label in labels:
        found[label] += 1
    return found


@kernel
def added(labels: NDArray[np.int32], values: NDArray[Any], count: int) -> NDArray[np.float64]:
    """Return (count + 1,) the sums of (N,) values by label from 0 on, added in their order in 64 bits."""
    found = np.zeros(count + 1, dtype=np.float64)
    for place in range(labels.size):
        if labels[place] != 0:
            found[labels[place]] += values[place]
    return found
