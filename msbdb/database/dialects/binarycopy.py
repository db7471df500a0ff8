"""The rows of PostgreSQL's binary COPY, made of whole columns: the driver would convert and send them value by value.

The format is that of PostgreSQL's manual, COPY, binary format: in each row the number of values, and before each value
its length in bytes, or -1 for null. All numbers are big-endian.
"""

from collections.abc import Mapping, Sequence
from itertools import chain
from typing import Any

import numpy as np
from numpy.typing import NDArray

NUMBERS = {"int8": ">i8", "int4": ">i4", "float8": ">f8", "bool": "?"}
"""Types of the server whose values have one length, and their form."""

LENGTH = ">i4"
"""The form of a value's length."""

SIGNATURE = b"PGCOPY\n\xff\r\n\0" + bytes(8)

END = b"\xff\xff"

NULL = b"\xff\xff\xff\xff"


def packed_rows(columns: Mapping[str, Sequence[Any] | NDArray[Any]], kinds: Mapping[str, str]) -> bytes:
    r"""Return rows as binary COPY takes them.

    Parameters
    ----------
    columns : mapping of str to sequence
        Values by column, N each: None is null, and so is NaN. Columns of `NUMBERS` come first.
    kinds : mapping of str to str
        The server's type of each column: one of `NUMBERS`, ``text`` or ``bytea``.

    Examples
    --------
    >>> packed_rows({"storeys": np.array([7]), "name": ["ab"]}, {"storeys": "int4", "name": "text"})[19:]
    b'\x00\x02\x00\x00\x00\x04\x00\x00\x00\x07\x00\x00\x00\x02ab\xff\xff'
    """
    numbers = [name for name in columns if kinds[name] in NUMBERS]
    texts = [_cells(values, kinds[name]) for name, values in columns.items() if name not in numbers]
    form = chain.from_iterable(((f"length {name}", LENGTH), (name, NUMBERS[kinds[name]])) for name in numbers)
    rows = np.empty(len(next(iter(columns.values()))), dtype=[("values of a row", ">i2"), *form])
    rows["values of a row"] = len(columns)
    kept = np.ones((rows.size, rows.itemsize), dtype=np.bool_)
    for name in numbers:
        values, null = _numbers(columns[name])
        kind, place = rows.dtype.fields[name][:2]  # type: ignore[index]  # this type has fields
        rows[name] = values
        rows[f"length {name}"] = np.where(null, -1, kind.itemsize)
        kept[null, place : place + kind.itemsize] = False
    block = rows.view(np.uint8).reshape(kept.shape)[kept].tobytes() if not kept.all() else rows.tobytes()
    if texts:
        ends = np.cumsum(kept.sum(axis=1)).tolist()
        fixed = [block[begin:end] for begin, end in zip([0, *ends], ends, strict=False)]
        block = b"".join(chain.from_iterable(zip(fixed, *texts, strict=True)))
    return b"".join([SIGNATURE, block, END])


def _numbers(values: Sequence[Any] | NDArray[Any]) -> tuple[NDArray[Any], NDArray[np.bool_]]:
    """Return a column of numbers, with anything where it is null, and where that is."""
    if isinstance(values, np.ndarray):
        return values, np.isnan(values)
    null = np.array([value is None or value != value for value in values], dtype=np.bool_)  # noqa: PLR0124  (NaN)
    return np.array([0 if gone else value for value, gone in zip(values, null.tolist(), strict=True)]), null


def _cells(values: Sequence[Any] | NDArray[Any], kind: str) -> list[bytes]:
    """Return texts or bytes with their lengths; equal texts are encoded once."""
    if kind == "bytea":
        return [NULL if value is None else len(value).to_bytes(4, "big") + value for value in values]
    known: dict[str | None, bytes] = {None: NULL}
    for value in set(values) - {None}:
        encoded = value.encode()
        known[value] = len(encoded).to_bytes(4, "big") + encoded
    return [known[value] for value in values]
