"""The operators' labels of classes, read before a survey is built again, from a database of any schema.

What was computed outside of a writer's transaction must still fit the database when the transaction begins.
"""

from dataclasses import dataclass
from os import PathLike

import pandas as pd
from sqlalchemy import URL, Connection, Engine, select, text

from msbdb.database.dialects.connection import TIMEOUT_S, database_url, guarded
from msbdb.database.dialects.dialect import dialect_of
from msbdb.database.schema.canonical import text_id
from msbdb.database.schema.sqltables import SQL

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


RUN = SQL["run"]


class OutdatedError(Exception):
    """What was to be written was computed from something that has changed since; it is to be computed again."""


@dataclass(frozen=True, slots=True, eq=False)
class BuildBasis:
    """What a build was computed from in the database, so that nothing that was written meanwhile is lost.

    ``labelled`` has the classes that operators had labelled, from `read_labelled_classes`; ``content_sha256`` is the
    digest of the run that it goes on from. None stands for what is of no matter.
    """

    labelled: pd.DataFrame | None = None
    content_sha256: str | None = None

    def require(self, connection: Connection, survey: str) -> None:
        """Raise `OutdatedError` when it is no longer so."""
        if self.labelled is not None:
            now = labelled_classes(connection, survey)
            # As words: a missing value is not equal to itself.
            if repr(now.to_numpy().tolist()) != repr(self.labelled.to_numpy().tolist()):
                raise OutdatedError
        if self.content_sha256 is not None and _digest_of(connection, survey) != self.content_sha256:
            raise OutdatedError


def read_digest(engine: Engine, survey: str) -> str | None:
    """Return the digest of the content of a survey's run, None where it has none."""
    with guarded(engine.url), engine.connect() as connection:
        return _digest_of(connection, survey)


def _digest_of(connection: Connection, survey: str) -> str | None:
    """Return what `read_digest` does, as an open transaction sees it."""
    query = select(RUN.c.content_sha256).where(RUN.c.survey_id == text_id("survey", survey))
    return connection.scalar(query)
