"""The extraction of flat regions as a whole: on simulated scenes, on a real tile, and on bad input."""

import os
from dataclasses import replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace

import geopandas as gpd
import numpy as np
import pytest
from affine import Affine
from pyproj import CRS
from simulated.scenes import attached_to_slope, courtyard, plateau, podium_tower, under_trees, wall
from support.notices import with_notices

from msbdb.detect.flatregions import mongus2013
from msbdb.detect.flatregions.initialisation import initialise
from msbdb.detect.flatregions.mongus2013 import extract_flat_regions
from msbdb.detect.scene import Evidence
from msbdb.errors import GridMismatchError, NodataError, ParameterError
from msbdb.evaluate import PointReference, evaluate
from msbdb.grid import Grid, GridSpec
from msbdb.io.las import read_points
from msbdb.outline.polygons import polygonise
from msbdb.params import Params, profile, with_values
from msbdb.parts.tree import extract_parts
from msbdb.run.preparation.drafts import build_surface
from msbdb.surface.heights import normalise
from msbdb.tables import FLAT_REGION, REJECTION

UTM = CRS.from_epsg(32633)
RAW = with_values(profile("mongus2013"), {"flatregions": {"lambda_max_m2": 600.0}})
"""The paper's own values on the raw surface, with a λ_max for scenes of a hectare: its own is for square kilometres."""


def with_flat(**changes):
    """Return the default parameters with some of flat regions replaced."""
    base = Params()
    return replace(base, flatregions=replace(base.flatregions, **changes))


def grid(values, valid=None, shift=(0, 0), cell_m=0.5):
    """Return a grid of heights whose first cell is shifted by whole cells."""
    values = np.array(values)
    valid = np.ones(values.shape, dtype=bool) if valid is None else np.array(valid, dtype=bool)
    origin = (389_000 + shift[1] * cell_m, 5_821_000 - shift[0] * cell_m)
    spec = GridSpec(values.shape, Affine(cell_m, 0, origin[0], 0, -cell_m, origin[1]), UTM)
    return Grid(values, valid, spec)


def houses():
    """Return heights of a house with a hole, one without, a wall, and rough trees, at cells of 0.5 m."""
    rng = np.random.default_rng(5)
    heights = np.zeros((80, 120), dtype=np.float32)
    heights[10:40, 10:40], heights[22:24, 22:24] = 6.5, 0
    heights[50:70, 20:60] = 9.5
    heights[5:7, 50:115] = 3.0
    heights[20:60, 80:110] = 5 + 10 * rng.random((40, 30))
    return heights


def extract(g, params=None, *, survey="test", heights=None):
    """Extract flat regions of heights above ground."""
    return extract_flat_regions(g, heights=heights or g, survey=survey, params=params or Params())


@cache
def scanned(scene, *, density=4.0, **options):
    """Return a scanned scene, its lowest points as a grid, and its surfaces."""
    made = scene(density=density, **dict(options))
    surface = build_surface(made.points, Params())
    return made, initialise(made.points, surface.dsm.spec, max_gap_m=1.0), surface


def agreement(scene, params, **options):
    """Return completeness and correctness by cells against the true buildings, and the flat regions."""
    made, lowest, surface = scanned(scene, **options)
    g = normalise(lowest, surface.dtm) if params.flatregions.on == "ndsm" else lowest
    found = extract(g, params, heights=surface.ndsm)
    row, col = made.spec.rowcol(*surface.dsm.spec.xy(*np.indices(surface.dsm.spec.shape)))
    inside = (row >= 0) & (col >= 0) & (row < made.spec.shape[0]) & (col < made.spec.shape[1])
    truth = np.zeros(surface.dsm.spec.shape, dtype=bool)
    truth[inside] = made.buildings[row[inside], col[inside]] > 0
    flat = found.labels > 0
    both = np.count_nonzero(flat & truth)
    return both / truth.sum(), both / max(1, flat.sum()), found


# What it finds


def test_regions_have_their_attributes():
    """Two houses, by their first cells; areas, heights, zones and centres are those of the scene."""
    found = extract(grid(houses()))
    regions = found.regions
    assert len(regions) == 2
    assert {c.name: c.dtype for c in FLAT_REGION.columns} == {name: str(d) for name, d in regions.dtypes.items()}
    assert list(found.rejections.columns) == REJECTION.names
    assert regions["area_m2"].tolist() == [225.0, 200.0]
    assert regions["h_p50"].tolist() == [6.5, 9.5]
    assert regions["h_max"].tolist() == [6.5, 9.5]
    assert regions["h_std"][1] == 0.0
    assert regions[["xcen", "ycen"]].iloc[1].tolist() == [389_000 + 20.0, 5_821_000 - 30.0]
    assert regions["zone"].tolist() == [1, 1]
    assert regions["lambda_low_m2"].tolist() == [0.0, 0.0]
    assert regions["lambda_m2"].tolist() == [20.0, 20.0]
    assert regions["gradient_sum"].to_numpy() == pytest.approx(
        (regions["mean_gradient"] * regions["area_m2"]).to_numpy()
    )
    assert regions["compactness"].between(1.1, 1.5).all()
    assert np.bincount(found.labels.ravel())[1:].tolist() == [900, 800]


def test_nothing_vanishes_in_silence():
    """Trees and the wall are in the ledger; each stage keeps or drops what it took in, and ids are unique."""
    found = extract(grid(houses()))
    for numbers in found.counts.values():
        assert numbers["in"] == numbers["kept"] + numbers["dropped"]
    dropped = {stage: numbers["dropped"] for stage, numbers in found.counts.items() if numbers["dropped"]}
    assert found.rejections["stage"].value_counts().to_dict() == dropped
    assert (found.rejections["area_m2"] < 1).any(), "single cells have rows of their own"
    assert {"denoising", "ratio"} <= set(dropped)
    large = found.rejections["area_m2"] >= Params().fuse.piece_m2
    ids = [*found.regions["region_id"], *found.rejections["region_id"][large]]
    assert len(set(ids)) == len(ids)
    assert min(ids) > 0
    assert large.any()
    assert not found.rejections["region_id"][~large].any()


@pytest.mark.parametrize(
    ("changes", "stage"),
    [
        ({"opening_m": 8.0, "s_max_m": 0.0}, "opening"),
        ({"max_compactness": 2.0, "s_max_m": 0.0}, "compactness"),
    ],
)
def test_recognition_rejects_a_wall(changes, stage):
    """A flat wall of 6 m by 60 m falls to an opening of 8 m, or to a strict compactness, and is recorded there."""
    heights = np.zeros((60, 160), dtype=np.float32)
    heights[5:17, 10:130] = 4.0
    heights[25:55, 20:60] = 7.0
    found = extract(grid(heights), with_flat(**changes))
    assert len(found.regions) == 1
    assert found.regions["h_max"][0] == 7.0
    lost = found.rejections[found.rejections["stage"] == stage]
    assert lost["area_m2"].tolist() == [360.0]
    assert found.counts[stage]["dropped"] == 1


@pytest.mark.parametrize(("compact_m2", "kept"), [(10_000.0, True), (0.0, False)])
def test_blocks_that_touch_are_no_long_region(compact_m2, kept):
    """Rows 8 m wide that a cross row joins, 4.6 ha, have a Ψ of 200; a wall of 3 m by 1200 m has 115, and goes."""
    heights = np.zeros((1230, 430), dtype=np.float32)
    for row in range(14):
        heights[10 + 16 * row : 18 + 16 * row, 10:410] = 8.0
    heights[10:226, 10:18] = 8.0
    heights[10:1210, 420:423] = 4.0
    found = extract(grid(heights, cell_m=1.0), with_flat(compact_m2=compact_m2))
    assert sorted(found.regions["h_max"]) == ([8.0] if kept else [])


@pytest.mark.parametrize(("grow_m", "gained"), [(0.9, True), (0.0, False)])
def test_on_large_cells_a_roof_gets_an_edge_of_one_cell_back(grow_m, gained):
    """The outermost cells of a roof hold ground points, also where a cell is wider than the edge that returns."""
    first, low = np.zeros((2, 20, 20), dtype=np.float32)
    first[5:15, 5:15], low[6:14, 6:14] = 7.0, 7.0
    found = extract(grid(low, cell_m=2.0), with_flat(grow_m=grow_m), heights=grid(first, cell_m=2.0))
    np.testing.assert_array_equal(found.labels > 0, (first if gained else low) > 0)


def test_the_compactness_as_printed_rejects_nothing():
    """4πA/P² is 1 at most, so that a wall stays that P²/(4πA) rejects (A9, M20)."""
    heights = np.zeros((60, 160), dtype=np.float32)
    heights[5:17, 10:130] = 4.0
    heights[25:55, 20:60] = 7.0
    found = extract(grid(heights), with_flat(max_compactness=2.0, s_max_m=0.0, compactness="literal"))
    assert sorted(found.regions["h_max"]) == [4.0, 7.0]
    assert found.regions["compactness"].max() > 2


def test_ids_come_from_the_place_and_are_not_those_of_parts():
    """The same houses in a larger tile have the same ids; other surveys, and parts there, have others."""
    small = extract(grid(houses())).regions
    wide = np.pad(houses(), ((7, 3), (11, 5)))
    assert extract(grid(wide, shift=(-7, -11))).regions["region_id"].tolist() == small["region_id"].tolist()
    assert not set(extract(grid(houses()), survey="other").regions["region_id"]) & set(small["region_id"])
    parts = extract_parts(grid(houses()), None, survey="test", params=Params()).parts
    assert not set(parts["part_id"]) & set(small["region_id"])


def test_the_order_of_the_points_does_not_count():
    """Shuffled points give the same surface and the same regions."""
    made, lowest, surface = scanned(courtyard)
    order = np.random.default_rng(0).permutation(len(made.points))
    again = initialise(made.points.take(order), surface.dsm.spec, max_gap_m=1.0)
    assert (again.values == lowest.values).all()


def test_regions_do_not_depend_on_the_direction():
    """Turned by a right angle, the same cells are flat."""
    heights = houses()
    turned = extract(grid(np.rot90(heights).copy())).labels > 0
    assert (turned == np.rot90(extract(grid(heights)).labels > 0)).all()


# Simulated scenes


@pytest.mark.parametrize("scene", [podium_tower, courtyard, wall])
@pytest.mark.parametrize("density", [4.0, 11.0])
def test_buildings_are_found_whole(scene, density):
    """A podium with a tower, a perimeter block with its yard, and a house beside a wall, to a cell of the edge.

    A cell in which a roof ends is roof, if one of its echoes is. So a house of 180 m2 on cells of 0.3 m grows by 2 %.
    """
    completeness, correctness, found = agreement(scene, Params(), density=density)
    assert completeness > 0.98
    assert correctness > 0.975
    assert len(found.regions) == 1


@pytest.mark.parametrize(("trust", "ratio"), [(1.0, 1.75), (0.5, 1.875), (0.0, 2.0), (None, 2.0)])
def test_the_less_echoes_are_trusted_the_stricter_is_the_ratio(monkeypatch, trust, ratio):
    """Points with later echoes, with few, without, and a raster: where echoes separate crowns, roofs may be rougher."""
    seen = []

    def stop(*_given, params, **_named):
        seen.append(params.flatregions.ratio)
        raise NodataError

    monkeypatch.setattr(mongus2013, "lowest_surface", lambda scene, _params: scene.heights)
    monkeypatch.setattr(mongus2013, "extract_flat_regions", stop)
    cloud = None if trust is None else SimpleNamespace(most_trust=trust)
    scene = SimpleNamespace(heights=grid(houses()), cloud=cloud, survey=SimpleNamespace(name="test"), evidence=None)
    with pytest.raises(NodataError):
        mongus2013.detect_flat_regions(scene, Params())
    assert seen == [ratio]


def test_leaves_belong_to_no_region():
    """A dense crown, as flat as the house that it touches, goes to the ledger; the roof does not grow into it."""
    heights = np.zeros((60, 80), dtype=np.float32)
    heights[10:40, 10:70] = 6.0
    leafy = np.zeros(heights.shape, dtype=bool)
    leafy[10:40, 44:70] = True
    whole = extract(grid(heights))
    found = extract_flat_regions(grid(heights), heights=grid(heights), survey="test", params=Params(), leafy=leafy)
    assert np.array_equal(whole.labels > 0, heights > 0)
    assert np.array_equal(found.labels > 0, (heights > 0) & ~leafy)
    lost = found.rejections[found.rejections["stage"] == "leaves"]
    assert lost["area_m2"].tolist() == [30 * 26 * 0.25]
    assert found.counts["leaves"] == {"in": 2, "pieces": 1, "kept": 1, "dropped": 1}


@pytest.mark.parametrize(("least", "lost"), [(0.2, True), (0.0, False)])
def test_leaves_are_known_by_echoes_and_texture(least, lost):
    """A rough crown with a probability of roof of a tenth has leaves. Glass has none, nor what is below the mask."""
    heights = np.zeros((40, 60), dtype=np.float32)
    heights[10:30, 5:25], heights[10:30, 35:55] = 6, 6
    probability = np.full(heights.shape, 230, dtype=np.uint8)
    probability[:, 30:] = 25
    glass = np.zeros(heights.shape, dtype=bool)
    glass[20:, 30:] = True
    evidence = Evidence(np.where(glass | (probability > 100), 20, 600).astype(np.uint16), probability)
    found = mongus2013.find_leaves(
        SimpleNamespace(heights=grid(heights), evidence=evidence), with_flat(leaf_probability=least)
    )
    if lost:
        assert found[11:18, 35:55].all()
        assert not found[(heights == 0) | (probability > 100)].any()
        assert not found[23:].any()
    else:
        assert found is None


def test_trees_are_rejected():
    """Of a grove nothing stays; of the crowns over a house at most what overspreads beside it (M27)."""
    completeness, correctness, found = agreement(under_trees, Params(), density=11.0)
    assert completeness > 0.97
    assert correctness > 0.85
    assert len(found.regions) == 1
    assert (found.rejections["stage"] == "ratio").sum() >= 3


def test_prior_ground_cures_the_plateau():
    """An earthwork with banks of 8 m is flat on the raw surface; above prior ground only its houses are (M27)."""
    raw = agreement(plateau, RAW, bank_m=8.0)
    cured = agreement(plateau, Params(), bank_m=8.0)
    assert raw[0] > 0.95
    assert raw[1] < 0.2
    assert cured[0] > 0.97
    assert cured[1] > 0.97


def test_prior_ground_parts_a_building_from_its_slope():
    """On the raw surface the attached house is lost in the bank; above ground what stands 2 m high is found (M27)."""
    raw = agreement(attached_to_slope, RAW)
    cured = agreement(attached_to_slope, Params())
    assert raw[1] < 0.1
    assert cured[0] > 0.65
    assert cured[1] > 0.97


@pytest.mark.data
@pytest.mark.skipif("MSBDB_DATA" not in os.environ, reason="needs the real tiles")
def test_a_real_tile_is_covered_to_85_per_cent():
    """Delft, classes wiped: flat regions alone against class 6, by area."""
    cloud, _ = with_notices(read_points, [Path(os.environ["MSBDB_DATA"]) / "delft" / "delft_2.laz"], crs="EPSG:28992")
    wiped = replace(cloud, classification=np.ones(len(cloud), dtype=np.uint8))
    surface = build_surface(wiped, Params())
    g = normalise(initialise(wiped, surface.dsm.spec, max_gap_m=1.0), surface.dtm)
    found = extract(g, heights=surface.ndsm)
    outlines = polygonise(found.labels, surface.dsm.spec, len(found.regions))
    regions = gpd.GeoDataFrame(found.regions, geometry=list(outlines), crs=surface.dsm.spec.crs)
    truth = PointReference(cloud.x, cloud.y, cloud.classification == 6, cloud.crs, cloud.first_echo)
    assert evaluate(regions, truth, valid=surface.ndsm).area.rates.quality > 0.85


# Bad input


@pytest.mark.parametrize("value", [0.0, 7.0, -3.0])
@pytest.mark.parametrize("shape", [(1, 1), (1, 30), (40, 40)])
@pytest.mark.parametrize("on", ["ndsm", "surface"])
def test_grids_of_one_value(value, shape, on):
    """A level raw surface has no region; heights above ground have one where they are a roof of enough area."""
    found = extract(grid(np.full(shape, value, dtype=np.float32)), with_flat(on=on))
    assert len(found.regions) == int(on == "ndsm" and value == 7.0 and shape == (40, 40))
    assert found.labels.shape == shape


def test_a_surface_without_valid_cells_is_refused():
    """All invalid: nothing can be sought."""
    nothing = grid(np.zeros((5, 5), dtype=np.float32), np.zeros((5, 5), dtype=bool))
    with pytest.raises(NodataError, match="no valid cell"):
        extract(nothing)


def test_an_invalid_half_holds_no_region_and_changes_none_of_the_other():
    """Where half of the tile is unknown, what lies in the other half is found as ever, whatever is under the mask."""
    heights = houses()
    valid = np.ones(heights.shape, dtype=bool)
    valid[:, 65:] = False
    hidden = np.where(valid, heights, 99).astype(np.float32)
    for values in (np.where(valid, heights, 0).astype(np.float32), hidden):
        found = extract(grid(values, valid))
        assert not found.labels[~valid].any()
        assert found.regions["area_m2"].tolist() == [225.0, 200.0]


def test_integers_of_16_bits_are_heights_like_others():
    """Whole metres in int16 give what the same heights in float32 give."""
    whole = np.round(houses())
    short = extract(grid(whole.astype(np.int16)))
    assert len(short.regions) == 2
    assert (short.labels == extract(grid(whole.astype(np.float32))).labels).all()


@pytest.mark.parametrize("changes", [{"lambda_max_m2": 10.0}, {"lambda_step_m2": 0.0}])
def test_zones_that_make_no_sense_are_refused(changes):
    """λ_max below λ_min, and λ_Δ of 0, with what was given and what is needed."""
    with pytest.raises(ParameterError, match="λ_min ≤ λ_max and a step λ_Δ above 0"):
        extract(grid(houses()), with_flat(**changes))


def test_another_lattice_is_refused():
    """Heights must lie on the surface's lattice."""
    with pytest.raises(GridMismatchError, match="one lattice"):
        extract(grid(houses()), heights=grid(houses(), shift=(1, 0)))


def test_the_papers_profile_finds_houses_on_rough_ground_of_a_town():
    """As shipped: 36 ha of meadow and shrubs have more gradient than λ_max, and each house is a region (M15).

    It spreads by a cell beyond the wall, as the paper reports (M27).
    """
    rng = np.random.default_rng(3)
    surface = (20 + rng.uniform(0, 1, (600, 600))).astype(np.float32)
    truth = np.zeros(surface.shape, dtype=np.int32)
    for number, (row, col) in enumerate([(60, 60), (60, 300), (300, 100), (320, 420), (500, 250)], start=1):
        house = (slice(row, row + 18), slice(col, col + 14 + 6 * number))
        truth[house] = number
        surface[house] = 30 + rng.normal(0, 0.02, surface[house].shape)
    found = extract(grid(surface, cell_m=1.0), profile("mongus2013"), heights=grid(surface - 20, cell_m=1.0))
    for number in range(1, 6):
        inside = truth == number
        label = np.bincount(found.labels[inside]).argmax()
        assert label > 0
        region = found.labels == label
        assert np.count_nonzero(region & inside) / np.count_nonzero(region | inside) > 0.8


@pytest.mark.parametrize(
    ("name", "least", "step", "psi"),
    [("mongus2013", 30, 250, 9), ("mongus2013-ds2", 20, 500, 11), ("mongus2013-ds3", 20, 300, 10.5)],
)
def test_the_profiles_are_table_1(name, least, step, psi):
    """λ_min, λ_Δ and ψ of the three data sets; what they share, from the text (M11, M14, M23)."""
    own = profile(name).flatregions
    assert (own.lambda_min_m2, own.lambda_step_m2, own.max_compactness) == (least, step, psi)
    assert (own.lambda_max_m2, own.ratio, own.s_max_m, own.opening_m) == (40_000, 1.5, 3.0, 3.0)
    assert (own.on, own.valley_factor, own.peak_factor, own.gradients) == ("surface", 2.0, 4.0, "denoised")
    assert (own.gradient_window_m, own.gradient_cap_m, own.largest_m2, own.grow_m) == (0, 0, 0, 0)
