"""Differential attribute profiles: at which size of an attribute a surface changes most (Mongus et al. 2013, §2).

The openings γ_λ of a surface lower it as λ grows. A profile takes the differences of successive openings, its zones.
All zones are read from one component tree: on the way from a cell to the root the attribute never falls, so the nodes
of each zone follow each other on that way.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msbdb.errors import InputError, ParameterError
from msbdb.morphology.componenttree import NONE, ComponentTree, is_increasing
from msbdb.threads import kernel

MAX_ZONES = 2**15 - 2
"""Zones and one more, for what remains, are counted in 16 bits."""


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

    Notes
    -----
    δ_i(g) = γ_{λ_{i-1}}(g) - γ_{λ_i}(g). At a cell, δ_i is the level of the smallest node of zone i that holds the
    cell, if any, less the level just outside of that zone. So {δ_i > 0} is covered by the nodes of zone i that lie in
    no other node of zone i. Each of these is connected. No two of them touch: the lower level of two neighbours would
    join them into one node. They are therefore the components of {δ_i > 0}, known without labelling, and each has
    all attributes of its node.
    """

    tree: ComponentTree
    thresholds: NDArray[np.float64]
    zone: NDArray[np.int16]

    @property
    def zones(self) -> int:
        """I, the number of zones."""
        return self.thresholds.size - 1

    def components(self) -> NDArray[np.bool_]:
        """Return (N,) bool, whether a node is a component of the support {δ_i > 0} of its zone i (Eq. 13; M16).

        Such a node belongs to a zone, not to what remains, and the node around it to a higher zone.
        """
        found: NDArray[np.bool_] = (self.zone <= self.zones) & (self.zone < self.tree.around(self.zone))
        return found

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
        (Eq. 14; M18).
        """
        return self.tree.paint(self.tree.outermost(kept), fill=NONE)


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
    Complexity: one pass over the nodes, whatever the number of zones. Memory: 2 bytes a node.

    Examples
    --------
    Two cells of height 7 on four of height 2: zone 1 takes the two away, zone 2 the four, and the ground remains.

    >>> from msbdb.morphology import areas, build_tree
    >>> tree = build_tree(np.array([[0, 2, 7, 7, 2, 0]]))
    >>> profile = build_profile(tree, areas(tree), [0, 3, 5])
    >>> tree.paint(profile.zone)
    array([[3, 2, 1, 1, 2, 3]], dtype=int16)
    >>> tree.level[profile.union(profile.components())[0, 1:-1]]
    array([2, 2, 2, 2])
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
    zone.flags.writeable = False
    return AttributeProfile(tree, limits, zone)


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


def _require_increasing(tree: ComponentTree, attribute: NDArray[Any]) -> None:
    """Refuse an attribute that is larger in some component than in the component around it."""
    if attribute.shape != (tree.size,):
        msg = f"The attribute needs one value a node, of {tree.size}; got the shape {attribute.shape}."
        raise InputError(msg)
    if not is_increasing(tree, attribute):
        msg = (
            "The attribute must be increasing, but some component has more of it than the component around it; "
            "sum a field that is nowhere negative."
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
    """Return for each node the number of limits that it reaches, by bisection."""
    zone = np.empty(attribute.size, dtype=np.int16)
    for node in range(attribute.size):
        # Limits before `low` are reached, limits from `high` on are not; the unknown ones between become fewer.
        low, high = 0, limits.size
        while low < high:
            middle = (low + high) // 2
            if attribute[node] < limits[middle]:
                high = middle
            else:
                low = middle + 1
        zone[node] = low
    return zone
