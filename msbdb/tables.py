"""The declared tables that pass between the stages and into the database."""

from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from msbdb.errors import TableError


@dataclass(frozen=True, slots=True)
class Column:
    """A column: its name, pandas dtype, unit and meaning. Upper-case names in the meaning are the paper's.

    A ``nullable`` column may hold NaN, which the database stores as NULL.
    """

    name: str
    dtype: str
    unit: str
    doc: str
    nullable: bool = False


@dataclass(frozen=True, slots=True)
class Table:
    """A declared table: its name, columns, and the geometry type where it has one."""

    name: str
    columns: tuple[Column, ...]
    geometry: str | None = None

    @property
    def names(self) -> list[str]:
        """The columns' names in order, without the geometry."""
        return [column.name for column in self.columns]

    def empty(self) -> pd.DataFrame:
        """Return a table of these columns without rows (and without geometry)."""
        return pd.DataFrame({c.name: pd.Series(dtype=c.dtype) for c in self.columns})

    def typed(self, frame: pd.DataFrame) -> pd.DataFrame:
        """Return these columns of a frame (and its geometry), in order and of their dtypes."""
        more = [name for name in ("geometry",) if name in frame]
        return frame[[*self.names, *more]].astype({c.name: c.dtype for c in self.columns})


SCALE = Table(
    "scale",
    (
        Column("scale", "int64", "-", "SCALE: number of the scale, 1 = coarsest"),
        Column("threshold_px", "int64", "cells", "s: area threshold of opening and closing (Vu et al. 2009, Eq. 6)"),
        Column("threshold_m2", "float64", "m2", "s in square metres"),
    ),
)

PART = Table(
    "part",
    (
        Column("part_id", "int64", "-", "ID: from survey, scale and absolute lattice position; above 0"),
        Column("supid", "int64", "-", "SUPID: the father's ID; 0 for a root"),
        Column("supscale", "int64", "-", "SUPSCALE: the father's scale; 0 for a root"),
        Column("root_id", "int64", "-", "ID of the root of its tree"),
        Column("scale", "int64", "-", "SCALE: the scale on which the part exists, 1 = coarsest"),
        Column("hindex", "int64", "storeys", "H: storeys from the upper heights (p90) inside the part (V18, V30)"),
        Column("hzone", "int64", "slices", "H as written: the value of the flat zone"),
        Column("speindex", "int64", "-", "SPE: the most frequent spectral class inside; 0 for none"),
        Column("xo", "float64", "m", "XO: easting of the first cell in row order"),
        Column("yo", "float64", "m", "YO: northing of the first cell in row order"),
        Column("xcen", "float64", "m", "XCEN: easting of the centroid of its cells"),
        Column("ycen", "float64", "m", "YCEN: northing of the centroid of its cells"),
        Column("xin", "float64", "m", "easting of a point that lies on the part"),
        Column("yin", "float64", "m", "northing of a point that lies on the part"),
        Column("area_px", "int64", "cells", "number of cells"),
        Column("area_m2", "float64", "m2", "AREA: area of the cells"),
        Column(
            "stddis",
            "float64",
            "m",
            "STDDIS: std of the children's distances to the centre; null without children",
            nullable=True,
        ),
        Column("h_max", "float64", "m", "largest height above ground inside"),
        Column("h_mean", "float64", "m", "mean height above ground inside"),
        Column("h_p50", "float64", "m", "median height above ground inside"),
        Column("h_p90", "float64", "m", "90th percentile of the height above ground inside"),
        Column("h_std", "float64", "m", "standard deviation of the heights inside"),
        Column("building_share", "float64", "1", "share of its cells whose class is a building class"),
    ),
    geometry="MULTIPOLYGON",
)

SPECTRAL_CLASS = Table(
    "spectral_class",
    (
        Column("speindex", "int64", "-", "SPE: number of the class, from 1 in canonical order"),
        Column("label", "str", "-", "building, vegetation, shadow, water or other"),
        Column("labelled_by", "str", "-", "automatic or operator"),
        Column("source", "str", "-", "spectral: k-means on the bands; structure: height texture and echoes"),
        Column("cells", "int64", "cells", "number of cells of the class"),
        Column("share", "float64", "1", "share of all classified cells"),
        Column(
            "ndvi", "float64", "1", "mean of (NIR - red) / (NIR + red), or of its stand-in; null without", nullable=True
        ),
        Column(
            "brightness",
            "float64",
            "1",
            "mean over the bands of the bands' 0 to 1 values; null without imagery",
            nullable=True,
        ),
        Column("roughness_m", "float64", "m", "median local roughness of the surface; null without", nullable=True),
        Column("height_m", "float64", "m", "mean height above ground"),
    ),
)

SPECTRAL_CLASS_BAND = Table(
    "spectral_class_band",
    (
        Column("speindex", "int64", "-", "the class"),
        Column("band", "str", "-", "name of the band"),
        Column("mean", "float64", "DN", "mean value of the band in the class, in the source's units"),
    ),
)

REJECTION = Table(
    "rejection",
    (
        Column("region_id", "int64", "-", "id of the dropped region, of the same kind as a part's"),
        Column("stage", "str", "-", "the stage that dropped it"),
        Column("reason", "str", "-", "why it was dropped"),
        Column("scale", "int64", "-", "its scale; 0 where none applies"),
        Column("area_m2", "float64", "m2", "its area"),
        Column("xcen", "float64", "m", "easting of its centroid"),
        Column("ycen", "float64", "m", "northing of its centroid"),
    ),
    geometry="POINT",
)

BUILDING = Table(
    "building",
    (
        Column("building_id", "int64", "-", "stable id of the building"),
        Column("root_id", "int64", "-", "ID of its root part"),
        Column(
            "state",
            "str",
            "-",
            "confirmed by the classes and by at least half of the other extractors that were heard; unsure; or refuted",
        ),
        Column("storeys", "int64", "storeys", "storeys of its tallest part"),
        Column("h_max", "float64", "m", "largest height above ground"),
        Column("h_mean", "float64", "m", "mean height above ground"),
        Column("h_p50", "float64", "m", "median height above ground"),
        Column("h_p90", "float64", "m", "90th percentile of the height above ground"),
        Column("area_m2", "float64", "m2", "area of the footprint's cells"),
        Column("volume_m3", "float64", "m3", "sum over the footprint's cells of height times cell area"),
        Column("parts", "int64", "count", "number of parts, the root included"),
        Column("scales", "int64", "count", "number of scales on which it has parts"),
        Column("speindex", "int64", "-", "the root's spectral class; 0 for none"),
        Column(
            "flat_share",
            "float64",
            "1",
            "share of the footprint that flat regions cover; null when they were not extracted",
            nullable=True,
        ),
        Column(
            "area3d_share",
            "float64",
            "1",
            "share of the footprint that candidates of area3d cover; null when they were not extracted",
            nullable=True,
        ),
        Column(
            "adaptive_share",
            "float64",
            "1",
            "share of the footprint that candidates of adaptive cover; null when they were not extracted",
            nullable=True,
        ),
    ),
    geometry="MULTIPOLYGON",
)

FLAT_REGION = Table(
    "flat_region",
    (
        Column("region_id", "int64", "-", "id of the flat region, from survey and absolute lattice position; above 0"),
        Column(
            "zone",
            "int64",
            "-",
            "i: attribute-zone of most of its cells; 0 where none has one (Mongus et al. 2013, Eq. 2)",
        ),
        Column("lambda_low_m2", "float64", "m2", "λ_{i-1}: lower threshold of the zone"),
        Column("lambda_m2", "float64", "m2", "λ_i: upper threshold of the zone"),
        Column("gradient_sum", "float64", "m3", "Λ: sum of second-order gradients times cell area (Eq. 11)"),
        Column("mean_gradient", "float64", "m", "mean second-order gradient of its cells, as summed"),
        Column("area_m2", "float64", "m2", "area of its cells"),
        Column("perimeter_m", "float64", "m", "P: corrected length of its outlines, holes included"),
        Column("compactness", "float64", "1", "Ψ' = P²/(4πA), 1 for a disc, larger for longer shapes (Eq. 15)"),
        Column("h_max", "float64", "m", "largest height above ground inside"),
        Column("h_mean", "float64", "m", "mean height above ground inside"),
        Column("h_p50", "float64", "m", "median height above ground inside"),
        Column("h_p90", "float64", "m", "90th percentile of the height above ground inside"),
        Column("h_std", "float64", "m", "standard deviation of the heights inside"),
        Column("xcen", "float64", "m", "easting of the centroid of its cells"),
        Column("ycen", "float64", "m", "northing of the centroid of its cells"),
    ),
    geometry="MULTIPOLYGON",
)

PART_FLAT_REGION = Table(
    "part_flat_region",
    (
        Column("part_id", "int64", "-", "the part"),
        Column("region_id", "int64", "-", "the flat region that it shares cells with"),
        Column("overlap_m2", "float64", "m2", "area of the cells that both cover; above 0"),
        Column("part_share", "float64", "1", "share of the part's area that the region covers"),
        Column("region_share", "float64", "1", "share of the region's area that the part covers"),
    ),
)

CANDIDATE_REGION = Table(
    "candidate_region",
    (
        Column("candidate_id", "int64", "-", "id of the region, from survey, method and absolute lattice position"),
        Column("method", "str", "-", "area3d (Cao & Wu) or adaptive (Bathurst slides)"),
        Column("rule", "str", "-", "the rule that accepted it: rule 1 or rule 2 (C18); clustering (S6)"),
        Column(
            "height_scale_m",
            "float64",
            "m",
            "h_j: lowest height above ground at which it was accepted (C14); null for the adaptive filter",
            nullable=True,
        ),
        Column("points", "int64", "count", "number of its points (C3)"),
        Column("area_m2", "float64", "m2", "its points' area: number over local density (A17)"),
        Column("perimeter", "int64", "count", "number of its edge points (C10); 0 where none were sought"),
        Column("mbr_m2", "float64", "m2", "area of the minimum bounding rectangle of its points (C10)"),
        Column("rectangularity", "float64", "1", "area over the area of the bounding rectangle (C17)"),
        Column(
            "compactness", "float64", "1", "points over edge points (C17); null where none were sought", nullable=True
        ),
        Column("linearity", "float64", "1", "mean L(u) over its edge points (C11, C12); null unsought", nullable=True),
        Column("direction_1", "float64", "deg", "strongest main direction, 0 to 180 from east (C11)", nullable=True),
        Column("direction_2", "float64", "deg", "second main direction, 0 to 180 from east (C11)", nullable=True),
        Column("ndvi", "float64", "1", "mean NDVI of its points; null without colours", nullable=True),
        Column("h_max", "float64", "m", "largest height above ground of its points"),
        Column("h_mean", "float64", "m", "mean height above ground of its points"),
        Column("h_p50", "float64", "m", "median height above ground of its points"),
        Column("h_p90", "float64", "m", "90th percentile of the height above ground of its points"),
        Column("h_std", "float64", "m", "standard deviation of the heights of its points"),
        Column("xcen", "float64", "m", "easting of the centroid of its points"),
        Column("ycen", "float64", "m", "northing of the centroid of its points"),
    ),
    geometry="MULTIPOLYGON",
)

PART_CANDIDATE = Table(
    "part_candidate",
    (
        Column("part_id", "int64", "-", "the part"),
        Column("candidate_id", "int64", "-", "the candidate region that it shares cells with"),
        Column("overlap_m2", "float64", "m2", "area of the cells that both cover; above 0"),
        Column("part_share", "float64", "1", "share of the part's area that the candidate region covers"),
        Column("candidate_share", "float64", "1", "share of the candidate region's cells that the part covers"),
    ),
)

FLAT_REGION_CANDIDATE = Table(
    "flat_region_candidate",
    (
        Column("region_id", "int64", "-", "the flat region"),
        Column("candidate_id", "int64", "-", "the candidate region that it shares cells with"),
        Column("overlap_m2", "float64", "m2", "area of the cells that both cover; above 0"),
        Column("region_share", "float64", "1", "share of the flat region's area that the candidate region covers"),
        Column("candidate_share", "float64", "1", "share of the candidate region's cells that the flat region covers"),
    ),
)

TABLES = (
    SCALE,
    PART,
    SPECTRAL_CLASS,
    SPECTRAL_CLASS_BAND,
    REJECTION,
    BUILDING,
    FLAT_REGION,
    PART_FLAT_REGION,
    CANDIDATE_REGION,
    PART_CANDIDATE,
    FLAT_REGION_CANDIDATE,
)

EXTRACTOR_SHARES = {"flatregions": "flat_share", "area3d": "area3d_share", "adaptive": "adaptive_share"}
"""The extractors that bear witness for parts and buildings, each with the column of the share that it covers."""

CONFIRMING_CLASS_SHARE = 0.5
"""Share of building classes from which the classes confirm a building that the heights found."""

CONFIRMING_COVER = 0.1
"""Share of a footprint from which the regions of an extractor confirm it.

Ours: on the real tiles shares lie near 1 or at 0, so that 0.1 and 0.3 confirm nearly the same buildings.
"""


def validate(frame: pd.DataFrame, table: Table) -> None:
    """Check a frame against its declaration: columns in order, dtypes, and geometry where declared.

    Raises
    ------
    TableError
        Naming the first column that differs.
    """
    expected = table.names + (["geometry"] if table.geometry else [])
    if list(frame.columns) != expected:
        msg = f"Table {table.name} must have the columns {expected}; got {list(frame.columns)}."
        raise TableError(msg)
    for column in table.columns:
        found = str(frame[column.name].dtype)
        if found != column.dtype and not (column.dtype == "str" and found in ("object", "string")):
            msg = f"Column {table.name}.{column.name} must be {column.dtype}; got {found}."
            raise TableError(msg)


def validate_parts(parts: pd.DataFrame) -> None:
    """Check the parts' declaration and the forest's invariants (V33).

    Ids are unique and above 0; every father exists, on a coarser scale and with a larger area; SUPID is 0 just
    where SUPSCALE is 0; every part reaches the root that it names.

    Raises
    ------
    TableError
        Naming the invariant and the first parts that break it.
    """
    validate(parts, PART)
    if parts["part_id"].duplicated().any() or (parts["part_id"] <= 0).any():
        msg = "Part ids must be unique and above 0."
        raise TableError(msg)
    by_id = parts.set_index("part_id")
    child = parts[parts["supid"] != 0]
    _require(child["supid"].isin(by_id.index), child, "has a father that does not exist")
    father = by_id.loc[child["supid"]]
    _require(
        child["supscale"].to_numpy() == father["scale"].to_numpy(), child, "has a SUPSCALE that is not its father's"
    )
    _require(father["scale"].to_numpy() < child["scale"].to_numpy(), child, "has a father on no coarser scale")
    _require(child["area_px"].to_numpy() < father["area_px"].to_numpy(), child, "is not smaller than its father")
    _require(father["root_id"].to_numpy() == child["root_id"].to_numpy(), child, "has another root than its father")
    root = parts[parts["supid"] == 0]
    _require(
        (root["supscale"] == 0) & (root["root_id"] == root["part_id"]), root, "is a root with a father's scale or root"
    )


def _require(holds: object, rows: pd.DataFrame, what: str) -> None:
    """Raise for the rows where a condition fails."""
    broken = rows.loc[~pd.Series(holds, index=rows.index, dtype=bool), "part_id"]
    if len(broken):
        msg = f"The forest of parts is broken: part {', '.join(str(i) for i in broken[:5])} {what}."
        raise TableError(msg)


@dataclass(frozen=True, slots=True)
class Source:
    """One input file of a survey."""

    name: str
    role: str
    sha256: str
    bytes: int


@dataclass(frozen=True, slots=True)
class Survey:
    """A survey: where and when the data were taken, and from which files.

    ``date`` is ISO 8601 or empty; ``density`` is in first echoes a square metre (0 for rasters); ``bounds`` are
    west, south, east and north in metres; ``cell_m`` is the lattice's cell.
    """

    name: str
    date: str
    crs_wkt: str
    epsg: int
    vertical_crs: str
    density: float
    cell_m: float
    bounds: tuple[float, float, float, float]
    sources: tuple[Source, ...]


@dataclass(frozen=True, slots=True)
class Run:
    """The run that built a survey.

    ``method`` names its extractors, sorted and joined by commas: 'multiscale' or 'flatregions,multiscale'.
    ``parameters`` and ``counts`` are nested plain dictionaries; ``timings`` are seconds a stage (and stay out of the
    canonical dump, as they are the one thing that differs between equal runs). ``notices`` are sentences for people.
    """

    method: str
    profile: str
    version: str
    parameters: dict[str, object]
    counts: dict[str, object]
    timings: dict[str, float]
    notices: tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Build:
    """All that one build writes into the database, in one transaction.

    ``frames`` holds one frame for each of ``TABLES`` by name (GeoDataFrames where the table has a geometry).
    ``state`` holds named rasters of the run, from which classes can be re-labelled without the source data.
    """

    survey: Survey
    run: Run
    frames: dict[str, pd.DataFrame]
    state: dict[str, NDArray[np.generic]]
