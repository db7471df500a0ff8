"""The land-cover classes of a survey, and other labels for them."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from msbdb.run.reports import BuildReport
from msbdb.run.stages import Progress

if TYPE_CHECKING:
    import pandas as pd


def classes(db: str | Path, survey: str | None = None) -> "pd.DataFrame":
    """Return the land-cover classes of a survey with their statistics."""
    from msbdb.database import opened, read_classes

    with opened(db) as engine:
        return read_classes(engine, survey)


def relabel(
    db: str | Path, labels: Mapping[int, str], *, survey: str | None = None, progress: Progress | None = None
) -> BuildReport:
    """Give classes the operator's labels (V36), and repeat the build from there on.

    The source data are not needed: the heights and class maps of the run are in the database. Labels that others give
    to the same survey at the same time are kept.

    Raises
    ------
    InputError
        When a class, a label or the survey does not exist.
    DatabaseError
        When the database cannot be written, or the survey was built again meanwhile, so that its classes changed.
    """
    from msbdb.run.store import relabel_survey

    return relabel_survey(db, labels, survey=survey, progress=progress)
