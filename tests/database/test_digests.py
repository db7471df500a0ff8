"""The digest of a table in shares takes the bytes of the whole table in its order."""

import errno

import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st

from msbdb.database.runs.digests import column_bytes, ordered, spooled
from msbdb.errors import FileError
from msbdb.tables import BUILDING, REJECTION

WORDS = ["eaves", "a ridge", "größer", "a", "", 'with "quotes"', None]


def content(columns, limits, table):
    """Return what the digest takes, each column's pieces together."""
    return {name: b"".join(pieces) for name, pieces in spooled(columns, table, np.array(limits, dtype=np.int64))}


@given(st.data(), st.lists(st.integers(-20, 20), max_size=40, unique=True), st.lists(st.integers(-25, 25), max_size=5))
def test_rows_in_any_chunks_and_shares_give_the_bytes_of_the_whole_table(data, keys, limits):
    """Whole numbers that are missing in one chunk alone, texts, missing texts and outlines are as in one table."""
    count = len(keys)
    numbers = np.array(data.draw(st.lists(st.sampled_from([0, 7, -3, None]), min_size=count, max_size=count)), object)
    words = np.array([*data.draw(st.lists(st.sampled_from(WORDS), min_size=count, max_size=count)), ""], object)[:-1]
    squares = [shapely.MultiPolygon([shapely.box(key, 0, key + 1 + abs(key), 1)]) for key in keys]
    whole = {
        "building_id": np.array(keys, dtype=np.int64),
        "storeys": numbers,
        "state": words,
        "geometry": np.array([*(shapely.to_wkb(one, byte_order=1) for one in squares), b""], object)[:-1],
    }
    cuts = sorted(data.draw(st.lists(st.integers(0, count), max_size=4)))

    def typed(columns):
        """Return the columns with the missing whole numbers as the checks of a build return them."""
        is_missing = any(one is None for one in columns["storeys"])
        return columns | {"storeys": columns["storeys"].astype(np.float64 if is_missing else np.int64)}

    pieces = [np.split(values, cuts) for values in whole.values()]
    chunks = [typed(dict(zip(whole, one, strict=True))) for one in zip(*pieces, strict=True)]
    expected = {name: column_bytes(name, values) for name, values in ordered(typed(whole), BUILDING).items()}
    assert content(chunks, sorted(set(limits)), BUILDING) == expected


def test_rows_of_equal_keys_are_ordered_by_the_next_columns():
    """Regions that were dropped have no keys: many rows may be equal in the first column."""
    whole = {
        "region_id": np.array([0, 5, 0, 0, 5], dtype=np.int64),
        "method": np.array(["b", "a", "a", "a b", "a"], object),
        "stage": np.array(["s"] * 5, object),
        "reason": np.array(["r"] * 5, object),
        "scale": np.array([3, 2, 1, 1, 1], dtype=np.int64),
        "area_m2": np.arange(5.0),
        "xcen": np.zeros(5),
        "ycen": np.full(5, np.nan),
    }
    chunks = [{name: values[part] for name, values in whole.items()} for part in (slice(0, 2), slice(2, 5))]
    expected = {name: column_bytes(name, values) for name, values in ordered(whole, REJECTION).items()}
    assert content(chunks, [3], REJECTION) == expected


def test_a_full_folder_of_temporary_files_is_named(monkeypatch):
    """The message says what needs the room and how to give it; the rows' own errors stay as they are."""
    chunk = {"building_id": np.arange(3, dtype=np.int64)}

    def is_full(*_args, **_kwargs):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("msbdb.database.runs.digests.np.save", is_full)
    with pytest.raises(FileError, match=r"table building .*No space left on device.*TMPDIR"):
        content([chunk], [], BUILDING)

    def lost():
        yield from ()
        msg = "a tile's result"
        raise FileNotFoundError(msg)

    with pytest.raises(FileNotFoundError, match="a tile's result"):
        content(lost(), [], BUILDING)
