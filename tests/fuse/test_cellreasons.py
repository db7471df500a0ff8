"""The reason of each raised cell that is no building, by the votes of the detectors."""

import numpy as np
import pandas as pd
import pytest
from pyproj import CRS

from msbdb.detect.scene import Elevations, Regions, Scene
from msbdb.fuse.cellreasons import explain_cells
from msbdb.grid import Grid, lattice
from msbdb.landcover import ClassMap
from msbdb.params import DETECTORS, Params
from msbdb.parts.forest import Forest
from msbdb.spectral.coverclasses import Cover
from msbdb.tables import SPECTRAL_CLASS, SPECTRAL_CLASS_BAND, Reason, Survey

SHAPE = (20, 80)
TAKEN = ("", "flatregions", "multiscale flatregions", "multiscale area3d")
"""By which detectors each of four objects is taken; none of them became a building."""


def reasons(*, of_points):
    """Return the reason of each object where the detectors decide together."""
    spec = lattice((0, 0.1, SHAPE[1] - 0.1, SHAPE[0]), 1.0, CRS.from_epsg(2154))
    objects = np.zeros(SHAPE, dtype=np.int32)
    for number in range(len(TAKEN)):
        objects[5:15, 20 * number + 5 : 20 * number + 15] = number + 1
    heights = Grid(np.where(objects > 0, 6.0, 0.0).astype(np.float32), np.ones(SHAPE, dtype=bool), spec)
    structure = ClassMap((objects > 0).astype(np.uint8), {1: "building", 2: "vegetation"}, spec)
    cover = Cover(structure, None, SPECTRAL_CLASS.empty(), SPECTRAL_CLASS_BAND.empty(), False, False, {})
    survey = Survey("here", "", spec.crs.to_wkt(), 2154, "", 1.0, 1.0, spec.bounds, ())
    scene = Scene(survey, heights, cover, None, Elevations(of_points=of_points))
    regions = {}
    for name in DETECTORS:
        own = [number + 1 for number, names in enumerate(TAKEN) if name in names.split()]
        regions[name] = Regions(name, np.isin(objects, own).astype(np.int32), None, None, {})
    none = np.zeros(SHAPE, dtype=np.int32)
    forest = Forest((), none, pd.DataFrame(), pd.DataFrame(), pd.DataFrame(), {})
    found = explain_cells(scene, regions, none > 0, forest, Params())
    return [Reason(int(found[10, 20 * number + 10])) for number in range(len(TAKEN))]


@pytest.mark.parametrize(("of_points", "half"), [(True, Reason.OUTVOTED), (False, Reason.HARDLY_SUPPORTED)])
def test_votes_that_are_enough_are_named_by_the_kind_of_source(of_points, half):
    """Half of the detectors are enough with points alone; what flat regions take by themselves has some support."""
    assert reasons(of_points=of_points) == [Reason.UNSUPPORTED, Reason.HARDLY_SUPPORTED, half, Reason.OUTVOTED]
