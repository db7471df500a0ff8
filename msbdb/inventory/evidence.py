"""Evidence for parts and buildings: the flat regions that confirm them, counted in cells they share."""

from collections.abc import Sequence

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from msbdb.errors import GridMismatchError, TableError
from msbdb.tables import PART_FLAT_REGION

Labels = NDArray[np.int32]
Ids = NDArray[np.int64]

CONFIRMING_FLAT_SHARE = 0.1
"""Share of a footprint from which flat regions confirm it.

Ours: on the real tiles shares lie near 1 or at 0, so that 0.1 and 0.3 confirm nearly the same buildings. Roofs below
40 m2, too small for a flat region (R times λ_min), have none.
"""


def link_parts(
    part_labels: Sequence[Labels], part_ids: Ids, region_labels: Labels, region_ids: Ids, *, cell_area_m2: float
) -> pd.DataFrame:
    """Link each part to the flat regions that it shares cells with.

    Parameters
    ----------
    part_labels : sequence of (H, W) ndarray of int32
        One image a scale: 0 for none, otherwise index + 1 in ``part_ids`` (``Forest.labels``).
    part_ids : (N,) ndarray of int64
        Ids of the parts of all scales.
    region_labels : (H, W) ndarray of int32
        0 for none, otherwise index + 1 in ``region_ids`` (``FlatRegions.labels``).
    region_ids : (M,) ndarray of int64
        Ids of the flat regions.
    cell_area_m2 : float
        Area of a cell.

    Returns
    -------
    DataFrame
        ``tables.PART_FLAT_REGION``, in order of the parts, and of the regions within a part.

    Raises
    ------
    GridMismatchError
        When the images differ in shape.
    TableError
        When a label has no id.

    Notes
    -----
    Parts of one scale are disjoint, and so are regions: a part's shares add up to its flat share, and so do a
    region's over the parts of one scale. Linear in the cells for each scale.
    """
    _require_ids(region_labels, region_ids, "flat region")
    tables = [_overlaps(labels, part_ids, region_labels, len(region_ids)) for labels in part_labels]
    found = pd.concat(tables, ignore_index=True) if tables else _overlaps(None, part_ids, region_labels, 0)
    found = found.sort_values(["part", "region"], ignore_index=True)
    region_cells = np.bincount(region_labels.ravel(), minlength=len(region_ids) + 1)[1:]
    part, region, cells = (found[name].to_numpy() for name in ("part", "region", "cells"))
    frame = pd.DataFrame(
        {
            "part_id": part_ids[part],
            "region_id": region_ids[region],
            "overlap_m2": cells * cell_area_m2,
            "part_share": cells / found["part_cells"].to_numpy(),
            "region_share": cells / region_cells[region],
        }
    )
    return frame.astype({column.name: column.dtype for column in PART_FLAT_REGION.columns})


def flat_shares(part_ids: Ids, links: pd.DataFrame) -> NDArray[np.float64]:
    """Return the share of each part's area that flat regions cover, from 0 to 1.

    A building's is that of its root, whose cells are the building's footprint.

    Parameters
    ----------
    part_ids : (N,) ndarray of int64
        Ids of the parts, or of the roots.
    links : DataFrame
        ``tables.PART_FLAT_REGION``.
    """
    shares = links.groupby("part_id")["part_share"].sum().reindex(part_ids, fill_value=0.0)
    # Shares of disjoint regions may exceed 1 by the rounding of their sum.
    return np.asarray(np.minimum(shares.to_numpy(dtype=np.float64), 1.0))


def _overlaps(part_labels: Labels | None, part_ids: Ids, region_labels: Labels, regions: int) -> pd.DataFrame:
    """Count the cells that parts of one scale and regions share: rows ``part, region, cells, part_cells``."""
    if part_labels is None:
        return pd.DataFrame({name: np.zeros(0, dtype=np.int64) for name in ("part", "region", "cells", "part_cells")})
    if part_labels.shape != region_labels.shape:
        msg = (
            f"Parts and flat regions must lie on one lattice; their labels have the shapes {part_labels.shape} and "
            f"{region_labels.shape}. Take both from one build."
        )
        raise GridMismatchError(msg)
    _require_ids(part_labels, part_ids, "part")
    both = (part_labels > 0) & (region_labels > 0)
    pairs = (part_labels[both].astype(np.int64) - 1) * regions + (region_labels[both] - 1)
    keys, cells = np.unique(pairs, return_counts=True)
    part, region = np.divmod(keys, max(regions, 1))
    part_cells = np.bincount(part_labels.ravel(), minlength=len(part_ids) + 1)[1:]
    return pd.DataFrame({"part": part, "region": region, "cells": cells, "part_cells": part_cells[part]})


def _require_ids(labels: Labels, ids: Ids, what: str) -> None:
    """Refuse labels beyond the ids."""
    highest = int(labels.max(initial=0))
    if highest > len(ids):
        msg = f"The label {highest} has no {what}: there are {len(ids)} ids. Take labels and ids from one extraction."
        raise TableError(msg)


def witnessed(buildings: pd.DataFrame, shares: NDArray[np.float64]) -> pd.DataFrame:
    """Return buildings with the flat regions' word: their flat shares, and the state that follows.

    A building that the classes confirm stays confirmed when flat regions cover at least ``CONFIRMING_FLAT_SHARE`` of
    it, and becomes unsure when they cover less: one witness speaks for it, and another does not.

    Parameters
    ----------
    buildings : DataFrame
        ``tables.BUILDING``.
    shares : (N,) ndarray of float64
        Share of each footprint that flat regions cover.
    """
    confirmed = (buildings["state"] == "confirmed") & (shares >= CONFIRMING_FLAT_SHARE)
    return buildings.assign(flat_share=shares, state=np.where(confirmed, "confirmed", "unsure"))
