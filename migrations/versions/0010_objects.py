"""Tables hold an empty object where a row has no imported attributes: QGIS warns of each null among JSON values.

The digests of the rows stay, as an empty object is no value in them either.
"""

from alembic import op

revision = "0010"
down_revision = "0009"

TABLES = ("building_version", "roof_sample")


def upgrade() -> None:
    """Write the empty objects."""
    for table in TABLES:
        op.execute(f"UPDATE {table} SET attributes = '{{}}' WHERE attributes IS NULL")  # noqa: S608  (our own names)


def downgrade() -> None:
    """Write null in their place."""
    for table in TABLES:
        op.execute(f"UPDATE {table} SET attributes = NULL WHERE CAST(attributes AS TEXT) = '{{}}'")  # noqa: S608  (our own names)
