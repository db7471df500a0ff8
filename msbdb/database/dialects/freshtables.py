"""Bulk loads into new tables of PostGIS: rows first, then indexes and foreign keys for all rows."""

import logging
from collections.abc import Iterator, Mapping
from contextlib import contextmanager

from sqlalchemy import Connection, text

logger = logging.getLogger(__name__)

WORTH = 1000
"""Rows from which it is quicker to make indexes and keys after the load."""

_NEW = """
SELECT c.relname
FROM pg_class AS c
WHERE c.relnamespace = current_schema()::regnamespace AND c.relkind = 'r' AND c.relname = ANY(:tables)
  AND c.xmin = pg_current_xact_id_if_assigned()::xid
ORDER BY c.relname
"""
"""Tables that this transaction made: nobody else sees them, so locking them disturbs nobody."""

_KEYS = """
SELECT format('ALTER TABLE %s DROP CONSTRAINT %I', conrelid::regclass, conname),
       format('ALTER TABLE %s ADD CONSTRAINT %I %s', conrelid::regclass, conname, pg_get_constraintdef(oid))
FROM pg_constraint
WHERE contype = 'f' AND connamespace = current_schema()::regnamespace AND conrelid = ANY(CAST(:tables AS regclass[]))
ORDER BY conrelid, conname
"""

_INDEXES = """
SELECT format('DROP INDEX %s', i.indexrelid::regclass), pg_get_indexdef(i.indexrelid)
FROM pg_index AS i
WHERE i.indrelid = ANY(CAST(:tables AS regclass[]))
  AND NOT EXISTS (SELECT FROM pg_constraint AS k WHERE k.conindid = i.indexrelid AND k.contype IN ('p', 'u', 'x'))
ORDER BY i.indrelid, i.indexrelid
"""
"""Statements that drop and make again foreign keys, and indexes that belong to no constraint."""

_ROOM = """
SELECT set_config('maintenance_work_mem', '256MB', true) FROM pg_settings
WHERE name = 'maintenance_work_mem' AND CAST(setting AS bigint) < 262144
"""
"""Memory for sorting an index until the end of the transaction; a larger setting of the server is kept."""


@contextmanager
def in_bulk(connection: Connection, coming: Mapping[str, int]) -> Iterator[None]:
    """Drop the foreign keys and indexes of new tables while they are filled, and make them at the end.

    Primary keys and unique constraints are kept: rows come in their order, so they cost little.

    Parameters
    ----------
    connection : Connection
        In a writer's transaction. A failure or a kill undoes all of it.
    coming : Mapping
        Number of rows that will be inserted into each table. Tables of an earlier transaction, and those with fewer
        than `WORTH` incoming rows, keep their keys and indexes.

    Raises
    ------
    IntegrityError
        At the end, when a row breaks a key.
    """
    large = [table for table, rows in coming.items() if rows >= WORTH]
    new = list(connection.scalars(text(_NEW), {"tables": large})) if large else []
    keys = connection.execute(text(_KEYS), {"tables": new}).all()
    indexes = connection.execute(text(_INDEXES), {"tables": new}).all()
    for off, _ in [*keys, *indexes]:
        connection.exec_driver_sql(off)
    yield
    if new:
        logger.debug("%d indexes and %d keys are made for the new tables %s", len(indexes), len(keys), ", ".join(new))
        connection.execute(text(_ROOM))
    for _, on in [*indexes, *keys]:
        connection.exec_driver_sql(on)
