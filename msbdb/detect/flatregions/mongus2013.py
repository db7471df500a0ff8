"""The detector of flat regions, from a surface to regions of compact shape (Mongus et al. 2013, section 3)."""

import logging
from dataclasses import dataclass

import geopandas as gpd
import numpy as np
import pandas as pd
from numpy.typing import NDArray

from msbdb.detect.flatregions.binarisation import Binarised, binarise
from msbdb.detect.flatregions.initialisation import Denoised, denoise, initialise
from msbdb.detect.flatregions.recognition import FlatRegionLedger, clean, describe, grow, measure_shapes
from msbdb.detect.scene import CERTAIN, Regions, Scene
from msbdb.errors import GridMismatchError, NodataError, give_notice
from msbdb.grid import Grid
from msbdb.labels import Labels, chosen_cells, islands_of, label_zones, reorder, sizes
from msbdb.ledger import Answers
from msbdb.outline.polygons import polygonise
from msbdb.outline.simplification import simplify_coverage
from msbdb.params import FlatRegionParams, Params, with_values
from msbdb.surface.structure import smooth_shares
from msbdb.tables import FLAT_REGION

logger = logging.getLogger(__name__)

PEAK = "sharp peak"
VALLEY = "steep valley"
ROUGH = "too rough for its size in every zone"
LEAFY = "leaves by its echoes and texture"
THIN = "thinner than the opening"
LONG = "too long and thin"

GROUND_IS_FLAT = (
    "One flat region covers {share:.0%} of the survey: on the raw surface, the ground is a flat region where its sum "
    "of gradients is below lambda_max_m2. Set flatregions.on=ndsm, or take the default profile."
)
NO_PLANE_MM = 1000
"""Ours: a larger roughness counts as this, millimetres: no plane fits there."""

MOST_OF_SURVEY = 0.35
"""No building covers so much of a survey; on the tiles at hand, ground that is a flat region covers 40 % and more."""


@dataclass(frozen=True, slots=True, eq=False)
class FlatRegions:
    """The flat regions of a surface, and the grids that lead to them.

    Parameters
    ----------
    labels : (H, W) ndarray of int32
        0 for none, otherwise row number + 1 in ``regions``, in row order of the regions' first cells.
    regions : DataFrame
        The columns of ``tables.FLAT_REGION``, without geometry.
    rejections : DataFrame
        The columns of ``tables.REJECTION``, without geometry.
    counts : dict
        By stage: regions ``in`` (with the ``pieces`` that the stage cut itself, less those it joined), ``kept`` and
        ``dropped``.
    answers : (H, W) ndarray of uint8
        Which stage dropped a cell, and why (`msbdb.ledger.Ledger.marked`).
    zones : (H, W) ndarray of int32
        i of the largest flat component that holds a cell, 0 for none: the set G of Eq. 14, as in the paper's Fig. 2.
    denoised : Grid
        The surface without outliers, as in the paper's Fig. 1.
    """

    labels: Labels
    regions: pd.DataFrame
    rejections: pd.DataFrame
    counts: dict[str, dict[str, int]]
    answers: Answers
    zones: NDArray[np.int32]
    denoised: Grid


def detect_flat_regions(scene: Scene, params: Params) -> Regions:
    """Detect flat regions in a scene (M22): the detector ``flatregions``.

    Parameters
    ----------
    scene : Scene
        Of points, the lowest echo of each cell counts (M8); of rasters, the surface as it is.
    params : Params
        Sections ``flatregions``, ``surface`` and ``vector``.

    Returns
    -------
    Regions
        The table has the columns of ``tables.FLAT_REGION`` and outlines.

    Warns
    -----
    MsbdbWarning
        Where, on the raw surface, one region covers so much of the survey that it must be ground.
    """
    spec = scene.heights.spec
    trust, own = 0.0 if scene.cloud is None else scene.cloud.most_trust, params.flatregions
    ratio = trust * own.ratio + (1 - trust) * own.blind_ratio
    params = with_values(params, {"flatregions": {"ratio": ratio}})
    found = extract_flat_regions(
        lowest_surface(scene, params),
        heights=scene.heights,
        survey=scene.survey.name,
        params=params,
        leafy=find_leaves(scene, params),
    )
    if params.flatregions.on == "surface" and len(found.regions):
        share = sizes(found.labels, len(found.regions)).max() / np.count_nonzero(scene.heights.valid)
        if share > MOST_OF_SURVEY:
            give_notice(GROUND_IS_FLAT.format(share=share))
    order = np.argsort(found.regions["region_id"].to_numpy(), kind="stable")
    labels = reorder(found.labels, order, len(order))
    islands = islands_of(labels > 0)
    traced = polygonise(islands.gather(labels), spec, len(order), islands=islands)
    outlines = simplify_coverage(traced, params.vector.simplify_px * spec.cell_m)
    regions = found.regions.iloc[order].reset_index(drop=True)
    table = gpd.GeoDataFrame(regions, geometry=list(outlines), crs=spec.crs)[[*FLAT_REGION.names, "geometry"]]
    return Regions("flatregions", labels, table, found.rejections, found.counts, answers=found.answers)


def lowest_surface(scene: Scene, params: Params) -> Grid:
    """Return the surface in which flat regions are detected (M7, M8), metres.

    The terrain is subtracted with ``flatregions.on`` 'ndsm'. Valid where both surfaces are.
    """
    surface, cloud = scene.require_surface(), scene.cloud
    lowest = surface.dsm
    if cloud is not None:
        max_gap_m = params.surface.max_gap_m if params.flatregions.gaps == "near" else 0.0
        lowest = initialise(cloud, scene.heights.spec, max_gap_m=max_gap_m)
    return above_ground(lowest, surface.dtm) if params.flatregions.on == "ndsm" else lowest


def find_leaves(scene: Scene, params: Params) -> NDArray[np.bool_] | None:
    """Return the cells that are leaves by their echoes and texture (ours).

    A dense crown may be as flat for its size as a rough roof. Its gradients do not show it, but its echoes do. What is
    smoother than leaves is a roof of glass or with plants.

    Parameters
    ----------
    scene : Scene
        Heights, and each cell's own evidence of roof.
    params : Params
        ``flatregions.leaf_*``, and ``surface.mask_m``.

    Returns
    -------
    (H, W) ndarray of bool or None
        None where the rule is off, or the scene has no evidence.

    Notes
    -----
    Both means are over raised cells alone. Where no plane fits, the roughness counts as `NO_PLANE_MM`. Border and
    nodata: what is invalid or beyond the lattice does not count.
    """
    own, evidence, heights = params.flatregions, scene.evidence, scene.heights
    if own.leaf_probability == 0 or evidence is None:
        return None
    raised = heights.valid & (np.asarray(heights.values) >= params.surface.mask_m)
    probability = evidence.roof_probability.astype(np.float32) / np.float32(CERTAIN)
    rough = np.minimum(evidence.roughness_mm, NO_PLANE_MM).astype(np.float32) / np.float32(1000)
    sigma = own.leaf_sigma_m / heights.spec.cell_m
    likely, rough = smooth_shares((probability, rough), raised, sigma)
    return raised & (likely < own.leaf_probability) & (rough > own.leaf_rough_m)


def above_ground(surface: Grid, dtm: Grid) -> Grid:
    """Subtract the terrain from another surface than the DSM; valid where both are, 0 elsewhere."""
    valid = surface.valid & dtm.valid
    height = np.asarray(surface.values, dtype=np.float32) - np.asarray(dtm.values, dtype=np.float32)
    return Grid(np.where(valid, height, np.float32(0)), valid, surface.spec)


def extract_flat_regions(
    g: Grid, *, heights: Grid, survey: str, params: Params, leafy: NDArray[np.bool_] | None = None
) -> FlatRegions:
    """Detect the flat regions of a surface that may be buildings.

    Parameters
    ----------
    g : Grid
        What `initialise` made, metres: elevations with ``params.flatregions.on`` 'surface'; with 'ndsm', the same
        less the terrain. Where the source is a raster, that raster.
    heights : Grid
        Heights above ground on the same lattice, metres, for the regions' statistics; with 'ndsm', regions get their
        edges back from it, too.
    survey : str
        Name of the survey; part of the ids.
    params : Params
        Sections ``flatregions`` and, of ``surface``, the mask.
    leafy : (H, W) ndarray of bool, optional
        Cells of leaves, which belong to no region.

    Returns
    -------
    FlatRegions
        Possibly without regions.

    Raises
    ------
    GridMismatchError
        When the grids do not share a lattice.
    NodataError
        When the surface has no valid cell.
    ParameterError
        When λ_max is below λ_min, or λ_Δ is 0.

    Notes
    -----
    Initialisation (M7, M8) comes before; denoising, binarisation and recognition are here. With 'ndsm' heights below
    the mask become ground, which is level, so nothing is attached to a slope and no plateau rises (M27).
    """
    if not g.spec.same_lattice(heights.spec):
        msg = (
            f"The surface {g.spec.shape} at {g.spec.bounds} and the heights {heights.spec.shape} at "
            f"{heights.spec.bounds} must share one lattice."
        )
        raise GridMismatchError(msg)
    if not g.valid.any():
        msg = "The surface has no valid cell in which flat regions could lie. Check its extent and nodata value."
        raise NodataError(msg)
    own, mask_m = params.flatregions, params.surface.mask_m
    ledger = FlatRegionLedger(g.spec, survey, params.fuse.piece_m2)
    denoised = denoise(g, own)
    _record_outliers(denoised, ledger)
    if own.on == "ndsm":
        found = binarise(level_ground(denoised.grid, mask_m), level_ground(g, mask_m), own)
    else:
        found = binarise(denoised.grid, g, own)
    rough = ledger.reject("ratio", ROUGH, found.risen & ~found.flat)
    _, candidates = label_zones(found.flat)
    ledger.count("ratio", candidates + rough, candidates, rough)
    labels = recognise(found, candidates, heights, params, ledger, leafy=leafy)
    regions = describe(labels, found, heights, survey)
    logger.info("flatregions found %d regions, of %d candidates", len(regions), candidates)
    return FlatRegions(
        labels,
        regions,
        ledger.rejections(),
        ledger.counts,
        ledger.marked().on(g.spec.shape),
        found.zones,
        denoised.grid,
    )


def _record_outliers(denoised: Denoised, ledger: FlatRegionLedger) -> None:
    """Write peaks and valleys into the ledger."""
    dropped = ledger.reject("denoising", PEAK, denoised.peaks)
    dropped += ledger.reject("denoising", VALLEY, denoised.valleys)
    ledger.count("denoising", dropped, 0, dropped)


def level_ground(heights: Grid, mask_m: float) -> Grid:
    """Return heights above ground with all that is below the mask at 0."""
    values = np.asarray(heights.values)
    return heights.with_values(np.where(values < mask_m, 0, values).astype(np.float32))


def recognise(
    found: Binarised,
    candidates: int,
    heights: Grid,
    params: Params,
    ledger: FlatRegionLedger,
    *,
    leafy: NDArray[np.bool_] | None = None,
) -> Labels:
    """Turn the set G without leaves into labelled regions: G_B = Γ^Ψ(Φ_w(Γ_w(G))) (Eq. 17; M22)."""
    own, cell_m, flat = params.flatregions, heights.spec.cell_m, found.flat
    if leafy is not None:
        dropped = ledger.reject("leaves", LEAFY, flat & leafy)
        flat, entered = flat & ~leafy, candidates
        heights = Grid(heights.values, heights.valid & ~leafy, heights.spec)  # nor do regions grow into them
        _, candidates = label_zones(flat)
        ledger.count("leaves", entered, candidates, dropped, pieces=candidates + dropped - entered)
    cleaned = clean(flat, own.opening_m, cell_m)
    labels, count = label_zones(cleaned)
    before, number = label_zones(flat)
    vanished = chosen_cells(before, sizes(before[cleaned], number) == 0)
    thin = ledger.reject("opening", THIN, vanished)
    ledger.count("opening", candidates, count, thin, pieces=count + thin - candidates)
    if own.on == "ndsm":
        # On cells of any size, the lowest points take the outermost cells of a roof.
        steps = max(1, int(own.grow_m / cell_m + 0.5)) if own.grow_m > 0 else 0
        labels = grow(labels, heights, steps=steps, step_m=own.grow_step_m, least_m=params.surface.mask_m)
    return _drop_long(labels, count, own, cell_m, ledger)


def _drop_long(labels: Labels, count: int, own: FlatRegionParams, cell_m: float, ledger: FlatRegionLedger) -> Labels:
    """Keep the regions of Ψ < ψ (Eq. 16) and number them again, by their first cells.

    Ψ is P²/(4πA) (A9), or its inverse as printed (M20). Ours: above ``compact_m2`` it counts per this area. A and P of
    blocks that touch add up, so that Ψ grows with their number, and a whole old town would be too long and thin.
    """
    shapes = measure_shapes(labels, cell_m)
    psi = shapes["compactness"].to_numpy()
    if own.compactness == "inverse" and own.compact_m2 > 0:
        psi = psi / np.maximum(shapes["area_m2"].to_numpy() / own.compact_m2, 1)
    compact = (1 / psi if own.compactness == "literal" else psi) < own.max_compactness
    inside = chosen_cells(labels, compact)
    long = ledger.reject("compactness", LONG, np.where(inside, 0, labels))
    kept, left = label_zones(np.where(inside, labels, 0))
    ledger.count("compactness", count, left, long)
    return kept
