"""Description: from parts and regions on the lattice to the tables, rasters and counts that the database keeps."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import partial

import geopandas as gpd
import numpy as np
import pandas as pd
import shapely
from numpy.typing import NDArray

from msbdb.detect.scene import Regions, Scene
from msbdb.fuse.buildings import buildings_from_parts, covered_shares, label_buildings, link_labels, with_support
from msbdb.fuse.cellreasons import explain_cells, support_of
from msbdb.fuse.cells import is_fused
from msbdb.fuse.houses.touching import Division
from msbdb.fuse.probability import refuse
from msbdb.grid import Grid, GridSpec
from msbdb.kept import Packed, Rasters
from msbdb.ledger import sum_up
from msbdb.outline.fitting import outline_labels
from msbdb.outline.polygons import Geometries
from msbdb.params import POINT_DETECTORS, Params, VectorParams
from msbdb.parts.forest import Forest
from msbdb.spectral.coverclasses import Cover
from msbdb.tables import (
    BUILDING,
    CANDIDATE_REGION,
    FLAT_REGION,
    FLAT_REGION_CANDIDATE,
    PART,
    PART_CANDIDATE,
    PART_FLAT_REGION,
    REJECTION,
    REJECTION_COUNT,
    TABLES,
    Table,
    validate,
    validate_parts,
)
from msbdb.threads import in_threads, together


@dataclass(frozen=True, slots=True, eq=False)
class Description:
    """What one run found, as the database keeps it.

    Parameters
    ----------
    frames : dict of str to DataFrame
        The tables of the run by name.
    rasters : Rasters
        The kept rasters of the scene and the regions.
    counts : dict
        By detector and stage: regions in, kept and dropped.
    dropped : DataFrame
        ``tables.REJECTION`` of all detectors without geometry, also of regions that are too small for a row.
    packed : mapping of str to (ndarray, dict)
        Rasters that are compressed already, as `msbdb.kept.KeptRun` has them.
    """

    frames: dict[str, pd.DataFrame]
    rasters: Rasters
    counts: dict[str, dict[str, dict[str, int]]]
    dropped: pd.DataFrame
    packed: Packed = field(default_factory=dict)


def describe(
    scene: Scene,
    regions: Mapping[str, Regions],
    forest: Forest,
    params: Params,
    *,
    built: NDArray[np.bool_] | None = None,
    division: Division | None = None,
    rasters: Rasters | None = None,
) -> Description:
    """Return the tables, rasters and counts of a run.

    Parameters
    ----------
    scene : Scene
        Heights, land cover and evidence.
    regions : mapping of str to Regions
        Of each detector that was run.
    forest : Forest
        The parts; empty where the multi-scale detector was not run.
    params : Params
        Sections ``fuse``, ``surface`` and ``vector``.
    built : (H, W) ndarray of bool, optional
        The cells that the detectors took together; None where they did not decide together.
    division : Division, optional
        The houses in which the parts grew, and why; None where the detectors did not decide together.
    rasters : Rasters, optional
        Those of `describe_rasters`, where they are known.
    """
    # The tree of parts may have grown inside the cells of all detectors: its counts are those of the kept parts.
    counts = {name: found.counts for name, found in regions.items()} | {"multiscale": forest.counts}
    if built is not None:
        refused, stages = refuse(
            scene.heights, regions, built, params.fuse, mask_m=params.surface.mask_m, survey=scene.survey.name
        )
        counts["multiscale"] = stages | forest.counts
        forest = replace(forest, rejections=_joined(refused, [forest.rejections]))
    some = {name: stages for name, stages in counts.items() if stages}
    frames, reason = together(
        partial(make_frames, scene, regions, forest, params, division=division),
        partial(explain_cells, scene, regions, built, forest, params),
    )
    ledgers = [found.ledger for name, found in sorted(regions.items()) if name != "multiscale"]
    rasters = replace(rasters or describe_rasters(scene, regions), reason=reason)
    return Description(frames, rasters, some, _joined(forest.rejections, ledgers))


def outline_parts(forest: Forest, ndsm: Grid, params: VectorParams) -> gpd.GeoDataFrame:
    """Give every part its polygon (V47), and say whether it is fitted or traced, a scale at a time.

    The parts of one scale are a coverage, so that neighbours keep their shared edges (V48).
    """
    spec = ndsm.spec
    outlines, fitted = np.empty(len(forest.parts), dtype=object), np.zeros(len(forest.parts), dtype=np.bool_)
    ends = np.maximum.accumulate([0, *(int(labels.max(initial=0)) for labels in forest.labels)])

    def outline(scale: int) -> None:
        first, stop = int(ends[scale]), int(ends[scale + 1])
        labels = forest.labels[scale]
        local = np.maximum(labels - np.int32(first), 0)
        outlines[first:stop], fitted[first:stop] = outline_labels(local, stop - first, spec, params)

    in_threads(outline, [scale for scale in range(len(forest.labels)) if ends[scale] < ends[scale + 1]])
    parts = _outlined(forest.parts, outlines, fitted, spec)
    validate_parts(parts)
    return parts


def _outlined(rows: pd.DataFrame, outlines: Geometries, fitted: NDArray[np.bool_], spec: GridSpec) -> gpd.GeoDataFrame:
    """Return rows with their outlines, and where these are from."""
    source = np.where(fitted, "fitted", "traced").astype(object)
    return gpd.GeoDataFrame(rows.assign(outline_source=source), geometry=list(outlines), crs=spec.crs)


def make_frames(
    scene: Scene,
    regions: Mapping[str, Regions],
    forest: Forest,
    params: Params,
    *,
    division: Division | None = None,
) -> dict[str, pd.DataFrame]:
    """Return all tables of the run, checked against their declarations: the outlines of parts beside all others.

    Parameters
    ----------
    scene : Scene
        Heights and land cover.
    regions : mapping of str to Regions
        Of each detector that was run, also one without any region.
    forest : Forest
        The parts; empty where none were sought.
    params : Params
        Sections ``fuse``, ``heights``, ``surface`` and ``vector``.
    division : Division, optional
        The houses in which the parts grew, and why. Without it no building is divided.
    """
    (parts, buildings), frames = together(
        partial(
            together,
            partial(outline_parts, forest, scene.heights, params.vector),
            partial(_describe_buildings, scene, regions, forest, params, division),
        ),
        partial(_other_frames, scene, regions, forest, params),
    )
    frames["part"] = parts[[*PART.names, "geometry"]]
    frames["building"] = buildings[[*BUILDING.names, "geometry"]]
    for table in TABLES:
        validate(frames[table.name], table)
    return frames


def _describe_buildings(
    scene: Scene, regions: Mapping[str, Regions], forest: Forest, params: Params, division: Division | None
) -> gpd.GeoDataFrame:
    """Return the buildings in which the trees of parts stand, with all that the detectors support, and outlines."""
    spec, parts = scene.heights.spec, forest.parts
    labels = label_buildings(parts, forest.root_labels)
    buildings = buildings_from_parts(parts, labels, scene.heights, scene.elevations, params)
    fusion = params.fuse if is_fused(regions, params.fuse) else None
    shares = {name: covered_shares(labels, len(buildings), found.labels) for name, found in regions.items()}
    outlines, fitted = outline_labels(labels, len(buildings), spec, params.vector)
    buildings = with_support(buildings, shares, params=fusion)
    if division is not None:
        buildings = buildings.assign(divided_by=division.reasons_of(labels, len(buildings)))
    return _outlined(buildings, outlines, fitted, spec)


def _other_frames(
    scene: Scene, regions: Mapping[str, Regions], forest: Forest, params: Params
) -> dict[str, pd.DataFrame]:
    """Return all tables but those of the parts and the buildings."""
    spec = scene.heights.spec
    link = partial(link_labels, cell_area_m2=spec.cell_area_m2)
    flat = regions.get("flatregions") or no_regions("flatregions", FLAT_REGION, spec)
    candidates = [regions[name] for name in sorted(POINT_DETECTORS) if name in regions]
    part_ids, flat_ids = forest.parts["part_id"].to_numpy(), flat.table["region_id"].to_numpy()
    flat_links = link(forest.labels, part_ids, flat.labels, flat_ids, table=PART_FLAT_REGION)
    links = {"flatregions": flat_links} if "flatregions" in regions else {}
    between = []
    for found in candidates:
        ids = found.table["candidate_id"].to_numpy()
        links[found.method] = link(forest.labels, part_ids, found.labels, ids, table=PART_CANDIDATE)
        between.append(link([flat.labels], flat_ids, found.labels, ids, table=FLAT_REGION_CANDIDATE))
    rejections, counts = _ledger(forest, [flat, *candidates], params)
    points = shapely.points(rejections["xcen"].to_numpy(), rejections["ycen"].to_numpy())
    none = no_regions("area3d", CANDIDATE_REGION, spec)
    return {
        "scale": forest.scales,
        "spectral_class": scene.cover.table,
        "spectral_class_band": scene.cover.bands,
        "rejection": gpd.GeoDataFrame(rejections, geometry=points, crs=spec.crs),
        "rejection_count": counts,
        "flat_region": flat.table,
        "part_flat_region": flat_links,
        "candidate_region": _joined(none.table, [found.table for found in candidates]),
        "part_candidate": _joined(PART_CANDIDATE.empty(), [links[found.method] for found in candidates]),
        "flat_region_candidate": _joined(FLAT_REGION_CANDIDATE.empty(), between),
    }


def _ledger(forest: Forest, others: list[Regions], params: Params) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Return the ledgers of all detectors: rows for what could have been a building, and the numbers of all.

    That of the multi-scale detector is the tree of parts', which may have grown inside the cells of all detectors.
    """
    none = REJECTION_COUNT.empty()
    ledgers = [(forest.rejections, none)]
    ledgers += [(found.ledger, none if found.counted is None else found.counted) for found in others]
    divided = [sum_up(rows, counted, params.fuse.piece_m2) for rows, counted in ledgers]
    rows, counts = (list(frames) for frames in zip(*divided, strict=True))
    return _joined(rows[0], rows[1:]), _joined(counts[0], counts[1:])


def no_regions(method: str, table: Table, spec: GridSpec) -> Regions:
    """Return the regions of a detector that was not run."""
    rows = gpd.GeoDataFrame(table.empty(), geometry=[], crs=spec.crs)
    return Regions(method, np.zeros(spec.shape, dtype=np.int32), rows, REJECTION.empty(), {})


def _joined(first: pd.DataFrame, others: list[pd.DataFrame]) -> pd.DataFrame:
    """Return the rows of all frames as one frame of the first one's kind."""
    return pd.concat([first, *others], ignore_index=True)


def count_cells(heights: Grid, cover: Cover) -> dict[str, int]:
    """Count the cells: all, valid, and a class label each."""
    classes = cover.classes
    labels = classes.labels
    found = np.bincount(classes.index.ravel(), minlength=256)
    by_label: dict[str, int] = {}
    for index, label in sorted(labels.items()):
        by_label[label] = by_label.get(label, 0) + int(found[index])
    return {"all": int(heights.valid.size), "valid": int(np.count_nonzero(heights.valid)), **by_label}


def describe_choices(scene: Scene, params: Params) -> dict[str, object]:
    """Return what a run decided itself, to be kept with it (V21, X2): ground filter, scales, fit of the classes.

    Parameters
    ----------
    scene : Scene
        As prepared. The ground filter is ``given`` for a terrain raster; the fit of the classes by colour is None
        without imagery.
    params : Params
        With the scales that were used.
    """
    model = scene.cover.model
    return {
        "ground_filter": scene.require_surface().ground_filter,
        "scales_m2": list(params.scale.scales_m2),
        "spectral": model.as_dict() if model else None,
    }


def describe_rasters(scene: Scene, regions: Mapping[str, Regions]) -> Rasters:
    """Return the rasters that the database keeps, except for the reasons: all that is known after detection."""
    cover, evidence = scene.cover, scene.evidence
    return replace(
        Rasters.of_heights(scene.heights, cover.structure.index),
        spectral=None if cover.spectral is None else cover.spectral.index,
        regions={name: found.labels for name, found in regions.items() if name != "multiscale"},
        roughness_mm=None if evidence is None else evidence.roughness_mm,
        roof_probability=None if evidence is None else evidence.roof_probability,
        terrain_cm=scene.elevations.terrain_cm,
        echoes=scene.elevations.echoes,
        support=support_of(regions, scene.heights.spec.shape),
        answers={name: found.answers for name, found in regions.items() if found.answers is not None},
        parcels=scene.parcels,
        intensity=scene.intensity,
    )
