"""What changed in the inventory between two dates."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

from msbdb.run.reports import Changes

if TYPE_CHECKING:
    pass


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
    """Tell what changed in the inventory between two dates.

    Parameters
    ----------
    db : str or path
        The database.
    since, until : str, optional
        From the state at the end of the one day to that of the other, ISO 8601; from before the first survey, and to
        the present, by default.
    survey : str, optional
        What this one did, and no net change.
    each : bool
        What each survey did, one after the other, and no net change.
    aoi : path, optional
        Polygons: buildings that meet them, and those of them that no survey saw.
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
        When there is nothing to draw, or the endings are unknown.
    """
    from msbdb.run.changes import changes_of

    return changes_of(db, since=since, until=until, survey=survey, each=each, aoi=aoi, out=out, figure=figure)


def summary(found: Changes) -> dict[str, Any]:
    """Return the changes as plain values for JSON: counts, and a record for each row that is no 'unchanged'."""
    from msbdb.run.changes import records_of

    return {"counts": found.counts, "in_between": found.in_between, "changes": records_of(found)}
