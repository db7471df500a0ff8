"""What changed in the inventory between two dates: a table, a file and a map."""

from collections.abc import Sequence
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
    first_day,
    footprint_at,
    opened,
    read_rasters,
    read_states,
    read_survey,
)
from msbdb.database.history.periods import read_period
from msbdb.errors import InputError
from msbdb.export import Content, choose_layers, export, find_format
from msbdb.grid import Grid, lattice
from msbdb.identity import to_json
from msbdb.io.files import PICTURES, require_output
from msbdb.io.layers import Layer
from msbdb.io.vector import read_polygons
from msbdb.kept import heights_of
from msbdb.run.reports import Changes
from msbdb.view.buildingmap import draw_changes

LARGEST_MAP = 4000
"""Cells a side beyond which a map of several surveys is made of larger cells."""

NO_OFFSET = Offset(0.0, 0.0, 0.0, 0, float("nan"))

NOT_SURVEYED = "not surveyed"
"""Kind of a building within the area of interest that no survey of the period covered."""

UNSURE = "unsure"
"""Kind of a building that came or went without ever being confirmed, by its probability or an operator."""


def changes_of(
    db: str | Path,
    *,
    since: str | None = None,
    until: str | None = None,
    survey: str | None = None,
    each: bool = False,
    aoi: Path | None = None,
    out: Path | None = None,
    figure: Path | None = None,
    overwrite: bool = False,
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
    return heights_of(read_survey(engine, survey), read_rasters(engine, survey, more=()))


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


def change_content(table: gpd.GeoDataFrame) -> Content:
    """Return changes as the layer of a file; imported attributes are JSON."""
    frame = table.copy()
    for column in ("attributes_before", "attributes_after"):
        words = np.empty(len(frame), dtype=object)
        words[:] = [None if value is None else to_json(value) for value in frame[column]]
        frame[column] = words
    return Content("changes", {"change": Layer.of(frame)})
