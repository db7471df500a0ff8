"""Checks of content: the runs with their forests, rasters and digests, and the history of the inventory."""

import zlib
from collections.abc import Iterator, Mapping

import numpy as np
import shapely
from numpy.typing import NDArray
from sqlalchemy import Connection, Table, exists, func, select

from msbdb.database.admin.findings import Finding, by_id, keyed
from msbdb.database.runs.digests import TABLES, digested
from msbdb.database.runs.mosaics import mosaics_of
from msbdb.database.runs.packing import unpack
from msbdb.database.runs.reading import content_of
from msbdb.database.schema.sqltables import SQL
from msbdb.errors import MsbdbError
from msbdb.kept import REQUIRED_RASTERS

BUILDING = SQL["building"]

BUILDING_CHANGE = SQL["building_change"]

BUILDING_VERSION = SQL["building_version"]

INVENTORY_BUILDING = SQL["inventory_building"]

INVENTORY_EVENT = SQL["inventory_event"]

PART = SQL["part"]

REJECTION = SQL["rejection"]

REJECTION_COUNT = SQL["rejection_count"]

RUN = SQL["run"]

RUN_STATE = SQL["run_state"]

SURVEY = SQL["survey"]

SURVEY_OFFSET = SQL["survey_offset"]

COUNTED_ONLY = "duplicates"
"""Prefix of the stages whose dropped regions are kept as coarser ones; the ledger does not count them."""

BATCH = 10_000
"""Rows in memory at a time."""

LAST_STAGE = ("multiscale", "fake fathers")
"""The method and the stage whose kept regions are the parts."""

UNREADABLE = (MsbdbError, ValueError, TypeError, KeyError, OverflowError, zlib.error, shapely.errors.ShapelyError)
"""Errors of reading damaged rows."""


def check_ledger(connection: Connection) -> Iterator[Finding]:
    """Yield stages whose counts do not add up, or whose dropped regions are not those of the ledger.

    The ledger counts each dropped region, and has a row for each that is not small.
    """
    yield from _rows_and_counts(connection)
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
                what = f"{found} regions of {name}"
                yield Finding("ledger", "rejection_count", key, what, f"{expected}, as the run counts")
        for method, stage in sorted(set(rows) - set(stages)):
            what = f"{rows[method, stage]} regions of stage '{stage}' of {method}"
            yield Finding("ledger", "rejection_count", key, what, "none: no such stage")
        kept = stages.get(LAST_STAGE, {}).get("kept")
        parts = connection.scalar(select(func.count()).where(PART.c.run_id == run_id))
        if kept is not None and parts != kept:
            yield Finding("ledger", "part", key, f"{parts} parts", f"{kept}, as stage '{LAST_STAGE[1]}' kept")


def _rejections(connection: Connection) -> dict[int, dict[tuple[str, str], int]]:
    """Return the number of dropped regions in the ledger by run, and by method and stage."""
    found: dict[int, dict[tuple[str, str], int]] = {}
    columns = (REJECTION_COUNT.c.run_id, REJECTION_COUNT.c.method, REJECTION_COUNT.c.stage)
    counted = select(*columns, func.sum(REJECTION_COUNT.c.regions)).group_by(*columns)
    for run_id, method, stage, regions in connection.execute(counted):
        found.setdefault(run_id, {})[method, stage] = int(regions)
    return found


def _rows_and_counts(connection: Connection) -> Iterator[Finding]:
    """Yield kinds of dropped regions whose rows in the ledger are more or fewer than it counts, without the small."""
    row, count = REJECTION.c, REJECTION_COUNT.c
    there = select(row.run_id, row.method, row.stage, row.reason, func.count())
    rows = {tuple(key): number for *key, number in connection.execute(there.group_by(*there.selected_columns[:4]))}
    counted = select(count.run_id, count.method, count.stage, count.reason, count.regions - count.small)
    expected = {tuple(key): number for *key, number in connection.execute(counted)}
    for key in sorted(set(rows) | set(expected)):
        run_id, method, stage, reason = key
        if rows.get(key, 0) != expected.get(key, 0):
            what = f"{rows.get(key, 0)} rows of stage '{stage}' of {method} for '{reason}'"
            yield Finding(
                "ledger",
                "rejection",
                by_id("run", "run_id", run_id),
                what,
                f"{expected.get(key, 0)}, as rejection_count has",
            )


def _unbalanced(key: str, name: str, numbers: Mapping[str, int]) -> Iterator[Finding]:
    # Of a run in tiles only the dropped regions are known by place.
    if "in" in numbers and numbers["in"] != numbers["kept"] + numbers["dropped"]:
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
            cells = unpack(data, dtype, shape)
        except (ValueError, TypeError, zlib.error) as error:
            yield Finding("rasters", "run_state", key, f"it cannot be read: {error}", f"{shape} cells of {dtype}")
            continue
        if cells.shape[-2:] != lattice:
            yield Finding(
                "rasters", "run_state", key, f"its shape is {list(cells.shape)}", f"{list(lattice)}, the lattice"
            )
    pieces = SQL["raster_tile"].c
    for run_id in connection.scalars(select(RUN.c.run_id)).all():
        missing -= {(run_id, name) for name in mosaics_of(connection, run_id)}
        named = select(pieces.name, pieces.lattice_row, pieces.lattice_column, pieces.dtype, pieces.shape, pieces.data)
        for name, row, column, dtype, shape, data in connection.execute(named.where(pieces.run_id == run_id)):
            try:
                unpack(data, dtype, shape)
            except (ValueError, TypeError, zlib.error) as error:
                key = f"{by_id('raster_tile', 'run_id', run_id)}, name={name}, {row}, {column}"
                yield Finding("rasters", "raster_tile", key, f"it cannot be read: {error}", f"{shape} cells of {dtype}")
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
        yield Finding("forest", "part", key, what.format_map(values), expected.format_map(values))


def _tops(father: NDArray[np.intp]) -> tuple[NDArray[np.intp], NDArray[np.bool_]]:
    """Return the place of the topmost father of each part, and the parts in a circle, by pointer doubling.

    ``father`` (N,) has the place of each part's father, -1 for none.
    """
    own = np.arange(len(father))
    up = np.where(father < 0, own, father)
    for _ in range(max(1, len(father).bit_length())):
        up = up[up]
    return up, father[up] >= 0


def check_intervals(connection: Connection) -> Iterator[Finding]:
    """Yield versions of a building that overlap, end before they begin, or are current besides another one."""
    columns = [BUILDING_VERSION.c[name] for name in ("uid", "version_id", "valid_from", "valid_to")]
    # A version without an end comes last among those of one beginning.
    rows = sorted(connection.execute(select(*columns)), key=lambda row: (row[0], row[2], row[3] or "~", row[1]))
    before_uid: int | None = None
    latest: str | None = ""
    for uid, version, begins, ends in rows:
        key = by_id("building_version", "version_id", version)
        if uid != before_uid:
            before_uid, latest = uid, ""
        if latest is None:
            what = f"building {uid} has an earlier version that is current, besides this one from {begins}"
            yield Finding("intervals", "building_version", key, what, "one current version, the last")
        elif begins < latest:
            what = f"it begins on {begins}, before the version before it ended on {latest}"
            yield Finding("intervals", "building_version", key, what, f"a beginning from {latest} on")
        if ends is not None and ends < begins:
            yield Finding("intervals", "building_version", key, f"it ends on {ends}", f"an end from {begins} on")
        latest = None if ends is None or latest is None else max(latest, ends)


def check_events(connection: Connection) -> Iterator[Finding]:
    """Yield imports and updates whose number of rows differs from their counts, and gaps in their order."""
    changes: dict[int | None, dict[str, int]] = {}
    for survey, kind, rows in connection.execute(
        select(BUILDING_CHANGE.c.survey_id, BUILDING_CHANGE.c.kind, func.count()).group_by(
            BUILDING_CHANGE.c.survey_id, BUILDING_CHANGE.c.kind
        )
    ):
        changes.setdefault(survey, {})[kind] = rows
    made = select(BUILDING_VERSION.c.survey_id, func.count()).group_by(BUILDING_VERSION.c.survey_id)
    versions: dict[int | None, int] = {}
    for maker, rows in connection.execute(made):
        versions[maker] = rows
    imported = 0
    columns = (INVENTORY_EVENT.c.number, INVENTORY_EVENT.c.kind, INVENTORY_EVENT.c.survey_id, INVENTORY_EVENT.c.counts)
    for place, (number, kind, survey, counts) in enumerate(
        connection.execute(select(*columns).order_by(INVENTORY_EVENT.c.number)), start=1
    ):
        key = by_id("inventory_event", "number", number)
        if number != place:
            yield Finding("events", "inventory_event", key, f"event {place} is missing", "numbers without a gap")
            return
        if kind == "import":
            imported += counts["versions"]
            continue
        found = {**changes.pop(survey, {}), "versions": versions.get(survey, 0)}
        if {name: rows for name, rows in found.items() if rows} != {n: rows for n, rows in counts.items() if rows}:
            yield Finding("events", "inventory_event", key, f"the survey has {_in_words(found)}", _in_words(counts))
    if versions.get(None, 0) != imported:
        what = f"{versions.get(None, 0)} versions are of imports"
        yield Finding("events", "building_version", "", what, f"{imported}, the sum of the imports' counts")
    has_offset = exists().where(SURVEY_OFFSET.c.survey_id == INVENTORY_EVENT.c.survey_id)
    for number in connection.scalars(
        select(INVENTORY_EVENT.c.number).where(INVENTORY_EVENT.c.kind == "update", ~has_offset)
    ):
        key = by_id("inventory_event", "number", number)
        yield Finding("events", "inventory_event", key, "its survey has no offset", "a row of survey_offset")
    for unknown in changes:
        key = by_id("survey", "survey_id", unknown)
        yield Finding("events", "building_change", key, "no event has its changes", "the update that made them")


def _in_words(counts: Mapping[str, int]) -> str:
    return ", ".join(f"{rows} {name}" for name, rows in sorted(counts.items()))


def check_digests(connection: Connection) -> Iterator[Finding]:
    """Yield rows of the history whose values differ from those that msbdb wrote, by the digest of each row."""
    for name in TABLES:
        table = SQL[name]
        for rows in digested(connection, table):
            for number, stored, found in rows:
                if stored == found:
                    continue
                what = "it has no digest" if stored is None else f"its values give the digest {found}"
                expected = "a digest, as in every row that msbdb writes" if stored is None else f"{stored}, as written"
                yield Finding("digests", name, keyed(table, [number]), what, expected)


def check_orphans(connection: Connection) -> Iterator[Finding]:
    """Yield surveys without a run, buildings of the inventory without a version, and changes of other buildings."""
    surveys = select(SURVEY.c.survey_id).where(~exists().where(RUN.c.survey_id == SURVEY.c.survey_id))
    for survey_id in connection.scalars(surveys):
        yield Finding(
            "orphans", "survey", by_id("survey", "survey_id", survey_id), "it has no run", "the run that built it"
        )
    has_version = exists().where(BUILDING_VERSION.c.uid == INVENTORY_BUILDING.c.uid)
    buildings = select(INVENTORY_BUILDING.c.uid).where(~has_version)
    for uid in connection.scalars(buildings):
        key = by_id("inventory_building", "uid", uid)
        yield Finding("orphans", "inventory_building", key, "it has no version", "one version or more")
    for side in ("before", "after"):
        change, version = BUILDING_CHANGE.c, BUILDING_VERSION.c
        named = change[f"uid_{side}"]
        query = (
            select(change.change_id, named, version.uid)
            .where(version.version_id == change[f"version_{side}"])
            .where(func.coalesce(named, 0) != version.uid)
        )
        for number, uid, its in connection.execute(query):
            key = by_id("building_change", "change_id", number)
            what = f"uid_{side} is {uid}, but version_{side} is one of building {its}"
            yield Finding("links", "building_change", key, what, str(its))
