"""The columns of the views, taken from the tables that they show; what a view computes is declared here."""

from collections.abc import Mapping
from dataclasses import replace

from msbdb.tables.building_tables import BUILDING, EXTRACTOR_SHARES, PART
from msbdb.tables.declaration import Column, Table
from msbdb.tables.inventory_tables import BUILDING_VERSION, OPERATOR_STATE, ROOF_SAMPLE
from msbdb.tables.region_tables import CANDIDATE_REGION, FLAT_REGION
from msbdb.tables.run_tables import SPECTRAL_CLASS, SURVEY

IDS = (
    "part_id", "uid", "building_id", "supid", "root_id", "version_id", "region_id", "candidate_id", "change_id",
    "uid_before", "uid_after", "version_before", "version_after", "rejection_id",
)  # fmt: skip
"""Columns of ids. Files and servers have them as text, because browsers and spreadsheets round numbers above 2^53."""

SURVEY_NAME = replace(SURVEY["name"], name="survey", nullable=True)
"""The survey of a row; null for a row of an import."""

GEOMETRY = Column("geometry", "bytes", "-", "outline of the roof's edges, in the database's CRS")
"""The geometry of each view that has one."""


def _count(name: str, doc: str) -> Column:
    return Column(name, "Int64", "count", doc, nullable=True)


def _share(name: str, doc: str) -> Column:
    return Column(name, "float64", "1", doc, nullable=True)


_BY_DETECTOR = tuple(
    column
    for what, name in (("flat", "flatregions"), ("area3d", "area3d"), ("adaptive", "adaptive"))
    for column in (
        _share(EXTRACTOR_SHARES[name], f"share of the part that regions of {name} cover; null when it was not run"),
        _count(
            f"{what}_regions", f"number of regions of {name} that share cells with the part; null when it was not run"
        ),
    )
)

_EXPLAINED = _share("explained_share", "share of the region that root parts cover; null when multiscale was not run")

_CLASS_LABEL = replace(SPECTRAL_CLASS["label"], name="class_label", nullable=True)

_CURRENT = (
    "version_id uid valid_from valid_to source survey state found_state operator note storeys storeys_min storeys_max "
    "storeys_top z_ground eaves ridge z_eaves z_ridge h_max h_mean h_p50 h_p90 area_m2 volume_m3 parts flat_share "
    "area3d_share adaptive_share probability building_id attributes"
)

_SHOWN: Mapping[str, tuple[str, tuple[Table, ...], tuple[Column, ...]]] = {
    "footprint": (
        "building_id survey state probability storeys storeys_min storeys_max storeys_top z_ground eaves ridge z_eaves "
        "z_ridge speindex area_m2 h_max h_mean h_p50 h_p90 trees parts divided_by outline_source xin yin",
        (BUILDING,),
        (),
    ),
    "part_tree": (
        "part_id survey building_id root_id supid supscale scale depth path hindex speindex area_m2 stddis h_max h_p90 "
        "outline_source",
        (PART,),
        (
            Column("depth", "int64", "-", "number of fathers above the part; 0 for a root"),
            Column("path", "str", "-", "ids from the root down to the part, with / between them"),
        ),
    ),
    "building_summary": (
        "building_id survey survey_date state probability storeys storeys_min storeys_max storeys_top z_ground "
        "z_ground_min z_ground_max eaves ridge z_eaves z_ridge vertical_crs coverage nodata_share density "
        "multiscale_share flat_share area3d_share adaptive_share h_max h_mean h_p50 h_p90 area_m2 volume_m3 "
        "floor_area_m2 trees parts scales speindex class_label divided_by outline_source xcen ycen xin yin",
        (BUILDING,),
        (replace(SURVEY["date"], name="survey_date"), SURVEY["vertical_crs"], _CLASS_LABEL),
    ),
    "part_evidence": (
        "part_id survey building_id root_id supid scale hindex area_m2 building_share flat_share flat_regions "
        "area3d_share area3d_regions adaptive_share adaptive_regions",
        (PART,),
        _BY_DETECTOR,
    ),
    "unexplained_flat_region": (
        "region_id survey zone lambda_low_m2 lambda_m2 gradient_sum mean_gradient area_m2 perimeter_m compactness "
        "h_max h_mean h_p50 h_p90 h_std xcen ycen explained_share",
        (FLAT_REGION,),
        (_EXPLAINED,),
    ),
    "candidate_evidence": (
        "candidate_id survey method rule height_scale_m points area_m2 rectangularity compactness linearity ndvi h_p50 "
        "h_p90 h_std xcen ycen explained_share flat_share",
        (CANDIDATE_REGION,),
        (
            _EXPLAINED,
            _share("flat_share", "share of the region that flat regions cover; null when they were not looked for"),
        ),
    ),
    "unexplained_candidate": (
        "candidate_id survey method rule height_scale_m points area_m2 rectangularity compactness linearity ndvi h_max "
        "h_mean h_p50 h_p90 h_std xcen ycen explained_share",
        (CANDIDATE_REGION,),
        (_EXPLAINED,),
    ),
    "building_evidence": (
        "building_id survey state probability storeys h_p90 area_m2 building_share multiscale_share flat_share "
        "area3d_share adaptive_share classes_for extractors_heard extractors_for",
        (BUILDING,),
        (
            _count("classes_for", "1 where the classes of land cover confirm it, else 0"),
            _count("extractors_heard", "number of the other detectors that were run"),
            _count("extractors_for", "number of these that confirm it"),
        ),
    ),
    "footprint_current": (
        _CURRENT,
        (BUILDING_VERSION, OPERATOR_STATE),
        (
            replace(
                BUILDING_VERSION["state"], doc="confirmed, unsure or refuted: the operator's decision, else found_state"
            ),
            replace(BUILDING_VERSION["state"], name="found_state", doc="the state that the detectors found"),
            replace(
                OPERATOR_STATE["operator"], doc="who decided the state; null where the detectors did", nullable=True
            ),
            replace(
                BUILDING_VERSION["attributes"],
                doc="attributes from an imported inventory, by the names of its columns; an empty object for none",
            ),
            replace(OPERATOR_STATE["note"], doc="the operator's reason; may be empty", nullable=True),
        ),
    ),
    "part_current": (
        "part_id survey building_id supid supscale root_id scale hindex hzone speindex xo yo xcen ycen xin yin area_px "
        "area_m2 stddis h_max h_mean h_p50 h_p90 h_std building_share outline_source",
        (PART,),
        (replace(PART["building_id"], doc="the building in footprint_current on which it stands"),),
    ),
    "building_piece": (
        "version_id building_id",
        (BUILDING_VERSION,),
        (replace(BUILDING_VERSION["building_id"], doc="the building of a run, which a rebuild may replace"),),
    ),
    "building_history": (
        "version_id uid valid_from valid_to source survey began_as ended_in ended_as state probability storeys eaves "
        "ridge z_ground h_max h_p90 area_m2 volume_m3",
        (BUILDING_VERSION,),
        (
            Column("began_as", "str", "-", "kind of the change by which it began: new, modified, …; or imported"),
            Column(
                "ended_in", "str", "-", "name of the survey that ended it; null for the current version", nullable=True
            ),
            Column("ended_as", "str", "-", "kind of the change by which it ended: demolished, …", nullable=True),
        ),
    ),
    "roof_material_by_class": (
        "survey material speindex class_label samples",
        (ROOF_SAMPLE, PART),
        (_CLASS_LABEL, _count("samples", "number of samples")),
    ),
}
"""Of each view: its columns in order without the geometry, the tables that they are taken from, and its own columns."""


def _columns(names: str, tables: tuple[Table, ...], own: tuple[Column, ...]) -> tuple[Column, ...]:
    """Return columns by name: a view's own ones, or those of the first table that has them."""
    known = {column.name: column for table in reversed(tables) for column in table.stored}
    known |= {"survey": SURVEY_NAME} | {column.name: column for column in own}
    return tuple(replace(known[name], primary=False, refers="", zero_of="", cascade=False) for name in names.split())


VIEW_COLUMNS: Mapping[str, tuple[Column, ...]] = {name: _columns(*shown) for name, shown in _SHOWN.items()}
"""The columns of each view in order, without the geometry."""


def computed_columns(view: str) -> frozenset[str]:
    """Return the numbers that a view computes: SQLite gives clients no type for them. A table has none.

    Examples
    --------
    >>> sorted(computed_columns("candidate_evidence")), sorted(computed_columns("footprint"))
    (['explained_share', 'flat_share'], [])
    """
    _, _, own = _SHOWN.get(view, ("", (), ()))
    return frozenset(column.name for column in own if column.dtype in ("float64", "Int64"))
