"""What the property tests draw: small images with plateaus, and the parameters of area filters."""

import numpy as np
from hypothesis import strategies as st

CONNECTIVITIES = st.sampled_from([4, 8])
THRESHOLDS = st.integers(1, 30)

INTEGERS = st.sampled_from([np.int16, np.int32, np.int64])
FLOATS = st.sampled_from([np.float32, np.float64])
FLOAT_LEVELS = np.array([-1e30, -1.5, 0.0, 0.1, 0.1 + 2**-50, 0.2, 1.0, 3.0, 1e30])
"""Levels from tiny to huge steps: a filter that computes instead of choosing would round some of them."""


@st.composite
def images(draw, dtypes=INTEGERS | FLOATS, low=-3, high=5, largest=14):
    """Draw an image: 1 to 14 cells a side, also a single row or column, of random cells or of blocks."""
    rows, cols = draw(st.sampled_from([(1, 0), (0, 1), (0, 0), (0, 0)]).flatmap(lambda one: _shape(one, largest)))
    dtype = np.dtype(draw(dtypes))
    random = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    values = random.integers(low, draw(st.integers(low + 1, high)), size=(rows, cols), endpoint=True)
    block_rows, block_cols = draw(st.integers(1, 4)), draw(st.integers(1, 4))
    values = np.kron(values, np.ones((block_rows, block_cols), dtype=int))[:rows, :cols]
    noisy = random.random((rows, cols)) < draw(st.sampled_from([0.0, 0.1]))
    values[noisy] = random.integers(low, high, size=noisy.sum(), endpoint=True)
    if dtype.kind == "f":
        return FLOAT_LEVELS.astype(dtype)[values - low]
    return values.astype(dtype)


def integer_images(low=-3, high=5, largest=14):
    """Draw images of integers only."""
    return images(INTEGERS, low, high, largest)


def _shape(one, largest):
    """Draw rows and columns; a 1 in the pair fixes that side to one cell."""
    return st.tuples(*(st.just(1) if side else st.integers(1, largest) for side in one))


@st.composite
def surfaces(draw, largest=12):
    """Draw an image and a mask of its valid cells: all, none, half of them, or a random share; NaN in the others."""
    image = draw(images(low=-3, high=3, largest=largest))
    if image.dtype.kind == "f":
        # Of a unit, as measured heights are: their differences have no rounding in 64 bits.
        image = np.round(np.clip(image, -4, 4) * 64).astype(image.dtype) / image.dtype.type(64)
    random = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    valid = random.random(image.shape) < draw(st.sampled_from([1.0, 1.0, 0.9, 0.5, 0.0]))
    if draw(st.booleans()):
        valid[:, image.shape[1] // 2 :] = True
    if image.dtype.kind == "f":
        image[~valid] = np.nan
    return image, valid


def fields(shape, seed):
    """Return a field that is nowhere negative, whose sums have no rounding."""
    random = np.random.default_rng(seed)
    return random.integers(0, 9, shape) * 0.25 * random.integers(0, 2, shape)


@st.composite
def clouds(draw, most=40):
    """Draw x, y and z of a small cloud: scattered, on a lattice with duplicates, in a line or at one place; or none."""
    count = draw(st.integers(0, most))
    random = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    points = random.uniform(0, draw(st.sampled_from([1.0, 4.0, 8.0])), (3, count))
    kind = draw(st.sampled_from(["scattered", "lattice", "line", "place"]))
    if kind == "lattice":
        points = np.floor(points)
    if kind == "line":
        points[1:] = 0.5 * points[0]
    if kind == "place":
        points[:] = 0.25
    if draw(st.booleans()):
        points[0, count // 2 :] += 1e6
    offset = draw(st.sampled_from([0.0, -3.0, 1e7]))
    return points[0] + offset, points[1] - offset, points[2]
