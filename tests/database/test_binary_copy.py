"""Rows for binary COPY, made of columns, are those that are made value by value."""

import math
import struct

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from msbdb.database.dialects.binarycopy import END, NUMBERS, SIGNATURE, packed_rows

FORMS = {"int8": ">q", "int4": ">i", "float8": ">d", "bool": "?"}

VALUES = {
    "int8": st.integers(-(2**63), 2**63 - 1),
    "int4": st.integers(-(2**31), 2**31 - 1),
    "float8": st.floats(),
    "bool": st.booleans(),
    "text": st.text(st.characters(exclude_categories=["Cs"])),
    "bytea": st.binary(max_size=20),
}


def in_order(kinds: list[str]) -> list[str]:
    """Return types in the order of a row: numbers first."""
    return sorted(kinds, key=lambda kind: kind not in NUMBERS)


TABLES = (
    st.lists(st.sampled_from(sorted(VALUES)), min_size=1, max_size=6)
    .map(in_order)
    .flatmap(
        lambda kinds: st.tuples(st.just(kinds), st.lists(st.tuples(*(VALUES[kind] | st.none() for kind in kinds))))
    )
)
"""The types of a table's columns, and its rows."""


def by_value(kinds: list[str], rows: list[tuple[object, ...]]) -> bytes:
    """Return the rows as PostgreSQL's manual describes the format."""
    found = [SIGNATURE]
    for row in rows:
        found.append(struct.pack(">h", len(row)))
        for kind, value in zip(kinds, row, strict=True):
            if value is None or (isinstance(value, float) and math.isnan(value)):
                found.append(struct.pack(">i", -1))
                continue
            if kind in FORMS:
                cell = struct.pack(FORMS[kind], value)
            else:
                cell = value.encode() if isinstance(value, str) else bytes(value)  # type: ignore[call-overload]
            found.append(struct.pack(">i", len(cell)) + cell)
    return b"".join([*found, END])


@given(TABLES)
def test_columns_give_the_rows_that_values_give(table: tuple[list[str], list[tuple[object, ...]]]) -> None:
    """For lists with None; and for arrays, where NaN stands for it."""
    kinds, rows = table
    kinds_by_name = {str(place): kind for place, kind in enumerate(kinds)}
    columns = [list(values) for values in zip(*rows, strict=True)] or [[] for _ in kinds]
    expected = by_value(kinds, rows)
    assert packed_rows(dict(zip(kinds_by_name, columns, strict=True)), kinds_by_name) == expected
    whole = [
        np.array(own) if kind in FORMS and None not in own and own else own
        for kind, own in zip(kinds, columns, strict=True)
    ]
    assert packed_rows(dict(zip(kinds_by_name, whole, strict=True)), kinds_by_name) == expected
