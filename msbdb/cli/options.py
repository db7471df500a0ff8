"""The registry of options that commands share, so that each is spelled and explained in one place."""

import datetime
import re
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from typing import Any, TypeVar

import click

F = TypeVar("F", bound=Callable[..., Any])

INPUT_FILE = click.Path(exists=True, dir_okay=False, path_type=Path)
OUTPUT_FILE = click.Path(dir_okay=False, path_type=Path)


def iso_date(text: str) -> str:
    """Return a day, month or year by ISO 8601, as it is: 2021-05-31, 2021-05 or 2021."""
    if re.fullmatch(r"\d{4}(-\d{2}(-\d{2})?)?", text):
        try:
            datetime.date.fromisoformat(text + "0000-01-01"[len(text) :])
        except ValueError:
            pass
        else:
            return text
    msg = f"{text!r} is no date; write it as 2021-05-31, 2021-05 or 2021."
    raise click.BadParameter(msg)


def crs_name(text: str) -> str:
    """Return the name of a CRS; a bare number is an EPSG code.

    Examples
    --------
    >>> crs_name("2154"), crs_name("EPSG:28992")
    ('EPSG:2154', 'EPSG:28992')
    """
    return f"EPSG:{text}" if text.isdecimal() else text


def scales_m2(text: str) -> tuple[float, ...]:
    """Return area thresholds, square metres, in rising order; none for 'auto' (V8).

    Examples
    --------
    >>> scales_m2("200,50"), scales_m2("auto")
    ((50.0, 200.0), ())
    """
    if text.strip() == "auto":
        return ()
    try:
        return tuple(sorted({float(item) for item in text.split(",")}))
    except ValueError:
        msg = f"{text!r} is neither 'auto' nor a list of areas in m2 like 50,200,1000."
        raise click.BadParameter(msg) from None


def detectors(text: str) -> tuple[str, ...]:
    """Return the names of detectors in a list like multiscale,flatregions.

    Examples
    --------
    >>> detectors("multiscale, flatregions")
    ('multiscale', 'flatregions')
    """
    return tuple(name.strip() for name in text.split(",") if name.strip())


def declared_range(section: type, name: str) -> click.FloatRange:
    """Return the type of an option that sets a parameter: a number within the parameter's bounds."""
    bounds = next(item.metadata for item in fields(section) if item.name == name)
    return click.FloatRange(bounds["low"], bounds["high"])


def assignment(text: str) -> tuple[str, str]:
    """Return name and column of an assignment written NAME=COLUMN.

    Examples
    --------
    >>> assignment("height=HGT")
    ('height', 'HGT')
    """
    name, _, column = text.partition("=")
    if not name.strip() or not column.strip():
        msg = f"{text!r} is no assignment like height=HGT."
        raise click.BadParameter(msg)
    return name.strip(), column.strip()


def class_label(text: str) -> tuple[int, str]:
    """Return an operator's label of a class, written NUMBER=LABEL (V36)."""
    from msbdb.landcover import LABELS

    number, _, label = text.partition("=")
    if not number.isdecimal() or label not in LABELS:
        msg = f"{text!r} is no assignment like 3=vegetation; the labels are {', '.join(LABELS)}."
        raise click.BadParameter(msg)
    return int(number), label


def setting(text: str) -> tuple[str, str, object]:
    """Return section, name and value of a parameter written SECTION.NAME=VALUE, the value as in TOML.

    Quotes around words may be left out. Whether the parameter exists is checked where it is set.

    Examples
    --------
    >>> setting("surface.cell_m=0.5"), setting("surface.slicing=step")
    (('surface', 'cell_m', 0.5), ('surface', 'slicing', 'step'))
    """
    import tomllib

    key, _, value = text.partition("=")
    section, _, name = key.strip().partition(".")
    if not name or not value:
        msg = f"{text!r} is no setting like surface.cell_m=0.5; 'msbdb params' lists them all."
        raise click.BadParameter(msg)
    try:
        return section, name, tomllib.loads(f"value = {value}")["value"]
    except tomllib.TOMLDecodeError:
        return section, name, value.strip()


SHARED: dict[str, Callable[[F], F]] = {
    "db": click.argument("db", metavar="DB"),
    "survey": click.option("--survey", metavar="NAME", help="The survey to use, where the database holds several."),
    "json": click.option("as_json", "--json", is_flag=True, help="Print the result as JSON on the standard output."),
    "verbose": click.option("-v", "--verbose", count=True, help="Print more: -v the stages, -vv the details."),
    "debug": click.option("--debug", is_flag=True, help="Show the traceback of an error."),
}
"""Every option that more than one command takes, by name."""


def shared(*names: str) -> Callable[[F], F]:
    """Decorate a command function with shared options, in the order in which the help lists them."""

    def decorate(function: F) -> F:
        for name in reversed(names):
            function = SHARED[name](function)
        return function

    return decorate
