"""From a forest on the lattice to the tables that the database takes."""

import geopandas as gpd
import numpy as np
import pandas as pd
import shapely

from msbdb.extract.multiscale.forest import Forest
from msbdb.grid import Grid
from msbdb.inventory.buildings import buildings_from_parts
from msbdb.inventory.evidence import flat_shares, link_parts, witnessed
from msbdb.params import VectorParams
from msbdb.pipeline.cover import Cover
from msbdb.pipeline.flat import Flat
from msbdb.tables import BUILDING, PART, TABLES, validate, validate_parts
from msbdb.vector.polygons import polygonise
from msbdb.vector.simplify import simplify_coverage


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
    forest: Forest, parts: gpd.GeoDataFrame, cover: Cover, flat: Flat, ndsm: Grid
) -> dict[str, pd.DataFrame]:
    """Return all tables of the build, checked against their declarations."""
    links = link_parts(
        forest.labels,
        parts["part_id"].to_numpy(),
        flat.labels,
        flat.regions["region_id"].to_numpy(),
        cell_area_m2=ndsm.spec.cell_area_m2,
    )
    buildings = buildings_from_parts(parts, forest.root_labels, ndsm)
    if flat.extracted:
        buildings = witnessed(buildings, flat_shares(buildings["root_id"].to_numpy(), links))
    rejections = pd.concat([forest.rejections, flat.rejections], ignore_index=True)
    points = shapely.points(rejections["xcen"].to_numpy(), rejections["ycen"].to_numpy())
    frames = {
        "scale": forest.scales,
        "part": parts[[*PART.names, "geometry"]],
        "spectral_class": cover.table,
        "spectral_class_band": cover.bands,
        "rejection": gpd.GeoDataFrame(rejections, geometry=points, crs=ndsm.spec.crs),
        "building": buildings[[*BUILDING.names, "geometry"]],
        "flat_region": flat.regions,
        "part_flat_region": links,
    }
    for table in TABLES:
        validate(frames[table.name], table)
    return frames
