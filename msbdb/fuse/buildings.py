"""Buildings from the roots of the forest, and the regions of other detectors that support them (V30, V49)."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from msbdb.errors import GridMismatchError, TableError
from msbdb.grid import Grid
from msbdb.labels import Labels, height_statistics, order_heights, reorder, shared_cells, sizes, sums
from msbdb.tables import BUILDING, CONFIRMING_CLASS_SHARE, CONFIRMING_COVER, EXTRACTOR_SHARES, Table

if TYPE_CHECKING:
    import geopandas as gpd

Ids = NDArray[np.int64]


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
        When the labels do not show exactly the roots of the parts.

    Notes
    -----
    - ``building_id`` is the root's ID: the building is known by its place. An inventory that is updated may carry an
      older id on; ``root_id`` then still names the root.
    - ``state`` says how far heights and classes agree. The heights found every building. It is 'confirmed' when at
      least half of its root's cells have a building class, and 'unsure' when fewer have, or there are no classes.
      Only a reference or an operator makes a building 'refuted', so none is here.
    - ``storeys`` are those of the tallest part; heights are of all valid cells in the footprint. The volume is
      exact for a surface above flat ground: the sum of height times cell area, in which heights below 0 count as 0.
    - The shares that other detectors cover are null here; `with_support` adds them.
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
    """Refuse labels that do not show exactly the roots of the parts."""
    shown = sizes(root_labels, len(is_root)) > 0
    if shown.size != is_root.size or (shown != is_root).any():
        msg = (
            f"The labels must show the {np.count_nonzero(is_root)} roots of the {len(is_root)} parts and nothing "
            f"else; they show {np.count_nonzero(shown)} regions. Take both from one build."
        )
        raise TableError(msg)


def with_support(buildings: pd.DataFrame, shares: Mapping[str, NDArray[np.float64]]) -> pd.DataFrame:
    """Return buildings with the support of the other detectors: the share that each covers, and the state.

    A detector supports a building when it covers at least ``CONFIRMING_COVER`` of the footprint. A building that the
    classes confirm stays confirmed when at least half of the other detectors support it, and is unsure otherwise.
    Without other detectors the classes alone decide.

    Parameters
    ----------
    buildings : DataFrame
        ``tables.BUILDING``.
    shares : mapping of str to (N,) ndarray of float64
        By detector (``tables.EXTRACTOR_SHARES``), only those that were run: the share of each footprint that its
        regions cover.

    Examples
    --------
    The second building has no support:

    >>> buildings = pd.DataFrame({"state": ["confirmed", "confirmed", "unsure"]})
    >>> with_support(buildings, {"flatregions": np.array([0.9, 0.0, 1.0])})["state"].tolist()
    ['confirmed', 'unsure', 'unsure']
    """
    supports = np.zeros(len(buildings), dtype=np.int64)
    for covered in shares.values():
        supports += covered >= CONFIRMING_COVER
    confirmed = (buildings["state"] == "confirmed") & (2 * supports >= len(shares))
    columns = {EXTRACTOR_SHARES[name]: covered for name, covered in shares.items()}
    return buildings.assign(**columns, state=np.where(confirmed, "confirmed", "unsure"))


def covered_shares(part_ids: Ids, links: pd.DataFrame) -> NDArray[np.float64]:
    """Return the share of each part's area that the regions of one image cover, from 0 to 1.

    A building's is that of its root, whose cells are the building's footprint.

    Parameters
    ----------
    part_ids : (N,) ndarray of int64
        Ids of the parts, or of the roots.
    links : DataFrame
        ``tables.PART_FLAT_REGION``, or ``tables.PART_CANDIDATE`` of one detector.
    """
    shares = links.groupby("part_id")["part_share"].sum().reindex(part_ids, fill_value=0.0)
    # Shares of disjoint regions may exceed 1 by the rounding of their sum.
    return np.asarray(np.minimum(shares.to_numpy(dtype=np.float64), 1.0))


def link_labels(
    one_labels: Sequence[Labels],
    one_ids: Ids,
    other_labels: Labels,
    other_ids: Ids,
    *,
    table: Table,
    cell_area_m2: float,
) -> pd.DataFrame:
    """Link regions of two kinds that share cells.

    Parameters
    ----------
    one_labels : sequence of (H, W) ndarray of int32
        Images of the one kind, such as one a scale (``Forest.labels``): 0 for none, otherwise index + 1 in
        ``one_ids``.
    one_ids : (N,) ndarray of int64
        Ids of the regions of all these images.
    other_labels : (H, W) ndarray of int32
        0 for none, otherwise index + 1 in ``other_ids``.
    other_ids : (M,) ndarray of int64
        Ids of the regions of the other kind.
    table : Table
        The declaration of the links: the one id, the other id, the shared area, and its shares of both.
    cell_area_m2 : float
        Area of a cell.

    Returns
    -------
    DataFrame
        The declared table, in order of the one kind, and of the other within it.

    Raises
    ------
    GridMismatchError
        When the images differ in shape.
    TableError
        When a label has no id.

    Notes
    -----
    Regions of one image are disjoint: the shares of a region add up to its share that the other image covers. Linear
    in the cells for each image.

    Examples
    --------
    Of the part's four cells, two lie in a flat region of three cells:

    >>> from msbdb.tables import PART_FLAT_REGION
    >>> part, flat = np.array([[1, 1, 1, 1, 0]]), np.array([[0, 0, 1, 1, 1]])
    >>> ids = np.array([101]), np.array([202])
    >>> links = link_labels([part], ids[0], flat, ids[1], table=PART_FLAT_REGION, cell_area_m2=0.25)
    >>> links.round(2).to_numpy().tolist()
    [[101.0, 202.0, 0.5, 0.5, 0.67]]
    """
    one, other, overlap, one_share, other_share = table.names
    _require_ids(other_labels, other_ids, other)
    counted = [_overlaps(labels, one_ids, other_labels, table) for labels in one_labels]
    # A row without cells gives the columns where there is no image.
    found = pd.concat([pd.DataFrame(columns=["one", "other", "cells", "one_cells"], dtype=np.int64), *counted])
    found = found.sort_values(["one", "other"], ignore_index=True)
    other_cells = sizes(other_labels, len(other_ids))
    left, right, cells = (found[name].to_numpy() for name in ("one", "other", "cells"))
    frame = pd.DataFrame(
        {
            one: one_ids[left],
            other: other_ids[right],
            overlap: cells * cell_area_m2,
            one_share: cells / found["one_cells"].to_numpy(),
            other_share: cells / other_cells[right],
        }
    )
    return table.typed(frame)


def _overlaps(one_labels: Labels, one_ids: Ids, other_labels: Labels, table: Table) -> pd.DataFrame:
    """Count the cells that regions of two images share: rows ``one, other, cells, one_cells``."""
    if one_labels.shape != other_labels.shape:
        msg = (
            f"The regions of {table.name} must lie on one lattice; their labels have the shapes {one_labels.shape} and "
            f"{other_labels.shape}. Take both from one build."
        )
        raise GridMismatchError(msg)
    _require_ids(one_labels, one_ids, table.names[0])
    first, second, cells = shared_cells(one_labels, other_labels)
    one, other = first - 1, second - 1
    one_cells = sizes(one_labels, len(one_ids))[one]
    return pd.DataFrame({"one": one, "other": other, "cells": cells, "one_cells": one_cells})


def _require_ids(labels: Labels, ids: Ids, what: str) -> None:
    """Refuse labels beyond the ids."""
    highest = int(labels.max(initial=0))
    if highest > len(ids):
        msg = f"The label {highest} has no {what}: there are {len(ids)} ids. Take labels and ids from one build."
        raise TableError(msg)
