"""The tables of the database as SQLAlchemy models, neutral to the dialect.

Where ``msbdb.tables`` declares a column, its type, unit, meaning and whether it may be null come from there.
``father_id`` and ``class_id`` are generated columns: the paper's SUPID and SPE use 0 for "none", which no foreign key
can hold, so these two repeat them with NULL and carry the keys.
"""

from typing import Any

from geoalchemy2 import Geometry, WKBElement
from sqlalchemy import (
    JSON,
    BigInteger,
    CheckConstraint,
    Computed,
    Double,
    ForeignKey,
    ForeignKeyConstraint,
    Index,
    Integer,
    LargeBinary,
    MetaData,
    Text,
    UniqueConstraint,
    event,
)
from sqlalchemy import Table as SqlTable
from sqlalchemy.orm import DeclarativeBase, Mapped, MappedColumn, mapped_column
from sqlalchemy.types import TypeEngine

from msbdb.classmap import LABELS
from msbdb.tables import (
    BUILDING,
    FLAT_REGION,
    PART,
    PART_FLAT_REGION,
    REJECTION,
    SCALE,
    SPECTRAL_CLASS,
    SPECTRAL_CLASS_BAND,
    Column,
    Table,
)

BUILDING_STATES = ("confirmed", "unsure", "refuted")
LABELLERS = ("automatic", "operator")
CLASS_SOURCES = ("spectral", "structure")

RowId = BigInteger().with_variant(Integer(), "sqlite")
"""64 bits everywhere. SQLite takes only an ``INTEGER PRIMARY KEY`` as the row's own number, which spatial indexes need;
every other integer is BIGINT, as GDAL reads INTEGER in a view as 32 bits and cuts ids off."""

_TYPES: dict[str, TypeEngine[Any]] = {"int64": BigInteger(), "float64": Double(), "str": Text()}


class Base(DeclarativeBase):
    """Root of the models, with names for all constraints, so that migrations can speak of them."""

    metadata = MetaData(
        naming_convention={
            "pk": "pk_%(table_name)s",
            "fk": "fk_%(table_name)s_%(referred_table_name)s",
            "uq": "uq_%(table_name)s",
            "ix": "ix_%(table_name)s_%(column_0_N_name)s",
            "ck": "ck_%(table_name)s_%(constraint_name)s",
        }
    )


@event.listens_for(Base, "instrument_class", propagate=True)
def _comment_table(_mapper: object, model: type[Base]) -> None:
    """Take the first sentence of a model's docstring as its table's comment."""
    table = model.__table__
    if isinstance(table, SqlTable):
        table.comment = (model.__doc__ or "").splitlines()[0].rstrip(".")


def _column(table: Table, name: str) -> Column:
    return next(column for column in table.columns if column.name == name)


def _comment(table: Table, name: str) -> str:
    """Return a declared column's meaning and unit."""
    column = _column(table, name)
    return column.doc if column.unit == "-" else f"{column.doc} [{column.unit}]"


def _declared(table: Table, name: str, **options: Any) -> MappedColumn[Any]:  # noqa: ANN401
    """Return the column that ``msbdb.tables`` declares."""
    column = _column(table, name)
    options.setdefault("nullable", column.nullable)
    return mapped_column(_TYPES[column.dtype], comment=_comment(table, name), **options)


def _row_id(comment: str) -> MappedColumn[int]:
    """Return a primary key of one column."""
    return mapped_column(RowId, comment=comment, primary_key=True, autoincrement=False)


def _key(comment: str, *args: Any, **options: Any) -> MappedColumn[int]:  # noqa: ANN401
    """Return an integer key column that the database never counts up by itself."""
    return mapped_column(BigInteger, *args, comment=comment, autoincrement=False, **options)


def _run_key(**options: Any) -> MappedColumn[int]:  # noqa: ANN401
    """Return the column that names the row's run; the row goes when its run goes."""
    return _key("the run that made the row", ForeignKey("run.run_id", ondelete="CASCADE"), **options)


def _text(comment: str, **options: Any) -> MappedColumn[str]:  # noqa: ANN401
    return mapped_column(Text, comment=comment, **options)


def _number(comment: str) -> MappedColumn[float]:
    return mapped_column(Double, comment=comment)


def _geometry(kind: str) -> MappedColumn[WKBElement]:
    """Return a geometry column; its SRID is the database's, chosen when the database is created."""
    return mapped_column(
        Geometry(kind, srid=-1, spatial_index=False), nullable=False, comment="in the database's CRS [m]"
    )


def _one_of(name: str, values: tuple[str, ...]) -> CheckConstraint:
    return CheckConstraint(f"{name} IN ({', '.join(repr(v) for v in values)})", name=name)


class Survey(Base):
    """A survey: where and when the data were taken."""

    __tablename__ = "survey"
    __table_args__ = (
        UniqueConstraint("name"),
        CheckConstraint("name <> ''", name="name"),
        CheckConstraint("density >= 0 AND cell_m > 0", name="density"),
        CheckConstraint("west < east AND south < north", name="bounds"),
    )
    survey_id: Mapped[int] = _row_id("from the name")
    name: Mapped[str] = _text("name of the survey")
    date: Mapped[str] = _text("day of the survey, ISO 8601; empty where unknown")
    epsg: Mapped[int] = mapped_column(Integer, comment="EPSG code of the horizontal CRS; 0 for a CRS without code")
    crs_wkt: Mapped[str] = _text("the full CRS as WKT")
    vertical_crs: Mapped[str] = _text("the vertical CRS; empty where unknown")
    density: Mapped[float] = _number("first echoes a square metre; 0 for rasters [1/m2]")
    cell_m: Mapped[float] = _number("side of a cell of the lattice [m]")
    west: Mapped[float] = _number("western edge [m]")
    south: Mapped[float] = _number("southern edge [m]")
    east: Mapped[float] = _number("eastern edge [m]")
    north: Mapped[float] = _number("northern edge [m]")


class Source(Base):
    """An input file of a survey."""

    __tablename__ = "source"
    __table_args__ = (CheckConstraint("bytes >= 0", name="bytes"),)
    survey_id: Mapped[int] = _key("the survey", ForeignKey("survey.survey_id", ondelete="CASCADE"), primary_key=True)
    number: Mapped[int] = mapped_column(
        Integer, primary_key=True, autoincrement=False, comment="1 to n, in the order of role, name and checksum"
    )
    name: Mapped[str] = _text("name of the file")
    role: Mapped[str] = _text("what the file gave: points, ortho, dsm, dtm, ndsm")
    sha256: Mapped[str] = _text("checksum of the file")
    bytes: Mapped[int] = mapped_column(BigInteger, comment="size of the file [bytes]")


class Run(Base):
    """The run that built a survey, a survey's only one; it is written whole or not at all.

    The weaker constraint is the first schema's: SQLite could only drop it together with the table, on which all rows
    hang.
    """

    __tablename__ = "run"
    __table_args__ = (UniqueConstraint("survey_id", "method"), Index(None, "survey_id", unique=True))
    run_id: Mapped[int] = _row_id("from the survey's name")
    survey_id: Mapped[int] = _key("the survey", ForeignKey("survey.survey_id", ondelete="CASCADE"))
    method: Mapped[str] = _text("the extractors, sorted and joined by commas: multiscale and flatregions")
    profile: Mapped[str] = _text("the set of parameters that it began from")
    version: Mapped[str] = _text("version of msbdb")
    parameters: Mapped[dict[str, Any]] = mapped_column(JSON, comment="every parameter's value, by section")
    counts: Mapped[dict[str, Any]] = mapped_column(JSON, comment="how many regions came in, were kept and dropped")
    timings: Mapped[dict[str, Any]] = mapped_column(JSON, comment="seconds a stage; no part of the content [s]")
    notices: Mapped[list[str]] = mapped_column(JSON, comment="what a reader should know, in sentences")
    content_sha256: Mapped[str] = _text("digest of all that the run wrote, but for its timings")


class Scale(Base):
    """A scale of a run's scale-space."""

    __tablename__ = "scale"
    __table_args__ = (
        CheckConstraint("scale >= 1", name="scale"),
        CheckConstraint("threshold_px >= 1 AND threshold_m2 > 0", name="threshold"),
    )
    run_id: Mapped[int] = _run_key(primary_key=True)
    scale: Mapped[int] = _declared(SCALE, "scale", primary_key=True, autoincrement=False)
    threshold_px: Mapped[int] = _declared(SCALE, "threshold_px")
    threshold_m2: Mapped[float] = _declared(SCALE, "threshold_m2")


class SpectralClass(Base):
    """A class of land cover of a run."""

    __tablename__ = "spectral_class"
    __table_args__ = (
        CheckConstraint("speindex >= 1", name="speindex"),
        CheckConstraint("cells >= 0 AND share >= 0", name="cells"),
        _one_of("label", LABELS),
        _one_of("labelled_by", LABELLERS),
        _one_of("source", CLASS_SOURCES),
    )
    run_id: Mapped[int] = _run_key(primary_key=True)
    speindex: Mapped[int] = _declared(SPECTRAL_CLASS, "speindex", primary_key=True, autoincrement=False)
    label: Mapped[str] = _declared(SPECTRAL_CLASS, "label")
    labelled_by: Mapped[str] = _declared(SPECTRAL_CLASS, "labelled_by")
    source: Mapped[str] = _declared(SPECTRAL_CLASS, "source")
    cells: Mapped[int] = _declared(SPECTRAL_CLASS, "cells")
    share: Mapped[float] = _declared(SPECTRAL_CLASS, "share")
    ndvi: Mapped[float | None] = _declared(SPECTRAL_CLASS, "ndvi")
    brightness: Mapped[float | None] = _declared(SPECTRAL_CLASS, "brightness")
    roughness_m: Mapped[float | None] = _declared(SPECTRAL_CLASS, "roughness_m")
    height_m: Mapped[float | None] = _declared(SPECTRAL_CLASS, "height_m")


class SpectralClassBand(Base):
    """The mean of a band in a class."""

    __tablename__ = "spectral_class_band"
    __table_args__ = (
        ForeignKeyConstraint(
            ["run_id", "speindex"], ["spectral_class.run_id", "spectral_class.speindex"], ondelete="CASCADE"
        ),
    )
    run_id: Mapped[int] = _key("the run that made the row", primary_key=True)
    speindex: Mapped[int] = _declared(SPECTRAL_CLASS_BAND, "speindex", primary_key=True, autoincrement=False)
    band: Mapped[str] = _declared(SPECTRAL_CLASS_BAND, "band", primary_key=True)
    mean: Mapped[float | None] = _declared(SPECTRAL_CLASS_BAND, "mean")


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
    part_id: Mapped[int] = _row_id(_comment(PART, "part_id"))
    run_id: Mapped[int] = _run_key()
    supid: Mapped[int] = _declared(PART, "supid")
    father_id: Mapped[int | None] = _key(
        "SUPID, but null for a root", Computed("nullif(supid, 0)", persisted=True), nullable=True
    )
    supscale: Mapped[int] = _declared(PART, "supscale")
    root_id: Mapped[int] = _declared(PART, "root_id")
    scale: Mapped[int] = _declared(PART, "scale")
    hindex: Mapped[int] = _declared(PART, "hindex")
    hzone: Mapped[int] = _declared(PART, "hzone")
    speindex: Mapped[int] = _declared(PART, "speindex")
    class_id: Mapped[int | None] = _key(
        "SPE, but null for none", Computed("nullif(speindex, 0)", persisted=True), nullable=True
    )
    xo: Mapped[float] = _declared(PART, "xo")
    yo: Mapped[float] = _declared(PART, "yo")
    xcen: Mapped[float] = _declared(PART, "xcen")
    ycen: Mapped[float] = _declared(PART, "ycen")
    xin: Mapped[float] = _declared(PART, "xin")
    yin: Mapped[float] = _declared(PART, "yin")
    area_px: Mapped[int] = _declared(PART, "area_px")
    area_m2: Mapped[float] = _declared(PART, "area_m2")
    stddis: Mapped[float | None] = _declared(PART, "stddis")
    h_max: Mapped[float] = _declared(PART, "h_max")
    h_mean: Mapped[float] = _declared(PART, "h_mean")
    h_p50: Mapped[float] = _declared(PART, "h_p50")
    h_p90: Mapped[float] = _declared(PART, "h_p90")
    h_std: Mapped[float] = _declared(PART, "h_std")
    building_share: Mapped[float] = _declared(PART, "building_share")
    geometry: Mapped[WKBElement] = _geometry("MULTIPOLYGON")


class Building(Base):
    """A building: a root part with the summary of its tree."""

    __tablename__ = "building"
    __table_args__ = (
        UniqueConstraint("root_id"),
        ForeignKeyConstraint(["root_id"], ["part.part_id"], deferrable=True, initially="DEFERRED"),
        ForeignKeyConstraint(["run_id", "class_id"], ["spectral_class.run_id", "spectral_class.speindex"]),
        CheckConstraint("building_id > 0", name="building_id"),
        _one_of("state", BUILDING_STATES),
        CheckConstraint("storeys >= 0 AND area_m2 > 0", name="size"),
        CheckConstraint("parts >= 1 AND scales >= 1", name="parts"),
        CheckConstraint("flat_share >= 0 AND flat_share <= 1", name="flat_share"),
        Index(None, "run_id", "class_id"),
    )
    building_id: Mapped[int] = _row_id(_comment(BUILDING, "building_id"))
    run_id: Mapped[int] = _run_key()
    root_id: Mapped[int] = _declared(BUILDING, "root_id")
    state: Mapped[str] = _declared(BUILDING, "state")
    storeys: Mapped[int] = _declared(BUILDING, "storeys")
    h_max: Mapped[float] = _declared(BUILDING, "h_max")
    h_mean: Mapped[float] = _declared(BUILDING, "h_mean")
    h_p50: Mapped[float] = _declared(BUILDING, "h_p50")
    h_p90: Mapped[float] = _declared(BUILDING, "h_p90")
    area_m2: Mapped[float] = _declared(BUILDING, "area_m2")
    volume_m3: Mapped[float] = _declared(BUILDING, "volume_m3")
    parts: Mapped[int] = _declared(BUILDING, "parts")
    scales: Mapped[int] = _declared(BUILDING, "scales")
    speindex: Mapped[int] = _declared(BUILDING, "speindex")
    class_id: Mapped[int | None] = _key(
        "SPE, but null for none", Computed("nullif(speindex, 0)", persisted=True), nullable=True
    )
    flat_share: Mapped[float | None] = _declared(BUILDING, "flat_share")
    geometry: Mapped[WKBElement] = _geometry("MULTIPOLYGON")


class FlatRegion(Base):
    """A region of even height that stands out of its surroundings, found by its gradients.

    The scale-space has no part in it (Mongus et al. 2013), so that parts and flat regions bear witness for each other.
    """

    __tablename__ = "flat_region"
    __table_args__ = (
        CheckConstraint("region_id > 0", name="region_id"),
        CheckConstraint("zone >= 0 AND lambda_low_m2 >= 0 AND lambda_low_m2 <= lambda_m2", name="zone"),
        CheckConstraint("gradient_sum >= 0 AND mean_gradient >= 0", name="gradient"),
        CheckConstraint("area_m2 > 0 AND perimeter_m > 0 AND compactness > 0", name="shape"),
        Index(None, "run_id", "zone"),
    )
    region_id: Mapped[int] = _row_id(_comment(FLAT_REGION, "region_id"))
    run_id: Mapped[int] = _run_key()
    zone: Mapped[int] = _declared(FLAT_REGION, "zone")
    lambda_low_m2: Mapped[float] = _declared(FLAT_REGION, "lambda_low_m2")
    lambda_m2: Mapped[float] = _declared(FLAT_REGION, "lambda_m2")
    gradient_sum: Mapped[float] = _declared(FLAT_REGION, "gradient_sum")
    mean_gradient: Mapped[float] = _declared(FLAT_REGION, "mean_gradient")
    area_m2: Mapped[float] = _declared(FLAT_REGION, "area_m2")
    perimeter_m: Mapped[float] = _declared(FLAT_REGION, "perimeter_m")
    compactness: Mapped[float] = _declared(FLAT_REGION, "compactness")
    h_max: Mapped[float] = _declared(FLAT_REGION, "h_max")
    h_mean: Mapped[float] = _declared(FLAT_REGION, "h_mean")
    h_p50: Mapped[float] = _declared(FLAT_REGION, "h_p50")
    h_p90: Mapped[float] = _declared(FLAT_REGION, "h_p90")
    h_std: Mapped[float] = _declared(FLAT_REGION, "h_std")
    xcen: Mapped[float] = _declared(FLAT_REGION, "xcen")
    ycen: Mapped[float] = _declared(FLAT_REGION, "ycen")
    geometry: Mapped[WKBElement] = _geometry("MULTIPOLYGON")


class PartFlatRegion(Base):
    """A part and a flat region that share cells: one is the other's witness."""

    __tablename__ = "part_flat_region"
    __table_args__ = (
        CheckConstraint("overlap_m2 > 0", name="overlap"),
        CheckConstraint("part_share > 0 AND part_share <= 1", name="part_share"),
        CheckConstraint("region_share > 0 AND region_share <= 1", name="region_share"),
        Index(None, "region_id"),
        Index(None, "run_id"),
    )
    part_id: Mapped[int] = _key(
        _comment(PART_FLAT_REGION, "part_id"), ForeignKey("part.part_id", ondelete="CASCADE"), primary_key=True
    )
    region_id: Mapped[int] = _key(
        _comment(PART_FLAT_REGION, "region_id"),
        ForeignKey("flat_region.region_id", ondelete="CASCADE"),
        primary_key=True,
    )
    run_id: Mapped[int] = _run_key()
    overlap_m2: Mapped[float] = _declared(PART_FLAT_REGION, "overlap_m2")
    part_share: Mapped[float] = _declared(PART_FLAT_REGION, "part_share")
    region_share: Mapped[float] = _declared(PART_FLAT_REGION, "region_share")


class Rejection(Base):
    """A region that a stage dropped, and why: nothing vanishes in silence."""

    __tablename__ = "rejection"
    __table_args__ = (
        CheckConstraint("stage <> '' AND reason <> ''", name="reason"),
        CheckConstraint("scale >= 0 AND area_m2 >= 0", name="area"),
        Index(None, "run_id", "stage", "reason"),
    )
    rejection_id: Mapped[int] = _row_id("from the run, the region, the stage and the reason")
    run_id: Mapped[int] = _run_key()
    region_id: Mapped[int] = _declared(REJECTION, "region_id")
    stage: Mapped[str] = _declared(REJECTION, "stage")
    reason: Mapped[str] = _declared(REJECTION, "reason")
    scale: Mapped[int] = _declared(REJECTION, "scale")
    area_m2: Mapped[float] = _declared(REJECTION, "area_m2")
    xcen: Mapped[float] = _declared(REJECTION, "xcen")
    ycen: Mapped[float] = _declared(REJECTION, "ycen")
    geometry: Mapped[WKBElement] = _geometry("POINT")


class RunState(Base):
    """A named raster of a run, from which classes can be labelled anew without the source data."""

    __tablename__ = "run_state"
    run_id: Mapped[int] = _run_key(primary_key=True)
    name: Mapped[str] = _text("name of the raster", primary_key=True)
    dtype: Mapped[str] = _text("numpy dtype of the cells, with byte order")
    shape: Mapped[list[int]] = mapped_column(JSON, comment="lengths of the axes [cells]")
    data: Mapped[bytes] = mapped_column(LargeBinary, comment="the cells in C order, compressed by zlib")


SPATIAL: dict[str, str] = {
    "part": "MULTIPOLYGON",
    "building": "MULTIPOLYGON",
    "rejection": "POINT",
    "flat_region": "MULTIPOLYGON",
}
"""Geometry type of each table that has one; the column is always ``geometry``."""
