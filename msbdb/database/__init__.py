"""The database: one set of functions creates, upgrades, loads and reads SpatiaLite files and PostGIS.

Modules import pandas, geopandas, Alembic and drivers inside their functions, so that opening a database is quick.
"""

from sqlalchemy import Engine

from msbdb.database.admin.copying import canonical_dump, copy_database
from msbdb.database.admin.findings import Finding
from msbdb.database.admin.lifecycle import Loss, create_database, downgrade_schema, upgrade_schema
from msbdb.database.admin.soundness import CHECKS, check_database
from msbdb.database.dialects.connection import (
    PATIENCE_S,
    ClientPlace,
    check_target,
    client_place,
    crs_words_of,
    database_crs_of,
    open_database,
    opened,
    read_fallback,
)
from msbdb.database.dialects.dialect import shown
from msbdb.database.dialects.rights import ROLES, grant_role
from msbdb.database.examples import ExampleQuery, example_queries, find_example, run_example
from msbdb.database.features import (
    LAYERS,
    FeatureLayer,
    FeatureQuery,
    Rows,
    ServedState,
    open_to_read,
    read_feature,
    read_page,
    read_state,
)
from msbdb.database.history.days import LAST_DAY, first_day, require_past
from msbdb.database.history.entries import write_import, write_samples, write_state
from msbdb.database.history.joins import Seams, current_pieces, read_pieces
from msbdb.database.history.periods import (
    footprint_at,
    has_inventory,
    read_changes,
    read_events_near,
    read_history,
    read_states,
    summarise_inventory,
)
from msbdb.database.history.shownlayers import ShownLayers, read_shown
from msbdb.database.history.standing import Standing, read_standing, survey_key
from msbdb.database.history.versions import Advance, identities, write_advance
from msbdb.database.runs.basis import (
    BuildBasis,
    Former,
    OutdatedError,
    read_digest,
    read_former,
    read_labelled_classes,
)
from msbdb.database.runs.merging import LINKS, METHODS, ROWS, MergeReport, Piece, merge_tiles
from msbdb.database.runs.mosaics import read_value_counts
from msbdb.database.runs.places import DetectorAnswer, Place, explain_places
from msbdb.database.runs.reading import (
    RunSummary,
    crs_of,
    list_runs,
    read_build,
    read_buildings,
    read_candidates,
    read_classes,
    read_columns,
    read_flat_regions,
    read_parts,
    read_plan,
    read_rasters,
    read_rejection_counts,
    read_rejections,
    read_run,
    read_scales,
    read_survey,
    read_tables,
    run_heads,
    summarise_run,
)
from msbdb.database.runs.tiles import (
    TileStatus,
    begin_tiles,
    note_result,
    note_tile,
    read_result,
    read_tile_status,
    tiles_with_results,
)
from msbdb.database.runs.writing import WriteReport, store_build, write_build
from msbdb.database.schema.srid import srid_of

__all__ = [
    "CHECKS",
    "LAST_DAY",
    "LAYERS",
    "LINKS",
    "METHODS",
    "PATIENCE_S",
    "ROLES",
    "ROWS",
    "Advance",
    "BuildBasis",
    "ClientPlace",
    "DetectorAnswer",
    "Engine",
    "ExampleQuery",
    "FeatureLayer",
    "FeatureQuery",
    "Finding",
    "Former",
    "Loss",
    "MergeReport",
    "OutdatedError",
    "Piece",
    "Place",
    "Rows",
    "RunSummary",
    "Seams",
    "ServedState",
    "ShownLayers",
    "Standing",
    "TileStatus",
    "WriteReport",
    "begin_tiles",
    "canonical_dump",
    "check_database",
    "check_target",
    "client_place",
    "copy_database",
    "create_database",
    "crs_of",
    "crs_words_of",
    "current_pieces",
    "database_crs_of",
    "downgrade_schema",
    "example_queries",
    "explain_places",
    "find_example",
    "first_day",
    "footprint_at",
    "grant_role",
    "has_inventory",
    "identities",
    "list_runs",
    "merge_tiles",
    "note_result",
    "note_tile",
    "open_database",
    "open_to_read",
    "opened",
    "read_build",
    "read_buildings",
    "read_candidates",
    "read_changes",
    "read_classes",
    "read_columns",
    "read_digest",
    "read_events_near",
    "read_fallback",
    "read_feature",
    "read_flat_regions",
    "read_former",
    "read_history",
    "read_labelled_classes",
    "read_page",
    "read_parts",
    "read_pieces",
    "read_plan",
    "read_rasters",
    "read_rejection_counts",
    "read_rejections",
    "read_result",
    "read_run",
    "read_scales",
    "read_shown",
    "read_standing",
    "read_state",
    "read_states",
    "read_survey",
    "read_tables",
    "read_tile_status",
    "read_value_counts",
    "require_past",
    "run_example",
    "run_heads",
    "shown",
    "srid_of",
    "store_build",
    "summarise_inventory",
    "summarise_run",
    "survey_key",
    "tiles_with_results",
    "upgrade_schema",
    "write_advance",
    "write_build",
    "write_import",
    "write_samples",
    "write_state",
]
