"""Each cell's own evidence of roof, from a build to the database and back, and again after labels by hand."""

import shutil
from dataclasses import replace

import numpy as np
import pytest
from simulated.files import write_points
from simulated.scenes import SCENES
from support.sizes import sample

import msbdb
from msbdb.database import read_rasters
from msbdb.detect.scene import Evidence
from msbdb.kept import Rasters
from msbdb.params import Params
from msbdb.run.preparation.drafts import build_surface
from msbdb.surface import cover_from_surface
from msbdb.tables import HEIGHTS

EVIDENCE = {"roughness_mm": "uint16", "roof_probability": "uint8"}

KEPT = EVIDENCE | {"terrain_cm": "int32", "echoes": "uint16", "intensity": "uint8"}


@pytest.fixture(scope="module")
def points(tmp_path_factory):
    """Return the points of a house under crowns."""
    return write_points(tmp_path_factory.mktemp("towns") / "under_trees.laz", SCENES["under_trees"]().points)


def kept(db):
    """Return the rasters that a database keeps, by name."""
    with msbdb.open(db) as opened:
        return read_rasters(opened.engine).by_name()


@pytest.mark.parametrize("extract", sample([["multiscale"], ["flatregions"], ["multiscale", "flatregions"]], 2))
def test_a_build_keeps_the_evidence(points, tmp_path, extract):
    """In small types, on the lattice of the heights, whichever detectors were run."""
    db = tmp_path / "town.sqlite"
    msbdb.build([points], db=db, survey="town", extract=extract)
    state = kept(db)
    assert {name: str(state[name].dtype) for name in KEPT} == KEPT
    assert {state[name].shape for name in KEPT} == {state["ndsm_cm"].shape}


def test_labels_of_an_operator_leave_no_trace_in_the_rasters(points, tmp_path):
    """Labels take the house away and bring it back, with the same rasters to the bit."""
    db = tmp_path / "town.sqlite"
    msbdb.build([points], db=db, survey="town", extract=("multiscale", "flatregions"))
    before = kept(db)
    with msbdb.open(db) as opened:
        measured = opened.buildings()
    labelled = shutil.copy(db, tmp_path / "labelled.sqlite")
    with msbdb.open(labelled) as opened:
        classes = opened.classes()
    roofs = classes.loc[classes["label"] == "building", "speindex"].tolist()
    for label in ("vegetation", "building"):
        msbdb.relabel(labelled, dict.fromkeys(roofs, label))
    after = kept(labelled)
    assert sorted(before) == sorted(after)
    for name in before:
        np.testing.assert_array_equal(before[name], after[name], strict=True)
    with msbdb.open(labelled) as opened:
        again = opened.buildings()
    assert measured[list(HEIGHTS)].notna().all(axis=None)
    assert again[list(HEIGHTS)].equals(measured[list(HEIGHTS)])


def test_the_evidence_is_rounded_to_whole_millimetres_and_255ths():
    """Half a unit is the most that is lost, and what is kept comes back as it was."""
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
