"""The points of a survey in memory, with their attributes."""

from dataclasses import dataclass, field, fields, replace

import numpy as np
from numpy.typing import NDArray
from pyproj import CRS

from msbdb.errors import InputError
from msbdb.grid import Bounds, require_metric
from msbdb.points.aside import set_aside
from msbdb.surveyplan import PointFacts

UNCLASSIFIED_CLASS, GROUND_CLASS, BUILDING_CLASS = 1, 2, 6

NOISE_CLASSES = (7, 18)
"""Classes of points by the ASPRS LAS specification; noise is low or high."""


@dataclass(frozen=True, slots=True, eq=False)
class PointCloud:
    """Points of one survey; arrays of equal length, None where the source has no such attribute.

    Parameters
    ----------
    x, y, z : (N,) ndarray of float64, metres
        Finite coordinates.
    crs : CRS
        Horizontal CRS, projected and in metres.
    vertical_crs : CRS, optional
        The heights' CRS, when the source names one.
    classification : (N,) ndarray of uint8, optional
        ASPRS classes.
    return_number, number_of_returns : (N,) ndarray of uint8, optional
        None when the source holds no echo information (all zero).
    intensity : (N,) ndarray of uint16, optional
        None when constant.
    colours : (N, B) ndarray of uint16, optional
        None when the source has none, or all are zero.
    colour_names : tuple of str
        Of ``red, green, blue, nir``, one a column of ``colours``.
    facts : PointFacts, optional
        What holds for the whole survey that the points are of; None where they are all of it, or nobody knows.
    """

    x: NDArray[np.float64]
    y: NDArray[np.float64]
    z: NDArray[np.float64]
    crs: CRS
    vertical_crs: CRS | None = None
    classification: NDArray[np.uint8] | None = None
    return_number: NDArray[np.uint8] | None = None
    number_of_returns: NDArray[np.uint8] | None = None
    intensity: NDArray[np.uint16] | None = None
    colours: NDArray[np.uint16] | None = None
    colour_names: tuple[str, ...] = field(default=())
    facts: PointFacts | None = None

    def __post_init__(self) -> None:
        """Check the lengths and the CRS."""
        require_metric(self.crs)
        for name, values in self.arrays().items():
            if len(values) != len(self.x):
                msg = f"The attribute {name} has {len(values)} values for {len(self.x)} points."
                raise InputError(msg)

    def __len__(self) -> int:
        """Return the number of points."""
        return len(self.x)

    def arrays(self) -> dict[str, NDArray[np.generic]]:
        """Return the arrays that are present, by name."""
        found = {f.name: getattr(self, f.name) for f in fields(self)}
        return {name: value for name, value in found.items() if isinstance(value, np.ndarray)}

    def in_class(self, *classes: int) -> NDArray[np.bool_]:
        """Return (N,) bool, which points have one of the ASPRS classes; none where the source holds no classes."""
        if self.classification is None:
            return np.zeros(len(self), dtype=np.bool_)
        return np.isin(self.classification, classes)

    def take(self, index: NDArray[np.generic]) -> "PointCloud":
        """Return the points that a boolean or integer index selects, with all their attributes."""
        # Of rows of colours a boolean index takes ten times as long as their numbers do.
        places = np.flatnonzero(index) if index.dtype == np.bool_ else index
        return replace(self, **{name: each.take(places, axis=0) for name, each in self.arrays().items()})  # type: ignore[arg-type]  # as they were

    def places(self) -> "PointCloud":
        """Return the points with their places and echoes alone, all that detectors take."""
        return replace(self, classification=None, intensity=None, colours=None, colour_names=())

    def aside(self) -> "PointCloud":
        """Return the points as files hold them where memory is bounded (`msbdb.points.aside.set_aside`)."""
        return replace(self, **{name: set_aside(values) for name, values in self.arrays().items()})  # type: ignore[arg-type]  # as they were

    @property
    def bounds(self) -> Bounds:
        """West, south, east and north, metres."""
        return (float(self.x.min()), float(self.y.min()), float(self.x.max()), float(self.y.max()))

    @property
    def first_echo(self) -> NDArray[np.bool_]:
        """Which points are first echoes (V15); all of them where the source holds no echo information."""
        if self.return_number is None:
            return np.ones(len(self), dtype=np.bool_)
        return np.equal(self.return_number, 1)

    @property
    def has_echoes(self) -> bool:
        """Whether some pulse of the survey gave more than one echo, so that the echoes hold information."""
        if self.number_of_returns is None:
            return False
        return bool((self.number_of_returns > 1).any()) if self.facts is None else self.facts.echoes

    def echo_trust(self, heights_m: NDArray[np.floating]) -> NDArray[np.float32]:
        """Return the trust in single echoes (`PointFacts.echo_trust`); full without facts, none without echoes."""
        if self.facts is None or not self.has_echoes:
            return np.full((1,) * heights_m.ndim, self.has_echoes, dtype=np.float32)
        return self.facts.echo_trust(heights_m)

    @property
    def most_trust(self) -> float:
        """The trust in single echoes high above the ground (`PointFacts.most_trust`)."""
        return float(self.has_echoes) if self.facts is None else self.facts.most_trust * self.has_echoes
