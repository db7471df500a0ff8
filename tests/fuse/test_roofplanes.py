"""Planes of roofs: what lies flush with a building comes back."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.masks import block, grid

from msbdb.fuse.roofplanes import measure_edges, with_flush_planes
from msbdb.params import FuseParams

PARAMS = FuseParams()


def test_a_pane_comes_back_and_an_annex_does_not():
    """A block of glass in a long roof lies flush at both ends; a lower annex and a lorry at the wall have steps."""
    shape = (30, 60)
    roof, glass = block(shape, (10, 20), (5, 50)), block(shape, (10, 20), (20, 32))
    annex, lorry = block(shape, (20, 26), (5, 12)), block(shape, (6, 9), (30, 40))
    heights = np.where(roof, 18.0, np.where(annex, 14.0, np.where(lorry, 3.5, 0.0)))
    found = with_flush_planes(roof & ~glass, glass | annex | lorry, grid(heights), PARAMS)
    np.testing.assert_array_equal(found, roof)


def test_a_terrace_that_touches_a_roof_at_one_end_alone_does_not_join():
    """A wide deck level with a kept roof along a tenth of its edge is something else."""
    shape = (40, 60)
    roof, deck = block(shape, (18, 22), (0, 10)), block(shape, (5, 35), (10, 45))
    heights = np.where(roof | deck, 6.0, 0.0)
    np.testing.assert_array_equal(with_flush_planes(roof, deck, grid(heights), PARAMS), roof)


def naive_planes(decided, candidates, heights, flush_m, share):
    """Flood each region from its first cell, and count the pairs at its edge."""
    rows, cols = decided.shape
    free, out = candidates & ~decided, decided.copy()

    def around(cell):
        for down, right in ((-1, 0), (1, 0), (0, -1), (0, 1)):
            r, c = cell[0] + down, cell[1] + right
            if 0 <= r < rows and 0 <= c < cols:
                yield (r, c), abs(heights[r, c] - heights[cell]) <= flush_m

    seen = set()
    for start in zip(*np.nonzero(free), strict=True):
        if start in seen:
            continue
        region, queue = {start}, [start]
        while queue:
            for other, level in around(queue.pop()):
                if level and free[other] and other not in region:
                    region.add(other)
                    queue.append(other)
        seen |= region
        rim = [(other, level) for cell in region for other, level in around(cell) if other not in region]
        joined = sum(level and decided[other] for other, level in rim)
        if joined >= max(share * len(rim), 1):
            out[tuple(zip(*region, strict=True))] = True
    return out


@given(st.integers(0, 10_000), st.sampled_from([0.1, 0.2, 0.5, 0.8]))
def test_planes_agree_with_a_flood_from_each_cell(seed, share):
    """On random cells of three levels."""
    rng = np.random.default_rng(seed)
    shape = (9, 11)
    heights = rng.choice(np.float32([3.0, 3.25, 6.0]), shape, p=[0.4, 0.4, 0.2])
    decided, candidates = rng.random(shape) < 0.3, rng.random(shape) < 0.7
    found = with_flush_planes(decided, candidates, grid(heights), FuseParams(flush_share=share))
    np.testing.assert_array_equal(found, naive_planes(decided, candidates, heights, PARAMS.flush_m, share))


@pytest.mark.parametrize("shape", [(1, 9), (9, 1), (8, 11)])
def test_edges_are_counted_pair_by_pair(shape):
    """Pairs with cells outside of a region, of them those with buildings, and those whose heights are level."""
    random = np.random.default_rng(sum(shape))
    labels = random.integers(0, 4, shape).astype(np.int32)
    decided = (labels > 0) | (random.random(shape) < 0.5)
    values = random.integers(0, 3, shape) * PARAMS.flush_m
    expected = np.zeros((3, 3), dtype=np.int64)
    for row, col in np.ndindex(shape):
        for r, c in ((row - 1, col), (row + 1, col), (row, col - 1), (row, col + 1)):
            inside = 0 <= r < shape[0] and 0 <= c < shape[1]
            if inside and labels[row, col] > 0 and labels[r, c] != labels[row, col]:
                level = abs(values[row, col] - values[r, c]) <= PARAMS.flush_m
                expected[:, labels[row, col] - 1] += 1, decided[r, c], decided[r, c] and level
    np.testing.assert_array_equal(measure_edges(labels, 3, decided, values, PARAMS), expected)
