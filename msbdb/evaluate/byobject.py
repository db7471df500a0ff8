"""Agreement by object, counted on both sides, also where objects were merged or split (V55, S9, S10)."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from msbdb.evaluate.agreement import Rates, rates, ratio
from msbdb.labels import Labels, shared_cells, sizes

Ints = NDArray[np.int64]

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Overlaps:
    """Where the objects of both sides meet.

    Attributes
    ----------
    extracted, reference : (P,) ndarray of int64
        The objects of each pair with common cells.
    common_m2 : (P,) ndarray of float64
        Their common area.
    extracted_m2, reference_m2 : (N,) and (M,) ndarray of float64
        The scored area of every object.
    """

    extracted: Ints
    reference: Ints
    common_m2: Floats
    extracted_m2: Floats
    reference_m2: Floats

    def together(self, share: float) -> NDArray[np.bool_]:
        """Return the pairs that have at least this share of the smaller object in common."""
        smaller = np.minimum(self.extracted_m2[self.extracted], self.reference_m2[self.reference])
        return np.asarray(self.common_m2 >= share * smaller)


@dataclass(frozen=True, slots=True)
class ObjectScore:
    """Objects as each side counts them, and their rates.

    Attributes
    ----------
    found, missed : int
        Reference objects that are covered by extracted ones to the chosen share, and the others.
    true, false : int
        Extracted objects that are covered by reference ones to the chosen share, and the others.
    fused : int
        Extracted objects that are several in reality: they hold the chosen share of each of two reference objects.
    split : int
        Reference objects that were extracted as several: they hold the chosen share of each of two extracted ones.
    fusion, fission : float
        ``fused`` a counted extracted object, ``split`` a counted reference object.
    rates : Rates
        Of the four counts.
    """

    found: int
    missed: int
    true: int
    false: int
    fused: int
    split: int
    fusion: float
    fission: float
    rates: Rates


def overlaps(extracted: Labels, reference: Labels, counts: tuple[int, int], cell_area_m2: float) -> Overlaps:
    """Count the common cells of all objects.

    Parameters
    ----------
    extracted, reference : (H, W) ndarray of int32
        Index + 1 of the object in each cell, 0 for none, and 0 on both sides in cells that are not scored.
    counts : tuple of int
        Number of extracted and of reference objects.
    cell_area_m2 : float
        Area of a cell, m2.
    """
    one, other, cells = shared_cells(extracted, reference)
    extracted_cells, reference_cells = sizes(extracted, counts[0]), sizes(reference, counts[1])
    return Overlaps(
        extracted=one - 1,
        reference=other - 1,
        common_m2=cells.astype(np.float64) * cell_area_m2,
        extracted_m2=extracted_cells.astype(np.float64) * cell_area_m2,
        reference_m2=reference_cells.astype(np.float64) * cell_area_m2,
    )


def score_objects(
    found: Overlaps,
    counted: tuple[NDArray[np.bool_], NDArray[np.bool_]],
    covered_m2: tuple[Floats, Floats],
    share: float,
) -> ObjectScore:
    """Count the objects that the other side covers, each side on its own.

    An object is covered when at least the share of its scored area is building on the other side, in one object or in
    several. So a merged row of houses counts as found; only the fusion rate shows the merge.

    Parameters
    ----------
    found : Overlaps
        The common areas of all objects.
    counted : tuple of ndarray of bool
        Which extracted, and which reference objects count; the others still cover.
    covered_m2 : tuple of ndarray of float64
        Scored area of each extracted and of each reference object that is building on the other side.
    share : float
        The least share of an object's area, above 0 and up to 1.
    """
    counted_e, counted_r = counted
    true = covered_m2[0][counted_e] >= share * found.extracted_m2[counted_e]
    seen = covered_m2[1][counted_r] >= share * found.reference_m2[counted_r]
    pair = counted_e[found.extracted] & counted_r[found.reference]
    holds_reference = pair & (found.common_m2 >= share * found.reference_m2[found.reference])
    holds_extracted = pair & (found.common_m2 >= share * found.extracted_m2[found.extracted])
    fused = int(np.count_nonzero(np.bincount(found.extracted[holds_reference]) >= 2))
    split = int(np.count_nonzero(np.bincount(found.reference[holds_extracted]) >= 2))
    numbers = {
        "found": int(seen.sum()),
        "missed": int((~seen).sum()),
        "true": int(true.sum()),
        "false": int((~true).sum()),
    }
    return ObjectScore(
        **numbers,
        fused=fused,
        split=split,
        fusion=ratio(fused, len(true)),
        fission=ratio(split, len(seen)),
        rates=rates(**numbers),
    )


def groups(found: Overlaps, share: float) -> tuple[Ints, Ints, int]:
    """Gather the objects that depict the same buildings, m to n.

    Two objects belong together when they have at least the share of the smaller one in common; a group holds all
    that are linked so, directly or through others.

    Returns
    -------
    extracted, reference : (N,) and (M,) ndarray of int64
        Group of each object; -1 for those that have no partner.
    count : int
        Number of groups.
    """
    n, m = len(found.extracted_m2), len(found.reference_m2)
    linked = found.together(share)
    one, other = found.extracted[linked], found.reference[linked]
    graph = coo_array((np.ones(len(one), dtype=np.int8), (one, n + other)), shape=(n + m, n + m))
    _, component = connected_components(graph, directed=False)
    matched = np.unique(component[one])
    of_component = np.full(n + m + 1, -1, dtype=np.int64)
    of_component[matched] = np.arange(len(matched))
    return of_component[component[:n]], of_component[component[n:]], len(matched)
