"""Import footprints and roof samples into the inventory, and an operator's decisions on buildings."""

import datetime
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from msbdb.errors import InputError
from msbdb.run.reports import ImportReport


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
    from msbdb.run.imports import take_inventory

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
    from msbdb.run.imports import take_samples

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
