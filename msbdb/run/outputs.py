"""What a database holds, as plain values, as a map on a hillshade, and as layers for other programs.

Each function imports what it alone needs, so that a summary and an export are quick.
"""

from dataclasses import asdict
from pathlib import Path
from typing import Any

from msbdb.database import RunSummary, crs_of, opened, read_build, read_columns, run_heads, shown, summarise_run
from msbdb.errors import counted
from msbdb.params import POINT_DETECTORS
from msbdb.tables import BUILDING, CANDIDATE_REGION, FLAT_REGION, PART

LAYERS = {"footprint": BUILDING, "part": PART, "flat_region": FLAT_REGION, "candidate_region": CANDIDATE_REGION}
"""The layers of an export and their tables."""


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
        "rejected": summary.rejected,
        "footprint_m2": round(summary.footprint_m2, 1),
        "volume_m3": round(summary.volume_m3, 1),
        "highest_m": None if summary.highest_m is None else round(summary.highest_m, 2),
        "scales_m2": summary.scales_m2,
        "seconds": round(sum(summary.run.timings.values()), 2),
        "chosen": summary.run.counts.chosen,
    }


def draw(db: str | Path, out: Path, *, survey: str | None, of: str, overwrite: bool) -> None:
    """Draw a map; see `msbdb.api.view`."""
    from msbdb.io.files import PICTURES, require_output

    require_output(out, overwrite=overwrite, endings=PICTURES, sources=[db])
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
        title = f"{build.survey.name}: {counted(len(regions), 'flat region')}"
        draw_zones(gpd.GeoDataFrame(regions), relief, out, title=title, subtitle=subtitle)
        return
    if of in POINT_DETECTORS:
        frame = build.frames["candidate_region"]
        chosen = gpd.GeoDataFrame(frame[frame["method"] == of])
        title = f"{build.survey.name}: {counted(len(chosen), 'candidate region')} of {of}"
        draw_candidates(chosen, relief, out, title=title, subtitle=subtitle)
        return
    buildings = counted(len(build.frames["building"]), "building")
    draw_map(
        build.frames["part"],
        build.frames["building"],
        relief,
        out,
        title=f"{build.survey.name}: {buildings} in {counted(len(build.frames['part']), 'part')}",
        subtitle=subtitle,
        thresholds_m2=dict(zip(scales["scale"].tolist(), scales["threshold_m2"].tolist(), strict=True)),
    )


def write_layers(db: str | Path, out: Path, *, survey: str | None, overwrite: bool) -> None:
    """Write parts and footprints; see `msbdb.api.export`."""
    from msbdb.export import export
    from msbdb.export.formats import FORMATS
    from msbdb.io.files import require_output
    from msbdb.io.layers import Layer, crs_text

    require_output(out, overwrite=overwrite, endings=tuple(FORMATS), sources=[db])
    with opened(db) as engine:
        read, found = read_columns(engine, tuple(LAYERS.values()), survey)
    # A code needs no PROJ, which takes time to load.
    crs = f"EPSG:{found.epsg}" if found.epsg else crs_text(crs_of(found))
    layers = {}
    for name, table in LAYERS.items():
        columns = read[table.name]
        layers[name] = Layer({own: columns[own] for own in table.names}, columns["geometry"], crs)
    export(layers, out, overwrite=overwrite)
