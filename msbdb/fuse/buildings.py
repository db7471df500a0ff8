"""Buildings: the islands of roots in which trees of parts stand, and the detectors that support them (V30, V49)."""

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from msbdb.detect.scene import Elevations
from msbdb.errors import GridMismatchError, TableError
from msbdb.fuse.probability import building_probability, states_of
from msbdb.fuse.roofheights import measure_heights
from msbdb.grid import Grid
from msbdb.labels import Labels, height_statistics, look_up, order_heights, shared_cells, sizes, sums
from msbdb.params import FuseParams, Params
from msbdb.tables import BUILDING, CONFIRMING_CLASS_SHARE, CONFIRMING_COVER, DETECTOR_SHARES, Table

Ids = NDArray[np.int64]


def label_buildings(parts: pd.DataFrame, root_labels: Labels) -> Labels:
    """Return which building covers a cell: the roots of one building are one region.

    Parameters
    ----------
    parts : DataFrame
        ``tables.PART``, with or without geometry.
    root_labels : (H, W) ndarray of int32
        Row number + 1 in ``parts`` of the root that covers a cell; 0 for none (``Forest.root_labels``).

    Returns
    -------
    (H, W) ndarray of int32
        0 for none, otherwise row number + 1 in the buildings in order of their ids.

    Raises
    ------
    TableError
        When the labels do not show exactly the roots of the parts.

    Examples
    --------
    Two roots side by side belong to building 4, the third one to building 7:

    >>> parts = pd.DataFrame({"supid": [0, 0, 0], "building_id": [4, 7, 4]})
    >>> label_buildings(parts, np.array([[1, 3, 0, 2]], dtype=np.int32))
    array([[1, 1, 0, 2]], dtype=int32)
    """
    is_root = (parts["supid"] == 0).to_numpy()
    _require_roots(root_labels, is_root)
    _, row = np.unique(parts["building_id"].to_numpy(), return_inverse=True)
    number = np.concatenate([[0], np.where(is_root, row + 1, 0)]).astype(np.int32)
    return look_up(number, root_labels)


def buildings_from_parts(
    parts: pd.DataFrame,
    labels: Labels,
    ndsm: Grid,
    elevations: Elevations | None = None,
    params: Params | None = None,
) -> pd.DataFrame:
    """Return the buildings in which the trees of parts stand.

    Parameters
    ----------
    parts : DataFrame
        ``tables.PART``, with or without geometry.
    labels : (H, W) ndarray of int32
        Which building covers a cell (`label_buildings`).
    ndsm : Grid
        Heights above ground on the labels' lattice, metres.
    elevations : Elevations, optional
        The terrain above sea and the echoes of each cell; without them levels above sea and the density are null.
    params : Params, optional
        Sections ``heights`` and ``surface``.

    Returns
    -------
    DataFrame
        ``tables.BUILDING`` without geometry, in order of the ids.

    Raises
    ------
    TableError
        When a label has no building.

    Notes
    -----
    - ``state`` is 'confirmed' when at least half of the building's cells have a building class, and 'unsure' when
      fewer have, or there are no classes. `with_support` hears the other detectors.
    - Ground, eaves, ridge and storeys are those of `msbdb.fuse.roofheights.measure_heights`. ``h_max`` and the other
      ``h_`` are of all valid cells in the footprint. The volume is exact for a surface above flat ground: the sum of
      height times cell area, in which heights below 0 count as 0.
    - The shares that other detectors cover, and the probability, are null here; `with_support` adds them. The
      ``outline_source`` is that of bare cells, 'traced'.
    """
    params, elevations = params or Params(), elevations or Elevations()
    parts = pd.DataFrame(parts)
    ids = np.unique(parts["building_id"].to_numpy())
    _require_ids(labels, ids, "building_id")
    heights = height_statistics(labels, slice(0, len(ids)), order_heights(ndsm, labels > 0))
    within = parts.groupby("building_id")
    roots = parts[parts["supid"] == 0]
    weighted = {name: roots[name] * roots["area_px"] for name in ("xcen", "ycen", "building_share")}
    cells = roots.groupby("building_id")["area_px"].sum()
    means = pd.DataFrame(weighted).groupby(roots["building_id"]).sum(min_count=1).div(cells, axis=0)
    # The largest root gives its id to the building.
    largest = roots.set_index("part_id").loc[ids, ["speindex", "xin", "yin"]].reset_index(drop=True)
    measured = measure_heights(labels, len(ids), ndsm, elevations, params=params.heights, surface=params.surface)
    frame = pd.concat([largest, measured], axis=1).assign(
        building_id=ids,
        **{name: means[name].to_numpy() for name in means.columns},
        area_m2=cells.to_numpy() * ndsm.spec.cell_area_m2,
        volume_m3=_volume(labels, len(ids), ndsm),
        trees=roots.groupby("building_id").size().to_numpy(),
        parts=within.size().to_numpy(),
        scales=within["scale"].nunique().to_numpy(),
        probability=np.nan,
        divided_by="",
        outline_source="traced",
        **dict.fromkeys(DETECTOR_SHARES.values(), np.nan),
        **{name: heights[name] for name in ("h_max", "h_mean", "h_p50", "h_p90")},
    )
    confirmed = frame["building_share"] >= CONFIRMING_CLASS_SHARE
    return BUILDING.typed(frame.assign(state=np.where(confirmed, "confirmed", "unsure")))


def _volume(footprints: Labels, count: int, ndsm: Grid) -> NDArray[np.float64]:
    """Return height times area, summed over the valid cells of each footprint, cubic metres."""
    cells = np.flatnonzero((footprints > 0) & ndsm.valid)
    heights = np.maximum(np.asarray(ndsm.values).ravel()[cells].astype(np.float64), 0)
    return sums(footprints.ravel()[cells], heights, count) * ndsm.spec.cell_area_m2


def _require_roots(root_labels: Labels, is_root: NDArray[np.bool_]) -> None:
    """Refuse labels that do not show exactly the roots of the parts."""
    shown = sizes(root_labels, len(is_root)) > 0
    if shown.size != is_root.size or (shown != is_root).any():
        msg = (
            f"The labels must show the {np.count_nonzero(is_root)} roots of the {len(is_root)} parts and nothing "
            f"else; they show {np.count_nonzero(shown)} regions. Take both from one build."
        )
        raise TableError(msg)


def with_support(
    buildings: pd.DataFrame, shares: Mapping[str, NDArray[np.float64]], *, params: FuseParams | None = None
) -> pd.DataFrame:
    """Return buildings with the support of the detectors: the share that each covers, the probability, and the state.

    Where the detectors decide together, their mean share and the area give the probability of a building
    (`msbdb.fuse.probability`), and this the state.

    Otherwise a detector supports a building when it covers at least ``CONFIRMING_COVER`` of the footprint. A building
    that the classes confirm stays confirmed when at least half of the detectors besides ``multiscale`` support it. It
    is unsure otherwise. Without other detectors the classes alone decide.

    Parameters
    ----------
    buildings : DataFrame
        ``tables.BUILDING``; where the detectors decide together its areas count.
    shares : mapping of str to (N,) ndarray of float64
        By detector (``tables.DETECTOR_SHARES``), only those that were run: the share of each footprint that its
        regions cover.
    params : FuseParams, optional
        As `building_probability` and `states_of` take them. None where the detectors do not decide together.

    Examples
    --------
    The second building has no support:

    >>> buildings = pd.DataFrame({"state": ["confirmed", "confirmed", "unsure"], "area_m2": [90.0, 30.0, 60.0]})
    >>> with_support(buildings, {"flatregions": np.array([0.9, 0.0, 1.0])})["state"].tolist()
    ['confirmed', 'unsure', 'unsure']

    Four detectors together; two of them see the second building:

    >>> seen = {"multiscale": np.array([1.0, 1.0]), "flatregions": np.array([0.9, 0.0])}
    >>> seen |= {"area3d": np.array([1.0, 1.0]), "adaptive": np.array([0.9, 0.0])}
    >>> found = with_support(buildings[:2], seen, params=FuseParams())
    >>> found[["probability", "state"]].round(2).to_numpy().tolist()
    [[0.99, 'confirmed'], [0.38, 'unsure']]
    """
    columns = {DETECTOR_SHARES[name]: covered for name, covered in shares.items()}
    if params is not None:
        area_m2 = buildings["area_m2"].to_numpy(dtype=np.float64)
        probability = building_probability(np.mean(list(shares.values()), axis=0), area_m2, params)
        return buildings.assign(**columns, probability=probability, state=states_of(probability, params))
    others = [covered >= CONFIRMING_COVER for name, covered in shares.items() if name != "multiscale"]
    supports = np.sum(others, axis=0)
    confirmed = (buildings["state"] == "confirmed") & (2 * supports >= len(others))
    return buildings.assign(**columns, state=np.where(confirmed, "confirmed", "unsure"))


def covered_shares(labels: Labels, count: int, regions: Labels) -> NDArray[np.float64]:
    """Return the share of each building's cells that the regions of a detector cover, from 0 to 1.

    Parameters
    ----------
    labels : (H, W) ndarray of int32
        Which building covers a cell: 0 for none, otherwise row number + 1.
    count : int
        Number of buildings.
    regions : (H, W) ndarray of int32
        The detector's regions, 0 for none.

    Examples
    --------
    >>> covered_shares(np.array([[1, 1, 2, 2]]), 2, np.array([[5, 0, 0, 0]]))
    array([0.5, 0. ])
    """
    return sizes(labels[regions > 0], count) / np.maximum(sizes(labels, count), 1)


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
    used = np.flatnonzero(other_labels)
    counted = [_overlaps(labels, one_ids, other_labels, used, table) for labels in one_labels]
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


def _overlaps(
    one_labels: Labels, one_ids: Ids, other_labels: Labels, used: NDArray[np.intp], table: Table
) -> pd.DataFrame:
    """Count the cells that regions of two images share, of those that the other one uses.

    The rows have the columns ``one, other, cells, one_cells``.
    """
    if one_labels.shape != other_labels.shape:
        msg = (
            f"The regions of {table.name} must lie on one lattice; their labels have the shapes {one_labels.shape} and "
            f"{other_labels.shape}. Take both from one build."
        )
        raise GridMismatchError(msg)
    _require_ids(one_labels, one_ids, table.names[0])
    first, second, cells = shared_cells(one_labels.ravel()[used], other_labels.ravel()[used])
    one, other = first - 1, second - 1
    one_cells = sizes(one_labels, len(one_ids))[one]
    return pd.DataFrame({"one": one, "other": other, "cells": cells, "one_cells": one_cells})


def _require_ids(labels: Labels, ids: Ids, what: str) -> None:
    """Refuse labels beyond the ids."""
    highest = int(labels.max(initial=0))
    if highest > len(ids):
        msg = f"The label {highest} has no {what}: there are {len(ids)} ids. Take labels and ids from one build."
        raise TableError(msg)
