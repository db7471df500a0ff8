"""Surveys that are built in tiles: how far each tile is, and its pieces of the rasters."""

import sqlalchemy as sa
from alembic import op

revision = "0008"
down_revision = "0007"

TILE, PIECE = "tile", "raster_tile"


def upgrade() -> None:
    """Create both tables."""
    baseline = op.get_context().script.get_revision("0001").module
    op.create_table(
        PIECE,
        *baseline.integers("run_id"),
        *baseline.words("name"),
        *baseline.integers("lattice_row", "lattice_column"),
        *baseline.words("dtype"),
        *baseline.documents("shape"),
        sa.Column("data", sa.LargeBinary(), nullable=False),
        baseline.key(PIECE, "run_id", "name", "lattice_row", "lattice_column"),
        baseline.of_run(PIECE),
    )
    op.create_table(
        TILE,
        *baseline.words("survey"),
        *baseline.integers("tile_row", "tile_column"),
        *baseline.numbers("west", "south", "east", "north"),
        *baseline.words("state"),
        *baseline.integers("points"),
        *baseline.numbers("halo_m", "seconds"),
        *baseline.words("reason", "build"),
        sa.Column("result", sa.LargeBinary(), nullable=True),
        baseline.key(TILE, "survey", "tile_row", "tile_column"),
        baseline.check(TILE, "tile_bounds", "west < east AND south < north"),
        baseline.check(TILE, "state", "state IN ('queued', 'running', 'done', 'failed')"),
    )


def downgrade() -> None:
    """Drop them; a survey that was built in tiles stays without its rasters until it is built again."""
    op.drop_table(TILE)
    op.drop_table(PIECE)
