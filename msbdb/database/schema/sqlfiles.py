"""The SQL texts in files: views, functions and example queries, one text for both dialects."""

import datetime
import difflib
import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sqlalchemy import Engine, text

from msbdb.database.dialects.dialect import guarded
from msbdb.errors import DatabaseError, InputError, ParameterError

if TYPE_CHECKING:
    import pandas as pd

_PARAMETER = re.compile(
    r"^    CAST\((?P<value>NULL|-?[\d.]+|'[^']*') AS (?P<kind>[A-Z ]+)\) AS (?P<name>\w+),?  -- (?P<meaning>.+)$",
    re.MULTILINE,
)
"""A line of the table ``param`` at the top of an example query."""

_USE = re.compile(r"\(SELECT (?P<name>\w+) FROM param\)")
"""A use of one of its values."""

KINDS: dict[str, type[str] | type[int] | type[float]] = {
    "TEXT": str,
    "INTEGER": int,
    "BIGINT": int,
    "DOUBLE PRECISION": float,
}
"""The types of parameters, in SQL and here."""

LARGEST = 2**63 - 1
"""Largest whole number of both dialects."""


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


@dataclass(frozen=True, slots=True)
class ExampleQuery:
    """A query: its name, the question that it answers, its SQL, and its parameters.

    In ``sql`` the parameters are bound by their names, ``:survey``; in the file they are rows of the table ``param``.
    """

    name: str
    title: str
    sql: str
    defaults: dict[str, Any]
    kinds: dict[str, type]
    meanings: dict[str, str]

    def values(self, given: Mapping[str, object]) -> dict[str, Any]:
        """Return the values of all parameters: the given ones, also as text, and the defaults of the others.

        Raises
        ------
        ParameterError
            For an unknown parameter, or a value that cannot be one.
        """
        unknown = sorted(set(given) - set(self.defaults))
        if unknown:
            there = ", ".join(self.defaults) or "none"
            msg = f"The query '{self.name}' has no parameter {', '.join(unknown)}; it has {there}."
            raise ParameterError(msg)
        return self.defaults | {name: self._value(name, value) for name, value in given.items()}

    def _value(self, name: str, value: object) -> object:
        """Return a value in the type of its parameter."""
        default = self.defaults[name]
        kind: Callable[[Any], object] = self.kinds[name]
        if value is None and default is None:
            return None
        expected = {str: "a text", int: "a whole number of at least 0", float: "a number"}[self.kinds[name]]
        if isinstance(default, str):
            kind, expected = _day, "a day such as 2021-05-31"
        try:
            found = kind(value)
            fits = value is not None and not (isinstance(found, int) and not 0 <= found <= LARGEST)
            fits &= not (isinstance(found, float) and not math.isfinite(found))
            fits &= not (isinstance(found, int) and isinstance(value, float) and found != value)
        except (TypeError, ValueError):
            fits = False
        if not fits:
            msg = (
                f"The parameter {name} of the query '{self.name}' is {expected} ({self.meanings[name]}); got {value!r}."
            )
            raise ParameterError(msg)
        return found


def _day(value: object) -> str:
    """Return a day as ISO 8601 writes it."""
    return datetime.date.fromisoformat(str(value)).isoformat()


def example_queries() -> dict[str, ExampleQuery]:
    """Return the example queries by name.

    A file begins with a comment, a question. Its parameters are the columns of the table ``param``, which has one row
    to edit in a client of SQL: a line ``CAST(value AS TYPE) AS name,  -- meaning`` each.
    """
    return {name: _example(name) for name in sql_names("queries")}


def find_example(name: str) -> ExampleQuery:
    """Return an example query.

    Raises
    ------
    ParameterError
        For an unknown name, with similar ones.
    """
    names = sql_names("queries")
    if name in names:
        return _example(name)
    near = difflib.get_close_matches(name, names, n=3) or [own for own in names if name.lower() in own][:3]
    hint = f"Did you mean {' or '.join(near)}?" if near else f"There are {', '.join(names)}."
    msg = f"There is no example query '{name}'. {hint}"
    raise ParameterError(msg)


def run_example(engine: Engine, name: str, **values: Any) -> "pd.DataFrame":  # noqa: ANN401  (what SQL takes)
    """Run an example query with its defaults, or with other values of its parameters.

    Raises
    ------
    ParameterError
        For an unknown query or parameter, or a value that cannot be one.
    InputError
        For a survey that the database does not have.
    """
    import pandas as pd

    query = find_example(name)
    chosen = query.values(values)
    with guarded(engine.url), engine.connect() as connection:
        if chosen.get("survey") is not None:
            there = connection.execute(text("SELECT name FROM survey ORDER BY name")).scalars().all()
            if chosen["survey"] not in there:
                msg = (
                    f"The database has no survey '{chosen['survey']}'. Give one of them: {'; '.join(there) or 'none'}."
                )
                raise InputError(msg)
        result = connection.execute(text(query.sql), chosen)
        names, rows = list(result.keys()), [tuple(row) for row in result]
    return pd.DataFrame({name: _column([row[place] for row in rows]) for place, name in enumerate(names)})


def _column(values: Sequence[Any]) -> "pd.Series[Any]":
    """Return a column; whole numbers with nulls stay whole, because ids beyond 2^53 have no floating point number."""
    import pandas as pd

    whole = None in values and all(value is None or isinstance(value, int) for value in values)
    return pd.Series(values, dtype="Int64" if whole else None)


def _example(name: str) -> ExampleQuery:
    """Read an example query; each use of a parameter, ``(SELECT name FROM param)``, becomes a bound value.

    So the planner of a server knows the values, as it does for a query that a program sends.
    """
    file = read_sql("queries", name)
    found = {match["name"]: match for match in _PARAMETER.finditer(file.sql)}
    sql = _PARAMETER.sub(lambda m: m[0].replace(f"CAST({m['value']} AS", f"CAST(:{m['name']} AS"), file.sql)
    sql = _USE.sub(lambda m: f"CAST(:{m['name']} AS {found[m['name']]['kind']})", sql)
    kinds = {own: KINDS[match["kind"]] for own, match in found.items()}
    defaults = {own: _literal(match["value"], kinds[own]) for own, match in found.items()}
    return ExampleQuery(name, file.title, sql, defaults, kinds, {own: m["meaning"] for own, m in found.items()})


def _literal(word: str, kind: type) -> object:
    """Return the value of a literal of SQL."""
    return None if word == "NULL" else kind(word.strip("'"))
