"""The living inventory: imports of footprints and roof samples, and what changed between two dates."""

import hashlib
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import geopandas as gpd
import numpy as np
import pandas as pd
import shapely
from pyproj import CRS

from msbdb.change.differences import Offset, earlier_heights
from msbdb.change.netchange import NO_CHANGE, Net, net_changes, with_beginnings
from msbdb.database import (
    LAST_DAY,
    Engine,
    database_crs_of,
    first_day,
    footprint_at,
    open_database,
    opened,
    read_fallback,
    read_rasters,
    read_states,
    read_survey,
    require_past,
    write_import,
    write_samples,
)
from msbdb.database.history.periods import read_period
from msbdb.errors import DatabaseError, InputError, ParameterError, SchemaVersionError
from msbdb.export import choose_layers, export, find_format
from msbdb.grid import Grid, lattice
from msbdb.io.files import PICTURES, require_output
from msbdb.io.vector import read_point_features, read_polygons
from msbdb.kept import heights_of
from msbdb.run.export import change_content
from msbdb.run.reports import Changes, ImportReport
from msbdb.tables import EXTRACTOR_SHARES, HEIGHTS
from msbdb.view.buildingmap import draw_changes

SINCE_EVER = "0001-01-01"
"""First day of an inventory of unknown age."""

MEASURED = (
    *HEIGHTS,
    "h_max",
    "h_mean",
    "h_p50",
    "h_p90",
    "volume_m3",
    "parts",
    *EXTRACTOR_SHARES.values(),
    "probability",
)


def take_inventory(
    db: str | Path,
    file: Path,
    *,
    name: str | None,
    layer: str | None,
    date: str | None,
    mapping: Mapping[str, str],
    id_column: str | None,
    crs: str | None,
) -> ImportReport:
    """Import the footprints of a file as the inventory; see `msbdb.api.import_inventory`."""
    if date:
        require_past(date, f"the footprints of {file.name}")
    frame = read_polygons(file, layer=layer, crs=crs or read_fallback(db))
    engine = _opened_or_created(db, frame)
    try:
        frame = frame.to_crs(database_crs_of(engine))
        rows = as_versions(frame, dict(mapping), id_column)
        chosen, day = name or file.stem, first_day(date) if date else SINCE_EVER
        status, count = write_import(engine, chosen, day, rows, digest=digest_of(chosen, day, rows))
    finally:
        engine.dispose()
    return ImportReport(chosen, day, status, count)


def take_samples(
    db: str | Path, file: Path, *, layer: str | None, mapping: Mapping[str, str], crs: str | None
) -> ImportReport:
    """Import points at which the material of a roof is known; see `msbdb.api.import_roof_samples`."""
    columns = {"material": "material", **mapping}
    with opened(db) as engine:
        frame = read_point_features(file, layer=layer, crs=crs or read_fallback(db), to=database_crs_of(engine))
        _require_columns(frame, columns)
        material = frame[columns["material"]].astype("string").fillna("").str.strip()
        if (material == "").any():
            row = int(np.flatnonzero(material == "")[0]) + 1
            msg = f"{file.name} has a sample without a material, first in row {row}. Complete or delete it."
            raise InputError(msg)
        note = frame[columns["note"]].astype("string").fillna("") if "note" in columns else ""
        attributes = _attributes(frame.drop(columns=["geometry", *columns.values()]), {})
        samples = gpd.GeoDataFrame(
            {"material": material.astype(object), "note": note, "attributes": attributes}, geometry=frame.geometry
        )
        count = write_samples(engine, samples)
    return ImportReport(file.stem, "", "created", count)


def _opened_or_created(db: str | Path, frame: gpd.GeoDataFrame) -> Engine:
    """Open a database, or make one in a frame's CRS."""
    try:
        return open_database(db)
    except SchemaVersionError:
        return open_database(db, create=True)
    except DatabaseError:
        return open_database(db, create=True, srid=frame.crs.to_epsg() or 0, crs_wkt=frame.crs.to_wkt())


def as_versions(frame: gpd.GeoDataFrame, mapping: dict[str, str], id_column: str | None) -> gpd.GeoDataFrame:
    """Return footprints with the columns of a version, and a key each.

    Raises
    ------
    ParameterError
        When a column does not exist, or a measure is no number.
    InputError
        When the id column holds a value twice, or none.
    """
    _require_columns(frame, mapping)
    rows = gpd.GeoDataFrame({"key": keys_of(frame, id_column)}, geometry=frame.geometry.to_numpy(), crs=frame.crs)
    rows = rows.assign(state="unsure", area_m2=frame.area.to_numpy(), **dict.fromkeys(MEASURED, None))
    if "height" in mapping:
        height = _numbers(frame, mapping.pop("height"))
        rows = rows.assign(h_max=height, h_p90=height)
    if "storeys" in mapping:
        rows["storeys"] = _numbers(frame, mapping.pop("storeys")).round().astype("Int64")
    names = {column: name for name, column in mapping.items()}
    return rows.assign(attributes=_attributes(frame.drop(columns="geometry"), names))


def keys_of(frame: gpd.GeoDataFrame, id_column: str | None) -> list[str]:
    """Return a unique key for each footprint: the file's own ids, or the places.

    Raises
    ------
    ParameterError
        When the id column does not exist.
    InputError
        When it holds a value twice, or none.
    """
    if id_column is not None:
        _require_columns(frame, {"id": id_column})
        ids = frame[id_column].astype("string")
        twice = ids[ids.duplicated() | ids.isna()]
        if len(twice):
            msg = (
                f"The column '{id_column}' is no id of the buildings: '{twice.iloc[0]}' is missing or twice. "
                "Choose another column."
            )
            raise InputError(msg)
        return [str(value) for value in ids]
    corners = np.round(shapely.bounds(frame.geometry.to_numpy()) * 1000).astype(np.int64)
    places = pd.Series([",".join(map(str, corner)) for corner in corners.tolist()])
    again = places.groupby(places).cumcount()
    return [f"{place};{count}" for place, count in zip(places, again, strict=True)]


def _require_columns(frame: gpd.GeoDataFrame, columns: Mapping[str, str]) -> None:
    """Refuse columns that do not exist."""
    for name, column in columns.items():
        if column not in frame.columns:
            there = ", ".join(str(c) for c in frame.columns if c != "geometry") or "none"
            msg = f"There is no column '{column}' to use as '{name}'; the columns are {there}."
            raise ParameterError(msg)


def _numbers(frame: gpd.GeoDataFrame, column: str) -> "pd.Series[float]":
    """Return a column of numbers, NaN for a missing one."""
    try:
        numbers: pd.Series[float] = pd.to_numeric(frame[column].reset_index(drop=True)).astype("float64")
    except (TypeError, ValueError) as error:
        msg = f"The column '{column}' holds a value that is no number: {error}. Correct it, or leave the column out."
        raise ParameterError(msg) from error
    return numbers


def _attributes(frame: pd.DataFrame, names: Mapping[str, str]) -> "pd.Series[Any]":
    """Return all columns as a dictionary a row, of values that JSON knows."""
    plain = pd.DataFrame(frame).rename(columns=dict(names))
    records = json.loads(plain.to_json(orient="records", date_format="iso", double_precision=15, default_handler=str))
    return pd.Series([record or None for record in records], dtype=object)


def digest_of(name: str, date: str, rows: gpd.GeoDataFrame, more: Sequence[str] = ()) -> str:
    """Return the digest of all that an import writes; ``more`` names the further columns that it has."""
    digest = hashlib.sha256(f"import\0{name}\0{date}\0".encode())
    for column in ("key", "h_p90", "storeys", "attributes", *more):
        digest.update(repr(rows[column].tolist()).encode())
    digest.update(b"".join(shapely.to_wkb(shapely.normalize(rows.geometry.to_numpy()), byte_order=1)))
    return digest.hexdigest()


NOT_SURVEYED = "not surveyed"
"""Kind of a building within the area of interest that no survey of the period covered."""

UNSURE = "unsure"
"""Kind of a building that came or went without ever being confirmed, by its probability or an operator."""

LARGEST_MAP = 4000
"""Cells a side beyond which a map of several surveys is made of larger cells."""

NO_OFFSET = Offset(0.0, 0.0, 0.0, 0, float("nan"))


def changes_of(
    db: str | Path,
    *,
    since: str | None,
    until: str | None,
    survey: str | None,
    each: bool,
    aoi: Path | None,
    out: Path | None,
    figure: Path | None,
    overwrite: bool,
) -> Changes:
    """List what changed in the inventory between two dates; see `msbdb.api.changes`."""
    if out is not None:
        choose_layers(find_format(Path(out)), ("change",))
    for path, endings in ((out, ()), (figure, PICTURES)):
        if path is not None:
            require_output(path, overwrite=overwrite, endings=endings, sources=[db, *([aoi] if aoi else [])])
    with opened(db) as engine:
        period = read_period(engine, since, until)
        rows = with_beginnings(period.changes, period.events, None if since is None else first_day(since))
        if survey is not None:
            rows = rows[rows["survey"] == survey]
        if each or survey is not None:
            net = Net(rows, rows.iloc[:0])
        else:
            net = net_changes(rows, period.versions, period.offsets)
        table, passing = _with_unsure(net.table, read_states(engine)), net.passing
        if aoi is not None:
            area = read_polygons(aoi, to=rows.crs).union_all()
            rows, table, passing = (frame[frame.intersects(area)] for frame in (rows, table, passing))
            table = _with_unseen(table, footprint_at(engine, until or LAST_DAY), area)
        table = table.reset_index(drop=True)
        if out is not None:
            export(change_content(table), Path(out), overwrite=True)
        if figure is not None:
            _draw(engine, table, rows, Path(figure), _period(since, until, len(passing)))
    counts = table["kind"].value_counts()
    return Changes(table, {str(kind): int(counts[kind]) for kind in sorted(counts.index)}, len(passing))


def _with_unsure(table: gpd.GeoDataFrame, decided: pd.DataFrame) -> gpd.GeoDataFrame:
    """Name the buildings that came or went without being confirmed: what one survey is unsure of is no change.

    A building of unknown probability counts as confirmed, such as one of an imported inventory.
    """
    by_operator = set(decided.loc[decided["state"] == "confirmed", "uid"])
    table = table.copy()
    for kind, side in (("new", "after"), ("demolished", "before")):
        known = table[f"probability_{side}"].notna() & ~table[f"uid_{side}"].isin(by_operator)
        unsure = known & (table[f"state_{side}"] != "confirmed") & (table["kind"] == kind)
        table.loc[unsure, "kind"] = UNSURE
    return table


def _with_unseen(table: gpd.GeoDataFrame, standing: gpd.GeoDataFrame, area: shapely.Geometry) -> gpd.GeoDataFrame:
    """Add the buildings within an area that no survey of the period covered."""
    seen = set(table["uid_before"].dropna()) | set(table["uid_after"].dropna())
    unseen = standing[standing.intersects(area) & ~standing["uid"].isin(seen)]
    if unseen.empty:
        return table
    names = {"uid": "uid_before", "version_id": "version_before", "state": "state_before", "storeys": "storeys_before"}
    names |= {
        name: f"{name}_before" for name in ("probability", "h_max", "h_p90", "area_m2", "volume_m3", "attributes")
    }
    rows = unseen[[*names, "geometry"]].rename(columns=names)
    rows = rows.assign(
        kind=NOT_SURVEYED, survey="", date="", note="", outline=False, height=False, parts=False, times=0
    )
    both = pd.concat([frame.dropna(axis=1, how="all") for frame in (table, rows) if len(frame)], ignore_index=True)
    return gpd.GeoDataFrame(both.reindex(columns=table.columns), crs=table.crs)


def _period(since: str | None, until: str | None, in_between: int) -> str:
    """Return a period, and the number of buildings that were new and demolished in it, in words."""
    words = [f"after {since}" if since else "", f"up to {until}" if until else ""]
    period = ", ".join(word for word in words if word) or "all surveys"
    return f"{period} · {in_between} new and demolished in between" if in_between else period


def _draw(engine: Engine, table: gpd.GeoDataFrame, rows: gpd.GeoDataFrame, figure: Path, period: str) -> None:
    """Draw the table on the heights of the surveys that saw its buildings, the latest on top."""
    names = rows.sort_values("date", kind="stable")["survey"].unique()[::-1]
    if not len(names):
        msg = (
            f"No building can be drawn: no survey of the period ({period}) covers one there. "
            "Choose other dates or another area."
        )
        raise InputError(msg)
    relief = relief_of(engine, [str(name) for name in names])
    place = CRS.from_user_input(table.crs).name
    several = f"{len(names)} surveys" if len(names) > 1 else f"survey {names[0]}"
    draw_changes(table, relief, figure, title=f"Changes by {several}", subtitle=f"{period} · {place}")


def relief_of(engine: Engine, surveys: Sequence[str]) -> Grid:
    """Return the heights above ground of surveys as one grid, the first one on top."""
    return _relief([_heights(engine, name) for name in surveys])


def _heights(engine: Engine, survey: str) -> Grid:
    """Return the heights above ground of a survey."""
    return heights_of(read_survey(engine, survey), read_rasters(engine, survey))


def _relief(grids: list[Grid]) -> Grid:
    """Return one grid of all, the first one on top."""
    if len(grids) == 1:
        return grids[0]
    bounds = np.array([grid.spec.bounds for grid in grids])
    west, south = bounds[:, :2].min(axis=0).tolist()
    east, north = bounds[:, 2:].max(axis=0).tolist()
    cell = max(min(grid.spec.cell_m for grid in grids), (east - west) / LARGEST_MAP, (north - south) / LARGEST_MAP)
    return earlier_heights(grids, lattice((west, south, east, north), cell, grids[0].spec.crs), NO_OFFSET)


def records_of(found: Changes) -> list[dict[str, Any]]:
    """Return a record of plain values for each row that is a change."""
    changed = found.table[~found.table["kind"].isin([*NO_CHANGE, NOT_SURVEYED, UNSURE])]
    plain = pd.DataFrame(changed.drop(columns="geometry")).astype(object)
    return [
        {str(name): value for name, value in row.items()}
        for row in plain.where(plain.notna(), None).to_dict(orient="records")
    ]
