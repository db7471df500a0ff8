"""The minimum cut: the cheapest division of cells into two kinds, under costs of each cell and of each pair."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from msbdb.errors import ParameterError

if TYPE_CHECKING:
    from scipy.sparse import csr_matrix

Nodes = NDArray[np.int32]
Costs = NDArray[np.float64]
Place = tuple[slice, slice]

UNITS = 256
"""Costs are rounded to this part of 1, so that the cut is exact and the same on all machines."""

GROUP = 20_000
"""Ours: parts of a network that are not connected are solved by themselves, small ones together up to so many nodes."""


@dataclass(frozen=True, slots=True, eq=False)
class Pairs:
    """Costs of M pairs of neighbours, by the kinds of the two.

    Parameters
    ----------
    first, second : (M,) ndarray of int32
        Numbers of the nodes.
    both_0, only_second, only_first, both_1 : (M,) ndarray of float64
        Costs when both are of kind 0, when only the second or only the first is of kind 1, and when both are.
        ``both_0 + both_1`` is at most ``only_second + only_first``: otherwise no minimum cut exists.
    """

    first: Nodes
    second: Nodes
    both_0: Costs
    only_second: Costs
    only_first: Costs
    both_1: Costs


def neighbours(shape: tuple[int, ...]) -> tuple[tuple[Place, Place], tuple[Place, Place]]:
    """Return the cells that have a neighbour to the right, with these neighbours, and those that have one below.

    Examples
    --------
    >>> image = np.array([[1, 2, 3], [4, 5, 6]])
    >>> for cells, beside in neighbours(image.shape):
    ...     (image[beside] - image[cells]).tolist()
    [[1, 1], [1, 1]]
    [[3, 3, 3]]
    """
    height, width = shape
    every = slice(None)
    across = (every, slice(0, width - 1)), (every, slice(1, width))
    down = (slice(0, height - 1), every), (slice(1, height), every)
    return across, down


def minimum_cut(costs: Costs, pairs: Pairs) -> NDArray[np.bool_]:
    """Divide nodes into two kinds at the least total cost.

    Parameters
    ----------
    costs : (N,) ndarray of float64
        What each node costs as kind 1, less what it costs as kind 0.
    pairs : Pairs
        Costs of the pairs of neighbours.

    Returns
    -------
    (N,) ndarray of bool
        The nodes of kind 1. Of several cheapest divisions, the one with the fewest of them.

    Raises
    ------
    ParameterError
        When unlike kinds would cost less than like ones in some pair.

    Notes
    -----
    The least cost is the largest flow through a network (Kolmogorov and Zabih 2004), which SciPy finds by Dinic's
    algorithm. All costs are rounded to 1/256. The flow must stay below 2^31 of these: that holds for a million cells
    whose costs are some tens. Parts that no pair connects have flows of their own, and the same division as together.

    Examples
    --------
    Four cells in a row. The first must be of kind 0, the last should be of kind 1, and a change costs 1, except
    between the second and the third:

    >>> edge = np.array([1.0, 0.25, 1.0])
    >>> none = np.zeros(3)
    >>> row = Pairs(np.arange(3, dtype=np.int32), np.arange(1, 4, dtype=np.int32), none, edge, edge, none)
    >>> minimum_cut(np.array([9.0, 0, 0, -0.5]), row)
    array([False, False,  True,  True])

    References
    ----------
    Kolmogorov, V., Zabih, R. (2004). What energy functions can be minimized via graph cuts? IEEE TPAMI 26(2), 147-159.
    doi:10.1109/TPAMI.2004.1262177
    """
    parts = (pairs.both_0, pairs.only_second, pairs.only_first, pairs.both_1)
    both_0, only_second, only_first, both_1 = (np.rint(part * UNITS).astype(np.int64) for part in parts)
    link = only_second + only_first - both_0 - both_1
    if (link < 0).any():
        msg = (
            "A minimum cut needs pairs in which like kinds cost no more than unlike ones; "
            f"{np.count_nonzero(link < 0)} of {link.size} pairs differ. Check the costs of the pairs."
        )
        raise ParameterError(msg)
    count = len(costs)
    # What a pair costs beside its link is a cost of its nodes: kind 1 of the first changes it by only_first - both_0,
    # kind 1 of the second, when the first has it, by both_1 - only_first.
    own = np.rint(costs * UNITS).astype(np.int64)
    own += _added(pairs.first, only_first - both_0, count) + _added(pairs.second, both_1 - only_first, count)
    # Along the order nodes of a group are neighbours, and so are the links between them.
    order, ends = _groups(count, pairs.first, pairs.second)
    place = np.empty(count, dtype=np.int32)
    place[order] = np.arange(count, dtype=np.int32)
    first, second = place[pairs.first], place[pairs.second]
    along = np.argsort(first, kind="stable")
    first, second, link, own = first[along], second[along], link[along], own[order]
    kinds = np.empty(count, dtype=np.bool_)
    begin = 0
    for end in ends.tolist():
        held = slice(*np.searchsorted(first, (begin, end)).tolist())
        kinds[order[begin:end]] = _cheapest(own[begin:end], first[held] - begin, second[held] - begin, link[held])
        begin = end
    return kinds


def _groups(count: int, first: Nodes, second: Nodes) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the nodes group by group, and where each group ends: nodes of two groups are not connected.

    The flow looks at all nodes as often as the farthest of them need, so that small networks take less time.
    """
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    graph = coo_matrix((np.ones(first.size, dtype=np.bool_), (first, second)), shape=(count, count))
    _, numbers = connected_components(graph, directed=False)
    ends = np.cumsum(np.bincount(numbers))
    # A component ends the group in which it reaches the next multiple of the size.
    last = np.flatnonzero(np.diff(ends // GROUP, append=-1))
    return np.argsort(numbers, kind="stable"), ends[last]


def _cheapest(own: NDArray[np.int64], first: Nodes, second: Nodes, link: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Return the nodes of kind 1 of a network, by what each costs and what divides each link."""
    from scipy.sparse.csgraph import breadth_first_order, maximum_flow

    count = own.size
    network = _network(own, first, second, link)
    flow = maximum_flow(network, count, count + 1, method="dinic").flow
    left = network - flow
    left.data[left.data < 0] = 0
    left.eliminate_zeros()
    # Kind 1 is what still reaches the sink: the smallest such set.
    reached = breadth_first_order(left.T.tocsr(), count + 1, return_predecessors=False)
    kinds = np.zeros(count + 2, dtype=np.bool_)
    kinds[reached] = True
    return kinds[:count]


def _added(nodes: Nodes, amounts: NDArray[np.int64], count: int) -> NDArray[np.int64]:
    """Sum amounts by node; exact, as whole numbers below 2^53 are in float64."""
    return np.bincount(nodes, weights=amounts, minlength=count).astype(np.int64)


def _network(own: NDArray[np.int64], first: Nodes, second: Nodes, link: NDArray[np.int64]) -> "csr_matrix":
    """Return the capacities: source ``N`` to nodes that kind 1 costs, nodes that kind 0 costs to sink ``N + 1``."""
    from scipy.sparse import coo_matrix

    count = own.size
    dear, cheap = np.flatnonzero(own > 0), np.flatnonzero(own < 0)
    tails = np.concatenate([first, np.full(dear.size, count), cheap])
    heads = np.concatenate([second, dear, np.full(cheap.size, count + 1)])
    capacities = np.concatenate([link, own[dear], -own[cheap]])
    network = coo_matrix((capacities, (tails, heads)), shape=(count + 2, count + 2)).tocsr()
    network.sum_duplicates()
    network.eliminate_zeros()
    return network.astype(np.int32)
