"""The models of the living inventory: buildings that live through surveys, their versions, and all that changed them.

Rows of a run (``building``, ``part`` and the rest) are replaced when their survey is built again. Versions copy what
they need and so outlive rebuilds; hence ``building_version.building_id`` is no foreign key, and neither is
``operator_state.uid``, as a decision must survive whatever is taken back and applied again.
"""

from typing import Any

from geoalchemy2 import WKBElement
from sqlalchemy import JSON, BigInteger, Boolean, CheckConstraint, Double, ForeignKey, Index
from sqlalchemy import text as sql
from sqlalchemy.orm import Mapped, MappedColumn, mapped_column
from sqlalchemy.types import TypeEngine

from msbdb.database.columns import Base, comment_of, digest, geometry, key, number, one_of, row_id, shares, text
from msbdb.tables import BUILDING

CHANGE_KINDS = ("unchanged", "modified", "new", "demolished", "merged", "split")
"""What a survey does to a building; one that was not surveyed has no row."""

VERSION_SOURCES = ("survey", "import")
VERSION_STATES = ("confirmed", "unsure", "refuted")
MANUAL_STATES = ("confirmed", "refuted")
EVENT_KINDS = ("import", "update")

MEASURES = ("h_max", "h_mean", "h_p50", "h_p90", "volume_m3")
"""Heights of a version in metres, and its volume; null where no survey has measured it."""

SHARES = ("flat_share", "area3d_share", "adaptive_share")
"""Shares of a version's footprint that extractors cover; null where they were not run."""


def _measured(name: str, kind: type[TypeEngine[Any]] = Double) -> MappedColumn[Any]:
    """Return a column that repeats a building's, and is null where no survey has told it."""
    return mapped_column(kind, comment=comment_of(BUILDING, name), nullable=True)


class InventoryBuilding(Base):
    """A building of the inventory, which keeps its identity through surveys."""

    __tablename__ = "inventory_building"
    __table_args__ = (CheckConstraint("uid > 0", name="uid"),)
    uid: Mapped[int] = row_id("from the survey or import in which it was born, and its place")
    source: Mapped[str] = text("name of the survey or import in which it was born")
    row_digest: Mapped[int | None] = digest()


class BuildingVersion(Base):
    """A state of a building of the inventory, with the interval in which it holds.

    The interval is [valid_from, valid_to); the current version has no valid_to. Of a version that began and ended on
    one day nothing is seen at any date.
    """

    __tablename__ = "building_version"
    __table_args__ = (
        CheckConstraint("version_id > 0", name="version_id"),
        CheckConstraint("length(valid_from) = 10", name="valid_from"),
        CheckConstraint("valid_to IS NULL OR (length(valid_to) = 10 AND valid_to >= valid_from)", name="valid_to"),
        one_of("source", VERSION_SOURCES),
        CheckConstraint("(source = 'survey') = (survey_id IS NOT NULL)", name="survey"),
        CheckConstraint("closed_by IS NULL OR valid_to IS NOT NULL", name="closed_by"),
        one_of("state", VERSION_STATES),
        CheckConstraint("area_m2 > 0", name="area"),
        CheckConstraint("storeys >= 0 AND parts >= 1", name="parts"),
        *shares(*SHARES),
        Index(None, "uid", "valid_from"),
        Index(
            "ix_building_version_current",
            "uid",
            unique=True,
            sqlite_where=sql("valid_to IS NULL"),
            postgresql_where=sql("valid_to IS NULL"),
        ),
        Index(None, "survey_id"),
        Index(None, "closed_by"),
    )
    version_id: Mapped[int] = row_id("from the building and the survey or import that made it")
    uid: Mapped[int] = key("the building", ForeignKey("inventory_building.uid"))
    valid_from: Mapped[str] = text("first day on which it holds, ISO 8601")
    valid_to: Mapped[str | None] = text("first day on which it holds no more, ISO 8601; null for the current version")
    source: Mapped[str] = text("what made it: survey or import")
    survey_id: Mapped[int | None] = mapped_column(
        BigInteger, ForeignKey("survey.survey_id"), comment="the survey that made it; null for an import"
    )
    closed_by: Mapped[int | None] = mapped_column(
        BigInteger,
        ForeignKey("survey.survey_id", name="fk_building_version_closed_by"),
        comment="the survey that ended it; null for the current version",
    )
    building_id: Mapped[int | None] = mapped_column(
        BigInteger, comment="the building of the survey's run that it was taken from, which a rebuild may replace"
    )
    state: Mapped[str] = text(comment_of(BUILDING, "state"))
    storeys: Mapped[int | None] = _measured("storeys", BigInteger)
    h_max: Mapped[float | None] = _measured("h_max")
    h_mean: Mapped[float | None] = _measured("h_mean")
    h_p50: Mapped[float | None] = _measured("h_p50")
    h_p90: Mapped[float | None] = _measured("h_p90")
    area_m2: Mapped[float] = number("area of the footprint [m2]")
    volume_m3: Mapped[float | None] = _measured("volume_m3")
    parts: Mapped[int | None] = _measured("parts", BigInteger)
    flat_share: Mapped[float | None] = _measured("flat_share")
    area3d_share: Mapped[float | None] = _measured("area3d_share")
    adaptive_share: Mapped[float | None] = _measured("adaptive_share")
    attributes: Mapped[dict[str, Any] | None] = mapped_column(
        JSON(none_as_null=True), comment="what an imported inventory tells of it, by the names of its columns"
    )
    geometry: Mapped[WKBElement] = geometry("MULTIPOLYGON")
    row_digest: Mapped[int | None] = digest()


class BuildingChange(Base):
    """What a survey did to a building of the inventory; for merged and split, to each pair of buildings."""

    __tablename__ = "building_change"
    __table_args__ = (
        CheckConstraint("change_id > 0", name="change_id"),
        one_of("kind", CHANGE_KINDS),
        CheckConstraint("uid_before IS NOT NULL OR uid_after IS NOT NULL", name="uid"),
        CheckConstraint(
            "(uid_before IS NULL) = (version_before IS NULL) AND (uid_after IS NULL) = (version_after IS NULL)",
            name="version",
        ),
        CheckConstraint("overlap_m2 >= 0 AND iou >= 0 AND iou <= 1", name="overlap"),
        Index(None, "survey_id", "kind"),
        Index(None, "uid_before"),
        Index(None, "uid_after"),
        Index(None, "version_before"),
        Index(None, "version_after"),
    )
    change_id: Mapped[int] = row_id("from the survey, the kind and the two buildings")
    survey_id: Mapped[int] = key("the survey", ForeignKey("survey.survey_id"))
    kind: Mapped[str] = text("unchanged, modified, new, demolished, merged or split")
    uid_before: Mapped[int | None] = mapped_column(
        BigInteger,
        ForeignKey("inventory_building.uid", name="fk_building_change_uid_before"),
        comment="the building before; null for new",
    )
    uid_after: Mapped[int | None] = mapped_column(
        BigInteger,
        ForeignKey("inventory_building.uid", name="fk_building_change_uid_after"),
        comment="the building after; null when gone",
    )
    version_before: Mapped[int | None] = mapped_column(
        BigInteger,
        ForeignKey("building_version.version_id", name="fk_building_change_version_before"),
        comment="its version before",
    )
    version_after: Mapped[int | None] = mapped_column(
        BigInteger,
        ForeignKey("building_version.version_id", name="fk_building_change_version_after"),
        comment="its version after; that of before where it is unchanged",
    )
    outline: Mapped[bool] = mapped_column(Boolean, comment="its outline changed")
    height: Mapped[bool] = mapped_column(Boolean, comment="its height changed")
    parts: Mapped[bool] = mapped_column(Boolean, comment="only a part of it changed its height")
    overlap_m2: Mapped[float] = number("area that both footprints share, the inventory shifted by the offset [m2]")
    iou: Mapped[float] = number("that area over the area that either covers [1]")
    dh_m: Mapped[float | None] = mapped_column(Double, comment="median change of height where both are known [m]")
    darea_m2: Mapped[float] = number("change of the footprint's area; all of it for new and demolished [m2]")
    note: Mapped[str] = text("what else there is to say; often empty")
    row_digest: Mapped[int | None] = digest()


class SurveyOffset(Base):
    """How a survey lies to the inventory: a place (x, y, h) of the inventory is (x + dx, y + dy, h + dz) there.

    It is told and taken into account when buildings are compared; no stored geometry is shifted by it.
    """

    __tablename__ = "survey_offset"
    __table_args__ = (CheckConstraint("pairs >= 0", name="pairs"),)
    survey_id: Mapped[int] = key("the survey", ForeignKey("survey.survey_id"), primary_key=True)
    dx_m: Mapped[float] = number("to the east; 0 where too few buildings tell it [m]")
    dy_m: Mapped[float] = number("to the north [m]")
    dz_m: Mapped[float] = number("of the heights above ground [m]")
    pairs: Mapped[int] = mapped_column(BigInteger, comment="pairs of like buildings that tell it")
    spread_m: Mapped[float | None] = mapped_column(
        Double, comment="robust standard deviation of a pair's shift; null without pairs [m]"
    )
    row_digest: Mapped[int | None] = digest()


class InventoryEvent(Base):
    """An import into the inventory or an update of it: what was applied, in which order, and where."""

    __tablename__ = "inventory_event"
    __table_args__ = (
        CheckConstraint("number > 0", name="number"),
        one_of("kind", EVENT_KINDS),
        CheckConstraint("name <> ''", name="name"),
        CheckConstraint("length(date) = 10", name="date"),
        CheckConstraint("(kind = 'update') = (survey_id IS NOT NULL)", name="survey"),
        Index(None, "survey_id", unique=True),
    )
    number: Mapped[int] = row_id("1 to n, in the order in which they were applied")
    kind: Mapped[str] = text("import or update")
    name: Mapped[str] = text("name of the survey or import")
    date: Mapped[str] = text("the day from which its versions hold, ISO 8601")
    survey_id: Mapped[int | None] = mapped_column(
        BigInteger, ForeignKey("survey.survey_id"), comment="the survey; null for an import"
    )
    counts: Mapped[dict[str, Any]] = mapped_column(JSON, comment="rows that it wrote: changes by kind, and versions")
    content_sha256: Mapped[str] = text("digest of all that decides of its outcome")
    geometry: Mapped[WKBElement] = geometry("MULTIPOLYGON")
    row_digest: Mapped[int | None] = digest()


class OperatorState(Base):
    """An operator's word on a building, which wins over what the extractors say, whatever is built or updated."""

    __tablename__ = "operator_state"
    __table_args__ = (
        one_of("state", MANUAL_STATES),
        CheckConstraint("operator <> ''", name="operator"),
    )
    uid: Mapped[int] = row_id("the building of the inventory")
    state: Mapped[str] = text("confirmed or refuted")
    operator: Mapped[str] = text("who said so")
    note: Mapped[str] = text("why; may be empty")
    decided_at: Mapped[str] = text("when, UTC, ISO 8601; no part of the content")
    row_digest: Mapped[int | None] = digest()


class RoofSample(Base):
    """A place where the material of a roof is known (V53)."""

    __tablename__ = "roof_sample"
    __table_args__ = (
        CheckConstraint("sample_id > 0", name="sample_id"),
        CheckConstraint("material <> ''", name="material"),
    )
    sample_id: Mapped[int] = row_id("from the place")
    material: Mapped[str] = text("the material")
    note: Mapped[str] = text("what else there is to say; may be empty")
    attributes: Mapped[dict[str, Any] | None] = mapped_column(
        JSON(none_as_null=True), comment="the other columns of the file it came from"
    )
    geometry: Mapped[WKBElement] = geometry("POINT")
    row_digest: Mapped[int | None] = digest()


INVENTORY_SPATIAL = {
    "building_version": "MULTIPOLYGON",
    "inventory_event": "MULTIPOLYGON",
    "roof_sample": "POINT",
}
"""Geometry type of each table here that has one."""
