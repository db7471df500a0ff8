"""What a database holds, as plain values, as a map on a hillshade, and as layers for other programs."""

from dataclasses import asdict
from pathlib import Path
from typing import Any

import geopandas as gpd
from pyproj import CRS

from msbdb.database import (
    list_runs,
    opened,
    read_build,
    read_buildings,
    read_candidates,
    read_flat_regions,
    read_parts,
    shown,
)
from msbdb.kept import KeptRun
from msbdb.params import POINT_DETECTORS


def info_of(db: str | Path) -> dict[str, Any]:
    """Report what a database holds; see `msbdb.api.info`."""
    with opened(db) as engine:
        where = shown(engine.url)
        runs = list_runs(engine)
        found = []
        for row in runs.to_dict(orient="records"):
            build = read_build(engine, row["survey"])
            survey = asdict(build.survey)
            survey.pop("crs_wkt")
            head: dict[str, Any] = {str(name): value for name, value in row.items()}
            found.append({**head, **_counts(build), "survey_record": survey, "notices": list(build.run.notices)})
    return {"database": where, "runs": found}


def _counts(build: KeptRun) -> dict[str, Any]:
    """Count what a run holds."""
    parts, buildings = build.frames["part"], build.frames["building"]
    return {
        "buildings": len(buildings),
        "parts": len(parts),
        "flat_regions": len(build.frames["flat_region"]),
        "candidate_regions": build.candidate_counts,
        "rejected": len(build.frames["rejection"]),
        "footprint_m2": round(float(buildings["area_m2"].sum()), 1),
        "volume_m3": round(float(buildings["volume_m3"].sum()), 1),
        "highest_m": round(float(buildings["h_max"].max()), 2) if len(buildings) else None,
        "scales_m2": build.frames["scale"].sort_values("scale")["threshold_m2"].tolist(),
        "seconds": round(sum(build.run.timings.values()), 2),
        "chosen": build.run.counts.chosen,
    }


def draw(db: str | Path, out: Path, *, survey: str | None, of: str) -> None:
    """Draw a map; see `msbdb.api.view`."""
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
    from msbdb.export import export
    from msbdb.run.store import has_together, read_together

    with opened(db) as engine:
        layers = {
            "footprint": read_buildings(engine, survey),
            "part": read_parts(engine, survey),
            "flat_region": read_flat_regions(engine, survey),
            "candidate_region": read_candidates(engine, survey),
        }
        if has_together(engine, survey):
            layers["together"] = read_together(engine, survey)
    export(layers, out, overwrite=overwrite)
