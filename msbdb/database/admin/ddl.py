"""The files of ``schema/``, generated from the declarations: the DDL of each dialect and the data dictionary."""

from sqlalchemy import URL, CheckConstraint, Column, Dialect, ForeignKeyConstraint, Table, UniqueConstraint
from sqlalchemy.schema import CreateIndex, CreateTable

from msbdb.database.dialects import postgis, spatialite
from msbdb.database.dialects.dialect import Dialect as Hooks
from msbdb.database.dialects.migration import comment_ddl, head_version
from msbdb.database.examples import example_queries
from msbdb.database.runs.digests import COLUMN, TABLES
from msbdb.database.schema.sqlfiles import TABLE_VIEWS, VIEWS
from msbdb.database.schema.sqltables import METADATA, SPATIAL, VERSION_TABLE
from msbdb.tables.view_columns import VIEW_COLUMNS

_NOTE = "Written by scripts/generate_schema; change msbdb.tables and the migrations instead."

_QUERIES = (
    "Each file runs as it is in psql and in sqlite3 with mod_spatialite; the values to edit are at its top. "
    "`msbdb query` runs them, too."
)

_HOOKS: dict[str, tuple[Hooks, Dialect, str]] = {
    "spatialite": (spatialite, URL.create("sqlite").get_dialect()(), "SELECT InitSpatialMetaData(0, 'NONE')"),
    "postgis": (postgis, URL.create("postgresql+psycopg").get_dialect()(), "CREATE EXTENSION IF NOT EXISTS postgis"),
}


def ddl(dialect: str, srid: int | str = ":srid") -> str:
    """Return the whole schema as SQL.

    Parameters
    ----------
    dialect : str
        ``spatialite`` or ``postgis``.
    srid : int or str
        SRID of the geometries, or the placeholder that psql and similar programs fill in.
    """
    title = f"-- The schema {head_version()} of msbdb for {dialect}.\n-- {_NOTE}\n"
    place = f"-- {srid} is the EPSG code of the database's one CRS, which must be in spatial_ref_sys.\n"
    return f"{title}{place}\n" + "".join(f"{statement};\n\n" for statement in statements(dialect, srid))


def statements(dialect: str, srid: int | str) -> list[str]:
    """Return the schema's statements in order, without semicolons."""
    hooks, compiler, first = _HOOKS[dialect]
    made = [first]
    for table in METADATA.sorted_tables:
        made.append(_table_ddl(table, compiler))
        indexes = sorted(table.indexes, key=lambda index: str(index.name))
        made += [str(CreateIndex(index).compile(dialect=compiler)) for index in indexes]
    for name, kind in SPATIAL.items():
        made += hooks.geometry_ddl(name, kind, srid)
    made += [f"ALTER TABLE {name} ADD COLUMN {COLUMN} BIGINT" for name in TABLES]
    made += [f"CREATE VIEW {view.name} AS\n{view.sql}" for view in TABLE_VIEWS]
    for view in VIEWS:
        made.append(f"CREATE VIEW {view.name} AS\n{view.sql}")
        made += hooks.view_ddl(view.name, view.key, view.base)
    made += hooks.function_ddl()
    if compiler.supports_comments:
        made += comment_ddl()
    made.append(f"CREATE TABLE {VERSION_TABLE} (version_num VARCHAR(32) NOT NULL PRIMARY KEY)")
    made.append(f"INSERT INTO {VERSION_TABLE} (version_num) VALUES ('{head_version()}')")  # noqa: S608  (our number)
    return made


def dictionary() -> str:
    """Return the data dictionary as Markdown: every table, column, view and example query."""
    lines = [
        "# Data dictionary",
        "",
        f"Schema {head_version()}. {_NOTE}",
        "",
        "Coordinates are in the database's one CRS, lengths in metres. *Key* names what a column refers to.",
    ]
    for table in sorted(METADATA.tables.values(), key=lambda t: t.name):
        lines += _table_entry(table)
    lines += ["", "# Views", ""]
    lines += ["In a database of PostGIS `\\d+` shows the same words."]
    for view in (*VIEWS, *TABLE_VIEWS):
        geometry = f"With the geometry of `{view.base}`." if view.base else "Without geometry."
        lines += ["", f"## {view.name}", "", f"{view.doc} {geometry}", "", "| Column | Meaning |", "| --- | --- |"]
        lines += [f"| {column.name} | {column.comment} |" for column in VIEW_COLUMNS[view.name]]
    lines += ["", "On PostGIS also the function `footprint_at(date)`: the inventory as it was on a day."]
    lines += ["", "# Example queries", "", f"In `schema/queries/`. {_QUERIES}", ""]
    lines += [f"- `{query.name}`: {query.title}" for query in example_queries().values()]
    return "\n".join(lines) + "\n"


def _table_ddl(table: Table, compiler: Dialect) -> str:
    """Return CREATE TABLE without geometry and digest, which later statements add."""
    lines = str(CreateTable(table).compile(dialect=compiler)).strip().splitlines()
    later = ("geometry ", f"{COLUMN} ")
    return "\n".join(line.replace("\t", "  ").rstrip() for line in lines if not line.strip().startswith(later))


def _table_entry(table: Table) -> list[str]:
    lines = ["", f"## {table.name}", "", str(table.comment), ""]
    lines += ["| Column | Type | Null | Key | Meaning |", "| --- | --- | --- | --- | --- |"]
    for column in table.columns:
        kind = f"{SPATIAL[table.name]}" if column.name == "geometry" else str(column.type)
        null = "yes" if column.nullable else ""
        lines.append(f"| {column.name} | {kind} | {null} | {_keys(column)} | {_meaning(column)} |")
    rules = sorted(str(c.sqltext) for c in table.constraints if isinstance(c, CheckConstraint))
    rules += sorted(
        f"{', '.join(c.columns.keys())} together are unique"
        for c in table.constraints
        if isinstance(c, UniqueConstraint)
    )
    rules += sorted(
        f"{', '.join(c.column_keys)} refer to {', '.join(e.target_fullname for e in c.elements)}"
        for c in table.constraints
        if isinstance(c, ForeignKeyConstraint) and len(c.elements) > 1
    )
    if rules:
        lines += ["", "Rules:", "", *(f"- {rule}" for rule in rules)]
    return lines


def _keys(column: "Column[object]") -> str:
    keys = ["primary"] if column.primary_key else []
    single = [k for k in column.foreign_keys if k.constraint is not None and len(k.constraint.elements) == 1]
    keys += sorted(key.target_fullname for key in single)
    return ", ".join(keys)


def _meaning(column: "Column[object]") -> str:
    made = f"; computed as {column.computed.sqltext}" if column.computed is not None else ""
    return f"{column.comment}{made}".replace("|", "\\|")
