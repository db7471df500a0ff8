"""From a surface and its points to the cover of the cells: their texture, how crowns split pulses, and roofs."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import isotonic_regression

from msbdb.labels import sizes
from msbdb.params import CoverParams, Params
from msbdb.points.cloud import PointCloud
from msbdb.surface.gridding import Samples
from msbdb.surface.heights import Surface
from msbdb.surface.noise import height_noise, without_noise
from msbdb.surface.squares import Squares, around
from msbdb.surface.structure import VEGETATION, Structure, rough_cells, structural_cover
from msbdb.surface.texture import LEAST_SAMPLES, WIDEST_SAMPLES, Texture, echoes, roughness, widest_window_m
from msbdb.surveyplan import CROWN_CLASSES_M, USUAL_SPLIT, PointFacts
from msbdb.threads import in_threads

LEAST_SPLIT = 0.12
"""Ours, in sample: rough cells split at least this share of their pulses with all echoes; see `recorded_echoes`."""

LEAST_M2 = 100.0
"""Ours: less area of rough cells does not show what was recorded around them, square metres."""

PARTS = 1_000_000
"""Shares are counted in so many parts, whole numbers, whose sums depend neither on the order nor on the window."""

UPPER = 0.9
"""Ours, in sample: this quantile of the shares of split pulses shows a strong sensor, also where trees are few."""

DOUBTFUL, STRONG = 0.6, 0.9
"""Ours, in sample: up to the first value of that quantile a sensor may be weak, from the second on it is strong."""

Field = NDArray[np.float32]


def cover_from_surface(
    surface: Surface, points: PointCloud | None, params: Params, *, planned: bool = True
) -> Structure:
    """Separate roofs from vegetation by texture, and by echoes where the source has them.

    Parameters
    ----------
    surface : Surface
        The surfaces of the survey.
    points : PointCloud, optional
        The same points, which may know the facts of the survey; None for a raster source.
    params : Params
        Sections ``surface`` and ``cover``.
    planned : bool
        Whether the facts are those of a plan. Otherwise the crowns of this surface show how far echoes are trusted.

    Returns
    -------
    Structure
        Building and vegetation above the mask, each cell's own probability of roof, and the roughness in the small
        window.
    """
    texture = texture_of(surface, points, params)
    facts, crowns = None if points is None else points.facts, None
    if facts is not None and not planned:
        crowns = crown_cells(texture, params.cover)
        facts = replace(facts, crown_split=None if crowns is None else crown_split([crowns]))
    recorded = recorded_echoes(texture, facts, params.cover)
    return replace(structural_cover(texture, facts, params.cover, recorded), crowns=crowns)


def texture_of(surface: Surface, points: PointCloud | None, params: Params) -> Texture:
    """Measure the texture of a surface, and the echoes where the source has them.

    Parameters
    ----------
    surface : Surface
        The surfaces of the survey.
    points : PointCloud, optional
        The same points; None for a raster source.
    params : Params
        Sections ``surface`` and ``cover``.
    """
    small_m, wide_m, mask_m = params.cover.window_m, params.cover.wide_window_m, params.surface.mask_m

    def relief(window: tuple[float, int]) -> tuple[Field, Field]:
        known = surface.roughness.get(window)
        seen = roughness(surface.samples, *window) if known is None else known
        noise_m = height_noise(seen, surface.ndsm, window_m=window[0], mask_m=mask_m)
        return without_noise(seen, noise_m), noise_m

    windows = _windows(params.cover, surface.ndsm.spec.cell_m)
    (rough, noise_m), (wide, _), (widest, _) = in_threads(relief, windows)
    found = (
        None
        if points is None
        else echoes(points, surface.ndsm, surface.dtm, small_m=small_m, wide_m=wide_m, mask_m=mask_m)
    )
    return Texture(surface.ndsm, rough, wide, found, mask_m, noise_m if noise_m.any() else None, widest)


def roughness_by_window(samples: Samples, params: CoverParams) -> dict[tuple[float, int], Field]:
    """Return the roughness of samples, noise included, by window: its side in metres, and the least samples."""
    return {window: roughness(samples, *window) for window in _windows(params, samples.spec.cell_m)}


def _windows(params: CoverParams, cell_m: float) -> tuple[tuple[float, int], ...]:
    """Return the sides of the small, wide and widest window, metres, each with the least samples of a plane."""
    widest_m = widest_window_m(params.wide_window_m, cell_m)
    return (params.window_m, LEAST_SAMPLES), (params.wide_window_m, LEAST_SAMPLES), (widest_m, WIDEST_SAMPLES)


def crown_cells(texture: Texture, params: CoverParams) -> Field | None:
    """Return what the echoes show where roughness alone sees vegetation; None without echoes.

    Parameters
    ----------
    texture : Texture
        Heights, roughness and echoes.
    params : CoverParams
        Weights and sizes.

    Returns
    -------
    (2, N) ndarray of float32
        Of each such cell the height above ground, metres, and the share of first echoes with a later one around it.
    """
    if texture.echoes is None:
        return None
    crowns = structural_cover(replace(texture, echoes=None), None, params).cover.index == VEGETATION
    return np.stack([np.asarray(texture.ndsm.values, dtype=np.float32)[crowns], texture.echoes.split[crowns]])


def crown_split(crowns: Sequence[Field]) -> tuple[float, ...] | None:
    """Return the share of pulses that the crowns of a survey split, by classes of height; None where none is known.

    It is the mean over the crowns. But where trees are few, most of these cells are rough roofs. A weak sensor splits
    nearly all pulses nowhere. So where a tenth of the cells does, the share is at least `USUAL_SPLIT`. This least share
    rises from 0 to that while the upper decile goes from `DOUBTFUL` to `STRONG`. High crowns split no fewer pulses than
    low ones. So the shares never fall with the height, and are nearest to the measured ones (isotonic regression).

    Parameters
    ----------
    crowns : sequence of (2, N) ndarray of float32
        Of the survey, or of blocks of it (`crown_cells`).

    Returns
    -------
    tuple of float
        One for each class between `CROWN_CLASSES_M`; a class without a cell has the share of all of them.
    """
    heights, shares = np.concatenate([*crowns, np.zeros((2, 0), dtype=np.float32)], axis=1)
    if not shares.size:
        return None
    of = np.digitize(heights, CROWN_CLASSES_M)
    cells, parts = sizes(of + 1, len(CROWN_CLASSES_M) + 1), np.rint(shares * PARTS).astype(np.int64)
    split = [_split_of(parts[of == number] if count else parts) for number, count in enumerate(cells.tolist())]
    rising = isotonic_regression(split, weights=np.maximum(cells, 1)).x
    return tuple(np.round(rising, 6).tolist())


def _split_of(parts: NDArray[np.int64]) -> float:
    """Return the share of pulses that crowns of one class split, from the shares of its cells in `PARTS`."""
    mean, upper = np.mean(parts) / PARTS, np.quantile(parts, UPPER) / PARTS
    return float(max(mean, np.interp(upper, (DOUBTFUL, STRONG), (0, USUAL_SPLIT))))


def recorded_echoes(texture: Texture, facts: PointFacts | None, params: CoverParams) -> Field | None:
    """Return how far later echoes were recorded at each place, where a survey has flights of several sensors.

    Parameters
    ----------
    texture : Texture
        Heights, roughness and echoes.
    facts : PointFacts or None
        With what crowns of the survey split.
    params : CoverParams
        Weights and sizes.

    Returns
    -------
    (H, W) ndarray of float32 or None
        From 0 to 1; None where it is 1 everywhere, or where no echoes are known.

    Notes
    -----
    Rough cells are crowns and rough roofs. Over 3 by 3 squares their mean share of split pulses is `LEAST_SPLIT` or
    more, times the trust in single echoes, whatever is built there: at the places at hand, over hills and under
    planted trees, and in 95 of 100 squares of copies with 0.3 to 1 first echo a square metre. Where it is less, single
    echoes are trusted in proportion. Squares with less than `LEAST_M2` of rough cells do not know, and count as 1. They
    lie on the absolute lattice, so that tiles agree. Border: squares end at the lattice. Nodata: cells that are not
    valid are not raised.
    """
    if texture.echoes is None or facts is None or facts.crown_split is None or facts.most_trust == 0:
        return None
    rough, squares = rough_cells(texture, params), Squares.of(texture.ndsm.spec)
    row, col = np.nonzero(rough)
    place, count = squares.rows[row] * squares.shape[1] + squares.cols[col], squares.shape[0] * squares.shape[1]
    split = np.rint(texture.echoes.split[rough] * PARTS)
    cells, shares = (
        around(np.bincount(place, weights, count).astype(np.int64).reshape(squares.shape)) for weights in (None, split)
    )
    usual = LEAST_SPLIT * facts.most_trust * PARTS
    enough = cells * texture.ndsm.spec.cell_area_m2 >= LEAST_M2
    found = np.where(enough, np.minimum(shares / (usual * np.maximum(cells, 1)), 1), 1).astype(np.float32)
    return None if found.min(initial=1) == 1 else squares.on_cells(found)
