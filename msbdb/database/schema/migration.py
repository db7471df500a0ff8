"""Creating and upgrading the schema through Alembic."""

from alembic import command
from alembic.config import Config
from alembic.migration import MigrationContext
from alembic.script import ScriptDirectory
from sqlalchemy import Connection, text

from msbdb.database.dialects.dialect import Dialect
from msbdb.database.schema.sqlfiles import TABLE_VIEWS, VIEWS, packaged
from msbdb.database.schema.sqltables import METADATA
from msbdb.database.schema.srid import crs_from, register
from msbdb.errors import SchemaVersionError

VERSION_TABLE = "msbdb_schema_version"


def head_version() -> str:
    """Return the schema version that this msbdb reads and writes."""
    return str(ScriptDirectory.from_config(_config()).get_current_head())


def schema_version(connection: Connection) -> str:
    """Return the schema version of a database; empty before the first migration."""
    context = MigrationContext.configure(connection, opts={"version_table": VERSION_TABLE})
    return context.get_current_revision() or ""


def initialise(connection: Connection, dialect: Dialect, srid: int, crs_wkt: str) -> None:
    """Write the CRS and the whole schema into an empty database, inside the caller's transaction."""
    register(connection, srid, crs_from(srid, crs_wkt))
    migrate(connection, dialect, srid)


def migrate(connection: Connection, dialect: Dialect, srid: int) -> None:
    """Bring the schema to the newest version, inside the caller's transaction.

    Comments are documentation, not schema: they are written afresh from the declarations, so that no migration
    copies them.
    """
    command.upgrade(configured(connection, dialect, srid), "head")
    if connection.dialect.supports_comments:
        for statement in comment_ddl():
            connection.execute(text(statement.replace(":", r"\:")))


def require_version(connection: Connection, where: str) -> bool:
    """Tell whether the schema is the newest.

    Raises
    ------
    SchemaVersionError
        When it is of a newer msbdb.
    """
    found = schema_version(connection)
    known = {script.revision for script in ScriptDirectory.from_config(_config()).walk_revisions()}
    if found and found not in known:
        msg = (
            f"The database {where} has the schema {found}; this msbdb knows schemas up to {head_version()}. "
            "Use the msbdb that wrote it, or a newer one."
        )
        raise SchemaVersionError(msg)
    return found == head_version()


def configured(connection: Connection, dialect: Dialect, srid: int) -> Config:
    """Return Alembic's configuration with what the migrations ask for."""
    config = _config()
    config.attributes.update(connection=connection, dialect=dialect, srid=srid)
    return config


def older_versions(version: str) -> list[str]:
    """Return the versions to which a schema of this one can be brought down, the nearest first."""
    older = []
    scripts = ScriptDirectory.from_config(_config())
    script = scripts.get_revision(version)
    while script.down_revision is not None and hasattr(script.module, "downgrade"):
        script = scripts.get_revision(str(script.down_revision))
        older.append(script.revision)
    return older


def comment_ddl() -> list[str]:
    """Return the statements that comment tables, columns and views, for dialects that keep comments."""
    statements = []
    for table in METADATA.sorted_tables:
        statements.append(f"COMMENT ON TABLE {table.name} IS {_quoted(table.comment or '')}")
        statements += [
            f"COMMENT ON COLUMN {table.name}.{column.name} IS {_quoted(column.comment or '')}"
            for column in table.columns
        ]
    for view in (*VIEWS, *TABLE_VIEWS):
        statements.append(f"COMMENT ON VIEW {view.name} IS {_quoted(view.doc)}")
    return statements


def _quoted(words: str) -> str:
    return "'" + words.replace("'", "''") + "'"


def _config() -> Config:
    config = Config()
    config.set_main_option("script_location", str(packaged("migrations")).replace("%", "%%"))
    config.set_main_option("path_separator", "os")
    return config
