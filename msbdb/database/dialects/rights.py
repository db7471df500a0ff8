"""The roles reader, operator and owner: rights on msbdb's tables, views and functions, also over migrations.

- A reader selects from msbdb's tables and views and calls its functions.
- An operator also changes rows of builds (labelling a class again writes its run again), states of buildings and roof
  samples. An operator cannot change the inventory's history, the schema or the rights.
- The owner owns all objects: only an owner updates the inventory, migrates the schema and grants rights.
"""

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from typing import LiteralString

from sqlalchemy import Connection, Engine, text

from msbdb.database.dialects.dialect import dialect_of, guarded, shown
from msbdb.database.schema.sqlfiles import TABLE_VIEWS, VIEWS
from msbdb.database.schema.sqltables import METADATA, SQL, VERSION_TABLE
from msbdb.errors import DatabaseError, ParameterError

OPERATORS_OWN = ("operator_state", "roof_sample")
"""The tables with the operators' decisions."""

FUNCTIONS = ("footprint_at",)
"""msbdb's own functions; everybody may call those of PostGIS."""

_HELD = """
SELECT pg_get_userbyid(a.grantee) AS name, bool_or(a.privilege_type = 'INSERT') AS changes
FROM pg_class AS c, aclexplode(c.relacl) AS a
WHERE c.oid = 'run'::regclass AND a.grantee NOT IN (0, c.relowner)
GROUP BY 1 ORDER BY 1
"""
"""The users and their rights, from those on the table run, which no migration makes again."""


@contextmanager
def kept_rights(connection: Connection, *, but: str = "") -> Iterator[None]:
    """Give all users but one their rights again after a change that makes tables again or grants rights."""
    if connection.dialect.name != "postgresql":
        yield
        return
    held = [(row.name, "operator" if row.changes else "reader") for row in connection.execute(text(_HELD))]
    yield
    for user, role in held:
        if user != but:
            give(connection, role, user)


def written_by_operators(table: str) -> bool:
    """Return whether operators may change rows of a table: those of builds, and their own."""
    return table in ("survey", "source", "tile", *OPERATORS_OWN) or "run_id" in SQL[table].columns


def give(connection: Connection, role: str, user: str) -> None:
    """Give a user the rights of a role, besides its own: reader, operator, owner, or none."""
    if role == "none":
        return
    here = _schema(connection)
    if role == "owner":
        _hand_over(connection, here, user)
        return
    _execute(connection, "GRANT USAGE ON SCHEMA {here} TO {user}", here=here, user=user)
    for name in _relations(connection):
        _execute(connection, "GRANT SELECT ON {here}.{name} TO {user}", here=here, name=name, user=user)
        if role == "operator" and name in METADATA.tables and written_by_operators(name):
            statement = "GRANT INSERT, UPDATE, DELETE ON {here}.{name} TO {user}"
            _execute(connection, statement, here=here, name=name, user=user)
    for name in _functions(connection):
        _execute(connection, "GRANT EXECUTE ON FUNCTION {here}.{name} TO {user}", here=here, name=name, user=user)


def take(connection: Connection, user: str) -> None:
    """Take all rights from a user, and from everybody the right to make objects in the database."""
    here, database = _schema(connection), _database(connection)
    _execute(connection, "REVOKE CREATE ON SCHEMA {here} FROM PUBLIC", here=here)
    _execute(connection, "REVOKE TEMPORARY ON DATABASE {database} FROM PUBLIC", database=database)
    for name in _relations(connection):
        _execute(connection, "REVOKE ALL ON {here}.{name} FROM {user}", here=here, name=name, user=user)
    for name in _functions(connection):
        _execute(connection, "REVOKE ALL ON FUNCTION {here}.{name} FROM {user}", here=here, name=name, user=user)
    _execute(connection, "REVOKE TEMPORARY ON DATABASE {database} FROM {user}", database=database, user=user)
    _execute(connection, "REVOKE ALL ON SCHEMA {here} FROM {user}", here=here, user=user)


def _hand_over(connection: Connection, here: str, user: str) -> None:
    """Make a user the owner of the schema and of all tables, views and functions of msbdb in it.

    The owner of a schema gives the rights on it, whoever runs the statement, and so can take them back.
    """
    _execute(connection, "ALTER SCHEMA {here} OWNER TO {user}", here=here, user=user)
    database = _database(connection)
    _execute(connection, "GRANT TEMPORARY ON DATABASE {database} TO {user}", database=database, user=user)
    for name in _relations(connection):
        _execute(connection, "ALTER TABLE {here}.{name} OWNER TO {user}", here=here, name=name, user=user)
    for name in _functions(connection):
        _execute(connection, "ALTER FUNCTION {here}.{name} OWNER TO {user}", here=here, name=name, user=user)


def _relations(connection: Connection) -> list[str]:
    """Return msbdb's existing tables and views; ALTER TABLE and GRANT accept both."""
    own = [*METADATA.tables, *(view.name for view in (*VIEWS, *TABLE_VIEWS)), VERSION_TABLE]
    query = text("SELECT relname FROM pg_class WHERE relnamespace = current_schema()::regnamespace")
    there = set(connection.scalars(query))
    return sorted(name for name in own if name in there)


def _functions(connection: Connection) -> list[str]:
    """Return msbdb's existing functions."""
    query = text("SELECT proname FROM pg_proc WHERE pronamespace = current_schema()::regnamespace")
    there = set(connection.scalars(query))
    return [name for name in FUNCTIONS if name in there]


def _schema(connection: Connection) -> str:
    return str(connection.scalar(text("SELECT current_schema()")))


def _database(connection: Connection) -> str:
    return str(connection.scalar(text("SELECT current_database()")))


def _execute(connection: Connection, statement: LiteralString, **names: str) -> None:
    """Run a statement; the driver quotes the names that take the places in braces."""
    from psycopg import sql

    quoted = {place: sql.Identifier(name) for place, name in names.items()}
    with connection.connection.cursor() as cursor:  # type: ignore[attr-defined]  # psycopg's own
        cursor.execute(sql.SQL(statement).format(**quoted))


logger = logging.getLogger(__name__)

ROLES = ("reader", "operator", "owner", "none")
"""What can be granted; 'none' takes all rights back."""


def grant_role(engine: Engine, role: str, user: str) -> None:
    """Give a user of the server the rights of a role in a database, in place of its earlier ones.

    Parameters
    ----------
    engine : Engine
        From ``open_database``, as the owner of the database or a superuser.
    role : {'reader', 'operator', 'owner', 'none'}
        The role; ``none`` takes all rights back.
    user : str
        Name of a role of the server; all characters are allowed.

    Raises
    ------
    ParameterError
        For another role.
    DatabaseError
        When the database is a file, the user does not exist, the owner would lose its rights, or this connection may
        not grant. Nothing was changed.
    """
    if role not in ROLES:
        msg = f"A role is one of {', '.join(ROLES)}; got '{role}'."
        raise ParameterError(msg)
    if engine.dialect.name != "postgresql":
        msg = (
            f"The database {shown(engine.url)} is a file, so the rights of the file system apply. "
            "Use chmod and the like, or 'msbdb db copy' into a PostGIS database."
        )
        raise DatabaseError(msg)
    with guarded(engine.url), dialect_of(engine.url).writing(engine) as connection:
        _require_user(connection, user, role, shown(engine.url))
        with kept_rights(connection, but=user):
            take(connection, user)
            give(connection, role, user)
    logger.info("Granted the role %s in %s", role, shown(engine.url))


def _require_user(connection: Connection, user: str, role: str, where: str) -> None:
    """Refuse a user that does not exist, and taking the owner's rights."""
    if not connection.scalar(text("SELECT COUNT(*) FROM pg_roles WHERE rolname = :name"), {"name": user}):
        msg = f"The server of {where} has no user '{user}'. Let its administrator make one by CREATE ROLE ... LOGIN."
        raise DatabaseError(msg)
    owns = "SELECT pg_get_userbyid(relowner), pg_has_role(relowner, 'USAGE') FROM pg_class WHERE oid = 'run'::regclass"
    owner, is_ours = connection.execute(text(owns)).one()
    if not is_ours:
        # The server would only warn that nothing was granted.
        msg = f"Rights on {where} are given by its owner, '{owner}'. Connect as that user, or as a superuser."
        raise DatabaseError(msg)
    if owner == user and role != "owner":
        msg = f"The user '{user}' owns the database {where}. Make another one its owner first, with --role owner."
        raise DatabaseError(msg)
