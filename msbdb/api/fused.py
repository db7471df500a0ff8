"""Footprints of parts and flat regions together, as outlines, from a database."""

import geopandas as gpd
import numpy as np
from numpy.typing import NDArray

from msbdb.database import Engine, read_buildings, read_run, read_state, read_survey
from msbdb.errors import InputError
from msbdb.grid import Grid
from msbdb.labels import height_statistics, order_heights, reorder, sizes, sums
from msbdb.outline.polygons import polygonise
from msbdb.outline.simplification import simplify_coverage
from msbdb.params import Params, with_values
from msbdb.run.kept import lattice_of, unpack_heights

NOT_THERE = (
    "The survey '{survey}' has no footprints of parts and flat regions together. Build it with the extractors "
    "multiscale and flatregions; 'msbdb classes --set' cannot make up for what an older msbdb did not keep."
)


def has_together(engine: Engine, survey: str | None = None) -> bool:
    """Tell whether a survey has footprints of parts and flat regions together."""
    return "together" in read_state(engine, survey)


def read_together(engine: Engine, survey: str | None = None) -> gpd.GeoDataFrame:
    """Return the footprints of parts and flat regions together, measured anew, a row a building, in order of the ids.

    Parameters
    ----------
    engine : Engine
        An open database.
    survey : str, optional
        Not needed where the database holds one.

    Returns
    -------
    GeoDataFrame
        ``building_id``, ``root_id``, ``state`` and ``storeys`` of the building; ``h_max``, ``h_mean``, ``h_p50`` and
        ``h_p90`` (m), ``area_m2`` and ``volume_m3`` (heights below 0 count as 0) of the fused footprint's cells, and
        its outline. Buildings of which nothing is left are not there.

    Raises
    ------
    InputError
        When the survey was built without one of the two extractors, or by an msbdb that did not fuse them.
    """
    record, state = read_survey(engine, survey), read_state(engine, survey)
    if "together" not in state:
        raise InputError(NOT_THERE.format(survey=record.name))
    values: dict[str, object] = read_run(engine, survey).parameters
    params = with_values(Params(), values)  # type: ignore[arg-type]  # plain nested values
    spec = lattice_of(record, state)
    buildings = read_buildings(engine, survey)
    kept = np.asarray(state["together"], dtype=np.int32)
    there = np.flatnonzero(sizes(kept, len(buildings)))
    labels = reorder(kept, there, len(buildings))
    rows = buildings.iloc[there][["building_id", "root_id", "state", "storeys"]].reset_index(drop=True)
    rows = rows.assign(**_measured(labels, len(there), unpack_heights(state, spec)))
    outlines = polygonise(labels, spec, len(there)) if len(there) else np.empty(0, dtype=object)
    shapes = list(simplify_coverage(outlines, params.vector.simplify_px * spec.cell_m)) if len(there) else []
    return gpd.GeoDataFrame(rows, geometry=shapes, crs=spec.crs)


def _measured(labels: NDArray[np.int32], count: int, heights: Grid) -> dict[str, NDArray[np.float64]]:
    """Return heights, areas and volumes of labelled footprints."""
    found = height_statistics(labels, slice(0, count), order_heights(heights, labels > 0))
    above = np.where(heights.valid, np.maximum(np.asarray(heights.values, dtype=np.float64), 0), 0)
    cell_m2 = heights.spec.cell_area_m2
    return {
        **{name: found[name].to_numpy() for name in ("h_max", "h_mean", "h_p50", "h_p90")},
        "area_m2": sizes(labels, count) * cell_m2,
        "volume_m3": sums(labels, above, count) * cell_m2,
    }
