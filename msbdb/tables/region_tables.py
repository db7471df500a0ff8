"""The tables of flat regions and candidate regions, and of their links to parts and to each other."""

from msbdb.params import POINT_DETECTORS
from msbdb.tables.declaration import RUN_ID, Check, Column, Index, Table, one_of, overlaps, shares

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
