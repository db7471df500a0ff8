"""The models of the regions that other extractors find, and of their links to parts and to each other."""

from geoalchemy2 import WKBElement
from sqlalchemy import CheckConstraint, ForeignKey, Index
from sqlalchemy.orm import Mapped

from msbdb.database.columns import (
    Base,
    comment_of,
    declared,
    geometry,
    key,
    one_of,
    overlaps,
    row_id,
    run_key,
    shares,
)
from msbdb.params import POINT_DETECTORS
from msbdb.tables import (
    CANDIDATE_REGION,
    FLAT_REGION,
    FLAT_REGION_CANDIDATE,
    PART_CANDIDATE,
    PART_FLAT_REGION,
)


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
    region_id: Mapped[int] = row_id(comment_of(FLAT_REGION, "region_id"))
    run_id: Mapped[int] = run_key()
    zone: Mapped[int] = declared(FLAT_REGION, "zone")
    lambda_low_m2: Mapped[float] = declared(FLAT_REGION, "lambda_low_m2")
    lambda_m2: Mapped[float] = declared(FLAT_REGION, "lambda_m2")
    gradient_sum: Mapped[float] = declared(FLAT_REGION, "gradient_sum")
    mean_gradient: Mapped[float] = declared(FLAT_REGION, "mean_gradient")
    area_m2: Mapped[float] = declared(FLAT_REGION, "area_m2")
    perimeter_m: Mapped[float] = declared(FLAT_REGION, "perimeter_m")
    compactness: Mapped[float] = declared(FLAT_REGION, "compactness")
    h_max: Mapped[float] = declared(FLAT_REGION, "h_max")
    h_mean: Mapped[float] = declared(FLAT_REGION, "h_mean")
    h_p50: Mapped[float] = declared(FLAT_REGION, "h_p50")
    h_p90: Mapped[float] = declared(FLAT_REGION, "h_p90")
    h_std: Mapped[float] = declared(FLAT_REGION, "h_std")
    xcen: Mapped[float] = declared(FLAT_REGION, "xcen")
    ycen: Mapped[float] = declared(FLAT_REGION, "ycen")
    geometry: Mapped[WKBElement] = geometry("MULTIPOLYGON")


class PartFlatRegion(Base):
    """A part and a flat region that share cells: one is the other's witness."""

    __tablename__ = "part_flat_region"
    __table_args__ = (
        *overlaps("part_share", "region_share"),
        Index(None, "region_id"),
        Index(None, "run_id"),
    )
    part_id: Mapped[int] = key(
        comment_of(PART_FLAT_REGION, "part_id"), ForeignKey("part.part_id", ondelete="CASCADE"), primary_key=True
    )
    region_id: Mapped[int] = key(
        comment_of(PART_FLAT_REGION, "region_id"),
        ForeignKey("flat_region.region_id", ondelete="CASCADE"),
        primary_key=True,
    )
    run_id: Mapped[int] = run_key()
    overlap_m2: Mapped[float] = declared(PART_FLAT_REGION, "overlap_m2")
    part_share: Mapped[float] = declared(PART_FLAT_REGION, "part_share")
    region_share: Mapped[float] = declared(PART_FLAT_REGION, "region_share")


class CandidateRegion(Base):
    """A region that an extractor on the points themselves takes for a roof.

    Neither the lattice nor the scale-space has a part in finding it (Cao & Wu; the Bathurst slides).
    """

    __tablename__ = "candidate_region"
    __table_args__ = (
        CheckConstraint("candidate_id > 0", name="candidate_id"),
        one_of("method", POINT_DETECTORS),
        CheckConstraint("rule <> ''", name="rule"),
        CheckConstraint("height_scale_m IS NULL OR method = 'area3d'", name="height_scale"),
        CheckConstraint("points > 0 AND perimeter >= 0", name="points"),
        CheckConstraint("area_m2 > 0 AND mbr_m2 >= 0 AND rectangularity >= 0 AND compactness >= 0", name="shape"),
        *shares("linearity"),
        CheckConstraint("direction_1 >= 0 AND direction_1 <= 180", name="direction_1"),
        CheckConstraint("direction_2 >= 0 AND direction_2 <= 180", name="direction_2"),
        CheckConstraint("ndvi >= -1 AND ndvi <= 1", name="ndvi"),
        Index(None, "run_id", "method"),
    )
    candidate_id: Mapped[int] = row_id(comment_of(CANDIDATE_REGION, "candidate_id"))
    run_id: Mapped[int] = run_key()
    method: Mapped[str] = declared(CANDIDATE_REGION, "method")
    rule: Mapped[str] = declared(CANDIDATE_REGION, "rule")
    height_scale_m: Mapped[float | None] = declared(CANDIDATE_REGION, "height_scale_m")
    points: Mapped[int] = declared(CANDIDATE_REGION, "points")
    area_m2: Mapped[float] = declared(CANDIDATE_REGION, "area_m2")
    perimeter: Mapped[int] = declared(CANDIDATE_REGION, "perimeter")
    mbr_m2: Mapped[float] = declared(CANDIDATE_REGION, "mbr_m2")
    rectangularity: Mapped[float] = declared(CANDIDATE_REGION, "rectangularity")
    compactness: Mapped[float | None] = declared(CANDIDATE_REGION, "compactness")
    linearity: Mapped[float | None] = declared(CANDIDATE_REGION, "linearity")
    direction_1: Mapped[float | None] = declared(CANDIDATE_REGION, "direction_1")
    direction_2: Mapped[float | None] = declared(CANDIDATE_REGION, "direction_2")
    ndvi: Mapped[float | None] = declared(CANDIDATE_REGION, "ndvi")
    h_max: Mapped[float] = declared(CANDIDATE_REGION, "h_max")
    h_mean: Mapped[float] = declared(CANDIDATE_REGION, "h_mean")
    h_p50: Mapped[float] = declared(CANDIDATE_REGION, "h_p50")
    h_p90: Mapped[float] = declared(CANDIDATE_REGION, "h_p90")
    h_std: Mapped[float] = declared(CANDIDATE_REGION, "h_std")
    xcen: Mapped[float] = declared(CANDIDATE_REGION, "xcen")
    ycen: Mapped[float] = declared(CANDIDATE_REGION, "ycen")
    geometry: Mapped[WKBElement] = geometry("MULTIPOLYGON")


class PartCandidate(Base):
    """A part and a candidate region that share cells: one is the other's witness."""

    __tablename__ = "part_candidate"
    __table_args__ = (
        *overlaps("part_share", "candidate_share"),
        Index(None, "candidate_id"),
        Index(None, "run_id"),
    )
    part_id: Mapped[int] = key(
        comment_of(PART_CANDIDATE, "part_id"), ForeignKey("part.part_id", ondelete="CASCADE"), primary_key=True
    )
    candidate_id: Mapped[int] = key(
        comment_of(PART_CANDIDATE, "candidate_id"),
        ForeignKey("candidate_region.candidate_id", ondelete="CASCADE"),
        primary_key=True,
    )
    run_id: Mapped[int] = run_key()
    overlap_m2: Mapped[float] = declared(PART_CANDIDATE, "overlap_m2")
    part_share: Mapped[float] = declared(PART_CANDIDATE, "part_share")
    candidate_share: Mapped[float] = declared(PART_CANDIDATE, "candidate_share")


class FlatRegionCandidate(Base):
    """A flat region and a candidate region that share cells: one is the other's witness."""

    __tablename__ = "flat_region_candidate"
    __table_args__ = (
        *overlaps("region_share", "candidate_share"),
        Index(None, "candidate_id"),
        Index(None, "run_id"),
    )
    region_id: Mapped[int] = key(
        comment_of(FLAT_REGION_CANDIDATE, "region_id"),
        ForeignKey("flat_region.region_id", ondelete="CASCADE"),
        primary_key=True,
    )
    candidate_id: Mapped[int] = key(
        comment_of(FLAT_REGION_CANDIDATE, "candidate_id"),
        ForeignKey("candidate_region.candidate_id", ondelete="CASCADE"),
        primary_key=True,
    )
    run_id: Mapped[int] = run_key()
    overlap_m2: Mapped[float] = declared(FLAT_REGION_CANDIDATE, "overlap_m2")
    region_share: Mapped[float] = declared(FLAT_REGION_CANDIDATE, "region_share")
    candidate_share: Mapped[float] = declared(FLAT_REGION_CANDIDATE, "candidate_share")
