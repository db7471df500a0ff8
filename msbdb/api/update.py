"""Update the inventory by a survey."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from msbdb.api.build import build
from msbdb.run.reports import AdvanceReport, UpdateReport
from msbdb.run.stages import Progress, Stages


def update(
    points: Sequence[Path] = (),
    *,
    db: str | Path,
    survey: str,
    date: str,
    aoi: Path | None = None,
    progress: Progress | None = None,
    **options: Any,  # noqa: ANN401  (those of build)
) -> UpdateReport:
    """Build a survey and update the inventory by it.

    Parameters
    ----------
    points : sequence of path
        LAS, LAZ or COPC files; or give rasters among the options.
    db : str or path
        A SpatiaLite file, made when it is missing, or a ``postgresql+psycopg://`` URL.
    survey, date : str
        Name of the survey, and when the data were taken, ISO 8601.
    aoi : path, optional
        Polygons in any vector format: only buildings in them are compared.
    progress : callable, optional
        Called with stage, steps done and steps in all.
    **options
        All that `msbdb.api.build` takes.

    Returns
    -------
    UpdateReport

    Raises
    ------
    MsbdbError
        One of its kinds. A build that was written stays; repeating the update completes it.

    Notes
    -----
    A survey that was built from the same files with the same values by the same msbdb is not built again.
    """
    from msbdb.run.update import is_built, require_date

    require_date(survey, date)
    stages = Stages(progress)
    built = None
    if not is_built(points, db=db, survey=survey, date=date, **options):
        built = build(points, db=db, survey=survey, date=date, progress=progress, **options)
    with stages.stage("inventory"):
        return UpdateReport(built, advance(db, survey, aoi=aoi))


def advance(db: str | Path, survey: str, *, aoi: Path | None = None) -> AdvanceReport:
    """Update the inventory by a survey that is built already, in one transaction.

    Parameters
    ----------
    db : str or path
        The database.
    survey : str
        Name of the survey, which must have a date.
    aoi : path, optional
        Polygons: only buildings in them are compared.

    Returns
    -------
    AdvanceReport

    Raises
    ------
    InputError
        When the survey does not exist or has no date, or a later one was applied to the same place already.
    DatabaseError
        When the database cannot be written, or others keep changing the same place.

    Notes
    -----
    The last survey of a place may be applied again: its changes are taken back and computed again. The same content
    leaves the inventory unchanged. The comparison is computed before the transaction. The transaction first checks that
    its basis is unchanged; if not, the comparison is computed again, at most `ATTEMPTS` times.
    """
    from msbdb.run.update import advance_inventory

    return advance_inventory(db, survey, aoi=aoi)
