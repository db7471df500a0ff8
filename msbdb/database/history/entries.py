"""Entries of operators into the living inventory: imported footprints, roof samples, and decisions on buildings."""

from typing import TYPE_CHECKING, Any

import numpy as np
import shapely
from sqlalchemy import Column, Connection, Engine, delete, select

from msbdb.database.dialects.dialect import dialect_of, guarded
from msbdb.database.history.joins import batches
from msbdb.database.history.periods import has_building, read_events
from msbdb.database.history.versions import write_event, write_versions
from msbdb.database.runs.digests import insert_digested
from msbdb.database.schema.sqltables import SQL
from msbdb.errors import InputError
from msbdb.identity import text_id, to_json

if TYPE_CHECKING:
    import geopandas as gpd

OPERATOR_STATE = SQL["operator_state"]

ROOF_SAMPLE = SQL["roof_sample"]


def write_import(engine: Engine, name: str, date: str, frame: "gpd.GeoDataFrame", *, digest: str) -> tuple[str, int]:
    """Write buildings of another inventory, each with its first version.

    Parameters
    ----------
    engine : Engine
        From ``open_database``.
    name, date : str
        Name of the import, and the first day on which its versions are valid.
    frame : GeoDataFrame
        ``key`` (a unique text for each building of the import), ``MEASURES``, ``attributes``, and geometry in the
        database's CRS.
    digest : str
        Digest of everything that determines the result.

    Returns
    -------
    tuple of str and int
        'created', or 'unchanged' when it was imported before; and the number of buildings.

    Raises
    ------
    InputError
        When the inventory has buildings in the same place.
    """
    dialect = dialect_of(engine.url)
    area = shapely.multipolygons([shapely.box(*frame.total_bounds)])
    with guarded(engine.url), dialect.writing(engine) as connection:
        events = read_events(connection)
        if (events["content_sha256"] == digest).any():
            return "unchanged", len(frame)
        near = events[events.intersects(area)]
        if len(near):
            last = near.iloc[-1]
            msg = (
                f"'{name}' cannot be imported: the inventory has buildings of '{last['name']}' ({last['date']}) in the "
                "same place. Import into an empty inventory, or where nothing was applied yet."
            )
            raise InputError(msg)
        srid = dialect.database_srid(connection)
        uids = [text_id("inventory building", "import", name, key) for key in frame["key"]]
        rows = frame.assign(
            version_id=[text_id("version", "import", name, uid) for uid in uids], uid=uids, valid_from=date,
            source="import", survey_id=None, building_id=None,
        )  # fmt: skip
        buildings = [(uid, name) for uid in uids]
        insert_digested(connection, dialect, "inventory_building", ["uid", "source"], buildings, srid=srid)
        write_versions(connection, dialect, rows, srid)
        event: dict[str, Any] = {"kind": "import", "name": name, "date": date, "survey_id": None}
        event |= {"counts": {"versions": len(frame)}, "content_sha256": digest}
        write_event(connection, dialect, event, area)
        dialect.after_load(connection)
    return "created", len(frame)


def write_samples(engine: Engine, frame: "gpd.GeoDataFrame") -> int:
    """Write roof samples (V53), one for each place; a sample replaces an earlier one of the same place.

    Parameters
    ----------
    engine : Engine
        From ``open_database``.
    frame : GeoDataFrame
        ``material``, ``note``, ``attributes`` and points in the database's CRS.

    Returns
    -------
    int
        Number of samples written.
    """
    dialect = dialect_of(engine.url)
    places = np.round(shapely.get_coordinates(frame.geometry.to_numpy()) * 1000).astype(np.int64).tolist()
    by_id = {text_id("roof sample", *place): row for row, place in enumerate(places)}
    chosen = frame.iloc[list(by_id.values())]
    with guarded(engine.url), dialect.writing(engine) as connection:
        srid = dialect.database_srid(connection)
        _delete_by(connection, ROOF_SAMPLE.c.sample_id, list(by_id))
        attributes = [to_json(value if isinstance(value, dict) else {}) for value in chosen["attributes"]]
        rows = list(zip(by_id, chosen["material"], chosen["note"], attributes, strict=True))
        columns = ["sample_id", "material", "note", "attributes"]
        insert_digested(connection, dialect, "roof_sample", columns, rows, srid=srid, shapes=chosen.geometry.to_numpy())
        dialect.after_load(connection)
    return len(rows)


def write_state(
    engine: Engine, uid: int, state: str | None, *, operator: str, note: str, decided_at: str
) -> dict[str, Any] | None:
    """Write an operator's decision on a building; None removes it.

    A later decision replaces an earlier one.

    Returns
    -------
    mapping, optional
        The decision that this one replaces: ``state``, ``operator``, ``note`` and ``decided_at``.

    Raises
    ------
    InputError
        When the inventory has no such building.
    """
    dialect = dialect_of(engine.url)
    with guarded(engine.url), dialect.writing(engine) as connection:
        if not has_building(connection, uid):
            msg = f"The inventory has no building {uid}. The view footprint_current lists them by uid."
            raise InputError(msg)
        own = OPERATOR_STATE.c.uid == uid
        words = (OPERATOR_STATE.c.state, OPERATOR_STATE.c.operator, OPERATOR_STATE.c.note, OPERATOR_STATE.c.decided_at)
        before = connection.execute(select(*words).where(own)).mappings().one_or_none()
        connection.execute(delete(OPERATOR_STATE).where(own))
        if state is not None:
            columns = ["uid", "state", "operator", "note", "decided_at"]
            row = (uid, state, operator, note, decided_at)
            insert_digested(
                connection, dialect, "operator_state", columns, [row], srid=dialect.database_srid(connection)
            )
    return None if before is None else dict(before)


def _delete_by(connection: Connection, column: Column[int], keys: list[int]) -> None:
    """Delete the rows of some keys."""
    for some in batches(keys):
        connection.execute(delete(column.table).where(column.in_(some)))
