"""Classification from bands to class map and tables, on scenes with known cover (V34 to V36)."""

import numpy as np
import pytest
from scipy import ndimage
from simulated import scenes

from msbdb.errors import GridMismatchError
from msbdb.grid import Bands, Grid
from msbdb.params import Params
from msbdb.spectral.colours import spectral_bands
from msbdb.spectral.coverclasses import classify
from msbdb.surface.gridding import sample_nearest
from msbdb.surface.texture import roughness
from msbdb.tables import SPECTRAL_CLASS, SPECTRAL_CLASS_BAND, validate

PARAMS = Params()


class Case:
    """A scene's bands, nDSM and roughness, made by the shortest means."""

    def __init__(self, name, names=("red", "green", "blue", "nir")):
        self.scene = scenes.SCENES[name]()
        spec, points = self.scene.spec, self.scene.points
        samples = sample_nearest(points, spec)
        top = samples.z - self.scene.ground(*spec.xy(*np.indices(spec.shape)))
        top = top[tuple(ndimage.distance_transform_edt(np.isnan(top), return_indices=True)[1])]
        self.ndsm = Grid(top.astype(np.float32), np.ones(spec.shape, dtype=bool), spec)
        self.roughness = roughness(samples, 1.5)
        ortho = self.scene.ortho(spec)
        chosen = [("red", "green", "blue", "nir").index(n) for n in names]
        self.bands = Bands(ortho[chosen], names, np.ones(spec.shape, dtype=bool), spec)

    def shares(self, classes):
        """Share of clustered crown cells called vegetation, and of roof cells called building."""
        seen = classes.index > 0
        crown = seen & (self.scene.cover == scenes.VEGETATION)
        roof = seen & (self.scene.cover == scenes.BUILDING)
        return classes.labelled("vegetation")[crown].mean(), classes.labelled("building")[roof].mean()


@pytest.fixture(scope="module")
def city():
    """Scan the city, with its four-band orthophoto."""
    return Case("city")


@pytest.fixture(scope="module")
def classified(city):
    """Classify the city by the defaults."""
    return classify(city.bands, city.ndsm, city.roughness, PARAMS)


def test_crowns_are_told_from_roofs(city, classified):
    """Nearly all crown cells are vegetation and nearly all roof cells building."""
    crowns, roofs = city.shares(classified[0])
    assert crowns > 0.9
    assert roofs > 0.9


def test_colours_without_infrared_tell_crowns_from_roofs():
    """Green against red stands in for NDVI."""
    case = Case("under_trees", ("red", "green", "blue"))
    crowns, roofs = case.shares(classify(case.bands, case.ndsm, case.roughness, PARAMS)[0])
    assert crowns > 0.85
    assert roofs > 0.85


@pytest.mark.parametrize("picture", ["grey", "green roofs"])
def test_roofs_are_roofs_in_pictures_that_do_not_tell_them_from_crowns(city, picture):
    """In cells as coarse as roofs are rough, no hue and the hue of crowns say nothing against the structure."""
    values = np.array(city.bands.values[:3])
    if picture == "grey":
        values[:] = values.mean(axis=0)
    else:
        green = values[:, city.scene.cover == scenes.VEGETATION].mean(axis=1)
        roofs = city.scene.cover == scenes.BUILDING
        values[:, roofs] = green[:, None] * (values[:, roofs].mean(axis=0) / values[:, roofs].mean())
    bands = Bands(values, ("red", "green", "blue"), np.array(city.bands.valid), city.bands.spec)
    rough = np.maximum(city.roughness, np.float32(0.15))
    roof = (city.scene.cover == scenes.BUILDING) & (np.random.default_rng(1).random(city.scene.cover.shape) < 0.9)
    _, alone = city.shares(classify(bands, city.ndsm, rough, PARAMS).classes)
    _, with_structure = city.shares(classify(bands, city.ndsm, rough, PARAMS, roof=roof).classes)
    assert alone < 0.5
    assert with_structure > 0.9


def test_only_cells_of_at_least_one_storey_are_classified(city, classified):
    """Cells below the mask are 0, all others have a class (V35)."""
    np.testing.assert_array_equal(classified[0].index > 0, city.ndsm.values >= PARAMS.surface.mask_m)


def test_tables_are_as_declared_and_add_up(city, classified):
    """Counts, shares and means describe the map."""
    classes, frame, means, _ = classified
    validate(frame, SPECTRAL_CLASS)
    validate(means, SPECTRAL_CLASS_BAND)
    assert frame["speindex"].tolist() == list(range(1, 16))
    assert frame["cells"].tolist() == np.bincount(classes.index.ravel(), minlength=16)[1:].tolist()
    assert frame["share"].sum() == pytest.approx(1)
    assert set(frame["labelled_by"]) == {"automatic"}
    assert dict(zip(frame["speindex"], frame["label"], strict=True)) == dict(classes.labels)
    row = means[(means["speindex"] == 3) & (means["band"] == "nir")]
    assert row["mean"].item() == pytest.approx(city.bands.band("nir")[classes.index == 3].mean(), rel=1e-5)
    heights = city.ndsm.values[classes.index == 3]
    assert frame["height_m"][2] == pytest.approx(heights.mean(), rel=1e-5)


def test_classes_come_in_canonical_order(classified):
    """Numbers rise with the vegetation index, whatever k-means called them."""
    assert (np.diff(classified[1]["ndvi"]) >= 0).all()


def test_a_planted_roof_stays_a_building():
    """A lawn on a hall is green but smooth; the tree apart is vegetation."""
    case = Case("green_roof")
    crowns, roofs = case.shares(classify(case.bands, case.ndsm, case.roughness, PARAMS)[0])
    assert roofs > 0.9
    assert crowns > 0.8


def test_nothing_above_the_mask_gives_an_empty_map():
    """A bare field has no class, and the tables have no rows but all columns."""
    case = Case("flat_field")
    classes, frame, means, _ = classify(case.bands, case.ndsm, case.roughness, PARAMS)
    assert not classes.index.any()
    assert dict(classes.labels) == {}
    validate(frame, SPECTRAL_CLASS)
    validate(means, SPECTRAL_CLASS_BAND)
    assert len(frame) == len(means) == 0


def test_intensity_alone_still_gives_classes(city):
    """Without image bands brightness and index are unknown, and only very rough classes are vegetation."""
    bands = spectral_bands(None, city.scene.points, city.scene.spec, max_gap_m=5.0)
    only = Bands(bands.values[4:].copy(), ("intensity",), bands.valid.copy(), bands.spec)
    _, frame, *_ = classify(only, city.ndsm, None, PARAMS)
    assert frame["ndvi"].isna().all()
    assert frame["brightness"].isna().all()
    assert frame["roughness_m"].isna().all()
    assert set(frame["label"]) == {"building"}


def test_other_lattices_are_refused(city):
    """The messages say what to do next."""
    spec = city.bands.spec.crop(slice(0, 10), slice(0, 10))
    small = Grid(np.zeros((10, 10), dtype=np.float32), np.ones((10, 10), dtype=bool), spec)
    with pytest.raises(GridMismatchError, match="resample"):
        classify(city.bands, small, None, PARAMS)
    with pytest.raises(GridMismatchError, match="roughness"):
        classify(city.bands, city.ndsm, np.zeros((3, 3)), PARAMS)
