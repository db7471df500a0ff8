"""Buildings that the borders of surveys cut: versions that several surveys make together, and their withdrawal."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
import shapely
from sqlalchemy import Connection, Engine, column, delete, func, select, table, update

from msbdb.database.dialects.dialect import Dialect, guarded
from msbdb.database.runs.digests import digest_again, insert_digested
from msbdb.database.schema.sqltables import SQL
from msbdb.identity import plain, text_id, to_json
from msbdb.tables import ACROSS

BUILDING_CHANGE = SQL["building_change"]

BUILDING_VERSION = SQL["building_version"]

INVENTORY_EVENT = SQL["inventory_event"]

PIECE = table("building_piece", column("version_id"), column("building_id"))
"""The view of the pieces of each version."""

_IS_CURRENT = BUILDING_VERSION.c.valid_to.is_(None)


@dataclass(frozen=True, slots=True)
class Seams:
    """The versions that an update joins across borders, and what they replace.

    Parameters
    ----------
    released : tuple of int
        Earlier versions of this kind, which are made anew.
    versions : tuple of dict
        The columns of ``building_version``, with ``geometry``.
    changes : tuple of dict
        The columns of ``building_change``, without the key.
    ends : tuple of (int, str, int)
        Versions of single surveys that end: key, day, and the survey that ends them.
    """

    released: tuple[int, ...] = ()
    versions: tuple[dict[str, Any], ...] = ()
    changes: tuple[dict[str, Any], ...] = ()
    ends: tuple[tuple[int, str, int], ...] = ()


def batches(keys: Iterable[int], size: int = 500) -> list[list[int]]:
    """Return keys in lists that are short enough for one statement in every dialect."""
    every = list(keys)
    return [every[at : at + size] for at in range(0, len(every), size)]


def read_members(connection: Connection, versions: Iterable[int]) -> dict[int, list[int]]:
    """Return the versions before each joined version; versions of another kind are left out.

    A joined version may follow another one. Then that one is in the result, too.
    """
    found: dict[int, list[int]] = {}
    waiting = sorted(set(versions))
    while waiting:
        rows: list[tuple[int, int]] = []
        for some in batches(waiting):
            query = select(BUILDING_CHANGE.c.version_after, BUILDING_CHANGE.c.version_before).where(
                BUILDING_CHANGE.c.version_after.in_(some), BUILDING_CHANGE.c.note.startswith(ACROSS, autoescape=True)
            )
            rows += [(int(after), int(before)) for after, before in connection.execute(query)]
        for after, before in sorted(rows):
            found.setdefault(after, []).append(before)
        waiting = sorted({before for _, before in rows} - set(found))
    return found


def leaves_of(members: dict[int, list[int]], version: int) -> list[int]:
    """Return the versions of single surveys that are in a joined version, and the version itself where it is none."""
    if version not in members:
        return [version]
    return sorted({leaf for member in members[version] for leaf in leaves_of(members, member)})


def joined_by(members: dict[int, list[int]], version: int) -> list[int]:
    """Return a joined version and the joined ones before it."""
    if version not in members:
        return []
    return sorted({version, *(each for member in members[version] for each in joined_by(members, member))})


def release(connection: Connection, released: Iterable[int]) -> set[int]:
    """Delete joined versions and reopen those before them; return the surveys whose rows are fewer now."""
    surveys: set[int] = set()
    keys = sorted(released)
    opened: list[int] = []
    for some in batches(keys):
        rows = BUILDING_CHANGE.c.version_after.in_(some)
        query = select(BUILDING_CHANGE.c.survey_id, BUILDING_CHANGE.c.version_before).where(rows)
        for survey_id, before in connection.execute(query):
            surveys.add(int(survey_id))
            opened.append(int(before))
        connection.execute(delete(BUILDING_CHANGE).where(rows))
    for some in batches(keys):
        connection.execute(delete(BUILDING_VERSION).where(BUILDING_VERSION.c.version_id.in_(some)))
    for some in batches(sorted(set(opened) - set(keys))):
        own = BUILDING_VERSION.c.version_id.in_(some)
        connection.execute(update(BUILDING_VERSION).where(own).values(valid_to=None, closed_by=None))
        digest_again(connection, BUILDING_VERSION, own)
    return surveys


def write_seams(
    connection: Connection, dialect: Dialect, seams: Seams, measures: tuple[str, ...], srid: int
) -> set[int]:
    """Write joined versions, their changes, and the ends of the versions before them; return the surveys of the rows.

    The versions before them exist.
    """
    for version, day, survey_id in seams.ends:
        own = BUILDING_VERSION.c.version_id == version
        connection.execute(update(BUILDING_VERSION).where(own).values(valid_to=day, closed_by=survey_id))
        digest_again(connection, BUILDING_VERSION, own)
    columns = ["version_id", "uid", "valid_from", "valid_to", "survey_id", "closed_by", "building_id", *measures]
    rows = [
        (*(plain(row[name]) for name in columns), "survey", to_json(row["attributes"] or {})) for row in seams.versions
    ]
    shapes = np.array([_multi(row["geometry"]) for row in seams.versions], dtype=object)
    if rows:
        names = [*columns, "source", "attributes"]
        insert_digested(connection, dialect, "building_version", names, rows, srid=srid, shapes=shapes)
    changes = [{"change_id": _change_key(row), **row} for row in seams.changes]
    if changes:
        names = list(changes[0])
        cells = sorted(tuple(row[name] for name in names) for row in changes)
        insert_digested(connection, dialect, "building_change", names, cells, srid=srid)
    return {int(row["survey_id"]) for row in (*seams.versions, *seams.changes)}


def current_pieces(engine: Engine) -> list[int]:
    """Return the runs' buildings behind the current versions, with all pieces of those across borders."""
    query = select(PIECE.c.building_id).join(BUILDING_VERSION, BUILDING_VERSION.c.version_id == PIECE.c.version_id)
    with guarded(engine.url), engine.connect() as connection:
        return sorted(connection.scalars(query.where(_IS_CURRENT)))


def read_pieces(engine: Engine) -> list[tuple[int, int]]:
    """Return each version of the inventory with each building of a run that it is made of, in their order."""
    query = select(PIECE.c.version_id, PIECE.c.building_id).order_by(PIECE.c.version_id, PIECE.c.building_id)
    with guarded(engine.url), engine.connect() as connection:
        return [(int(version), int(building)) for version, building in connection.execute(query)]


def count_again(connection: Connection, surveys: Iterable[int]) -> None:
    """Write the number of rows that updates made, after rows of theirs were joined or released by another one."""
    for survey_id in sorted(surveys):
        own = INVENTORY_EVENT.c.survey_id == survey_id
        connection.execute(update(INVENTORY_EVENT).where(own).values(counts=counts_of(connection, survey_id)))
        digest_again(connection, INVENTORY_EVENT, own)


def counts_of(connection: Connection, survey_id: int) -> dict[str, int]:
    """Return the rows of an update: changes by kind, and versions."""
    kinds = select(BUILDING_CHANGE.c.kind, func.count()).where(BUILDING_CHANGE.c.survey_id == survey_id)
    found = {str(kind): int(n) for kind, n in sorted(connection.execute(kinds.group_by(BUILDING_CHANGE.c.kind)).all())}
    versions = select(func.count()).where(BUILDING_VERSION.c.survey_id == survey_id)
    return found | {"versions": int(connection.scalar(versions) or 0)}


def _change_key(row: dict[str, Any]) -> int:
    """Return the key of a change across a border."""
    return text_id("change", "across", row["version_before"], row["version_after"])


def _multi(shape: shapely.Geometry) -> shapely.Geometry:
    """Return a polygon as a multipolygon."""
    return shape if shape.geom_type == "MultiPolygon" else shapely.multipolygons([shape])
