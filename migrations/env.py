"""The entry of Alembic: msbdb passes the connection, the dialect and the SRID."""

from alembic import context

from msbdb.database.schema.sqltables import METADATA, VERSION_TABLE

attributes = context.config.attributes
context.configure(
    connection=attributes["connection"],
    target_metadata=METADATA,
    version_table=VERSION_TABLE,
    transactional_ddl=True,
    srid=attributes["srid"],
    hooks=attributes["dialect"],
)
with context.begin_transaction():
    context.run_migrations()
