"""The tree of parts, from heights and classes to a forest: all steps in their order (Vu et al. 2009, section 3.2)."""

import logging
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from msbdb.errors import GridMismatchError
from msbdb.grid import Grid
from msbdb.labels import Labels, around, chosen_cells, colour_touching, label_zones, measure
from msbdb.landcover import ClassMap
from msbdb.morphology.scalespace import build_scale_space, scales_of_sizes, sizes_of_cells
from msbdb.params import Params, ScaleParams, with_values
from msbdb.parts.clusters import ClusterLedger, Clusters, label_clusters, slice_heights
from msbdb.parts.fakefathers import drop_fake_fathers
from msbdb.parts.forest import Context, Forest, grow_forest
from msbdb.parts.links import NONE, drop_duplicates, link
from msbdb.parts.reshaping import cut_vegetation, joined, settle
from msbdb.parts.spectrum import drop_unlike, split_by_classes
from msbdb.tables import SCALE, Reason
from msbdb.threads import in_threads

logger = logging.getLogger(__name__)

TOO_SMALL = "smaller than the finest scale"
VEGETATION = "vegetation by its structure"
UNSUPPORTED = "vegetation, or supported by too few detectors"
OTHER_LABEL = "its class is labelled as no building"
NO_ROWS = np.zeros(0, dtype=np.intp)


def extract_parts(
    ndsm: Grid,
    classes: ClassMap | None,
    *,
    survey: str,
    params: Params,
    houses: Labels | None = None,
    colours: ClassMap | None = None,
    crowns: NDArray[np.bool_] | None = None,
) -> Forest:
    """Grow the forest of building parts from heights above ground and land-cover classes.

    Parameters
    ----------
    ndsm : Grid
        Heights above ground, metres.
    classes : ClassMap or None
        Classes on the same lattice. Without them the stages that need vegetation or roof classes are left out.
    survey : str
        Name of the survey; part of the ids.
    params : Params
        Sections ``surface``, ``scale``, ``granulometry`` and ``spectral``; of ``fuse`` the least area of a row.
    houses : (H, W) ndarray of int32, optional
        The house of each cell that several detectors take for building, 0 for none. Those of them below the mask, where
        an echo beside the wall hit the ground, belong to the highest slice beside them; all others have no such
        exception (V17). Parts grow in each house as if it stood alone, and no part reaches into another house. Roots
        keep these cells, whatever the crowns.
    colours : ClassMap, optional
        Classes by colour, which alone give SPE (V42); without them ``classes`` give it.
    crowns : (H, W) ndarray of bool, optional
        Cells that are vegetation by colour and by roughness, though ``classes`` have a roof there: crowns that hang
        over it. They count as vegetation when clusters are reshaped and removed (V37, V41).

    Returns
    -------
    Forest
        Possibly empty.

    Raises
    ------
    GridMismatchError
        When nDSM and classes do not share a lattice.

    Notes
    -----
    Slices, scale-space, clusters, duplicates, vegetation, spectrum, fake fathers, links: the order of the paper. Other
    than there, fathers are looked up anew after each stage, which re-attaches children by itself (V45).
    Complexity: linear in the cells for each scale, after one sort of the heights.
    """
    if classes is not None and not classes.spec.same_lattice(ndsm.spec):
        msg = (
            f"The classes lie on the lattice {classes.spec.shape} at {classes.spec.bounds}, the nDSM on "
            f"{ndsm.spec.shape} at {ndsm.spec.bounds}. Classify on the nDSM's lattice."
        )
        raise GridMismatchError(msg)
    ledger = ClusterLedger("multiscale", params.fuse.piece_m2)
    params = choose_scales(ndsm, classes, params)
    heights = ndsm
    ledger.begin(ndsm.valid & (np.asarray(ndsm.values) >= params.surface.mask_m))
    if classes is not None and params.spectral.decides == "structure":
        reason = VEGETATION if houses is None else UNSUPPORTED
        heights = _without_vegetation(ndsm, classes.labelled("vegetation"), params, ledger, reason=reason)
    sliced = slice_heights(heights, params.surface, connectivity=params.scale.connectivity)
    if houses is not None:
        _record_outside((sliced > 0) & (houses == 0), classes, params.scale.connectivity, ledger)
        sliced = _beside_slices(sliced, houses)
    scales = number_scales(params.scale.scales_m2, ndsm.spec.cell_area_m2)
    thresholds = scales["threshold_px"].tolist()[::-1]
    clusters = form_clusters(sliced, thresholds, params.scale, ledger, houses)
    step = drop_duplicates(clusters, params.scale.duplicate_share)
    clusters = ledger.record("duplicates", clusters, step)
    if classes is not None:
        kept = np.flatnonzero(clusters.alive & (link(clusters) == NONE)) if houses is not None else NO_ROWS
        crowned = _with_crowns(classes, crowns)
        clusters = _apply_classes(clusters, classes, crowned, params, ledger, smallest_px=thresholds[0], kept=kept)
    if params.scale.merge_slivers:
        clusters = ledger.record("duplicates by scale", clusters, settle(clusters, thresholds))
    step = drop_fake_fathers(
        clusters, params.scale, cell_m=ndsm.spec.cell_m, smallest_px=thresholds[0], supported=houses is not None
    )
    clusters = ledger.record("fake fathers", clusters, step, Reason.GAP)
    if params.scale.merge_slivers:
        # Only what a fake father left beside its children moves; it holds no cluster that it could cover.
        clusters = settle(clusters, thresholds).clusters
    context = Context(
        ndsm, classes, colours or classes, scales, survey, params.surface, params.scale.connectivity, houses
    )
    forest = grow_forest(clusters, context, ledger)
    logger.info("The tree has %d parts; %d regions were rejected", len(forest.parts), len(forest.rejections))
    return forest


def _beside_slices(sliced: NDArray[Any], houses: Labels) -> NDArray[Any]:
    """Return the slices of houses alone; their cells below the mask get the highest slice beside them."""
    framed = np.pad(sliced, 1)
    low = np.flatnonzero(np.pad((houses > 0) & (sliced == 0), 1))
    raised = around(framed, low).max(axis=1)
    framed.ravel()[low] = raised
    return np.where(houses > 0, framed[1:-1, 1:-1], sliced.dtype.type(0))


def choose_scales(ndsm: Grid, classes: ClassMap | None, params: Params) -> Params:
    """Return the parameters with scales: those that were given, or those that the heights contain (V8).

    Parameters
    ----------
    ndsm : Grid
        Heights above ground, metres.
    classes : ClassMap or None
        Classes on the same lattice, by which vegetation has no part in the sizes where the structure decides. A build
        finds its scales before there are colours, as the filter of the bands needs the finest one (V34).
    params : Params
        Where ``scale.scales_m2`` is empty, `msbdb.morphology.find_scales` finds it by ``granulometry``.
    """
    if params.scale.scales_m2:
        return params
    found = scales_of_sizes(cell_sizes(ndsm, classes, params), params.granulometry)
    return with_values(params, {"scale": {"scales_m2": found}})


def cell_sizes(ndsm: Grid, classes: ClassMap | None, params: Params) -> NDArray[np.floating]:
    """Return the sizes of cells from which `choose_scales` finds the scales, square metres."""
    sliced = slice_heights(ndsm, params.surface)
    if classes is not None and params.spectral.decides == "structure":
        sliced = np.where(classes.labelled("vegetation"), np.uint16(0), sliced)
    return sizes_of_cells(sliced, ndsm.spec.cell_area_m2, params.granulometry)


def number_scales(scales_m2: tuple[float, ...], cell_area_m2: float) -> pd.DataFrame:
    """Return the scales (``tables.SCALE``, coarsest first) of area thresholds in square metres.

    Thresholds are rounded to whole cells, at least one; of those that fall together the largest stays.
    """
    cells: dict[int, float] = {}
    for threshold_m2 in sorted(scales_m2, reverse=True):
        cells.setdefault(max(1, round(threshold_m2 / cell_area_m2)), threshold_m2)
    frame = pd.DataFrame(
        {
            "scale": range(1, len(cells) + 1),
            "threshold_px": list(cells),
            "threshold_m2": list(cells.values()),
        }
    )
    return SCALE.typed(frame)


def form_clusters(
    sliced: NDArray[Any],
    thresholds: list[int],
    scale: ScaleParams,
    ledger: ClusterLedger,
    houses: Labels | None = None,
) -> Clusters:
    """Build the scale-space of sliced heights, and label its clusters.

    Parameters
    ----------
    sliced : (H, W) ndarray of int
        Storeys or steps; 0 is background.
    thresholds : list of int
        s of the scales, cells, ascending.
    scale : ScaleParams
        Connectivity, and what is done about slivers and courtyards.
    ledger : ClusterLedger
        Gets the islands that the finest opening removes.
    houses : (H, W) ndarray of int32, optional
        The house of each cell; 0 for none. No cluster reaches from one house into another, or out of all houses.

    Notes
    -----
    With ``merge_slivers`` every cluster has s cells or more of its own scale (V7). Courtyards: a coarse closing fills
    each hole smaller than s, so that a yard becomes roof; with ``keep_courtyards`` the finest scale's ground stays.

    Houses: the scale-space is that of each house as if it stood alone. It is built of several houses at once that do
    not touch, by a colouring of the houses.
    """
    connectivity = scale.connectivity
    islands = sliced > 0 if houses is None else np.where(sliced > 0, houses, 0)
    _record_islands(islands, thresholds[0], connectivity, ledger)
    if houses is None:
        levels = _build_levels(sliced, thresholds, scale)
    else:
        levels = _build_levels_apart(sliced, thresholds, scale, colour_touching(houses))
    clusters = label_clusters(levels, connectivity=connectivity, houses=houses)
    ledger.count("clusters", len(clusters.rows), len(clusters.rows), 0)
    return clusters


def _build_levels(sliced: NDArray[Any], thresholds: list[int], scale: ScaleParams) -> list[NDArray[Any]]:
    """Return the scale-space of sliced heights, small zones merged and courtyards kept as `form_clusters` says."""
    space = build_scale_space(
        sliced,
        thresholds,
        connectivity=scale.connectivity,
        merge_small=scale.merge_slivers,
        keep_ground=scale.keep_courtyards,
    )
    return list(space.levels)


def _build_levels_apart(
    sliced: NDArray[Any], thresholds: list[int], scale: ScaleParams, colours: NDArray[np.uint8]
) -> list[NDArray[Any]]:
    """Return the scale-spaces of the houses of each colour in one, each cut to the cells of its houses."""
    levels = [np.zeros_like(sliced) for _ in thresholds]

    def build(colour: int) -> None:
        own = colours == colour  # no cell has two colours, so threads never write to the same place
        found = _build_levels(np.where(own, sliced, sliced.dtype.type(0)), thresholds, scale)
        for level, alone in zip(levels, found, strict=True):
            np.copyto(level, alone, where=own)

    in_threads(build, range(1, int(colours.max(initial=0)) + 1))
    return levels


def _without_vegetation(
    ndsm: Grid, vegetation: NDArray[np.bool_], params: Params, ledger: ClusterLedger, *, reason: str
) -> Grid:
    """Remove vegetation with the ground, before the scale-space; each blob goes to the ledger, with the reason.

    The paper cuts vegetation out of clusters after the scale-space (V37), as its classes come from colours. Where they
    come from the structure, crowns need not flatten the roofs beside them first.
    """
    above = ndsm.valid & (np.asarray(ndsm.values) >= params.surface.mask_m)
    blobs, count = label_zones(above & vegetation, connectivity=params.scale.connectivity)
    lost = measure(blobs, count)
    ledger.write("vegetation mask", _without_scale(lost, reason))
    ledger.count("vegetation mask", count, 0, count)
    ledger.lose(vegetation, Reason.VEGETATION_BY_STRUCTURE)
    return Grid(ndsm.values, ndsm.valid & ~vegetation, ndsm.spec)


def _record_outside(
    cells: NDArray[np.bool_], classes: ClassMap | None, connectivity: int, ledger: ClusterLedger
) -> None:
    """Record what is above the mask and in no house: most of it lies in a class with another label, as decks do."""
    named = np.zeros_like(cells)
    if classes is not None:
        named = (classes.index > 0) & ~classes.labelled("building") & ~classes.labelled("vegetation")
    for chosen, reason in ((cells & named, OTHER_LABEL), (cells & ~named, UNSUPPORTED)):
        blobs, count = label_zones(chosen, connectivity=connectivity)
        ledger.write("houses", _without_scale(measure(blobs, count), reason))
        ledger.count("houses", count, 0, count)
    ledger.lose(cells, Reason.OTHER_CLASS)


def _record_islands(islands: NDArray[Any], smallest_px: int, connectivity: int, ledger: ClusterLedger) -> None:
    """Record the connected areas above the mask, of one house each, that are too small for the finest scale."""
    labels, count = label_zones(islands, connectivity=connectivity)
    table = measure(labels, count)
    lost = table[table["area"] < smallest_px]
    ledger.write("opening", _without_scale(lost, TOO_SMALL))
    ledger.count("opening", count, count - len(lost), len(lost))
    ledger.lose(chosen_cells(labels, (table["area"] < smallest_px).to_numpy()), Reason.SMALL)


def _without_scale(measured: pd.DataFrame, reason: str) -> pd.DataFrame:
    """Return measured regions, lost before there were scales, as rows of clusters."""
    return measured.assign(level=-1, hzone=0, origin=measured["first"], piece=0, made=-1, alive=False, reason=reason)


def _with_crowns(classes: ClassMap, crowns: NDArray[np.bool_] | None) -> ClassMap:
    """Return the classes with one more of vegetation, in the cells of crowns."""
    if crowns is None or not crowns.any():
        return classes
    number = max(classes.labels, default=0) + 1
    index = np.where(crowns, number, classes.index).astype(np.uint8)
    return ClassMap(index, {**classes.labels, number: "vegetation"}, classes.spec)


def _apply_classes(
    clusters: Clusters,
    classes: ClassMap,
    crowned: ClassMap,
    params: Params,
    ledger: ClusterLedger,
    *,
    smallest_px: int,
    kept: NDArray[np.intp],
) -> Clusters:
    """Reshape, split and drop clusters by their classes (V37-V45), and drop the duplicates that this makes.

    The crowned classes have vegetation where crowns hang over roofs. The rows to keep are roots of cells that several
    detectors support: crowns are taken from the parts in them, and not from the roots.
    """
    scale, spectral = params.scale, params.spectral
    step = cut_vegetation(
        clusters, crowned.labelled("vegetation"), smallest_px=smallest_px, connectivity=scale.connectivity, kept=kept
    )
    clusters = ledger.record("vegetation", clusters, step, Reason.VEGETATION_BY_COLOUR)
    step = drop_duplicates(clusters, scale.duplicate_share, by_storeys=False)
    clusters = ledger.record("duplicates after vegetation", clusters, step)
    step = split_by_classes(
        clusters,
        classes,
        split_share=spectral.split_share,
        min_share=spectral.min_building_share,
        smallest_px=smallest_px,
        connectivity=scale.connectivity,
    )
    clusters = ledger.record("split", clusters, step, Reason.SMALL_PART)
    step = drop_duplicates(clusters, scale.duplicate_share, by_storeys=False)
    clusters = ledger.record("duplicates after split", clusters, step)
    least = spectral.min_building_share
    parts = drop_unlike(clusters, crowned, least, kept=kept)
    others = np.setdiff1d(np.flatnonzero(clusters.alive), kept)
    roots = drop_unlike(parts.clusters, classes, least, kept=others)
    return ledger.record("spectrum", clusters, joined(roots.clusters, [parts, roots]), Reason.UNLIKE_PART)
