"""Footprints that an office has, measured on a survey: heights, storeys, parts, and whether there is a building.

Nothing is detected here. The survey is built as always, with the footprints as the parcels that divide its houses. Then
each footprint is measured on the rasters of that build, and enters the inventory with its own outline and columns.
"""

import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import geopandas as gpd
import numpy as np
import pandas as pd
import shapely
from numpy.typing import NDArray

from msbdb.change.surveywindows import WINDOW_CELLS
from msbdb.database import (
    Engine,
    OutdatedError,
    crs_of,
    database_crs_of,
    first_day,
    opened,
    read_buildings,
    read_digest,
    read_events_near,
    read_fallback,
    read_parts,
    read_run,
    read_survey,
    shown,
    write_import,
)
from msbdb.errors import DatabaseError, InputError, PassingNotice, collected_notices, give_notice
from msbdb.io.extents import Extent, require_common_place
from msbdb.io.vector import read_polygons
from msbdb.params import Params, with_values
from msbdb.run.inventory.footprintcells import (
    STANDS,
    STATISTICS,
    DrawnShapes,
    SurveyCells,
    cells_within,
    heights_inside,
    shares_inside,
)
from msbdb.run.inventory.footprintfile import write_footprints
from msbdb.run.inventory.imported import MEASURED, SINCE_EVER, as_versions, digest_of, keys_of
from msbdb.run.reports import BuildReport, MeasureReport
from msbdb.tables import CONFIRMING_COVER, HEIGHTS

SEEN = 0.5
"""Ours: a survey decides on a footprint if it has heights on at least this share of it."""

LEAST_PIECE_M2 = 1.0
"""Ours: smaller pieces of a detected outline between footprints are the difference of two drawings."""

SHOWN = ("state", "building_share", "points", "point_share", "seen_share")
"""Measures that no column of the inventory has; they stay with the attributes, under `OWN`."""

OWN = "msbdb"
"""The attribute of a measured footprint that holds the values of `SHOWN`."""


@dataclass(frozen=True, slots=True, eq=False)
class Measured:
    """Footprints measured on a survey.

    Parameters
    ----------
    footprints : GeoDataFrame
        A row a footprint in the file's order, in the survey's CRS: ``state``, `MEASURED`, ``building_id`` of the
        detected building that covers most of it, ``seen_share``, ``building_share``, ``points`` and ``point_share``.
    others : GeoDataFrame
        Detected buildings without a footprint: the same columns, and the outline outside of the footprints.
    """

    footprints: gpd.GeoDataFrame
    others: gpd.GeoDataFrame


def measure_footprints(engine: Engine, survey: str, frame: gpd.GeoDataFrame, *, side: int = WINDOW_CELLS) -> Measured:
    """Measure footprints on what a survey found.

    Parameters
    ----------
    engine : Engine
        From ``open_database``.
    survey : str
        A survey that is built.
    frame : GeoDataFrame
        Polygons in the survey's CRS. They may overlap.
    side : int
        Side of the windows in which the rasters are read, cells; of no influence on the result.

    Raises
    ------
    OutdatedError
        When others replace the survey meanwhile.

    Notes
    -----
    Heights are those of the detected cells in a footprint: a roof that covers half of a lot gives the heights of the
    roof. Where less than `STANDS` of it is detected, all its cells count, and storeys are null.

    ``state`` is that of the detected building that covers most of the footprint, where at least `STANDS` of it is
    detected. It is 'refuted' where less than ``CONFIRMING_COVER`` is, and 'unsure' between. It is also 'unsure' where
    the survey has heights on less than `SEEN` of the footprint. So is a footprint smaller than the least building on
    which something raised was found.
    """
    record, run = read_survey(engine, survey), read_run(engine, survey)
    values: Any = run.parameters
    params = with_values(Params(), {name: values.get(name, {}) for name in ("fuse", "heights", "surface")})
    buildings = read_buildings(engine, survey).reset_index(drop=True)
    cells = SurveyCells(engine, record, buildings, side)
    rows = pd.DataFrame(np.nan, index=range(len(frame)), columns=[*STATISTICS, "volume_m3", *HEIGHTS])
    for layer in layers_of(frame):
        footprints = DrawnShapes(frame.geometry.to_numpy()[layer], cells.spec)
        shares = shares_inside(footprints, cells)
        for name, own in (shares | heights_inside(footprints, cells, shares["building_share"], params)).items():
            if name not in rows:
                rows[name] = np.nan
            rows.loc[layer, name] = own
    main = rows.pop("main").to_numpy(dtype=np.int64, na_value=-1)
    known = buildings.reindex(main).reset_index(drop=True)
    stands = (rows["building_share"] >= STANDS).to_numpy()
    hardly = (rows["building_share"] < CONFIRMING_COVER).to_numpy()
    # A detector leaves out what is smaller than any building. There heights decide, and they do not tell a shed apart.
    shed = (frame.area < params.fuse.piece_m2).to_numpy() & (rows["h_p50"] >= params.surface.mask_m).to_numpy()
    state = np.select([stands, hardly & ~shed], [known["state"], "refuted"], "unsure")
    rows["state"] = np.where(rows["seen_share"] >= SEEN, state, "unsure")
    rows["probability"] = known["probability"].where(stands)
    rows["building_id"] = known["building_id"].where(main >= 0).astype("Int64")
    rows["parts"] = _parts_inside(frame, read_parts(engine, survey))
    for name in (*(name for name in HEIGHTS if name.startswith("storeys")), "parts"):
        rows[name] = rows[name].where(stands).astype("Int64")
    measured = gpd.GeoDataFrame(rows.assign(area_m2=frame.area.to_numpy()), geometry=[*frame.geometry], crs=frame.crs)
    return Measured(measured, _without_footprint(buildings, cells, frame))


def layers_of(frame: gpd.GeoDataFrame) -> list[NDArray[np.intp]]:
    """Return the rows in as few groups as a first fit needs, so that no two footprints of a group overlap.

    Examples
    --------
    >>> squares = [shapely.box(0, 0, 2, 2), shapely.box(1, 0, 3, 2), shapely.box(3, 0, 4, 2)]
    >>> [rows.tolist() for rows in layers_of(gpd.GeoDataFrame(geometry=squares, crs="EPSG:2154"))]
    [[0, 2], [1]]
    """
    shapes = frame.geometry.to_numpy()
    first, second = shapely.STRtree(shapes).query(shapes, predicate="intersects")
    pairs = first > second
    first, second = first[pairs], second[pairs]
    overlap = shapely.area(shapely.intersection(shapes[first], shapes[second])) > 0
    layer = np.zeros(len(shapes), dtype=np.int64)
    others: dict[int, list[int]] = {}
    for one, other in zip(first[overlap].tolist(), second[overlap].tolist(), strict=True):
        others.setdefault(one, []).append(other)
    for row in sorted(others):
        taken = {int(layer[other]) for other in others[row]}
        layer[row] = min(set(range(len(taken) + 1)) - taken)
    return [np.flatnonzero(layer == number) for number in range(int(layer.max(initial=-1)) + 1)]


def _parts_inside(frame: gpd.GeoDataFrame, parts: pd.DataFrame) -> "pd.Series[Any]":
    """Return the number of the survey's parts in each footprint; null without any."""
    inner: NDArray[np.object_] = np.asarray(shapely.points(parts["xin"].to_numpy(), parts["yin"].to_numpy()))
    rows, _ = shapely.STRtree(inner).query(frame.geometry.to_numpy(), predicate="contains")
    found = pd.Series(np.bincount(rows, minlength=len(frame))[: len(frame)], dtype="Int64")
    return found.where(found > 0)


def _without_footprint(buildings: gpd.GeoDataFrame, survey: SurveyCells, frame: gpd.GeoDataFrame) -> gpd.GeoDataFrame:
    """Return the detected buildings that footprints cover by less than `STANDS`, with what lies outside of these."""
    cells, within = cells_within(survey, DrawnShapes(frame.geometry.to_numpy(), survey.spec))
    left = buildings[within < STANDS * np.maximum(cells, 1)].reset_index(drop=True)
    shapes = left.geometry.to_numpy()
    rows, near = shapely.STRtree(frame.geometry.to_numpy()).query(shapes, predicate="intersects")
    for row in np.unique(rows).tolist():
        others = shapely.union_all(frame.geometry.to_numpy()[near[rows == row]])
        pieces = shapely.get_parts(shapely.difference(shapes[row], others))
        pieces = [one for one in pieces if one.geom_type == "Polygon" and one.area >= LEAST_PIECE_M2]
        shapes[row] = shapely.multipolygons(pieces) if pieces else shapely.MultiPolygon()
    kept = ~shapely.is_empty(shapes)
    columns = left.loc[kept, ["state", "building_id", *MEASURED]].reset_index(drop=True)
    return gpd.GeoDataFrame(columns.assign(area_m2=shapely.area(shapes[kept])), geometry=shapes[kept], crs=frame.crs)


def check_footprints(
    db: str | Path,
    file: Path,
    *,
    name: str,
    layer: str | None,
    id_column: str | None,
    crs: str | None,
    place: Extent | None = None,
) -> None:
    """Refuse what cannot be measured, before the survey is built; ``place`` is what its files cover.

    Raises
    ------
    GridMismatchError
        When no footprint lies in the place.
    ParameterError, InputError
        For an id column that is none, and where the inventory knows the place from another import or from an update.
    """
    with collected_notices(), warnings.catch_warnings(action="ignore"):
        frame = read_polygons(file, layer=layer, crs=crs or read_fallback(db))
    keys_of(frame, id_column)
    if place is not None:
        require_common_place(place, [Extent(tuple(frame.total_bounds.tolist()), frame.crs, f"{file.name} has")])
    try:
        with opened(db) as engine:
            area = shapely.box(*frame.to_crs(database_crs_of(engine)).total_bounds)
            near = [event for event in read_events_near(engine, area) if event != ("import", name)]
    except DatabaseError:
        return  # it is made by the build, which says what is wrong with it
    if near:
        msg = (
            f"The inventory of the place of {file.name} begins with {near[0][1]!r} already. Measure in a new database, "
            f"or let 'msbdb update' compare the survey with this inventory."
        )
        raise InputError(msg)


def take_measures(
    db: str | Path,
    file: Path,
    survey: str,
    *,
    name: str,
    layer: str | None,
    id_column: str | None,
    crs: str | None,
    out: Path | None,
    built: BuildReport | None,
) -> MeasureReport:
    """Measure the footprints of a file on a survey that is built, and write them into the inventory and a file."""
    with opened(db) as engine:
        record = read_survey(engine, survey)
        frame = read_polygons(file, layer=layer, crs=crs or read_fallback(db), to=crs_of(record))
        found = _of_one_state(engine, survey, frame)
        if found.footprints["seen_share"].max() <= 0:
            msg = f"No footprint of {file.name} lies within the survey '{survey}'. Check both, and their CRS."
            raise InputError(msg)
        rows = _as_inventory(found, frame, id_column)
        day = first_day(record.date) if record.date else SINCE_EVER
        digest = digest_of(name, day, rows, ("state", *MEASURED))
        status, _ = write_import(engine, name, day, rows.to_crs(database_crs_of(engine)), digest=digest)
        where = shown(engine.url)
    if out is not None:
        write_footprints(found.footprints, found.others, frame, out)
    unseen = int((found.footprints["seen_share"] < SEEN).sum())
    if unseen:
        some = "1 footprint is" if unseen == 1 else f"{unseen} footprints are"
        msg = f"{some} mostly outside of the survey, or without heights, and unsure for that reason."
        give_notice(msg, PassingNotice)
    states = found.footprints["state"].value_counts()
    return MeasureReport(
        survey=survey,
        name=name,
        status=status,
        footprints=len(frame),
        states={state: int(states[state]) for state in sorted(states.index)},
        unseen=unseen,
        others=len(found.others),
        database=where,
        build=built,
    )


def _of_one_state(engine: Engine, survey: str, frame: gpd.GeoDataFrame) -> Measured:
    """Measure footprints, and refuse a survey that others replaced between two windows."""
    before, outdated = read_digest(engine, survey), None
    try:
        found = measure_footprints(engine, survey, frame)
        if read_digest(engine, survey) == before:
            return found
    except OutdatedError as error:
        outdated = error
    msg = f"Others replaced the survey '{survey}' while footprints were measured on it. Measure them again."
    raise DatabaseError(msg) from outdated


def _as_inventory(found: Measured, frame: gpd.GeoDataFrame, id_column: str | None) -> gpd.GeoDataFrame:
    """Return footprints and the buildings without one as the first versions of an inventory."""
    rows = as_versions(frame, {}, id_column)
    own = found.footprints
    shown_values = own[list(SHOWN)].astype(object).where(own[list(SHOWN)].notna(), None).to_dict(orient="records")
    attributes = [
        (given or {}) | {OWN: _plain(more)} for given, more in zip(rows["attributes"], shown_values, strict=True)
    ]
    rows = rows.assign(**{name: own.get(name) for name in ("state", "area_m2", *MEASURED)})
    rows = rows.assign(attributes=pd.Series(attributes, dtype=object))
    others = found.others.drop(columns="building_id")
    keys = [f"detected;{building}" for building in found.others["building_id"]]
    more = others.assign(key=keys, attributes=pd.Series([None] * len(others), dtype=object))
    frames = [part.astype({name: object for name in part.columns if name != "geometry"}) for part in (rows, more)]
    both = pd.concat([part for part in frames if len(part)], ignore_index=True)
    return gpd.GeoDataFrame(both, geometry="geometry", crs=frame.crs)


def _plain(values: Mapping[Any, Any]) -> dict[str, Any]:
    """Return measures as few digits as they deserve, for JSON."""
    return {str(name): round(value, 3) if isinstance(value, float) else value for name, value in values.items()}
