"""Land cover from structure alone: texture and echoes separate roofs from vegetation, without any colour.

Each cell's evidence gives log-odds of roof against vegetation, their sum a probability. The probabilities are
smoothed and cut at one half, and each region is then checked as a whole. All values are ours, calibrated together on
tiles of four surveys and on thinned copies.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from msbdb.grid import Grid
from msbdb.labels import chosen_cells, label_zones, sizes, small_zones, sums
from msbdb.landcover import ClassMap
from msbdb.morphology.windows import dilation, erosion, opening
from msbdb.params import CoverParams
from msbdb.surface.texture import Echoes, Texture, window_cells
from msbdb.surveyplan import PointFacts, usual_split
from msbdb.threads import in_threads

ROOF, VEGETATION = 1, 2
"""Indices of the structural classes."""

USUAL_CELL_M = 0.6
"""Ours: the largest cells of the surveys that the limits of roughness were calibrated on."""

WINDOW_POWER = 1.2
"""Ours, in sample: the limit of smoothness grows by this power of the window, as wide windows span several roofs."""

Mask = NDArray[np.bool_]
Field = NDArray[np.float32]


@dataclass(frozen=True, slots=True, eq=False)
class Structure:
    """The cover of the cells by structure alone.

    Parameters
    ----------
    cover : ClassMap
        Class 1 (building) and 2 (vegetation) above the mask, 0 below it and where not valid.
    roof_probability : (H, W) ndarray of float32
        Of roof against vegetation, 0 to 1, by each cell's own echoes and texture, before any smoothing; also below
        the mask, where it means little.
    roughness_m : (H, W) ndarray of float32, metres
        Residual of the best plane in the small window; `msbdb.surface.texture.NO_PLANE_M` where it has too few samples.
    filled_m : (H, W) ndarray of float32, metres
        The same, and there the residual in the smallest window that has enough.
    noise_m : (H, W) ndarray of float32 or None, metres
        What noise of the heights added to the residual in the small window, and is taken off; None where nothing is.
    crowns : (2, N) ndarray of float32 or None
        Heights and split echoes of crowns (`msbdb.surface.cover.crown_cells`); None where nobody asked for them.
    recorded : (H, W) ndarray of float32 or None
        How far later echoes were recorded here, from 0 to 1 (`msbdb.surface.cover.recorded_echoes`); None where they
        were everywhere.
    """

    cover: ClassMap
    roof_probability: Field
    roughness_m: Field
    filled_m: Field
    noise_m: Field | None = None
    crowns: Field | None = None
    recorded: Field | None = None


def structural_cover(
    texture: Texture, facts: PointFacts | None, params: CoverParams, recorded: Field | None = None
) -> Structure:
    """Separate roofs from vegetation on every cell above the mask.

    Parameters
    ----------
    texture : Texture
        Heights, roughness and echoes.
    facts : PointFacts or None
        With the trust in single echoes as a sign of a roof; None trusts them in full. Split echoes are a sign of leaves
        whatever the sensor, and the more so the fewer it splits (`msbdb.surveyplan.usual_split`).
    params : CoverParams
        Weights and sizes.
    recorded : (H, W) ndarray of float32, optional
        The trust is multiplied by it.

    Returns
    -------
    Structure

    Notes
    -----
    Where the small window has too few samples for a plane, as beside strips that overlap, the wide one is judged, and
    where that has too few the widest: sparse is not rough. In the odds with echoes such cells keep the penalty that
    they were calibrated with, and split echoes there are leaves.
    Without echoes the limits of roughness grow with the windows on cells above 0.6 m.

    With w the trust, the log-odds are w times the part of single echoes and 1 - w times that of roughness alone, less
    the part of split echoes. The limits for regions go in the same way from those of roughness alone to the others.
    """
    ndsm, small_m, wide_m = texture.ndsm, texture.roughness_m, texture.wide_roughness_m
    wider, filled_m, echoes = _for_wider_windows(params, ndsm.spec.cell_m), texture.filled_m, texture.echoes
    trust, most = np.zeros((1, 1), dtype=np.float32), 0.0
    if echoes is None:
        odds = _rough_odds(filled_m, texture.filled_wide_m, wider)
    else:
        trust, most = np.ones((1, 1), dtype=np.float32), 1.0
        if facts is not None:
            trust, most = facts.echo_trust(np.asarray(ndsm.values)), facts.most_trust
        if recorded is not None:
            trust = trust * recorded
        leafy = leaf_share(wide_m, ndsm.spec.cell_m, params)
        echoes = replace(
            echoes,
            split=usual_split(echoes.split, trust) * leafy,
            split_best=usual_split(echoes.split_best, trust) * leafy,
            split_wide=usual_split(echoes.split_wide, trust) * leafy,
        )
        odds = _echo_odds(small_m, echoes, trust, params)
        if trust.min() < 1:
            odds += (1 - trust) * _rough_odds(filled_m, texture.filled_wide_m, wider)
    probability = _sigmoid(odds)
    with_echoes_m, alone_m = (_smooth_m(each, ndsm.spec.cell_m) for each in (params, wider))
    smooth = filled_m < trust * with_echoes_m + (1 - trust) * alone_m
    split = None if echoes is None else echoes.split
    params = replace(params, neck_m=most * params.neck_m + (1 - most) * params.blind_neck_m)
    cover = _regions_of(probability, texture.raised, ndsm, params, smooth=smooth, split=split, trust=trust)
    return Structure(cover, probability, small_m, filled_m, texture.noise_m, recorded=recorded)


def rough_cells(texture: Texture, params: CoverParams) -> Mask:
    """Return the (H, W) cells that are vegetation by the roughness around them alone, before regions are judged."""
    cell_m = texture.ndsm.spec.cell_m
    odds = _rough_odds(texture.filled_m, texture.filled_wide_m, _for_wider_windows(params, cell_m))
    [share] = smooth_shares((_sigmoid(odds),), texture.raised, params.smooth_m / cell_m)
    return texture.raised & (share <= 0.5)


def _smooth_m(params: CoverParams, cell_m: float) -> float:
    """Return the roughness below which a cell is smooth, metres.

    On cells above 1 m a window spans several planes of a roof, so that the limit grows with the cell.
    """
    return params.smooth_m_limit * max(1.0, cell_m)


def _regions_of(
    probability: Field,
    raised: Mask,
    ndsm: Grid,
    params: CoverParams,
    *,
    smooth: Mask,
    split: Field | None,
    trust: Field,
) -> ClassMap:
    """Smooth the cells' probabilities, cut them at one half, and judge each region as a whole."""
    cell_m = ndsm.spec.cell_m
    [share] = smooth_shares((probability,), raised, params.smooth_m / cell_m)
    roof = share > 0.5
    roof = _tidy(roof & raised, raised, cell_m, params)
    roof = _judge_regions(roof, smooth, split, trust, params)
    roof = _grow(roof, raised, np.asarray(ndsm.values, dtype=np.float32), cell_m, params)
    index = np.where(roof, ROOF, np.where(raised, VEGETATION, 0)).astype(np.uint8)
    return ClassMap(index, {ROOF: "building", VEGETATION: "vegetation"}, ndsm.spec)


def cover_with_colours(
    structure: Structure, ndsm: Grid, index: NDArray[np.uint8], odds: NDArray[np.float64], params: CoverParams
) -> ClassMap:
    """Separate roofs from vegetation where single echoes are hardly trusted: by roughness and classes of colours.

    Roughness errs on single roofs and crowns, seldom on most of a class. So each class is evidence for its cells.

    Parameters
    ----------
    structure : Structure
        By roughness alone, or nearly.
    ndsm : Grid
        Heights above ground, metres.
    index : (H, W) ndarray of uint8
        Class of a cell, 1 to K; 0 where it has none, and stands by its own roughness.
    odds : (K + 1,) ndarray of float64
        Log-odds of roof by the structure, of all classified cells together, and then of those of each class.
    params : CoverParams
        Weights and sizes.

    Returns
    -------
    ClassMap
        As that of the structure.

    Notes
    -----
    A class adds to the log-odds of its cells what it has more than all cells together, for so much is in their own
    already: of odds p / (1 - p) that become f times as much, the probability is f·p / (1 - p + f·p). Where regions are
    judged, roughness r becomes r·exp(-odds / w): by that much it changes the odds itself, with w the weight of
    roughness.
    """
    times = np.exp(odds - odds[0]).astype(np.float32)[index]
    factor = np.exp(-np.append(0.0, odds[1:]) / params.rough_weight).astype(np.float32)[index]
    own = structure.roof_probability
    times *= own
    probability = times / (1 - own + times)
    wider, raised = _for_wider_windows(params, ndsm.spec.cell_m), structure.cover.index > 0
    smooth = structure.filled_m * factor < _smooth_m(wider, ndsm.spec.cell_m)
    blind, none = replace(params, neck_m=params.blind_neck_m), np.zeros((1, 1), dtype=np.float32)
    return _regions_of(probability, raised, ndsm, blind, smooth=smooth, split=None, trust=none)


def leaf_share(wide_roughness_m: Field, cell_m: float, params: CoverParams) -> Field:
    """Return how far split echoes suggest leaves: 0 on planes, which may be glass, to 1 on rough surfaces.

    Parameters
    ----------
    wide_roughness_m : (H, W) ndarray of float32, metres
        Residual of the best plane in the wide window.
    cell_m : float
        Side of a cell, metres. On cells above 1 m a window spans several planes, so that the limits grow with it.
    params : CoverParams
        ``glass_m`` and ``leaf_m``: at the first the share is 0, at the second 1, and between them it goes with the
        logarithm.

    Examples
    --------
    >>> leaf_share(np.float32([0.02, 0.087, 0.3]), 0.5, CoverParams()).round(1)
    array([0. , 0.5, 1. ], dtype=float32)
    """
    low_m, high_m = params.glass_m * max(1.0, cell_m), params.leaf_m * max(1.0, cell_m)
    ratio = np.log(np.maximum(wide_roughness_m, params.smooth_floor_m) / low_m) / np.log(high_m / low_m)
    return np.asarray(np.clip(ratio, 0, 1), dtype=np.float32)


def _echo_odds(roughness_m: Field, echoes: Echoes, trust: Field, params: CoverParams) -> Field:
    """Log-odds of roof from the echoes, with a little from the roughness; split echoes of planes do not count.

    w·(b - w_3·ln(roughness) + w_4·solid) - w_1·split_best - w_2·split_wide, with the trust w and the weights of
    ``cover``.
    """
    odds: Field = (
        trust * params.echo_bias
        - params.split_weight * echoes.split_best
        - params.split_wide_weight * echoes.split_wide
        - trust * params.echo_rough_weight * np.log(np.maximum(roughness_m, params.smooth_floor_m))
        + trust * params.solid_weight * echoes.solid
    )
    return odds


def _for_wider_windows(params: CoverParams, cell_m: float) -> CoverParams:
    """Return the parameters with limits of roughness for large cells, whose windows of three cells are too wide.

    A window of 6 m holds the ridge and the eaves of a roof, which is as rough there as a crown in a window of 1.5 m.
    """

    def wider(window_m: float) -> float:
        usual_m = window_cells(window_m, USUAL_CELL_M) * USUAL_CELL_M
        return max(1.0, window_cells(window_m, cell_m) * cell_m / usual_m)

    small, wide = wider(params.window_m), wider(params.wide_window_m)
    return replace(
        params,
        rough_m=params.rough_m * small,
        rough_wide_m=params.rough_wide_m * wide,
        # On cells above 1 m the limit grows with the cell already.
        smooth_m_limit=params.smooth_m_limit * max(1.0, small**WINDOW_POWER / max(1.0, cell_m)),
    )


def _rough_odds(roughness_m: Field, wide_m: Field, params: CoverParams) -> Field:
    """Log-odds of roof from the roughness alone: -w·(ln(small / small_0) + ln(wide / wide_0))."""
    floor = params.smooth_floor_m
    small = np.log(np.maximum(roughness_m, floor) / params.rough_m)
    wide = np.log(np.maximum(wide_m, floor) / params.rough_wide_m)
    return np.asarray(-params.rough_weight * (small + wide), dtype=np.float32)


def _sigmoid(odds: Field) -> Field:
    """Probabilities of log-odds, 1/(1 + e^-x)."""
    return np.asarray(1 / (1 + np.exp(-np.clip(odds, -30, 30))), dtype=np.float32)


def smooth_shares(images: Sequence[Field], raised: Mask, sigma_cells: float) -> list[Field]:
    """Return the mean of each image around a cell, over raised cells only (normalised Gaussian)."""
    sigma = max(sigma_cells, 0.7)
    blur = partial(gaussian_filter, sigma=sigma, mode="constant", truncate=2.5)
    *shares, weight = in_threads(blur, (*(np.where(raised, one, np.float32(0)) for one in images), np.float32(raised)))
    np.maximum(weight, 1e-3, out=weight)
    return [np.divide(share, weight, out=share) for share in shares]


def _tidy(roof: Mask, raised: Mask, cell_m: float, params: CoverParams) -> Mask:
    """Close small holes, cut thin necks and drop small regions."""
    roof = roof | (small_zones(~roof, params.hole_m2 / cell_m**2, connectivity=4) & raised)
    radius = round(params.neck_m / 2 / cell_m)
    if radius:
        size = 2 * radius + 1
        roof = opening(roof.astype(np.float32), size, None) > 0
    return roof & ~small_zones(roof, params.min_roof_m2 / cell_m**2, connectivity=8)


def _judge_regions(roof: Mask, smooth: Mask, split: Field | None, trust: Field, params: CoverParams) -> Mask:
    """Keep the regions that are smooth enough for the echoes that they split, and for the trust in the others."""
    labels, count = label_zones(roof)
    cells = sizes(labels, count)
    least: NDArray[np.floating] = 1 - (trust.ravel() if trust.size == 1 else sums(labels, trust, count) / cells)
    needed = np.broadcast_to(least * params.min_smooth_share, count)
    if split is not None:
        shares = sums(labels, split, count) / cells
        needed = np.maximum(needed, params.smooth_per_split * (shares - params.free_split_share))
    return chosen_cells(labels, sizes(labels[smooth], count) / cells >= needed)


def drop_green_regions(cover: ClassMap, green: Mask, roughness_m: Field, params: CoverParams) -> ClassMap:
    """Turn roofs into vegetation that are mostly green and not quite smooth: colour and texture against the echoes.

    A green roof is smooth and stays. A dense crown that stops every pulse is detected by its colour.

    Parameters
    ----------
    cover : ClassMap
        From `structural_cover`.
    green : (H, W) ndarray of bool
        Cells of the colour of vegetation.
    roughness_m : (H, W) ndarray of float32, metres
        In the small window.
    params : CoverParams
        Shares and the limit of smoothness.
    """
    labels, count = label_zones(cover.index == ROOF)
    cells = sizes(labels, count)
    green_share = sizes(labels[green], count) / cells
    smooth_share = sizes(labels[roughness_m < _smooth_m(params, cover.spec.cell_m)], count) / cells
    crown = (green_share >= params.green_share) & (smooth_share < params.green_smooth_share)
    index = np.where(chosen_cells(labels, crown), np.uint8(VEGETATION), cover.index)
    return ClassMap(index, cover.labels, cover.spec)


def _grow(roof: Mask, raised: Mask, heights: Field, cell_m: float, params: CoverParams) -> Mask:
    """Give the roofs' edges back: raised neighbours of like height, a cell at a time, and then the small holes."""
    for _ in range(round(params.grow_m / cell_m)):
        upper, lower = in_threads(partial(_around, roof, heights), (dilation, erosion))
        near = np.minimum(np.abs(heights - upper), np.abs(heights - lower)) < params.grow_step_m
        roof = roof | (raised & near)
    return roof | (small_zones(~roof, params.hole_m2 / cell_m**2, connectivity=4) & raised)


def _around(roof: Mask, heights: Field, extreme: Callable[..., Field]) -> Field:
    """Highest or lowest roof in the 3 by 3 cells around each cell; infinite without a roof."""
    none = np.float32(-np.inf if extreme is dilation else np.inf)
    return extreme(np.where(roof, heights, none), 3, None)
