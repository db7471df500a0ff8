"""The example queries of ``schema/queries``: SQL for both dialects, with parameters that have defaults."""

import json
import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from sqlalchemy import Engine, text

from msbdb.database.dialects.connection import guarded
from msbdb.database.schema.sqlfiles import read_sql, sql_names
from msbdb.errors import ParameterError

if TYPE_CHECKING:
    import pandas as pd

_PARAMETER = re.compile(r"^-- :(?P<name>\w+) = (?P<value>\S+)  (?P<doc>.+)$", re.MULTILINE)


@dataclass(frozen=True, slots=True)
class ExampleQuery:
    """A query: its name, a sentence about its result, its SQL, and its parameters' defaults and meanings."""

    name: str
    title: str
    sql: str
    defaults: dict[str, Any]
    meanings: dict[str, str]


def example_queries() -> dict[str, ExampleQuery]:
    """Return the example queries by name.

    A file begins with a comment: a sentence about the result, then for each parameter a line
    ``-- :name = default  meaning``, where the default is a JSON value.
    """
    return {name: _example(name) for name in sql_names("queries")}


def run_example(engine: Engine, name: str, **values: Any) -> "pd.DataFrame":  # noqa: ANN401
    """Run an example query with its defaults, or with other values of its parameters.

    Raises
    ------
    ParameterError
        For an unknown query or parameter.
    """
    import pandas as pd

    queries = example_queries()
    if name not in queries:
        msg = f"There is no example query '{name}'; there are {', '.join(queries)}."
        raise ParameterError(msg)
    query = queries[name]
    unknown = sorted(set(values) - set(query.defaults))
    if unknown:
        msg = f"The query '{name}' has no parameter {', '.join(unknown)}; it has {', '.join(query.defaults) or 'none'}."
        raise ParameterError(msg)
    with guarded(engine.url), engine.connect() as connection:
        result = connection.execute(text(query.sql), query.defaults | values)
        return pd.DataFrame([tuple(row) for row in result], columns=list(result.keys()))


def _example(name: str) -> ExampleQuery:
    file = read_sql("queries", name)
    found = list(_PARAMETER.finditer(file.comment))
    return ExampleQuery(
        name=name,
        title=file.title,
        sql=file.sql,
        defaults={match["name"]: json.loads(match["value"]) for match in found},
        meanings={match["name"]: match["doc"] for match in found},
    )
