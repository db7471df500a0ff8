"""The tables of what a run found: parts, buildings, regions of the other detectors, and links between them."""

from typing import TYPE_CHECKING

from msbdb.errors import TableError
from msbdb.params import POINT_DETECTORS
from msbdb.tables.declaration import (
    RUN_ID,
    Check,
    Column,
    Index,
    KeyReference,
    Table,
    Unique,
    one_of,
    overlaps,
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
        *shares("building_share"),
    ),
    indexes=(
        Index(("father_id", "supscale", "root_id", "run_id")),
        Index(("root_id",)),
        Index(("building_id", "run_id")),
        Index(("run_id", "scale")),
        Index(("run_id", "class_id")),
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
        Column("storeys", "int64", "storeys", "storeys of its tallest part"),
        Column("h_max", "float64", "m", "largest height above ground"),
        Column("h_mean", "float64", "m", "mean height above ground"),
        Column("h_p50", "float64", "m", "median height above ground"),
        Column("h_p90", "float64", "m", "90th percentile of the height above ground"),
        Column("area_m2", "float64", "m2", "area of the footprint's cells"),
        Column("volume_m3", "float64", "m3", "sum over the footprint's cells of height times cell area"),
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
    ),
    rules=(
        Unique(("building_id", "run_id")),
        KeyReference(("run_id", "class_id"), "spectral_class", ("run_id", "speindex")),
        Check("building_id", "building_id > 0"),
        one_of("state", BUILDING_STATES),
        Check("size", "storeys >= 0 AND area_m2 > 0"),
        Check("parts", "trees >= 1 AND parts >= trees AND scales >= 1"),
        *shares("probability", "building_share", *DETECTOR_SHARES.values()),
    ),
    indexes=(Index(("run_id", "class_id")),),
    geometry="MULTIPOLYGON",
)

# Found without the scale-space (Mongus et al. 2013), so that parts and flat regions are independent evidence.
FLAT_REGION = Table(
    "flat_region",
    "A region of even height above its surroundings, found by its gradients",
    (
        Column(
            "region_id",
            "int64",
            "-",
            "id of the flat region, from survey and absolute lattice position; above 0",
            primary=True,
        ),
        RUN_ID,
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
    rules=(
        Check("region_id", "region_id > 0"),
        Check("zone", "zone >= 0 AND lambda_low_m2 >= 0 AND lambda_low_m2 <= lambda_m2"),
        Check("gradient", "gradient_sum >= 0 AND mean_gradient >= 0"),
        Check("shape", "area_m2 > 0 AND perimeter_m > 0 AND compactness > 0"),
    ),
    indexes=(Index(("run_id", "zone")),),
    geometry="MULTIPOLYGON",
)

PART_FLAT_REGION = Table(
    "part_flat_region",
    "A part and a flat region that share cells: each is evidence for the other",
    (
        Column("part_id", "int64", "-", "the part", primary=True, refers="part.part_id", cascade=True),
        Column(
            "region_id",
            "int64",
            "-",
            "the flat region that it shares cells with",
            primary=True,
            refers="flat_region.region_id",
            cascade=True,
        ),
        RUN_ID,
        Column("overlap_m2", "float64", "m2", "area of the cells that both cover; above 0"),
        Column("part_share", "float64", "1", "share of the part's area that the region covers"),
        Column("region_share", "float64", "1", "share of the region's area that the part covers"),
    ),
    rules=(*overlaps("part_share", "region_share"),),
    indexes=(
        Index(("region_id",)),
        Index(("run_id",)),
    ),
)

# Found without the lattice and the scale-space (Cao & Wu; the Bathurst slides).
CANDIDATE_REGION = Table(
    "candidate_region",
    "A region that a detector on the points takes for a roof",
    (
        Column(
            "candidate_id",
            "int64",
            "-",
            "id of the region, from survey, method and absolute lattice position",
            primary=True,
        ),
        RUN_ID,
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
        Column("perimeter", "int64", "count", "number of its edge points (C10); 0 where edges were not computed"),
        Column("mbr_m2", "float64", "m2", "area of the minimum bounding rectangle of its points (C10)"),
        Column("rectangularity", "float64", "1", "area over the area of the bounding rectangle (C17)"),
        Column(
            "compactness",
            "float64",
            "1",
            "points over edge points (C17); null where edges were not computed",
            nullable=True,
        ),
        Column(
            "linearity",
            "float64",
            "1",
            "mean L(u) over its edge points (C11, C12); null where edges were not computed",
            nullable=True,
        ),
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
    rules=(
        Check("candidate_id", "candidate_id > 0"),
        one_of("method", POINT_DETECTORS),
        Check("rule", "rule <> ''"),
        Check("height_scale", "height_scale_m IS NULL OR method = 'area3d'"),
        Check("points", "points > 0 AND perimeter >= 0"),
        Check("shape", "area_m2 > 0 AND mbr_m2 >= 0 AND rectangularity >= 0 AND compactness >= 0"),
        *shares("linearity"),
        Check("direction_1", "direction_1 >= 0 AND direction_1 <= 180"),
        Check("direction_2", "direction_2 >= 0 AND direction_2 <= 180"),
        Check("ndvi", "ndvi >= -1 AND ndvi <= 1"),
    ),
    indexes=(Index(("run_id", "method")),),
    geometry="MULTIPOLYGON",
)

PART_CANDIDATE = Table(
    "part_candidate",
    "A part and a candidate region that share cells: each is evidence for the other",
    (
        Column("part_id", "int64", "-", "the part", primary=True, refers="part.part_id", cascade=True),
        Column(
            "candidate_id",
            "int64",
            "-",
            "the candidate region that it shares cells with",
            primary=True,
            refers="candidate_region.candidate_id",
            cascade=True,
        ),
        RUN_ID,
        Column("overlap_m2", "float64", "m2", "area of the cells that both cover; above 0"),
        Column("part_share", "float64", "1", "share of the part's area that the candidate region covers"),
        Column("candidate_share", "float64", "1", "share of the candidate region's cells that the part covers"),
    ),
    rules=(*overlaps("part_share", "candidate_share"),),
    indexes=(
        Index(("candidate_id",)),
        Index(("run_id",)),
    ),
)

FLAT_REGION_CANDIDATE = Table(
    "flat_region_candidate",
    "A flat region and a candidate region that share cells: each is evidence for the other",
    (
        Column(
            "region_id", "int64", "-", "the flat region", primary=True, refers="flat_region.region_id", cascade=True
        ),
        Column(
            "candidate_id",
            "int64",
            "-",
            "the candidate region that it shares cells with",
            primary=True,
            refers="candidate_region.candidate_id",
            cascade=True,
        ),
        RUN_ID,
        Column("overlap_m2", "float64", "m2", "area of the cells that both cover; above 0"),
        Column("region_share", "float64", "1", "share of the flat region's area that the candidate region covers"),
        Column("candidate_share", "float64", "1", "share of the candidate region's cells that the flat region covers"),
    ),
    rules=(*overlaps("region_share", "candidate_share"),),
    indexes=(
        Index(("candidate_id",)),
        Index(("run_id",)),
    ),
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
