"""Suggested labels of the spectral classes (V36), from colour, brightness and roughness, for an operator to correct.

The paper leaves this step to an operator. Our rules look at whole classes, never at single cells, and each threshold
is a parameter marked as ours. The one adaptive threshold, of the vegetation index, stays within stated bounds.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from skimage.filters import threshold_otsu

from msbdb.params import SpectralParams
from msbdb.spectral.colours import Scaling
from msbdb.spectral.kmeans import Sample

INDEX_BANDS = {"ndvi": ("nir", "red"), "green-red": ("green", "red"), "pseudo-ndvi": ("intensity", "red")}
"""The two bands a and b of each vegetation index (a - b) / (a + b), in order of preference."""


@dataclass(frozen=True, slots=True, eq=False)
class ClassFacts:
    """What is known of each class, from its cells in the sample; arrays of one value a class, NaN for unknown.

    Parameters
    ----------
    index : (K,) ndarray of float64
        Mean vegetation index.
    brightness : (K,) ndarray of float64
        Mean over the image bands, scaled to 0 to 1; the pulse intensity is no image band.
    roughness : (K,) ndarray of float64, metres
        Median, which edges of roofs do not sway.
    height : (K,) ndarray of float64, metres
        Mean height above ground.
    """

    index: NDArray[np.float64]
    brightness: NDArray[np.float64]
    roughness: NDArray[np.float64]
    height: NDArray[np.float64]


def choose_index(names: tuple[str, ...], wanted: str) -> str | None:
    """Choose the vegetation index that the bands allow: the one wanted, or the best; None when there is none.

    NDVI needs ``nir`` and ``red``; ``green-red`` needs ``green`` and ``red``; ``pseudo-ndvi`` needs ``intensity`` and
    ``red`` (V20). An index that is wanted but not possible gives way to the best that is.
    """
    possible = [index for index, bands in INDEX_BANDS.items() if set(bands) <= set(names)]
    if wanted in possible:
        return wanted
    return possible[0] if possible else None


def vegetation_index(sample: Sample, scaling: Scaling, index: str | None) -> NDArray[np.float64]:
    """Return the (N,) vegetation index of the sample's cells; NaN without an index, 0 for black.

    Intensity and colour have different units, so the pseudo-NDVI is taken from scaled values (V21).
    """
    if index is None:
        return np.full(len(sample), np.nan)
    values = scaling.apply(sample.bands) if index == "pseudo-ndvi" else sample.bands
    first, second = (values[:, sample.names.index(name)] for name in INDEX_BANDS[index])
    total = first + second
    return np.asarray((first - second) / np.where(total > 0, total, 1.0))


def brightness(sample: Sample, scaling: Scaling) -> NDArray[np.float64]:
    """Return the (N,) mean of the scaled image bands; NaN when there is no band but intensity."""
    image = [number for number, name in enumerate(sample.names) if name != "intensity"]
    if not image:
        return np.full(len(sample), np.nan)
    return np.asarray(scaling.apply(sample.bands)[:, image].mean(axis=1))


def index_threshold(values: NDArray[np.float64], index: str | None, params: SpectralParams) -> float:
    """Find the vegetation index above which a class is green: Otsu's threshold, kept within the index's bounds.

    The bounds hold where Otsu's method has no meaning: in a quarter without trees, or in a forest.
    """
    if index is None or values.size == 0:
        return float("nan")
    low, high = index_bounds(index, params)
    otsu = threshold_otsu(values)  # type: ignore[no-untyped-call]  # scikit-image is untyped
    return float(np.clip(otsu, low, high))


def index_bounds(index: str, params: SpectralParams) -> tuple[float, float]:
    """Return the lowest and highest threshold of a vegetation index."""
    bounds = {
        "ndvi": params.ndvi_bounds,
        "green-red": params.green_red_bounds,
        "pseudo-ndvi": params.pseudo_ndvi_bounds,
    }[index]
    return min(bounds), max(bounds)


def suggest_labels(facts: ClassFacts, threshold: float, index: str | None, params: SpectralParams) -> list[str]:
    """Suggest the information class of each class (V36): one of ``msbdb.landcover.LABELS``.

    Parameters
    ----------
    facts : ClassFacts
        The classes.
    threshold : float
        Vegetation index above which a class is green; NaN for none.
    index : str or None
        Name of the vegetation index.
    params : SpectralParams
        The thresholds.

    Returns
    -------
    list of str
        One a class.

    Notes
    -----
    The first rule that holds decides:

    1. Vegetation: green, and not as smooth as a roof. The index must exceed its threshold. For rough classes the
       threshold is lower, by up to ``leafless_share`` of the width of its bounds, for bare crowns and crowns in shadow.
    2. Other: rougher than any roof.
    3. Water: smooth, with a very low NDVI.
    4. Shadow: dark, and not known to be smoother than ``rough_m``. Smooth dark classes are roofs, in shadow or dark.
    5. Building: all other classes, as only cells above the mask are classified.

    Where a value is unknown, its rule does not hold.

    Examples
    --------
    A green rough class, a smooth bright one, and a dark rough one:

    >>> index, bright, rough = np.array([[0.6, 0.1, 0.1], [0.3, 0.5, 0.05], [0.6, 0.03, 0.6]])
    >>> facts = ClassFacts(index, bright, rough, np.full(3, 6.0))
    >>> suggest_labels(facts, 0.3, "ndvi", SpectralParams())
    ['vegetation', 'building', 'shadow']
    """
    return [
        _label(*values, threshold=threshold, index=index, params=params)
        for values in zip(facts.index, facts.brightness, facts.roughness, strict=True)
    ]


def _label(
    greenness: float, bright: float, rough: float, *, threshold: float, index: str | None, params: SpectralParams
) -> str:
    """Suggest the label of one class; comparisons with NaN are false."""
    smooth = rough < params.smooth_m
    crown = np.interp(rough, [params.smooth_m, max(params.rough_m, params.smooth_m)], [0.0, 1.0])
    low, high = index_bounds(index, params) if index else (0.0, 0.0)
    needed = threshold - params.leafless_share * (high - low) * float(np.nan_to_num(crown))
    if (greenness > needed and not smooth) or (np.isnan(greenness) and rough >= params.rough_m):
        return "vegetation"
    if rough >= params.clutter_m:
        return "other"
    if index == "ndvi" and greenness < params.water_ndvi and smooth:
        return "water"
    if bright < params.shadow_brightness and not rough < params.rough_m:
        return "shadow"
    return "building"
