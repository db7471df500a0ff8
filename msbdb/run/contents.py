"""What a database holds, as plain values and as a map on a hillshade.

Each function imports what it alone needs, so that a summary is quick.
"""

import math
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from msbdb.database import (
    LAST_DAY,
    Engine,
    RunSummary,
    current_pieces,
    database_crs_of,
    footprint_at,
    has_inventory,
    opened,
    read_rasters,
    read_scales,
    read_survey,
    read_tables,
    run_heads,
    shown,
    summarise_inventory,
    summarise_run,
)
from msbdb.errors import InputError, PassingNotice, counted, give_notice
from msbdb.kept import heights_of, lattice_of
from msbdb.params import POINT_DETECTORS, REGION_DETECTORS
from msbdb.tables import BUILDING, CANDIDATE_REGION, DETECTOR_SHARES, FLAT_REGION, PART

if TYPE_CHECKING:
    import geopandas as gpd
    import numpy as np
    import shapely
    from numpy.typing import NDArray

    from msbdb.grid import Bands, Grid, GridSpec

    Rasters = list[tuple[GridSpec, NDArray[np.uint8]]]

Bounds = tuple[float, float, float, float]

LAYERS = {"footprint": BUILDING, "part": PART, "flat_region": FLAT_REGION, "candidate_region": CANDIDATE_REGION}
"""The layers of a map and their tables."""

MAPS = ("parts", "footprints", "detectors", "change", "probability", "reasons", *REGION_DETECTORS)
"""What a map shows."""

LARGEST_PHOTO = 2000
"""Most cells a side of an orthophoto on the page (ours), as of the light and shadow."""

FINEST_PHOTO = 0.1
"""Finest cell of an orthophoto on the page, metres (ours); finer pixels are averaged."""

EMPTY_MAP = (0.0, 0.0, 100.0, 100.0)
"""Extent of a map of nothing, metres."""


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
        inventory = summarise_inventory(engine)
    return {"database": where, "runs": found, "inventory": inventory}


def _counts(summary: RunSummary) -> dict[str, Any]:
    """Return the numbers of a run as ``info`` shows them."""
    return {
        "buildings": summary.rows["building"],
        "parts": summary.rows["part"],
        "flat_regions": summary.rows["flat_region"],
        "candidate_regions": summary.candidates,
        "rejected": summary.rejected,
        "rejected_rows": summary.rejected_rows,
        "footprint_m2": round(summary.footprint_m2, 1),
        "volume_m3": round(summary.volume_m3, 1),
        "highest_m": None if summary.highest_m is None else round(summary.highest_m, 2),
        "scales_m2": summary.scales_m2,
        "seconds": round(sum(summary.run.timings.values()), 2),
        "chosen": summary.run.counts.chosen,
    }


@dataclass(frozen=True, slots=True)
class Choice:
    """What an output is made of.

    ``surveys`` has the names, the newest first. ``present`` is set where the buildings are those of the current
    inventory, and not those of each survey.
    """

    surveys: tuple[str, ...]
    present: bool

    @property
    def is_one(self) -> bool:
        """Whether it is one survey, as that found it."""
        return len(self.surveys) == 1 and not self.present


def choose(engine: Engine, survey: str | None) -> Choice:
    """Return what an output is made of: the named survey, else the current inventory, else all surveys.

    Gives a notice where that is more or less than one survey.
    """
    if survey is not None:
        return Choice((survey,), present=False)
    heads = sorted(run_heads(engine), key=lambda head: str(head["date"]), reverse=True)
    choice = Choice(tuple(str(head["survey"]) for head in heads), present=has_inventory(engine))
    tell_choice(engine, choice)
    return choice


def tell_choice(engine: Engine, choice: Choice, *, named: bool = False) -> None:
    """Give a notice of what an output is made of, where that is more or less than one survey and nobody named it."""
    several = f"{len(choice.surveys)} surveys: {', '.join(choice.surveys)}"
    if choice.present:
        msg = "The buildings are those of the current inventory. --survey NAME takes those of one survey."
    elif not choice.surveys:
        msg = f"The database {shown(engine.url)} has no survey and no inventory yet; the output is empty."
    else:
        msg = f"The database has {several}. All are taken, the newest first; --survey NAME takes one."
    if not choice.is_one and not named:
        give_notice(msg, PassingNotice, stacklevel=3)


def draw(db: str | Path, out: Path, *, survey: str | None, what: str, aoi: Path | None, overwrite: bool) -> None:
    """Draw a map; see `msbdb.api.view`."""
    from msbdb.io.files import PAGE, PICTURES, require_output

    require_output(out, overwrite=overwrite, endings=(*PICTURES, PAGE), sources=[db, *([aoi] if aoi else [])])
    if what not in MAPS:
        msg = f"There is no map of {what!r}. Choose one of {', '.join(MAPS)}."
        raise InputError(msg)
    if what == "change":
        from msbdb.run.inventory.changed import changes_of

        changes_of(db, survey=survey, aoi=aoi, figure=out, overwrite=overwrite)
        return
    with opened(db) as engine:
        choice = of_one_place(engine, choose(engine, survey))
        frames, thresholds = _frames(engine, choice), _thresholds(engine, choice)
        relief = relief_for(engine, choice, frames["footprint"])
        rasters = reason_rasters(engine, choice) if what == "reasons" else []
        dates = [read_survey(engine, name).date for name in choice.surveys]
    if len(dates) > 1:  # the newest are drawn last, on top
        frames = {layer: frame.iloc[::-1] for layer, frame in frames.items()}
    if choice.present:
        buildings = frames["footprint"]
        here = buildings["survey"].isna() | buildings["survey"].isin(choice.surveys)
        frames["footprint"] = buildings[here & (buildings["state"] != "refuted")]
    if aoi is not None:
        area = area_of(aoi, relief)
        frames = {layer: frame[frame.intersects(area)] for layer, frame in frames.items()}
        relief = within(relief, area)
    name = choice.surveys[0] if choice.is_one else "Inventory" if choice.present else f"{len(dates)} surveys"
    words = (max(dates, default=""), relief.spec.crs.name, f"cell {relief.spec.cell_m:g} m")
    subtitle = " · ".join(word for word in words if word)
    _draw_one(frames, relief, out, what, name=name, subtitle=subtitle, thresholds=thresholds, rasters=rasters)


def _draw_one(
    frames: "dict[str, gpd.GeoDataFrame]",
    relief: "Grid",
    out: Path,
    what: str,
    *,
    name: str,
    subtitle: str,
    thresholds: dict[int, float],
    rasters: "Rasters",
) -> None:
    """Draw one of the maps."""
    from msbdb.view.buildingmap import draw_map
    from msbdb.view.buildingthemes import draw_heights, draw_probability, draw_reasons, draw_support
    from msbdb.view.regionmap import draw_candidates, draw_zones

    parts, buildings, regions = frames["part"], frames["footprint"], frames["candidate_region"]
    count = counted(len(buildings), "building")
    if what == "flatregions":
        zones = frames["flat_region"]
        draw_zones(zones, relief, out, title=f"{name}: {counted(len(zones), 'flat region')}", subtitle=subtitle)
    elif what in POINT_DETECTORS:
        regions = regions[regions["method"] == what]
        title = f"{name}: {counted(len(regions), 'candidate region')} of {what}"
        draw_candidates(regions, relief, out, title=title, subtitle=subtitle)
    elif what == "footprints":
        draw_heights(buildings, relief, out, title=f"{name}: {count}", subtitle=subtitle)
    elif what == "detectors":
        shares = {method: column for method, column in DETECTOR_SHARES.items() if column in buildings}
        draw_support(buildings, shares, relief, out, title=f"{name}: {count}, by detectors", subtitle=subtitle)
    elif what == "probability":
        draw_probability(buildings, relief, out, title=f"{name}: {count}, by probability", subtitle=subtitle)
    elif what == "reasons":
        title = f"{name}: why there is no building"
        draw_reasons(buildings, rasters, relief, out, title=title, subtitle=subtitle)
    else:
        title = f"{name}: {count} in {counted(len(parts), 'part')}"
        draw_map(parts, buildings, relief, out, title=title, subtitle=subtitle, thresholds_m2=thresholds)


def reason_rasters(engine: Engine, choice: Choice) -> "Rasters":
    """Return the rasters of reasons of the surveys, the newest first, of runs that kept one."""
    found = (
        (lattice_of(read_survey(engine, name)), read_rasters(engine, name, more=["reason"]).reason)
        for name in choice.surveys
    )
    return [(spec, own) for spec, own in found if own is not None]


def area_of(aoi: Path, relief: "Grid") -> "shapely.Geometry":
    """Return the polygons of a file as one, in the CRS of the heights.

    Raises
    ------
    InputError
        When no cell of the heights lies in their bounds.
    """
    from msbdb.io.files import require_input
    from msbdb.io.vector import read_polygons

    require_input(aoi)
    area = read_polygons(aoi, to=relief.spec.crs).union_all()
    west, south, east, north = relief.spec.bounds
    box = area.bounds
    if box[0] >= east or box[2] <= west or box[1] >= north or box[3] <= south:
        msg = f"The polygons of {aoi.name} lie beside the surveys, which reach {_extent(relief)}. Give an area inside."
        raise InputError(msg)
    return area


def _extent(relief: "Grid") -> str:
    west, south, east, north = relief.spec.bounds
    return f"from {west:.0f} to {east:.0f} east and from {south:.0f} to {north:.0f} north"


def within(relief: "Grid", area: "shapely.Geometry") -> "Grid":
    """Return the cells of heights in the bounds of an area."""
    import numpy as np

    from msbdb.grid import Grid

    west, south, east, north = area.bounds
    edge_west, _, _, edge_north = relief.spec.bounds
    cell, (rows, cols) = relief.spec.cell_m, relief.spec.shape
    first = np.floor([(edge_north - north) / cell, (west - edge_west) / cell]).astype(int).clip(0)
    last = np.ceil([(edge_north - south) / cell, (east - edge_west) / cell]).astype(int).clip(1, (rows, cols))
    window = tuple(slice(int(a), int(b)) for a, b in zip(first, last, strict=True))
    return Grid(relief.values[window], relief.valid[window], relief.spec.crop(*window))


def photo_on(relief: "Grid", ortho: Path) -> "Bands":
    """Return an orthophoto within the bounds of heights, on cells that suit a picture of a page.

    Raises
    ------
    GridMismatchError
        When the orthophoto is of another place.
    """
    from msbdb.grid import lattice
    from msbdb.io.ortho import read_bands

    west, south, east, north = relief.spec.bounds
    cell = max(math.ceil(100 * max(east - west, north - south) / LARGEST_PHOTO) / 100, FINEST_PHOTO)
    return read_bands(ortho, lattice(relief.spec.bounds, cell, relief.spec.crs))


def of_one_place(engine: Engine, choice: Choice) -> Choice:
    """Leave out, with a notice, surveys that are too far from the newest one for the same map.

    Surveys are of one place when the gap between them, or between each and the next, is less than the larger is wide.
    """
    boxes = {name: read_survey(engine, name).bounds for name in choice.surveys}
    near = list(choice.surveys[:1])
    for name in near:  # grows in the loop
        near += [other for other in boxes if other not in near and _is_near(boxes[name], boxes[other])]
    away = [name for name in choice.surveys if name not in near]
    if away:
        msg = f"Too far away for this map, and not drawn: {', '.join(away)}. --survey NAME draws one of them."
        give_notice(msg, PassingNotice)
    return replace(choice, surveys=tuple(name for name in choice.surveys if name in near))


def _is_near(one: Bounds, other: Bounds) -> bool:
    """Return whether the gap between two extents is less than the larger one is wide."""
    wide = max(max(east - west, north - south) for west, south, east, north in (one, other))
    east = max(one[0], other[0]) - min(one[2], other[2])
    north = max(one[1], other[1]) - min(one[3], other[3])
    return max(east, north) < wide


def _frames(engine: Engine, choice: Choice) -> "dict[str, gpd.GeoDataFrame]":
    """Return the layers by name as frames, the newest rows first, with the name of the survey of each row.

    The footprints of the current inventory are those of its view, and its parts those of its footprints.
    """
    import geopandas as gpd
    import numpy as np
    import pandas as pd

    present = footprint_at(engine, LAST_DAY) if choice.present else None
    pieces = current_pieces(engine) if choice.present else []
    crs = database_crs_of(engine)
    read: dict[str, list[gpd.GeoDataFrame]] = {name: [] for name in LAYERS}
    for survey in choice.surveys:
        tables = read_tables(engine, tuple(LAYERS.values()), survey)
        for name, table in LAYERS.items():
            frame = gpd.GeoDataFrame(tables[table.name])
            if present is not None and name == "part":
                frame = frame[frame["building_id"].isin(pieces)]
            read[name].append(frame)
    found = {}
    for name, frames in read.items():
        empty = gpd.GeoDataFrame(LAYERS[name].empty(), geometry=[], crs=crs)
        names = np.repeat(np.array(choice.surveys, dtype=object), [len(frame) for frame in frames])
        filled = [frame for frame in frames if len(frame)] or [empty]
        found[name] = gpd.GeoDataFrame(pd.concat(filled, ignore_index=True))
        found[name].insert(0, "survey", pd.Series(names, dtype=object))
    return found if present is None else found | {"footprint": present}


def _thresholds(engine: Engine, choice: Choice) -> dict[int, float]:
    """Return the area thresholds of the scales, square metres; none where they differ between the surveys."""
    tables = [read_scales(engine, survey) for survey in choice.surveys]
    found = [dict(zip(own["scale"].tolist(), own["threshold_m2"].tolist(), strict=True)) for own in tables]
    return found[0] if found and all(own == found[0] for own in found) else {}


def relief_for(engine: Engine, choice: Choice, buildings: "gpd.GeoDataFrame") -> "Grid":
    """Return the heights of the surveys, the newest on top; without surveys an empty grid around the buildings."""
    import numpy as np

    from msbdb.grid import Grid, lattice

    if len(choice.surveys) == 1:
        [name] = choice.surveys
        return heights_of(read_survey(engine, name), read_rasters(engine, name, more=()))
    if choice.surveys:
        from msbdb.run.inventory.changed import relief_of

        return relief_of(engine, choice.surveys)
    bounds = tuple(buildings.total_bounds.tolist()) if len(buildings) else EMPTY_MAP
    spec = lattice(bounds, 1.0, buildings.crs)
    return Grid(np.zeros(spec.shape, dtype=np.float32), np.zeros(spec.shape, dtype=np.bool_), spec)
