"""Chains: the distinct arcs of traced outlines, a vertex a cell, with their nodes and the regions beside them."""

from dataclasses import dataclass, replace

import numpy as np
import shapely
from numpy.typing import NDArray

from msbdb.grid import GridSpec
from msbdb.outline.arcs import Arcs, border_sides, cells_of
from msbdb.outline.runs import WallRuns

Ints = NDArray[np.int64]
Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Chains:
    """The distinct arcs in canonical direction, with a vertex at each cell.

    Attributes
    ----------
    own : (O,) ndarray of int64
        The arc of each occurrence in a ring.
    places : columns, rows, offsets
        The vertices of the arcs, cells, ends included.
    nodes : (A,) tail, (A,) head, (N, 2) places
        The nodes at the ends, -1 for rings without one.
    regions : (A, 2) ndarray of int64
        The geometries on both sides, -1 for none.
    border : (A,) ndarray of bool
        The arc runs along the border of the lattice: it is a cut, and no wall.
    """

    own: Ints
    places: tuple[Floats, Floats, Ints]
    nodes: tuple[Ints, Ints, Floats]
    regions: Ints
    border: NDArray[np.bool_]

    @property
    def count(self) -> int:
        """Number of arcs."""
        return len(self.regions)


def traced_chains(arcs: Arcs, spec: GridSpec) -> Chains:
    """Return the distinct arcs, a vertex a cell."""
    _, first, own = np.unique(arcs.key, return_index=True, return_inverse=True)
    given = arcs.as_given()
    lines = given.lines(first)
    backwards = ~arcs.forward[first]
    lines[backwards] = shapely.reverse(lines[backwards])
    coords, arc = shapely.get_coordinates(lines, return_index=True)
    corners = cells_of(coords, spec)
    step = np.zeros_like(corners)
    inner = arc[1:] == arc[:-1]
    step[:-1][inner] = np.diff(corners, axis=0)[inner]
    length = np.maximum(np.abs(step).sum(axis=1), 1)
    index = np.repeat(np.arange(len(corners)), length)
    along = np.arange(len(index)) - np.repeat(np.cumsum(length) - length, length)
    dense = corners[index] + np.sign(step)[index] * along[:, None]
    starts = np.concatenate(([0], np.cumsum(np.bincount(arc[index], minlength=len(first)))))
    regions = np.full((len(first), 2), -1)
    regions[:, 0] = arcs.geometry[first]
    second = np.setdiff1d(np.arange(len(own)), first)
    regions[own[second], 1] = arcs.geometry[second]
    nodes = _nodes(dense[starts[:-1]], dense[starts[1:] - 1])
    border = np.asarray(border_sides(dense, np.arange(1, len(dense)), spec).any(axis=0))[starts[:-1]]
    return Chains(own.astype(np.int64), (*dense.T.astype(np.float64), starts), nodes, regions, border)


def _nodes(tail: Ints, head: Ints) -> tuple[Ints, Ints, Floats]:
    """Return the nodes at the ends of the arcs; the place where a ring begins that meets no other arc is none."""
    places, node = np.unique(np.concatenate((tail, head)), axis=0, return_inverse=True)
    node = node.reshape(2, -1)
    alone = (node[0] == node[1]) & (np.bincount(node.ravel())[node[0]] == 2)
    node[:, alone] = -1
    return node[0], node[1], places.astype(np.float64)


def from_corners(chains: Chains, runs: WallRuns) -> Chains:
    """Return chains whose rings begin between two walls: where the shorter of both is longest."""
    x, y, starts = chains.places
    x, y = x.copy(), y.copy()
    ring = chains.nodes[0][runs.arc] < 0
    inner = np.flatnonzero(ring[1:] & (runs.arc[1:] == runs.arc[:-1])) + 1
    size = runs.end - runs.begin
    shorter = np.minimum(size[inner], size[inner - 1])
    best = inner[np.lexsort((-inner, shorter, runs.arc[inner]))]
    best = best[np.flatnonzero(np.diff(runs.arc[best], append=-1))]
    for run in best:
        arc, begin = runs.arc[run], runs.begin[run]
        low, high = starts[arc], starts[arc + 1]
        for values in (x, y):
            values[low : high - 1] = np.roll(values[low : high - 1], -begin)
            values[high - 1] = values[low]
    return replace(chains, places=(x, y, starts))
