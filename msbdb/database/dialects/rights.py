"""Rights of the server's users on msbdb's tables, views and functions, given, taken and kept over migrations.

- A reader selects from msbdb's tables and views and calls its functions.
- An operator also changes rows of the builds (labelling a class anew writes its run anew), and the operators' own:
  states of buildings and roof samples. The inventory's history, the schema and the rights are beyond an operator.
- The owner owns all of it: only an owner updates the inventory, migrates the schema and grants rights.
"""

from collections.abc import Iterator
from contextlib import contextmanager

from psycopg import sql
from sqlalchemy import Connection, text

from msbdb.database.schema.sqlfiles import TABLE_VIEWS, VIEWS
from msbdb.database.schema.sqltables import METADATA, SQL

VERSION_TABLE = "msbdb_schema_version"

OPERATORS_OWN = ("operator_state", "roof_sample")
"""The tables that hold what operators decide."""

FUNCTIONS = ("footprint_at",)
"""msbdb's own functions; PostGIS's are everybody's."""

_HELD = """
SELECT pg_get_userbyid(a.grantee) AS name, bool_or(a.privilege_type = 'INSERT') AS changes
FROM pg_class AS c, aclexplode(c.relacl) AS a
WHERE c.oid = 'run'::regclass AND a.grantee NOT IN (0, c.relowner)
GROUP BY 1 ORDER BY 1
"""
"""Who holds which rights, by those on the table run, which no migration makes anew."""


@contextmanager
def kept_rights(connection: Connection, *, but: str = "") -> Iterator[None]:
    """Give all users but one their rights again after what makes tables anew or changes who granted them."""
    if connection.dialect.name != "postgresql":
        yield
        return
    held = [(row.name, "operator" if row.changes else "reader") for row in connection.execute(text(_HELD))]
    yield
    for user, role in held:
        if user != but:
            give(connection, role, user)


def written_by_operators(table: str) -> bool:
    """Tell whether operators change rows of a table: those of builds, and their own."""
    return table in ("survey", "source", *OPERATORS_OWN) or "run_id" in SQL[table].columns


def give(connection: Connection, role: str, user: str) -> None:
    """Give a user the rights of a role, beside those that it has: reader, operator, owner, or none."""
    if role == "none":
        return
    to, here = sql.Identifier(user), _schema(connection)
    if role == "owner":
        _hand_over(connection, here, to)
        return
    _execute(connection, sql.SQL("GRANT USAGE ON SCHEMA {} TO {}").format(here, to))
    for name in _relations(connection):
        _execute(connection, sql.SQL("GRANT SELECT ON {}.{} TO {}").format(here, sql.Identifier(name), to))
        if role == "operator" and name in METADATA.tables and written_by_operators(name):
            statement = sql.SQL("GRANT INSERT, UPDATE, DELETE ON {}.{} TO {}")
            _execute(connection, statement.format(here, sql.Identifier(name), to))
    for name in _functions(connection):
        _execute(connection, sql.SQL("GRANT EXECUTE ON FUNCTION {}.{} TO {}").format(here, sql.Identifier(name), to))


def take(connection: Connection, user: str) -> None:
    """Take all rights from a user, and from everybody what nobody needs: making objects in the database."""
    of, here, database = sql.Identifier(user), _schema(connection), _database(connection)
    _execute(connection, sql.SQL("REVOKE CREATE ON SCHEMA {} FROM PUBLIC").format(here))
    _execute(connection, sql.SQL("REVOKE TEMPORARY ON DATABASE {} FROM PUBLIC").format(database))
    for name in _relations(connection):
        _execute(connection, sql.SQL("REVOKE ALL ON {}.{} FROM {}").format(here, sql.Identifier(name), of))
    for name in _functions(connection):
        _execute(connection, sql.SQL("REVOKE ALL ON FUNCTION {}.{} FROM {}").format(here, sql.Identifier(name), of))
    _execute(connection, sql.SQL("REVOKE TEMPORARY ON DATABASE {} FROM {}").format(database, of))
    _execute(connection, sql.SQL("REVOKE ALL ON SCHEMA {} FROM {}").format(here, of))


def _hand_over(connection: Connection, here: sql.Identifier, to: sql.Identifier) -> None:
    """Make a user the owner of the schema and of all tables, views and functions of msbdb in it.

    The schema's too, as rights on it are given by its owner, whoever gives them, and so can be taken back.
    """
    _execute(connection, sql.SQL("ALTER SCHEMA {} OWNER TO {}").format(here, to))
    _execute(connection, sql.SQL("GRANT TEMPORARY ON DATABASE {} TO {}").format(_database(connection), to))
    for name in _relations(connection):
        _execute(connection, sql.SQL("ALTER TABLE {}.{} OWNER TO {}").format(here, sql.Identifier(name), to))
    for name in _functions(connection):
        _execute(connection, sql.SQL("ALTER FUNCTION {}.{} OWNER TO {}").format(here, sql.Identifier(name), to))


def _relations(connection: Connection) -> list[str]:
    """Return the tables and views that are msbdb's own and there; ALTER TABLE and GRANT take both."""
    own = [*METADATA.tables, *(view.name for view in (*VIEWS, *TABLE_VIEWS)), VERSION_TABLE]
    query = text("SELECT relname FROM pg_class WHERE relnamespace = current_schema()::regnamespace")
    there = set(connection.scalars(query))
    return sorted(name for name in own if name in there)


def _functions(connection: Connection) -> list[str]:
    """Return the functions that are msbdb's own and there."""
    query = text("SELECT proname FROM pg_proc WHERE pronamespace = current_schema()::regnamespace")
    there = set(connection.scalars(query))
    return [name for name in FUNCTIONS if name in there]


def _schema(connection: Connection) -> sql.Identifier:
    return sql.Identifier(str(connection.scalar(text("SELECT current_schema()"))))


def _database(connection: Connection) -> sql.Identifier:
    return sql.Identifier(str(connection.scalar(text("SELECT current_database()"))))


def _execute(connection: Connection, statement: sql.Composed) -> None:
    """Run a statement whose identifiers the driver has quoted."""
    with connection.connection.cursor() as cursor:  # type: ignore[attr-defined]  # psycopg's own
        cursor.execute(statement)
