"""What changed in the inventory between two dates: as a table, a file or a map."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import geopandas as gpd
import numpy as np
import pandas as pd
import shapely
from pyproj import CRS

from msbdb.api.reports import opened
from msbdb.change.differences import Offset, earlier_heights
from msbdb.change.netchange import Net, net_changes
from msbdb.database import Engine, footprint_at, read_state, read_survey
from msbdb.database.history.periods import read_period
from msbdb.errors import InputError
from msbdb.export.changelist import write_changes
from msbdb.grid import Grid, lattice
from msbdb.io.vector import read_polygons
from msbdb.run.kept import lattice_of, unpack_heights
from msbdb.view.changemap import draw_changes

NOT_SURVEYED = "not surveyed"

END = "9999-12-31"

LARGEST_MAP = 4000
"""Cells a side beyond which a map of several surveys is made of larger cells."""

NOWHERE = Offset(0.0, 0.0, 0.0, 0, float("nan"))


@dataclass(frozen=True, slots=True, eq=False)
class Changes:
    """Changes between two dates.

    Parameters
    ----------
    table : GeoDataFrame
        A row for each building that a survey saw (a pair of buildings for merged and split): the net change, as
        `msbdb.change.netchange` tells it, or, survey by survey, what each one did, as `msbdb.database.read_changes` does.
        Buildings within an area of interest that no survey saw follow as 'not surveyed'.
    counts : dict
        The rows by kind.
    in_between : int
        Buildings that came and went between the dates, and are in no row of the net change.
    """

    table: gpd.GeoDataFrame
    counts: dict[str, int]
    in_between: int


def changes(
    db: str | Path,
    *,
    since: str | None = None,
    until: str | None = None,
    survey: str | None = None,
    each: bool = False,
    aoi: Path | None = None,
    out: Path | None = None,
    figure: Path | None = None,
) -> Changes:
    """Tell what changed in the inventory between two dates.

    Parameters
    ----------
    db : str or path
        The database.
    since, until : str, optional
        From the state at the end of the one day to that of the other, ISO 8601; from before the first survey, and to
        the present, by default.
    survey : str, optional
        What this one did, and no net change.
    each : bool
        What each survey did, one after the other, and no net change.
    aoi : path, optional
        Polygons: buildings that meet them, and those of them that no survey saw.
    out : path, optional
        A GeoPackage, GeoJSON or CSV of the rows, by its ending.
    figure : path, optional
        A PNG: the buildings coloured by kind on a hillshade of the surveys.

    Returns
    -------
    Changes

    Raises
    ------
    InputError
        When there is nothing to draw, or the endings are unknown.
    """
    with opened(db) as engine:
        period = read_period(engine, since, until)
        rows = period.changes
        if survey is not None:
            rows = rows[rows["survey"] == survey]
        if each or survey is not None:
            net = Net(rows, rows.iloc[:0])
        else:
            net = net_changes(rows, period.versions, period.offsets)
        table, passing = net.table, net.passing
        if aoi is not None:
            area = read_polygons(aoi, to=rows.crs).union_all()
            rows, table, passing = (frame[frame.intersects(area)] for frame in (rows, table, passing))
            table = _with_unseen(table, footprint_at(engine, until or END), area)
        table = table.reset_index(drop=True)
        if out is not None:
            write_changes(table, Path(out))
        if figure is not None:
            _draw(engine, table, rows, Path(figure), _period(since, until, len(passing)))
    counts = table["kind"].value_counts()
    return Changes(table, {str(kind): int(counts[kind]) for kind in sorted(counts.index)}, len(passing))


def _with_unseen(table: gpd.GeoDataFrame, standing: gpd.GeoDataFrame, area: shapely.Geometry) -> gpd.GeoDataFrame:
    """Add the buildings within an area that no survey of the period saw."""
    seen = set(table["uid_before"].dropna()) | set(table["uid_after"].dropna())
    unseen = standing[standing.intersects(area) & ~standing["uid"].isin(seen)]
    if unseen.empty:
        return table
    told = {"uid": "uid_before", "version_id": "version_before", "state": "state_before", "storeys": "storeys_before"}
    told |= {name: f"{name}_before" for name in ("h_max", "h_p90", "area_m2", "volume_m3", "attributes")}
    rows = unseen[[*told, "geometry"]].rename(columns=told)
    rows = rows.assign(
        kind=NOT_SURVEYED, survey="", date="", note="", outline=False, height=False, parts=False, times=0
    )
    both = pd.concat([frame.dropna(axis=1, how="all") for frame in (table, rows) if len(frame)], ignore_index=True)
    return gpd.GeoDataFrame(both.reindex(columns=table.columns), crs=table.crs)


def _period(since: str | None, until: str | None, in_between: int) -> str:
    """Return a period, and what came and went in it, in words."""
    words = [f"after {since}" if since else "", f"up to {until}" if until else ""]
    period = ", ".join(word for word in words if word) or "all surveys"
    return f"{period} · {in_between} came and went in between" if in_between else period


def _draw(engine: Engine, table: gpd.GeoDataFrame, rows: gpd.GeoDataFrame, figure: Path, period: str) -> None:
    """Draw the table on the heights of the surveys that saw its buildings, the latest on top."""
    names = rows.sort_values("date", kind="stable")["survey"].unique()[::-1]
    if not len(names):
        msg = f"There is nothing to draw: no survey of the period ({period}) saw a building there."
        raise InputError(msg)
    relief = _relief([_heights(engine, str(name)) for name in names])
    place = CRS.from_user_input(table.crs).name
    several = f"{len(names)} surveys" if len(names) > 1 else f"survey {names[0]}"
    draw_changes(table, relief, figure, title=f"Changes by {several}", subtitle=f"{period} · {place}")


def _heights(engine: Engine, survey: str) -> Grid:
    """Return the heights above ground of a survey."""
    state, record = read_state(engine, survey), read_survey(engine, survey)
    return unpack_heights(state, lattice_of(record, state))


def _relief(grids: list[Grid]) -> Grid:
    """Return one grid of all, the first one on top."""
    if len(grids) == 1:
        return grids[0]
    bounds = np.array([grid.spec.bounds for grid in grids])
    west, south = bounds[:, :2].min(axis=0).tolist()
    east, north = bounds[:, 2:].max(axis=0).tolist()
    cell = max(min(grid.spec.cell_m for grid in grids), (east - west) / LARGEST_MAP, (north - south) / LARGEST_MAP)
    return earlier_heights(grids, lattice((west, south, east, north), cell, grids[0].spec.crs), NOWHERE)


def summary(found: Changes) -> dict[str, Any]:
    """Return the changes as plain values for JSON: counts, and a record for each row that is no 'unchanged'."""
    told = found.table[~found.table["kind"].isin(["unchanged", NOT_SURVEYED])]
    plain = pd.DataFrame(told.drop(columns="geometry")).astype(object)
    records = plain.where(plain.notna(), None).to_dict(orient="records")
    return {"counts": found.counts, "in_between": found.in_between, "changes": records}
