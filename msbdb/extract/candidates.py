"""What the two extractors on points give: candidate regions, as labels of the points and as rows."""

from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True, eq=False)
class Candidates:
    """The candidate regions of one extractor.

    Parameters
    ----------
    method : str
        ``area3d`` or ``adaptive``.
    labels : (N,) ndarray of int32
        For each point of the cloud, in the cloud's order: 0 for none, otherwise row number + 1 in ``regions``.
    regions : DataFrame
        ``tables.CANDIDATE_REGION`` without geometry, in order of the ids. Regions share no point.
    rejections : DataFrame
        ``tables.REJECTION`` without geometry: a row for each region that a stage dropped.
    counts : dict
        By stage: regions ``in`` (with the ``pieces`` that the stage cut
        itself, less those it joined), ``kept`` and ``dropped``.
    """

    method: str
    labels: NDArray[np.int32]
    regions: pd.DataFrame
    rejections: pd.DataFrame
    counts: dict[str, dict[str, int]]
