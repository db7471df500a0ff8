"""The probability that a raised object is a building, and the objects that the detectors refuse together."""

from collections.abc import Iterable, Mapping

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.special import expit

from msbdb.detect.scene import Regions
from msbdb.grid import Grid
from msbdb.identity import part_ids
from msbdb.labels import Labels, centroids, label_zones, measure, renumber, sizes
from msbdb.ledger import Ledger
from msbdb.morphology.windows import dilation, opening
from msbdb.params import FuseParams
from msbdb.tables import REJECTION

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

HOUSE_M2 = 50.0
"""s₀ is the even share of an object of this area: a small house."""

STAGE = "fusion"
"""The stage of the ledger that refuses objects."""


def building_probability(support: Floats, area_m2: Floats, params: FuseParams) -> Floats:
    """Return the probability that objects are buildings: the log-odds are k (s - s₀) + a s^q ln(A / 50 m²).

    Detectors err together on small things: lorries, containers and crowns have the size and the smooth top of a shed.
    A large object on which they agree is hardly ever anything else.

    Parameters
    ----------
    support : (N,) ndarray of float64
        Mean share s that the detectors cover.
    area_m2 : (N,) ndarray of float64
        Area A, above 0.
    params : FuseParams
        ``support_slope`` k, ``support_even`` s₀, ``area_slope`` a and ``area_power`` q.

    Returns
    -------
    (N,) ndarray of float64
        From 0 to 1. It rises with the area, and with the share: with q = 2 not below 14 m².

    Examples
    --------
    >>> building_probability(np.array([0.9, 0.9, 0.25]), np.array([500, 15, 15.0]), FuseParams()).round(2)
    array([1.  , 0.95, 0.03])
    """
    share = np.asarray(support, dtype=np.float64)
    size = params.area_slope * share**params.area_power * np.log(area_m2 / HOUSE_M2)
    return np.asarray(expit(params.support_slope * (share - params.support_even) + size))


def states_of(probability: Floats, params: FuseParams) -> NDArray[np.str_]:
    """Return 'confirmed' from the probability p₁ on, 'refuted' up to 1 - p₁, and 'unsure' between.

    Parameters
    ----------
    probability : (N,) ndarray of float64
    params : FuseParams
        ``sure`` p₁.
    """
    return np.select([probability >= params.sure, probability <= 1 - params.sure], ["confirmed", "refuted"], "unsure")


def mean_support(labels: Labels, count: int, covered: Iterable[Mask]) -> Floats:
    """Return the mean share of each region that detectors cover, from the cells that each takes."""
    cells = np.maximum(sizes(labels, count), 1)
    return np.asarray(np.mean([sizes(labels[taken], count) / cells for taken in covered], axis=0), dtype=np.float64)


def refused_objects(heights: Grid, built: Mask, params: FuseParams, *, mask_m: float) -> tuple[Labels, int]:
    """Label the raised objects that stand apart from the buildings: as large as one, but refused.

    Parameters
    ----------
    heights : Grid
        Heights above ground, metres.
    built : (H, W) ndarray of bool
        The cells that the detectors took together.
    params : FuseParams
        ``piece_m2``, the least area of a building.
    mask_m : float
        Height of the mask (V17), metres.

    Returns
    -------
    labels : (H, W) ndarray of int32
        0 for none; objects are 8-connected, and three cells wide at least.
    count : int

    Notes
    -----
    What touches a building is left out: a crown beside a wall has no edge of its own. Nodata: invalid cells belong to
    no object. Linear in the cells.
    """
    high = heights.valid & (np.asarray(heights.values) >= mask_m) & ~built
    wide = opening(high.astype(np.float32), 3, heights.valid) > 0
    labels, count = label_zones(wide & high)
    touching = sizes(labels[dilation(built.astype(np.float32), 3, np.ones_like(built)) > 0], count) > 0
    large = sizes(labels, count) * heights.spec.cell_area_m2 >= params.piece_m2
    return renumber(labels, large & ~touching)


def refuse(
    heights: Grid, regions: Mapping[str, Regions], built: Mask, params: FuseParams, *, mask_m: float, survey: str
) -> tuple[pd.DataFrame, dict[str, dict[str, int]]]:
    """Return the ledger of the joint decision: a row for each refused object, with its state as the reason.

    Parameters
    ----------
    heights : Grid
        Heights above ground, metres.
    regions : mapping of str to Regions
        Of each detector that was run.
    built : (H, W) ndarray of bool
        The cells that the detectors took together.
    params : FuseParams
        As `refused_objects`, `building_probability` and `states_of` take them.
    mask_m : float
        Height of the mask (V17), metres.
    survey : str
        Its name, for the ids.

    Returns
    -------
    rows : DataFrame
        ``tables.REJECTION`` without geometry, of the method ``multiscale``, which makes the parts of what was taken.
    counts : dict
        Of the stage: raised objects in, those kept, and those dropped.
    """
    spec = heights.spec
    labels, count = refused_objects(heights, built, params, mask_m=mask_m)
    found = measure(labels, count)
    area_m2 = found["area"].to_numpy() * spec.cell_area_m2
    support = mean_support(labels, count, (one.labels > 0 for one in regions.values()))
    states = states_of(building_probability(support, area_m2, params), params)
    # Without half of the votes an object is no building, however large it is.
    states = np.where(states == "confirmed", "unsure", states)
    row, col = np.divmod(found["first"].to_numpy().astype(np.int64), spec.shape[1])
    ids = part_ids(
        survey,
        spec.cell_m,
        threshold_px=0,
        row=row + spec.origin[0],
        col=col + spec.origin[1],
        piece=np.zeros_like(row),
    )
    xcen, ycen = centroids(found, spec)
    rows = pd.DataFrame(
        {"region_id": ids, "reason": states, "scale": 0, "area_m2": area_m2, "xcen": xcen, "ycen": ycen}
    )
    ledger = Ledger("multiscale")
    kept = label_zones(built)[1]
    ledger.count(STAGE, kept + count, kept, ledger.write(STAGE, rows))
    return REJECTION.typed(ledger.lost(REJECTION.empty())), ledger.counts
