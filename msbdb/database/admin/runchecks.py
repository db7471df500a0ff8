"""Checks of runs: counts and ledger, rasters, digest of all rows, the forest of parts (V33) and its buildings."""

import zlib
from collections.abc import Iterator, Mapping

import numpy as np
import shapely
from numpy.typing import NDArray
from sqlalchemy import Connection, Table, exists, func, select

from msbdb.database.admin.findings import Finding, by_id
from msbdb.database.runs.reading import content_of
from msbdb.database.schema.sqltables import SQL
from msbdb.errors import MsbdbError
from msbdb.kept import REQUIRED_RASTERS

PART = SQL["part"]

REJECTION = SQL["rejection"]

RUN = SQL["run"]

RUN_STATE = SQL["run_state"]

SURVEY = SQL["survey"]

COUNTED_ONLY = "duplicates"
"""Prefix of the stages whose dropped regions are kept as coarser ones; the ledger has no rows for them."""

LAST_STAGE = ("multiscale", "fake fathers")
"""The method and the stage whose kept regions are the parts."""

UNREADABLE = (MsbdbError, ValueError, TypeError, KeyError, OverflowError, zlib.error, shapely.errors.ShapelyError)
"""Errors of reading damaged rows."""


def check_ledger(connection: Connection) -> Iterator[Finding]:
    """Yield stages whose counts do not add up, or whose dropped regions differ from the rows of the ledger."""
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
        yield Finding("ledger", "run", key, what, "in = kept + dropped")


def check_rasters(connection: Connection) -> Iterator[Finding]:
    """Yield rasters of a run that are missing, cannot be read, or are not on the survey's lattice."""
    edges = (SURVEY.c.west, SURVEY.c.south, SURVEY.c.east, SURVEY.c.north, SURVEY.c.cell_m)
    query = (
        select(RUN_STATE.c.run_id, RUN_STATE.c.name, RUN_STATE.c.dtype, RUN_STATE.c.shape, RUN_STATE.c.data, *edges)
        .join_from(RUN_STATE, RUN)
        .join(SURVEY)
        .order_by(RUN_STATE.c.run_id, RUN_STATE.c.name)
    )
    missing = {(run_id, name) for run_id in connection.scalars(select(RUN.c.run_id)) for name in REQUIRED_RASTERS}
    for run_id, name, dtype, shape, data, west, south, east, north, cell in connection.execute(query):
        missing.discard((run_id, name))
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
    for run_id, name in missing:
        key = f"{by_id('run_state', 'run_id', run_id)}, name={name}"
        yield Finding("rasters", "run_state", key, "the raster is missing", "a row: every run has this raster")


def check_content(connection: Connection) -> Iterator[Finding]:
    """Yield runs whose rows differ from those that msbdb wrote, by the digest of all rows."""
    query = select(RUN.c.run_id, RUN.c.content_sha256, SURVEY.c.name).join_from(RUN, SURVEY).order_by(SURVEY.c.name)
    for run_id, digest, survey in connection.execute(query).all():
        key = by_id("run", "run_id", run_id)
        try:
            found = content_of(connection, survey).digest()
        except UNREADABLE as error:
            yield Finding("content", "run", key, f"its rows cannot be read: {error}", "the rows that were written")
            continue
        if digest != found:
            what = f"the rows of survey '{survey}' give the digest {found}"
            yield Finding("content", "run", key, what, f"{digest}, as when they were written")


BUILDING = SQL["building"]

CHECK = "forest"

BATCH = 10_000
"""Rows in memory at a time."""


def check_forest(connection: Connection) -> Iterator[Finding]:
    """Yield parts that break V33.

    A father exists in the same run and tree, on the coarser scale SUPSCALE, and is larger. A root is the root of its
    own tree. The path from father to father ends at that root and has no circle.
    """
    parts = _columns(connection, ("part_id", "run_id", "supid", "supscale", "root_id", "scale", "area_px"), PART)
    # Repeated ids are findings of the values.
    _, first = np.unique(parts["part_id"], return_index=True)
    parts = {name: own[first] for name, own in parts.items()}
    ids, root_ids = parts["part_id"], parts["root_id"]
    place = _places(ids, parts["supid"])
    is_child, has_father = parts["supid"] != 0, place >= 0
    yield from _wrong_parts(parts, is_child & ~has_father, "its father {supid} does not exist", "a part of this id")
    both = parts | {f"father_{name}": own[place] for name, own in parts.items()}
    child = is_child & has_father
    for holds, what, expected in (
        (both["run_id"] == both["father_run_id"], "it is of run {run_id}", "its father's run {father_run_id}"),
        (both["root_id"] == both["father_root_id"], "its tree is {root_id}", "its father's {father_root_id}"),
        (both["supscale"] == both["father_scale"], "SUPSCALE is {supscale}", "{father_scale}, its father's scale"),
        (both["scale"] > both["father_scale"], "it is on scale {scale}", "a finer one than {father_scale}"),
        (
            both["area_px"] < both["father_area_px"],
            "it has {area_px} cells",
            "fewer than its father's {father_area_px}",
        ),
    ):
        yield from _wrong_parts(both, child & ~holds, what, expected)
    what, expected = "it has no father, and its tree is {root_id}", "a root's tree is its own id {part_id}"
    yield from _wrong_parts(parts, ~is_child & (root_ids != ids), what, expected)
    top, in_circle = _tops(place)
    yield from _wrong_parts(parts, in_circle, "its fathers form a circle", "a root at the top")
    lost = is_child & ~in_circle & ~is_child[top] & (ids[top] != root_ids)
    yield from _wrong_parts(parts, lost, "its topmost father is not {root_id}", "the root that it names")


def check_buildings(connection: Connection) -> Iterator[Finding]:
    """Yield parts without a building, trees in several, and buildings whose numbers are not those of their trees."""
    part, building = PART.c, BUILDING.c
    has_building = exists().where(building.building_id == part.building_id, building.run_id == part.run_id)
    for number in connection.scalars(select(part.part_id).where(~has_building)):
        yield Finding("buildings", "part", by_id("part", "part_id", number), "its building does not exist", "one")
    root = PART.alias("root")
    strayed = select(part.part_id, part.building_id, root.c.building_id).join_from(
        PART, root, part.root_id == root.c.part_id
    )
    for number, held, expected in connection.execute(strayed.where(part.building_id != root.c.building_id)):
        what = f"it is in building {held}"
        yield Finding("buildings", "part", by_id("part", "part_id", number), what, f"{expected}, its root's building")
    sizes = {
        "trees": func.count(part.part_id).filter(part.supid == 0),
        "parts": func.count(part.part_id),
        "scales": func.count(part.scale.distinct()),
    }
    counted = select(part.building_id, *(size.label(name) for name, size in sizes.items()))
    trees = counted.group_by(part.building_id).subquery()
    for name in sizes:
        found, expected = building[name], func.coalesce(trees.c[name], 0)
        query = select(building.building_id, found, expected).where(found != expected)
        for number, held, size in connection.execute(
            query.select_from(BUILDING).outerjoin(trees, trees.c.building_id == building.building_id)
        ):
            key = by_id("building", "building_id", number)
            yield Finding("buildings", "building", key, f"{name} is {held}", f"{size}, the number in its trees")


def _columns(connection: Connection, names: tuple[str, ...], table: Table) -> dict[str, NDArray[np.int64]]:
    """Return columns of whole numbers, sorted by the first."""
    columns = [table.columns[name] for name in names]
    result = connection.execute(select(*columns).order_by(columns[0]), execution_options={"yield_per": BATCH})
    # Column by column: an array of rows takes ten times as long.
    batches = [np.array(list(zip(*rows, strict=True)), dtype=np.int64) for rows in result.partitions()]
    held = np.concatenate(batches, axis=1) if batches else np.empty((len(names), 0), dtype=np.int64)
    return dict(zip(names, held, strict=True))


def _places(ids: NDArray[np.int64], wanted: NDArray[np.int64]) -> NDArray[np.intp]:
    """Return the place of each wanted id among the sorted ones, -1 for none."""
    near = np.minimum(np.searchsorted(ids, wanted), len(ids) - 1)
    return np.where(ids[near] == wanted, near, -1)


def _wrong_parts(
    parts: Mapping[str, NDArray[np.int64]], wrong: NDArray[np.bool_], what: str, expected: str
) -> Iterator[Finding]:
    """Yield a finding for each wrong part; the sentences have its columns in braces."""
    for place in np.flatnonzero(wrong).tolist():
        values = {name: own[place] for name, own in parts.items()}
        key = by_id("part", "part_id", values["part_id"])
        yield Finding(CHECK, "part", key, what.format_map(values), expected.format_map(values))


def _tops(father: NDArray[np.intp]) -> tuple[NDArray[np.intp], NDArray[np.bool_]]:
    """Return the place of the topmost father of each part, and the parts in a circle, by pointer doubling.

    ``father`` (N,) has the place of each part's father, -1 for none.
    """
    own = np.arange(len(father))
    up = np.where(father < 0, own, father)
    for _ in range(max(1, len(father).bit_length())):
        up = up[up]
    return up, father[up] >= 0
