"""Results on the standard output, as lists and tables for people or as JSON for programs."""

import json
import math
import shutil
import sys
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any, Literal, TypeGuard

import click

if TYPE_CHECKING:
    from rich.console import Console

QUIET = "msbdb.quiet"
"""Where the context of a command keeps whether it is quiet."""

SHORTEST = 28
"""Characters beyond which a text of several words may continue on the next line, and the least room for it."""

WIDEST = 12
"""Columns beyond which records are printed one below the other."""


@cache
def stderr_console() -> "Console":
    """Return the console on the standard error: one for progress, logs and notices, so that none spoils another."""
    from rich.console import Console

    return Console(stderr=True)


def emit_json(result: object) -> None:
    """Print a result as JSON: keys as they are, numbers of any library as plain ones, NaN as null."""
    click.echo(json.dumps(plain(result), indent=2, ensure_ascii=False, allow_nan=False))


def plain(value: object) -> Any:  # noqa: ANN401  (JSON's own types)
    """Return the value in the types of JSON.

    Examples
    --------
    >>> plain({"a": (1, float("nan"))})
    {'a': [1, None]}
    """
    if hasattr(value, "tolist"):  # numpy's scalars and arrays
        value = value.tolist()
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple | set | frozenset):
        return [plain(item) for item in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if value is None or isinstance(value, bool | int | str):
        return value
    return str(value)


def emit(result: Mapping[str, object], title: str = "") -> None:
    """Print a result for people: plain values as a list, flat records as a table, the rest in sections of their own."""
    rest: dict[str, object] = {}
    sections: list[tuple[str, Mapping[str, object]]] = []
    tables: list[tuple[str, Sequence[Mapping[str, object]]]] = []
    for key, value in result.items():
        heading = f"{title} · {words(key)}" if title else words(key)
        if isinstance(value, Mapping) and value:
            sections.append((heading, value))
        elif _is_table(value):
            tables.append((heading, value))
        elif _is_records(value):
            sections += [(f"{heading} {number}", record) for number, record in enumerate(value, 1)]
        else:
            rest[key] = value
    if rest:
        emit_pairs(rest, title)
    for heading, section in sections:
        emit(section, heading)
    for heading, records in tables:
        emit_table(records, heading)


def emit_pairs(pairs: Mapping[str, object], title: str = "") -> None:
    """Print names and values in two columns; a long text continues below itself, and a word or id is never broken."""
    _heading(title)
    labels = [heading(name) for name in pairs]
    indent = max(map(len, labels), default=0) + 4
    for label, (name, value) in zip(labels, pairs.items(), strict=True):
        shown = text(value, digits_of(name, [value]))
        lines = [shown]
        if _has_width() and " " in shown:
            room = max(_width() - indent, SHORTEST)
            lines = textwrap.wrap(shown, room, break_long_words=False, break_on_hyphens=False)
        click.echo(f" {click.style(label, bold=True)}{' ' * (indent - 1 - len(label))}{lines[0]}")
        for line in lines[1:]:
            click.echo(" " * indent + line)


def emit_table(records: Sequence[Mapping[str, object]], title: str = "") -> None:
    """Print records as a table with a column a key; numbers are set flush right.

    Where the terminal is too narrow for all columns, they follow in groups below each other, with the numbers of the
    rows. Only texts of several words are wrapped, so that ids stay whole.
    """
    columns = [_Column.of(name, [record[name] for record in records]) for name in records[0]]
    groups = [columns]
    if _has_width() and _table_width(columns) > _width():
        number = _Column.of("#", list(range(1, len(records) + 1)))
        groups = [[number]]
        for column in columns:
            if len(groups[-1]) > 1 and _table_width([*groups[-1], column]) > _width():
                groups.append([number])
            groups[-1].append(column)
    _heading(title)
    for position, group in enumerate(groups):
        if position:
            click.echo()
        _print_table(group)


@dataclass(frozen=True, slots=True)
class _Column:
    """A column of a table as it is shown."""

    head: str
    cells: tuple[str, ...]
    is_number: bool

    @classmethod
    def of(cls, name: str, values: Sequence[object]) -> "_Column":
        """Return the column of these values."""
        own = [plain(value) for value in values]
        is_number = all(value is None or (isinstance(value, int | float) and value is not True) for value in own)
        digits = digits_of(name, own)
        return cls(heading(name), tuple(text(value, digits) for value in own), is_number)

    @property
    def wraps(self) -> bool:
        """Whether its cells are texts of several words, which may continue on the next line."""
        return any(" " in cell and len(cell) > SHORTEST for cell in self.cells)

    @property
    def least(self) -> int:
        """The width without which a word or a number would be broken."""
        words = [word for cell in self.cells for word in (cell.split(" ") if self.wraps else [cell])]
        longest = max(map(len, (*self.head.split(" "), *words)))
        return max(longest, SHORTEST) if self.wraps else longest


def _table_width(columns: Sequence[_Column]) -> int:
    """Return the width of a table without which a word or number would be broken: of cells, padding and gaps."""
    return sum(column.least + 3 for column in columns) - 1


def _print_table(columns: Sequence[_Column]) -> None:
    """Print a table; where the output is no terminal, as wide as it needs to be, so that no cell is cut.

    Cells are data without markup: a survey may be called '[/red]'.
    """
    from rich import box
    from rich.console import Console
    from rich.table import Table

    table = Table(box=box.SIMPLE_HEAD, show_edge=False)
    for column in columns:
        justify: Literal["right", "left"] = "right" if column.is_number else "left"
        table.add_column(
            column.head, justify=justify, overflow="fold", min_width=column.least, no_wrap=not column.wraps
        )
    for row in zip(*(column.cells for column in columns), strict=True):
        table.add_row(*row)
    if _has_width():
        console = Console(markup=False, emoji=False, width=max(_width(), _table_width(columns)))
    else:
        wide = Console(width=10_000, markup=False, emoji=False)
        console = Console(width=wide.measure(table).maximum, no_color=True, markup=False, emoji=False)
    console.print(table)


def _has_width() -> bool:
    """Return whether the standard output is a terminal, which has an end of the line."""
    return sys.stdout is not None and sys.stdout.isatty()


def _width() -> int:
    """Return the characters of a line of the terminal."""
    return shutil.get_terminal_size().columns


def text(value: object, digits: int | None = None) -> str:
    """Return a value as people write it; a fraction with so many digits, by default those that it needs.

    Examples
    --------
    >>> text(1234567), text(0.87654), text(None), text(("a", "b")), text(2.0, 1)
    ('1234567', '0.877', '-', 'a, b', '2.0')
    """
    value = plain(value)
    if value in (None, "", []):
        return "-"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        if digits is not None:
            return f"{value:.{digits}f}"
        digits = 3 if abs(value) < 100 else 1
        return f"{value:.{digits}f}".rstrip("0").rstrip(".")
    if isinstance(value, list):
        return ", ".join(text(item, digits) for item in value)
    return str(value)


UNITS = {"_m2": "m²", "_m3": "m³", "_m": "m", "_s": "s"}
"""Units by the end of a name."""

DECLARED = {"m": "m", "m2": "m²", "m3": "m³", "1/m2": "1/m²"}
"""Units of declared columns that are shown."""


def unit_of(name: str) -> str:
    """Return the unit of a column: by the end of its name, or as it is declared.

    Examples
    --------
    >>> unit_of("area_m2"), unit_of("ridge"), unit_of("density"), unit_of("storeys")
    ('m²', 'm', '1/m²', '')
    """
    ends = [unit for end, unit in UNITS.items() if name.endswith(end)]
    return ends[0] if ends else _declared_units().get(name, "")


@cache
def _declared_units() -> dict[str, str]:
    """Return the units of the columns of all tables."""
    from msbdb.tables import INVENTORY_TABLES, SURVEY, TABLES

    columns = [column for table in (*TABLES, *INVENTORY_TABLES, SURVEY) for column in table.columns]
    return {column.name: DECLARED[column.unit] for column in columns if column.unit in DECLARED}


def heading(name: str) -> str:
    """Return a key as words, with its unit.

    Examples
    --------
    >>> heading("area_m2"), heading("ridge"), heading("h_p90"), heading("building_id")
    ('area, m²', 'ridge, m', 'h p90, m', 'building id')
    """
    unit = unit_of(name)
    end = next((end for end in UNITS if name.endswith(end)), "")
    return f"{words(name.removesuffix(end))}, {unit}" if unit else words(name)


def digits_of(name: str, values: Sequence[object]) -> int | None:
    """Return the digits behind the point that values of a column deserve; None for as many as each needs.

    Lengths are true to a decimetre and small ones to a centimetre, areas and volumes to a unit, shares to a per cent.

    Examples
    --------
    >>> digits_of("ridge", [28.7]), digits_of("roughness_m", [0.008]), digits_of("area_m2", [528.12])
    (1, 2, 0)
    """
    unit = unit_of(name)
    if unit == "m":
        known = [abs(value) for value in values if isinstance(value, float) and math.isfinite(value)]
        return 2 if max(known, default=0.0) < 10 else 1
    if unit in ("m²", "m³"):
        return 0
    if unit == "1/m²":
        return 1
    return 2 if name in ("probability", "share") or name.endswith("_share") else None


def words(name: str) -> str:
    """Return a key as words."""
    return name.replace("_", " ")


def on_terminal() -> bool:
    """Return whether the standard error is a terminal; asked of Python, as loading rich takes time."""
    # It is None where it is closed.
    return sys.stderr is not None and sys.stderr.isatty()


def is_quiet() -> bool:
    """Return whether the command that runs has the option ``--quiet``."""
    context = click.get_current_context(silent=True)
    return context is not None and bool(context.meta.get(QUIET))


def say(sentence: str = "") -> None:
    """Print what a person reads and a program does not need; nothing under ``--quiet``."""
    if not is_quiet():
        click.echo(sentence)


def _is_records(value: object) -> TypeGuard[Sequence[Mapping[str, object]]]:
    """Whether a value is a list of mappings."""
    return isinstance(value, list | tuple) and bool(value) and all(isinstance(item, Mapping) for item in value)


def _is_table(value: object) -> TypeGuard[Sequence[Mapping[str, object]]]:
    """Whether a value is a list of mappings with the same few keys and plain values."""
    if not _is_records(value) or len(value[0]) > WIDEST or not all(list(item) == list(value[0]) for item in value):
        return False
    return not any(isinstance(cell, Mapping) or _is_records(cell) for item in value for cell in item.values())


def _heading(title: str) -> None:
    """Print a title with a line of space before it."""
    if title:
        click.secho(f"\n{title}", bold=True)


def refused(candidates: int, rows: int) -> str:
    """Return in words how many candidates were refused, and how many of them the ledger lists.

    Examples
    --------
    >>> refused(19623, 823)
    '19,623 in all, 823 of them as large as a building and listed in the ledger'
    """
    return f"{candidates:,} in all, {rows:,} of them as large as a building and listed in the ledger"
