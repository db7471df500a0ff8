"""No SQL is built from what users give: a scan of the source, and comments that the server itself shows."""

import ast
import re
from functools import cache
from pathlib import Path

import pytest
from simulated.builds import EPSG, HOSTILE, small_build
from sqlalchemy import Engine, text
from support.sizes import sample

from msbdb.database import list_runs, open_database, read_build, write_build
from msbdb.database.admin.ddl import statements
from msbdb.database.schema.sqlfiles import TABLE_VIEWS, VIEWS
from msbdb.database.schema.sqltables import METADATA
from msbdb.tables.view_columns import VIEW_COLUMNS

ROOT = Path(__file__).resolve().parents[2]
SQL = re.compile(
    r"\s*(SELECT|INSERT|UPDATE|DELETE|CREATE|DROP|ALTER|COPY|GRANT|REVOKE|TRUNCATE|ANALYZE|PRAGMA|COMMENT|WITH|LOCK|SET"
    r"|BEGIN|VACUUM|EXPLAIN|WHERE|FROM|JOIN|ORDER BY|VALUES|AND)\b(?-i: )?[\s({]*",
)
"""How statements and pieces of them begin: keywords in capitals."""

OUR_NAMES = "names of tables, columns and views are the declared tables'"
ALLOWED = {
    "admin/declarationchecks.py": f"{OUR_NAMES}; conditions are the declared rules",
    "admin/shapechecks.py": OUR_NAMES,
    "dialects/bulk.py": OUR_NAMES,
    "dialects/postgis.py": OUR_NAMES,
    "dialects/setkeys.py": OUR_NAMES,
    "dialects/spatialite.py": OUR_NAMES,
    "dialects/sqliteconnection.py": "kinds of transactions and values of pragmas are ours",
    "history/periods.py": OUR_NAMES,
    "history/shownlayers.py": OUR_NAMES,
    "runs/reading.py": OUR_NAMES,
    "admin/ddl.py": OUR_NAMES,
    "dialects/migration.py": "comments of the declared tables, quoted; the table of the version",
    "schema/srid.py": "columns of spatial_ref_sys",
    "msbdb/export/standards/inspire.py": "the columns of INSPIRE's table of heights",
}
"""The modules that put SQL together, and of what; values always go as parameters. A new one needs a reason here."""

USERS_WORDS = {
    "survey", "layer", "user", "name", "path", "role", "operator", "note", "material", "label", "labels", "attributes",
    "words", "value", "values_", "date", "reason", "stage", "source", "epsg", "wkt", "crs_wkt", "password",
}  # fmt: skip
"""Names of variables that hold what users give: none of them is ever put into a statement."""


def pieces(tree: ast.AST) -> list[tuple[ast.AST, str, list[ast.expr]]]:
    """Return the strings that a module puts together: the node, its first words, and what is put in."""
    found: list[tuple[ast.AST, str, list[ast.expr]]] = []
    for node in ast.walk(tree):
        if isinstance(node, ast.JoinedStr):
            put_in = [part.value for part in node.values if isinstance(part, ast.FormattedValue)]
            first = node.values[0] if node.values else None
            words = first.value if isinstance(first, ast.Constant) else ""
            found.append((node, str(words), put_in))
        elif isinstance(node, ast.BinOp) and isinstance(node.op, ast.Mod | ast.Add):
            side = node.left
            if isinstance(side, ast.Constant) and isinstance(side.value, str):
                found.append((node, side.value, [node.right]))
        elif (
            isinstance(node, ast.Call)
            and isinstance(node.func, ast.Attribute)
            and node.func.attr in ("format", "format_map")
            and isinstance(node.func.value, ast.Constant)
        ):
            found.append((node, str(node.func.value.value), [*node.args, *(word.value for word in node.keywords)]))
    return [(node, words, put_in) for node, words, put_in in found if put_in and SQL.match(words)]


@cache
def modules() -> dict[str, ast.AST]:
    """Return the syntax of each module of the package, by its path in the room of the database or in the package."""
    room = ROOT / "msbdb" / "database"
    return {
        str(path.relative_to(room) if path.is_relative_to(room) else path.relative_to(ROOT)): ast.parse(
            path.read_text()
        )
        for path in sorted((ROOT / "msbdb").rglob("*.py"))
    }


def test_sql_is_put_together_in_known_places_alone() -> None:
    """Outside of the modules that are listed, with their reason, every statement is a constant or SQLAlchemy's."""
    assert {name for name, tree in modules().items() if pieces(tree)} <= set(ALLOWED)


def test_nothing_that_users_give_is_put_into_a_statement() -> None:
    """Survey, layer, role and other names go as parameters, or are quoted by the driver."""
    for name, tree in modules().items():
        for node, words, put_in in pieces(tree):
            used = {leaf.id for value in put_in for leaf in ast.walk(value) if isinstance(leaf, ast.Name)}
            where = f"{name}:{node.lineno}: {words[:40]}"
            assert not used & (USERS_WORDS - {"name"}), where


def test_the_scan_finds_what_it_is_for() -> None:
    """Each way of putting words into a statement, and none that is not SQL."""
    for bad in (
        'f"SELECT * FROM survey WHERE name = {survey}"',
        "\"DELETE FROM run WHERE name = '%s'\" % survey",
        '"DROP TABLE {}".format(layer)',
        '"INSERT INTO survey VALUES (" + survey',
        'f"GRANT SELECT ON part TO {user}"',
    ):
        assert pieces(ast.parse(bad)), bad
    for good in (
        'f"Select a survey, such as {survey}."',
        'sql.SQL("GRANT SELECT ON {} TO {}").format(a, b)',
        '"SELECT 1"',
    ):
        assert not pieces(ast.parse(good)), good


def test_the_reasons_are_of_modules_that_exist() -> None:
    """No allowance outlives its module."""
    assert set(ALLOWED) <= set(modules())


NAMES = [HOSTILE, '"quoted"', "a\\'b", "%s %(x)s :name {0} $1", "zeile\numbruch", "🏠 [/red]", "' OR 1=1 --"]


@pytest.mark.parametrize("name", sample(NAMES, 3))
def test_hostile_names_stay_data(engine: Engine, name: str) -> None:
    """Written, found, read and replaced under just this name."""
    write_build(engine, small_build(name))
    assert write_build(engine, small_build(name)).status == "unchanged"
    assert list_runs(engine)["survey"].tolist() == [name]
    assert read_build(engine, name).survey.name == name
    with engine.connect() as connection:
        assert connection.scalar(text("SELECT COUNT(*) FROM part")) == 6


def test_the_generated_schema_comments_on_everything() -> None:
    """Each table, column and view has its words."""
    made = "\n".join(statements("postgis", EPSG))
    for table in METADATA.tables.values():
        assert f"COMMENT ON TABLE {table.name} IS '" in made
        for column in table.columns:
            assert f"COMMENT ON COLUMN {table.name}.{column.name} IS '" in made
    for view in (*VIEWS, *TABLE_VIEWS):
        assert f"COMMENT ON VIEW {view.name} IS '" in made


def test_the_words_of_views_fit_their_columns(engine: Engine) -> None:
    """The declared columns of each view are those that it has, in their order."""
    with engine.connect() as connection:
        for view in (*VIEWS, *TABLE_VIEWS):
            names = list(connection.execute(text(f"SELECT * FROM {view.name} LIMIT 0")).keys())
            declared = [column.name for column in VIEW_COLUMNS[view.name]]
            assert names == [*declared, *(["geometry"] if view.base else [])], view.name


@pytest.mark.postgis
def test_the_server_explains_tables_and_columns(new_postgis) -> None:
    """What psql shows of tables, columns and views is empty for none of them."""
    engine = open_database(new_postgis(), create=True, srid=EPSG)
    query = """
    SELECT c.relname, a.attname FROM pg_class AS c
    LEFT JOIN pg_attribute AS a ON a.attrelid = c.oid AND a.attnum > 0 AND NOT a.attisdropped
    WHERE c.relnamespace = 'public'::regnamespace AND c.relkind IN ('r', 'v')
      AND c.relname NOT IN ('spatial_ref_sys', 'geometry_columns', 'geography_columns', 'msbdb_schema_version')
      AND (COALESCE(obj_description(c.oid, 'pg_class'), '') = ''
           OR (a.attnum IS NOT NULL AND COALESCE(col_description(c.oid, a.attnum), '') = ''))
    """
    with engine.connect() as connection:
        assert connection.execute(text(query)).all() == []
