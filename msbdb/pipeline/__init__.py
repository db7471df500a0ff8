"""The composition of the stages: building a database, and what is done with one that is there."""

from msbdb.pipeline.build import BuildReport, build
from msbdb.pipeline.bypoint import evaluate_points
from msbdb.pipeline.classify import ClassifyReport, classify
from msbdb.pipeline.inventory import Inventory, open
from msbdb.pipeline.reports import classes, evaluate, export, info, relabel, view

__all__ = [
    "BuildReport",
    "ClassifyReport",
    "Inventory",
    "build",
    "classes",
    "classify",
    "evaluate",
    "evaluate_points",
    "export",
    "info",
    "open",
    "relabel",
    "view",
]
