"""The forest of parts: clusters with ids, fathers and attributes, and the ledger (V22 to V26, V33)."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from msbdb.grid import Grid, GridSpec
from msbdb.identity import part_ids
from msbdb.labels import (
    Labels,
    central_cells,
    centroids,
    height_statistics,
    order_heights,
    reorder,
)
from msbdb.landcover import ClassMap
from msbdb.params import SurfaceParams
from msbdb.parts.clusters import ClusterLedger, Clusters, storeys
from msbdb.parts.fakefathers import spread_of_children
from msbdb.parts.links import NONE, find_roots, link
from msbdb.parts.spectrum import measure_spectrum, spectral_modes
from msbdb.tables import PART, REJECTION, validate_parts
from msbdb.threads import in_threads


@dataclass(frozen=True, slots=True, eq=False)
class Forest:
    """Trees of parts over the scales.

    Parameters
    ----------
    labels : tuple of (H, W) ndarray of int32
        One image a scale, finest first: 0 for none, otherwise row number + 1 in ``parts``. The parts of one scale
        are disjoint and numbered without a gap, in row order of their first cells.
    root_labels : (H, W) ndarray of int32
        Row number + 1 in ``parts`` of the root that covers a cell; 0 for none. Roots are disjoint, whatever their
        scales.
    parts : DataFrame
        The columns of ``tables.PART``, without geometry; in order of scale, finest first.
    scales : DataFrame
        ``tables.SCALE``, coarsest first.
    rejections : DataFrame
        The columns of ``tables.REJECTION``, without geometry.
    counts : dict
        By stage: regions ``in`` (with the ``pieces`` that the stage cut itself), ``kept`` and ``dropped``.
    reasons : (H, W) ndarray of uint8, optional
        `msbdb.tables.Reason` of the cells above the mask that a stage dropped; 0 elsewhere.
    """

    labels: tuple[Labels, ...]
    root_labels: Labels
    parts: pd.DataFrame
    scales: pd.DataFrame
    rejections: pd.DataFrame
    counts: dict[str, dict[str, int]]
    reasons: NDArray[np.uint8] | None = None


@dataclass(frozen=True, slots=True)
class Context:
    """The data beside its own cells on which the attributes of a part depend."""

    ndsm: Grid
    classes: ClassMap | None
    colours: ClassMap | None
    scales: pd.DataFrame
    survey: str
    surface: SurfaceParams
    connectivity: int
    houses: Labels | None = None


def grow_forest(clusters: Clusters, context: Context, ledger: ClusterLedger) -> Forest:
    """Return the forest of the living clusters: with ids, fathers and attributes, checked.

    Parameters
    ----------
    clusters : Clusters
        The clusters after the last stage.
    context : Context
        Heights, classes (without them the building share is null), colours (SPE 0), scales, survey and storeys.
    ledger : ClusterLedger
        The ledger of the stages.

    Raises
    ------
    TableError
        When the parts break an invariant of the forest (V33).
    """
    clusters = compact(clusters)
    rows, lost = clusters.rows, ledger.lost(clusters.rows)
    every = pd.concat([rows, lost], ignore_index=True)
    wanted = (every.index < len(rows)) | (every["area"] * context.ndsm.spec.cell_area_m2 >= ledger.least_m2).to_numpy()
    ids = np.zeros(len(every), dtype=np.int64)
    ids[wanted] = _identify(every[wanted], context)
    father = link(clusters)
    has_father = father != NONE
    scale = _scale_of(rows["level"], context)
    roots = find_roots(father)
    images = tuple(clusters.image(level) for level in range(len(clusters.labels)))
    work = (
        partial(_places, clusters, images, context.ndsm.spec),
        partial(_heights, clusters, images, father, context),
        partial(_spectra, clusters, context),
    )
    places, heights, spectra = in_threads(lambda each: each(), work)
    parts = pd.DataFrame(
        {
            "part_id": ids[: len(rows)],
            "supid": np.where(has_father, ids[father], 0),
            "supscale": np.where(has_father, scale[father], 0) if len(rows) else scale,
            "root_id": ids[roots],
            "building_id": ids[_largest_roots(clusters, father, ids, context)[roots]],
            "scale": scale,
            "hzone": rows["hzone"].to_numpy(),
            **places,
            "stddis": spread_of_children(clusters, father, context.ndsm.spec.cell_m)["stddis"].to_numpy(),
            **heights,
            **spectra,
            # Until it is outlined, a part is its cells.
            "outline_source": "traced",
        }
    )
    parts = PART.typed(parts)
    validate_parts(parts.assign(geometry=None))
    rejections = _rejections(lost, ids[len(rows) :], context)
    cover = clusters.cells.image(_root_of_cells(clusters, father))
    return Forest(images, cover, parts, context.scales, rejections, ledger.counts, ledger.reasons)


def compact(clusters: Clusters) -> Clusters:
    """Return only the living clusters, in order of scale and first cell, and labels without the dropped ones."""
    rows = clusters.rows
    order = np.lexsort((rows["first"], rows["level"]))
    order = order[clusters.alive[order]]
    labels = {level: reorder(own, order, len(rows)) for level, own in enumerate(clusters.labels)}
    return clusters.relabelled(labels, rows.iloc[order].reset_index(drop=True))


def _root_of_cells(clusters: Clusters, father: NDArray[np.int64]) -> Labels:
    """Return (K,) the label of the root in each of the clusters' cells; roots do not overlap."""
    is_root = father == NONE
    return clusters.in_cells(np.where(is_root, np.arange(1, is_root.size + 1), 0).astype(np.int32))


def _largest_roots(
    clusters: Clusters, father: NDArray[np.int64], ids: NDArray[np.int64], context: Context
) -> NDArray[np.int64]:
    """Return, by the row of a root, the row of the largest root of its building; of equals, that of the smallest id.

    A building is a connected island of roots, with the connectivity of the scale-space, within one house.
    """
    is_root = father == NONE
    rows = np.flatnonzero(is_root)
    largest = np.arange(len(ids))
    if not len(rows):
        return largest
    root = _root_of_cells(clusters, father)
    covered = root > 0 if context.houses is None else np.where(root > 0, clusters.cells.of(context.houses), 0)
    islands, _ = clusters.cells.zones(covered, connectivity=context.connectivity)
    island = np.zeros(len(ids), dtype=np.int64)
    island[root[root > 0] - 1] = islands[root > 0]
    area = clusters.rows["area"].to_numpy()[rows]
    order = rows[np.lexsort((ids[rows], -area, island[rows]))]
    first = np.searchsorted(island[order], island[order])
    largest[order] = order[first]
    return largest


def _scale_of(levels: pd.Series, context: Context) -> NDArray[np.int64]:
    """Return SCALE, 1 = coarsest, of levels; 0 where they are -1."""
    level = levels.to_numpy().astype(np.int64)
    return np.where(level < 0, 0, len(context.scales) - level)


def _identify(rows: pd.DataFrame, context: Context) -> NDArray[np.int64]:
    """Return the ids of clusters and lost regions."""
    spec = context.ndsm.spec
    threshold = np.concatenate([[0], context.scales["threshold_px"].to_numpy()])[_scale_of(rows["made"], context)]
    row, col = np.divmod(rows["origin"].to_numpy().astype(np.int64), spec.shape[1])
    row, col = row + spec.origin[0], col + spec.origin[1]
    return part_ids(context.survey, spec.cell_m, threshold_px=threshold, row=row, col=col, piece=rows["piece"])


def _places(clusters: Clusters, images: Sequence[Labels], spec: GridSpec) -> dict[str, NDArray[np.generic]]:
    """Return the first cell, the centroid, a cell inside, and the area of every cluster."""
    rows = clusters.rows
    sums = {name: rows[name].to_numpy().astype(np.int64) for name in ("area", "row_sum", "col_sum")}
    inner = np.zeros(len(rows), dtype=np.int64)
    for level, labels in enumerate(images):
        at = _span(clusters, level)
        inner[at] = central_cells(labels, at, **{name: part[at] for name, part in sums.items()})
    first = rows["first"].to_numpy().astype(np.int64)
    xo, yo = spec.xy(*np.divmod(first, spec.shape[1]))
    xin, yin = spec.xy(*np.divmod(inner, spec.shape[1]))
    xcen, ycen = centroids(rows, spec)
    places = {"xo": xo, "yo": yo, "xcen": xcen, "ycen": ycen, "xin": xin, "yin": yin}
    return {**places, "area_px": sums["area"], "area_m2": sums["area"] * spec.cell_area_m2}


def _span(clusters: Clusters, level: int) -> slice:
    """Return the rows of a scale of compact clusters; the labels are one higher."""
    start, stop = np.searchsorted(clusters.rows["level"], [level, level + 1]).tolist()
    return slice(start, stop)


def _heights(
    clusters: Clusters, images: Sequence[Labels], father: NDArray[np.int64], context: Context
) -> dict[str, NDArray[np.generic]]:
    """Return height statistics of every cluster, from the nDSM inside of it, and its storeys.

    In the paper (V30) H is the value of the flat zone. The opening lowers it where a tower is about as large as the
    podium under it, so by default the storeys come from the nDSM.
    """
    order = order_heights(context.ndsm, clusters.cells.image(_root_of_cells(clusters, father) > 0))
    tables = [height_statistics(labels, _span(clusters, level), order) for level, labels in enumerate(images)]
    table = pd.concat(tables, ignore_index=True)
    found = {name: table[name].to_numpy() for name in table.columns}
    zone = context.surface.storeys_from == "zone"
    hindex = clusters.rows["hzone"].to_numpy() if zone else storeys(found["h_p90"], context.surface)
    return {**found, "hindex": hindex}


def _spectra(clusters: Clusters, context: Context) -> dict[str, NDArray[np.generic]]:
    """Return SPE and the building share of every cluster; 0 and null without classes."""
    speindex = np.zeros(len(clusters.rows), dtype=np.int64)
    share = np.full(len(clusters.rows), np.nan)
    for level in range(len(clusters.labels)):
        if context.classes is not None:
            spectrum = measure_spectrum(clusters, level, context.classes)
            share[spectrum.rows] = spectrum.share
        if context.colours is not None:
            rows, modes = spectral_modes(clusters, level, context.colours)
            speindex[rows] = modes
    return {"speindex": speindex, "building_share": share}


def _rejections(lost: pd.DataFrame, ids: NDArray[np.int64], context: Context) -> pd.DataFrame:
    """Return the lost regions as ``tables.REJECTION``."""
    spec = context.ndsm.spec
    xcen, ycen = centroids(lost, spec)
    frame = pd.DataFrame(
        {
            "region_id": ids,
            "method": lost["method"],
            "stage": lost["stage"],
            "reason": lost["reason"],
            "scale": _scale_of(lost["level"], context),
            "area_m2": lost["area"] * spec.cell_area_m2,
            "xcen": xcen,
            "ycen": ycen,
        }
    )
    return REJECTION.typed(frame)
