"""Each rule of the tree of parts as a claim on a small array."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from affine import Affine
from pyproj import CRS

from msbdb.errors import TableError
from msbdb.grid import Grid, GridSpec
from msbdb.labels import central_cells, height_statistics, measure, order_heights
from msbdb.landcover import ClassMap
from msbdb.params import ScaleParams, SurfaceParams
from msbdb.parts.adjacency import grow
from msbdb.parts.clusters import ClusterLedger, Clusters, label_clusters, slice_heights, storeys
from msbdb.parts.fakefathers import FAKE, GAP, drop_fake_fathers, spread_of_children
from msbdb.parts.links import SAME_AREA, SAME_STOREYS, drop_duplicates, find_roots, link
from msbdb.parts.reshaping import FRAGMENT, cut, cut_vegetation, settle
from msbdb.parts.spectrum import drop_unlike, measure_spectrum, spectral_modes, split_by_classes
from msbdb.parts.tree import number_scales

UTM = CRS.from_epsg(32633)


def spec_of(shape, cell_m=1.0):
    """Return a lattice of a shape."""
    return GridSpec(shape, Affine(cell_m, 0, 389_000.0, 0, -cell_m, 5_821_000.0), UTM)


def grid(values, valid=None):
    """Return a grid of heights."""
    values = np.asarray(values, dtype=np.float32)
    valid = np.ones(values.shape, dtype=bool) if valid is None else valid
    return Grid(values, valid, spec_of(values.shape))


def classes_of(index):
    """Return a class map in which class 1 is vegetation and all others are building classes."""
    index = np.asarray(index, dtype=np.uint8)
    labels = {n: "vegetation" if n == 1 else "building" for n in range(1, int(index.max()) + 1)}
    return ClassMap(index, labels, spec_of(index.shape))


def living(clusters: Clusters) -> pd.DataFrame:
    """Return the rows of the living clusters."""
    return clusters.rows[clusters.alive]


def block(shape, *boxes, base=0):
    """Draw boxes (row, col, height, width, value) on a background."""
    image = np.full(shape, base, dtype=np.int64)
    for row, col, height, width, value in boxes:
        image[row : row + height, col : col + width] = value
    return image


class TestSlicing:
    """V17 to V19, A8."""

    def test_storeys_count_from_one_at_the_mask(self):
        """H = 1 + floor((h - 2) / 3) inside the mask, 0 below it."""
        heights = grid([[0.0, 1.99, 2.0, 4.4, 5.0, 8.0, 30.5]])
        assert slice_heights(heights, SurfaceParams()).tolist() == [[0, 0, 1, 1, 2, 3, 10]]

    def test_a_step_slices_finer(self):
        """With steps of 1 m each metre above the mask is a slice."""
        heights = grid([[1.0, 2.0, 2.9, 3.5, 5.5]])
        assert slice_heights(heights, SurfaceParams(slicing="step", step_m=1.0)).tolist() == [[0, 1, 1, 2, 4]]

    def test_without_a_level_each_cell_has_its_own_slice(self):
        """With level_m 0 the noise of a roof at 5 m cuts it."""
        heights = grid([[4.99, 5.01, 4.99, 5.01]])
        assert slice_heights(heights, SurfaceParams(level_m=0)).tolist() == [[1, 2, 1, 2]]
        assert slice_heights(heights, SurfaceParams()).tolist() == [[1, 1, 1, 1]]

    @pytest.mark.parametrize("seed", range(3))
    def test_a_level_roof_is_whole_at_any_storey_height(self, seed):
        """From 2.5 to 4 m by 0.05, at any height and with noise of 5 cm, between a tower, an annex and a ramp."""
        random = np.random.default_rng(seed)
        level = random.uniform(3.5, 25)
        heights = np.full((34, 40), level)
        heights[:10, :10] = level + 6
        heights[24:, :10] = level - 1.5
        heights[12:22, 20:] = level + 0.4 * np.arange(1, 21)
        roof = heights == level
        values = grid(heights + random.normal(scale=0.05, size=heights.shape))
        for storey_m in np.arange(2.5, 4.0001, 0.05):
            slices = slice_heights(values, SurfaceParams(storey_m=float(storey_m)))
            found, counts = np.unique(slices[roof], return_counts=True)
            assert counts.max() == roof.sum(), (storey_m, found)
            own = int(storeys(np.array([np.median(values.values[roof])]), SurfaceParams(storey_m=float(storey_m)))[0])
            assert abs(int(found[0]) - own) <= 1
            assert (slices[:10, :10] > found[0]).all()

    @pytest.mark.parametrize("noise_m", [0.01, 0.05])
    def test_a_level_hall_on_sloping_ground_is_whole(self, noise_m):
        """The ground under it falls by 5 m over 120 m, and its heights above ground rise; a step stays a step."""
        heights = np.repeat(np.linspace(5, 10, 120)[None], 60, axis=0)
        heights[40:, :50] += 1.5
        heights += np.random.default_rng(1).normal(scale=noise_m, size=heights.shape)
        for storey_m in np.arange(2.5, 4.0001, 0.05):
            slices = slice_heights(grid(heights), SurfaceParams(storey_m=float(storey_m)))
            for part in (slices[:38], slices[42:, :48]):
                assert np.bincount(part.ravel()).max() > 0.99 * part.size

    def test_a_long_slope_is_cut_where_it_leaves_a_storey(self):
        """Cells that rise by 0.4 m over three storeys are no level zone, and keep their own slices."""
        heights = grid([np.arange(2.2, 11, 0.4)])
        by_cell = slice_heights(heights, SurfaceParams(level_m=0))
        assert slice_heights(heights, SurfaceParams()).tolist() == by_cell.tolist()
        assert by_cell.max() == 3

    def test_cells_without_validity_are_background(self):
        """An invalid cell is no part of a building, whatever its value."""
        heights = grid([[9.0, 9.0]], np.array([[True, False]]))
        assert slice_heights(heights, SurfaceParams()).tolist() == [[3, 0]]

    def test_a_part_has_at_least_one_storey(self):
        """Low statistics inside a part do not take its only storey."""
        assert storeys(np.array([0.0, 1.9, 5.0]), SurfaceParams()).tolist() == [1, 1, 2]


class TestClusters:
    """V22 to V26."""

    def test_clusters_are_flat_zones_without_the_background(self):
        """Equal values that touch by a corner are one cluster; 0 is none."""
        level = np.array([[2, 0, 1], [0, 2, 1], [0, 0, 0]])
        rows = label_clusters([level], connectivity=8).rows
        assert rows[["hzone", "first", "area"]].to_numpy().tolist() == [[2, 0, 2], [1, 2, 2]]

    def test_corners_do_not_connect_by_four(self):
        """With 4-connectivity the two cells are two clusters."""
        assert len(label_clusters([np.array([[2, 0], [0, 2]])], connectivity=4).rows) == 2

    def test_labels_point_at_rows_over_all_scales(self):
        """Labels run on from scale to scale: row number + 1."""
        clusters = label_clusters([np.array([[1, 0, 2]]), np.array([[1, 0, 0]])], connectivity=8)
        assert [clusters.image(level).tolist() for level in range(2)] == [[[1, 0, 2]], [[3, 0, 0]]]
        assert clusters.rows["level"].tolist() == [0, 0, 1]

    def test_measures_equal_those_of_loops(self):
        """First cell, area and centroid sums are those of a plain definition."""
        rng = np.random.default_rng(0)
        labels = rng.integers(0, 6, (7, 9)).astype(np.int32)
        table = measure(labels, 5)
        for label in range(1, 6):
            row, col = np.nonzero(labels == label)
            expected = [row[0] * 9 + col[0], row.size, row.sum(), col.sum()]
            assert table.loc[label - 1].tolist() == expected


class TestDuplicates:
    """V27 to V31."""

    def test_the_same_storeys_make_a_duplicate(self):
        """F in C with equal storeys goes, C stays."""
        fine = block((6, 6), (1, 1, 2, 2, 2))
        coarse = block((6, 6), (0, 0, 6, 6, 2))
        step = drop_duplicates(label_clusters([fine, coarse], connectivity=8), 0.85)
        assert living(step.clusters)["level"].tolist() == [1]
        assert step.dropped["reason"].tolist() == [SAME_STOREYS]

    @pytest.mark.parametrize(("width", "left"), [(17, [1]), (16, [0, 1])])
    def test_nearly_the_same_area_makes_a_duplicate(self, width, left):
        """85 of 100 cells are a duplicate at 0.85, 80 are not."""
        fine = block((5, 20), (0, 0, 5, width, 3))
        coarse = block((5, 20), (0, 0, 5, 20, 2))
        step = drop_duplicates(label_clusters([fine, coarse], connectivity=8), 0.85)
        assert living(step.clusters)["level"].tolist() == left
        assert set(step.dropped["reason"]) <= {SAME_AREA}

    def test_comparison_skips_scales_on_which_there_is_nothing(self):
        """F is compared with the next coarser cluster that exists (V29)."""
        here, nothing = block((5, 5), (1, 1, 3, 3, 2)), np.zeros((5, 5), dtype=np.int64)
        step = drop_duplicates(label_clusters([here, nothing, here], connectivity=8), 0.85)
        assert living(step.clusters)["level"].tolist() == [2]

    def test_a_chain_of_duplicates_leaves_the_coarsest(self):
        """The same zone on every scale stays once."""
        here = block((5, 5), (1, 1, 3, 3, 2))
        step = drop_duplicates(label_clusters([here] * 4, connectivity=8), 0.85)
        assert living(step.clusters)["level"].tolist() == [3]
        assert len(step.dropped) == 3

    def test_storeys_can_be_left_out(self):
        """After reshaping only areas count."""
        fine, coarse = block((6, 6), (1, 1, 2, 2, 2)), block((6, 6), (0, 0, 6, 6, 2))
        step = drop_duplicates(label_clusters([fine, coarse], connectivity=8), 0.85, by_storeys=False)
        assert len(step.dropped) == 0


class TestLinks:
    """V32, V33, A3."""

    def test_the_father_is_the_nearest_coarser_survivor(self):
        """A child looks past a scale whose cluster has been dropped."""
        fine = block((8, 8), (2, 2, 2, 2, 5))
        middle = block((8, 8), (1, 1, 4, 4, 4))
        coarse = block((8, 8), (0, 0, 8, 8, 3))
        clusters = label_clusters([fine, middle, coarse], connectivity=8)
        assert link(clusters).tolist() == [1, 2, -1]
        assert link(clusters.without(np.array([1]))).tolist() == [2, -1, -1]

    def test_roots_are_found_through_any_depth(self):
        """Every chain ends at its own root."""
        assert find_roots(np.array([1, 2, 3, -1, -1, 4])).tolist() == [3, 3, 3, 3, 4, 4]


class TestPieces:
    """V38."""

    def cut_once(self, image, gone, smallest_px):
        """Take cells away from the one cluster of an image."""
        clusters = label_clusters([image], connectivity=8)
        zones = np.where(clusters.cells.of(gone), 0, clusters.labels[0]).astype(np.int32)
        return cut(clusters, 0, zones, np.array([0]), smallest_px=smallest_px, connectivity=8, reason="gone")

    def test_the_largest_piece_keeps_the_row(self):
        """The others get rows of their own, or are dropped when too small."""
        gone = block((1, 12), (0, 1, 1, 1, 1), (0, 5, 1, 1, 1)) > 0
        step = self.cut_once(np.ones((1, 12), dtype=np.int64), gone, 3)
        rows = living(step.clusters)
        assert rows[["first", "area", "origin", "piece"]].to_numpy().tolist() == [[6, 6, 0, 0], [2, 3, 2, 1]]
        assert step.clusters.image(0).tolist() == [[0, 0, 2, 2, 2, 0, 1, 1, 1, 1, 1, 1]]
        assert step.dropped[["area", "reason"]].to_numpy().tolist() == [[1, FRAGMENT]]
        assert step.pieces == 2

    def test_of_equal_pieces_the_first_keeps_the_row(self):
        """Ties are broken by row order."""
        step = self.cut_once(np.ones((1, 7), dtype=np.int64), np.arange(7)[None] == 3, 2)
        assert step.clusters.image(0).tolist() == [[1, 1, 1, 0, 2, 2, 2]]

    def test_a_cluster_of_which_too_little_is_left_is_dropped_as_it_was(self):
        """The ledger shows the whole cluster, not its rest."""
        step = self.cut_once(np.ones((1, 7), dtype=np.int64), np.arange(7)[None] >= 2, 3)
        assert not step.clusters.alive.any()
        assert step.dropped[["area", "reason"]].to_numpy().tolist() == [[7, "gone"]]


class TestVegetation:
    """V37 to V39, A6."""

    def reshaped(self, roof, vegetation, smallest_px=4):
        """Cut vegetation from a roof of one scale."""
        return cut_vegetation(
            label_clusters([roof], connectivity=8), vegetation > 0, smallest_px=smallest_px, connectivity=8
        )

    def test_a_tree_that_reaches_in_is_cut_off(self):
        """A thick blob over the edge has mark 1: its cells leave the object."""
        roof = block((14, 14), (2, 2, 10, 10, 2))
        tree = block((14, 14), (4, 8, 5, 6, 1))
        step = self.reshaped(roof, tree)
        assert ((step.clusters.image(0) > 0) == ((roof > 0) & (tree == 0))).all()
        assert living(step.clusters)["area"].tolist() == [100 - 5 * 4]

    def test_a_green_roof_stays(self):
        """A blob in the middle meets no band."""
        roof = block((14, 14), (2, 2, 10, 10, 2))
        step = self.reshaped(roof, block((14, 14), (5, 5, 4, 4, 1)))
        assert living(step.clusters)["area"].tolist() == [100]

    @pytest.mark.parametrize(("inner", "area"), [(4, 100), (3, 64 + 20)])
    def test_the_band_is_two_cells_deep_inside(self, inner, area):
        """A blob two cells from the edge meets no band; one that begins in it does, and is cut."""
        roof = block((14, 14), (2, 2, 10, 10, 2))
        lawn = block((14, 14), (inner, inner, 4, 4, 1))
        assert living(self.reshaped(roof, lawn).clusters)["area"].tolist() == [area]

    def test_a_thin_fringe_stays(self):
        """A blob wholly in the band has mark 0: mixed cells along the eaves are roof."""
        roof = block((14, 14), (2, 2, 10, 10, 2))
        step = self.reshaped(roof, block((14, 14), (2, 11, 10, 2, 1)))
        assert living(step.clusters)["area"].tolist() == [100]

    def test_a_tree_by_itself_vanishes_into_the_ledger(self):
        """An object under vegetation is dropped with the reason."""
        tree = block((14, 14), (2, 2, 8, 8, 3))
        step = self.reshaped(tree, tree)
        assert not step.clusters.alive.any()
        assert step.dropped[["area", "reason"]].to_numpy().tolist() == [[64, "vegetation"]]

    def test_an_object_may_fall_into_pieces(self):
        """A hedge through a roof leaves two parts; the larger keeps the row."""
        roof = block((14, 20), (2, 2, 10, 16, 2))
        step = self.reshaped(roof, block((14, 20), (0, 6, 14, 4, 1)))
        assert living(step.clusters)["area"].tolist() == [80, 40]
        assert living(step.clusters)["piece"].tolist() == [0, 1]

    def test_what_is_kept_keeps_all_cells_and_its_children_do_not(self):
        """A crown over a roof takes its cells from the part, and leaves the root as the detectors decided it."""
        father, child = block((16, 16), (2, 2, 12, 12, 1)), block((16, 16), (4, 4, 6, 6, 3))
        clusters = label_clusters([child, father], connectivity=8)
        tree = block((16, 16), (5, 8, 4, 8, 1)) > 0
        after = cut_vegetation(clusters, tree, smallest_px=4, connectivity=8, kept=[1]).clusters
        assert living(after)["area"].tolist() == [36 - 8, 144]
        assert link(after).tolist() == [1, -1]

    def test_children_stay_inside_of_their_fathers(self):
        """What a father loses his children lose as well."""
        father = block((16, 16), (2, 2, 12, 12, 1))
        child = block((16, 16), (4, 4, 6, 6, 3))
        clusters = label_clusters([child, father], connectivity=8)
        tree = block((16, 16), (5, 8, 4, 8, 1)) > 0
        after = cut_vegetation(clusters, tree, smallest_px=4, connectivity=8).clusters
        assert (after.labels[1][after.labels[0] > 0] == 2).all()
        assert living(after)["area"].tolist() == [36 - 8, 144 - 24]
        assert link(after).tolist() == [1, -1]


class TestSpectrum:
    """V40 to V45."""

    def test_the_mode_of_the_building_classes_is_spe(self):
        """Vegetation does not count, even if it is most frequent."""
        index = np.array([[1, 1, 1, 1, 2, 3, 3, 1, 1, 1]])
        clusters = label_clusters([np.ones((1, 10), int)], connectivity=8)
        assert spectral_modes(clusters, 0, classes_of(index))[1].tolist() == [3]
        assert measure_spectrum(clusters, 0, classes_of(index)).share.tolist() == [0.3]

    def test_without_a_building_class_the_most_frequent_of_all_is_spe(self):
        """A roof garden has the class of its plants, and a roof without any colour has none (V42)."""
        clusters = label_clusters([np.array([[1, 1, 1, 0, 2, 2]])], connectivity=8)
        index = ClassMap(
            np.array([[1, 1, 2, 3, 0, 0]], np.uint8), {1: "vegetation", 2: "vegetation", 3: "building"}, spec_of((1, 6))
        )
        assert spectral_modes(clusters, 0, index)[1].tolist() == [1, 0]

    def test_equal_classes_give_the_lower_one(self):
        """Ties are broken by the index."""
        index = np.array([[3, 2, 3, 2]])
        clusters = label_clusters([np.ones((1, 4), int)], connectivity=8)
        assert spectral_modes(clusters, 0, classes_of(index))[1].tolist() == [2]

    @pytest.mark.parametrize(("cells", "min_share", "kept"), [(3, 0.3, 1), (2, 0.3, 0), (1, 0.0, 1), (0, 0.0, 0)])
    def test_too_few_building_cells_drop_an_object(self, cells, min_share, kept):
        """Below the share it goes; without any building cell it always goes (V41)."""
        index = np.where(np.arange(10) < cells, 2, 1)[None]
        clusters = label_clusters([np.ones((1, 10), int)], connectivity=8)
        step = drop_unlike(clusters, classes_of(index), min_share)
        assert step.clusters.alive.sum() == kept
        assert len(step.dropped) == 1 - kept

    def test_what_is_kept_is_not_dropped(self):
        """A root that the detectors support stays, whatever its classes."""
        clusters = label_clusters([np.ones((1, 10), int)], connectivity=8)
        step = drop_unlike(clusters, classes_of(np.ones((1, 10), int)), 0.3, kept=[0])
        assert step.clusters.alive.all()
        assert len(step.dropped) == 0

    def test_children_of_a_dropped_father_go_to_its_father(self):
        """And become roots where there is none (V45)."""
        fine, middle, coarse = block((1, 12), (0, 0, 1, 3, 3)), block((1, 12), (0, 0, 1, 8, 2)), np.ones((1, 12), int)
        clusters = label_clusters([fine, middle, coarse], connectivity=8)
        assert link(clusters.without(np.array([1]))).tolist() == [2, -1, -1]
        assert link(clusters.without(np.array([1, 2]))).tolist() == [-1, -1, -1]

    def split(self, levels, index, share=0.4, smallest_px=4):
        """Split by two dominant classes."""
        return split_by_classes(
            label_clusters(levels, connectivity=8),
            classes_of(index),
            split_share=share,
            min_share=0.3,
            smallest_px=smallest_px,
            connectivity=8,
        )

    def test_two_dominant_classes_split_an_object(self):
        """Each class gets its half, and the rest goes to the nearest."""
        index = np.repeat([[2, 2, 2, 2, 1, 3, 3, 3, 3]], 5, axis=0)
        step = self.split([np.ones((5, 9), int)], index)
        assert living(step.clusters)["area"].tolist() == [25, 20]
        assert step.clusters.image(0)[0].tolist() == [1, 1, 1, 1, 1, 2, 2, 2, 2]

    @pytest.mark.parametrize(("width", "parts"), [(4, 2), (3, 1)])
    def test_the_second_class_must_reach_the_share(self, width, parts):
        """40 % of the building cells split, 30 % do not (A5)."""
        index = np.repeat([np.where(np.arange(10) < width, 2, 3)], 5, axis=0)
        assert len(living(self.split([np.ones((5, 10), int)], index).clusters)) == parts

    def test_dust_of_a_class_does_not_split(self):
        """A chequered roof has two classes but no area of either."""
        index = 2 + np.indices((6, 6)).sum(axis=0) % 2
        step = split_by_classes(
            label_clusters([np.ones((6, 6), int)], connectivity=4),
            classes_of(index),
            split_share=0.4,
            min_share=0.3,
            smallest_px=4,
            connectivity=4,
        )
        assert len(living(step.clusters)) == 1

    def test_a_share_of_zero_never_splits(self):
        """The switch is off."""
        index = np.repeat([[2, 2, 3, 3]], 4, axis=0)
        assert len(living(self.split([np.ones((4, 4), int)], index, share=0.0).clusters)) == 1

    def test_the_line_of_a_father_splits_its_children(self):
        """Every piece of a child lies in one piece of the father, and is linked to it."""
        father = np.ones((8, 12), dtype=np.int64)
        child = block((8, 12), (2, 2, 4, 8, 2))
        index = np.where(np.arange(12) < 6, 2, 3)[None].repeat(8, axis=0)
        after = self.split([child, father], index).clusters
        fathers = link(after)
        rows = after.rows
        assert living(after).groupby("level")["area"].apply(list).to_dict() == {0: [16, 16], 1: [48, 48]}
        for row in np.flatnonzero(rows["level"] == 0):
            assert (after.labels[1][after.labels[0] == row + 1] == fathers[row] + 1).all()
        assert len(set(fathers[rows["level"] == 0])) == 2

    def test_a_split_of_a_child_leaves_its_father_whole(self):
        """The pieces have the same father (V44)."""
        father = np.ones((8, 20), dtype=np.int64)
        child = block((8, 20), (2, 2, 4, 8, 2))
        index = np.full((8, 20), 2)
        index[:, 6:10] = 3
        after = self.split([child, father], index).clusters
        assert living(after)["level"].tolist() == [0, 1, 0]
        assert link(after)[[0, 2]].tolist() == [1, 1]


class TestGrow:
    """The kernel behind slivers and splits."""

    def test_values_spread_to_the_nearest_inside_their_domain(self):
        """A wall between two domains is not crossed, and what is out of reach stays 0."""
        seeds = np.array([[4, 0, 0, 0, 0, 9, 0]], dtype=np.int32)
        domain = np.array([[1, 1, 1, 2, 1, 1, 1]])
        assert grow(seeds, domain, 8).tolist() == [[4, 4, 4, 0, 9, 9, 9]]


def row_of_houses(count, *, depth=6, width=10, gap=1):
    """Return a fine scale with houses side by side, and a coarse one on which the gaps have closed."""
    cols = count * width + (count - 1) * gap
    fine = np.zeros((depth + 2, cols + 2), dtype=np.int64)
    for n in range(count):
        start = 1 + n * (width + gap)
        fine[1:-1, start : start + width] = 2
    coarse = np.zeros_like(fine)
    coarse[1:-1, 1:-1] = 1
    return fine, coarse


class TestFathers:
    """V46, A7."""

    def drop(self, levels, **options):
        """Drop fake fathers with the default rule."""
        clusters = label_clusters(levels, connectivity=8)
        return drop_fake_fathers(clusters, replace(ScaleParams(), **options), cell_m=1.0, smallest_px=20)

    def test_stddis_is_the_population_deviation_of_the_distances(self):
        """Three houses in a row 11 m apart: distances 11, 0, 11."""
        clusters = label_clusters(row_of_houses(3), connectivity=8)
        spread = spread_of_children(clusters, link(clusters), 1.0)
        assert spread["stddis"].to_numpy()[3] == pytest.approx(np.std([11, 0, 11]))
        assert spread["children"].tolist() == [0, 0, 0, 3]
        assert spread["stddis"].isna().tolist() == [True, True, True, False]

    def test_a_row_of_houses_has_a_fake_father(self):
        """Houses with gaps of one cell become roots, unchanged; the gaps go to the ledger."""
        fine, coarse = row_of_houses(3)
        step = self.drop([fine, coarse])
        rows = living(step.clusters)
        assert rows["level"].tolist() == [0, 0, 0]
        assert rows["area"].tolist() == [60, 60, 60]
        assert (link(step.clusters) == -1).all()
        assert step.dropped["reason"].tolist() == [FAKE, GAP, GAP]
        assert step.dropped["area"].tolist() == [192, 6, 6]

    def test_cells_that_detectors_support_are_no_gaps(self):
        """Strips of two cells become roots where they are supported and large enough; smaller ones go to the houses."""
        clusters = label_clusters(row_of_houses(3, depth=12, gap=2), connectivity=8)
        areas = {(False, 20): [120] * 3, (True, 20): [120] * 3 + [24] * 2, (True, 25): [120 + 12, 120 + 24, 120 + 12]}
        for (supported, least), expected in areas.items():
            step = drop_fake_fathers(clusters, ScaleParams(), cell_m=1.0, smallest_px=least, supported=supported)
            rows = living(step.clusters)
            assert rows["area"].tolist() == expected
            assert (step.dropped["reason"] == GAP).sum() == (0 if supported else 2)
            for row, (first, area) in rows[["first", "area"]].iterrows():
                cells = np.flatnonzero(step.clusters.image(int(rows.loc[row, "level"])) == row + 1)
                assert (cells[0], cells.size) == (first, area)

    def test_two_children_are_too_few(self):
        """Only fathers with more than two children are judged."""
        assert len(self.drop(row_of_houses(2)).dropped) == 0

    def test_a_podium_with_three_roof_parts_is_real(self):
        """Small parts far apart cover little of their father."""
        podium = np.ones((12, 40), dtype=np.int64)
        parts = block((12, 40), (4, 2, 4, 6, 3), (4, 17, 4, 6, 3), (4, 32, 4, 6, 3))
        assert len(self.drop([parts, podium]).dropped) == 0
        assert len(self.drop([parts, podium], fake_father_coverage=0.0).dropped) > 0

    def test_the_absolute_threshold_is_in_metres(self):
        """A father is fake when StdDis exceeds it, even below the ratio."""
        levels = row_of_houses(3)
        deviation = float(np.std([11, 0, 11]))
        high = {"fake_father_ratio": 10.0}
        assert len(self.drop(levels, **high).dropped) == 0
        assert len(self.drop(levels, **high, fake_father_m=deviation - 0.01).dropped) == 3
        assert len(self.drop(levels, **high, fake_father_m=deviation + 0.01).dropped) == 0

    def test_a_house_that_was_a_duplicate_of_the_father_stays(self):
        """What only the father held becomes a root with an id of its own when it is large and wide."""
        fine, coarse = row_of_houses(5)
        fine[:, 23:33] = 0
        step = self.drop([fine, coarse])
        rows = living(step.clusters)
        assert sorted(rows["area"].tolist()) == [60, 60, 60, 60, 72]
        assert rows[rows["level"] == 1]["piece"].tolist() == [1]
        assert step.pieces == 3

    def test_removal_repeats_until_nothing_is_fake(self):
        """Rows in a block: first the block's father goes, then those of the rows."""
        fine_row, coarse_row = row_of_houses(3)
        fine, middle = np.vstack([fine_row] * 3), np.vstack([coarse_row] * 3)
        coarse = np.where(np.ones_like(middle), 1, 0)
        coarse[:, [0, -1]] = 0
        step = self.drop([fine, middle * 2, coarse], fake_father_ratio=0.1)
        assert living(step.clusters)["level"].tolist() == [0] * 9
        assert (step.dropped["reason"] == FAKE).sum() == 4


class TestSettling:
    """V7 after cuts: no cluster below the s of its scale."""

    def settled(self, *images, thresholds):
        """Settle clusters of some scales, finest first."""
        clusters = label_clusters(images, connectivity=8)
        return settle(clusters, list(thresholds))

    def test_a_cut_cluster_moves_to_the_scale_that_it_reaches(self):
        """20 cells on a scale of 50 belong to that of 10; the father and the child stay where they are."""
        child, cut_off = block((12, 12), (3, 3, 2, 3, 3)), block((12, 12), (2, 2, 4, 5, 2))
        step = self.settled(
            child, np.zeros((12, 12), int), cut_off, np.ones((12, 12), int), thresholds=(5, 10, 50, 100)
        )
        assert living(step.clusters)[["level", "area", "made"]].to_numpy().tolist() == [
            [0, 6, 0],
            [1, 20, 2],
            [3, 144, 3],
        ]
        assert link(step.clusters).tolist() == [1, 2, -1]
        assert len(step.dropped) == 0

    def test_it_covers_what_it_holds_on_its_new_scale(self):
        """A child that is large enough for the same scale goes, as a duplicate; a smaller one stays its child."""
        middle = block((12, 12), (2, 2, 3, 4, 2))
        fine, cut_off = block((12, 12), (2, 2, 2, 3, 3)), block((12, 12), (2, 2, 4, 5, 1))
        step = self.settled(fine, middle, cut_off, thresholds=(5, 10, 50))
        assert living(step.clusters)["area"].tolist() == [6, 20]
        assert step.dropped["area"].tolist() == [12]
        assert link(step.clusters)[0] == 2

    def test_a_crumb_goes_to_its_father_and_a_small_root_stays(self):
        """4 cells of 5 lie in a house of 20, and 4 others stand alone."""
        crumb, house = block((12, 12), (2, 2, 2, 2, 2)), block((12, 12), (2, 2, 4, 5, 1))
        alone = block((12, 12), (9, 9, 2, 2, 3))
        step = self.settled(crumb + alone, house, thresholds=(5, 15))
        assert living(step.clusters)["area"].tolist() == [4, 20]
        assert living(step.clusters)["hzone"].tolist() == [3, 1]
        assert step.dropped[["area", "reason"]].to_numpy().tolist() == [[4, FRAGMENT]]

    def test_clusters_that_are_large_enough_stay(self):
        """Nothing changes."""
        images = block((12, 12), (2, 2, 2, 3, 2)), block((12, 12), (2, 2, 5, 5, 1))
        step = self.settled(*images, thresholds=(6, 25))
        assert step.clusters.rows["level"].tolist() == [0, 1]


class TestHeights:
    """V24, V30."""

    def test_statistics_equal_numpy(self):
        """Each column is numpy's of the valid cells inside."""
        rng = np.random.default_rng(3)
        labels = rng.integers(0, 5, (12, 15)).astype(np.int32)
        ndsm = grid(rng.uniform(0, 30, (12, 15)), rng.random((12, 15)) < 0.8)
        table = height_statistics(labels, slice(0, 4), order_heights(ndsm, labels > 0))
        for label in range(1, 5):
            inside = ndsm.values[(labels == label) & ndsm.valid].astype(np.float64)
            expected = [inside.max(), inside.mean(), *np.percentile(inside, [50, 90]), inside.std()]
            assert table.loc[label - 1].to_numpy() == pytest.approx(expected)

    def test_a_region_without_a_valid_cell_counts_as_zero(self):
        """There is nothing to measure, and no NaN."""
        labels = np.array([[1, 2]], dtype=np.int32)
        order = order_heights(grid([[5.0, 0.0]], np.array([[True, False]])), labels > 0)
        assert height_statistics(labels, slice(0, 2), order)["h_max"].tolist() == [5.0, 0.0]

    def test_the_inner_point_of_a_ring_lies_on_it(self):
        """The centroid of a ring lies in its hole; the inner point does not."""
        labels = np.ones((5, 5), dtype=np.int32)
        labels[1:4, 1:4] = 0
        sums = {"area": 16, "row_sum": 32, "col_sum": 32}
        assert labels.ravel()[central_cells(labels, slice(0, 1), **{k: np.array([v]) for k, v in sums.items()})].all()


def test_scales_that_fall_together_become_one():
    """SCALE 1 is the coarsest, and thresholds are whole cells."""
    scales = number_scales((20.0, 50.0, 52.0), 25.0)
    assert scales.to_numpy().tolist() == [[1, 2, 52.0], [2, 1, 20.0]]


def test_ledgers_that_do_not_balance_are_refused():
    """What goes in is kept or dropped, at each stage."""
    with pytest.raises(TableError, match="does not balance"):
        ClusterLedger("multiscale").count("stage", 5, 3, 1)
