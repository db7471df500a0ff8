"""Example queries: their files, the values of their parameters, and running them."""

import datetime
import difflib
import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from sqlalchemy import Engine, text

from msbdb.database.dialects.dialect import guarded
from msbdb.database.schema.sqlfiles import read_sql, sql_names
from msbdb.errors import InputError, ParameterError

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
