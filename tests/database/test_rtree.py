"""Packed R-trees, held to SQLite's own module."""

import numpy as np
import pytest

from msbdb.database.rtree import pack
from msbdb.database.spatialite import _driver

TREE = "CREATE VIRTUAL TABLE tree USING rtree(pkid, xmin, xmax, ymin, ymax)"
SIZES = [0, 1, 2, 51, 52, 103, 2601, 2602, 6000]
"""About the numbers that fill a node of 51 cells, and a tree of two levels."""


def boxes_of(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return rows and boxes of up to 30 m, some of them points, on both sides of zero."""
    rng = np.random.default_rng(count)
    west, south = rng.uniform(-1e6, 1e6, count), rng.uniform(4e6, 5e6, count)
    width = rng.choice([0.0, 30.0], count)
    return rng.choice(2**59, count, replace=False), np.column_stack([west, west + width, south, south + width])


def written(rows: np.ndarray, boxes: np.ndarray):
    """Return a connection whose R-tree holds the packed boxes."""
    connection = _driver().connect(":memory:", isolation_level=None)
    connection.execute(TREE)
    [[node_bytes]] = connection.execute("SELECT length(data) FROM tree_node").fetchall()
    packed = pack(rows, boxes, node_bytes)
    connection.execute("BEGIN")
    for part, content in (("node", packed.nodes), ("rowid", packed.leaves), ("parent", packed.fathers)):
        connection.execute(f"DELETE FROM tree_{part}")
        connection.executemany(f"INSERT INTO tree_{part} VALUES (?, ?)", content)
    connection.execute("COMMIT")
    return connection


def in_window(connection, west: float, east: float, south: float, north: float) -> list[int]:
    """Return the rows whose boxes meet a window."""
    query = "SELECT pkid FROM tree WHERE xmax >= ? AND xmin <= ? AND ymax >= ? AND ymin <= ? ORDER BY pkid"
    return [row for (row,) in connection.execute(query, (west, east, south, north))]


@pytest.mark.parametrize("count", SIZES)
def test_sqlite_finds_what_was_packed(count):
    """SQLite's check finds no fault, and a window has what lies in it."""
    rows, boxes = boxes_of(count)
    tree = written(rows, boxes)
    assert tree.execute("SELECT rtreecheck('tree')").fetchall() == [("ok",)]
    assert in_window(tree, -2e6, 2e6, 3e6, 6e6) == sorted(rows.tolist())
    window = (-2e5, 3e5, 4.2e6, 4.6e6)
    meets = (boxes[:, 1] >= window[0]) & (boxes[:, 0] <= window[1])
    meets &= (boxes[:, 3] >= window[2]) & (boxes[:, 2] <= window[3])
    assert in_window(tree, *window) == sorted(rows[meets].tolist())


def test_a_box_is_found_at_its_very_corners():
    """Rounding to four bytes loses none: a window that is a single corner finds the box."""
    rows, boxes = boxes_of(300)
    tree = written(rows, boxes)
    for row, (west, east, south, north) in zip(rows.tolist(), boxes.tolist(), strict=True):
        assert row in in_window(tree, west, west, south, south)
        assert row in in_window(tree, east, east, north, north)


@pytest.mark.parametrize("count", SIZES)
def test_the_tree_lives_on(count):
    """SQLite takes rows out of a packed tree and puts others in."""
    rows, boxes = boxes_of(count)
    tree = written(rows, boxes)
    tree.executemany("DELETE FROM tree WHERE pkid = ?", [(row,) for row in rows[: count // 2].tolist()])
    tree.executemany("INSERT INTO tree VALUES (?, ?, ?, ?, ?)", [(-n, n, n, n, n) for n in range(1, 201)])
    assert tree.execute("SELECT rtreecheck('tree')").fetchall() == [("ok",)]
    assert tree.execute("SELECT count(*) FROM tree").fetchall() == [(count - count // 2 + 200,)]


def test_the_order_of_the_boxes_is_of_no_matter():
    """Shuffled boxes give the same tables."""
    rows, boxes = boxes_of(500)
    order = np.random.default_rng(1).permutation(500)
    assert pack(rows[order], boxes[order], 1228) == pack(rows, boxes, 1228)
