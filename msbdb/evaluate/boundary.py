"""Distances between matched outlines."""

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import shapely
from numpy.typing import NDArray

from msbdb.evaluate.metrics import Averages, ratio
from msbdb.grid import GridSpec
from msbdb.labels import sizes, sums
from msbdb.vector.polygons import Geometries

Ints = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class BoundaryScore:
    """Distances between the outlines of matched buildings.

    Attributes
    ----------
    samples : int
        Samples on both outlines that lie in scored cells.
    left_out : float
        Share of them that is farther than the cap from the other outline.
    rms_m : Averages
        RMS of the distances of the others: of all samples (micro), and the mean of the buildings' (macro).
    """

    samples: int
    left_out: float
    rms_m: Averages


def score_boundary(
    extracted: Geometries,
    reference: Geometries,
    scored: NDArray[np.bool_],
    spec: GridSpec,
    *,
    step_m: float,
    cap_m: float,
) -> BoundaryScore:
    """Measure the distance of samples on each outline to the nearest point of the other outline.

    Parameters
    ----------
    extracted, reference : (G,) ndarray of polygonal geometries
        Outlines of the matched buildings, with their holes.
    scored : (H, W) ndarray of bool
        Samples in other cells are left out, for there the outline may be the data's edge.
    spec : GridSpec
        The lattice of ``scored``.
    step_m : float
        Largest distance between two samples; they are spread evenly on each ring.
    cap_m : float
        Samples farther than this from the other outline are no counterpart of it (a part that is missing or added,
        which the areas tell) and do not enter the RMS.
    """
    lines_e, lines_r = shapely.boundary(extracted), shapely.boundary(reference)
    distance, group = (
        np.concatenate(both)
        for both in zip(
            _distances(lines_e, lines_r, scored, spec, step_m),
            _distances(lines_r, lines_e, scored, spec, step_m),
            strict=True,
        )
    )
    near = distance <= cap_m
    used = sizes(group[near] + 1, len(extracted))
    squares = sums(group[near] + 1, distance[near] ** 2, len(extracted))
    if not near.any():
        return BoundaryScore(len(distance), ratio(len(distance), len(distance)), Averages(math.nan, math.nan))
    micro = math.sqrt(float(squares.sum()) / int(used.sum()))
    macro = float(np.mean(np.sqrt(squares[used > 0] / used[used > 0])))
    return BoundaryScore(len(distance), 1 - float(near.mean()), Averages(micro, macro))


def united(outlines: Geometries, group: Ints, count: int) -> Geometries:
    """Return the union of the outlines of each group; those of group -1 are left out."""
    order = np.argsort(group, kind="stable")
    first = np.searchsorted(group[order], np.arange(count + 1))
    members = (outlines[order[start:stop]] for start, stop in pairwise(first))
    unions = np.empty(count, dtype=np.object_)
    unions[:] = [part[0] if len(part) == 1 else shapely.union_all(part) for part in members]
    return unions


def _distances(
    lines: Geometries, others: Geometries, scored: NDArray[np.bool_], spec: GridSpec, step_m: float
) -> tuple[NDArray[np.float64], Ints]:
    """Return the distance of each scored sample on the lines to the other line of its group, and the group."""
    rings, group = shapely.get_parts(lines, return_index=True)
    length = shapely.length(rings)
    number = np.maximum(np.ceil(length / step_m), 1).astype(np.int64)
    ring = np.repeat(np.arange(len(rings)), number)
    along = np.arange(len(ring)) - np.repeat(np.cumsum(number) - number, number)
    points = shapely.line_interpolate_point(rings[ring], (along + 0.5) * (length / number)[ring])
    counted = spec.sample(scored, shapely.get_x(points), shapely.get_y(points), outside=False)
    kept = group[ring[counted]].astype(np.int64)
    return np.asarray(shapely.distance(points[counted], others[kept]), dtype=np.float64), kept
