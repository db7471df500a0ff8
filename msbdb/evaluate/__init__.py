"""How well extracted buildings agree with a reference: the one metric module (X1)."""

from msbdb.evaluate.reference import PointReference, PolygonReference, Reference
from msbdb.evaluate.report import Evaluation, evaluate
from msbdb.evaluate.settings import EvaluateParams

__all__ = ["EvaluateParams", "Evaluation", "PointReference", "PolygonReference", "Reference", "evaluate"]
