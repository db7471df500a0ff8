"""What changed in the inventory between two dates."""

from pathlib import Path
from typing import Any

from msbdb.run.reports import Changes


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
) -> Changes:
    """Report what changed in the inventory between two dates.

    Parameters
    ----------
    db : str or path
        The database.
    since, until : str, optional
        The first and the last day of the period, ISO 8601; the states at the end of both days are compared. By default
        from before the first survey, and to the present.
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

    Returns
    -------
    Changes

    Raises
    ------
    InputError
        When no building is left to draw, or an ending is unknown.
    """
    from msbdb.run.changes import changes_of

    return changes_of(db, since=since, until=until, survey=survey, each=each, aoi=aoi, out=out, figure=figure)


def summary(found: Changes) -> dict[str, Any]:
    """Return the changes as plain values for JSON: counts, and a record for each row that is not 'unchanged'."""
    from msbdb.run.changes import records_of

    return {"counts": found.counts, "in_between": found.in_between, "changes": records_of(found)}
