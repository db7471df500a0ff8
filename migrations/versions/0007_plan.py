"""The plan by which a run was built; runs that are there have none until they are built again."""

from alembic import op

revision = "0007"
down_revision = "0006"

TABLE = "survey_plan"


def upgrade() -> None:
    """Create the table."""
    baseline = op.get_context().script.get_revision("0001").module
    op.create_table(
        TABLE,
        *baseline.integers("run_id"),
        *baseline.documents("plan"),
        baseline.key(TABLE, "run_id"),
        baseline.of_run(TABLE),
    )


def downgrade() -> None:
    """Drop it; the runs stay, and their digests count no plan."""
    op.drop_table(TABLE)
