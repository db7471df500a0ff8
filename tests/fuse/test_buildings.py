"""Buildings from parts."""

from dataclasses import replace

import geopandas as gpd
import numpy as np
import pytest
from affine import Affine
from pyproj import CRS
from shapely import MultiPolygon, box

from msbdb.errors import TableError
from msbdb.fuse.buildings import buildings_from_parts, label_buildings
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


def made(parts, roots, ndsm):
    """Return the buildings of parts."""
    return buildings_from_parts(parts, label_buildings(parts, roots), ndsm)


def test_a_building_has_the_summary_of_its_trees():
    """Storeys of the podium and of the tower, parts and scales of the tree, heights and volume of the footprint."""
    parts, labels, ndsm = build()
    buildings = made(parts, labels, ndsm)
    validate(buildings.assign(geometry=None), BUILDING)
    podium = buildings.sort_values("parts").iloc[-1]
    assert len(buildings) == 2
    assert podium[["storeys", "storeys_top", "parts", "scales"]].tolist() == [2, 10, 2, 2]
    assert podium["area_m2"] == 100.0
    assert podium["volume_m3"] == pytest.approx((400 - 64) * 0.25 * 6.5 + 64 * 0.25 * 30.5)
    assert podium["h_max"] == 30.5
    assert podium["h_p50"] == 6.5
    assert podium["building_id"] == parts.set_index("supid").loc[podium["building_id"], "root_id"]
    assert buildings["trees"].tolist() == [1, 1]


def test_a_building_of_one_root_has_what_its_root_has():
    """The footprint is the root, so both tables agree."""
    parts, labels, ndsm = build()
    buildings = made(parts, labels, ndsm)
    roots = parts.set_index("part_id").loc[buildings["building_id"]]
    for name in ("h_max", "h_mean", "h_p50", "h_p90", "area_m2", "xcen", "ycen", "xin", "yin", "building_share"):
        assert buildings[name].tolist() == pytest.approx(roots[name].tolist(), rel=1e-12)


def test_roots_that_touch_are_one_building():
    """Four wings of different height, of which two meet at a corner: one island, and a tree for each wing."""
    heights = np.zeros((30, 60), dtype=np.float32)
    heights[2:12, 2:12], heights[2:12, 12:32], heights[12:28, 32:50] = 6.5, 24.5, 12.5
    heights[20:28, 2:12] = 9.5
    spec = GridSpec((30, 60), Affine(0.5, 0, 389_000, 0, -0.5, 5_821_000), UTM)
    ndsm = Grid(heights, np.ones(heights.shape, dtype=bool), spec)
    classes = ClassMap(np.where(heights > 0, 2, 0).astype(np.uint8), {2: "building"}, spec)
    params = replace(Params(), scale=replace(Params().scale, scales_m2=(5.0,)))
    forest = extract_parts(ndsm, classes, survey="test", params=params)
    buildings = made(forest.parts, forest.root_labels, ndsm).sort_values("area_m2")
    assert buildings["trees"].tolist() == [1, 3]
    assert buildings["area_m2"].tolist() == [20.0, (100 + 200 + 288) / 4]
    largest = forest.parts.sort_values("area_m2").iloc[-1]
    assert buildings["building_id"].iloc[-1] == largest["part_id"]
    assert buildings["h_max"].tolist() == [9.5, 24.5]
    assert buildings["storeys_top"].iloc[-1] == forest.parts["hindex"].max()
    inside = heights[12:28, 32:50].size, heights[2:12, 2:32].size
    assert buildings["xcen"].iloc[-1] == pytest.approx(389_000 + (inside[0] * 20.5 + inside[1] * 8.5) / sum(inside))


@pytest.mark.parametrize(("share", "state"), [(1.0, "confirmed"), (0.5, "confirmed"), (0.4, "unsure")])
def test_classes_confirm_a_building(share, state):
    """Half of the root's cells must have a building class."""
    buildings = made(*build(share))
    assert buildings.sort_values("parts")["state"].tolist() == [state, "confirmed"]


def test_without_classes_a_building_is_unsure():
    """Heights or classes alone are not enough."""
    assert set(made(*build(classes=False))["state"]) == {"unsure"}


def test_no_parts_make_no_buildings():
    """An empty forest gives an empty table."""
    parts, labels, ndsm = build()
    buildings = made(parts.iloc[:0], np.zeros_like(labels), ndsm)
    validate(buildings.assign(geometry=None), BUILDING)
    assert len(buildings) == 0


def test_another_forest_is_refused():
    """Roots that are not the parts' are an error, not a silent zero."""
    parts, _, ndsm = build()
    _, other, _ = build(0.0)
    with pytest.raises(TableError, match="Take both from one build"):
        label_buildings(parts, other)
    with pytest.raises(TableError, match="has no building_id"):
        buildings_from_parts(parts.iloc[:1], label_buildings(*build()[:2]), ndsm)
