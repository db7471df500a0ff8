"""The model of the spectral classes (V34 to V36): filtered bands, centres in canonical order, and suggested labels.

The paper leaves the labels to an operator, who may correct ours. Our rules look at whole classes, never at single
cells, and each threshold is a parameter marked as ours. The one adaptive threshold, of the vegetation index, stays
within stated bounds.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from skimage.filters import threshold_otsu

from msbdb.grid import Bands, Grid
from msbdb.labels import sizes, sums
from msbdb.morphology.area import area_closing, area_opening
from msbdb.params import Params, SpectralParams
from msbdb.spectral.colours import Scaling
from msbdb.spectral.kmeans import Centres, Sample, fit_centres, nearest_class
from msbdb.surveyplan import ClassPlan, known, numbers
from msbdb.threads import in_threads

INDEX_BANDS = {"ndvi": ("nir", "red"), "green-red": ("green", "red"), "pseudo-ndvi": ("intensity", "red")}
"""The two bands a and b of each vegetation index (a - b) / (a + b), in order of preference."""

SURE_SHARES = (0.05, 0.95)
"""Ours: lowest and highest share of roofs that counts, as the structure errs on one cell in twenty where it is sure."""


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
    roof_share : (K,) ndarray of float64
        Share of the cells that are roofs by structure.
    """

    index: NDArray[np.float64]
    brightness: NDArray[np.float64]
    roughness: NDArray[np.float64]
    height: NDArray[np.float64]
    roof_share: NDArray[np.float64]


def choose_index(names: tuple[str, ...], wanted: str) -> str | None:
    """Choose the vegetation index that the bands allow: the one wanted, or the best; None when no index is possible.

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

    1. Vegetation: green, not as smooth as a roof, and by structure not mostly roofs. The index must exceed its
       threshold. For rough classes the threshold is lower, by up to ``leafless_share`` of the width of its bounds, for
       bare crowns and crowns in shadow. Pictures may have roofs of the colour of crowns, or no hue at all. So the
       share of roofs must not exceed ``roof_share``, or ``green_roof_share`` for an index above its bounds.
    2. Other: rougher than any roof.
    3. Water: smooth, with a very low NDVI.
    4. Shadow: dark, and not known to be smoother than ``rough_m``. Smooth dark classes are roofs, in shadow or dark.
    5. Building: all other classes, as only cells above the mask are classified.

    Where a value is unknown, its rule does not hold.

    Examples
    --------
    A green rough class, a smooth bright one, and a dark rough one, of which nobody knows the structure:

    >>> index, bright, rough = np.array([[0.6, 0.1, 0.1], [0.3, 0.5, 0.05], [0.6, 0.03, 0.6]])
    >>> facts = ClassFacts(index, bright, rough, np.full(3, 6.0), np.full(3, np.nan))
    >>> suggest_labels(facts, 0.3, "ndvi", SpectralParams())
    ['vegetation', 'building', 'shadow']
    """
    values = zip(facts.index, facts.brightness, facts.roughness, facts.roof_share, strict=True)
    return [_label(*each, threshold=threshold, index=index, params=params) for each in values]


def _label(
    greenness: float,
    bright: float,
    rough: float,
    roofs: float,
    *,
    threshold: float,
    index: str | None,
    params: SpectralParams,
) -> str:
    """Suggest the label of one class; comparisons with NaN are false."""
    smooth = rough < params.smooth_m
    crown = np.interp(rough, [params.smooth_m, max(params.rough_m, params.smooth_m)], [0.0, 1.0])
    low, high = index_bounds(index, params) if index else (0.0, 0.0)
    needed = threshold - params.leafless_share * (high - low) * float(np.nan_to_num(crown))
    roof = roofs > (params.green_roof_share if index and greenness > high else params.roof_share)
    leafy = (greenness > needed and not smooth) or (np.isnan(greenness) and rough >= params.rough_m)
    if leafy and not roof:
        return "vegetation"
    if rough >= params.clutter_m:
        return "other"
    if index == "ndvi" and greenness < params.water_ndvi and smooth:
        return "water"
    if bright < params.shadow_brightness and not rough < params.rough_m:
        return "shadow"
    return "building"


def filter_bands(bands: Bands, inside: NDArray[np.bool_], area_m2: float, *, connectivity: int = 8) -> Bands:
    """Open and close every band with one area, within the cells that will be clustered.

    Small bright and dark objects (chimneys, cars, roof windows) take the value of what surrounds them. So k-means gets
    fewer different values.

    Parameters
    ----------
    bands : Bands
        The bands to filter.
    inside : (H, W) ndarray of bool
        The cells to be clustered. Cells outside do not exist for the filter and become invalid. So each island of
        cells is filtered apart from all others, in whatever tile it lies.
    area_m2 : float
        Smallest object that stays, "a bit smaller than the smallest building". Below two cells nothing is filtered.
    connectivity : int
        4 or 8.

    Returns
    -------
    Bands
        On the same lattice, valid where ``inside`` and the bands are.

    Notes
    -----
    AOC_s(b) = φ_s(γ_s(b)) of each band b (V5) [1]_ (Section 3.2). An island smaller than the area has nothing to be
    compared with and keeps its values. The paper filters the whole image; within the mask, roofs do not take the
    colour of the street.

    References
    ----------
    .. [1] Vu, T.T., Yamazaki, F., Matsuoka, M., 2009. Multi-scale solution for building extraction from LiDAR and
       image data. International Journal of Applied Earth Observation and Geoinformation 11 (4), 281-289.
       doi:10.1016/j.jag.2009.03.005.
    """
    valid = bands.valid & inside
    threshold = round(area_m2 / bands.spec.cell_area_m2)
    values = np.zeros(bands.values.shape, dtype=np.float32)

    def write_band(number: int) -> None:
        band = bands.values[number]
        filtered = _filter(band, valid, threshold, connectivity) if threshold >= 2 else band
        np.copyto(values[number], filtered, where=valid)

    if valid.any():
        in_threads(write_band, range(len(values)))
    return Bands(values, bands.names, valid, bands.spec)


def _filter(
    band: NDArray[np.float32], valid: NDArray[np.bool_], threshold_px: int, connectivity: int
) -> NDArray[np.float32]:
    """Open and close one band; outside lies below all values for the opening and above all for the closing.

    What is returned there has no meaning.
    """
    below = np.float32(band[valid].min() - 1)
    above = np.float32(band[valid].max() + 1)
    opened = area_opening(np.where(valid, band, below), threshold_px, connectivity=connectivity)
    opened[opened <= below] = above  # islands that are too small, and what lies outside
    closed = area_closing(opened, threshold_px, connectivity=connectivity)
    return np.where(closed >= above, band, closed)


@dataclass(frozen=True, slots=True, eq=False)
class ClassModel:
    """Fitted classes: with it, any tile of the survey is classified as the whole would be.

    Parameters
    ----------
    centres : Centres
        In canonical order: by mean vegetation index, then brightness.
    facts : ClassFacts
        What is known of each class from the sample.
    band_means : (K, B) ndarray of float64
        Mean of each band as it came, in the source's units.
    suggested : tuple of str
        The automatic label of each class.
    index : str or None
        The vegetation index in use.
    threshold : float
        Of the vegetation index; NaN for none.
    all_roofs : float
        Share of all cells that are roofs by structure; NaN for unknown.
    """

    centres: Centres
    facts: ClassFacts
    band_means: NDArray[np.float64]
    suggested: tuple[str, ...]
    index: str | None
    threshold: float
    all_roofs: float

    @property
    def roof_odds(self) -> NDArray[np.float64] | None:
        """Return the (K + 1,) log-odds of roof by the structure: of all cells, and then of each class.

        ln(p / (1 - p)) of their shares p of roofs within `SURE_SHARES`; of a class without cells, that of all. None
        where the structure was not known.
        """
        if np.isnan(self.all_roofs):
            return None
        shares = np.append(self.all_roofs, np.nan_to_num(self.facts.roof_share, nan=self.all_roofs))
        shares = shares.clip(*SURE_SHARES)
        return np.asarray(np.log(shares / (1 - shares)))

    @property
    def plan(self) -> ClassPlan:
        """The model as the plan of a survey has it."""
        scaling, facts = self.centres.scaling, self.facts
        return ClassPlan(
            bands=scaling.names,
            low=scaling.low,
            high=scaling.high,
            centres=tuple(tuple(map(float, centre)) for centre in self.centres.values),
            vegetation_index=self.index,
            vegetation_threshold=known(np.array([self.threshold]))[0],
            labels=self.suggested,
            index=known(facts.index),
            brightness=known(facts.brightness),
            roughness_m=known(facts.roughness),
            height_m=known(facts.height),
            roof_share=known(facts.roof_share),
            all_roofs=known(np.array([self.all_roofs]))[0],
            band_means=tuple(map(known, self.band_means)),
        )

    @classmethod
    def of_plan(cls, plan: ClassPlan) -> "ClassModel":
        """Return the model that a plan has, the inverse of ``plan``."""
        columns = (plan.index, plan.brightness, plan.roughness_m, plan.height_m, plan.roof_share)
        facts = ClassFacts(*map(numbers, columns))
        return cls(
            Centres(Scaling(plan.bands, plan.low, plan.high), numbers(plan.centres)),
            facts,
            numbers(plan.band_means),
            plan.labels,
            plan.vegetation_index,
            float(numbers((plan.vegetation_threshold,))[0]),
            float(numbers((plan.all_roofs,))[0]),
        )

    def as_dict(self) -> dict[str, object]:
        """Return what classifies another tile alike, as plain values: scaling, centres, index and roofs (V21).

        ``low`` and ``high`` hold the values of each of ``bands`` that become 0 and 1; ``centres`` has a row for each
        class, from class 1 on, with a scaled value for each band. ``roof_share`` and ``all_roofs`` are the shares of
        roofs by structure.
        """
        scaling = self.centres.scaling
        return {
            "bands": list(scaling.names),
            "low": list(scaling.low),
            "high": list(scaling.high),
            "centres": self.centres.values.tolist(),
            "vegetation_index": self.index,
            "vegetation_threshold": self.threshold,
            "roof_share": list(known(self.facts.roof_share)),
            "all_roofs": known(np.array([self.all_roofs]))[0],
        }


def filter_to_classify(bands: Bands, ndsm: Grid, params: Params) -> Bands:
    """Return the bands after the area filter (V34), valid just where cells are clustered: above the mask (V35).

    The filter follows the finest scale, so ``scale.scales_m2`` must not be empty.
    """
    heights = np.asarray(ndsm.values, dtype=np.float64)
    inside = ndsm.valid & (heights >= params.surface.mask_m)
    area_m2 = params.spectral.filter_share * min(params.scale.scales_m2)
    return filter_bands(bands, inside, area_m2, connectivity=params.scale.connectivity)


def fit_model(sample: Sample, params: SpectralParams) -> ClassModel:
    """Fit the classes on a sample of at least one cell, put them in canonical order and suggest their labels."""
    centres = fit_centres(sample, classes=params.classes, seed=params.seed, tail_percent=params.tail_percent)
    index = choose_index(sample.names, params.vegetation_index)
    greenness = vegetation_index(sample, centres.scaling, index)
    bright = brightness(sample, centres.scaling)
    member = nearest_class(sample.filtered, centres)
    rank = [_by_class(np.nan_to_num(values), member, len(centres)) for values in (bright, greenness)]
    centres = Centres(centres.scaling, centres.values[np.lexsort(rank)])
    member = nearest_class(sample.filtered, centres)
    facts = ClassFacts(
        _by_class(greenness, member, len(centres)),
        _by_class(bright, member, len(centres)),
        np.array([_median(sample.roughness[member == k]) for k in range(1, len(centres) + 1)]),
        _by_class(sample.height, member, len(centres)),
        _by_class(sample.roof, member, len(centres)),
    )
    threshold = index_threshold(greenness, index, params)
    means = np.stack([_by_class(band, member, len(centres)) for band in sample.bands.T], axis=1)
    suggested = tuple(suggest_labels(facts, threshold, index, params))
    return ClassModel(centres, facts, means, suggested, index, threshold, float(sample.roof.mean()))


def _by_class(values: NDArray[np.float64], member: NDArray[np.uint8], classes: int) -> NDArray[np.float64]:
    """Mean of the values in each class; NaN for a class without cells."""
    count, total = sizes(member, classes), sums(member, values, classes)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def _median(values: NDArray[np.float64]) -> float:
    """Median of the known values; NaN without any."""
    known = values[~np.isnan(values)]
    return float(np.median(known)) if known.size else float("nan")
