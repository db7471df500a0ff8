"""All checks in order, on one committed state of the database."""

import logging
from collections.abc import Callable, Iterator

from sqlalchemy import Connection, Engine
from sqlalchemy.exc import DBAPIError

from msbdb.database.admin.contentchecks import (
    check_buildings,
    check_content,
    check_digests,
    check_events,
    check_forest,
    check_intervals,
    check_ledger,
    check_orphans,
    check_rasters,
)
from msbdb.database.admin.declarationchecks import (
    check_foreign_keys,
    check_links,
    check_schema,
    check_values,
    missing_tables,
)
from msbdb.database.admin.findings import Finding
from msbdb.database.admin.shapechecks import check_geometries, check_overlaps, check_registers, check_spatial_index
from msbdb.database.dialects.connection import snapshot
from msbdb.errors import MsbdbError

logger = logging.getLogger(__name__)

Progress = Callable[[str, int, int], None]

CHECKS: dict[str, Callable[[Connection], Iterator[Finding]]] = {
    "schema": check_schema,
    "values": check_values,
    "foreign keys": check_foreign_keys,
    "links": check_links,
    "forest": check_forest,
    "buildings": check_buildings,
    "geometries": check_geometries,
    "registers": check_registers,
    "spatial index": check_spatial_index,
    "ledger": check_ledger,
    "rasters": check_rasters,
    "content": check_content,
    "intervals": check_intervals,
    "overlaps": check_overlaps,
    "events": check_events,
    "digests": check_digests,
    "orphans": check_orphans,
}
"""The checks by name, in their order."""


def check_database(engine: Engine, *, progress: Progress | None = None) -> list[Finding]:
    """Check every row of a database against its declaration, and return the errors, sorted.

    Nothing is changed, and writers do not wait. The checks see one committed state.

    Parameters
    ----------
    engine : Engine
        From ``open_database``.
    progress : callable, optional
        Called with 'check', the number of finished checks and the number of all checks.

    Returns
    -------
    list of Finding
        Empty for a database without errors. ``CHECKS`` has the names of the checks.

    Raises
    ------
    DatabaseError
        When the database cannot be read.
    """
    with snapshot(engine) as connection:
        found = missing_tables(connection)
        if found:
            # Queries on missing tables would fail.
            return sorted(found)
        for number, (name, check) in enumerate(CHECKS.items(), start=1):
            found += _results(connection, name, check)
            if progress is not None:
                progress("check", number, len(CHECKS))
    logger.info("%d checks, %d findings", len(CHECKS), len(found))
    return sorted(found)


def _results(connection: Connection, name: str, check: Callable[[Connection], Iterator[Finding]]) -> list[Finding]:
    """Return a check's findings; an error that damaged rows cause in the check is a finding, too."""
    try:
        with connection.begin_nested():
            return list(check(connection))
    except DBAPIError as error:
        if connection.invalidated:
            raise
        cause = " ".join(str(error.orig).split())
    except (ValueError, TypeError, KeyError, OverflowError, MsbdbError) as error:
        cause = f"{type(error).__name__}: {error}"
    return [Finding(name, "", "", f"the check failed: {cause}", "rows of the declared types")]
