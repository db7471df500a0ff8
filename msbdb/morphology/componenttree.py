"""The component tree of an image: which connected area lies within which, from the lowest level to the highest.

A component at level h is a connected area of cells no lower than h. As h falls, components grow and join, so they
form a tree, the max-tree (Salembier et al. 1998). Built once, it answers for every threshold of every attribute.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msbdb.errors import InputError
from msbdb.labels.cellkernels import neighbour_steps
from msbdb.labels.numbering import MAX_CELLS, require_connectivity
from msbdb.morphology.area import require_valid
from msbdb.morphology.flood import flood
from msbdb.order import order_of
from msbdb.threads import kernel

NONE = -1
"""Node of a cell that belongs to no component, and of a node without the ancestor asked for."""


@dataclass(frozen=True, slots=True, eq=False)
class ComponentTree:
    """The max-tree of an image; of its valid cells, one tree for each connected area of them.

    Nodes are numbered from the root up: a parent comes before its children, and a node's descendants follow it
    without a gap. The same image gives the same numbers. All arrays are read-only.

    Parameters
    ----------
    parent : (N,) ndarray of int32
        The next larger component around each; a root is its own.
    level : (N,) ndarray
        Lowest value in each component, of the image's dtype. A node's own cells have it.
    node_of : (H, W) ndarray of int32
        The smallest component that holds the cell, at the cell's own value; -1 where the cell is invalid.
    connectivity : int
        4 or 8.

    Notes
    -----
    Memory: 4 bytes a cell, and 4 bytes beside the level a node. There are at most as many nodes as valid cells; a
    surface of floats, without plateaus, comes close.
    """

    parent: NDArray[np.int32]
    level: NDArray[Any]
    node_of: NDArray[np.int32]
    connectivity: int

    @property
    def size(self) -> int:
        """Number of nodes."""
        return self.parent.size

    @property
    def is_root(self) -> NDArray[np.bool_]:
        """(N,) bool, whether a node is a whole connected area of valid cells."""
        roots: NDArray[np.bool_] = self.parent == np.arange(self.size, dtype=np.int32)
        return roots

    def around(self, values: NDArray[Any]) -> NDArray[Any]:
        """Return (N,) what the node around each node has; a root has its own."""
        return values[self.parent]

    def outermost(self, selected: NDArray[np.bool_]) -> NDArray[np.int32]:
        """Return (N,) the largest of the selected nodes that holds each node, itself included; -1 where none."""
        return _outermost(self.parent, self._of_nodes(selected))

    def paint(self, values: NDArray[Any], *, fill: float = 0) -> NDArray[Any]:
        """Return (H, W) the value of each cell's node, in the values' dtype; ``fill`` on invalid cells."""
        if self.size == 0:
            return np.full(self.node_of.shape, fill, dtype=values.dtype)
        painted = self._of_nodes(values)[self.node_of]
        painted[self.node_of == NONE] = fill
        return painted

    def _of_nodes(self, values: NDArray[Any]) -> NDArray[Any]:
        """Refuse an array that has not one value a node."""
        if values.shape != (self.size,):
            msg = f"One value a node is needed, of {self.size}; got the shape {values.shape}."
            raise InputError(msg)
        return values


def build_tree(values: NDArray[Any], valid: NDArray[np.bool_] | None = None, *, connectivity: int = 8) -> ComponentTree:
    """Build the max-tree of an image.

    Parameters
    ----------
    values : (H, W) ndarray
        Booleans, integers or floats without NaN in valid cells. Not modified.
    valid : (H, W) ndarray of bool, optional
        The cells that count; all by default. No component holds, or reaches across, an invalid cell.
    connectivity : int
        4 or 8.

    Raises
    ------
    InputError
        When the array is no image, or the mask is not of its shape.
    ParameterError
        When the connectivity is neither 4 nor 8.

    Notes
    -----
    The cells are ordered by value and flooded from the lowest up [1]_ with a queue of priorities [2]_, here ranks.
    O(n) for n cells but for the queue: a hierarchy of words of 64 bits, whose four levels hold 16 million cells.
    Afterwards cells of equal value become nodes, from the root up.

    Border: what lies outside of the array does not exist. Nodata: invalid cells do not exist; without any valid cell
    the tree has no node. Halo: none suffices, as a component may be of any extent. The min-tree, of the pits, is the
    tree of the negative of signed numbers.

    Memory while building: about 24 bytes a cell beside the image. At most 12 of them remain, for a node a cell with a
    level of 32 bits.

    References
    ----------
    .. [1] Salembier, P., Oliveras, A., Garrido, L., 1998. Antiextensive connected operators for image and sequence
       processing. IEEE Transactions on Image Processing 7 (4), 555-570. doi:10.1109/83.663500.
    .. [2] Wilkinson, M.H.F., 2011. A fast component-tree algorithm for high dynamic-range images and second generation
       connectivity. 18th IEEE International Conference on Image Processing, 1021-1024. doi:10.1109/ICIP.2011.6115597.

    Examples
    --------
    >>> tree = build_tree(np.array([[0, 5, 5, 1, 2]]))
    >>> tree.parent, tree.level, tree.node_of
    (array([0, 0, 1, 1], dtype=int32), array([0, 1, 2, 5]), array([[0, 3, 3, 1, 2]], dtype=int32))
    """
    require_connectivity(connectivity)
    valid = require_valid(values, valid)
    rows, cols = values.shape
    if (rows + 2) * (cols + 2) > MAX_CELLS:
        msg = f"An image of {values.shape} and its frame have more than {MAX_CELLS} cells; cut it into tiles."
        raise InputError(msg)
    flat = values.ravel()
    order = _order_of_valid(flat, valid)
    width = cols + 2  # the lattice in a frame of no cells, so that no neighbour needs a check
    order += order // np.int32(cols) * np.int32(2) + np.int32(width + 1)
    rank = np.full((rows + 2) * width, NONE, dtype=np.int32)
    rank[order] = np.arange(order.size, dtype=np.int32)
    before, left = flood(rank, order, neighbour_steps(width, connectivity))
    del order
    framed = rank  # its ranks have served
    parent, leaders = _make_nodes(before, left, _comparable(flat), framed, width)
    node_of = np.ascontiguousarray(framed.reshape(rows + 2, width)[1:-1, 1:-1])
    return _read_only(ComponentTree(parent, flat[leaders], node_of, connectivity))


def areas(tree: ComponentTree) -> NDArray[np.int32]:
    """Return (N,) the area of each component, cells."""
    return _sum_up(tree.parent, _count(tree.node_of.ravel(), tree.size))


def sums(tree: ComponentTree, field: NDArray[Any]) -> NDArray[np.float64]:
    """Return (N,) the sum over each component of an (H, W) field, which has to be finite on the tree's cells.

    The sums have 64 bits, and are taken in row-major order within a node, then from the highest node down. Where the
    field is nowhere negative the sum is increasing, in rounded numbers too.
    """
    return _sum_up(tree.parent, _add(tree.node_of.ravel(), _field(tree, field), tree.size))


def is_increasing(tree: ComponentTree, attribute: NDArray[Any]) -> bool:
    """Return whether no component has more than the component around it (Mongus et al. 2013, Eq. 3; M4)."""
    return bool((attribute <= tree.around(attribute)).all())


def _order_of_valid(flat: NDArray[Any], valid: NDArray[np.bool_] | None) -> NDArray[np.int32]:
    """Return the valid cells from the lowest to the highest."""
    if valid is None:
        return order_of(flat, descending=False)
    cells = np.flatnonzero(valid).astype(np.int32)
    return cells[order_of(flat[cells], descending=False)]


def _comparable(values: NDArray[Any]) -> NDArray[Any]:
    """Return numbers that are equal where the values are, of one of the few dtypes that the kernel is compiled for."""
    bits = 32 if values.dtype.itemsize <= 4 else 64
    return values.astype(f"{'f' if values.dtype.kind == 'f' else 'i'}{bits // 8}", copy=False)


def _read_only(tree: ComponentTree) -> ComponentTree:
    """Return the tree, whose arrays nobody can change any more."""
    for array in (tree.parent, tree.level, tree.node_of):
        array.flags.writeable = False
    return tree


def _field(tree: ComponentTree, field: NDArray[Any]) -> NDArray[Any]:
    """Return a field as a row of numbers; refuse one of another shape, or not finite on the tree's cells."""
    if field.shape != tree.node_of.shape:
        msg = f"The field must be of the tree's shape {tree.node_of.shape}; got {field.shape}."
        raise InputError(msg)
    if field.dtype.kind == "f":
        wrong = ~np.isfinite(field)
        if wrong.any() and (wrong & (tree.node_of != NONE)).any():
            msg = f"The field is not finite in {np.sum(wrong & (tree.node_of != NONE))} valid cells; fill them."
            raise InputError(msg)
    return field.ravel()


@kernel
def _make_nodes(
    parent: NDArray[np.int32], left: NDArray[np.int32], values: NDArray[Any], node_of: NDArray[np.int32], width: int
) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Give the nodes numbers from the root up; return the parent of each, and a cell that has its level.

    Cells come in the order in which the flood left them. A cell of its parent's value belongs to the parent's node.
    ``node_of`` gets each cell's node; what is no cell keeps its negative mark.
    """
    parents = np.empty(left.size, dtype=np.int32)
    leaders = np.empty(left.size, dtype=np.int32)
    count = 0
    # The flood leaves a cell after all cells above it, so in reverse each parent has its node before its children.
    for position in range(left.size - 1, -1, -1):
        cell = left[position]
        other = parent[cell]
        index = cell - cell // width * 2 - width + 1  # the cell's place in the image without its frame
        if other != cell and values[index] == values[other - other // width * 2 - width + 1]:
            node_of[cell] = node_of[other]
        else:
            parents[count] = count if other == cell else node_of[other]
            leaders[count] = index
            node_of[cell] = count
            count += 1
    return parents[:count].copy(), leaders[:count].copy()


@kernel
def _count(node_of: NDArray[np.int32], size: int) -> NDArray[np.int32]:
    """Count each node's own cells."""
    count = np.zeros(size, dtype=np.int32)
    for node in node_of:
        if node != NONE:
            count[node] += 1
    return count


@kernel
def _add(node_of: NDArray[np.int32], field: NDArray[Any], size: int) -> NDArray[np.float64]:
    """Add up each node's own cells."""
    total = np.zeros(size, dtype=np.float64)
    for cell, node in enumerate(node_of):
        if node != NONE:
            total[node] += field[cell]
    return total


@kernel
def _sum_up(parent: NDArray[np.int32], total: NDArray[Any]) -> NDArray[Any]:
    """Add the children to each node, in place."""
    # Children have higher numbers than their parents, so a node is complete before it is added to its parent.
    for node in range(parent.size - 1, -1, -1):
        if parent[node] != node:
            total[parent[node]] += total[node]
    return total


@kernel
def _outermost(parent: NDArray[np.int32], selected: NDArray[np.bool_]) -> NDArray[np.int32]:
    """Take what was found for the parent, which has a lower number, else the node itself where it is selected."""
    found = np.empty(parent.size, dtype=np.int32)
    for node in range(parent.size):
        found[node] = NONE if parent[node] == node else found[parent[node]]
        if found[node] == NONE and selected[node]:
            found[node] = node
    return found
