"""Views of the parts of the inventory, also of buildings that borders of surveys cut."""

from pathlib import Path

from alembic import op

revision = "0006"
down_revision = "0005"

TEXTS = Path(__file__).parents[1] / "sql" / revision
VIEW, PIECES = "part_current", "building_piece"
INDEX = ("ix_building_version_building_id", "building_version", ["building_id"])


def upgrade() -> None:
    """Create the views, and the index by which they find versions."""
    op.create_index(*INDEX)
    for view in (PIECES, VIEW):
        lines = (TEXTS / f"{view}.sql").read_text(encoding="utf-8").splitlines()
        statement = "\n".join(line for line in lines if not line.startswith("--")).strip().rstrip(";")
        op.execute(f"CREATE VIEW {view} AS\n{statement}")
    for statement in op.get_context().opts["hooks"].view_ddl(VIEW, "part_id", "part"):
        op.execute(statement)


def downgrade() -> None:
    """Drop them."""
    for statement in op.get_context().opts["hooks"].drop_view_ddl(VIEW):
        op.execute(statement)
    for view in (VIEW, PIECES):
        op.execute(f"DROP VIEW {view}")
    op.drop_index(INDEX[0], INDEX[1])
