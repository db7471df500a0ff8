"""Creating, upgrading and downgrading the schema.

Alembic runs the migrations and is imported only for that: opening a database reads the version from its table, and the
known versions from the names of the migrations' files.
"""

from typing import TYPE_CHECKING

from sqlalchemy import Connection, inspect, text

from msbdb.database.dialects.dialect import Dialect
from msbdb.database.schema.sqlfiles import TABLE_VIEWS, VIEWS, packaged
from msbdb.database.schema.sqltables import METADATA, VERSION_TABLE
from msbdb.database.schema.srid import crs_from, register
from msbdb.errors import SchemaVersionError
from msbdb.tables.view_columns import GEOMETRY, VIEW_COLUMNS

if TYPE_CHECKING:
    from alembic.config import Config


def head_version() -> str:
    """Return the schema version that this msbdb reads and writes."""
    return known_versions()[-1]


def known_versions() -> list[str]:
    """Return the versions that this msbdb has migrations for, oldest first: the numbers before the files' names."""
    return sorted(path.name.partition("_")[0] for path in (packaged("migrations") / "versions").glob("[0-9]*_*.py"))


def schema_version(connection: Connection) -> str:
    """Return the schema version of a database; empty before the first migration."""
    if not inspect(connection).has_table(VERSION_TABLE):
        return ""
    return connection.scalar(text(f"SELECT version_num FROM {VERSION_TABLE}")) or ""  # noqa: S608  (our own name)


def initialise(connection: Connection, dialect: Dialect, srid: int, crs_wkt: str) -> None:
    """Write the CRS and the whole schema into an empty database, inside the caller's transaction."""
    register(connection, srid, crs_from(srid, crs_wkt))
    migrate(connection, dialect, srid)


def migrate(connection: Connection, dialect: Dialect, srid: int) -> None:
    """Bring the schema to the newest version, inside the caller's transaction.

    Comments are documentation, not schema: each upgrade writes them from the declarations.
    """
    from alembic import command

    command.upgrade(_configured(connection, dialect, srid), "head")
    if connection.dialect.supports_comments:
        for statement in comment_ddl():
            connection.execute(text(statement.replace(":", r"\:")))


def require_version(connection: Connection, where: str) -> bool:
    """Return whether the schema is the newest.

    Raises
    ------
    SchemaVersionError
        When it is of a newer msbdb.
    """
    found = schema_version(connection)
    if found and found not in known_versions():
        msg = (
            f"The database {where} has the schema {found}; this msbdb knows schemas up to {head_version()}. "
            "Use the msbdb that wrote it, or a newer one."
        )
        raise SchemaVersionError(msg)
    return found == head_version()


def migrate_down(connection: Connection, dialect: Dialect, version: str) -> None:
    """Bring the schema to an older version, inside the caller's transaction.

    Raises
    ------
    SchemaVersionError
        When Alembic has no way to that version.
    """
    from alembic import command
    from alembic.util import CommandError

    try:
        command.downgrade(_configured(connection, dialect, dialect.database_srid(connection)), version)
    except CommandError as error:
        msg = f"The schema cannot be brought down to {version}: {error}. Give one of {', '.join(known_versions())}."
        raise SchemaVersionError(msg) from error
    dialect.settle(connection)


def _configured(connection: Connection, dialect: Dialect, srid: int) -> "Config":
    """Return Alembic's configuration with the values that the migrations need."""
    config = _config()
    config.attributes.update(connection=connection, dialect=dialect, srid=srid)
    return config


def older_versions(version: str) -> list[str]:
    """Return the versions to which a schema of this one can be brought down, the nearest first."""
    from alembic.script import ScriptDirectory

    older = []
    scripts = ScriptDirectory.from_config(_config())
    script = scripts.get_revision(version)
    while script.down_revision is not None and hasattr(script.module, "downgrade"):
        script = scripts.get_revision(str(script.down_revision))
        older.append(script.revision)
    return older


def comment_ddl() -> list[str]:
    """Return the statements that comment tables, views and the columns of both, for dialects that keep comments."""
    statements = []
    for table in METADATA.sorted_tables:
        statements.append(f"COMMENT ON TABLE {table.name} IS {_quoted(table.comment or '')}")
        statements += [
            f"COMMENT ON COLUMN {table.name}.{column.name} IS {_quoted(column.comment or '')}"
            for column in table.columns
        ]
    for view in (*VIEWS, *TABLE_VIEWS):
        statements.append(f"COMMENT ON VIEW {view.name} IS {_quoted(view.doc)}")
        columns = [*VIEW_COLUMNS[view.name], *([GEOMETRY] if view.base else [])]
        statements += [
            f"COMMENT ON COLUMN {view.name}.{column.name} IS {_quoted(column.comment)}" for column in columns
        ]
    return statements


def _quoted(words: str) -> str:
    return "'" + words.replace("'", "''") + "'"


def _config() -> "Config":
    from alembic.config import Config

    config = Config()
    config.set_main_option("script_location", str(packaged("migrations")).replace("%", "%%"))
    config.set_main_option("path_separator", "os")
    return config
