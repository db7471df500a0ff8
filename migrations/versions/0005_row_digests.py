"""Each row of the inventory's history has a digest of its own, by which an edit that msbdb did not make is noticed."""

import sqlalchemy as sa
from alembic import op

from msbdb.database.rowdigest import digest_again

revision = "0005"
down_revision = "0004"

WORD, NUMBER, REAL, FLAG, DOCUMENT, SHAPE = (
    sa.Text(), sa.BigInteger(), sa.Double(), sa.Boolean(), sa.JSON(), sa.LargeBinary()
)  # fmt: skip

TABLES: dict[str, dict[str, sa.types.TypeEngine]] = {
    "inventory_building": {"uid": NUMBER, "source": WORD},
    "building_version": {"version_id": NUMBER, "uid": NUMBER}
    | dict.fromkeys(("valid_from", "valid_to", "source"), WORD)
    | dict.fromkeys(("survey_id", "closed_by", "building_id"), NUMBER)
    | {"state": WORD, "storeys": NUMBER, "parts": NUMBER, "attributes": DOCUMENT, "geometry": SHAPE}
    | dict.fromkeys(("h_max", "h_mean", "h_p50", "h_p90", "area_m2", "volume_m3"), REAL)
    | dict.fromkeys(("flat_share", "area3d_share", "adaptive_share"), REAL),
    "building_change": {"change_id": NUMBER, "survey_id": NUMBER, "kind": WORD, "note": WORD}
    | dict.fromkeys(("uid_before", "uid_after", "version_before", "version_after"), NUMBER)
    | dict.fromkeys(("outline", "height", "parts"), FLAG)
    | dict.fromkeys(("overlap_m2", "iou", "dh_m", "darea_m2"), REAL),
    "survey_offset": {"survey_id": NUMBER, "pairs": NUMBER} | dict.fromkeys(("dx_m", "dy_m", "dz_m", "spread_m"), REAL),
    "inventory_event": {"number": NUMBER, "survey_id": NUMBER, "counts": DOCUMENT, "geometry": SHAPE}
    | dict.fromkeys(("kind", "name", "date", "content_sha256"), WORD),
    "operator_state": {"uid": NUMBER} | dict.fromkeys(("state", "operator", "note", "decided_at"), WORD),
    "roof_sample": {"sample_id": NUMBER, "material": WORD, "note": WORD, "attributes": DOCUMENT, "geometry": SHAPE},
}
"""The tables of the fourth schema with all of their columns; the first one is the key."""


def upgrade() -> None:
    """Add the column to each table, and write the digests of the rows that are there."""
    for name, columns in TABLES.items():
        op.execute(f"ALTER TABLE {name} ADD COLUMN row_digest BIGINT")
        first, *others = columns.items()
        table = sa.Table(
            name,
            sa.MetaData(),
            sa.Column(*first, primary_key=True),
            *(sa.Column(*column) for column in others),
            sa.Column("row_digest", NUMBER),
        )
        digest_again(op.get_bind(), table)


def downgrade() -> None:
    """Drop the digests, which can be computed again."""
    for name in TABLES:
        op.execute(f"ALTER TABLE {name} DROP COLUMN row_digest")
