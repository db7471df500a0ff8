"""A schema later than today's, for tests of upgrades and downgrades: the migrations with one more."""

import shutil
from pathlib import Path

from msbdb.database.dialects import migration as upgrade

ROOT = Path(__file__).resolve().parents[2]
TODAY = upgrade.head_version()
"""The version of today's schema."""

LATER = "9000"
"""The later version."""

MIGRATION = '''
"""A migration of tomorrow: a table, a column with values, and a view that shows it; back, links are lost."""

import sqlalchemy as sa
from alembic import op

revision = "9000"
down_revision = "{today}"

OLD_VIEW = """{footprint}"""
NEW_VIEW = OLD_VIEW.replace("b.building_id,", "b.building_id, b.colour,", 1)


def upgrade() -> None:
    op.create_table("visit", sa.Column("visit_id", sa.Integer, primary_key=True))
    op.execute("INSERT INTO visit VALUES (1)")
    drop_view()
    op.execute("ALTER TABLE building ADD COLUMN colour TEXT")
    op.execute("UPDATE building SET colour = 'grey' WHERE storeys > 1")
    create_view(NEW_VIEW)
    {broken}


def downgrade() -> None:
    drop_view()
    op.execute("ALTER TABLE building DROP COLUMN colour")
    create_view(OLD_VIEW)
    op.execute("DELETE FROM flat_region_candidate")
    op.drop_table("visit")


def hooks():
    return op.get_context().opts["hooks"]


def drop_view() -> None:
    for statement in hooks().drop_view_ddl("footprint"):
        op.execute(statement)
    op.execute("DROP VIEW footprint")


def create_view(query: str) -> None:
    op.execute("CREATE VIEW footprint AS\\n" + query.strip())
    for statement in hooks().view_ddl("footprint", "building_id", "building"):
        op.execute(statement)
'''


def migrations_of_tomorrow(folder: Path, *, broken: str = "") -> Path:
    """Write a copy of the migrations with one more; ``broken`` is a statement at the end of its upgrade."""
    shutil.copytree(ROOT / "migrations", folder, ignore=shutil.ignore_patterns("__pycache__"))
    newest = max((folder / "sql").glob("*/footprint.sql"))
    text = newest.read_text()
    footprint = "\n".join(line for line in text.splitlines() if not line.startswith("--")).rstrip(";")
    words = MIGRATION.format(today=upgrade.head_version(), footprint=footprint, broken=broken)
    (folder / "versions" / "9000_next.py").write_text(words)
    return folder
