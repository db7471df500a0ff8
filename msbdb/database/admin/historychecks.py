"""Checks of the living inventory: versions without overlap, events, digests of rows, and references."""

from collections.abc import Iterator, Mapping

from sqlalchemy import Connection, exists, func, select

from msbdb.database.admin.findings import Finding, by_id, keyed
from msbdb.database.history.rowdigest import TABLES, digested
from msbdb.database.schema.sqltables import SQL

BUILDING_CHANGE = SQL["building_change"]

BUILDING_VERSION = SQL["building_version"]

INVENTORY_BUILDING = SQL["inventory_building"]

INVENTORY_EVENT = SQL["inventory_event"]

RUN = SQL["run"]

SURVEY = SQL["survey"]

SURVEY_OFFSET = SQL["survey_offset"]


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
