"""Agreement of detected buildings with a reference: one set of measures for all papers (X1)."""

from msbdb.evaluate.agreement import PointEvaluation, PointScores, match_points, score_points
from msbdb.evaluate.evaluation import Evaluation, evaluate
from msbdb.evaluate.reference import PointReference, PolygonReference, Reference
from msbdb.params import EvaluateParams

__all__ = [
    "EvaluateParams",
    "Evaluation",
    "PointEvaluation",
    "PointReference",
    "PointScores",
    "PolygonReference",
    "Reference",
    "evaluate",
    "match_points",
    "score_points",
]
