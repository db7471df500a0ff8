"""From a forest on the lattice to the tables that the database takes."""

from collections.abc import Sequence
from functools import partial

import geopandas as gpd
import numpy as np
import pandas as pd
import shapely

from msbdb.detect.candidatelayer import CandidateLayer
from msbdb.detect.flatregions.flatlayer import Flat
from msbdb.fuse.buildings import buildings_from_parts, covered_shares, link_labels, witnessed
from msbdb.grid import Grid
from msbdb.outline.polygons import polygonise
from msbdb.outline.simplification import simplify_coverage
from msbdb.params import VectorParams
from msbdb.parts.forest import Forest
from msbdb.spectral.coverclasses import Cover
from msbdb.tables import (
    BUILDING,
    CANDIDATE_REGION,
    FLAT_REGION_CANDIDATE,
    PART,
    PART_CANDIDATE,
    PART_FLAT_REGION,
    TABLES,
    validate,
    validate_parts,
)


def outline_parts(forest: Forest, ndsm: Grid, params: VectorParams) -> gpd.GeoDataFrame:
    """Give every part its polygon (V47): traced along its cells, then freed of the zig-zag, a scale at a time.

    The parts of one scale are a coverage, so that neighbours keep their shared edges (V48).
    """
    spec = ndsm.spec
    outlines = np.empty(len(forest.parts), dtype=object)
    offset = 0
    for labels in forest.labels:
        count = int(labels.max(initial=0)) - offset
        if count <= 0:
            continue
        local = np.where(labels > 0, labels - offset, 0).astype(np.int32)
        traced = polygonise(local, spec, count)
        outlines[offset : offset + count] = simplify_coverage(traced, params.simplify_px * spec.cell_m)
        offset += count
    parts = gpd.GeoDataFrame(forest.parts, geometry=list(outlines), crs=spec.crs)
    validate_parts(parts)
    return parts


def make_frames(
    forest: Forest,
    parts: gpd.GeoDataFrame,
    cover: Cover,
    flat: Flat,
    candidates: Sequence[CandidateLayer],
    *,
    ndsm: Grid,
) -> dict[str, pd.DataFrame]:
    """Return all tables of the build, checked against their declarations.

    ``candidates`` has one layer for each extractor on the points that was run, also where it found nothing.
    """
    link = partial(link_labels, cell_area_m2=ndsm.spec.cell_area_m2)
    part_ids, flat_ids = parts["part_id"].to_numpy(), flat.regions["region_id"].to_numpy()
    flat_links = link(forest.labels, part_ids, flat.labels, flat_ids, table=PART_FLAT_REGION)
    heard = {"flatregions": flat_links} if flat.extracted else {}
    between = []
    for layer in candidates:
        ids = layer.regions["candidate_id"].to_numpy()
        heard[layer.method] = link(forest.labels, part_ids, layer.labels, ids, table=PART_CANDIDATE)
        between.append(link([flat.labels], flat_ids, layer.labels, ids, table=FLAT_REGION_CANDIDATE))
    buildings = buildings_from_parts(parts, forest.root_labels, ndsm)
    roots = buildings["root_id"].to_numpy()
    buildings = witnessed(buildings, {name: covered_shares(roots, links) for name, links in heard.items()})
    rejections = _joined(forest.rejections, [flat.rejections, *(layer.rejections for layer in candidates)])
    points = shapely.points(rejections["xcen"].to_numpy(), rejections["ycen"].to_numpy())
    crs = ndsm.spec.crs
    no_regions = gpd.GeoDataFrame(CANDIDATE_REGION.empty(), geometry=[], crs=crs)
    frames = {
        "scale": forest.scales,
        "part": parts[[*PART.names, "geometry"]],
        "spectral_class": cover.table,
        "spectral_class_band": cover.bands,
        "rejection": gpd.GeoDataFrame(rejections, geometry=points, crs=crs),
        "building": buildings[[*BUILDING.names, "geometry"]],
        "flat_region": flat.regions,
        "part_flat_region": flat_links,
        "candidate_region": _joined(no_regions, [layer.regions for layer in candidates]),
        "part_candidate": _joined(PART_CANDIDATE.empty(), [heard[layer.method] for layer in candidates]),
        "flat_region_candidate": _joined(FLAT_REGION_CANDIDATE.empty(), between),
    }
    for table in TABLES:
        validate(frames[table.name], table)
    return frames


def _joined(first: pd.DataFrame, others: list[pd.DataFrame]) -> pd.DataFrame:
    """Return the rows of all frames as one frame of the first one's kind."""
    return pd.concat([first, *others], ignore_index=True)
