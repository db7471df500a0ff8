"""The tables of the database as SQLAlchemy models, neutral to the dialect.

Where ``msbdb.tables`` declares a column, its type, unit, meaning and whether it may be null come from there.
``father_id`` and ``class_id`` are generated columns: the paper's SUPID and SPE use 0 for "none", which no foreign key
can hold, so these two repeat them with NULL and carry the keys.
"""

from typing import Any

from geoalchemy2 import WKBElement
from sqlalchemy import (
    JSON,
    BigInteger,
    CheckConstraint,
    Computed,
    ForeignKey,
    ForeignKeyConstraint,
    Index,
    Integer,
    LargeBinary,
    UniqueConstraint,
)
from sqlalchemy.orm import Mapped, mapped_column

from msbdb.classmap import LABELS
from msbdb.database.columns import (
    Base,
    comment_of,
    declared,
    geometry,
    key,
    number,
    one_of,
    row_id,
    run_key,
    shares,
    text,
)
from msbdb.database.inventory import (
    INVENTORY_SPATIAL,
    BuildingChange,
    BuildingVersion,
    InventoryBuilding,
    InventoryEvent,
    OperatorState,
    RoofSample,
    SurveyOffset,
)
from msbdb.database.regions import CandidateRegion, FlatRegion, FlatRegionCandidate, PartCandidate, PartFlatRegion
from msbdb.tables import (
    BUILDING,
    PART,
    REJECTION,
    SCALE,
    SPECTRAL_CLASS,
    SPECTRAL_CLASS_BAND,
)

__all__ = [
    "SPATIAL",
    "Base",
    "Building",
    "BuildingChange",
    "BuildingVersion",
    "CandidateRegion",
    "FlatRegion",
    "FlatRegionCandidate",
    "InventoryBuilding",
    "InventoryEvent",
    "OperatorState",
    "Part",
    "PartCandidate",
    "PartFlatRegion",
    "Rejection",
    "RoofSample",
    "Run",
    "RunState",
    "Scale",
    "Source",
    "SpectralClass",
    "SpectralClassBand",
    "Survey",
    "SurveyOffset",
]

BUILDING_STATES = ("confirmed", "unsure", "refuted")
LABELLERS = ("automatic", "operator")
CLASS_SOURCES = ("spectral", "structure")


class Survey(Base):
    """A survey: where and when the data were taken."""

    __tablename__ = "survey"
    __table_args__ = (
        UniqueConstraint("name"),
        CheckConstraint("name <> ''", name="name"),
        CheckConstraint("density >= 0 AND cell_m > 0", name="density"),
        CheckConstraint("west < east AND south < north", name="bounds"),
    )
    survey_id: Mapped[int] = row_id("from the name")
    name: Mapped[str] = text("name of the survey")
    date: Mapped[str] = text("day of the survey, ISO 8601; empty where unknown")
    epsg: Mapped[int] = mapped_column(Integer, comment="EPSG code of the horizontal CRS; 0 for a CRS without code")
    crs_wkt: Mapped[str] = text("the full CRS as WKT")
    vertical_crs: Mapped[str] = text("the vertical CRS; empty where unknown")
    density: Mapped[float] = number("first echoes a square metre; 0 for rasters [1/m2]")
    cell_m: Mapped[float] = number("side of a cell of the lattice [m]")
    west: Mapped[float] = number("western edge [m]")
    south: Mapped[float] = number("southern edge [m]")
    east: Mapped[float] = number("eastern edge [m]")
    north: Mapped[float] = number("northern edge [m]")


class Source(Base):
    """An input file of a survey."""

    __tablename__ = "source"
    __table_args__ = (CheckConstraint("bytes >= 0", name="bytes"),)
    survey_id: Mapped[int] = key("the survey", ForeignKey("survey.survey_id", ondelete="CASCADE"), primary_key=True)
    number: Mapped[int] = mapped_column(
        Integer, primary_key=True, autoincrement=False, comment="1 to n, in the order of role, name and checksum"
    )
    name: Mapped[str] = text("name of the file")
    role: Mapped[str] = text("what the file gave: points, ortho, dsm, dtm, ndsm")
    sha256: Mapped[str] = text("checksum of the file")
    bytes: Mapped[int] = mapped_column(BigInteger, comment="size of the file [bytes]")


class Run(Base):
    """The run that built a survey, a survey's only one; it is written whole or not at all.

    The weaker constraint is the first schema's: SQLite could only drop it together with the table, on which all rows
    hang.
    """

    __tablename__ = "run"
    __table_args__ = (UniqueConstraint("survey_id", "method"), Index(None, "survey_id", unique=True))
    run_id: Mapped[int] = row_id("from the survey's name")
    survey_id: Mapped[int] = key("the survey", ForeignKey("survey.survey_id", ondelete="CASCADE"))
    method: Mapped[str] = text(
        "the extractors, sorted and joined by commas: multiscale, flatregions, area3d and adaptive"
    )
    profile: Mapped[str] = text("the set of parameters that it began from")
    version: Mapped[str] = text("version of msbdb")
    parameters: Mapped[dict[str, Any]] = mapped_column(JSON, comment="every parameter's value, by section")
    counts: Mapped[dict[str, Any]] = mapped_column(JSON, comment="how many regions came in, were kept and dropped")
    timings: Mapped[dict[str, Any]] = mapped_column(JSON, comment="seconds a stage; no part of the content [s]")
    notices: Mapped[list[str]] = mapped_column(JSON, comment="what a reader should know, in sentences")
    content_sha256: Mapped[str] = text("digest of all that the run wrote, but for its timings")


class Scale(Base):
    """A scale of a run's scale-space."""

    __tablename__ = "scale"
    __table_args__ = (
        CheckConstraint("scale >= 1", name="scale"),
        CheckConstraint("threshold_px >= 1 AND threshold_m2 > 0", name="threshold"),
    )
    run_id: Mapped[int] = run_key(primary_key=True)
    scale: Mapped[int] = declared(SCALE, "scale", primary_key=True, autoincrement=False)
    threshold_px: Mapped[int] = declared(SCALE, "threshold_px")
    threshold_m2: Mapped[float] = declared(SCALE, "threshold_m2")


class SpectralClass(Base):
    """A class of land cover of a run."""

    __tablename__ = "spectral_class"
    __table_args__ = (
        CheckConstraint("speindex >= 1", name="speindex"),
        CheckConstraint("cells >= 0 AND share >= 0", name="cells"),
        one_of("label", LABELS),
        one_of("labelled_by", LABELLERS),
        one_of("source", CLASS_SOURCES),
    )
    run_id: Mapped[int] = run_key(primary_key=True)
    speindex: Mapped[int] = declared(SPECTRAL_CLASS, "speindex", primary_key=True, autoincrement=False)
    label: Mapped[str] = declared(SPECTRAL_CLASS, "label")
    labelled_by: Mapped[str] = declared(SPECTRAL_CLASS, "labelled_by")
    source: Mapped[str] = declared(SPECTRAL_CLASS, "source")
    cells: Mapped[int] = declared(SPECTRAL_CLASS, "cells")
    share: Mapped[float] = declared(SPECTRAL_CLASS, "share")
    ndvi: Mapped[float | None] = declared(SPECTRAL_CLASS, "ndvi")
    brightness: Mapped[float | None] = declared(SPECTRAL_CLASS, "brightness")
    roughness_m: Mapped[float | None] = declared(SPECTRAL_CLASS, "roughness_m")
    height_m: Mapped[float | None] = declared(SPECTRAL_CLASS, "height_m")


class SpectralClassBand(Base):
    """The mean of a band in a class."""

    __tablename__ = "spectral_class_band"
    __table_args__ = (
        ForeignKeyConstraint(
            ["run_id", "speindex"], ["spectral_class.run_id", "spectral_class.speindex"], ondelete="CASCADE"
        ),
    )
    run_id: Mapped[int] = key("the run that made the row", primary_key=True)
    speindex: Mapped[int] = declared(SPECTRAL_CLASS_BAND, "speindex", primary_key=True, autoincrement=False)
    band: Mapped[str] = declared(SPECTRAL_CLASS_BAND, "band", primary_key=True)
    mean: Mapped[float | None] = declared(SPECTRAL_CLASS_BAND, "mean")


class Part(Base):
    """A part of a building on one scale; a father holds its children (V32, V33).

    One foreign key and two checks hold the forest: the father exists, in the same run and tree, on the scale that
    SUPSCALE says; fathers are coarser than children, so there is no cycle; and a root is its own tree's root.
    """

    __tablename__ = "part"
    __table_args__ = (
        UniqueConstraint("part_id", "scale", "root_id", "run_id"),
        ForeignKeyConstraint(
            ["father_id", "supscale", "root_id", "run_id"],
            ["part.part_id", "part.scale", "part.root_id", "part.run_id"],
            deferrable=True,
            initially="DEFERRED",
        ),
        ForeignKeyConstraint(["run_id", "scale"], ["scale.run_id", "scale.scale"]),
        ForeignKeyConstraint(["run_id", "class_id"], ["spectral_class.run_id", "spectral_class.speindex"]),
        CheckConstraint("part_id > 0", name="part_id"),
        CheckConstraint(
            "(supid = 0 AND supscale = 0 AND root_id = part_id) OR (supid > 0 AND supscale > 0 AND supscale < scale)",
            name="father",
        ),
        CheckConstraint("area_px > 0 AND area_m2 > 0", name="area"),
        CheckConstraint("hindex >= 0 AND hzone >= 0", name="storeys"),
        CheckConstraint("building_share >= 0 AND building_share <= 1", name="building_share"),
        Index(None, "father_id", "supscale", "root_id", "run_id"),
        Index(None, "root_id"),
        Index(None, "run_id", "scale"),
        Index(None, "run_id", "class_id"),
    )
    part_id: Mapped[int] = row_id(comment_of(PART, "part_id"))
    run_id: Mapped[int] = run_key()
    supid: Mapped[int] = declared(PART, "supid")
    father_id: Mapped[int | None] = key(
        "SUPID, but null for a root", Computed("nullif(supid, 0)", persisted=True), nullable=True
    )
    supscale: Mapped[int] = declared(PART, "supscale")
    root_id: Mapped[int] = declared(PART, "root_id")
    scale: Mapped[int] = declared(PART, "scale")
    hindex: Mapped[int] = declared(PART, "hindex")
    hzone: Mapped[int] = declared(PART, "hzone")
    speindex: Mapped[int] = declared(PART, "speindex")
    class_id: Mapped[int | None] = key(
        "SPE, but null for none", Computed("nullif(speindex, 0)", persisted=True), nullable=True
    )
    xo: Mapped[float] = declared(PART, "xo")
    yo: Mapped[float] = declared(PART, "yo")
    xcen: Mapped[float] = declared(PART, "xcen")
    ycen: Mapped[float] = declared(PART, "ycen")
    xin: Mapped[float] = declared(PART, "xin")
    yin: Mapped[float] = declared(PART, "yin")
    area_px: Mapped[int] = declared(PART, "area_px")
    area_m2: Mapped[float] = declared(PART, "area_m2")
    stddis: Mapped[float | None] = declared(PART, "stddis")
    h_max: Mapped[float] = declared(PART, "h_max")
    h_mean: Mapped[float] = declared(PART, "h_mean")
    h_p50: Mapped[float] = declared(PART, "h_p50")
    h_p90: Mapped[float] = declared(PART, "h_p90")
    h_std: Mapped[float] = declared(PART, "h_std")
    building_share: Mapped[float] = declared(PART, "building_share")
    geometry: Mapped[WKBElement] = geometry("MULTIPOLYGON")


class Building(Base):
    """A building: a root part with the summary of its tree."""

    __tablename__ = "building"
    __table_args__ = (
        UniqueConstraint("root_id"),
        ForeignKeyConstraint(["root_id"], ["part.part_id"], deferrable=True, initially="DEFERRED"),
        ForeignKeyConstraint(["run_id", "class_id"], ["spectral_class.run_id", "spectral_class.speindex"]),
        CheckConstraint("building_id > 0", name="building_id"),
        one_of("state", BUILDING_STATES),
        CheckConstraint("storeys >= 0 AND area_m2 > 0", name="size"),
        CheckConstraint("parts >= 1 AND scales >= 1", name="parts"),
        *shares("flat_share", "area3d_share", "adaptive_share"),
        Index(None, "run_id", "class_id"),
    )
    building_id: Mapped[int] = row_id(comment_of(BUILDING, "building_id"))
    run_id: Mapped[int] = run_key()
    root_id: Mapped[int] = declared(BUILDING, "root_id")
    state: Mapped[str] = declared(BUILDING, "state")
    storeys: Mapped[int] = declared(BUILDING, "storeys")
    h_max: Mapped[float] = declared(BUILDING, "h_max")
    h_mean: Mapped[float] = declared(BUILDING, "h_mean")
    h_p50: Mapped[float] = declared(BUILDING, "h_p50")
    h_p90: Mapped[float] = declared(BUILDING, "h_p90")
    area_m2: Mapped[float] = declared(BUILDING, "area_m2")
    volume_m3: Mapped[float] = declared(BUILDING, "volume_m3")
    parts: Mapped[int] = declared(BUILDING, "parts")
    scales: Mapped[int] = declared(BUILDING, "scales")
    speindex: Mapped[int] = declared(BUILDING, "speindex")
    class_id: Mapped[int | None] = key(
        "SPE, but null for none", Computed("nullif(speindex, 0)", persisted=True), nullable=True
    )
    flat_share: Mapped[float | None] = declared(BUILDING, "flat_share")
    area3d_share: Mapped[float | None] = declared(BUILDING, "area3d_share")
    adaptive_share: Mapped[float | None] = declared(BUILDING, "adaptive_share")
    geometry: Mapped[WKBElement] = geometry("MULTIPOLYGON")


class Rejection(Base):
    """A region that a stage dropped, and why: nothing vanishes in silence."""

    __tablename__ = "rejection"
    __table_args__ = (
        CheckConstraint("stage <> '' AND reason <> ''", name="reason"),
        CheckConstraint("scale >= 0 AND area_m2 >= 0", name="area"),
        Index(None, "run_id", "stage", "reason"),
    )
    rejection_id: Mapped[int] = row_id("from the run, the region, the stage and the reason")
    run_id: Mapped[int] = run_key()
    region_id: Mapped[int] = declared(REJECTION, "region_id")
    stage: Mapped[str] = declared(REJECTION, "stage")
    reason: Mapped[str] = declared(REJECTION, "reason")
    scale: Mapped[int] = declared(REJECTION, "scale")
    area_m2: Mapped[float] = declared(REJECTION, "area_m2")
    xcen: Mapped[float] = declared(REJECTION, "xcen")
    ycen: Mapped[float] = declared(REJECTION, "ycen")
    geometry: Mapped[WKBElement] = geometry("POINT")


class RunState(Base):
    """A named raster of a run, from which classes can be labelled anew without the source data."""

    __tablename__ = "run_state"
    run_id: Mapped[int] = run_key(primary_key=True)
    name: Mapped[str] = text("name of the raster", primary_key=True)
    dtype: Mapped[str] = text("numpy dtype of the cells, with byte order")
    shape: Mapped[list[int]] = mapped_column(JSON, comment="lengths of the axes [cells]")
    data: Mapped[bytes] = mapped_column(LargeBinary, comment="the cells in C order, compressed by zlib")


SPATIAL: dict[str, str] = {
    "part": "MULTIPOLYGON",
    "building": "MULTIPOLYGON",
    "rejection": "POINT",
    "flat_region": "MULTIPOLYGON",
    "candidate_region": "MULTIPOLYGON",
    **INVENTORY_SPATIAL,
}
"""Geometry type of each table that has one; the column is always ``geometry``."""
