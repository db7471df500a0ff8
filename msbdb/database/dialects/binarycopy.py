"""The rows of PostgreSQL's binary COPY, made of whole columns: the driver would convert and send them value by value.

The format is that of PostgreSQL's manual, COPY, binary format: in each row the number of values, and before each value
its length in bytes, or -1 for null. All numbers are big-endian.
"""

from collections.abc import Sequence
from itertools import chain
from typing import Any

import numpy as np
from numpy.typing import NDArray

NUMBERS = {"int8": ">i8", "int4": ">i4", "float8": ">f8", "bool": "?"}
"""Types of the server whose values have one length, and their form."""

SIGNATURE = b"PGCOPY\n\xff\r\n\0" + bytes(8)

END = b"\xff\xff"

NULL = b"\xff\xff\xff\xff"


def packed_rows(kinds: Sequence[str], columns: Sequence[Sequence[Any] | NDArray[Any]]) -> bytes:
    r"""Return rows as binary COPY takes them.

    Parameters
    ----------
    kinds : sequence of str
        The server's type of each column: one of `NUMBERS`, ``text`` or ``bytea``.
    columns : sequence of sequence
        Values by column, N each: None is null, and so is NaN.

    Examples
    --------
    >>> packed_rows(["int4", "text"], [np.array([7]), ["ab"]])[19:]
    b'\x00\x02\x00\x00\x00\x04\x00\x00\x00\x07\x00\x00\x00\x02ab\xff\xff'
    """
    count = len(columns[0])
    pieces: list[list[bytes]] = []
    fixed: list[tuple[str, Any]] = [(">i2", len(columns))]
    for kind, values in zip(kinds, columns, strict=True):
        if kind not in NUMBERS:
            if fixed:
                pieces.append(_side_by_side(fixed, count))
                fixed = []
            pieces.append(_cells(values))
            continue
        numbers, null = _numbers(NUMBERS[kind], values)
        block = [(">i4", numbers.itemsize), (NUMBERS[kind], numbers)]
        if not null.any():
            fixed += block
            continue
        if fixed:
            pieces.append(_side_by_side(fixed, count))
            fixed = []
        cells = _side_by_side(block, count)
        for row in np.flatnonzero(null).tolist():
            cells[row] = NULL
        pieces.append(cells)
    if fixed:
        pieces.append(_side_by_side(fixed, count))
    return b"".join([SIGNATURE, *chain.from_iterable(zip(*pieces, strict=True)), END])


def _side_by_side(fixed: Sequence[tuple[str, Any]], count: int) -> list[bytes]:
    """Return values of one length, a value for all rows or one each, as the bytes of each row."""
    rows = np.empty(count, dtype=[(f"f{place}", kind) for place, (kind, _) in enumerate(fixed)])
    for name, (_, values) in zip(rows.dtype.names or (), fixed, strict=True):
        rows[name] = values
    found: list[bytes] = rows.view(f"V{rows.itemsize}").tolist()
    return found


def _numbers(form: str, values: Sequence[Any] | NDArray[Any]) -> tuple[NDArray[Any], NDArray[np.bool_]]:
    """Return a column of numbers, with anything where it is null, and where that is."""
    if not isinstance(values, np.ndarray) or values.dtype == object:
        null = np.array([value is None for value in values], dtype=np.bool_)
        if null.any():
            values = [0 if value is None else value for value in values]
        numbers = np.array(values, dtype=form)
    else:
        null, numbers = np.zeros(len(values), dtype=np.bool_), values.astype(form)
    return numbers, null | np.isnan(numbers) if form == NUMBERS["float8"] else null


def _cells(values: Sequence[Any] | NDArray[Any]) -> list[bytes]:
    """Return texts or bytes with their lengths; equal texts are encoded once."""
    known: dict[str, bytes] = {}
    found = []
    for value in values:
        if value is None:
            found.append(NULL)
        elif isinstance(value, str):
            cell = known.get(value)
            if cell is None:
                cell = known[value] = _cell(value.encode())
            found.append(cell)
        else:
            found.append(_cell(value))
    return found


def _cell(value: bytes) -> bytes:
    """Return bytes with their length."""
    return len(value).to_bytes(4, "big") + value
