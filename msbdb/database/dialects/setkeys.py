"""Foreign keys of a run checked in sets: one query for each key, in place of two look-ups for each row."""

import logging
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from sqlalchemy import Connection, ForeignKeyConstraint, text

from msbdb.database.schema.sqltables import SQL
from msbdb.errors import LoadError

logger = logging.getLogger(__name__)

_MAY = {
    True: "SELECT has_parameter_privilege('session_replication_role', 'SET')",
    False: "SELECT rolsuper FROM pg_roles WHERE rolname = current_user",
}
"""Whether the user may load without the keys' triggers; servers of version 15 and newer can grant this right."""

GRANTED_FROM = (15,)
"""The version of the server from which on the right can be granted."""

_FOREIGN = """
SELECT count(*) FROM pg_trigger
WHERE tgrelid = ANY(CAST(:tables AS regclass[])) AND NOT tgisinternal AND tgenabled = 'O'
"""
"""Triggers of other programs on our tables, which would not see the rows."""


@contextmanager
def keys_in_sets(connection: Connection, tables: Sequence[str], run_id: int) -> Iterator[None]:
    """Insert rows of a run without the triggers of their keys, then check all keys, each by one query.

    The keys stay in the schema, and hold for everybody else. A user who may not set ``session_replication_role`` has
    them checked row by row, as ever. So it is where somebody added triggers to the tables, which must fire.

    Parameters
    ----------
    connection : Connection
        In a writer's transaction that has inserted the run. A failure undoes all of it, the setting included.
    tables : sequence of str
        The tables that get rows of the run, and no others.
    run_id : int
        The run. Its rows refer to rows of the same run alone, which nobody else sees or deletes before the commit.

    Raises
    ------
    LoadError
        When a row refers to no row of its run.
    """
    may = connection.scalar(text(_MAY[(connection.dialect.server_version_info or (0,)) >= GRANTED_FROM]))
    if not may or connection.scalar(text(_FOREIGN), {"tables": list(tables)}):
        yield
        return
    connection.execute(text("SET LOCAL session_replication_role = replica"))
    yield
    connection.execute(text("SET LOCAL session_replication_role = origin"))
    for table in tables:
        for key in sorted(SQL[table].foreign_key_constraints, key=lambda key: str(key.name)):
            if key.referred_table.name != "run":
                _require(connection, table, key, run_id)


def _require(connection: Connection, table: str, key: ForeignKeyConstraint, run_id: int) -> None:
    """Refuse rows of a run that refer to no row of it."""
    pairs = [(e.parent.name, e.column.name) for e in key.elements if e.parent.name != "run_id"]
    own, its = (", ".join(names) for names in zip(*pairs, strict=True))
    known = " AND ".join(f"{name} IS NOT NULL" for name, _ in pairs)
    other = key.referred_table.name
    # Both sides are read once. A join would be planned with statistics that lack the new rows.
    query = f"""
        SELECT {own} FROM {table} WHERE run_id = :run AND {known}
        EXCEPT SELECT {its} FROM {other} WHERE run_id = :run LIMIT 1
    """  # noqa: S608  (names are the models')
    wrong = connection.execute(text(query), {"run": run_id}).one_or_none()
    if wrong is not None:
        values = ", ".join(str(value) for value in wrong)
        msg = (
            f"The database refused the rows: {table} refers by {own} = {values} to no row of {other} in its run. "
            "Nothing was written. This is a fault of msbdb; please report it."
        )
        raise LoadError(msg)
