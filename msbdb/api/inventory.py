"""The living inventory: updates by surveys, imports, operators' decisions, and what changed between two dates."""

import datetime
from collections.abc import Mapping
from inspect import signature
from pathlib import Path
from typing import Any

from msbdb.api.build import Files, build, read_plan
from msbdb.errors import InputError
from msbdb.run.reports import (
    AdvanceReport,
    Changes,
    ImportReport,
    MeasureReport,
    Notices,
    Progress,
    Stages,
    UpdateReport,
)

TILED = ("tile", "workers", "scheduler", "resume")
"""Options of a build in tiles, which do not decide its content."""


def update(
    points: Files = (),
    *,
    db: str | Path,
    survey: str,
    date: str,
    aoi: Path | None = None,
    replace: bool = False,
    overwrite: bool = False,
    progress: Progress | None = None,
    **options: Any,  # noqa: ANN401  (those of build)
) -> UpdateReport:
    """Build a survey and update the inventory by it.

    Parameters
    ----------
    points : path or sequence of path
        LAS, LAZ or COPC files; or give rasters among the options.
    db : str or path
        A SpatiaLite file, made when it is missing, or a ``postgresql+psycopg://`` URL.
    survey, date : str
        Name of the survey, and when the data were taken, ISO 8601.
    aoi : path, optional
        Polygons in any vector format: only buildings in them are compared.
    replace : bool
        As for `msbdb.api.build`.
    overwrite : bool
        Replace a figure that exists.
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
    A survey that was built from the same files with the same values by the same msbdb is not built again, whether in
    tiles or in one piece.
    """
    from msbdb.run.inputs import require_polygons
    from msbdb.run.inventory.update import is_built, require_date

    _require_known("update", options)
    require_date(survey, date)
    if aoi is not None:
        require_polygons(aoi)
    stages = Stages(progress)
    built = None
    options = _with_plan(options)
    if not is_built(points, db=db, survey=survey, date=date, **_without(options, *TILED)):
        built = build(
            points,
            db=db,
            survey=survey,
            date=date,
            replace=replace,
            overwrite=overwrite,
            progress=progress,
            **options,
        )
    with stages.stage("inventory"):
        return UpdateReport(built, advance(db, survey, aoi=aoi))


def measure(
    footprints: str | Path,
    points: Files = (),
    *,
    db: str | Path,
    survey: str | None = None,
    date: str | None = None,
    name: str | None = None,
    layer: str | None = None,
    id_column: str | None = None,
    out: Path | None = None,
    overwrite: bool = False,
    progress: Progress | None = None,
    **options: Any,  # noqa: ANN401  (those of build)
) -> MeasureReport:
    """Measure footprints that you have on a survey: heights, storeys, parts, and whether a building is there.

    The survey is built by all detectors, with the footprints as its parcels. Each footprint keeps its outline and its
    columns, and enters the inventory of the database with its measures. So do detected buildings without a footprint.

    Parameters
    ----------
    footprints : path
        Polygons in any vector format.
    points : path or sequence of path
        LAS, LAZ or COPC files; or give rasters among the options.
    db : str or path
        A SpatiaLite file, made when it is missing, or a ``postgresql+psycopg://`` URL.
    survey : str, optional
        Name of the survey; as for `msbdb.api.build`.
    date : str, optional
        When the data were taken, ISO 8601; the day from which the measures hold.
    name : str, optional
        Name of the footprints in the inventory; the file's by default.
    layer : str, optional
        Their layer, where the file has several.
    id_column : str, optional
        Column with an id for each footprint; by default their places serve. All columns are kept.
    out : path, optional
        Also write a GeoPackage, GeoJSON or CSV, by its ending, with the footprints' own columns and their measures.
    overwrite : bool
        Replace ``out`` if it exists.
    progress : callable, optional
        Called with stage, steps done and steps in all.
    **options
        All that `msbdb.api.build` takes. ``parcels`` are other polygons than the footprints that divide houses.

    Returns
    -------
    MeasureReport

    Raises
    ------
    InputError
        When the inventory has other buildings in the place, the id column holds a value twice, or no footprint lies in
        the survey.
    MsbdbError
        One of its kinds. A build that was written stays; repeating the command completes it.
    """
    from msbdb.database import read_fallback
    from msbdb.io.files import require_output
    from msbdb.run.inputs import Inputs
    from msbdb.run.inventory.footprintfile import FORMATS
    from msbdb.run.inventory.measure import check_footprints, take_measures
    from msbdb.run.inventory.update import is_built
    from msbdb.run.reports import collect_notices

    _require_known("measure", options)
    file, crs = Path(footprints), options.get("crs")
    if out is not None:
        require_output(out, overwrite=overwrite, endings=FORMATS, sources=[db, file])
    given = {
        key: options[key]
        for key in ("ortho", "dsm", "dtm", "ndsm", "crs", "ortho_crs", "z_unit", "skip_bad")
        if key in options
    }
    with collect_notices(Notices()):
        inputs = Inputs.of(points, **given, fallback=read_fallback(db))
    chosen, label = name or file.stem, survey or inputs.default_survey()
    check_footprints(db, file, name=chosen, layer=layer, id_column=id_column, crs=crs, place=inputs.extent())
    if options.get("parcels") is None and layer is None:
        options["parcels"] = file
    stages = Stages(progress)
    built = None
    options = _with_plan(options)
    if not is_built(points, db=db, survey=label, date=date or "", **_without(options, "replace", *TILED)):
        built = build(points, db=db, survey=label, date=date, overwrite=overwrite, progress=progress, **options)
    with stages.stage("measure"):
        return take_measures(
            db, file, label, name=chosen, layer=layer, id_column=id_column, crs=crs, out=out, built=built
        )


def _require_known(name: str, options: Mapping[str, Any]) -> None:
    """Refuse options that `build` does not take, as Python does for the function that was called."""
    for unknown in sorted(set(options) - set(signature(build).parameters)):
        msg = f"{name}() got an unexpected keyword argument '{unknown}'"
        raise TypeError(msg)


def _with_plan(options: Mapping[str, Any]) -> dict[str, Any]:
    """Return options with the plan itself where they name a file or a database."""
    plan = options.get("plan")
    return {**options, "plan": read_plan(plan)} if isinstance(plan, str | Path) else dict(options)


def _without(options: Mapping[str, Any], *names: str) -> dict[str, Any]:
    """Return options without some of them."""
    return {key: value for key, value in options.items() if key not in names}


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
    from msbdb.run.inventory.update import advance_inventory

    return advance_inventory(db, survey, aoi=aoi)


def import_inventory(
    db: str | Path,
    file: Path,
    *,
    name: str | None = None,
    layer: str | None = None,
    date: str | None = None,
    mapping: Mapping[str, str] | None = None,
    id_column: str | None = None,
    crs: str | None = None,
) -> ImportReport:
    """Import the footprints of a file as the inventory that later surveys update (V49).

    Parameters
    ----------
    db : str or path
        The database; made in the file's CRS if it is missing.
    file : path
        Polygons in any vector format.
    name : str, optional
        Name of the import; the file's by default.
    layer : str, optional
        Its layer; needed if there are several.
    date : str, optional
        The day from which the footprints hold, ISO 8601; always by default.
    mapping : mapping of str to str, optional
        Columns by what they become: ``height`` (metres above ground) and ``storeys`` are measures of the buildings,
        any other name is the attribute's own.
    id_column : str, optional
        Column with an id for each building; by default the places of the buildings serve.
    crs : str, optional
        The CRS of a file that states none.

    Returns
    -------
    ImportReport

    Raises
    ------
    InputError
        When the place is known to the inventory already, or the id column holds a value twice.
    ParameterError
        When a column does not exist, or a measure is no number.
    """
    from msbdb.run.inventory.imported import take_inventory

    return take_inventory(
        db, Path(file), name=name, layer=layer, date=date, mapping=mapping or {}, id_column=id_column, crs=crs
    )


def import_roof_samples(
    db: str | Path,
    file: Path,
    *,
    layer: str | None = None,
    mapping: Mapping[str, str] | None = None,
    crs: str | None = None,
) -> ImportReport:
    """Import points at which the material of a roof is known (V53).

    Parameters
    ----------
    db : str or path
        A database that exists.
    file : path
        Points in any vector format.
    layer : str, optional
        Its layer; needed if there are several.
    mapping : mapping of str to str, optional
        ``material`` and ``note`` by the columns that hold them, where these are called otherwise.
    crs : str, optional
        The CRS of a file that states none.

    Returns
    -------
    ImportReport

    Raises
    ------
    ParameterError
        When a column does not exist.
    InputError
        When a material is missing.
    """
    from msbdb.run.inventory.imported import take_samples

    return take_samples(db, Path(file), layer=layer, mapping=mapping or {}, crs=crs)


def set_state(db: str | Path, uid: int, state: str | None, *, operator: str, note: str = "") -> dict[str, Any] | None:
    """Write an operator's decision on a building of the inventory; None takes it back.

    Parameters
    ----------
    db : str or path
        The database.
    uid : int
        The building.
    state : {'confirmed', 'refuted', None}
        The decision; it takes precedence over the detectors, and is kept through every build and update.
    operator, note : str
        Who decides, and why.

    Returns
    -------
    mapping, optional
        The decision that this one replaces: ``state``, ``operator``, ``note`` and ``decided_at``.

    Raises
    ------
    InputError
        When the building does not exist, or the operator's name is empty.
    """
    if not operator.strip():
        msg = "A manual state needs the name of its operator. Give one by --operator."
        raise InputError(msg)
    from msbdb.database import opened, write_state

    now = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
    with opened(db) as engine:
        return write_state(engine, uid, state, operator=operator, note=note, decided_at=now)


def changes(
    db: str | Path,
    *,
    since: str | None = None,
    until: str | None = None,
    survey: str | None = None,
    each: bool = False,
    aoi: Path | None = None,
    out: Path | None = None,
    figure: Path | None = None,
    overwrite: bool = False,
) -> Changes:
    """Report what changed in the inventory between two dates.

    Parameters
    ----------
    db : str or path
        The database.
    since, until : str, optional
        The first and the last day of the period, ISO 8601; the states at the end of both days are compared. By default
        from the first state of each place, and to the present.
    survey : str, optional
        Report what this survey changed, in place of the net change.
    each : bool
        Report what each survey changed, one after the other, in place of the net change.
    aoi : path, optional
        Polygons: buildings that meet them, and those of them that no survey covered.
    out : path, optional
        A GeoPackage, GeoJSON or CSV of the rows, by its ending.
    figure : path, optional
        A PNG: the buildings coloured by kind on a hillshade of the surveys.
    overwrite : bool
        Replace ``out`` and ``figure`` if they exist.

    Returns
    -------
    Changes

    Notes
    -----
    The first state of a place is its beginning, not a change. Buildings that the first survey of a place finds count as
    present before: 'unchanged' in the net change, 'first seen' in the changes of surveys. They are 'new' where an
    import of the same place lacks them, and where ``since`` is before all surveys and imports.

    Raises
    ------
    InputError
        When no building is left to draw, or an ending is unknown.
    FileError
        When a file cannot be written, or exists already. This is checked first.
    """
    from msbdb.run.inventory.changed import changes_of

    return changes_of(
        db, since=since, until=until, survey=survey, each=each, aoi=aoi, out=out, figure=figure, overwrite=overwrite
    )


def summary(found: Changes) -> dict[str, Any]:
    """Return the changes as plain values for JSON: counts, and a record for each row that is not 'unchanged'."""
    from msbdb.run.inventory.changed import records_of

    return {"counts": found.counts, "in_between": found.in_between, "changes": records_of(found)}
