"""The tables of the living inventory: buildings over several surveys, their versions, and the events that changed them.

Rows of a run (``building``, ``part`` and the others) are replaced when their survey is built again. Versions hold
copies and are kept, so ``building_version.building_id`` is no foreign key. Neither is ``operator_state.uid``: a
decision must be kept when an update is withdrawn and applied again.
"""

from dataclasses import replace

from msbdb.tables.building_tables import BUILDING, BUILDING_STATES, EXTRACTOR_SHARES, HEIGHTS, height_rules
from msbdb.tables.declaration import Check, Column, Index, Table, one_of, only_stored, shares

CHANGE_KINDS = ("unchanged", "modified", "new", "demolished", "merged", "split")
"""The change of a building in a survey; a building outside the surveyed area has no row."""

ACROSS = "across a border: "
"""How the notes of changes begin that join the pieces of a building, which the border of surveys cuts."""

FIRST_SURVEY = "the first survey of this place"
"""The note of new buildings that no earlier survey could see: a beginning, not a change."""

VERSION_SOURCES = ("survey", "import")
MANUAL_STATES = ("confirmed", "refuted")
EVENT_KINDS = ("import", "update")

ROW_DIGEST = Column(
    "row_digest",
    "int64",
    "-",
    "digest of the row's values, which detects edits by other programs",
    nullable=True,
    in_frame=False,
)
"""The last column of each table whose rows have digests."""


def _measured(*names: str) -> tuple[Column, ...]:
    """Return columns of a building, null where no survey has measured them."""
    return tuple(replace(BUILDING[name], nullable=True) for name in names)


INVENTORY_BUILDING = Table(
    "inventory_building",
    "A building of the inventory, with one identity over all surveys",
    only_stored(
        Column("uid", "int64", "-", "from the survey or import that first had it, and its place", primary=True),
        Column("source", "str", "-", "name of the survey or import that first had it"),
    ),
    rules=(Check("uid", "uid > 0"),),
    digested=True,
)

# The interval is [valid_from, valid_to); the current version has no valid_to. A version that began and ended on the
# same day is valid at no date.
BUILDING_VERSION = Table(
    "building_version",
    "A state of a building of the inventory, with the interval in which it is valid",
    only_stored(
        Column("version_id", "int64", "-", "from the building and the survey or import that made it", primary=True),
        Column("uid", "int64", "-", "the building", refers="inventory_building.uid"),
        Column("valid_from", "str", "-", "first day on which it is valid, ISO 8601"),
        Column(
            "valid_to",
            "str",
            "-",
            "first day on which it is no longer valid, ISO 8601; null for the current version",
            nullable=True,
        ),
        Column("source", "str", "-", "what made it: survey or import"),
        Column(
            "survey_id",
            "int64",
            "-",
            "the survey that made it; null for an import",
            nullable=True,
            refers="survey.survey_id",
        ),
        Column(
            "closed_by",
            "int64",
            "-",
            "the survey that ended it; null for the current version",
            nullable=True,
            refers="survey.survey_id",
            key_name="fk_building_version_closed_by",
        ),
        Column(
            "building_id",
            "int64",
            "-",
            "the building of the survey's run it was copied from, which a rebuild may replace",
            nullable=True,
        ),
        BUILDING["state"],
        *_measured(*HEIGHTS, "h_max", "h_mean", "h_p50", "h_p90"),
        Column("area_m2", "float64", "m2", "area of the footprint"),
        *_measured("volume_m3", "parts", "flat_share", "area3d_share", "adaptive_share", "probability"),
        Column(
            "attributes",
            "json",
            "-",
            "attributes from an imported inventory, by the names of its columns",
            nullable=True,
        ),
    ),
    rules=(
        Check("version_id", "version_id > 0"),
        Check("valid_from", "length(valid_from) = 10"),
        Check("valid_to", "valid_to IS NULL OR (length(valid_to) = 10 AND valid_to >= valid_from)"),
        one_of("source", VERSION_SOURCES),
        Check("survey", "(source = 'survey') = (survey_id IS NOT NULL)"),
        Check("closed_by", "closed_by IS NULL OR valid_to IS NOT NULL"),
        one_of("state", BUILDING_STATES),
        Check("area", "area_m2 > 0"),
        Check("parts", "storeys >= 0 AND parts >= 1"),
        *height_rules(),
        *shares(*EXTRACTOR_SHARES.values(), "probability"),
    ),
    indexes=(
        Index(("uid", "valid_from")),
        Index(("uid",), unique=True, name="ix_building_version_current", where="valid_to IS NULL"),
        Index(("survey_id",)),
        Index(("closed_by",)),
        Index(("building_id",)),
    ),
    geometry="MULTIPOLYGON",
    digested=True,
)


def _side(name: str, doc: str, refers: str) -> Column:
    """Return the column of one side of a change; null where the side has no building."""
    key_name = f"fk_building_change_{name}"
    return Column(name, "int64", "-", doc, nullable=True, refers=refers, key_name=key_name)


BUILDING_CHANGE = Table(
    "building_change",
    "The change of a building of the inventory in a survey; for merged and split, a row for each pair of buildings",
    only_stored(
        Column("change_id", "int64", "-", "from the survey, the kind and the two buildings", primary=True),
        Column("survey_id", "int64", "-", "the survey", refers="survey.survey_id"),
        Column("kind", "str", "-", "unchanged, modified, new, demolished, merged or split"),
        _side("uid_before", "the building before; null for new", "inventory_building.uid"),
        _side("uid_after", "the building after; null when demolished", "inventory_building.uid"),
        _side("version_before", "its version before", "building_version.version_id"),
        _side("version_after", "its version after; the same as before where unchanged", "building_version.version_id"),
        Column("outline", "bool", "-", "its outline changed"),
        Column("height", "bool", "-", "its height changed"),
        Column("parts", "bool", "-", "only a part of it changed its height"),
        Column("overlap_m2", "float64", "m2", "area shared by both footprints, the inventory shifted by the offset"),
        Column("iou", "float64", "1", "shared area over the area of the union"),
        Column("dh_m", "float64", "m", "median change of height where both are known", nullable=True),
        Column("darea_m2", "float64", "m2", "change of the footprint's area; all of it for new and demolished"),
        Column("note", "str", "-", "a remark; often empty"),
    ),
    rules=(
        Check("change_id", "change_id > 0"),
        one_of("kind", CHANGE_KINDS),
        Check("uid", "uid_before IS NOT NULL OR uid_after IS NOT NULL"),
        Check(
            "version",
            "(uid_before IS NULL) = (version_before IS NULL) AND (uid_after IS NULL) = (version_after IS NULL)",
        ),
        Check("overlap", "overlap_m2 >= 0 AND iou >= 0 AND iou <= 1"),
    ),
    indexes=(
        Index(("survey_id", "kind")),
        Index(("uid_before",)),
        Index(("uid_after",)),
        Index(("version_before",)),
        Index(("version_after",)),
    ),
    digested=True,
)

# The offset is applied when buildings are compared; no stored geometry is shifted.
SURVEY_OFFSET = Table(
    "survey_offset",
    "The offset of a survey: a place (x, y, h) of the inventory is (x + dx, y + dy, h + dz) in the survey",
    only_stored(
        Column("survey_id", "int64", "-", "the survey", primary=True, refers="survey.survey_id"),
        Column("dx_m", "float64", "m", "to the east; 0 where too few buildings match"),
        Column("dy_m", "float64", "m", "to the north"),
        Column("dz_m", "float64", "m", "of the heights above ground"),
        Column("pairs", "int64", "-", "pairs of matching buildings that it was computed from"),
        Column(
            "spread_m",
            "float64",
            "m",
            "robust standard deviation of a pair's shift; null without pairs",
            nullable=True,
        ),
    ),
    rules=(Check("pairs", "pairs >= 0"),),
    digested=True,
)

INVENTORY_EVENT = Table(
    "inventory_event",
    "An import into the inventory or an update of it, with its order and area",
    only_stored(
        Column("number", "int64", "-", "1 to n, in the order in which they were applied", primary=True),
        Column("kind", "str", "-", "import or update"),
        Column("name", "str", "-", "name of the survey or import"),
        Column("date", "str", "-", "first day on which its versions are valid, ISO 8601"),
        Column("survey_id", "int64", "-", "the survey; null for an import", nullable=True, refers="survey.survey_id"),
        Column("counts", "json", "-", "rows that it wrote: changes by kind, and versions"),
        Column("content_sha256", "str", "-", "digest of everything that determines its result"),
    ),
    rules=(
        Check("number", "number > 0"),
        one_of("kind", EVENT_KINDS),
        Check("name", "name <> ''"),
        Check("date", "length(date) = 10"),
        Check("survey", "(kind = 'update') = (survey_id IS NOT NULL)"),
    ),
    indexes=(Index(("survey_id",), unique=True),),
    geometry="MULTIPOLYGON",
    digested=True,
)

OPERATOR_STATE = Table(
    "operator_state",
    "An operator's decision on a building; it has priority over the detectors, also after builds and updates",
    only_stored(
        Column("uid", "int64", "-", "the building of the inventory", primary=True),
        Column("state", "str", "-", "confirmed or refuted"),
        Column("operator", "str", "-", "who decided"),
        Column("note", "str", "-", "the reason; may be empty"),
        Column("decided_at", "str", "-", "when, UTC, ISO 8601; not part of the content"),
    ),
    rules=(one_of("state", MANUAL_STATES), Check("operator", "operator <> ''")),
    digested=True,
)

ROOF_SAMPLE = Table(
    "roof_sample",
    "A place where the material of a roof is known (V53)",
    only_stored(
        Column("sample_id", "int64", "-", "from the place", primary=True),
        Column("material", "str", "-", "the material"),
        Column("note", "str", "-", "a remark; may be empty"),
        Column(
            "attributes", "json", "-", "the other columns of the source file; an empty object for none", nullable=True
        ),
    ),
    rules=(Check("sample_id", "sample_id > 0"), Check("material", "material <> ''")),
    geometry="POINT",
    digested=True,
)

INVENTORY_TABLES = (
    INVENTORY_BUILDING,
    BUILDING_VERSION,
    BUILDING_CHANGE,
    SURVEY_OFFSET,
    INVENTORY_EVENT,
    OPERATOR_STATE,
    ROOF_SAMPLE,
)
"""All tables of the inventory."""
