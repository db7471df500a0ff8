"""The tree of parts as a whole: invariants of the forest, ids, ledger, and what moves with the scene."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pandas as pd
import pytest
from affine import Affine
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from pyproj import CRS
from support.sizes import examples

from msbdb.errors import GridMismatchError
from msbdb.grid import Grid, GridSpec
from msbdb.labels import label_zones
from msbdb.landcover import ClassMap
from msbdb.params import Params, profile
from msbdb.parts.forest import Forest
from msbdb.parts.tree import extract_parts
from msbdb.tables import PART, REJECTION, SCALE, validate_parts

UTM = CRS.from_epsg(32633)
WEST, NORTH = 389_000.0, 5_821_000.0


def heights_of(storeys, *, cell_m=1.0, row=0, col=0):
    """Return an nDSM in the middle of the storeys of an image, placed some cells from a corner of the world."""
    storeys = np.asarray(storeys)
    values = np.where(storeys > 0, 2.0 + 3.0 * storeys - 1.5, 0.0).astype(np.float32)
    transform = Affine(cell_m, 0, WEST + col * cell_m, 0, -cell_m, NORTH - row * cell_m)
    return Grid(values, np.ones(storeys.shape, dtype=bool), GridSpec(storeys.shape, transform, UTM))


def params_of(*scales_m2, decides="spectral", **scale):
    """Return default parameters with some scales; vegetation comes from colours, as in the paper, unless stated."""
    base = Params()
    return replace(
        base,
        scale=replace(base.scale, scales_m2=scales_m2, **scale),
        spectral=replace(base.spectral, decides=decides),
    )


def extract(storeys, *scales_m2, index=None, row=0, col=0, survey="test", **options) -> Forest:
    """Extract parts from storeys; class 1 of an index is vegetation, the others are building."""
    ndsm = heights_of(storeys, row=row, col=col)
    classes = None
    if index is not None:
        index = np.asarray(index, dtype=np.uint8)
        labels = {n: "vegetation" if n == 1 else "building" for n in range(1, max(int(index.max()), 1) + 1)}
        classes = ClassMap(index, labels, ndsm.spec)
    return extract_parts(ndsm, classes, survey=survey, params=params_of(*scales_m2, **options))


def podium():
    """Return a podium of 400 cells with two towers of 100 and 25 on it (Fig. 4)."""
    image = np.zeros((24, 24), dtype=int)
    image[2:22, 2:22] = 3
    image[4:14, 4:14] = 4
    image[16:21, 16:21] = 5
    return image


def nested(forest):
    """Return whether every cell of every part belongs to its father as well."""
    row_of = {part: row for row, part in enumerate(forest.parts["part_id"])}
    level_of = len(forest.labels) - forest.parts["scale"].to_numpy()
    for row, (father, level) in enumerate(zip(forest.parts["supid"], level_of, strict=True)):
        if father:
            over = forest.labels[level_of[row_of[father]]][forest.labels[level] == row + 1]
            if (over != row_of[father] + 1).any():
                return False
    return True


def shape_of(forest):
    """Return the trees without places: nested tuples of area, zone and children, in order."""
    parts = forest.parts

    def tree(part):
        children = parts[parts["supid"] == part["part_id"]]
        return (part["area_px"], part["hzone"], part["scale"], tuple(sorted(tree(c) for _, c in children.iterrows())))

    return sorted(tree(root) for _, root in parts[parts["supid"] == 0].iterrows())


def test_figure_4():
    """A on the coarsest scale is the root of B and C on finer ones: rows (ID, SUPID, SUPSCALE, H)."""
    forest = extract(podium(), 10, 50, 200)
    part = forest.parts.set_index("scale")
    root = part.loc[1]
    assert part["hindex"].tolist() == [5, 4, 4]
    assert part["hzone"].tolist() == [5, 4, 3]
    assert part["supid"].tolist() == [root["part_id"], root["part_id"], 0]
    assert part["supscale"].tolist() == [1, 1, 0]
    assert part["area_px"].tolist() == [25, 100, 400]
    assert (part["root_id"] == root["part_id"]).all()


def test_attributes_in_world_coordinates():
    """XO and YO are the first cell's centre, XCEN and YCEN the centroid."""
    forest = extract(podium(), 10, 50, 200)
    root = forest.parts.iloc[-1]
    assert (root["xo"], root["yo"]) == (WEST + 2.5, NORTH - 2.5)
    assert (root["xcen"], root["ycen"]) == (WEST + 12.0, NORTH - 12.0)
    assert root["area_m2"] == 400.0
    assert root["h_max"] == 15.5
    assert root["stddis"] == pytest.approx(np.std([np.hypot(3, 3), np.hypot(6.5, 6.5)]))
    assert np.isnan(forest.parts.iloc[0]["stddis"])


def test_heights_come_from_the_surface_and_not_from_the_zone():
    """A tower that is a duplicate of its podium by area gives the podium its storeys (V30, A4)."""
    image = np.zeros((14, 14), dtype=int)
    image[2:12, 2:12] = 1
    image[2:12, 2:11] = 9
    root = extract(image, 5, 95).parts
    assert root[["hzone", "hindex", "area_px"]].to_numpy().tolist() == [[1, 9, 100]]


def test_storeys_come_from_the_zone_as_written():
    """In the paper's profile the podium keeps the storeys of its flat zone, and loses those of the tower (V30)."""
    image = np.zeros((14, 14), dtype=int)
    image[2:12, 2:12] = 1
    image[2:12, 2:11] = 9
    base = profile("vu2009")
    params = replace(base, scale=replace(base.scale, scales_m2=(5.0, 95.0)))
    root = extract_parts(heights_of(image), None, survey="test", params=params).parts
    assert root[["hzone", "hindex", "h_p90"]].to_numpy().tolist() == [[1, 1, 27.5]]


def test_tables_are_as_declared():
    """All columns, in order, of the declared dtypes."""
    forest = extract(podium(), 10, 50, 200, index=np.where(podium() > 0, 2, 0))
    validate_parts(forest.parts.assign(geometry=None))
    assert list(forest.parts.columns) == PART.names
    assert list(forest.rejections.columns) == REJECTION.names
    assert list(forest.scales.columns) == SCALE.names
    assert forest.scales["threshold_px"].tolist() == [200, 50, 10]
    assert forest.parts["speindex"].tolist() == [2, 2, 2]
    assert forest.parts["building_share"].tolist() == [1, 1, 1]


@pytest.mark.parametrize("index", [None, np.zeros((24, 24))])
def test_a_field_without_buildings_is_an_empty_forest(index):
    """No part, no error."""
    forest = extract(np.zeros((24, 24), dtype=int), 10, 50, index=index)
    assert len(forest.parts) == 0
    assert len(forest.rejections) == 0
    assert forest.root_labels.max() == 0
    validate_parts(forest.parts.assign(geometry=None))


def test_classes_on_another_lattice_are_refused():
    """The message names both lattices."""
    ndsm = heights_of(podium())
    other = heights_of(podium(), row=1).spec
    classes = ClassMap(np.zeros((24, 24), dtype=np.uint8), {}, other)
    with pytest.raises(GridMismatchError, match="lattice"):
        extract_parts(ndsm, classes, survey="test", params=Params())


def test_without_scales_granulometry_finds_them():
    """An empty list of scales is filled from the image (V8)."""
    forest = extract(podium())
    assert len(forest.scales) >= 1
    assert len(forest.parts) >= 1


def test_an_island_too_small_goes_to_the_ledger():
    """What the finest opening takes away is a row with its area, on no scale."""
    image = podium()
    image[0, 0] = 2
    forest = extract(image, 10, 50, 200)
    assert forest.rejections[["stage", "scale", "area_m2"]].to_numpy().tolist() == [["opening", 0, 1.0]]
    assert forest.counts["opening"] == {"in": 2, "pieces": 0, "kept": 1, "dropped": 1}


def ring():
    """Return a building of 400 - 100 cells around a courtyard."""
    image = np.zeros((26, 26), dtype=int)
    image[3:23, 3:23] = 2
    image[8:18, 8:18] = 0
    return image


def test_a_courtyard_is_kept():
    """The closing at 200 would fill the yard of 100 cells."""
    forest = extract(ring(), 20, 200, keep_courtyards=True)
    assert forest.parts["area_px"].tolist() == [300]
    assert ((forest.root_labels > 0) == (ring() > 0)).all()


def test_a_courtyard_is_filled_as_the_paper_has_it():
    """Without the cut the coarse part covers its yard."""
    forest = extract(ring(), 20, 200, keep_courtyards=False)
    assert forest.parts["area_px"].tolist() == [400]


def test_vegetation_and_classes_together():
    """A tree beside the house is cut off, a tree apart vanishes, and both are in the ledger."""
    image, index = np.zeros((40, 40), dtype=int), np.zeros((40, 40), dtype=int)
    image[5:20, 5:20], index[5:20, 5:20] = 2, 2
    image[8:16, 18:26], index[8:16, 18:26] = 2, 1
    image[28:36, 28:36], index[28:36, 28:36] = 4, 1
    forest = extract(image, 20, 60, index=index)
    assert forest.parts["area_px"].tolist() == [15 * 15 - 8 * 2]
    assert forest.rejections["reason"].tolist() == ["vegetation"]
    assert forest.parts["building_share"].tolist() == [1.0]


def test_vegetation_told_by_structure_is_masked_with_the_ground():
    """It takes no part in the scale-space, and its blobs are in the ledger."""
    image, index = np.zeros((40, 40), dtype=int), np.zeros((40, 40), dtype=int)
    image[5:20, 5:20], index[5:20, 5:20] = 2, 2
    image[8:16, 20:28], index[8:16, 20:28] = 4, 1
    forest = extract(image, 20, 60, index=index, decides="structure")
    assert forest.parts["area_px"].tolist() == [225]
    assert forest.counts["vegetation mask"] == {"in": 1, "pieces": 0, "kept": 0, "dropped": 1}
    assert forest.rejections["area_m2"].tolist() == [64.0]


def test_edges_below_the_mask_are_raised_inside_the_built_cells():
    """They belong to the highest storey beside them; the same cells outside of it stay ground."""
    image = np.zeros((30, 30), dtype=int)
    image[5:20, 5:20] = 2
    built = image > 0
    built[5:20, 20] = True
    params = params_of(20.0)
    parts = extract_parts(heights_of(image), None, survey="test", params=params, houses=built.astype(np.int32)).parts
    assert parts["area_px"].tolist() == [15 * 16]
    assert parts["hzone"].tolist() == [2]
    bare = extract_parts(
        heights_of(image), None, survey="test", params=params, houses=(image > 0).astype(np.int32)
    ).parts
    assert bare["area_px"].tolist() == [15 * 15]


def crowned_house():
    """Return a house of two storeys with a part of four on it, and a crown that reaches from outside over both."""
    image, crowns = np.zeros((40, 40), dtype=int), np.zeros((40, 40), dtype=bool)
    image[5:30, 5:30] = 2
    image[8:20, 8:28] = 4
    crowns[10:17, 22:34] = True
    image[10:17, 30:34] = 4
    return image, crowns


@pytest.mark.parametrize(("supported", "root"), [(True, 625), (False, 625 - 7 * 8)])
def test_a_crown_over_a_roof_is_cut_from_the_parts(supported, root):
    """By colour and roughness it is no roof: the part loses it; so does the root, unless it is supported (V37)."""
    image, crowns = crowned_house()
    built = (image > 0) & (np.arange(40) < 30)
    ndsm = heights_of(image)
    classes = ClassMap(np.where(built, 2, image > 0).astype(np.uint8), {1: "vegetation", 2: "building"}, ndsm.spec)
    params = params_of(20.0, 300.0, decides="structure")
    options = {"survey": "test", "params": params, "houses": built.astype(np.int32) if supported else None}
    parts = extract_parts(ndsm, classes, crowns=crowns, **options).parts
    assert parts["area_px"].tolist() == [12 * 20 - 7 * 6, root]
    assert extract_parts(ndsm, classes, **options).parts["area_px"].tolist() == [12 * 20, 625]


def test_a_part_of_leaves_goes_and_its_roof_stays():
    """Planting on most of a part meets none of its edges, so that V37 leaves it; by its classes it is no part (V41)."""
    image = np.zeros((50, 50), dtype=int)
    image[2:48, 2:48] = 2
    image[5:41, 5:41] = 4
    ndsm, crowns = heights_of(image), np.zeros((50, 50), dtype=bool)
    crowns[7:39, 7:39] = True
    classes = ClassMap(np.where(image > 0, 2, 0).astype(np.uint8), {1: "vegetation", 2: "building"}, ndsm.spec)
    params, houses = params_of(20.0, 1500.0, decides="structure"), (image > 0).astype(np.int32)
    options = {"survey": "test", "params": params, "houses": houses}
    with_crowns = extract_parts(ndsm, classes, crowns=crowns, **options)
    assert with_crowns.parts["area_px"].tolist() == [46 * 46]
    assert with_crowns.rejections["reason"].tolist() == ["too few cells of building classes"]
    assert extract_parts(ndsm, classes, **options).parts["area_px"].tolist() == [36 * 36, 46 * 46]


def test_colours_alone_give_spe():
    """A roof of one colour has its class, whatever the cover calls it; without colours SPE is 0 (V42)."""
    image = np.zeros((20, 20), dtype=int)
    image[5:15, 5:15] = 2
    ndsm = heights_of(image)
    classes = ClassMap(np.where(image > 0, 16, 0).astype(np.uint8), {16: "building"}, ndsm.spec)
    colours = ClassMap(np.full((20, 20), 3, dtype=np.uint8), {3: "building"}, ndsm.spec)
    none = ClassMap(np.zeros((20, 20), dtype=np.uint8), {}, ndsm.spec)
    for by_colour, spe in ((colours, 3), (none, 0)):
        parts = extract_parts(ndsm, classes, survey="test", params=params_of(20.0), colours=by_colour).parts
        assert parts["speindex"].tolist() == [spe]
        assert parts["building_share"].tolist() == [1.0]


def test_what_joins_a_row_of_houses_is_a_fake_father():
    """Five houses with low strips between are one root on the coarse scale; it is fake, and they stay (V46)."""
    image = np.zeros((14, 62), dtype=int)
    image[2:12, 2:60] = 1
    for house in range(5):
        image[2:12, 2 + 12 * house : 12 + 12 * house] = 3
    joined = extract(image, 20, 450, fake_father_min_children=1000)
    assert joined.parts["area_px"].tolist() == [100] * 5 + [580]
    forest = extract(image, 20, 450)
    assert forest.parts[["area_px", "supid"]].to_numpy().tolist() == [[100, 0]] * 5
    assert forest.rejections["reason"].tolist() == ["fake father", *["gap between the children of a fake father"] * 4]


IMAGES = hnp.arrays(
    np.int64, hnp.array_shapes(min_dims=2, max_dims=2, min_side=1, max_side=14), elements=st.integers(0, 4)
)


@st.composite
def scenes(draw):
    """Draw storeys as overlapping boxes (so that there are large zones), with noise, and classes."""
    image = draw(IMAGES)
    grown = np.kron(image, np.ones((2, 2), dtype=np.int64))
    index = draw(hnp.arrays(np.int64, image.shape, elements=st.integers(0, 3)))
    return grown, np.where(grown > 0, np.kron(index, np.ones((2, 2), dtype=np.int64)), 0)


def options():
    """Draw the switches of the detector."""
    return st.fixed_dictionaries(
        {
            "classes": st.booleans(),
            "keep_courtyards": st.booleans(),
            "merge_slivers": st.booleans(),
            "connectivity": st.sampled_from([4, 8]),
            "decides": st.sampled_from(["spectral", "structure"]),
        }
    )


@examples(60)
@given(scenes(), options())
def test_the_forest_holds_its_invariants(scene, chosen):
    """V33 on any scene: acyclic, coarser and larger fathers, children inside, roots disjoint, ledger balanced."""
    image, index = scene
    forest = extract(image, 4, 12, 40, index=index if chosen.pop("classes") else None, fake_father_ratio=0.2, **chosen)
    validate_parts(forest.parts.assign(geometry=None))
    assert nested(forest)
    for level, labels in enumerate(forest.labels):
        rows = np.flatnonzero(forest.parts["scale"] == len(forest.labels) - level)
        found, areas = np.unique(labels[labels > 0], return_counts=True)
        assert found.tolist() == (rows + 1).tolist()
        assert areas.tolist() == forest.parts["area_px"].to_numpy()[rows].tolist()
    roots = forest.parts[forest.parts["supid"] == 0]
    assert np.count_nonzero(forest.root_labels) == roots["area_px"].sum()
    assert all(c["in"] == c["kept"] + c["dropped"] for c in forest.counts.values())
    stages = [count for stage, count in forest.counts.items() if stage not in ("opening", "vegetation mask")]
    assert all(b["in"] - b["pieces"] == a["kept"] for a, b in pairwise(stages))
    assert stages[-1]["kept"] == len(forest.parts)
    large = forest.rejections["area_m2"] >= Params().fuse.piece_m2
    assert forest.rejections["region_id"][large].is_unique
    assert ((forest.rejections["region_id"] > 0) == large).all()
    if chosen["merge_slivers"]:
        least = forest.scales.set_index("scale")["threshold_px"]
        assert (forest.parts["area_px"] >= forest.parts["scale"].map(least)).all()
    if chosen["keep_courtyards"]:
        yards, _ = label_zones(image == 0, connectivity=chosen["connectivity"])
        large = np.bincount(yards.ravel())[yards] >= 4
        assert not forest.root_labels[(yards > 0) & large].any()


@examples(30)
@given(scenes())
def test_every_cell_above_ground_is_a_part_or_in_the_ledger(scene):
    """Without classes the parts and the regions lost together cover all that is above the mask."""
    image, _ = scene
    forest = extract(image, 4, 12, fake_father_coverage=1.0)
    lost = forest.rejections["area_m2"].sum()
    covered = np.count_nonzero((forest.root_labels > 0) & (image > 0))
    assert covered + lost >= np.count_nonzero(image)


@examples(30)
@given(scenes(), st.integers(-5, 50), st.integers(-5, 50))
def test_a_shift_moves_places_and_nothing_else(scene, row, col):
    """By whole cells XO and YO move and every part gets another id; attributes, fathers and their order stay.

    Ids come from the place: where a part moves onto the old place of an equal one, it gets the id that this one had.
    """
    image, index = scene
    here = extract(image, 4, 12, 40, index=index).parts
    there = extract(image, 4, 12, 40, index=index, row=row, col=col).parts
    assert there["xo"].tolist() == pytest.approx((here["xo"] + col).tolist())
    assert there["yo"].tolist() == pytest.approx((here["yo"] - row).tolist())
    same = ["supscale", "scale", "hindex", "hzone", "speindex", "area_px", "h_max", "h_mean", "building_share"]
    assert there[same].equals(here[same])
    fathers = [pd.Index(parts["part_id"]).get_indexer(parts["supid"]).tolist() for parts in (here, there)]
    assert fathers[0] == fathers[1]
    if (row, col) != (0, 0):
        assert (there["part_id"].to_numpy() != here["part_id"].to_numpy()).all()


def test_an_equal_part_at_the_old_place_of_another_has_its_id():
    """Two equal houses, shifted by their distance: the second one stands where the first one was."""
    image = np.zeros((14, 30), dtype=int)
    image[2:12, 2:12], image[2:12, 16:26] = 2, 2
    here, there = extract(image, 4).parts, extract(image, 4, col=-14).parts
    assert there["part_id"].iloc[1] == here["part_id"].iloc[0]
    assert there["part_id"].iloc[0] not in set(here["part_id"])


@examples(30)
@given(scenes(), st.tuples(*[st.integers(0, 6)] * 4))
def test_ids_do_not_depend_on_the_tile(scene, margin):
    """The same scene in the middle of a larger array has the same parts with the same ids."""
    image, index = scene
    top, bottom, left, right = margin
    wide = [np.pad(np.pad(part, 1), ((top, bottom), (left, right))) for part in (image, index)]
    here = extract(np.pad(image, 1), 4, 12, 40, index=np.pad(index, 1), row=10, col=20)
    there = extract(wide[0], 4, 12, 40, index=wide[1], row=10 - top, col=20 - left)
    assert there.parts.equals(here.parts)
    assert there.rejections.equals(here.rejections)


def test_ids_depend_on_survey_and_scale():
    """Another survey gives other ids; no id occurs twice."""
    here, there = extract(podium(), 10, 50, 200), extract(podium(), 10, 50, 200, survey="other")
    assert here.parts["part_id"].is_unique
    assert not set(here.parts["part_id"]) & set(there.parts["part_id"])
    assert (here.parts["part_id"] > 0).all()
    assert (here.parts["part_id"] < 2**59).all()


@pytest.mark.parametrize("turn", [1, 2, 3])
def test_turning_the_scene_turns_the_forest(turn):
    """A scene by boxes keeps the shape of its trees under rotation."""
    image = np.zeros((60, 50), dtype=int)
    image[2:22, 2:22] = podium()[2:22, 2:22]
    image[30:50, 5:25] = ring()[3:23, 3:23]
    image[5:15, 30:45] = 2
    image[40:43, 35:38] = 1
    assert shape_of(extract(np.rot90(image, turn), 10, 50, 200)) == shape_of(extract(image, 10, 50, 200))
    assert len(shape_of(extract(image, 10, 50, 200))) == 3


def test_the_same_input_gives_the_same_forest():
    """Twice the same, to the byte."""
    rng = np.random.default_rng(5)
    image = np.kron(rng.integers(0, 4, (10, 10)), np.ones((4, 4), dtype=int))
    index = np.where(image > 0, np.kron(rng.integers(1, 4, (10, 10)), np.ones((4, 4), dtype=int)), 0)
    one, two = (extract(image, 4, 12, 40, index=index) for _ in range(2))
    assert one.parts.equals(two.parts)
    assert one.rejections.equals(two.rejections)
    assert all((a == b).all() for a, b in zip(one.labels, two.labels, strict=True))


def test_the_papers_profile_runs():
    """Courtyards fill, as in the paper, and its scales are the five of its test."""
    base = profile("vu2009")
    forest = extract_parts(heights_of(np.kron(podium(), np.ones((2, 2), int))), None, survey="x", params=base)
    assert forest.scales["threshold_m2"].tolist() == [1000.0, 500.0, 200.0, 100.0, 50.0]
    assert len(forest.parts) == 3
