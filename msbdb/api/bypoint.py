"""Evaluation by point: a classified file, or a database, against a file whose class 6 is the truth."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from msbdb.api.classify import points_in
from msbdb.api.reports import POINT_SUFFIXES, compared, opened
from msbdb.database import read_build
from msbdb.errors import CRSError, InputError
from msbdb.evaluate import PointEvaluation, match_points, score_points
from msbdb.evaluate.reference import horizontal
from msbdb.io.las import read_points_indexed
from msbdb.outline.polygons import rasterise
from msbdb.params import Params, with_values
from msbdb.points.cloud import BUILDING_CLASS, NOISE_CLASSES, PointCloud
from msbdb.run.kept import lattice_of, unpack_heights
from msbdb.surface import grid_surface

Mask = NDArray[np.bool_]


def evaluate_points(
    found: str | Path, reference: Path, *, crs: str | None = None, survey: str | None = None, of: str = "buildings"
) -> PointEvaluation:
    """Compare by point what was found with points whose class 6 is the truth (C20, C21).

    Parameters
    ----------
    found : str or path
        A LAS or LAZ file of the same points whose class 6 was found, or a database.
    reference : path
        A LAS or LAZ file. Its noise points (classes 7 and 18), and points of absurd coordinates, are not scored; with
        a database, neither are withheld and lone points, which no build reads.
    crs : str, optional
        CRS of files that state none.
    survey : str, optional
        Survey of the database; not needed where it holds one.
    of : str
        What of the database is compared, as for `msbdb.api.reports.evaluate`.

    Returns
    -------
    PointEvaluation

    Raises
    ------
    InputError
        When the reference is no point file, or the two files are not of the same points.
    CRSError
        When the CRS differ.

    Notes
    -----
    The database keeps heights above ground on the lattice, and no points. A point of the reference counts as found
    when its cell's centre lies in an outline, and it is at least as high as the run's mask above the terrain; the
    terrain is the surface of the reference's own first echoes less the height that the database has there.
    """
    reference = Path(reference)
    if reference.suffix.lower() not in POINT_SUFFIXES:
        msg = f"By point, the reference must be a LAS or LAZ file whose class 6 is the truth; got '{reference.name}'."
        raise InputError(msg)
    of_points = Path(found).suffix.lower() in POINT_SUFFIXES
    truth, _, _ = read_points_indexed(reference, crs=crs, noise=of_points)
    if not of_points:
        return PointEvaluation(
            "footprints", score_points(_taken(found, truth, survey, of), truth.in_class(BUILDING_CLASS))
        )
    predicted, _, _ = read_points_indexed(Path(found), crs=crs, noise=True)
    index, matched = match_points(predicted, truth)
    scored = ~truth.in_class(*NOISE_CLASSES)
    mine, theirs = predicted.in_class(BUILDING_CLASS)[index], truth.in_class(BUILDING_CLASS)
    return PointEvaluation(matched, score_points(mine[scored], theirs[scored]))


def _taken(db: str | Path, cloud: PointCloud, survey: str | None, of: str) -> Mask:
    """Return the points that lie in an outline of a database and are not below it."""
    with opened(db) as engine:
        outlines = compared(engine, survey, of)
        build = read_build(engine, survey)
    spec = lattice_of(build.survey, build.state)
    if horizontal(cloud.crs) != horizontal(spec.crs):
        msg = f"The reference points are in '{cloud.crs.name}', the database in '{spec.crs.name}'; reproject one."
        raise CRSError(msg)
    params = with_values(Params(), build.run.parameters)  # type: ignore[arg-type]  # plain nested values
    kept = unpack_heights(build.state, spec)
    surface, _ = grid_surface(cloud, spec, params)
    known = surface.valid & kept.valid
    above = np.asarray(kept.values, dtype=np.float64)
    terrain = np.where(known, np.asarray(surface.values, dtype=np.float64) - above, np.nan)
    ground_m = spec.sample(terrain, cloud.x, cloud.y, outside=np.nan)
    cells = rasterise(outlines.geometry, spec) > 0
    return points_in(cells, spec, cloud, cloud.z - ground_m, params.surface.mask_m)
