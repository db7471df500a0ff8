"""The automatic suggestion of what a class is (V36)."""

from dataclasses import replace

import numpy as np
import pytest

from msbdb.params import SpectralParams
from msbdb.spectral.colours import fit_scaling
from msbdb.spectral.kmeans import Sample
from msbdb.spectral.model import (
    ClassFacts,
    ClassModel,
    brightness,
    choose_index,
    fit_model,
    index_threshold,
    suggest_labels,
    vegetation_index,
)

NAN = float("nan")
PARAMS = SpectralParams()


def _label(index, bright, rough, *, threshold=0.1, name="ndvi", roofs=NAN):
    """Label of one class."""
    facts = ClassFacts(*(np.array([value]) for value in (index, bright, rough, 5.0, roofs)))
    return suggest_labels(facts, threshold, name, PARAMS)[0]


@pytest.mark.parametrize(
    ("index", "bright", "rough", "label"),
    [
        (0.4, 0.3, 0.6, "vegetation"),
        (0.4, 0.3, NAN, "vegetation"),
        (0.4, 0.3, 0.02, "building"),
        (-0.1, 0.6, 0.05, "building"),
        (-0.1, 0.6, NAN, "building"),
        (0.05, 0.4, 2.0, "vegetation"),
        (0.02, 0.4, 0.5, "vegetation"),
        (0.02, 0.4, 0.2, "building"),
        (-0.3, 0.4, 2.0, "other"),
        (-0.3, 0.4, 0.6, "building"),
        (-0.1, 0.05, 0.8, "shadow"),
        (-0.1, 0.05, NAN, "shadow"),
        (-0.1, 0.05, 0.02, "building"),
        (-0.5, 0.1, 0.02, "water"),
        (NAN, NAN, 2.0, "vegetation"),
        (NAN, NAN, 0.05, "building"),
        (NAN, NAN, NAN, "building"),
    ],
)
def test_rules(index, bright, rough, label):
    """Crown, planted roof, roof, bare crown, clutter, shadow, dark roof, water, and facts that are not known."""
    assert _label(index, bright, rough) == label


@pytest.mark.parametrize(
    ("index", "roofs", "label"),
    [
        (0.15, 0.4, "vegetation"),
        (0.15, 0.6, "building"),
        (0.4, 0.6, "vegetation"),
        (0.4, 0.8, "building"),
        (0.4, NAN, "vegetation"),
    ],
)
def test_roofs_of_the_colour_of_crowns_are_known_by_structure(index, roofs, label):
    """A class that is mostly roofs by structure is no vegetation; one that is surely green needs three quarters."""
    assert _label(index, 0.3, 0.3, roofs=roofs) == label


def test_a_rough_class_of_one_band_is_no_vegetation_where_it_is_mostly_roofs():
    """Without an index the structure decides alone."""
    assert _label(NAN, NAN, 0.8, roofs=0.2) == "vegetation"
    assert _label(NAN, NAN, 0.8, roofs=0.6) == "building"


def test_water_needs_a_near_infrared_band():
    """A red roof has a low green-red index and is no water."""
    assert _label(-0.5, 0.4, 0.02, name="green-red") == "building"


def test_best_index_is_chosen_and_a_wish_is_granted_where_possible():
    """Near infrared first, then green and red, then intensity (V20)."""
    assert choose_index(("red", "green", "nir", "intensity"), "auto") == "ndvi"
    assert choose_index(("red", "green", "intensity"), "auto") == "green-red"
    assert choose_index(("red", "green", "intensity"), "pseudo-ndvi") == "pseudo-ndvi"
    assert choose_index(("red", "intensity"), "ndvi") == "pseudo-ndvi"
    assert choose_index(("intensity",), "auto") is None


def _sample(names, *rows):
    """Make a sample of given band values."""
    values = np.array(rows, dtype=float)
    unknown = np.full(len(values), NAN)
    return Sample(names, np.arange(len(values), dtype=np.uint64), values, values, unknown, unknown, unknown)


def test_indices_by_their_formula():
    """NDVI and green-red take the source's values; pseudo-NDVI the scaled ones; black is 0."""
    sample = _sample(("red", "green", "nir", "intensity"), (50, 100, 150, 4000), (0, 0, 0, 0))
    scaling = fit_scaling(sample.bands, sample.names, 0.0)
    np.testing.assert_allclose(vegetation_index(sample, scaling, "ndvi"), [0.5, 0])
    np.testing.assert_allclose(vegetation_index(sample, scaling, "green-red"), [1 / 3, 0])
    np.testing.assert_allclose(vegetation_index(sample, scaling, "pseudo-ndvi"), [0, 0])
    assert np.isnan(vegetation_index(sample, scaling, None)).all()


def test_intensity_is_no_brightness():
    """A strong echo does not make a dark roof bright."""
    sample = _sample(("red", "intensity"), (0, 0), (0, 100), (100, 100))
    scaling = fit_scaling(sample.bands, sample.names, 0.0)
    np.testing.assert_allclose(brightness(sample, scaling), [0, 0, 1])
    alone = _sample(("intensity",), (0,), (9,))
    assert np.isnan(brightness(alone, fit_scaling(alone.bands, alone.names, 0.0))).all()


def test_threshold_lies_between_roofs_and_crowns_and_within_its_bounds():
    """Otsu's value where both are there; the nearer bound where there is only one kind."""
    rng = np.random.default_rng(0)
    roofs, crowns = rng.normal(-0.1, 0.06, 5000), rng.normal(0.35, 0.08, 5000)
    both = index_threshold(np.append(roofs, crowns), "ndvi", PARAMS)
    assert 0.0 < both < 0.2
    assert index_threshold(roofs, "ndvi", PARAMS) == 0.0
    assert index_threshold(crowns, "ndvi", PARAMS) == 0.2
    assert np.isnan(index_threshold(roofs, None, PARAMS))


def test_classes_know_their_odds_of_roof_and_keep_them_in_a_plan():
    """Of three colours one is always a roof, one never, one half of the time; shares are cut at 5 and 95 per cent."""
    values = np.repeat([[0.0], [50.0], [100.0]], 40, axis=0)
    unknown = np.full(len(values), NAN)
    roof = np.concatenate((np.ones(40), np.arange(40) % 2, np.zeros(40)))
    sample = Sample(("red",), np.arange(len(values), dtype=np.uint64), values, values, unknown, unknown, roof)
    model = fit_model(sample, PARAMS)
    np.testing.assert_allclose(model.roof_odds, [0.0, np.log(19), 0.0, -np.log(19)], atol=1e-12)
    again = ClassModel.of_plan(model.plan)
    np.testing.assert_array_equal(again.roof_odds, model.roof_odds)
    assert fit_model(replace(sample, roof=unknown), PARAMS).roof_odds is None
