"""The rasters of a run that the database keeps, so that classes can be re-labelled without the source data."""

from collections.abc import Mapping, Sequence

import geopandas as gpd
import numpy as np
import pandas as pd
from affine import Affine
from numpy.typing import NDArray
from pyproj import CRS

from msbdb.detect.candidatelayer import CandidateLayer
from msbdb.detect.flatregions.flatlayer import Flat, no_flat_regions
from msbdb.fuse.footprints import Evidence, Together
from msbdb.grid import Grid, GridSpec
from msbdb.landcover import ClassMap
from msbdb.params import POINT_DETECTORS
from msbdb.spectral.coverclasses import Cover
from msbdb.surface.heights import PER_METRE
from msbdb.tables import REJECTION, Build, Survey

State = Mapping[str, NDArray[np.generic]]


def pack_state(
    ndsm: Grid, cover: Cover, flat: Flat, candidates: Sequence[CandidateLayer], together: Together | None = None
) -> dict[str, NDArray[np.generic]]:
    """Return the rasters to keep: heights in whole centimetres, where they hold, class maps, labels of the regions.

    Of the fused footprints, the labels of the buildings and the evidence from which they can be fused again.
    """
    state: dict[str, NDArray[np.generic]] = {
        "ndsm_cm": np.round(np.asarray(ndsm.values, dtype=np.float64) * PER_METRE).astype(np.int32),
        "valid": ndsm.valid.astype(np.uint8),
        "structure": cover.structure.index,
    }
    if cover.spectral is not None:
        state["spectral"] = cover.spectral.index
    if flat.extracted:
        state["flat"] = flat.labels
        if flat.firm is not None:
            state["flat_firm"] = flat.firm.astype(np.uint8)
    state |= {layer.method: layer.labels for layer in candidates}
    return state if together is None else state | together.state()


def unpack_flat(build: Build, spec: GridSpec) -> Flat:
    """Return the flat regions of a kept run, with what they wrote into ledger and counts."""
    if "flat" not in build.state:
        return no_flat_regions(spec)
    rejections, counts = _written_by(build, "flatregions")
    frame = build.frames["flat_region"].sort_values("region_id", ignore_index=True)
    labels = build.state["flat"].astype(np.int32)
    firm = build.state["flat_firm"].astype(np.bool_) if "flat_firm" in build.state else None
    return Flat(labels, gpd.GeoDataFrame(frame), rejections, counts, extracted=True, firm=firm)


def unpack_candidates(build: Build) -> tuple[CandidateLayer, ...]:
    """Return the candidate regions of a kept run, a layer an extractor, with what they wrote into ledger and counts."""
    frame = build.frames["candidate_region"].sort_values("candidate_id", ignore_index=True)
    layers = []
    for method in (name for name in build.run.methods if name in POINT_DETECTORS):
        regions = gpd.GeoDataFrame(frame[frame["method"] == method].reset_index(drop=True))
        labels = build.state[method].astype(np.int32)
        layers.append(CandidateLayer(method, labels, regions, *_written_by(build, method)))
    return tuple(layers)


def _written_by(build: Build, method: str) -> tuple[pd.DataFrame, dict[str, dict[str, int]]]:
    """Return the ledger rows and the counts by stage of an extractor."""
    ledger = build.frames["rejection"]
    own = ledger.loc[ledger["method"] == method, REJECTION.names]
    regions: dict[str, dict[str, dict[str, int]]] = build.run.counts["regions"]  # type: ignore[assignment]  # plain nested values
    return own, regions.get(method, {})


def unpack_evidence(state: State) -> Evidence | None:
    """Return each cell's evidence of roof, as a kept run has it; None where the run has none."""
    if "roof_probability" not in state:
        return None
    return Evidence(state["roughness_mm"].astype(np.uint16), state["roof_probability"].astype(np.uint8))


def lattice_of(survey: Survey, state: State) -> GridSpec:
    """Return the lattice on which a survey's rasters lie."""
    west, _, _, north = survey.bounds
    transform = Affine(survey.cell_m, 0.0, west, 0.0, -survey.cell_m, north)
    rows, cols = state["valid"].shape
    return GridSpec((rows, cols), transform, CRS.from_wkt(survey.crs_wkt))


def unpack_heights(state: State, spec: GridSpec) -> Grid:
    """Return the nDSM of a kept run, to the bit."""
    values = (np.asarray(state["ndsm_cm"], dtype=np.float64) / PER_METRE).astype(np.float32)
    return Grid(values, state["valid"].astype(np.bool_), spec)


def unpack_cover(build: Build, spec: GridSpec) -> Cover:
    """Return the land cover of a kept run, with the operator's labels so far."""
    state, table = build.state, build.frames["spectral_class"]
    structure = ClassMap(state["structure"].astype(np.uint8), {1: "building", 2: "vegetation"}, spec)
    labels = dict(zip(table["speindex"].tolist(), table["label"].tolist(), strict=True))
    by_operator = set(table.loc[table["labelled_by"] == "operator", "speindex"].tolist())
    colours = set(table.loc[table["source"] == "spectral", "speindex"].tolist())
    spectral = None
    if "spectral" in state:
        spectral = ClassMap(state["spectral"].astype(np.uint8), {k: labels[k] for k in colours}, spec)
    rule = build.run.counts["cover"]
    return Cover(
        structure=structure,
        spectral=spectral,
        table=table,
        bands=build.frames["spectral_class_band"],
        colours_decide=bool(rule["colours_decide"]),  # type: ignore[index]  # counts are plain nested values
        green_decides=bool(rule["green_decides"]),  # type: ignore[index]
        operator={k: labels[k] for k in by_operator},
    )
