"""The composition of the stages: building a database, and what is done with one that is there."""

from msbdb.pipeline.build import BuildReport, build
from msbdb.pipeline.bypoint import evaluate_points
from msbdb.pipeline.changes import Changes, changes, summary
from msbdb.pipeline.classify import ClassifyReport, classify
from msbdb.pipeline.imports import ImportReport, import_inventory, import_roof_samples, set_state
from msbdb.pipeline.inventory import Inventory, open
from msbdb.pipeline.reports import classes, evaluate, export, info, relabel, view
from msbdb.pipeline.update import AdvanceReport, UpdateReport, advance, update

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
