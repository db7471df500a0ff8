"""What a run says of itself: its counts and ledger, its rasters, and the digest of all its rows."""

import zlib
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import shapely
from sqlalchemy import Connection, func, select

from msbdb.database.integrity.finding import Finding, by_id
from msbdb.database.load import content_digest
from msbdb.database.models import Part, Rejection, Run, RunState, Survey
from msbdb.database.query import build_of
from msbdb.errors import MsbdbError
from msbdb.tables import Build

COUNTED_ONLY = "duplicates"
"""What the names of stages begin with whose dropped regions live on in coarser ones, and so are in no ledger."""

LAST_STAGE = "fake fathers"
"""The stage that keeps just the parts."""

_LATER: tuple[tuple[set[str], set[str]], ...] = (
    (set(), set()),
    ({"candidate_region", "part_candidate", "flat_region_candidate"}, {"area3d_share", "adaptive_share"}),
    ({"flat_region", "part_flat_region"}, {"flat_share"}),
)
"""Tables and columns that each older schema had not, the newest first: a run of its time is digested without them."""

_UNREADABLE = (MsbdbError, ValueError, TypeError, KeyError, OverflowError, zlib.error, shapely.errors.ShapelyError)
"""What damaged rows raise when they are read."""


def check_ledger(connection: Connection) -> Iterator[Finding]:
    """Yield stages whose books do not balance, or whose dropped regions are not the rows of the ledger."""
    rejections = _rejections(connection)
    for run_id, counts in connection.execute(select(Run.run_id, Run.counts).order_by(Run.run_id)):
        stages = counts.get("regions") if isinstance(counts, Mapping) else None
        if not isinstance(stages, Mapping):
            continue
        rows = rejections.get(run_id, {})
        key = by_id("run", "run_id", run_id)
        for stage, numbers in stages.items():
            yield from _unbalanced(key, stage, numbers)
            expected = numbers.get("booked", numbers["dropped"])
            allowed = {expected, 0} if stage.startswith(COUNTED_ONLY) else {expected}
            if rows.get(stage, 0) not in allowed:
                what = f"{rows.get(stage, 0)} rows of stage '{stage}'"
                yield Finding("ledger", "rejection", key, what, f"{expected}, as the run counts")
        for stage in sorted(set(rows) - set(stages)):
            yield Finding("ledger", "rejection", key, f"{rows[stage]} rows of stage '{stage}'", "none: no such stage")
        kept = stages.get(LAST_STAGE, {}).get("kept")
        parts = connection.scalar(select(func.count()).where(Part.run_id == run_id))
        if kept is not None and parts != kept:
            yield Finding("ledger", "part", key, f"{parts} parts", f"{kept}, as stage '{LAST_STAGE}' kept")


def _rejections(connection: Connection) -> dict[int, dict[str, int]]:
    """Return the number of ledger rows by run and stage."""
    found: dict[int, dict[str, int]] = {}
    query = select(Rejection.run_id, Rejection.stage, func.count()).group_by(Rejection.run_id, Rejection.stage)
    for run_id, stage, rows in connection.execute(query):
        found.setdefault(run_id, {})[stage] = rows
    return found


def _unbalanced(key: str, stage: str, numbers: Mapping[str, int]) -> Iterator[Finding]:
    if numbers["in"] != numbers["kept"] + numbers["dropped"]:
        what = f"stage '{stage}': {numbers['in']} in, {numbers['kept']} kept, {numbers['dropped']} dropped"
        yield Finding("ledger", "run", key, what, "as many in as kept and dropped")


def check_rasters(connection: Connection) -> Iterator[Finding]:
    """Yield rasters of a run that cannot be read, or do not lie on the survey's lattice."""
    edges = (Survey.west, Survey.south, Survey.east, Survey.north, Survey.cell_m)
    query = (
        select(RunState.run_id, RunState.name, RunState.dtype, RunState.shape, RunState.data, *edges)
        .join_from(RunState, Run)
        .join(Survey)
        .order_by(RunState.run_id, RunState.name)
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
    query = select(Run.run_id, Run.content_sha256, Survey.name).join_from(Run, Survey).order_by(Survey.name)
    for run_id, digest, survey in connection.execute(query).all():
        key = by_id("run", "run_id", run_id)
        try:
            known = digests(build_of(connection, survey))
        except _UNREADABLE as error:
            yield Finding("content", "run", key, f"its rows cannot be read: {error}", "the rows that were written")
            continue
        if digest not in known:
            what = f"the rows of survey '{survey}' give the digest {known[0]}"
            yield Finding("content", "run", key, what, f"{digest}, as when they were written")


def digests(build: Build) -> list[str]:
    """Return a build's digest, and those that an older msbdb would have given it where it could have made it."""
    frames: dict[str, Any] = dict(build.frames)
    found = []
    for tables, columns in _LATER:
        if any(len(frames[name]) for name in tables):
            break
        frames = {name: frame for name, frame in frames.items() if name not in tables}
        if frames["building"].reindex(columns=sorted(columns)).notna().any(axis=None):
            break
        frames["building"] = frames["building"].drop(columns=sorted(columns))
        found.append(content_digest(build, frames))
    return found
