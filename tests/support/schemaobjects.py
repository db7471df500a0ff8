"""All that a database's schema consists of, as the database itself keeps it."""

from sqlalchemy import Connection, text

POSTGIS_OBJECTS = """
SELECT 'column', table_name || '.' || column_name, data_type || ' ' || is_nullable || ' ' || udt_name || ' '
       || COALESCE(generation_expression, '') || ' ' || ordinal_position
FROM information_schema.columns WHERE table_schema = 'public' AND table_name <> 'spatial_ref_sys'
UNION ALL
SELECT 'constraint', conname, pg_get_constraintdef(oid) FROM pg_constraint WHERE connamespace = 'public'::regnamespace
UNION ALL
SELECT 'index', indexname, indexdef FROM pg_indexes WHERE schemaname = 'public'
UNION ALL
SELECT 'view', viewname, definition FROM pg_views WHERE schemaname = 'public'
UNION ALL
SELECT 'comment', c.relname || '.' || d.objsubid, d.description
FROM pg_description d JOIN pg_class c ON c.oid = d.objoid WHERE c.relnamespace = 'public'::regnamespace
UNION ALL
SELECT 'function', p.proname, pg_get_functiondef(p.oid) FROM pg_proc p
WHERE p.pronamespace = 'public'::regnamespace
  AND NOT EXISTS (SELECT 1 FROM pg_depend d WHERE d.objid = p.oid AND d.deptype = 'e')
UNION ALL
SELECT 'geometry', f_table_name, type || srid FROM geometry_columns
"""


def objects(connection: Connection) -> set[tuple[str, ...]]:
    """Return all tables, constraints, indexes, views and comments of a database, as it keeps them."""
    if connection.dialect.name == "postgresql":
        # The version table is Alembic's own and has its own name for the primary key.
        rows = connection.execute(text(POSTGIS_OBJECTS)).all()
        return {tuple(map(str, row)) for row in rows if "msbdb_schema_version" not in str(row)}
    rows = connection.execute(text("SELECT type, name, sql FROM sqlite_master WHERE sql IS NOT NULL")).all()
    rows += connection.execute(
        text("SELECT 'geometry', f_table_name, geometry_type * srid FROM geometry_columns")
    ).all()
    rows += connection.execute(text("SELECT 'view', view_name, view_rowid FROM views_geometry_columns"))
    found = {tuple("".join(str(cell).split()).replace('"', "") for cell in row) for row in rows}
    return {row for row in found if "msbdb_schema_version" not in row[1]}
