"""Candidate regions of a build: from the points' extractors to the tables that the database takes."""

from dataclasses import dataclass

import geopandas as gpd
import numpy as np
import pandas as pd
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True, eq=False)
class CandidateLayer:
    """The candidate regions of one extractor on the lattice.

    Parameters
    ----------
    method : str
        ``area3d`` or ``adaptive``; the stages of the extractor begin with it, in the ledger and the counts.
    labels : (H, W) ndarray of int32
        0 for none, otherwise row number + 1 in ``regions``.
    regions : GeoDataFrame
        ``tables.CANDIDATE_REGION``, in order of the ids, as the database gives them back.
    rejections : DataFrame
        ``tables.REJECTION`` without geometry.
    counts : dict
        By stage.
    """

    method: str
    labels: NDArray[np.int32]
    regions: gpd.GeoDataFrame
    rejections: pd.DataFrame
    counts: dict[str, dict[str, int]]
