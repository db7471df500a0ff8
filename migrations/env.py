"""Alembic's entry: msbdb hands over the connection, the dialect's hooks and the SRID."""

from alembic import context

from msbdb.database.schema.sqltables import METADATA

attributes = context.config.attributes
context.configure(
    connection=attributes["connection"],
    target_metadata=METADATA,
    version_table="msbdb_schema_version",
    transactional_ddl=True,
    srid=attributes["srid"],
    hooks=attributes["dialect"],
)
with context.begin_transaction():
    context.run_migrations()
