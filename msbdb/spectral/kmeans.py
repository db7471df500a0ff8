"""K-means of the bands (V35): one seeded fit on a sample of cells, the same for any tiling, then prediction."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from msbdb.grid import Bands
from msbdb.spectral.colours import Scaling, fit_scaling
from msbdb.threads import in_threads, kernel

STARTS = 4
"""Fits from different first centres; the tightest one is kept."""

ITERATIONS = 100
"""Largest number of Lloyd's iterations of a fit."""

CHUNK = 2**18
"""Cells that are predicted at a time, to bound the memory."""


@dataclass(frozen=True, slots=True, eq=False)
class Sample:
    """Cells on which the classes are fitted and described, in the order of their keys.

    Parameters
    ----------
    names : tuple of str
        The bands.
    keys : (N,) ndarray of uint64
        Hash of seed and absolute lattice position, ascending.
    filtered : (N, B) ndarray of float64
        The bands after the area filter, which are clustered.
    bands : (N, B) ndarray of float64
        The bands as they came.
    roughness : (N,) ndarray of float64, metres
        NaN where unknown.
    height : (N,) ndarray of float64, metres
        Above ground.
    roof : (N,) ndarray of float64
        1 where the structure takes the cell for a roof, 0 where for vegetation; NaN where unknown.
    """

    names: tuple[str, ...]
    keys: NDArray[np.uint64]
    filtered: NDArray[np.float64]
    bands: NDArray[np.float64]
    roughness: NDArray[np.float64]
    height: NDArray[np.float64]
    roof: NDArray[np.float64]

    def __len__(self) -> int:
        """Return the number of cells."""
        return len(self.keys)


@dataclass(frozen=True, slots=True, eq=False)
class Centres:
    """The centres of the classes, and the scaling that they were fitted with.

    ``values`` is (K, B) float64, scaled; class k of a class map, from 1, is row k - 1.
    """

    scaling: Scaling
    values: NDArray[np.float64]

    def __len__(self) -> int:
        """Return the number of classes."""
        return len(self.values)


def lattice_keys(row: NDArray[np.integer], col: NDArray[np.integer], seed: int) -> NDArray[np.uint64]:
    """Hash seed and absolute lattice position to 64 bits: a random order that no tiling can change."""
    packed = (row.astype(np.uint64) << np.uint64(32)) ^ (col.astype(np.uint64) & np.uint64(0xFFFFFFFF))
    return _mix(packed ^ _mix(np.full(1, seed, dtype=np.uint64)))


def _mix(value: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """Return SplitMix64 of the values (Steele et al. 2014, doi:10.1145/2660193.2660195); the sums wrap on purpose."""
    value = value + np.uint64(0x9E3779B97F4A7C15)
    value = (value ^ (value >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    value = (value ^ (value >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return value ^ (value >> np.uint64(31))


def draw_sample(
    filtered: Bands,
    bands: Bands,
    heights: NDArray[np.generic],
    roughness: NDArray[np.floating] | None,
    roof: NDArray[np.bool_] | None = None,
    *,
    count: int,
    seed: int,
) -> Sample:
    """Draw the ``count`` valid cells of the filtered bands with the smallest keys; all, when there are fewer."""
    row, col = np.nonzero(filtered.valid)
    first_row, first_col = bands.spec.origin
    keys = lattice_keys(row + first_row, col + first_col, seed)
    kept = _smallest(keys, count)
    row, col = row[kept], col[kept]

    def known(values: NDArray[np.generic] | None) -> NDArray[np.float64]:
        return np.full(row.size, np.nan) if values is None else values[row, col].astype(np.float64)

    return Sample(
        bands.names,
        keys[kept],
        filtered.values[:, row, col].T.astype(np.float64),
        bands.values[:, row, col].T.astype(np.float64),
        known(roughness),
        known(heights),
        known(roof),
    )


def pooled(samples: Sequence[Sample], count: int) -> Sample:
    """Return the ``count`` cells with the smallest keys of samples of one survey, as if it had been sampled at once."""
    if len(samples) == 1:
        return samples[0]
    keys = np.concatenate([each.keys for each in samples])
    kept = _smallest(keys, count)
    columns = ("filtered", "bands", "roughness", "height", "roof")
    values = (np.concatenate([getattr(each, name) for each in samples])[kept] for name in columns)
    return Sample(samples[0].names, keys[kept], *values)


def _smallest(keys: NDArray[np.uint64], count: int) -> NDArray[np.intp]:
    """Index of the smallest keys, in their order."""
    chosen = np.argpartition(keys, count)[:count] if keys.size > count else np.arange(keys.size)
    return chosen[np.argsort(keys[chosen], kind="stable")]


def load_solver() -> None:
    """Load scikit-learn, which takes half a second: beside other work it costs nothing."""
    import sklearn.cluster  # noqa: F401  (`fit_centres` finds it loaded)


def fit_centres(sample: Sample, *, classes: int, seed: int, tail_percent: float) -> Centres:
    """Scale the bands by the sample's percentiles (V21) and fit k-means on it (V35).

    Parameters
    ----------
    sample : Sample
        At least one cell.
    classes : int
        K; fewer when the sample has fewer distinct cells.
    seed : int
        Of the first centres.
    tail_percent : float
        Percentile that becomes 0; that of 100 less it becomes 1.

    Returns
    -------
    Centres
        In the lexical order of their values.

    Notes
    -----
    One thread, and a fixed number of starts and iterations: the same sample gives the same centres everywhere.
    """
    from sklearn.cluster import KMeans  # it takes a second to load, which a build without colours does not need

    scaling = fit_scaling(sample.filtered, sample.names, tail_percent)
    scaled = scaling.apply(sample.filtered)
    distinct = np.unique(scaled, axis=0)
    if len(distinct) <= classes:
        return Centres(scaling, distinct)
    model = KMeans(classes, n_init=STARTS, max_iter=ITERATIONS, algorithm="lloyd", random_state=seed)
    with threadpool_limits(limits=1):
        model.fit(scaled)
    return Centres(scaling, np.unique(model.cluster_centers_, axis=0))


def nearest_class(filtered: NDArray[np.floating], centres: Centres) -> NDArray[np.uint8]:
    """Return the class, from 1, of the nearest centre to each row (N, B) of filtered bands; ties go to the lower.

    Examples
    --------
    >>> centres = Centres(Scaling(("red",), (0.0,), (100.0,)), np.array([[0.0], [0.5], [1.0]]))
    >>> nearest_class(np.array([[10.0], [25.0], [90.0]]), centres)
    array([1, 1, 3], dtype=uint8)
    """
    low, high = np.array(centres.scaling.low), np.array(centres.scaling.high)
    span = np.where(high > low, high - low, 1.0)
    return nearest_centres(np.ascontiguousarray(filtered, dtype=np.float64), low, span, centres.values)


def predict(filtered: Bands, centres: Centres) -> NDArray[np.uint8]:
    """Return the (H, W) classes of the valid cells, from 1; 0 elsewhere."""
    index = np.zeros(filtered.spec.shape, dtype=np.uint8)
    row, col = np.nonzero(filtered.valid)

    def of_part(start: int) -> None:
        part = slice(start, start + CHUNK)
        index[row[part], col[part]] = nearest_class(filtered.values[:, row[part], col[part]].T, centres)

    in_threads(of_part, range(0, row.size, CHUNK))
    return index


@kernel
def nearest_centres(
    values: NDArray[np.float64], low: NDArray[np.float64], span: NDArray[np.float64], centres: NDArray[np.float64]
) -> NDArray[np.uint8]:
    """Class, from 1, of the centre nearest to each row (N, B), after scaling by ``low`` and ``span`` and clipping.

    Distances are summed a band at a time, never by a matrix product, so that they are the same on every machine.
    """
    count, bands = values.shape
    nearest = np.zeros(count, dtype=np.uint8)
    scaled = np.empty(bands)
    for i in range(count):
        for band in range(bands):
            scaled[band] = min(max((values[i, band] - low[band]) / span[band], 0.0), 1.0)
        best = np.inf
        for number in range(len(centres)):
            distance = 0.0
            for band in range(bands):
                away = scaled[band] - centres[number, band]
                distance += away * away
            if distance < best:  # not "<=": of equal distances the lower class stays
                best = distance
                nearest[i] = number + 1
    return nearest
