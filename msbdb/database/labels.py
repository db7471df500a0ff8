"""The operators' labels of classes, read before a survey is built again, from a database of any schema."""

from os import PathLike

import pandas as pd
from sqlalchemy import URL, Connection, text

from msbdb.database.dialect import dialect_of
from msbdb.database.engine import TIMEOUT_S, database_url, guarded

COLUMNS = ("speindex", "label", "labelled_by", "source", "cells", "ndvi", "brightness", "roughness_m")
"""What tells a class, and whether it is the same one again; every schema has these."""

_CLASSES = text(
    f"SELECT {', '.join('c.' + name for name in COLUMNS)} FROM spectral_class AS c "  # noqa: S608  (our own names)
    "JOIN run AS r ON r.run_id = c.run_id JOIN survey AS s ON s.survey_id = r.survey_id "
    "WHERE s.name = :survey ORDER BY c.speindex"
)


def read_labelled_classes(target: str | PathLike[str] | URL, survey: str) -> pd.DataFrame:
    """Return the classes of a survey that an operator has labelled.

    Parameters
    ----------
    target : str, path or URL
        The database; there need not be one.
    survey : str
        Name of the survey, which need not be there.

    Returns
    -------
    DataFrame
        ``COLUMNS``; no row where no operator has labelled a class.
    """
    url = database_url(target)
    dialect = dialect_of(url)
    with guarded(url):
        if dialect.exists(url, TIMEOUT_S):
            with dialect.make_engine(url, TIMEOUT_S).connect() as connection:
                return labelled_classes(connection, survey)
    return pd.DataFrame([], columns=list(COLUMNS))


def labelled_classes(connection: Connection, survey: str) -> pd.DataFrame:
    """Return what ``read_labelled_classes`` does, as an open transaction sees it."""
    rows = [tuple(row) for row in connection.execute(_CLASSES, {"survey": survey})]
    found = pd.DataFrame(rows, columns=list(COLUMNS))
    return found[found["labelled_by"] == "operator"].reset_index(drop=True)
