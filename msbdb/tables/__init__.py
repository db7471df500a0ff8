"""The tables of the database, each column declared once, and the records that belong to them."""

from msbdb.tables.building_tables import (
    BUILDING,
    CONFIRMING_CLASS_SHARE,
    CONFIRMING_COVER,
    DETECTOR_SHARES,
    EXTRACTOR_SHARES,
    HEIGHTS,
    PART,
    validate_parts,
)
from msbdb.tables.declaration import Check, Column, Index, KeyReference, Table, Unique, validate
from msbdb.tables.inventory_tables import (
    BUILDING_CHANGE,
    BUILDING_VERSION,
    INVENTORY_BUILDING,
    INVENTORY_EVENT,
    INVENTORY_TABLES,
    OPERATOR_STATE,
    ROOF_SAMPLE,
    ROW_DIGEST,
    SURVEY_OFFSET,
)
from msbdb.tables.reasons import REASONS, Reason
from msbdb.tables.records import Counts, Run, Source, Survey
from msbdb.tables.region_tables import (
    CANDIDATE_REGION,
    FLAT_REGION,
    FLAT_REGION_CANDIDATE,
    PART_CANDIDATE,
    PART_FLAT_REGION,
)
from msbdb.tables.run_tables import (
    CLASS_LABELS,
    REJECTION,
    REJECTION_COUNT,
    RUN,
    RUN_METHOD,
    RUN_STATE,
    SCALE,
    SOURCE,
    SPECTRAL_CLASS,
    SPECTRAL_CLASS_BAND,
    SURVEY,
)

TABLES = (
    SCALE,
    PART,
    SPECTRAL_CLASS,
    SPECTRAL_CLASS_BAND,
    REJECTION,
    REJECTION_COUNT,
    BUILDING,
    FLAT_REGION,
    PART_FLAT_REGION,
    CANDIDATE_REGION,
    PART_CANDIDATE,
    FLAT_REGION_CANDIDATE,
)
"""The tables of a build's frames."""

RUN_TABLES = (
    SURVEY,
    SOURCE,
    RUN,
    RUN_METHOD,
    RUN_STATE,
    SCALE,
    SPECTRAL_CLASS,
    SPECTRAL_CLASS_BAND,
    PART,
    BUILDING,
    REJECTION,
    REJECTION_COUNT,
    FLAT_REGION,
    PART_FLAT_REGION,
    CANDIDATE_REGION,
    PART_CANDIDATE,
    FLAT_REGION_CANDIDATE,
)
"""All tables of surveys and runs."""

DATABASE_TABLES = (*RUN_TABLES, *INVENTORY_TABLES)
"""All tables of the database."""

__all__ = [
    "BUILDING",
    "BUILDING_CHANGE",
    "BUILDING_VERSION",
    "CANDIDATE_REGION",
    "CLASS_LABELS",
    "CONFIRMING_CLASS_SHARE",
    "CONFIRMING_COVER",
    "DATABASE_TABLES",
    "DETECTOR_SHARES",
    "EXTRACTOR_SHARES",
    "FLAT_REGION",
    "FLAT_REGION_CANDIDATE",
    "HEIGHTS",
    "INVENTORY_BUILDING",
    "INVENTORY_EVENT",
    "INVENTORY_TABLES",
    "OPERATOR_STATE",
    "PART",
    "PART_CANDIDATE",
    "PART_FLAT_REGION",
    "REASONS",
    "REJECTION",
    "REJECTION_COUNT",
    "ROOF_SAMPLE",
    "ROW_DIGEST",
    "RUN",
    "RUN_METHOD",
    "RUN_STATE",
    "RUN_TABLES",
    "SCALE",
    "SOURCE",
    "SPECTRAL_CLASS",
    "SPECTRAL_CLASS_BAND",
    "SURVEY",
    "SURVEY_OFFSET",
    "TABLES",
    "Check",
    "Column",
    "Counts",
    "Index",
    "KeyReference",
    "Reason",
    "Run",
    "Source",
    "Survey",
    "Table",
    "Unique",
    "validate",
    "validate_parts",
]
