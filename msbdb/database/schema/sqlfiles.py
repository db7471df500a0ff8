"""The SQL texts in files: views, functions and queries, one text for both dialects."""

import re
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

from msbdb.errors import DatabaseError

if TYPE_CHECKING:
    pass


@dataclass(frozen=True, slots=True)
class SqlFile:
    """An SQL text: ``title`` has the sentences of its comment, ``comment`` all its lines, ``sql`` the statement."""

    title: str
    comment: str
    sql: str


INSTALLED = {"migrations": "migrations", "schema": "sql"}
"""The folders of SQL and migrations, by their names in an installed msbdb (pyproject.toml)."""


def packaged(folder: str) -> Path:
    """Return ``migrations`` or ``schema``: in the database room of an installed msbdb, at the top of a source checkout.

    Raises
    ------
    DatabaseError
        When the installation lacks it.
    """
    room = Path(__file__).resolve().parents[1]
    for place in (room / INSTALLED[folder], room.parent.parent / folder):
        if place.is_dir():
            return place
    msg = f"This msbdb lacks its folder '{folder}' in {room}. Install msbdb again."
    raise DatabaseError(msg)


@cache
def read_sql(kind: str, name: str) -> SqlFile:
    """Return ``schema/KIND/NAME.sql``, where kind is ``views``, ``functions`` or ``queries``."""
    return parse_sql(packaged("schema") / kind / f"{name}.sql")


def sql_names(kind: str) -> list[str]:
    """Return the names of the files of a kind."""
    return sorted(path.stem for path in (packaged("schema") / kind).glob("*.sql"))


def parse_sql(path: Path) -> SqlFile:
    """Return an SQL file: a comment and one statement."""
    lines = path.read_text(encoding="utf-8").splitlines()
    comment = [line for line in lines if line.startswith("--")]
    words = [re.sub("^-- ?", "", line).strip() for line in comment]
    return SqlFile(
        title=" ".join(line for line in words if line),
        comment="\n".join(comment),
        sql="\n".join(line for line in lines if not line.startswith("--")).strip().rstrip(";"),
    )


# Sums of links are subqueries of a row, not joined groups of all rows: queries of a view have a window or a survey, and
# neither dialect passes such a condition into a grouped join.


@dataclass(frozen=True, slots=True)
class View:
    """A view: its key and geometry are those of a base table; one without geometry has neither base nor key.

    ``key`` is both the view's and the base table's key column, by which the base table's spatial index serves the view.
    A ``complete`` view has one row for every row of its base table, and so the same extent.
    """

    name: str
    key: str = ""
    base: str = ""
    complete: bool = False

    @property
    def doc(self) -> str:
        """Its meaning, from the file's comment."""
        return read_sql("views", self.name).title

    @property
    def sql(self) -> str:
        """Its query."""
        return read_sql("views", self.name).sql


VIEWS = (
    View("footprint", key="building_id", base="building", complete=True),
    View("part_tree", key="part_id", base="part", complete=True),
    View("building_summary", key="building_id", base="building", complete=True),
    View("part_evidence", key="part_id", base="part", complete=True),
    View("unexplained_flat_region", key="region_id", base="flat_region"),
    View("candidate_evidence", key="candidate_id", base="candidate_region", complete=True),
    View("unexplained_candidate", key="candidate_id", base="candidate_region"),
    View("building_evidence", key="building_id", base="building", complete=True),
    View("footprint_current", key="version_id", base="building_version"),
    View("part_current", key="part_id", base="part"),
    View("building_history", key="version_id", base="building_version", complete=True),
)
"""The views with a geometry, which are layers of GIS clients."""

TABLE_VIEWS = (View("roof_material_by_class"), View("building_piece"))
"""The views without one, on which those with one may stand."""


def footprint_at_query() -> str:
    """Return the query of the function ``footprint_at`` with the day as ``:date``, for dialects without functions."""
    _, body, _ = read_sql("functions", "footprint_at").sql.split("$$")
    return body.strip().replace("to_char(day, 'YYYY-MM-DD')", ":date")
