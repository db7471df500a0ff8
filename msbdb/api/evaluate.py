"""Compare what was found with a reference."""

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from msbdb.evaluate import Evaluation, PointEvaluation


def evaluate(
    db: str | Path,
    reference: Path,
    *,
    layer: str | None = None,
    aoi: Path | None = None,
    crs: str | None = None,
    height: str | None = None,
    overlap: float = 0.5,
    cell_m: float = 0.5,
    survey: str | None = None,
    of: str = "buildings",
) -> "Evaluation":
    """Compare what was found in a survey with a reference.

    Parameters
    ----------
    db : str or path
        The database.
    reference : path
        Footprints in any vector format, or LAS or LAZ points whose class 6 is the truth.
    layer : str, optional
        Layer of a vector reference.
    aoi : path, optional
        Polygons within which to compare.
    crs : str, optional
        The reference's CRS where it states none.
    height : str, optional
        Column of the reference that holds heights above ground, metres; one called ``height`` (in any case) is found.
    overlap, cell_m : float
        Share that counts as found; cell of the grid on which areas are compared, metres.
    survey : str, optional
        Not needed where the database holds one.
    of : {'buildings', 'confirmed', 'parts', 'flatregions', 'area3d', 'adaptive'}
        What is compared: all buildings, the confirmed ones, the parts of all scales, the flat regions, or the
        candidate regions of a detector on points.
    """
    from msbdb.run.evaluate import evaluate_survey

    return evaluate_survey(
        db,
        Path(reference),
        layer=layer,
        aoi=aoi,
        crs=crs,
        height=height,
        overlap=overlap,
        cell_m=cell_m,
        survey=survey,
        of=of,
    )


def evaluate_points(
    found: str | Path, reference: Path, *, crs: str | None = None, survey: str | None = None, of: str = "buildings"
) -> "PointEvaluation":
    """Compare by point what was found with points whose class 6 is the truth (C20, C21).

    Parameters
    ----------
    found : str or path
        A LAS or LAZ file of the same points whose class 6 was found, or a database.
    reference : path
        A LAS or LAZ file. Its noise points (classes 7 and 18) and points with absurd coordinates are not scored. With a
        database, withheld and lone points are not scored either, because no build reads them.
    crs : str, optional
        CRS of files that state none.
    survey : str, optional
        Survey of the database; not needed where it holds one.
    of : str
        What of the database is compared, as for `msbdb.api.evaluate`.

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
    when its cell's centre lies in an outline and it is high enough above the terrain, by the run's mask. The terrain
    is the surface of the reference's own first echoes, minus the height that the database has there.
    """
    from msbdb.run.evaluate import evaluate_file

    return evaluate_file(found, Path(reference), crs=crs, survey=survey, of=of)
