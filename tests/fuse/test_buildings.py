"""Buildings from parts."""

from dataclasses import replace

import geopandas as gpd
import numpy as np
import pytest
from affine import Affine
from pyproj import CRS
from shapely import MultiPolygon, box

from msbdb.errors import TableError
from msbdb.fuse.buildings import buildings_from_parts
from msbdb.grid import Grid, GridSpec
from msbdb.landcover import ClassMap
from msbdb.params import Params
from msbdb.parts.tree import extract_parts
from msbdb.tables import BUILDING, validate

UTM = CRS.from_epsg(32633)


def build(share=1.0, *, classes=True):
    """Return parts with squares for polygons, root labels and nDSM of a podium with a tower, and of a house."""
    heights = np.zeros((30, 50), dtype=np.float32)
    heights[4:24, 4:24] = 6.5
    heights[8:16, 8:16] = 30.5
    heights[5:15, 34:44] = 9.5
    spec = GridSpec((30, 50), Affine(0.5, 0, 389_000, 0, -0.5, 5_821_000), UTM)
    ndsm = Grid(heights, np.ones(heights.shape, dtype=bool), spec)
    index = np.where(heights > 0, 2, 0).astype(np.uint8)
    index[5 + round(10 * share) : 15, 34:44] = 1
    base = Params()
    params = replace(
        base,
        scale=replace(base.scale, scales_m2=(5.0, 20.0, 50.0)),
        spectral=replace(base.spectral, min_building_share=0.1),
    )
    labels = {1: "other", 2: "building"}
    forest = extract_parts(ndsm, ClassMap(index, labels, spec) if classes else None, survey="test", params=params)
    squares = [MultiPolygon([box(x, y, x + 1, y + 1)]) for x, y in forest.parts[["xo", "yo"]].to_numpy()]
    return gpd.GeoDataFrame(forest.parts, geometry=squares, crs=UTM), forest.root_labels, ndsm


def test_one_building_a_root_with_its_summary():
    """Storeys of the tallest part, parts and scales of the tree, heights and volume of the footprint."""
    parts, labels, ndsm = build()
    buildings = buildings_from_parts(parts, labels, ndsm)
    validate(buildings, BUILDING)
    podium = buildings.sort_values("parts").iloc[-1]
    assert len(buildings) == 2
    assert podium[["storeys", "parts", "scales"]].tolist() == [10, 2, 2]
    assert podium["area_m2"] == 100.0
    assert podium["volume_m3"] == pytest.approx((400 - 64) * 0.25 * 6.5 + 64 * 0.25 * 30.5)
    assert podium["h_max"] == 30.5
    assert podium["h_p50"] == 6.5
    assert podium["building_id"] == podium["root_id"] == parts.set_index("supid").loc[podium["root_id"], "root_id"]
    assert buildings.crs == UTM


def test_heights_of_a_building_are_those_of_its_root():
    """The footprint is the root, so both tables agree."""
    parts, labels, ndsm = build()
    buildings = buildings_from_parts(parts, labels, ndsm)
    roots = parts.set_index("part_id").loc[buildings["root_id"]]
    for name in ("h_max", "h_mean", "h_p50", "h_p90", "area_m2"):
        assert buildings[name].tolist() == roots[name].tolist()


@pytest.mark.parametrize(("share", "state"), [(1.0, "confirmed"), (0.5, "confirmed"), (0.4, "unsure")])
def test_classes_confirm_a_building(share, state):
    """Half of the root's cells must have a building class."""
    buildings = buildings_from_parts(*build(share))
    assert buildings.sort_values("parts")["state"].tolist() == [state, "confirmed"]


def test_without_classes_a_building_is_unsure():
    """Heights or classes alone are not enough."""
    assert set(buildings_from_parts(*build(classes=False))["state"]) == {"unsure"}


def test_no_parts_make_no_buildings():
    """An empty forest gives an empty table with the parts' CRS."""
    parts, labels, ndsm = build()
    buildings = buildings_from_parts(parts.iloc[:0], np.zeros_like(labels), ndsm)
    validate(buildings, BUILDING)
    assert len(buildings) == 0
    assert buildings.crs == UTM


def test_another_forest_is_refused():
    """Roots that are not the parts' are an error, not a silent zero."""
    parts, _, ndsm = build()
    _, other, _ = build(0.0)
    with pytest.raises(TableError, match="Take both from one build"):
        buildings_from_parts(parts, other, ndsm)
