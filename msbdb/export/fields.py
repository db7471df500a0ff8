"""The columns of exported layers by their declarations, and their short names for Shapefiles."""

from collections.abc import Mapping
from dataclasses import replace

from msbdb.tables import (
    BUILDING,
    BUILDING_CHANGE,
    BUILDING_VERSION,
    CANDIDATE_REGION,
    FLAT_REGION,
    INVENTORY_EVENT,
    PART,
    REJECTION,
    Column,
)
from msbdb.tables.view_columns import SURVEY_NAME, VIEW_COLUMNS

STATES = ("state", "probability", "storeys", "h_max", "h_p90", "area_m2", "volume_m3", "attributes")
"""Columns of a version that a change has twice, before and after."""

_TIMES = Column("times", "int64", "count", "number of surveys in which the building changed")

_CHANGE = (
    *BUILDING_CHANGE.stored,
    INVENTORY_EVENT["date"],
    _TIMES,
    *(replace(BUILDING_VERSION[name], name=f"{name}_{side}", doc=f"{BUILDING_VERSION[name].doc}, {side} the change")
      for name in STATES for side in ("before", "after")),
)  # fmt: skip

FIELDS: Mapping[str, Mapping[str, Column]] = {
    layer: {column.name: column for column in (SURVEY_NAME, *columns)}
    for layer, columns in {
        "footprint": (*BUILDING.stored, *VIEW_COLUMNS["footprint_current"]),
        "part": PART.stored,
        "flat_region": FLAT_REGION.stored,
        "candidate_region": CANDIDATE_REGION.stored,
        "rejection": REJECTION.stored,
        "change": _CHANGE,
        **{name: VIEW_COLUMNS[name] for name in ("building_evidence", "part_evidence", "candidate_evidence")},
    }.items()
}
"""Of each layer, the declarations of its columns by name, those of surveys and of the inventory."""

PAPER = {
    "part_id": "ID",
    "supid": "SUPID",
    "supscale": "SUPSCALE",
    "scale": "SCALE",
    "hindex": "H",
    "xo": "XO",
    "yo": "YO",
    "xcen": "XCEN",
    "ycen": "YCEN",
    "area_m2": "AREA",
    "speindex": "SPE",
    "stddis": "STDDIS",
}
"""The paper's name of each column of a part that it has (V26); none is longer than the 10 characters of a DBF."""

SHORT = PAPER | {
    "adaptive_regions": "ADAPT_N",
    "adaptive_share": "ADAPT_SH",
    "area3d_regions": "AREA3D_N",
    "area3d_share": "AREA3D_SH",
    "area_m2_after": "AREA_AFT",
    "area_m2_before": "AREA_BEF",
    "area_px": "CELLS",
    "attributes": "ATTRIBUTES",
    "attributes_after": "ATTR_AFT",
    "attributes_before": "ATTR_BEF",
    "building_id": "BLDG_ID",
    "building_share": "BLDG_SHARE",
    "candidate_id": "CAND_ID",
    "classes_for": "CLASS_FOR",
    "compactness": "COMPACT",
    "darea_m2": "DAREA",
    "dh_m": "DH",
    "direction_1": "DIR_1",
    "direction_2": "DIR_2",
    "eaves": "EAVES_M",
    "explained_share": "PARTS_SH",
    "extractors_for": "EXTR_FOR",
    "extractors_heard": "EXTR_RUN",
    "flat_regions": "FLAT_N",
    "flat_share": "FLAT_SH",
    "floor_area_m2": "FLOOR_AREA",
    "found_state": "FOUND",
    "gradient_sum": "GRAD_SUM",
    "h_max": "HMAX_M",
    "h_max_after": "HMAX_AFT",
    "h_max_before": "HMAX_BEF",
    "h_mean": "HMEAN_M",
    "h_p50": "HP50_M",
    "h_p90": "HP90_M",
    "h_p90_after": "HP90_AFT",
    "h_p90_before": "HP90_BEF",
    "h_std": "HSTD_M",
    "height_scale_m": "H_SCALE",
    "lambda_low_m2": "LAMBDA_LOW",
    "lambda_m2": "LAMBDA",
    "linearity": "LINEAR",
    "mbr_m2": "MBR",
    "mean_gradient": "MEAN_GRAD",
    "multiscale_share": "MULTI_SH",
    "nodata_share": "NODATA_SH",
    "outline_source": "OUTL_BY",
    "overlap_m2": "OVERLAP",
    "perimeter_m": "PERIM_M",
    "perimeter": "EDGE_N",
    "probability": "PROB",
    "probability_after": "PROB_AFT",
    "probability_before": "PROB_BEF",
    "rectangularity": "RECTANG",
    "ridge": "RIDGE_M",
    "state_after": "STATE_AFT",
    "state_before": "STATE_BEF",
    "storeys_after": "STOR_AFT",
    "storeys_before": "STOR_BEF",
    "storeys_max": "STOR_MAX",
    "storeys_min": "STOR_MIN",
    "storeys_top": "STOR_TOP",
    "version_after": "VERS_AFT",
    "version_before": "VERS_BEF",
    "volume_m3": "VOLUME",
    "volume_m3_after": "VOL_AFT",
    "volume_m3_before": "VOL_BEF",
    "z_ground_max": "ZGROUND_MX",
    "z_ground_min": "ZGROUND_MN",
}
"""The name of a column in a DBF, at most 10 characters; other columns have their own name in upper case."""


def short_name(column: str) -> str:
    """Return the name of a column in a DBF.

    Examples
    --------
    >>> short_name("part_id"), short_name("h_max"), short_name("z_eaves")
    ('ID', 'HMAX_M', 'Z_EAVES')
    """
    return SHORT.get(column, column.upper())
