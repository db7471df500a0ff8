"""What a database holds, as plain values, as a map on a hillshade, and as layers for other programs.

Each function imports what it alone needs, so that a summary and an export are quick.
"""

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from msbdb.database import Engine, RunSummary, opened, read_build, run_heads, shown, summarise_run
from msbdb.errors import InputError
from msbdb.kept import KeptRun
from msbdb.params import POINT_DETECTORS, Params, with_values
from msbdb.tables import BUILDING, CANDIDATE_REGION, FLAT_REGION, PART

if TYPE_CHECKING:
    import geopandas as gpd
    import numpy as np
    from numpy.typing import NDArray

    from msbdb.grid import Grid

LAYERS = {"footprint": BUILDING, "part": PART, "flat_region": FLAT_REGION, "candidate_region": CANDIDATE_REGION}
"""The layers of an export and their tables."""

NOT_FUSED = (
    "The survey '{survey}' has no fused footprints. Build it again with the detectors multiscale and flatregions; "
    "'msbdb classes --set' cannot replace what an older msbdb did not keep."
)


def info_of(db: str | Path) -> dict[str, Any]:
    """Report what a database holds; see `msbdb.api.info`."""
    with opened(db) as engine:
        where = shown(engine.url)
        found = []
        for head in run_heads(engine):
            summary = summarise_run(engine, head["survey"])
            survey = asdict(summary.survey)
            survey.pop("crs_wkt")
            found.append({**head, **_counts(summary), "survey_record": survey, "notices": list(summary.run.notices)})
    return {"database": where, "runs": found}


def _counts(summary: RunSummary) -> dict[str, Any]:
    """Return the numbers of a run as ``info`` shows them."""
    return {
        "buildings": summary.rows["building"],
        "parts": summary.rows["part"],
        "flat_regions": summary.rows["flat_region"],
        "candidate_regions": summary.candidates,
        "rejected": summary.rows["rejection"],
        "footprint_m2": round(summary.footprint_m2, 1),
        "volume_m3": round(summary.volume_m3, 1),
        "highest_m": None if summary.highest_m is None else round(summary.highest_m, 2),
        "scales_m2": summary.scales_m2,
        "seconds": round(sum(summary.run.timings.values()), 2),
        "chosen": summary.run.counts.chosen,
    }


def draw(db: str | Path, out: Path, *, survey: str | None, of: str) -> None:
    """Draw a map; see `msbdb.api.view`."""
    import geopandas as gpd
    from pyproj import CRS

    from msbdb.view.buildingmap import draw_map
    from msbdb.view.regionmap import draw_candidates, draw_zones

    with opened(db) as engine:
        build = read_build(engine, survey)
    relief = build.heights
    scales, regions = build.frames["scale"], build.frames["flat_region"]
    place = CRS.from_wkt(build.survey.crs_wkt).name
    subtitle = " · ".join(word for word in (build.survey.date, place, f"cell {build.survey.cell_m:g} m") if word)
    if of == "flatregions":
        title = f"{build.survey.name}: {len(regions)} flat regions"
        draw_zones(gpd.GeoDataFrame(regions), relief, out, title=title, subtitle=subtitle)
        return
    if of in POINT_DETECTORS:
        frame = build.frames["candidate_region"]
        chosen = gpd.GeoDataFrame(frame[frame["method"] == of])
        title = f"{build.survey.name}: {len(chosen)} candidate regions of {of}"
        draw_candidates(chosen, relief, out, title=title, subtitle=subtitle)
        return
    draw_map(
        build.frames["part"],
        build.frames["building"],
        relief,
        out,
        title=f"{build.survey.name}: {len(build.frames['building'])} buildings in {len(build.frames['part'])} parts",
        subtitle=subtitle,
        thresholds_m2=dict(zip(scales["scale"].tolist(), scales["threshold_m2"].tolist(), strict=True)),
    )


def write_layers(db: str | Path, out: Path, *, survey: str | None, overwrite: bool) -> None:
    """Write parts and footprints; see `msbdb.api.export`."""
    import geopandas as gpd

    from msbdb.export import export

    with opened(db) as engine:
        build = read_build(engine, survey, tables=tuple(LAYERS.values()))
    layers = {layer: gpd.GeoDataFrame(build.frames[table.name]) for layer, table in LAYERS.items()}
    if build.rasters.fused is not None:
        layers["together"] = _together(build)
    export(layers, out, overwrite=overwrite)


def read_together(engine: Engine, survey: str | None = None) -> "gpd.GeoDataFrame":
    """Return the fused footprints of parts and flat regions, measured again: a row a building, in order of the ids.

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
        its outline. Buildings without any cell in the fused footprints have no row.

    Raises
    ------
    InputError
        When the survey was built without one of the two detectors, or by an msbdb that did not fuse them.
    """
    return _together(read_build(engine, survey, tables=(BUILDING,)))


def _together(build: KeptRun) -> "gpd.GeoDataFrame":
    """Return what `read_together` does, from a run with its buildings."""
    import geopandas as gpd
    import numpy as np

    from msbdb.kept import lattice_of
    from msbdb.labels import reorder, sizes
    from msbdb.outline.polygons import polygonise
    from msbdb.outline.simplification import simplify_coverage

    kept = build.rasters.fused
    if kept is None:
        raise InputError(NOT_FUSED.format(survey=build.survey.name))
    values: dict[str, object] = build.run.parameters
    params = with_values(Params(), values)  # type: ignore[arg-type]  # plain nested values
    spec = lattice_of(build.survey)
    buildings = build.frames["building"]
    there = np.flatnonzero(sizes(kept, len(buildings)))
    labels = reorder(kept, there, len(buildings))
    rows = buildings.iloc[there][["building_id", "root_id", "state", "storeys"]].reset_index(drop=True)
    rows = rows.assign(**_measured(labels, len(there), build.heights))
    outlines = polygonise(labels, spec, len(there)) if len(there) else np.empty(0, dtype=object)
    shapes = list(simplify_coverage(outlines, params.vector.simplify_px * spec.cell_m)) if len(there) else []
    return gpd.GeoDataFrame(rows, geometry=shapes, crs=spec.crs)


def _measured(labels: "NDArray[np.int32]", count: int, heights: "Grid") -> "dict[str, NDArray[np.float64]]":
    """Return heights, areas and volumes of labelled footprints."""
    import numpy as np

    from msbdb.labels import height_statistics, order_heights, sizes, sums

    found = height_statistics(labels, slice(0, count), order_heights(heights, labels > 0))
    above = np.where(heights.valid, np.maximum(np.asarray(heights.values, dtype=np.float64), 0), 0)
    cell_m2 = heights.spec.cell_area_m2
    return {
        **{name: found[name].to_numpy() for name in ("h_max", "h_mean", "h_p50", "h_p90")},
        "area_m2": sizes(labels, count) * cell_m2,
        "volume_m3": sums(labels, above, count) * cell_m2,
    }
