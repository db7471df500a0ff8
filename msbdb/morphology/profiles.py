"""Differential attribute profiles: at which size of an attribute a surface changes most (Mongus et al. 2013, §2).

A profile takes the differences between openings of growing size. All its zones are read from one component tree:
along the way from a cell to the root the attribute grows, so each zone is a stretch of it.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from msbdb.errors import InputError, ParameterError
from msbdb.morphology.componenttree import NONE, ComponentTree, is_increasing
from msbdb.threads import kernel

MAX_ZONES = 2**15 - 2
"""Zones and one more, for what remains, are counted in 16 bits."""


class Theta(NamedTuple):
    """What characterises each cell in a profile, θ(g) (Eq. 4 and 5; M5).

    Parameters
    ----------
    response : (H, W) ndarray of float64
        r, the highest response of any zone, in the unit of the surface; 0 in invalid cells.
    zone : (H, W) ndarray of int16
        q, the largest zone i, from 1, with that response; 0 where no zone responds. There Eq. 5 to the letter gives
        the last zone, which would not be told from a response of it.
    """

    response: NDArray[np.float64]
    zone: NDArray[np.int16]


@dataclass(frozen=True, slots=True, eq=False)
class AttributeProfile:
    """The differential attribute profile of a surface: zones of its component tree (Eq. 2; M3).

    Parameters
    ----------
    tree : ComponentTree
        The tree of N nodes.
    thresholds : (I + 1,) ndarray of float64
        λ_0 = 0 < λ_1 < ... < λ_I.
    zone : (N,) ndarray of int16
        The zone i that takes each node away: λ_{i-1} ≤ Λ < λ_i. I + 1 for what remains after all: nodes of λ_I
        and more, and the roots, at which an opening is flat when nothing is large enough.
    outside : (N,) ndarray of int32
        The smallest node around each that its zone leaves; a node that remains has itself.

    Notes
    -----
    δ_i(g) = γ_{λ_{i-1}}(g) - γ_{λ_i}(g). At a cell of node n, δ_i is the level of the smallest node around n of zone
    i, if any, less the level outside of it. So δ_i > 0 just within the nodes of zone i that lie in no other of it.
    Each of these is connected and no two of them touch: were they neighbours, the lower one's level would join them.
    They are therefore the components of {δ_i > 0}, known without labelling, each with all attributes of its node.

    Differences are of 64 bits: without rounding for integers of 32 bits, and for floats of 32 bits that are multiples
    of one unit, as measured heights are, and fewer than 2^53 units apart.
    """

    tree: ComponentTree
    thresholds: NDArray[np.float64]
    zone: NDArray[np.int16]
    outside: NDArray[np.int32]

    @property
    def zones(self) -> int:
        """I, the number of zones."""
        return self.thresholds.size - 1

    def opening(self, i: int) -> NDArray[Any]:
        """Return (H, W) the opening by λ_i, of the surface's dtype; i = 0 gives the surface, i = I the residual."""
        self._require_zone(i, first=0)
        return _painted_levels(self.tree, self.zone > i)

    def response(self, i: int) -> NDArray[np.float64]:
        """Return (H, W) the response δ_i of zone i, from 1 to I (Eq. 2)."""
        self._require_zone(i, first=1)
        difference: NDArray[np.float64] = np.subtract(self.opening(i - 1), self.opening(i), dtype=np.float64)
        return difference

    def theta(self) -> Theta:
        """Return the highest response of each cell and its zone (Eq. 4, 5; M5), for all zones at once."""
        level = self.tree.level
        level = level.astype(np.result_type(level.dtype, np.float32), copy=False)
        strongest = _find_strongest(level, self.outside)
        node_of = self.tree.node_of
        response, zone = _paint_strongest(node_of.ravel(), strongest, level, self.zone, self.outside)
        return Theta(response.reshape(node_of.shape), zone.reshape(node_of.shape))

    def components(self) -> NDArray[np.bool_]:
        """Return (N,) bool, whether a node is a component of the support {δ_i > 0} of its zone i (Eq. 13; M16)."""
        return _find_components(self.tree, self.zone, self.zones + 1)

    def filter_supports(self, attribute: NDArray[Any], least: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Keep the components of every zone's support that have enough of an attribute (Eq. 14; M17).

        Parameters
        ----------
        attribute : (N,) ndarray
            What each node has: its area for the area opening of Eq. 14. It need not be increasing.
        least : (I + 1,) ndarray of float64
            What a component of zone i must have at least; R · λ_i for Eq. 14. Position 0 has no zone.

        Returns
        -------
        (N,) ndarray of bool
            The components kept, among those of `components`; to be read by `union`.
        """
        if least.shape != self.thresholds.shape:
            msg = f"One value for each of {self.zones} zones is needed, after one that is unused; got {least.shape}."
            raise InputError(msg)
        return self.components() & (attribute >= np.append(least, np.inf)[self.zone])

    def union(self, kept: NDArray[np.bool_]) -> NDArray[np.int32]:
        """Return (H, W) the union of all zones' kept components: at each cell the largest one's node, -1 outside.

        Two components are apart or one is in the other, so the largest ones are the components of the union G
        (Eq. 14; M18). Where the smallest one is asked for instead, paint ``tree.innermost(kept)``.
        """
        return self.tree.paint(self.tree.outermost(kept), fill=NONE)

    def _require_zone(self, i: int, *, first: int) -> None:
        """Refuse a zone that the profile does not have."""
        if not first <= i <= self.zones:
            msg = f"The profile has the zones {first} to {self.zones}; got {i}."
            raise ParameterError(msg)


def attribute_filter(tree: ComponentTree, keep: NDArray[np.bool_]) -> NDArray[Any]:
    """Return (H, W) the image without the nodes that are not kept: their cells fall to what is kept around them.

    For an attribute that is not increasing, as one of shape, this is the direct rule. Roots always stay. Invalid
    cells become 0.

    Parameters
    ----------
    tree : ComponentTree
        Of N nodes.
    keep : (N,) ndarray of bool
        The nodes to keep.
    """
    return _painted_levels(tree, keep | tree.is_root)


def attribute_opening(tree: ComponentTree, attribute: NDArray[Any], threshold: float) -> NDArray[Any]:
    """Return (H, W) the opening γ_λ that keeps the components of at least λ (Mongus et al. 2013, §2; M3).

    Parameters
    ----------
    tree : ComponentTree
        Of N nodes.
    attribute : (N,) ndarray
        An increasing attribute, such as `areas` or the `sums` of a field that is not negative.
    threshold : float
        λ, in the attribute's unit.

    Returns
    -------
    (H, W) ndarray
        Of the image's dtype; values of the image. 0 in invalid cells.

    Raises
    ------
    InputError
        When the attribute is not increasing.

    Notes
    -----
    Where no component has λ, the result is flat at the lowest value of the connected area of valid cells. Complexity:
    linear in nodes and cells.

    Examples
    --------
    >>> from msbdb.morphology import areas, build_tree
    >>> tree = build_tree(np.array([[0, 5, 0, 3, 3]]))
    >>> attribute_opening(tree, areas(tree), 2)
    array([[0, 0, 0, 3, 3]])
    """
    _require_increasing(tree, attribute)
    return attribute_filter(tree, attribute >= threshold)


def build_profile(
    tree: ComponentTree, attribute: NDArray[Any], thresholds: Sequence[float] | NDArray[np.float64]
) -> AttributeProfile:
    """Sort the nodes of a tree into the zones of a differential attribute profile (Eq. 2; M3).

    Parameters
    ----------
    tree : ComponentTree
        Of N nodes, with finite levels.
    attribute : (N,) ndarray
        Λ of each node: increasing (Eq. 3; M4), 0 or more.
    thresholds : sequence of float
        λ_0 = 0 and increasing; as `zone_thresholds` gives them.

    Raises
    ------
    InputError
        When the attribute is not increasing or negative, or the image has infinite values.
    ParameterError
        When the thresholds do not start at 0, do not increase or are too many.

    Notes
    -----
    Complexity: two passes over the nodes, whatever the number of zones. Memory: 6 bytes a node; 4 a
    node and 10 a cell beside for `theta`.

    Examples
    --------
    >>> from msbdb.morphology import areas, build_tree
    >>> tree = build_tree(np.array([[0, 2, 7, 7, 2, 0]]))
    >>> profile = build_profile(tree, areas(tree), [0, 3, 5])
    >>> profile.response(1), profile.response(2)
    (array([[0., 0., 5., 5., 0., 0.]]), array([[0., 2., 2., 2., 2., 0.]]))
    >>> profile.theta().zone
    array([[0, 2, 1, 1, 2, 0]], dtype=int16)
    """
    limits = _require_thresholds(thresholds)
    _require_increasing(tree, attribute)
    if not np.isfinite(tree.level).all():
        msg = "The surface has infinite values, which have no differences; mask them."
        raise InputError(msg)
    if (attribute < 0).any():
        msg = f"The attribute of a profile must not be negative; got {attribute.min()}."
        raise InputError(msg)
    zone = _find_zones(attribute, limits)
    zone[tree.is_root] = limits.size
    outside = tree.outside(_find_components(tree, zone, limits.size))
    for array in (zone, outside):
        array.flags.writeable = False
    return AttributeProfile(tree, limits, zone, outside)


def zone_thresholds(least: float, most: float, step: float) -> NDArray[np.float64]:
    """Return λ = {0, λ_min, λ_min + λ_Δ, λ_min + 2 λ_Δ, ..., λ_max} (Eq. 12; M15).

    The last zone is narrower than the others where λ_max is no whole number of steps from λ_min.

    Raises
    ------
    ParameterError
        When λ_min or λ_Δ is not above 0, λ_max is below λ_min, or the zones are too many.

    Examples
    --------
    >>> zone_thresholds(30, 600, 250)
    array([  0.,  30., 280., 530., 600.])
    """
    if not (np.isfinite([least, most, step]).all() and 0 < least <= most and step > 0):
        msg = (
            "The zones of a profile need 0 < λ_min ≤ λ_max and a step λ_Δ above 0, all finite; "
            f"got λ_min = {least}, λ_max = {most} and λ_Δ = {step}."
        )
        raise ParameterError(msg)
    steps = (most - least) / step
    if steps > MAX_ZONES:
        msg = f"A profile has at most {MAX_ZONES} zones; λ_Δ = {step} up to λ_max = {most} gives {steps:.0f}."
        raise ParameterError(msg)
    inner = least + step * np.arange(int(steps) + 1)
    # A last step that only rounding keeps from λ_max is λ_max.
    return _require_thresholds(np.concatenate([[0.0], inner[inner < most - 1e-9 * step], [most]]))


def _find_components(tree: ComponentTree, zone: NDArray[np.int16], rest: int) -> NDArray[np.bool_]:
    """Return (N,) bool, whether a node is of a zone, not of the rest, and the node around it is of a higher one."""
    found: NDArray[np.bool_] = (zone < rest) & (zone < tree.around(zone))
    return found


def _painted_levels(tree: ComponentTree, kept: NDArray[np.bool_]) -> NDArray[Any]:
    """Return each cell's level of the smallest kept node around it, of which a root is always one."""
    return tree.paint(tree.level[tree.innermost(kept)])


def _require_increasing(tree: ComponentTree, attribute: NDArray[Any]) -> None:
    """Refuse an attribute of which some component has more than the component around it."""
    if attribute.shape != (tree.size,):
        msg = f"The attribute needs one value a node, of {tree.size}; got the shape {attribute.shape}."
        raise InputError(msg)
    if not is_increasing(tree, attribute):
        msg = (
            "The attribute must be increasing, but some component has more of it than the component around it; "
            "sum a field that is nowhere negative, or use attribute_filter."
        )
        raise InputError(msg)


def _require_thresholds(thresholds: Sequence[float] | NDArray[np.float64]) -> NDArray[np.float64]:
    """Refuse thresholds that make no zones; return them as a read-only array."""
    limits = np.array(thresholds, dtype=np.float64)
    if limits.ndim != 1 or not 2 <= limits.size <= MAX_ZONES + 1 or limits[0] != 0 or not (np.diff(limits) > 0).all():
        msg = f"The thresholds of a profile must be 2 to {MAX_ZONES + 1} numbers, from 0 up; got {thresholds!r}."
        raise ParameterError(msg)
    limits.flags.writeable = False
    return limits


@kernel
def _find_zones(attribute: NDArray[Any], limits: NDArray[np.float64]) -> NDArray[np.int16]:
    """Return for each node the number of limits that it reaches, by halving the interval."""
    zone = np.empty(attribute.size, dtype=np.int16)
    for node in range(attribute.size):
        low, high = 0, limits.size
        while low < high:
            middle = (low + high) // 2
            if attribute[node] < limits[middle]:
                high = middle
            else:
                low = middle + 1
        zone[node] = low
    return zone


@kernel
def _find_strongest(level: NDArray[Any], outside: NDArray[np.int32]) -> NDArray[np.int32]:
    """Return for each node the one around it, or itself, whose zone responds most.

    A node's own zone is followed by those of the node outside, which comes first. Of equal responses the one of the
    higher zone stays.
    """
    strongest = np.empty(level.size, dtype=np.int32)
    for node in range(level.size):
        other = outside[node]
        rival = strongest[other] if other != node else node
        own = np.float64(level[node]) - np.float64(level[other])
        strongest[node] = node if own > np.float64(level[rival]) - np.float64(level[outside[rival]]) else rival
    return strongest


@kernel
def _paint_strongest(
    node_of: NDArray[np.int32],
    strongest: NDArray[np.int32],
    level: NDArray[Any],
    zone: NDArray[np.int16],
    outside: NDArray[np.int32],
) -> tuple[NDArray[np.float64], NDArray[np.int16]]:
    """Return each cell's strongest response and its zone; 0 where the cell has no node or no zone responds."""
    response = np.zeros(node_of.size, dtype=np.float64)
    characteristic = np.zeros(node_of.size, dtype=np.int16)
    for cell, node in enumerate(node_of):
        if node != NONE:
            best = strongest[node]
            if outside[best] != best:
                response[cell] = np.float64(level[best]) - np.float64(level[outside[best]])
                characteristic[cell] = zone[best]
    return response, characteristic
