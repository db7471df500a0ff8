"""The basis of a build: operators' labels of classes, and the digest of the earlier run.

A build is computed before the transaction that writes it. The basis must be unchanged when that transaction begins.
"""

from dataclasses import dataclass
from os import PathLike
from typing import TYPE_CHECKING

from sqlalchemy import URL, Connection, Engine, select

from msbdb.database.dialects.connection import TIMEOUT_S, database_url, guarded
from msbdb.database.dialects.dialect import dialect_of
from msbdb.database.schema.canonical import text_id
from msbdb.database.schema.sqltables import SQL

if TYPE_CHECKING:
    import pandas as pd

RUN = SQL["run"]

SPECTRAL_CLASS = SQL["spectral_class"]

SURVEY = SQL["survey"]

COLUMNS = ("speindex", "label", "labelled_by", "source", "cells", "ndvi", "brightness", "roughness_m")
"""Columns that identify a class over several builds; every schema has them."""


def read_labelled_classes(target: str | PathLike[str] | URL, survey: str) -> "pd.DataFrame":
    """Return the classes of a survey that an operator has labelled, from a database of any schema.

    Parameters
    ----------
    target : str, path or URL
        The database, which may be missing.
    survey : str
        Name of the survey, which may be missing.

    Returns
    -------
    DataFrame
        ``COLUMNS``; empty if no operator has labelled a class.
    """
    import pandas as pd

    url = database_url(target)
    dialect = dialect_of(url)
    with guarded(url):
        if dialect.exists(url, TIMEOUT_S):
            with dialect.make_engine(url, TIMEOUT_S).connect() as connection:
                return labelled_classes(connection, survey)
    return pd.DataFrame([], columns=list(COLUMNS))


def labelled_classes(connection: Connection, survey: str) -> "pd.DataFrame":
    """Return what ``read_labelled_classes`` does, as an open transaction sees it."""
    import pandas as pd

    query = (
        select(*(SPECTRAL_CLASS.c[name] for name in COLUMNS))
        .join(RUN, RUN.c.run_id == SPECTRAL_CLASS.c.run_id)
        .join(SURVEY, SURVEY.c.survey_id == RUN.c.survey_id)
        .where(SURVEY.c.name == survey)
        .order_by(SPECTRAL_CLASS.c.speindex)
    )
    rows = [tuple(row) for row in connection.execute(query)]
    found = pd.DataFrame(rows, columns=list(COLUMNS))
    return found[found["labelled_by"] == "operator"].reset_index(drop=True)


class OutdatedError(Exception):
    """The basis of a computation has changed since it was read; compute it again."""


@dataclass(frozen=True, slots=True, eq=False)
class BuildBasis:
    """The content of the database from which a build was computed, so that no change of others is lost.

    ``labelled`` has the classes labelled by operators, from `read_labelled_classes`; ``content_sha256`` is the digest
    of the run that the build continues. None means that it is not checked.
    """

    labelled: "pd.DataFrame | None" = None
    content_sha256: str | None = None

    def require(self, connection: Connection, survey: str) -> None:
        """Raise `OutdatedError` when the basis has changed."""
        if self.labelled is not None:
            now = labelled_classes(connection, survey)
            # As text: a missing value is not equal to itself.
            if repr(now.to_numpy().tolist()) != repr(self.labelled.to_numpy().tolist()):
                raise OutdatedError
        if self.content_sha256 is not None and _digest_of(connection, survey) != self.content_sha256:
            raise OutdatedError


def read_digest(engine: Engine, survey: str) -> str | None:
    """Return the digest of the content of a survey's run, None without a run."""
    with guarded(engine.url), engine.connect() as connection:
        return _digest_of(connection, survey)


def _digest_of(connection: Connection, survey: str) -> str | None:
    """Return what `read_digest` does, as an open transaction sees it."""
    query = select(RUN.c.content_sha256).where(RUN.c.survey_id == text_id("survey", survey))
    return connection.scalar(query)
