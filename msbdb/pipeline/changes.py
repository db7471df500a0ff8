"""What surveys did to the inventory between two dates: as a table, a file or a map."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import geopandas as gpd
import numpy as np
import pandas as pd
import shapely
from pyproj import CRS

from msbdb.database import Engine, footprint_at, read_changes, read_state, read_survey
from msbdb.errors import InputError
from msbdb.export.changes import write_changes
from msbdb.grid import Grid, lattice
from msbdb.inventory.offset import Offset
from msbdb.inventory.pieces import earlier_heights
from msbdb.io.vector import read_polygons
from msbdb.pipeline.reports import opened
from msbdb.pipeline.state import lattice_of, unpack_heights
from msbdb.view.changes import draw_changes

NOT_SURVEYED = "not surveyed"
END = "9999-12-31"

LARGEST_MAP = 4000
"""Cells a side beyond which a map of several surveys is made of larger cells."""

NOWHERE = Offset(0.0, 0.0, 0.0, 0, float("nan"))


@dataclass(frozen=True, slots=True, eq=False)
class Changes:
    """Changes between two dates.

    ``table`` has a row for each building and survey that saw it (a pair of buildings for merged and split), as
    `msbdb.database.read_changes` gives it; buildings within an area of interest that no survey saw follow as
    'not surveyed'. ``counts`` has the rows by kind.
    """

    table: gpd.GeoDataFrame
    counts: dict[str, int]


def changes(
    db: str | Path,
    *,
    since: str | None = None,
    until: str | None = None,
    survey: str | None = None,
    aoi: Path | None = None,
    out: Path | None = None,
    figure: Path | None = None,
) -> Changes:
    """Tell what surveys did to the buildings of the inventory.

    Parameters
    ----------
    db : str or path
        The database.
    since, until : str, optional
        Surveys after the one day, and up to the other, ISO 8601; all by default.
    survey : str, optional
        Only this one.
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
        table = read_changes(engine, since, until)
        if survey is not None:
            table = table[table["survey"] == survey]
        if aoi is not None:
            area = read_polygons(aoi, to=table.crs).union_all()
            table = table[table.intersects(area)]
            table = _with_unseen(table, footprint_at(engine, until or END), area)
        table = table.reset_index(drop=True)
        if out is not None:
            write_changes(table, Path(out))
        if figure is not None:
            _draw(engine, table, Path(figure), _period(since, until))
    counts = table["kind"].value_counts()
    return Changes(table, {str(kind): int(counts[kind]) for kind in sorted(counts.index)})


def _with_unseen(table: gpd.GeoDataFrame, standing: gpd.GeoDataFrame, area: shapely.Geometry) -> gpd.GeoDataFrame:
    """Add the buildings within an area that no survey of the period saw."""
    seen = set(table["uid_before"].dropna()) | set(table["uid_after"].dropna())
    unseen = standing[standing.intersects(area) & ~standing["uid"].isin(seen)]
    if unseen.empty:
        return table
    told = {"uid": "uid_before", "version_id": "version_before", "state": "state_before", "storeys": "storeys_before"}
    told |= {name: f"{name}_before" for name in ("h_max", "h_p90", "area_m2", "volume_m3", "attributes")}
    rows = unseen[[*told, "geometry"]].rename(columns=told)
    rows = rows.assign(kind=NOT_SURVEYED, survey="", date="", note="", outline=False, height=False, parts=False)
    both = pd.concat([frame.dropna(axis=1, how="all") for frame in (table, rows) if len(frame)], ignore_index=True)
    return gpd.GeoDataFrame(both.reindex(columns=table.columns), crs=table.crs)


def _period(since: str | None, until: str | None) -> str:
    """Return a period in words."""
    words = [f"after {since}" if since else "", f"up to {until}" if until else ""]
    return ", ".join(word for word in words if word) or "all surveys"


def _draw(engine: Engine, table: gpd.GeoDataFrame, figure: Path, period: str) -> None:
    """Draw the rows on the heights of their surveys, the latest on top."""
    names = table.loc[table["survey"] != ""].sort_values("date", kind="stable")["survey"].unique()[::-1]
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
    return {"counts": found.counts, "changes": records}
