"""Views show an empty object where a building has no imported attributes: QGIS warns of each null among JSON values."""

from pathlib import Path

from alembic import op

revision = "0005"
down_revision = "0004"

VIEW, FUNCTION = "footprint_current", "footprint_at"
TEXTS = Path(__file__).resolve().parents[1] / "sql"


def upgrade() -> None:
    """Make the view and the function of PostGIS anew."""
    make(statement(VIEW, revision), statement(FUNCTION, revision))


def downgrade() -> None:
    """Make those of the former schema."""
    make(statement(VIEW, "0003"), statement(FUNCTION, "0003"))


def make(view: str, function: str) -> None:
    """Replace the view and the function; columns, registers and rights stay."""
    if op.get_bind().dialect.name == "postgresql":
        op.execute(f"CREATE OR REPLACE VIEW {VIEW} AS\n{view}")
        op.execute(function.replace("CREATE FUNCTION", "CREATE OR REPLACE FUNCTION"))
    else:
        op.execute(f"DROP VIEW {VIEW}")
        op.execute(f"CREATE VIEW {VIEW} AS\n{view}")


def statement(name: str, version: str) -> str:
    """Return a text as a version of the schema has it."""
    lines = (TEXTS / version / f"{name}.sql").read_text(encoding="utf-8").splitlines()
    return "\n".join(line for line in lines if not line.startswith("--")).strip().rstrip(";")
