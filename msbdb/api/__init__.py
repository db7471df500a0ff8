"""What users call: build, update, relabel, classify, evaluate, view, export, changes, imports, open.

The modules here declare the public functions. Libraries that take time to load are imported when they are used.
"""

from msbdb.api.build import build
from msbdb.api.changes import changes, summary
from msbdb.api.classify import classify
from msbdb.api.evaluate import evaluate, evaluate_points
from msbdb.api.imports import import_inventory, import_roof_samples, set_state
from msbdb.api.open import Inventory, open
from msbdb.api.outputs import export, info, view
from msbdb.api.relabel import classes, relabel
from msbdb.api.update import advance, update
from msbdb.run.reports import AdvanceReport, BuildReport, Changes, ClassifyReport, ImportReport, UpdateReport

__all__ = [
    "AdvanceReport",
    "BuildReport",
    "Changes",
    "ClassifyReport",
    "ImportReport",
    "Inventory",
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
    "open",
    "relabel",
    "set_state",
    "summary",
    "update",
    "view",
]
