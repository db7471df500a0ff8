"""Footprints of parts and flat regions together, from a build to its readers, and again after labels by hand."""

import shutil
from dataclasses import replace

import numpy as np
import pyogrio
import pytest
from simulated.builds import small_build
from simulated.files import write_points
from simulated.scenes import SCENES
from support.sizes import sample

import msbdb
from msbdb.api import evaluate_points
from msbdb.database import read_rasters, read_survey
from msbdb.detect.scene import Evidence
from msbdb.errors import InputError
from msbdb.fuse.footprints import fuse
from msbdb.kept import Rasters, lattice_of
from msbdb.outline.polygons import rasterise
from msbdb.params import Params, with_values
from msbdb.run.compose import decompose
from msbdb.run.describe import no_regions
from msbdb.run.prepare import build_surface
from msbdb.run.store import recall_scene
from msbdb.surface import cover_from_surface
from msbdb.tables import FLAT_REGION

BOTH = ("multiscale", "flatregions")
EVIDENCE = ("roughness_mm", "roof_probability")
RASTERS = {"together": "int32", "roughness_mm": "uint16", "roof_probability": "uint8"}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Return a folder with the points of three towns: houses of unlike heights, a house under crowns, a quarter."""
    made = tmp_path_factory.mktemp("towns")
    for name in ("podium_tower", "under_trees", "city"):
        write_points(made / f"{name}.laz", SCENES[name]().points)
    return made


@pytest.fixture(scope="module")
def town(folder):
    """Build the house under crowns with both extractors."""
    db = folder / "town.sqlite"
    msbdb.build([folder / "under_trees.laz"], db=db, survey="town", extract=BOTH)
    return db


def kept(db):
    """Return the rasters that a database keeps, by name."""
    with msbdb.open(db) as opened:
        return read_rasters(opened.engine).by_name()


def test_a_build_by_both_keeps_the_labels_and_the_evidence(town):
    """Small types, one lattice; the labels are the buildings' row numbers."""
    state = kept(town)
    assert {name: str(state[name].dtype) for name in RASTERS} == RASTERS
    assert {state[name].shape for name in RASTERS} == {state["ndsm_cm"].shape}
    with msbdb.open(town) as opened:
        buildings = opened.buildings()
    assert set(np.unique(state["together"])) <= set(range(len(buildings) + 1))


def test_the_outlines_lie_on_their_buildings(town):
    """Each keeps the id, state and storeys; what both see of the house stands, measured on its own cells."""
    with msbdb.open(town) as opened:
        buildings, together = opened.buildings().set_index("building_id"), opened.together()
        spec = lattice_of(read_survey(opened.engine))
    assert len(together) > 0
    assert together["building_id"].is_monotonic_increasing
    own = buildings.loc[together["building_id"]]
    assert own["state"].tolist() == together["state"].tolist()
    assert own["storeys"].tolist() == together["storeys"].tolist()
    common = together.geometry.intersection(own.geometry.set_axis(together.index), align=False).area
    assert (common > 0.8 * together.geometry.area).all()
    assert together["area_m2"].to_numpy() == pytest.approx(together.geometry.area.to_numpy(), rel=0.1)
    assert (together["volume_m3"] / together["area_m2"]).to_numpy() == pytest.approx(together["h_mean"], rel=0.02)
    assert (rasterise(together.geometry, spec) > 0).sum() == pytest.approx((kept(town)["together"] > 0).sum(), rel=0.05)


def test_what_is_kept_is_enough_to_fuse_anew(town, folder):
    """Labels by the operator take the house away and bring it back, with the same rasters to the bit."""
    db = shutil.copy(town, folder / "labelled.sqlite")
    before = kept(db)
    with msbdb.open(db) as opened:
        classes, footprints = opened.classes(), opened.together()
    roofs = classes.loc[classes["label"] == "building", "speindex"].tolist()
    msbdb.relabel(db, dict.fromkeys(roofs, "vegetation"))
    with msbdb.open(db) as opened:
        assert len(opened.together()) == 0
        opened.export(folder / "empty.gpkg")
    msbdb.relabel(db, dict.fromkeys(roofs, "building"))
    after = kept(db)
    assert sorted(before) == sorted(after)
    for name in before:
        np.testing.assert_array_equal(before[name], after[name], strict=True)
    with msbdb.open(db) as opened:
        assert opened.together().equals(footprints)


def test_flat_cells_by_the_lower_r_have_no_say(folder, tmp_path):
    """In large cells some flat cells are not firm: the database keeps which are, and fuses alike from them."""
    db = tmp_path / "coarse.sqlite"
    coarse = with_values(Params(), {"surface": {"cell_m": 1.5}})
    msbdb.build([folder / "city.laz"], db=db, survey="coarse", extract=BOTH, params=coarse)
    before = kept(db)
    assert "flat_firm" in before
    assert (before["flat"][before["flat_firm"] == 0] > 0).any()
    with msbdb.open(db) as opened:
        classes = opened.classes()
    roofs = classes.loc[classes["label"] == "building", "speindex"].tolist()
    for label in ("vegetation", "building"):
        msbdb.relabel(db, dict.fromkeys(roofs, label))
    after = kept(db)
    for name in before:
        np.testing.assert_array_equal(before[name], after[name], strict=True)


@pytest.mark.parametrize("extract", sample([["multiscale"], ["flatregions"]], 2))
def test_one_extractor_alone_has_nothing_together(folder, tmp_path, extract):
    """No raster is kept, the export has no such layer, and who asks is told what to do."""
    db = tmp_path / "one.sqlite"
    msbdb.build([folder / "under_trees.laz"], db=db, survey="one", extract=extract)
    assert not set(RASTERS) & set(kept(db))
    with msbdb.open(db) as opened:
        opened.export(tmp_path / "one.gpkg")
        with pytest.raises(InputError, match=r"'one' has no fused footprints\..* multiscale and flatregions"):
            opened.together()
    assert "together" not in pyogrio.list_layers(tmp_path / "one.gpkg")[:, 0]


def test_the_export_has_a_layer_of_them(town, tmp_path):
    """A GeoPackage holds the outlines with ids and heights, as they are read."""
    with msbdb.open(town) as opened:
        opened.export(tmp_path / "town.gpkg")
        together = opened.together()
    found = pyogrio.read_dataframe(tmp_path / "town.gpkg", layer="together")
    assert found["building_id"].tolist() == together["building_id"].tolist()
    assert found["h_p90"].tolist() == together["h_p90"].tolist()
    assert found.geometry.area.to_numpy() == pytest.approx(together.geometry.area.to_numpy())


def test_they_are_evaluated_by_area_and_by_point(town, tmp_path):
    """Against themselves they are perfect; by point they find the points on the roof."""
    with msbdb.open(town) as opened:
        opened.together()[["geometry"]].to_file(tmp_path / "truth.gpkg")
        assert opened.evaluate(tmp_path / "truth.gpkg", of="together").area.rates.quality > 0.999
    scene = SCENES["under_trees"]()
    cloud, (row, col) = scene.points, scene.spec.rowcol(scene.points.x, scene.points.y)
    roof = (scene.buildings[row, col] > 0) & (cloud.z > cloud.z.min() + 3)
    truth = replace(cloud, classification=np.where(roof, 6, 1).astype(np.uint8))
    by_point = evaluate_points(town, write_points(tmp_path / "truth.laz", truth), of="together")
    assert by_point.matched == "footprints"
    assert by_point.points.rates.quality > 0.7


def test_the_labels_follow_the_order_of_the_ids(folder, tmp_path):
    """Each label covers the footprint of the building of that row, in a town of several."""
    db = tmp_path / "town.sqlite"
    msbdb.build([folder / "podium_tower.laz"], db=db, survey="other", extract=BOTH)
    state = kept(db)
    with msbdb.open(db) as opened:
        buildings = opened.buildings()
        spec = lattice_of(read_survey(opened.engine))
    shown = rasterise(buildings.geometry, spec)
    both = (shown > 0) & (state["together"] > 0)
    assert both.any()
    np.testing.assert_array_equal(shown[both], state["together"][both])


def test_the_evidence_is_rounded_to_whole_millimetres_and_255ths():
    """What a build fuses is what it keeps: half a unit is the most that is lost."""
    scene = SCENES["under_trees"]()
    surface = build_surface(scene.points, Params())
    structure = cover_from_surface(surface, scene.points, Params())
    evidence = Evidence.of(structure)
    assert np.abs(evidence.roughness_mm / 1000 - structure.roughness_m).max() <= 0.0005 + 1e-6
    assert np.abs(evidence.roof_probability / 255 - structure.roof_probability).max() <= 0.5 / 255 + 1e-6
    rasters = Rasters.of_heights(surface.ndsm, structure.cover.index)
    assert again_of(rasters) == (None, None)
    roughness, probability = again_of(replace(rasters, **{name: getattr(evidence, name) for name in EVIDENCE}))
    np.testing.assert_array_equal(roughness, evidence.roughness_mm, strict=True)
    np.testing.assert_array_equal(probability, evidence.roof_probability, strict=True)


def again_of(rasters):
    """Return the evidence in rasters that were named for the database and came back."""
    back = Rasters.from_names(rasters.by_name())
    return tuple(getattr(back, name) for name in EVIDENCE)


@pytest.mark.long
def test_the_values_of_the_fusion_are_parameters_of_the_build(folder, town, tmp_path):
    """They are in the run's record, and values that call all roofs rough cut what the defaults keep."""
    strict = with_values(Params(), {"fuse": {"edge_m": 20.0, "roof_share": 0.0}})
    db = tmp_path / "edges.sqlite"
    msbdb.build([folder / "under_trees.laz"], db=db, survey="town", extract=BOTH, params=strict)
    with msbdb.open(db) as opened, msbdb.open(town) as plain:
        assert opened.together().geometry.area.sum() == pytest.approx(opened.buildings().geometry.area.sum(), rel=1e-3)
        assert opened.buildings().drop(columns="geometry").equals(plain.buildings().drop(columns="geometry"))


def test_without_evidence_nothing_is_fused():
    """A run that an older msbdb kept has none, and one without flat regions has nothing to fuse."""
    scene = recall_scene(small_build())
    assert scene.evidence is None
    forest = decompose(scene, {}, None, Params())
    flat = no_regions("flatregions", FLAT_REGION, scene.heights.spec)
    assert fuse(forest, flat, scene, Params()) is None
    known = Evidence(np.zeros(scene.heights.spec.shape, np.uint16), np.zeros(scene.heights.spec.shape, np.uint8))
    assert fuse(forest, None, replace(scene, evidence=known), Params()) is None
    assert fuse(forest, flat, replace(scene, evidence=known), Params()) is not None
