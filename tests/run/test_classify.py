"""What decides of a point: its cell and height, or its label; and the colours that extractors on points are given."""

from types import SimpleNamespace

import laspy
import numpy as np
import pandas as pd
import pytest
from affine import Affine
from pyproj import CRS
from simulated.files import write_points
from simulated.scenes import SCENES
from support.notices import with_notices

import msbdb
from msbdb.detect.adaptive import bathurst
from msbdb.detect.area3d import caowu
from msbdb.detect.pointregions import Candidates, point_ndvi, point_noise, recorded_at
from msbdb.grid import Bands, Grid, GridSpec
from msbdb.io.las import read_points
from msbdb.ledger import Ledger
from msbdb.params import Params, with_values
from msbdb.points.cloud import PointCloud
from msbdb.run.classify import points_in
from msbdb.tables import REJECTION

UTM33 = CRS.from_epsg(32633)
MODULES = {"adaptive": bathurst, "area3d": caowu}
SPEC = GridSpec((2, 3), Affine(2.0, 0.0, 100.0, 0.0, -2.0, 204.0), UTM33)


def cloud_at(*places):
    """Return points at (easting, northing)."""
    x, y = np.array(places, dtype=np.float64).T
    return PointCloud(x, y, np.zeros(len(x)), crs=UTM33)


def test_cell_and_height_decide_together():
    """A point outside of the lattice, below the mask, or of unknown height is no building."""
    cells = np.array([[True, False, False], [False, False, True]])
    cloud = cloud_at((101, 203), (103, 203), (105, 201), (101, 203), (99, 203), (101, 205), (107, 201), (105, 201))
    heights = np.array([2.0, 9.0, 5.0, 1.99, 9.0, 9.0, 9.0, np.nan])
    taken = points_in(cells, SPEC, cloud, heights, 2.0)
    np.testing.assert_array_equal(taken, [True, False, True, False, False, False, False, False])


def test_points_take_the_vegetation_index_of_their_cells():
    """(nir - red) / (nir + red); unknown where there is no colour, no cell, or black; none without both bands."""
    red = np.array([[10, 30, 0], [50, 20, 20]], dtype=np.float32)
    nir = np.array([[30, 10, 0], [50, 0, 60]], dtype=np.float32)
    valid = np.array([[True, True, True], [True, True, False]])
    bands = Bands(np.stack([red, nir]), ("red", "nir"), valid, SPEC)
    cloud = cloud_at((101, 203), (103, 203), (105, 203), (101, 201), (103, 201), (105, 201), (99, 201))
    index = point_ndvi(bands, cloud)
    assert index.dtype == np.float32
    np.testing.assert_allclose(index, [0.5, -0.5, np.nan, 0.0, -1.0, np.nan, np.nan])
    assert point_ndvi(None, cloud) is None
    assert point_ndvi(Bands(red[None], ("red",), valid, SPEC), cloud) is None


def test_points_take_half_of_the_noise_of_their_cells_and_cells_of_a_raster_none():
    """By variance, and none outside of the lattice. What makes the cells of a raster rough is the relief in them."""
    noise_m = np.array([[0.1, 0.2, 0.3], [0.4, 0.5, 0.6]], dtype=np.float32)
    heights = Grid(np.zeros(SPEC.shape, dtype=np.float32), np.ones(SPEC.shape, dtype=bool), SPEC)
    cloud = cloud_at((105, 201), (101, 203), (99, 201), (103, 203))
    scene = SimpleNamespace(noise_m=noise_m, cloud=cloud, heights=heights)
    found = point_noise(scene, cloud)
    assert found.dtype == np.float32
    np.testing.assert_allclose(found**2, [0.18, 0.005, 0, 0.02], rtol=1e-5)
    assert point_noise(SimpleNamespace(noise_m=noise_m, cloud=None, heights=heights), cloud) is None
    assert point_noise(SimpleNamespace(noise_m=None, cloud=cloud, heights=heights), cloud) is None


def test_points_know_how_far_later_echoes_were_recorded_around_them():
    """As their cells do, and in full outside of the lattice; nobody asks where they were recorded everywhere."""
    recorded = np.array([[0.1, 0.2, 0.3], [0.4, 0.5, 0.6]], dtype=np.float32)
    heights = Grid(np.zeros(SPEC.shape, dtype=np.float32), np.ones(SPEC.shape, dtype=bool), SPEC)
    cloud = cloud_at((105, 201), (101, 203), (99, 201), (103, 203))
    found = recorded_at(SimpleNamespace(recorded=recorded, heights=heights), cloud)
    np.testing.assert_array_equal(found, np.float32([0.6, 0.1, 1, 0.2]))
    assert recorded_at(SimpleNamespace(recorded=None, heights=heights), cloud) is None


@pytest.mark.parametrize("method", ["area3d", "adaptive"])
def test_labels_of_points_decide_for_extractors_on_points(tmp_path, monkeypatch, method):
    """A labelled point is a building, whatever its cell and height; the extractor sees cloud, heights and colours."""
    source = write_points(tmp_path / "town.laz", SCENES["podium_tower"](density=1.0).points)
    seen = {}

    def extract(cloud, heights, *, spec, survey, params, ndvi, noise_m, recorded):
        seen.update(cloud=cloud, heights=heights, spec=spec, survey=survey, ndvi=ndvi)
        labels = (np.arange(len(cloud)) % 3).astype(np.int32)
        regions = pd.DataFrame({"xcen": [0.0, 1.0], "ycen": [0.0, 0.0]})
        return Candidates(method, labels, regions, REJECTION.empty(), {}, Ledger(method).marked())

    monkeypatch.setattr(MODULES[method], f"extract_{method}", extract)
    report = msbdb.api.classify(source, tmp_path / "out.laz", extract=(method,))
    cloud, _ = with_notices(read_points, source)
    np.testing.assert_array_equal(laspy.read(tmp_path / "out.laz").classification == 6, np.arange(len(cloud)) % 3 > 0)
    assert (seen["survey"], seen["ndvi"].shape, seen["heights"].shape) == ("town", (len(cloud),), (len(cloud),))
    np.testing.assert_array_equal(seen["cloud"].x, cloud.x)
    assert seen["spec"].crs == cloud.crs
    assert (report.regions, report.building_points) == ({method: 2}, np.count_nonzero(np.arange(len(cloud)) % 3))


def test_points_that_detectors_are_not_shown_are_classified(tmp_path):
    """Of a survey that is thinned, and of points that are there twice, all get a class: that of what lies around."""
    points = SCENES["podium_tower"](density=2.0).points
    dense = with_values(Params(), {"surface": {"most_density": 1.0}})
    classes = []
    for name, order, params in (
        ("once", np.arange(len(points)), Params()),
        ("twice", np.repeat(np.arange(len(points)), 2), Params()),
        ("dense", np.arange(len(points)), dense),
    ):
        source = write_points(tmp_path / f"{name}.laz", points.take(order))
        msbdb.api.classify(source, tmp_path / f"out_{name}.laz", params=params)
        classes.append(np.asarray(laspy.read(tmp_path / f"out_{name}.laz").classification) == 6)
    once, twice, thinned = classes
    assert once.any()
    np.testing.assert_array_equal(twice, np.repeat(once, 2))
    assert np.count_nonzero(once & thinned) > 0.9 * np.count_nonzero(once | thinned)
