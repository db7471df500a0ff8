"""The tables of parts and buildings, and the checks of the forest of parts."""

from typing import TYPE_CHECKING

from msbdb.errors import TableError
from msbdb.tables.declaration import (
    RUN_ID,
    Check,
    Column,
    Index,
    KeyReference,
    Table,
    Unique,
    one_of,
    shares,
    validate,
)

if TYPE_CHECKING:
    import pandas as pd

EXTRACTOR_SHARES = {"flatregions": "flat_share", "area3d": "area3d_share", "adaptive": "adaptive_share"}
"""The detectors that can confirm parts and buildings, each with the column of the share that its regions cover."""

DETECTOR_SHARES = {"multiscale": "multiscale_share"} | EXTRACTOR_SHARES
"""All detectors with the column of a building that has the share which their regions cover."""

CONFIRMING_CLASS_SHARE = 0.5
"""The classes confirm a building when at least this share of its cells has a building class."""

CONFIRMING_COVER = 0.1
"""The regions of a detector confirm a building when they cover at least this share of its footprint.

Ours: on the real tiles shares lie near 1 or at 0, so that 0.1 and 0.3 confirm nearly the same buildings.
"""

BUILDING_STATES = ("confirmed", "unsure", "refuted")

OUTLINE_SOURCES = ("fitted", "traced")

OUTLINE_SOURCE = Column(
    "outline_source",
    "str",
    "-",
    "the outline, of roof edges: fitted to straight walls, or traced along cells where some wall would be off",
)

_CLASS_ID = Column(
    "class_id", "int64", "-", "SPE, but null for none", nullable=True, zero_of="speindex", in_frame=False
)

# One foreign key and two checks hold the forest (V33): the father exists, in the same run and tree, on the scale that
# SUPSCALE says; fathers are coarser than children, so there is no cycle; and a root is its own tree's root.
PART = Table(
    "part",
    "A part of a building on one scale; a father holds its children (V32, V33)",
    (
        Column("part_id", "int64", "-", "ID: from survey, scale and absolute lattice position; above 0", primary=True),
        RUN_ID,
        Column("supid", "int64", "-", "SUPID: the father's ID; 0 for a root"),
        Column("father_id", "int64", "-", "SUPID, but null for a root", nullable=True, zero_of="supid", in_frame=False),
        Column("supscale", "int64", "-", "SUPSCALE: the father's scale; 0 for a root"),
        Column("root_id", "int64", "-", "ID of the root of its tree"),
        Column("building_id", "int64", "-", "the building in which its tree stands"),
        Column("scale", "int64", "-", "SCALE: the scale on which the part exists, 1 = coarsest"),
        Column(
            "hindex",
            "int64",
            "storeys",
            "H: storeys from h_p90, or with surface.storeys_from=zone the same as hzone (V18, V30)",
        ),
        Column("hzone", "int64", "slices", "H by the letter of the paper: the value of the flat zone"),
        Column("speindex", "int64", "-", "SPE: the most frequent spectral class inside; 0 for none"),
        _CLASS_ID,
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
        OUTLINE_SOURCE,
    ),
    rules=(
        Unique(("part_id", "scale", "root_id", "run_id")),
        KeyReference(
            ("father_id", "supscale", "root_id", "run_id"),
            "part",
            ("part_id", "scale", "root_id", "run_id"),
            deferred=True,
        ),
        KeyReference(("building_id", "run_id"), "building", ("building_id", "run_id"), deferred=True),
        KeyReference(("run_id", "scale"), "scale", ("run_id", "scale")),
        KeyReference(("run_id", "class_id"), "spectral_class", ("run_id", "speindex")),
        Check("part_id", "part_id > 0"),
        Check(
            "father",
            "(supid = 0 AND supscale = 0 AND root_id = part_id) OR (supid > 0 AND supscale > 0 AND supscale < scale)",
        ),
        Check("area", "area_px > 0 AND area_m2 > 0"),
        Check("storeys", "hindex >= 0 AND hzone >= 0"),
        one_of("outline_source", OUTLINE_SOURCES),
        *shares("building_share"),
    ),
    indexes=(
        Index(("father_id",)),
        Index(("building_id", "run_id")),
        Index(("run_id", "scale", "class_id")),
    ),
    geometry="MULTIPOLYGON",
)


def _covered() -> tuple[Column, ...]:
    """Return a column for each detector: the share of the footprint that its regions cover."""
    words = {
        "multiscale": "regions of multiscale cover",
        "flatregions": "flat regions cover",
        "area3d": "candidates of area3d cover",
        "adaptive": "candidates of adaptive cover",
    }
    return tuple(
        Column(
            DETECTOR_SHARES[name],
            "float64",
            "1",
            f"share of the footprint that {what}; null when this detector was not run",
            nullable=True,
        )
        for name, what in words.items()
    )


HEIGHTS = (
    "z_ground",
    "z_ground_min",
    "z_ground_max",
    "z_eaves",
    "z_ridge",
    "eaves",
    "ridge",
    "storeys",
    "storeys_min",
    "storeys_max",
    "storeys_top",
)
"""Columns of a building, and of its versions, with ground, eaves, ridge and storeys."""


def _heights() -> tuple[Column, ...]:
    """Return the columns of a building's ground, eaves, ridge and storeys, null where an older msbdb has none."""
    metres = {
        "z_ground": "median level of the ground around it, in the survey's vertical reference; null where not known",
        "z_ground_min": "lowest level of the ground around it, but for a twentieth",
        "z_ground_max": "highest level of the ground around it, but for a twentieth",
        "z_eaves": "level of the eaves: mean of its roofs over the middle half of its area; null where z_ground is",
        "z_ridge": "level of the ridge of its highest roof of weight; null where z_ground is",
        "eaves": "z_eaves above z_ground",
        "ridge": "z_ridge above z_ground",
    }
    counts = {
        "storeys_min": "fewest storeys that the eaves can have, if storeys are tall",
        "storeys_max": "most storeys that the eaves can have, if storeys are low",
        "storeys_top": "storeys of the highest eaves of its roofs of weight, as of a tower on a podium",
    }
    return (
        *(Column(name, "float64", "m", doc, nullable=True) for name, doc in metres.items()),
        Column("storeys", "int64", "storeys", "storeys by the eaves of its main roof; in old runs of its tallest part"),
        *(Column(name, "Int64", "storeys", doc, nullable=True) for name, doc in counts.items()),
    )


def height_rules() -> tuple[Check, ...]:
    """Return what holds between the heights of a building, or of one of its versions."""
    return (
        Check("heights", "ridge >= eaves"),
        Check("storeys", "storeys_min >= 1 AND storeys_min <= storeys AND storeys <= storeys_max"),
    )


def _quality() -> tuple[Column, ...]:
    """Return the columns that say how well a building was seen, null where a run of an older msbdb has none."""
    return (
        Column("coverage", "float64", "1", "share of the footprint's cells with a measured height", nullable=True),
        Column(
            "nodata_share",
            "float64",
            "1",
            "share of the footprint and the ring around it that has no height, as at water and at the survey's border",
            nullable=True,
        ),
        Column("density", "float64", "1/m2", "first echoes a square metre in it; null for rasters", nullable=True),
    )


BUILDING = Table(
    "building",
    "A building: one connected island of roofs that the detectors support, with one or more trees of parts",
    (
        Column("building_id", "int64", "-", "stable id of the building: the ID of its largest root", primary=True),
        RUN_ID,
        Column(
            "state",
            "str",
            "-",
            "confirmed, unsure or refuted: from the probability; where it is null, from the classes and the detectors",
        ),
        Column(
            "probability",
            "float64",
            "1",
            "probability that it is a building, from the support of all detectors; null with fewer than three",
            nullable=True,
        ),
        *_heights(),
        Column("h_max", "float64", "m", "largest height above ground"),
        Column("h_mean", "float64", "m", "mean height above ground"),
        Column("h_p50", "float64", "m", "median height above ground"),
        Column("h_p90", "float64", "m", "90th percentile of the height above ground"),
        Column("area_m2", "float64", "m2", "area of the footprint's cells"),
        Column("volume_m3", "float64", "m3", "sum over the footprint's cells of height times cell area"),
        Column(
            "floor_area_m2",
            "float64",
            "m2",
            "estimate of the area of all storeys, by the eaves of each roof; null in runs of an older msbdb",
            nullable=True,
        ),
        Column("trees", "int64", "count", "number of its trees of parts; one root each"),
        Column("parts", "int64", "count", "number of parts, the roots included"),
        Column("scales", "int64", "count", "number of scales on which it has parts"),
        Column("speindex", "int64", "-", "the spectral class of its largest root; 0 for none"),
        _CLASS_ID,
        Column("building_share", "float64", "1", "share of its cells whose class is a building class"),
        Column("xcen", "float64", "m", "easting of the centroid of its cells"),
        Column("ycen", "float64", "m", "northing of the centroid of its cells"),
        Column("xin", "float64", "m", "easting of a point that lies on the building"),
        Column("yin", "float64", "m", "northing of a point that lies on the building"),
        *_covered(),
        *_quality(),
        Column(
            "divided_by",
            "str",
            "-",
            "why touching houses beside it are other buildings: parcel, step, valley, wall, direction, "
            "material; several with commas; empty for none",
        ),
        OUTLINE_SOURCE,
    ),
    rules=(
        Unique(("building_id", "run_id")),
        KeyReference(("run_id", "class_id"), "spectral_class", ("run_id", "speindex")),
        Check("building_id", "building_id > 0"),
        one_of("state", BUILDING_STATES),
        one_of("outline_source", OUTLINE_SOURCES),
        Check("size", "storeys >= 0 AND area_m2 > 0"),
        *height_rules(),
        Check("parts", "trees >= 1 AND parts >= trees AND scales >= 1"),
        *shares("probability", "building_share", *DETECTOR_SHARES.values(), "coverage", "nodata_share"),
    ),
    indexes=(Index(("run_id", "class_id")),),
    geometry="MULTIPOLYGON",
)


def validate_parts(parts: "pd.DataFrame") -> None:
    """Check the parts' declaration and the forest's invariants (V33).

    Ids are unique and above 0; every father exists, on a coarser scale and with a larger area; SUPID is 0
    exactly where SUPSCALE is 0; every part reaches the root that it names.

    Raises
    ------
    TableError
        Naming the invariant and the first parts that break it.
    """
    validate(parts, PART)
    if parts["part_id"].duplicated().any() or (parts["part_id"] <= 0).any():
        msg = "Part ids must be unique and above 0."
        raise TableError(msg)
    # Without the columns that no rule is about, which would be copied with their rows.
    parts = parts[["part_id", "supid", "supscale", "root_id", "building_id", "scale", "area_px"]]
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
    _require(
        father["building_id"].to_numpy() == child["building_id"].to_numpy(),
        child,
        "is in another building than its father",
    )
    root = parts[parts["supid"] == 0]
    _require(
        (root["supscale"] == 0) & (root["root_id"] == root["part_id"]), root, "is a root with a father's scale or root"
    )


def _require(holds: object, rows: "pd.DataFrame", what: str) -> None:
    """Raise for the rows where a condition fails."""
    import pandas as pd

    broken = rows.loc[~pd.Series(holds, index=rows.index, dtype=bool), "part_id"]
    if len(broken):
        msg = f"The forest of parts is broken: part {', '.join(str(i) for i in broken[:5])} {what}."
        raise TableError(msg)
