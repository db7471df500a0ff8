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
from msbdb.surface.structure import VEGETATION, Structure, structural_cover
from msbdb.surface.texture import Texture, echoes, roughness
from msbdb.surveyplan import CROWN_CLASSES_M
from msbdb.threads import in_threads

UPPER = 0.9
"""Ours, in sample: a tenth or more of what roughness alone takes for vegetation is crowns, also where trees are few."""

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
    return replace(structural_cover(texture, facts, params.cover), crowns=crowns)


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

    def relief(window_m: float) -> tuple[Field, Field]:
        known = surface.roughness.get(window_m)
        seen = roughness(surface.samples, window_m) if known is None else known
        noise_m = height_noise(seen, surface.ndsm)
        return without_noise(seen, noise_m), noise_m

    (rough, noise_m), (wide, _) = in_threads(relief, (small_m, wide_m))
    found = (
        None
        if points is None
        else echoes(points, surface.ndsm, surface.dtm, small_m=small_m, wide_m=wide_m, mask_m=mask_m)
    )
    return Texture(surface.ndsm, rough, wide, found, mask_m, noise_m if noise_m.any() else None)


def roughness_by_window(samples: Samples, params: CoverParams) -> dict[float, Field]:
    """Return the roughness of samples, noise included, by the sides of the small and the wide window, metres."""
    windows_m = (params.window_m, params.wide_window_m)
    return {window_m: roughness(samples, window_m) for window_m in windows_m}


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

    The upper decile counts: on coarse cells many roofs are as rough as crowns, and split hardly a pulse. High crowns
    split no fewer pulses than low ones. So the shares are those that never fall with the height and are nearest to the
    measured ones, by isotonic regression.

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
    cells = sizes(of + 1, len(CROWN_CLASSES_M) + 1)
    upper = [
        np.quantile(shares[of == number] if count else shares, UPPER) for number, count in enumerate(cells.tolist())
    ]
    rising = isotonic_regression(upper, weights=np.maximum(cells, 1)).x
    return tuple(np.round(rising, 6).tolist())
