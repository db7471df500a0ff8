"""What a run says of itself: its counts and ledger, its rasters, and the digest of all its rows."""

import zlib
from collections.abc import Iterator, Mapping

import numpy as np
import shapely
from sqlalchemy import Connection, func, select

from msbdb.database.integrity.finding import Finding, by_id
from msbdb.database.load import content_digest
from msbdb.database.query import build_of
from msbdb.database.sqltables import SQL
from msbdb.errors import MsbdbError

PART = SQL["part"]
REJECTION = SQL["rejection"]
RUN = SQL["run"]
RUN_STATE = SQL["run_state"]
SURVEY = SQL["survey"]

COUNTED_ONLY = "duplicates"
"""What the names of stages begin with whose dropped regions live on in coarser ones, and so are in no ledger."""

LAST_STAGE = ("multiscale", "fake fathers")
"""The method and the stage that keeps just the parts."""

_UNREADABLE = (MsbdbError, ValueError, TypeError, KeyError, OverflowError, zlib.error, shapely.errors.ShapelyError)
"""What damaged rows raise when they are read."""


def check_ledger(connection: Connection) -> Iterator[Finding]:
    """Yield stages whose books do not balance, or whose dropped regions are not the rows of the ledger."""
    rejections = _rejections(connection)
    for run_id, counts in connection.execute(select(RUN.c.run_id, RUN.c.counts).order_by(RUN.c.run_id)):
        methods = counts.get("regions") if isinstance(counts, Mapping) else None
        if not isinstance(methods, Mapping):
            continue
        stages = {(method, stage): numbers for method, own in methods.items() for stage, numbers in own.items()}
        rows = rejections.get(run_id, {})
        key = by_id("run", "run_id", run_id)
        for (method, stage), numbers in stages.items():
            name = f"stage '{stage}' of {method}"
            found = rows.get((method, stage), 0)
            yield from _unbalanced(key, name, numbers)
            expected = numbers["dropped"]
            allowed = {expected, 0} if stage.startswith(COUNTED_ONLY) else {expected}
            if found not in allowed:
                yield Finding("ledger", "rejection", key, f"{found} rows of {name}", f"{expected}, as the run counts")
        for method, stage in sorted(set(rows) - set(stages)):
            what = f"{rows[method, stage]} rows of stage '{stage}' of {method}"
            yield Finding("ledger", "rejection", key, what, "none: no such stage")
        kept = stages.get(LAST_STAGE, {}).get("kept")
        parts = connection.scalar(select(func.count()).where(PART.c.run_id == run_id))
        if kept is not None and parts != kept:
            yield Finding("ledger", "part", key, f"{parts} parts", f"{kept}, as stage '{LAST_STAGE[1]}' kept")


def _rejections(connection: Connection) -> dict[int, dict[tuple[str, str], int]]:
    """Return the number of ledger rows by run, and by method and stage."""
    found: dict[int, dict[tuple[str, str], int]] = {}
    columns = (REJECTION.c.run_id, REJECTION.c.method, REJECTION.c.stage)
    for run_id, method, stage, rows in connection.execute(select(*columns, func.count()).group_by(*columns)):
        found.setdefault(run_id, {})[method, stage] = rows
    return found


def _unbalanced(key: str, name: str, numbers: Mapping[str, int]) -> Iterator[Finding]:
    if numbers["in"] != numbers["kept"] + numbers["dropped"]:
        what = f"{name}: {numbers['in']} in, {numbers['kept']} kept, {numbers['dropped']} dropped"
        yield Finding("ledger", "run", key, what, "as many in as kept and dropped")


def check_rasters(connection: Connection) -> Iterator[Finding]:
    """Yield rasters of a run that cannot be read, or do not lie on the survey's lattice."""
    edges = (SURVEY.c.west, SURVEY.c.south, SURVEY.c.east, SURVEY.c.north, SURVEY.c.cell_m)
    query = (
        select(RUN_STATE.c.run_id, RUN_STATE.c.name, RUN_STATE.c.dtype, RUN_STATE.c.shape, RUN_STATE.c.data, *edges)
        .join_from(RUN_STATE, RUN)
        .join(SURVEY)
        .order_by(RUN_STATE.c.run_id, RUN_STATE.c.name)
    )
    for run_id, name, dtype, shape, data, west, south, east, north, cell in connection.execute(query):
        key = f"{by_id('run_state', 'run_id', run_id)}, name={name}"
        lattice = (round((north - south) / cell), round((east - west) / cell))
        try:
            cells = np.frombuffer(zlib.decompress(data), dtype=np.dtype(dtype)).reshape(shape)
        except (ValueError, TypeError, zlib.error) as error:
            yield Finding("rasters", "run_state", key, f"it cannot be read: {error}", f"{shape} cells of {dtype}")
            continue
        if cells.shape[-2:] != lattice:
            yield Finding(
                "rasters", "run_state", key, f"its shape is {list(cells.shape)}", f"{list(lattice)}, the lattice"
            )


def check_content(connection: Connection) -> Iterator[Finding]:
    """Yield runs whose rows are not those that were written, by the digest of all of them."""
    query = select(RUN.c.run_id, RUN.c.content_sha256, SURVEY.c.name).join_from(RUN, SURVEY).order_by(SURVEY.c.name)
    for run_id, digest, survey in connection.execute(query).all():
        key = by_id("run", "run_id", run_id)
        try:
            build = build_of(connection, survey)
            found = content_digest(build, build.frames)
        except _UNREADABLE as error:
            yield Finding("content", "run", key, f"its rows cannot be read: {error}", "the rows that were written")
            continue
        if digest != found:
            what = f"the rows of survey '{survey}' give the digest {found}"
            yield Finding("content", "run", key, what, f"{digest}, as when they were written")
