"""Crowns that the detectors took for roofs go: rough and green objects, domes, and what leans on a house."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.masks import block, grid

from msbdb.detect.scene import Evidence, Regions
from msbdb.fuse.cells import fuse_cells
from msbdb.fuse.crowns import without_crowns, without_green, without_leaning_crowns, without_rough
from msbdb.grid import Grid
from msbdb.labels import by_three
from msbdb.params import FuseParams
from msbdb.surface.texture import NO_PLANE_M, grid_samples, roughness

PARAMS = FuseParams()


def supported_by_all(decided, rough, heights):
    """Return what stays where all detectors take the objects."""
    return without_rough(decided, decided.astype(np.float32), rough, heights, PARAMS)


@pytest.mark.parametrize(
    ("votes", "rough_share", "kept"),
    [(2, 0.4, True), (2, 0.6, False), (3, 1.0, True), (4, 1.0, True)],
)
def test_only_rough_objects_of_few_votes_go(votes, rough_share, kept):
    """Either three votes or a smooth half is enough."""
    shape = (20, 20)
    decided = block(shape, (5, 15), (5, 15))
    rough = np.full(shape, 0.02, dtype=np.float32)
    rough[5 : 5 + round(10 * rough_share), 5:15] = 0.3
    found = without_crowns(decided, votes / 4 * decided, rough, PARAMS, clear=0.625, cell_m=1.0)
    assert found.any() == kept
    assert np.array_equal(found, decided if kept else np.zeros(shape, dtype=bool))


@pytest.mark.parametrize(("cell_m", "rough_m", "kept"), [(1.0, 0.05, True), (1.0, 0.15, False), (2.0, 0.15, True)])
def test_roofs_may_be_rougher_on_large_cells(cell_m, rough_m, kept):
    """What is rough on cells of 1 m is smooth on those of 2 m, where a window holds several planes of a roof."""
    decided = block((20, 20), (5, 15), (5, 15))
    rough = np.full(decided.shape, rough_m, dtype=np.float32)
    found = without_crowns(decided, 0.5 * decided, rough, PARAMS, clear=0.625, cell_m=cell_m)
    assert found.any() == kept


@pytest.mark.parametrize(
    ("side", "share", "smooth_rows", "kept"),
    [(4, 0.6, 1, False), (10, 0.6, 2, True), (10, 0.6, 0, False), (10, 0.55, 2, False), (30, 0.55, 6, True)],
)
def test_a_large_rough_object_needs_less_support(side, share, smooth_rows, kept):
    """A block of 900 m² of which a fifth is smooth is no crown, though it has less support than a small house needs."""
    decided = block((40, 40), (5, 5 + side), (5, 5 + side))
    rough = np.ones((40, 40), dtype=np.float32)
    rough[5 : 5 + smooth_rows] = 0.02
    found = without_crowns(decided, share * decided, rough, PARAMS, clear=0.625, cell_m=1.0)
    assert np.array_equal(found, decided if kept else np.zeros_like(decided))


@pytest.mark.parametrize(
    ("green_rows", "rough_rows", "taken_rows", "kept"),
    [(10, 10, 0, False), (6, 6, 0, False), (4, 10, 0, True), (10, 4, 0, True), (10, 10, 2, True)],
    ids=["trees", "mostly trees", "of another colour", "planted roof", "taken by the multi-scale detector"],
)
def test_green_rough_objects_that_only_shape_supports_go(green_rows, rough_rows, taken_rows, kept):
    """A tenth taken by the detector that looks at colours, a smooth half, or half of another colour keeps an object."""
    shape = (20, 20)
    decided = block(shape, (5, 15), (5, 15))
    green, taken = (block(shape, (5, 5 + rows), (5, 15)) for rows in (green_rows, taken_rows))
    rough = np.where(block(shape, (5, 5 + rough_rows), (5, 15)), np.float32(0.4), np.float32(0.02))
    found = without_green(decided, taken, green, rough, PARAMS, cell_m=1.0)
    assert (np.count_nonzero(found) > 50) == kept


def test_a_house_that_trees_touch_stays():
    """The smooth part of another colour stays, if it has the area of a building; narrow gaps in the green do not."""
    shape = (20, 60)
    decided = block(shape, (5, 15), (5, 55))
    house, gap = block(shape, (5, 15), (5, 15)), block(shape, (5, 15), (30, 32))
    rough = np.where(house | gap, np.float32(0.02), np.float32(0.4))
    found = without_green(decided, ~decided, ~(house | gap), rough, PARAMS, cell_m=1.0)
    np.testing.assert_array_equal(found, house)
    regions = {name: Regions(name, decided.astype(np.int32), None, None, {}) for name in ("flat", "area3d", "adaptive")}
    regions["multiscale"] = Regions("multiscale", np.zeros(shape, dtype=np.int32), None, None, {})
    evidence = Evidence(np.rint(1000 * rough).astype(np.uint16), np.full(shape, 200, dtype=np.uint8))
    heights = grid(np.where(decided, 6.0, 0.0))
    fused = fuse_cells(heights, regions, PARAMS, mask_m=2.0, evidence=evidence, green=~house)
    np.testing.assert_array_equal(fused, house)
    np.testing.assert_array_equal(fuse_cells(heights, regions, PARAMS, mask_m=2.0, evidence=evidence), decided)


def crowns(shape):
    """Return heights of dense crowns 5 m apart, on cells of 0.5 m."""
    row, col = np.indices(shape)
    return 5 + 1.5 * np.sin(2 * np.pi * row / 10) * np.sin(2 * np.pi * col / 10)


@pytest.mark.parametrize(
    ("roof_m", "ground_m", "cell_m", "kept"),
    [
        (0.3, 0.02, 0.5, False),
        (0.02, 0.02, 0.5, True),
        (0.1, 0.02, 0.5, True),
        (0.3, 0.12, 0.5, True),
        (0.3, 0.02, 1.2, True),
    ],
    ids=["hedge", "roof", "nearly smooth roof", "noisy survey", "coarse cells"],
)
def test_what_is_rough_throughout_is_no_building(roof_m, ground_m, cell_m, kept):
    """Whatever supports it, unless the bare ground around it is nearly as rough, or cells are too large to say."""
    shape = (60, 60)
    decided = block(shape, (20, 40), (20, 40))
    rough = np.where(decided, np.float32(roof_m), np.float32(ground_m))
    found = supported_by_all(decided, rough, grid(np.where(decided, crowns(shape), 0.0), cell_m))
    np.testing.assert_array_equal(found, decided if kept else np.zeros_like(decided))


ROW = {
    "cell_m": 1.0,
    "sides": (10, 11),
    "share": 0.8,
    "inner_m": 0.3,
    "smooth": 0.0,
    "edge_m": 0.3,
    "unknown": 0.1,
    "beside_m": 0.02,
    "ground_m": 0.02,
    "even": False,
}
"""A row of crowns between 1 and 2 points/m², on even ground."""


@pytest.mark.parametrize(
    ("change", "kept"),
    [
        ({}, False),
        ({"edge_m": 0.02}, False),
        ({"inner_m": 0.02}, True),
        ({"sides": (9, 11)}, True),
        ({"sides": (2, 60)}, True),
        ({"unknown": 0.2}, True),
        ({"ground_m": 0.12}, True),
        ({"even": True}, True),
        ({"smooth": 0.19}, False),
        ({"smooth": 0.23}, True),
        ({"share": 1.0}, False),
        ({"share": 0.75, "edge_m": 0.02, "beside_m": 0.3}, False),
    ],
    ids=[
        "row of crowns",
        "smooth edge",
        "rough edge alone",
        "99 m²",
        "no inner cells",
        "few planes",
        "noisy survey",
        "even once averaged",
        "hardly smooth",
        "a fifth is smooth",
        "all detectors take it",
        "three of four, smooth edge, rough beside it",
    ],
)
def test_groups_of_crowns_are_no_buildings_on_cells_of_a_metre(change, kept):
    """Inner cells of objects of 100 m² and more decide; each property of a roof alone keeps it."""
    row = {**ROW, **change}
    shape, (high, wide) = (70, 70), row["sides"]
    decided = block(shape, (7, 7 + high), (5, 5 + wide))
    inner = by_three(np.logical_and, decided, beyond=np.False_)
    beside = by_three(np.logical_or, decided, beyond=np.False_) & ~decided
    kinds = [(inner, row["inner_m"]), (decided, row["edge_m"]), (beside, row["beside_m"])]
    rough = np.select(*zip(*kinds, strict=True), row["ground_m"]).astype(np.float32)
    cells = np.flatnonzero(decided)
    rough.ravel()[cells[: round(row["unknown"] * len(cells))]] = NO_PLANE_M
    known = np.flatnonzero(inner & (rough < NO_PLANE_M))
    rough.ravel()[known[: round(row["smooth"] * len(known))]] = 0.02
    relief = 6 * np.ones(shape) if row["even"] else 2 * crowns(shape)
    heights = grid(np.where(decided, relief, 0.0), row["cell_m"])
    found = without_rough(decided, np.float32(row["share"] * decided), rough, heights, PARAMS)
    np.testing.assert_array_equal(found, decided & kept)


@pytest.mark.parametrize("edge_m", [0.3, 0.02])
@pytest.mark.parametrize(
    ("beside_m", "cell_m", "share", "kept"),
    [(0.02, 0.5, 1.0, False), (0.3, 0.5, 0.7, True), (0.3, 1.0, 0.75, False), (0.3, 1.0, 0.8, True)],
)
def test_noise_beside_walls_shows_how_rough_roofs_are(beside_m, cell_m, share, kept, edge_m):
    """With rough bare cells beside it a rough roof stays; on cells of a metre only if most detectors take it."""
    shape = (60, 60)
    decided = block(shape, (24, 34), (4, 56))
    inner = by_three(np.logical_and, decided, beyond=np.False_)
    beside = by_three(np.logical_or, decided, beyond=np.False_) & ~decided
    bare = decided | beside | block(shape, (0, 1), (0, 60))
    rough = np.select([inner, decided, beside], [0.3, edge_m, beside_m], 0.02).astype(np.float32)
    heights = grid(np.where(decided, 3 * crowns(shape), 0.0), cell_m)
    heights = Grid(heights.values, bare, heights.spec)
    found = without_rough(decided, np.float32(share * decided), rough, heights, PARAMS)
    # On fine cells edges count, too, and a fifth of them is enough.
    np.testing.assert_array_equal(found, decided & (kept or (cell_m < 1 and edge_m < 0.1)))


@pytest.mark.parametrize("seed", range(6))
def test_bare_cells_out_of_reach_tell_nothing(seed):
    """A hedge without bare cells around is rough, whatever the rounding of sums along its rows has left."""
    shape = (30, 400)
    random = np.random.default_rng(seed)
    decided = block(shape, (9, 21), (300, 330))
    valid = decided | (block(shape, (0, 30), (0, 200)) & (random.random(shape) < 0.5))
    rough = np.where(decided, 0.3, random.uniform(0.01, 0.3, shape)).astype(np.float32)
    heights = grid(np.where(decided, crowns(shape), 0.0), 0.5)
    heights = Grid(heights.values, valid, heights.spec)
    assert not supported_by_all(decided, rough, heights).any()


@pytest.mark.parametrize("noise_m", [0.1, 0.25])
def test_a_roof_that_noise_alone_makes_rough_stays(noise_m):
    """Of a roof the means of some cells are even, and of a hedge they are not, whatever the noise."""
    shape = (60, 60)
    decided = block(shape, (20, 40), (20, 40))
    noise = np.random.default_rng(3).normal(0, noise_m, shape)
    for top, kept in ((5 + 0.4 * np.indices(shape)[0], True), (crowns(shape), False)):
        heights = grid(np.where(decided, top + noise, 0.0), 0.5)
        rough = np.where(decided, roughness(grid_samples(heights), 1.5), np.float32(0.02))
        assert supported_by_all(decided, np.maximum(rough, 0.25 * decided), heights).any() == kept


@pytest.mark.parametrize(
    ("share", "rougher_m", "kept"),
    [(0.2, 0.5, True), (0.3, 0.5, False), (0.6, 0.23, True)],
    ids=["a fifth is rougher", "three tenths are rougher", "most is rougher than twice, all within four times"],
)
def test_what_is_as_rough_all_over_as_noise_makes_a_steep_roof_stays(share, rougher_m, kept):
    """Half of it is beyond twice the limit, three quarters are within four times the limit, or not."""
    shape = (60, 60)
    decided = block(shape, (20, 40), (20, 40))
    rough = np.full(shape, 0.02, dtype=np.float32)
    rough[decided] = np.where(np.arange(400) < 400 * share, rougher_m, 0.17)
    found = supported_by_all(decided, rough, grid(np.where(decided, crowns(shape), 0.0), 0.5))
    np.testing.assert_array_equal(found, decided & kept)


LOW = {
    "cell_m": 1.2,
    "sides": (8, 9),
    "high": ((1.0, 4.0),),
    "share": 0.8,
    "inner_m": 0.3,
    "edge_m": 0.02,
    "beside_m": 0.3,
    "ground_m": 0.02,
    "unknown": 0.4,
}
"""A row of low crowns at 0.6 points/m²."""


@pytest.mark.parametrize(
    ("change", "kept"),
    [
        ({}, False),
        ({"cell_m": 0.5}, False),
        ({"cell_m": 1.5}, False),
        ({"cell_m": 2.0}, True),
        ({"high": ((0.4, 7.0), (0.6, 5.0))}, False),
        ({"high": ((0.6, 7.0), (0.4, 5.0))}, True),
        ({"share": 0.85}, False),
        ({"share": 0.9}, True),
        ({"sides": (5, 6)}, False),
        ({"sides": (5, 5)}, True),
        ({"inner_m": 0.02}, True),
        ({"inner_m": 0.11}, True),
        ({"ground_m": 0.11}, True),
        ({"unknown": 0.6}, True),
    ],
    ids=[
        "row of low crowns",
        "fine cells",
        "cells of 1.5 m",
        "cells of 2 m",
        "two fifths above 6 m",
        "three fifths above 6 m",
        "hardly less support",
        "nearly all support",
        "12 inner cells",
        "9 inner cells",
        "rough edge alone",
        "nearly smooth",
        "noisy survey",
        "planes for few",
    ],
)
def test_low_objects_are_judged_by_the_even_ground_around(change, kept):
    """Bare cells beside them are as rough as they are, and tell nothing; each property of a roof alone keeps it."""
    low = {**LOW, **change}
    shape, (high, wide) = (60, 60), low["sides"]
    decided = block(shape, (20, 20 + high), (20, 20 + wide))
    inner = by_three(np.logical_and, decided, beyond=np.False_)
    beside = by_three(np.logical_or, decided, beyond=np.False_) & ~decided
    rough = np.select([inner, decided, beside], [low["inner_m"], low["edge_m"], low["beside_m"]], low["ground_m"])
    cells = np.flatnonzero(inner)
    rough.ravel()[cells[: round(low["unknown"] * len(cells))]] = NO_PLANE_M
    shares, tops = zip(*low["high"], strict=True)
    heights = np.zeros(shape)
    ends = np.rint(np.cumsum(shares) * decided.sum()).astype(int)
    heights[decided] = np.repeat(tops, np.diff([0, *ends]))
    found = without_rough(
        decided, np.float32(low["share"] * decided), rough.astype(np.float32), grid(heights, low["cell_m"]), PARAMS
    )
    np.testing.assert_array_equal(found, decided & kept)


def test_low_objects_go_one_by_one():
    """Of three low objects on coarse cells the rough one goes; without any object nothing is dropped."""
    shape = (60, 60)
    first, second, third = (block(shape, (at, at + 8), (at, at + 8)) for at in (5, 25, 45))
    decided = first | second | third
    rough = np.where(second, np.float32(0.3), np.float32(0.02))
    share = np.float32(0.75 * decided)
    found = without_rough(decided, share, rough, grid(4.0 * decided, 1.2), PARAMS)
    np.testing.assert_array_equal(found, first | third)
    none = np.zeros(shape, dtype=bool)
    assert not without_rough(none, share, rough, grid(4.0 * decided, 1.2), PARAMS).any()


DOME = {"bends": (0.1, 0.1), "off_m": 0.3, "even": 0.0, "side": 14, "cell_m": 1.0, "ground_m": 0.02}


@pytest.mark.parametrize(
    ("change", "kept"),
    [
        ({}, False),
        ({"cell_m": 0.5, "bends": (0.05, 0.05), "side": 20}, False),
        ({"even": 0.28}, False),
        ({"even": 0.32}, True),
        ({"bends": (0.1, -0.1)}, True),
        ({"bends": (0.2, 0.0)}, True),
        ({"bends": (0.2, 0.01)}, True),
        ({"bends": (-0.1, -0.1)}, True),
        ({"off_m": 0.65}, True),
        ({"side": 15, "bends": (0.02, 0.02)}, True),
        ({"cell_m": 1.2, "side": 11}, True),
        ({"ground_m": 0.11}, True),
    ],
    ids=[
        "crown",
        "fine cells",
        "a quarter is even",
        "a third is even",
        "saddle",
        "ridge",
        "hardly along a ridge",
        "bowl",
        "far from its dome",
        "225 m²",
        "coarse cells",
        "as noisy as the ground",
    ],
)
def test_a_rough_dome_is_a_crown(change, kept):
    """Heights scatter about a quadratic surface that falls off to all sides; each property of a roof alone keeps it."""
    dome = {**DOME, **change}
    side, shape = dome["side"], (40, 40)
    decided = block(shape, (7, 7 + side), (6, 6 + side))
    row, col = (place - 7 - (side - 1) / 2 for place in np.indices(shape))
    off = dome["off_m"] * np.where(np.indices(shape).sum(axis=0) % 2, 1, -1)
    along, across = (bend * dome["cell_m"] ** 2 for bend in dome["bends"])
    high = np.where(decided, 12 - along * row**2 - across * col**2 + off, 0.0)
    rough = np.full(shape, dome["ground_m"], dtype=np.float32)
    rough[decided] = np.where(np.arange(side**2) < dome["even"] * side**2, 0.08, 0.2)
    found = supported_by_all(decided, rough, grid(high, dome["cell_m"]))
    np.testing.assert_array_equal(found, decided & kept)


DOUBTED = {"cell_m": 1.2, "side": 8, "share": 0.75, "even": 0.08, "ground_m": 0.02}


@pytest.mark.parametrize(
    ("change", "kept"),
    [
        ({}, False),
        ({"cell_m": 0.8, "side": 12}, False),
        ({"cell_m": 0.7, "side": 13}, True),
        ({"cell_m": 1.5, "side": 6}, False),
        ({"cell_m": 1.6, "side": 6}, True),
        ({"even": 0.14}, True),
        ({"share": 0.8}, True),
        ({"ground_m": 0.06}, True),
        ({"side": 9}, True),
        ({"cell_m": 1.0, "side": 11, "even": 0.18}, False),
        ({"cell_m": 1.0, "side": 11, "even": 0.22}, True),
        ({"cell_m": 1.0, "side": 9, "even": 0.14}, True),
    ],
    ids=[
        "small",
        "cells of 0.8 m",
        "fine cells",
        "cells of 1.5 m",
        "cells of 1.6 m",
        "an eighth is even",
        "more than three of four",
        "as rough as the ground",
        "117 m²",
        "121 m² on cells of 1 m",
        "121 m² on cells of 1 m, more than a fifth is even",
        "81 m² on cells of 1 m, an eighth is even",
    ],
)
def test_what_three_of_four_take_and_is_hardly_even_goes(change, kept):
    """A level object, neither low nor rough throughout, on cells of 0.75 to 1.5 m; each property of a roof keeps it."""
    doubted = {**DOUBTED, **change}
    side, shape = doubted["side"], (40, 40)
    decided = block(shape, (7, 7 + side), (6, 6 + side))
    rough = np.full(shape, doubted["ground_m"], dtype=np.float32)
    rough[decided] = np.where(np.arange(side**2) < doubted["even"] * side**2, 0.08, 0.11)
    share = np.float32(doubted["share"] * decided)
    found = without_rough(decided, share, rough, grid(12.0 * decided, doubted["cell_m"]), PARAMS)
    np.testing.assert_array_equal(found, decided & kept)


SCRUB = {"high_m": 3.0, "even": 0.35, "side": 12, "cell_m": 0.5, "share": 1.0, "ground_m": 0.02, "edge_m": 0.08}


@pytest.mark.parametrize(
    ("change", "kept"),
    [
        ({}, False),
        ({"high_m": 3.9}, False),
        ({"high_m": 4.1}, True),
        ({"even": 0.45}, True),
        ({"side": 6}, False),
        ({"side": 5, "even": 0.3}, True),
        ({"cell_m": 1.0}, False),
        ({"cell_m": 1.2}, True),
        ({"ground_m": 0.06}, True),
        ({"edge_m": 0.11}, False),
        ({"side": 20, "even": 0.55, "share": 0.85}, False),
        ({"side": 20, "even": 0.55, "share": 0.9}, True),
        ({"side": 20, "even": 0.35}, False),
        ({"side": 20, "even": 0.65, "share": 0.85}, True),
        ({"side": 19, "even": 0.55, "share": 0.85}, True),
    ],
    ids=[
        "scrub that all take",
        "nearly a storey",
        "higher than a storey",
        "nearly half is even",
        "16 inner cells",
        "9 inner cells",
        "cells of a metre",
        "coarse cells",
        "as rough as the ground",
        "rough edge",
        "100 m², more than half is even",
        "100 m² that nearly all take, more than half is even",
        "100 m² that all take, a third is even",
        "100 m², two thirds are even",
        "90 m², more than half is even",
    ],
)
def test_low_objects_that_are_mostly_uneven_go_whatever_supports_them(change, kept):
    """A level object of a roughness that higher roofs may have; its edge does not count."""
    scrub = {**SCRUB, **change}
    shape, inside = (40, 40), (8, 8 + scrub["side"])
    decided = block(shape, inside, inside)
    inner = by_three(np.logical_and, decided, beyond=np.False_)
    rough = np.full(shape, scrub["ground_m"], dtype=np.float32)
    rough[decided] = scrub["edge_m"]
    rough[inner] = np.where(np.arange(inner.sum()) < scrub["even"] * inner.sum(), 0.08, 0.11)
    found = without_rough(
        decided, np.float32(scrub["share"] * decided), rough, grid(scrub["high_m"] * decided, scrub["cell_m"]), PARAMS
    )
    np.testing.assert_array_equal(found, decided & kept)


BESIDE = {"high_m": 3.0, "even": 0.25, "rows": 16, "cell_m": 0.5, "share": 0.75}


@pytest.mark.parametrize(
    ("change", "kept"),
    [
        ({}, False),
        ({"high_m": 4.1}, True),
        ({"even": 0.35}, True),
        ({"rows": 12}, True),
        ({"share": 0.8}, True),
        ({"share": 1.0, "rows": 24}, True),
        ({"share": 1.0, "rows": 26}, False),
        ({"cell_m": 1.2}, True),
    ],
    ids=[
        "64 m²",
        "higher than a storey",
        "a third is even",
        "48 m²",
        "more than three of four",
        "96 m² that all take",
        "104 m² that all take",
        "coarse cells",
    ],
)
def test_scrub_that_touches_a_house_goes_and_the_house_stays(change, kept):
    """Of one object the low part is judged by itself: by its area, its support and its inner cells."""
    beside = {**BESIDE, **change}
    shape = (60, 60)
    house, low = block(shape, (4, 32), (4, 20)), block(shape, (32, 32 + beside["rows"]), (4, 20))
    inner = by_three(np.logical_and, low, beyond=np.False_)
    rough = np.where(low, 0.11, 0.02).astype(np.float32)
    rough[inner] = np.where(np.arange(inner.sum()) < beside["even"] * inner.sum(), 0.08, 0.11)
    share = np.where(house, 1, beside["share"] * low).astype(np.float32)
    heights = grid(np.where(house, 7, beside["high_m"] * low), beside["cell_m"])
    found = without_rough(house | low, share, rough, heights, PARAMS)
    np.testing.assert_array_equal(found, house | low & kept)


@pytest.mark.parametrize(("house_m", "high_m", "kept"), [(0.03, 6, True), (0.11, 6, False), (0.03, 3.5, False)])
def test_a_house_among_scrub_stays(house_m, high_m, kept):
    """Most of the object is scrub; of what is higher than a storey the even part is a house."""
    shape = (60, 60)
    low, house = block(shape, (4, 54), (4, 54)), block(shape, (20, 40), (20, 40))
    rough = np.select([house, low], [house_m, 0.11], 0.02).astype(np.float32)
    found = supported_by_all(low, rough, grid(np.where(house, high_m, 3.0 * low)))
    np.testing.assert_array_equal(found, house & kept)


@pytest.mark.parametrize(("bare_m", "kept"), [((0.8, 0.02), False), ((0.8, 0.2), True), ((0.02, 0.2), True)])
def test_bare_cells_beside_what_is_raised_tell_nothing_about_crowns(bare_m, kept):
    """Refused trees stand around a crown; the bare cells beside them and beyond have a roughness of their own."""
    shape = (40, 40)
    decided = block(shape, (14, 26), (14, 26))
    row, col = np.indices(shape)
    trees = (row % 5 < 2) & (col % 5 < 2) & ~block(shape, (12, 28), (12, 28))
    raised = decided | trees
    beside = by_three(np.logical_or, raised, beyond=np.False_) & ~raised
    assert beside.sum() > (~raised & ~beside).sum() / 2
    high = np.where(
        decided, 12 - 0.1 * (row - 19.5) ** 2 - 0.1 * (col - 19.5) ** 2 + 0.2 * (-1) ** (row + col), 4 * trees
    )
    rough = np.select([raised, beside], [0.3, bare_m[0]], bare_m[1]).astype(np.float32)
    found = supported_by_all(decided, rough, grid(high))
    np.testing.assert_array_equal(found, decided & kept)


def test_domes_are_judged_one_by_one():
    """A crown that the lattice cuts, a ridge, and a level house around a court with a crown, all as rough."""
    shape = (40, 40)
    cut, ridge, court = block(shape, (0, 9), (3, 15)), block(shape, (4, 16), (20, 34)), block(shape, (24, 34), (8, 18))
    house = block(shape, (22, 36), (6, 20)) & ~block(shape, (23, 36), (7, 19))
    row, col = np.indices(shape)
    high = np.select(
        [cut, ridge, court, house],
        [
            9 - ((row - 3) ** 2 + (col - 9) ** 2) / 10,
            9 - 0.5 * abs(row - 10),
            8 - ((row - 29) ** 2 + (col - 13) ** 2) / 30,
            6,
        ],
    )
    decided = cut | ridge | court | house
    rough = np.where(decided, np.float32(0.3), np.float32(0.02))
    off = 0.3 * np.where((row + col) % 2, 1, -1) * decided
    np.testing.assert_array_equal(supported_by_all(decided, rough, grid(high + off)), ridge | house)


@pytest.mark.parametrize(
    ("change", "kept"),
    [
        ({}, False),
        ({"bends": (0.1, -0.1)}, True),
        ({"cell_m": 1.2}, True),
        ({"rough_m": 0.08}, True),
        ({"beside": 3}, False),
        ({"beside": 3, "bends": (0.1, -0.1)}, True),
        ({"side": 3, "bends": (0.5, 0.5)}, True),
    ],
    ids=["crown", "saddle", "coarse cells", "even", "in a court", "annex in a court", "9 m²"],
)
def test_a_dome_that_leans_on_a_house_goes_whatever_supports_it(change, kept):
    """Three of four detectors take a piece at the wall; only its shape tells that it is a crown."""
    piece = {"bends": (0.1, 0.1), "cell_m": 1.0, "rough_m": 0.3, "beside": 1, "side": 10, **change}
    shape, end = (34, 40), 12 + piece["side"]
    # The cells at the wall stay with the house.
    house, wall, crown = (
        block(shape, *cells) for cells in (((4, 30), (4, 14)), ((12, end), (14, 15)), ((12, end), (15, end + 3)))
    )
    if piece["beside"] == 3:
        house |= block(shape, (4, 12), (4, 30)) | block(shape, (22, 30), (4, 30))
    row, col = (
        place - first - (piece["side"] - 1) / 2 for place, first in zip(np.indices(shape), (12, 15), strict=True)
    )
    along, across = (bend * piece["cell_m"] ** 2 for bend in piece["bends"])
    dome = 9 - along * row**2 - across * col**2 + 0.3 * np.where(np.indices(shape).sum(axis=0) % 2, 1, -1)
    high = grid(np.where(crown | wall, dome, np.where(house, 12.0, 0.0)), piece["cell_m"])
    rough = np.where(crown | wall, piece["rough_m"], 0.02).astype(np.float32)
    share = np.where(house, 1.0, 0.75 * (crown | wall))
    left = without_leaning_crowns(house | wall | crown, share, rough, high, PARAMS, limit_m=0.06)
    at_house = by_three(np.logical_or, house, beyond=np.False_)
    np.testing.assert_array_equal(left, house | wall | (crown & (kept | at_house)))


def test_an_object_whose_roughness_is_not_known_stays():
    """Too few samples for planes say nothing, neither on a roof nor on the ground."""
    shape = (60, 60)
    decided = block(shape, (20, 40), (20, 40))
    heights = grid(np.where(decided, crowns(shape), 0.0), 0.5)
    unknown = np.full(shape, NO_PLANE_M, dtype=np.float32)
    np.testing.assert_array_equal(supported_by_all(decided, unknown, heights), decided)
    hedge = np.where(decided, np.float32(0.3), unknown)
    assert not supported_by_all(decided, hedge, heights).any()
    few = without_crowns(decided, 0.5 * decided, unknown, PARAMS, clear=0.625, cell_m=0.5)
    np.testing.assert_array_equal(few, decided)
    green = without_green(decided, ~decided, decided, unknown, PARAMS, cell_m=0.5)
    np.testing.assert_array_equal(green, decided)


def test_each_object_is_judged_by_itself():
    """A house and a crown with the same votes."""
    shape = (10, 30)
    house, crown = block(shape, (2, 8), (2, 12)), block(shape, (2, 8), (15, 22))
    rough = np.where(crown, 0.2, 0.03).astype(np.float32)
    found = without_crowns(house | crown, (house | crown) / 2, rough, PARAMS, clear=0.625, cell_m=1.0)
    np.testing.assert_array_equal(found, house)


def test_the_fusion_looks_twice_where_there_is_evidence():
    """One detector of four sees the glass, two see a crown: by votes alone the crown is taken, and not the glass."""
    shape = (40, 70)
    roof, glass, crown = (
        block(shape, rows, cols) for rows, cols in (((10, 22), (5, 45)), ((10, 22), (20, 30)), ((28, 36), (50, 60)))
    )
    heights = grid(np.where(roof, 12.0, np.where(crown, 7.0, 0.0)))
    masks = [roof | crown, (roof & ~glass) | crown, roof & ~glass, roof & ~glass]
    regions = {str(n): Regions(str(n), mask.astype(np.int32), None, None, {}) for n, mask in enumerate(masks)}
    evidence = Evidence(np.where(crown, 150, 20).astype(np.uint16), np.full(shape, 200, dtype=np.uint8))
    np.testing.assert_array_equal(fuse_cells(heights, regions, PARAMS, mask_m=2.0), (roof & ~glass) | crown)
    found = fuse_cells(heights, regions, PARAMS, mask_m=2.0, evidence=evidence)
    np.testing.assert_array_equal(found, roof)


LEANING = {"votes": 2, "rough": 0.3, "height": 4.0, "beside": 1}


@pytest.mark.parametrize(
    ("change", "kept"),
    [({}, False), ({"votes": 3}, True), ({"rough": 0.02}, True), ({"height": 6.0}, True), ({"beside": 3}, True)],
)
def test_what_leans_on_a_house_goes_if_all_its_evidence_is_poor(change, kept):
    """A rough piece of two votes, 2 m below the house; each property of an annex alone keeps it."""
    piece = {**LEANING, **change}
    shape = (30, 30)
    house, annex = block(shape, (8, 22), (4, 14)), block(shape, (12, 17), (14, 21))
    if piece["beside"] == 3:
        # Wings of the house stand at both sides of the piece, as around a court.
        house |= block(shape, (8, 12), (4, 24)) | block(shape, (17, 22), (4, 24))
    heights = grid(np.where(annex, piece["height"], np.where(house, 6.0, 0.0)))
    share = np.where(house, 1.0, annex * piece["votes"] / 4)
    rough = np.where(annex, piece["rough"], 0.02).astype(np.float32)
    left = without_leaning_crowns(house | annex, share, rough, heights, PARAMS, limit_m=0.06)
    assert np.array_equal(left & ~annex, house), "the house stays"
    # The cells beside the house stay with it.
    assert np.array_equal(left, house | annex if kept else house | block(shape, (12, 17), (14, 15)))


@pytest.mark.parametrize(("depth", "kept"), [(10, False), (11, True)])
def test_a_piece_larger_than_crowns_stays(depth, kept):
    """A row of trees of 400 m² goes. What is larger is a wing whose roof few echoes show."""
    shape = (80, 40)
    house, wing = block(shape, (4, 50), (2, 12)), block(shape, (5, 45), (12, 13 + depth))
    heights = grid(np.where(wing, 4.0, np.where(house, 6.0, 0.0)))
    share, rough = np.where(house, 1.0, wing / 2), np.where(wing, 0.3, 0.02).astype(np.float32)
    left = without_leaning_crowns(house | wing, share, rough, heights, PARAMS, limit_m=0.06)
    assert np.array_equal(left, house | wing if kept else house | block(shape, (5, 45), (12, 13)))


def test_an_object_that_not_all_detectors_see_has_no_leaning_pieces():
    """Without a house there is nothing to lean on; the object as a whole is judged elsewhere."""
    decided = block((20, 20), (5, 15), (5, 15))
    heights = grid(4.0 * decided)
    rough = np.full(decided.shape, 0.3, dtype=np.float32)
    left = without_leaning_crowns(decided, 0.5 * decided, rough, heights, PARAMS, limit_m=0.06)
    assert np.array_equal(left, decided)


@given(st.integers(0, 2**32 - 1))
def test_leaning_crowns_are_the_same_when_the_survey_is_turned(seed):
    """The rule knows no direction, and only takes cells away."""
    random = np.random.default_rng(seed)
    blocks = np.kron(random.integers(0, 5, (6, 6)), np.ones((4, 4)))
    decided = blocks > 1
    share, rough = blocks / 4 * decided, np.asarray(0.1 * random.random(blocks.shape), dtype=np.float32)
    high = 6 * share + random.random(blocks.shape)

    def left(turns):
        images = [np.rot90(image, turns).copy() for image in (decided, share, rough, high)]
        return without_leaning_crowns(*images[:3], grid(images[3]), PARAMS, limit_m=0.06)

    straight = left(0)
    assert not (straight & ~decided).any()
    assert np.array_equal(np.rot90(straight), left(1))
