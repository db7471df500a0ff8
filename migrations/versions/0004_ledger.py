"""The ledger in numbers: rows for what could have been a building, and counts of all dropped regions.

The rows of older runs stay, and are counted. These runs have no raster of reasons, as they kept nothing from which it
could be made. Runs keep a digest of their content. It is computed again where it was right before, so that an edit by
another program is found after the upgrade, too.

There is no way back: in the former schema every dropped region has a row.
"""

from collections import defaultdict

import sqlalchemy as sa
from alembic import op

revision = "0004"
down_revision = "0003"

TABLE = "rejection_count"
KEY = ("method", "number")
COLUMNS = ("method", "number", "stage", "reason", "regions", "area_m2", "small", "small_m2")
KINDS = {"method": "str", "stage": "str", "reason": "str", "area_m2": "float64", "small_m2": "float64"}
"""Kinds of the columns that are no whole numbers."""


def upgrade() -> None:
    """Create the table, count the rows of the ledger, and compute the digests again."""
    baseline = op.get_context().script.get_revision("0001").module
    right = [run_id for run_id, kept, found in run_digests(old=True) if kept == found]
    op.create_table(
        TABLE,
        *baseline.integers("run_id"),
        *baseline.words("method"),
        *baseline.integers("number"),
        *baseline.words("stage", "reason"),
        *baseline.integers("regions"),
        *baseline.numbers("area_m2"),
        *baseline.integers("small"),
        *baseline.numbers("small_m2"),
        baseline.key(TABLE, "run_id", *KEY),
        baseline.check(TABLE, "method", "method IN ('multiscale', 'flatregions', 'area3d', 'adaptive')"),
        baseline.check(TABLE, "number", "number >= 1 AND number <= 255"),
        baseline.check(TABLE, "reason", "stage <> '' AND reason <> ''"),
        baseline.check(TABLE, "regions", "regions >= 1 AND small >= 0 AND small <= regions"),
        baseline.check(TABLE, "area", "small_m2 >= 0 AND area_m2 >= small_m2"),
        baseline.of_run(TABLE),
    )
    count_rows()
    run = sa.table("run", sa.column("run_id"), sa.column("content_sha256"))
    for run_id, _, found in run_digests(old=False):
        if run_id in right:
            op.execute(run.update().where(run.c.run_id == run_id).values(content_sha256=found))


def count_rows() -> None:
    """Count the rows of the ledger, numbered by stage and reason within a detector of a run."""
    query = """
        SELECT run_id, method, stage, reason, count(*) AS regions, sum(area_m2) AS area_m2
        FROM rejection GROUP BY run_id, method, stage, reason
    """
    rows = [dict(row._mapping) for row in op.get_bind().execute(sa.text(query))]
    number: dict[tuple[int, str], int] = defaultdict(int)
    # Sorted here, because servers sort texts differently.
    for row in sorted(rows, key=lambda row: (row["run_id"], row["method"], row["stage"], row["reason"])):
        number[row["run_id"], row["method"]] += 1
        row |= {"number": number[row["run_id"], row["method"]], "small": 0, "small_m2": 0.0}
    if rows:
        op.bulk_insert(sa.table(TABLE, *(sa.column(name) for name in ("run_id", *COLUMNS))), rows)


def content_tables(*, old: bool) -> list[object]:
    """Return the declarations of a run's content before this migration, or with the new table after it."""
    from msbdb.tables import Column, Table

    tables: list[object] = op.get_context().script.get_revision(down_revision).module.content_tables(old=False)
    if old:
        return tables
    columns = tuple(Column(name, KINDS.get(name, "int64"), "-", "", primary=name in KEY) for name in COLUMNS)
    place = next(place for place, table in enumerate(tables, start=1) if table.name == "rejection")
    return [*tables[:place], Table(TABLE, "", columns), *tables[place:]]


def run_digests(*, old: bool) -> list[tuple[int, str, str | None]]:
    """Return each run with its kept digest, and that of its rows; None where they cannot be read."""
    from msbdb.database.admin.contentchecks import UNREADABLE
    from msbdb.database.runs.reading import content_of

    connection, tables = op.get_bind(), content_tables(old=old)
    query = "SELECT r.run_id, r.content_sha256, s.name FROM run AS r JOIN survey AS s ON s.survey_id = r.survey_id"
    found = []
    for run_id, kept, survey in connection.execute(sa.text(query)).all():
        try:
            digest = content_of(connection, survey, tables).digest()
        except UNREADABLE:
            digest = None
        found.append((run_id, kept, digest))
    return found
