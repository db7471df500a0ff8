"""Fewer indexes of parts, because each of them is written with every row of a load.

Trees are found by their building, fathers by their id alone, and scales and classes of a run share an index.
"""

from alembic import op

revision = "0009"
down_revision = "0008"

VIEW, TABLE = "roof_material_by_class", "part"
BEFORE = (
    ("father_id", "supscale", "root_id", "run_id"),
    ("root_id",),
    ("run_id", "scale"),
    ("run_id", "class_id"),
)
AFTER = (("father_id",), ("run_id", "scale", "class_id"))


def upgrade() -> None:
    """Make the indexes anew, and the view that found trees by their root."""
    replace(BEFORE, AFTER, revision)


def downgrade() -> None:
    """Make those of the former schema."""
    replace(AFTER, BEFORE, "0001")


def replace(old: tuple[tuple[str, ...], ...], new: tuple[tuple[str, ...], ...], version: str) -> None:
    """Put indexes in the place of others, and the view of a version; its columns and rights stay."""
    script = op.get_context().script
    script.get_revision("0003").module.settle_keys()
    views = script.get_revision("0005").module
    for columns in old:
        op.drop_index(f"ix_{TABLE}_{'_'.join(columns)}", TABLE)
    for columns in new:
        op.create_index(f"ix_{TABLE}_{'_'.join(columns)}", TABLE, list(columns))
    if op.get_bind().dialect.name == "postgresql":
        op.execute(f"CREATE OR REPLACE VIEW {VIEW} AS\n{views.statement(VIEW, version)}")
    else:
        op.execute(f"DROP VIEW {VIEW}")
        op.execute(f"CREATE VIEW {VIEW} AS\n{views.statement(VIEW, version)}")
