"""What users call: build, plan, tiles, update, measure, classify, evaluate, view, serve, export, open, query, why.

The modules here declare the public functions. Libraries that take time to load are imported when they are used.
"""

from msbdb.api.build import build, classes, classify, plan, read_plan, relabel, tiles
from msbdb.api.inventory import (
    advance,
    changes,
    import_inventory,
    import_roof_samples,
    measure,
    set_state,
    summary,
    update,
)
from msbdb.api.opened import Inventory, open
from msbdb.api.outputs import evaluate, evaluate_points, export, info, qgis, queries, query, serve, view, why
from msbdb.run.reports import (
    AdvanceReport,
    BuildReport,
    Changes,
    ClassifyReport,
    ImportReport,
    MeasureReport,
    UpdateReport,
)

__all__ = [
    "AdvanceReport",
    "BuildReport",
    "Changes",
    "ClassifyReport",
    "ImportReport",
    "Inventory",
    "MeasureReport",
    "UpdateReport",
    "advance",
    "build",
    "changes",
    "classes",
    "classify",
    "evaluate",
    "evaluate_points",
    "export",
    "import_inventory",
    "import_roof_samples",
    "info",
    "measure",
    "open",
    "plan",
    "qgis",
    "queries",
    "query",
    "read_plan",
    "relabel",
    "serve",
    "set_state",
    "summary",
    "tiles",
    "update",
    "view",
    "why",
]
