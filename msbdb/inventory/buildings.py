"""Buildings from parts: one building a tree, with a summary of its parts and heights (V30, V49)."""

from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from msbdb.errors import TableError
from msbdb.grid import Grid
from msbdb.labels import height_statistics, order_heights, reorder, sizes, sums
from msbdb.tables import BUILDING, CONFIRMING_CLASS_SHARE, EXTRACTOR_SHARES

if TYPE_CHECKING:
    import geopandas as gpd


def buildings_from_parts(parts: "gpd.GeoDataFrame", root_labels: NDArray[np.int32], ndsm: Grid) -> "gpd.GeoDataFrame":
    """Return one building for each root of the forest of parts.

    Parameters
    ----------
    parts : GeoDataFrame
        ``tables.PART`` with geometry.
    root_labels : (H, W) ndarray of int32
        Row number + 1 in ``parts`` of the root that covers a cell; 0 for none (``Forest.root_labels``).
    ndsm : Grid
        Heights above ground on the labels' lattice, metres.

    Returns
    -------
    GeoDataFrame
        ``tables.BUILDING``, in order of the parts' table, with the root's polygon as footprint (V49) and the parts'
        CRS.

    Raises
    ------
    TableError
        When the labels do not show just the roots of the parts.

    Notes
    -----
    - ``building_id`` is the root's ID: the building is known by its place. An inventory that is updated may carry an
      older id on; ``root_id`` then still names the root.
    - ``state`` tells how far two witnesses agree. The heights found every building; it is 'confirmed' when at least
      half of its root's cells have a building class, and 'unsure' when fewer have, or nothing is known of classes.
      'refuted' takes a reference or an operator, so none is here.
    - ``storeys`` are those of the tallest part; heights are of all valid cells in the footprint. The volume is
      exact for a surface above flat ground: the sum of height times cell area, in which heights below 0 count as 0.
    - The shares that other extractors cover are null, as nothing is known of them here; `evidence.witnessed` adds
      their word.
    """
    is_root = (parts["supid"] == 0).to_numpy()
    root_rows = np.flatnonzero(is_root)
    _require_roots(root_labels, is_root)
    footprints = reorder(root_labels, root_rows, len(parts))
    heights = height_statistics(footprints, slice(0, len(root_rows)), order_heights(ndsm, footprints > 0))
    roots = parts.iloc[root_rows].reset_index(drop=True)
    trees = parts.groupby("root_id")
    summary = pd.DataFrame(
        {
            "storeys": trees["hindex"].max(),
            "parts": trees.size(),
            "scales": trees["scale"].nunique(),
        }
    ).reindex(roots["part_id"])
    frame = roots.assign(
        building_id=roots["part_id"],
        root_id=roots["part_id"],
        state=np.where(roots["building_share"] >= CONFIRMING_CLASS_SHARE, "confirmed", "unsure"),
        volume_m3=_volume(footprints, len(root_rows), ndsm),
        **dict.fromkeys(EXTRACTOR_SHARES.values(), np.nan),
        **{name: heights[name] for name in ("h_max", "h_mean", "h_p50", "h_p90")},
        **{name: summary[name].to_numpy() for name in summary.columns},
    )
    return BUILDING.typed(frame)


def _volume(footprints: NDArray[np.int32], count: int, ndsm: Grid) -> NDArray[np.float64]:
    """Return height times area, summed over the valid cells of each footprint, cubic metres."""
    cells = np.flatnonzero((footprints > 0) & ndsm.valid)
    heights = np.maximum(np.asarray(ndsm.values).ravel()[cells].astype(np.float64), 0)
    return sums(footprints.ravel()[cells], heights, count) * ndsm.spec.cell_area_m2


def _require_roots(root_labels: NDArray[np.int32], is_root: NDArray[np.bool_]) -> None:
    """Refuse labels that do not show just the roots of the parts."""
    shown = sizes(root_labels, len(is_root)) > 0
    if shown.size != is_root.size or (shown != is_root).any():
        msg = (
            f"The labels must show the {np.count_nonzero(is_root)} roots of the {len(is_root)} parts and nothing "
            f"else; they show {np.count_nonzero(shown)} regions. Take both from one extraction."
        )
        raise TableError(msg)
