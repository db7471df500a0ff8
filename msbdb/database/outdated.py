"""What was computed outside of a writer's transaction must still fit the database when the transaction begins."""

from dataclasses import dataclass

import pandas as pd
from sqlalchemy import Connection, Engine, select

from msbdb.database.canonical import text_id
from msbdb.database.engine import guarded
from msbdb.database.labels import labelled_classes
from msbdb.database.sqltables import SQL

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
