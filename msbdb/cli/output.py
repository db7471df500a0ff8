"""Results on the standard output, as tables or JSON; progress on the standard error."""

import json
import math
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cache
from typing import TYPE_CHECKING, Any, Literal, TypeGuard

import click

if TYPE_CHECKING:
    from rich.console import Console
    from rich.progress import TaskID
    from rich.table import Table

Progress = Callable[[str, int, int], None]
"""Called with a stage's name, the steps done and the steps in all."""

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
    """Print names and values in two columns."""
    table = _table(title)
    table.show_header = False
    table.add_column(style="bold", no_wrap=True)
    table.add_column(overflow="fold")
    for name, value in pairs.items():
        table.add_row(words(name), text(value))
    _print(table)


def emit_table(records: Sequence[Mapping[str, object]], title: str = "") -> None:
    """Print records as a table with a column a key; numbers are set flush right."""
    table = _table(title)
    for position, name in enumerate(records[0]):
        numeric = all(isinstance(plain(record[name]), int | float | None) for record in records)
        justify: Literal["right", "left"] = "right" if numeric else "left"
        table.add_column(words(name), justify=justify, overflow="fold", no_wrap=position == 0)
    for record in records:
        table.add_row(*(text(value) for value in record.values()))
    _print(table)


def text(value: object) -> str:
    """Return a value as people write it.

    Examples
    --------
    >>> text(1234567), text(0.87654), text(None), text(("a", "b"))
    ('1234567', '0.877', '-', 'a, b')
    """
    value = plain(value)
    if value in (None, "", []):
        return "-"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        digits = 3 if abs(value) < 100 else 1
        return f"{value:.{digits}f}".rstrip("0").rstrip(".")
    if isinstance(value, list):
        return ", ".join(text(item) for item in value)
    return str(value)


def words(name: str) -> str:
    """Return a key as words."""
    return name.replace("_", " ")


def on_terminal() -> bool:
    """Return whether the standard error is a terminal; asked of Python, as loading rich takes time."""
    # It is None where it is closed.
    return sys.stderr is not None and sys.stderr.isatty()


@contextmanager
def progress_bars() -> Iterator[Progress | None]:
    """Give a callback that draws a bar a stage on the standard error; None where that is no terminal."""
    if not on_terminal():
        yield None
        return
    from rich.progress import BarColumn, TaskProgressColumn, TextColumn, TimeElapsedColumn
    from rich.progress import Progress as Bars

    columns = (TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), TimeElapsedColumn())
    tasks: dict[str, TaskID] = {}
    with Bars(*columns, console=stderr_console(), transient=True) as bars:

        def advance(stage: str, done: int, total: int) -> None:
            if stage not in tasks:
                tasks[stage] = bars.add_task(stage, total=total)
            bars.update(tasks[stage], completed=done, total=total)

        yield advance


def _is_records(value: object) -> TypeGuard[Sequence[Mapping[str, object]]]:
    """Whether a value is a list of mappings."""
    return isinstance(value, list | tuple) and bool(value) and all(isinstance(item, Mapping) for item in value)


def _is_table(value: object) -> TypeGuard[Sequence[Mapping[str, object]]]:
    """Whether a value is a list of mappings with the same few keys and plain values."""
    if not _is_records(value) or len(value[0]) > WIDEST or not all(list(item) == list(value[0]) for item in value):
        return False
    return not any(isinstance(cell, Mapping) or _is_records(cell) for item in value for cell in item.values())


def _table(title: str) -> "Table":
    """Return an empty table, and print its title."""
    from rich import box
    from rich.table import Table

    _heading(title)
    return Table(box=box.SIMPLE_HEAD, show_edge=False)


def _heading(title: str) -> None:
    """Print a title with a line of space before it."""
    if title:
        click.secho(f"\n{title}", bold=True)


def _print(table: "Table") -> None:
    """Print a table; where the output is no terminal, as wide as it needs to be, so that no cell is cut.

    Cells are data without markup: a survey may be called '[/red]'.
    """
    from rich.console import Console

    console = Console(markup=False, emoji=False)
    if not console.is_terminal:
        wide = Console(width=10_000, markup=False, emoji=False)
        console = Console(width=wide.measure(table).maximum, no_color=True, markup=False, emoji=False)
    console.print(table)
