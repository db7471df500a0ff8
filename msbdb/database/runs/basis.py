"""The basis of a build: what the database has of its survey before, so that nothing is lost by replacing it.

A build is computed before the transaction that writes it. What would be lost is checked twice: before the work, and
when that transaction begins.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from os import PathLike
from typing import TYPE_CHECKING, Any

from sqlalchemy import URL, Connection, Engine, func, select

from msbdb.database.dialects.connection import connected
from msbdb.database.dialects.dialect import guarded, shown
from msbdb.database.schema.sqltables import SQL
from msbdb.errors import InputError
from msbdb.identity import text_id, to_json
from msbdb.kept import KeptRun
from msbdb.tables import Run, Source, Survey

if TYPE_CHECKING:
    import pandas as pd

CANDIDATE_REGION = SQL["candidate_region"]

FLAT_REGION = SQL["flat_region"]

PART = SQL["part"]

RUN_METHOD = SQL["run_method"]

SOURCE = SQL["source"]

RUN = SQL["run"]

SPECTRAL_CLASS = SQL["spectral_class"]

SURVEY = SQL["survey"]

COLUMNS = ("speindex", "label", "labelled_by", "source", "cells", "ndvi", "brightness", "roughness_m")
"""Columns that identify a class over several builds; every schema has them."""

MOST = 5
"""Names that a sentence lists."""


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

    with connected(target) as connection:
        return pd.DataFrame([], columns=list(COLUMNS)) if connection is None else labelled_classes(connection, survey)


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


@dataclass(frozen=True, slots=True)
class Former:
    """A survey's run as the database has it before the survey is built again.

    Parameters
    ----------
    where : str
        The database, for messages.
    name, date, bounds, cell_m, sources
        As `msbdb.tables.Survey`.
    methods, profile, version, parameters
        As `msbdb.tables.Run`.
    stated : mapping of str to str
        What the user stated about the files.
    results : mapping of str to str
        What each detector found, in words.
    """

    where: str
    name: str
    date: str
    bounds: tuple[float, float, float, float]
    cell_m: float
    sources: tuple[Source, ...]
    methods: tuple[str, ...]
    profile: str
    version: str
    parameters: Mapping[str, Any]
    stated: Mapping[str, str]
    results: Mapping[str, str]

    def require_sources(self, sources: Sequence[Source], suggested: str = "NAME") -> None:
        """Raise `InputError` unless the files are the same, whatever they are called; ``suggested`` is another name."""
        old, new = ({(source.role, source.sha256) for source in own} for own in (self.sources, sources))
        if old == new:
            return
        without = _names(source for source in self.sources if (source.role, source.sha256) not in new)
        more = _names(source for source in sources if (source.role, source.sha256) not in old)
        words = f"it has {without}, and this build {more}{' with another content' if more == without else ''}"
        if not without or not more:
            words = f"this build adds {more}" if more else f"this build lacks {without}"
        if {role for role, _ in old ^ new} == {"parcels"}:
            msg = (
                f"The survey '{self.name}' of the database {self.where} was built with other parcels: {words}. Parcels "
                "divide touching houses, so its buildings and their ids would change. Nothing was changed. Add "
                "--replace to divide them anew; buildings of the inventory stay as they are until they change."
            )
            raise InputError(msg)
        msg = (
            f"The survey '{self.name}' of the database {self.where} is of other files: {words}. Nothing was changed. "
            f"Give this build another name by --survey {suggested}, or replace the survey by --replace."
        )
        raise InputError(msg)

    def require_place(self, survey: Survey) -> None:
        """Raise `InputError` unless the extent is the same but for the cells."""
        margin = self.cell_m + survey.cell_m
        if all(abs(old - new) <= margin for old, new in zip(self.bounds, survey.bounds, strict=True)):
            return
        msg = (
            f"The database {self.where} has the survey '{self.name}' in {_words(self.bounds)}; this build is in "
            f"{_words(survey.bounds)}. Nothing was changed. Check --crs, or replace the survey by --replace."
        )
        raise InputError(msg)

    def require_methods(self, methods: Sequence[str]) -> None:
        """Raise `InputError` when the results of a detector would be deleted without a successor."""
        lost = [name for name in self.methods if name not in methods]
        if not lost:
            return
        msg = (
            f"The survey '{self.name}' of the database {self.where} has results that a build with "
            f"{', '.join(methods)} deletes: {', '.join(f'{self.results[name]} of {name}' for name in lost)}. Nothing "
            f"was changed. Name {' and '.join(lost)} in --extract too, keep both by another --survey NAME, or delete "
            "them by --replace."
        )
        raise InputError(msg)

    def differences(self, survey: Survey, run: Run) -> str:
        """Return in words how the survey's build differs from this one, for a notice."""
        pairs: dict[str, tuple[object, object]] = {
            "date": (self.date or "none", survey.date or "none"),
            "detectors": (", ".join(self.methods), ", ".join(run.methods)),
            "profile": (self.profile, run.profile),
            "version of msbdb": (self.version, run.version),
        }
        stated, flat = run.counts.stated, [_flat(own) for own in (self.parameters, run.parameters)]
        for old, new in ((self.stated, stated), flat):
            pairs |= {name: (old.get(name, "none"), new.get(name, "none")) for name in sorted({*old, *new})}
        words = [f"{name} {new} (was {old})" for name, (old, new) in pairs.items() if to_json(old) != to_json(new)]
        if {(s.role, s.sha256) for s in self.sources} != {(s.role, s.sha256) for s in survey.sources}:
            words.insert(0, f"other files (was {_names(self.sources)})")
        return _some(words) or "other content from the same files and values"


def read_former(target: str | PathLike[str] | URL, survey: str) -> Former | None:
    """Return what a database of any schema has of a survey; None where it has nothing."""
    with connected(target) as connection:
        return None if connection is None else _former(connection, survey)


def _former(connection: Connection, survey: str) -> Former | None:
    """Return what `read_former` does, as an open transaction sees it."""
    chosen = [SURVEY.c[name] for name in ("survey_id", "date", "west", "south", "east", "north", "cell_m")]
    chosen += [RUN.c[name] for name in ("run_id", "profile", "version", "parameters", "counts")]
    row = connection.execute(select(*chosen).join_from(RUN, SURVEY).where(SURVEY.c.name == survey)).one_or_none()
    if row is None:
        return None
    sources = connection.execute(select(SOURCE).where(SOURCE.c.survey_id == row.survey_id).order_by(SOURCE.c.number))
    methods = sorted(connection.scalars(select(RUN_METHOD.c.method).where(RUN_METHOD.c.run_id == row.run_id)))
    return Former(
        where=shown(connection.engine.url),
        name=survey,
        date=row.date,
        bounds=(row.west, row.south, row.east, row.north),
        cell_m=row.cell_m,
        sources=tuple(Source(s.name, s.role, s.sha256, s.bytes) for s in sources),
        methods=tuple(methods),
        profile=row.profile,
        version=row.version,
        parameters=row.parameters,
        stated=row.counts.get("stated", {}),
        results={name: _results(connection, row.run_id, name) for name in methods},
    )


def _results(connection: Connection, run_id: int, method: str) -> str:
    """Return in words what a detector found in a run."""
    tables = {"multiscale": (PART, "part"), "flatregions": (FLAT_REGION, "flat region")}
    table, word = tables.get(method, (CANDIDATE_REGION, "candidate region"))
    query = select(func.count()).select_from(table).where(table.c.run_id == run_id)
    if table is CANDIDATE_REGION:
        query = query.where(table.c.method == method)
    number = connection.scalar(query)
    return f"{number} {word}" + ("s" if number != 1 else "")


def _flat(parameters: Mapping[str, Any]) -> dict[str, Any]:
    """Return parameters by section and name."""
    return {f"{section}.{name}": value for section, own in parameters.items() for name, value in own.items()}


def _names(sources: Iterable[Source]) -> str:
    """Return the names of files."""
    return _some(sorted({source.name for source in sources}))


def _some(words: Sequence[str]) -> str:
    """Return a list in words, cut where it is long."""
    return ", ".join(words[:MOST]) + (f" and {len(words) - MOST} more" if len(words) > MOST else "")


def _words(bounds: tuple[float, float, float, float]) -> str:
    """Return an extent in words."""
    west, south, east, north = (f"{value:.1f}" for value in bounds)
    return f"{west} to {east} east, {south} to {north} north"


class OutdatedError(Exception):
    """The basis of a computation has changed since it was read; compute it again."""


@dataclass(frozen=True, slots=True, eq=False)
class BuildBasis:
    """The content of the database from which a build was computed, so that no change of others is lost.

    ``labelled`` has the classes labelled by operators, from `read_labelled_classes`; ``content_sha256`` is the digest
    of the run that the build continues. None means that it is not checked. Without ``replace``, a run of other files or
    of another place is kept, and so are the results of detectors that the build lacks.
    """

    labelled: "pd.DataFrame | None" = None
    content_sha256: str | None = None
    replace: bool = True

    def require(self, connection: Connection, build: KeptRun) -> None:
        """Raise `OutdatedError` when the basis has changed, `InputError` when the build would replace too much."""
        survey = build.survey.name
        former = None if self.replace else _former(connection, survey)
        if former is not None:
            former.require_sources(build.survey.sources)
            former.require_place(build.survey)
            former.require_methods(build.run.methods)
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
