"""The plan of a survey: all values that a tile of it cannot know by itself, fixed once for all of its tiles.

A build of one piece finds them on its way. A build by the plan of a larger survey takes them as they are. Everything
else that a build computes depends on what lies around a place.
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from msbdb.errors import InputError, ParameterError
from msbdb.identity import exact_json, plain

T = TypeVar("T")

FORM = 1
"""Version of the form in which a plan is written."""

EVEN = 1.5
"""Ours, in sample: sparser parts of a survey have up to so many mean spacings; real places have 1.1 to 1.45."""

USUAL_SPLIT = 0.55
"""Ours: mean share of pulses that crowns split with all echoes. Each town chooses it by the others (decision 0043)."""

LEAST_TRUST = 0.2
"""Ours: shares of split pulses grow at most five times; otherwise one of few pulses would decide."""

CROWN_CLASSES_M = (3.0, 4.0, 5.0, 6.0, 8.0)
"""Ours: heights between the classes of crowns, metres. A sensor separates echoes only some metres apart."""

CROWN_MIDDLES_M = (2.5, 3.5, 4.5, 5.5, 7.0, 9.0)
"""Heights above ground for which the classes stand, metres."""

BASIS = {
    "surface": (),
    "ground": (),
    "cover": (),
    "scale": (),
    "granulometry": (),
    "spectral": (),
    "area3d": ("heights_m", "most_heights", "mask_first", "histogram_tail_percent"),
    "adaptive": ("ndvi_bounds",),
}
"""The parameters from which a plan follows, by section: some names, or all of the section's."""

NO_PLAN = "It is no plan as 'msbdb plan --json' writes it: {}. Make it again."


@dataclass(frozen=True, slots=True)
class PointFacts:
    """What holds for all points of a survey.

    Parameters
    ----------
    points : int
        Points from which it is known.
    density : float
        First echoes a square metre of covered ground.
    all_density : float
        The same before what is denser than ``surface.most_density`` was thinned.
    spacing_m, typical_m, link_m : float
        Mean and median spacing of the first echoes, and their least link, metres (`msbdb.points.spacing.Density`).
    sparse_m : float
        Spacing of the sparser parts, metres (`msbdb.points.spacing.sparse_spacing`).
    numbered, echoes : bool
        Echoes have numbers, and some pulse has more than one echo.
    crown_split : tuple of float, or None
        Share of pulses that crowns split, by `CROWN_CLASSES_M` (`msbdb.surface.cover.crown_split`). None where
        nothing is known of it.
    under_m : float
        Where echoes have no numbers, points that lie under others within this distance are later ones, metres; 0 where
        none are (`msbdb.points.laterechoes`).
    ground_share : float
        Share of the points in class 2.
    colours : tuple of str
        The colours of the points, those that are the same everywhere left out.
    intensity : bool
        The intensity of the pulses varies.
    levels_m : tuple of (float, float)
        Lowest and highest elevation of each group of points, metres. A wide gap without points lies between groups;
        points that lie as far from all groups are lone.
    """

    points: int
    density: float
    all_density: float
    spacing_m: float
    typical_m: float
    sparse_m: float
    link_m: float
    numbered: bool
    echoes: bool
    crown_split: tuple[float, ...] | None
    under_m: float
    ground_share: float
    colours: tuple[str, ...]
    intensity: bool
    levels_m: tuple[tuple[float, float], ...]

    @property
    def even_m(self) -> float:
        """Spacing that cells and the links of points follow, metres: the mean, or more where much is far sparser."""
        return max(self.spacing_m, self.sparse_m / EVEN)

    @property
    def most_trust(self) -> float:
        """The trust in single echoes high above the ground, from 0 to 1."""
        return self._trusts()[-1]

    def echo_trust(self, heights_m: NDArray[np.floating[Any]]) -> NDArray[np.float32]:
        """Return the trust in single echoes as a sign of a roof, from 0 to 1, at heights above ground.

        Where a sensor hardly splits pulses in crowns of this height, roofs and crowns both give single echoes.
        """
        trusts = self._trusts()
        if min(trusts) == 1:
            return np.ones((1,) * np.ndim(heights_m), dtype=np.float32)
        return np.asarray(np.interp(heights_m, CROWN_MIDDLES_M, trusts), dtype=np.float32)

    def _trusts(self) -> list[float]:
        """Return the trust in single echoes of each class of crowns."""
        if not self.echoes:
            return [0.0] * len(CROWN_MIDDLES_M)
        return [min(1.0, split / USUAL_SPLIT) for split in self.crown_split or (1.0,) * len(CROWN_MIDDLES_M)]


def usual_split(split: NDArray[np.floating[Any]], trust: NDArray[np.floating[Any]]) -> NDArray[np.float32]:
    """Return the share of pulses that a sensor would have split whose single echoes are trusted in full.

    A weaker sensor splits fewer pulses of the same leaves, in proportion to the trust in its single echoes.

    Parameters
    ----------
    split : ndarray
        The recorded shares, from 0 to 1.
    trust : ndarray
        The trust at the same places, from 0 to 1; below `LEAST_TRUST` it counts as that.

    Returns
    -------
    ndarray of float32
        At most 1.

    Examples
    --------
    >>> usual_split(np.float32([0.05, 0.2, 0.2]), np.float32([0.5, 0.5, 0.1])).round(2)
    array([0.1, 0.4, 1. ], dtype=float32)
    """
    return np.asarray(np.minimum(split / np.maximum(trust, LEAST_TRUST), 1), dtype=np.float32)


@dataclass(frozen=True, slots=True)
class ClassPlan:
    """The classes of colours (V21, V35, V36): one value a band, or one a class; None for an unknown one.

    Parameters
    ----------
    bands : tuple of str
        The bands.
    low, high : tuple of float
        The values of each band that become 0 and 1, in the source's units.
    centres : tuple of tuple of float
        For each class, in canonical order, the scaled value of each band.
    vegetation_index : str or None
        The index in use, and ``vegetation_threshold``, above which a class is green.
    labels : tuple of str
        The automatic label of each class.
    index, brightness, roughness_m, height_m : tuple of float or None
        What is known of each class (`msbdb.spectral.model.ClassFacts`).
    band_means : tuple of tuple of float or None
        For each class the mean of each band, in the source's units.
    roof_share : tuple of float or None
        The share of each class that the structure takes for roofs, and ``all_roofs``, that of all cells.
    """

    bands: tuple[str, ...]
    low: tuple[float, ...]
    high: tuple[float, ...]
    centres: tuple[tuple[float, ...], ...]
    vegetation_index: str | None
    vegetation_threshold: float | None
    labels: tuple[str, ...]
    index: tuple[float | None, ...]
    brightness: tuple[float | None, ...]
    roughness_m: tuple[float | None, ...]
    height_m: tuple[float | None, ...]
    band_means: tuple[tuple[float | None, ...], ...]
    roof_share: tuple[float | None, ...]
    all_roofs: float | None


@dataclass(frozen=True, slots=True)
class Plan:
    """All values that depend on the whole extent of a survey.

    Parameters
    ----------
    crs : str
        The horizontal CRS, as an authority's code or as WKT.
    cell_m : float
        Side of a cell of the lattice, metres.
    density : float
        First echoes a square metre; of rasters, cells.
    points : PointFacts or None
        What holds for all points; None for rasters.
    ground_filter : str
        The filter by which the ground is detected; ``given`` for a terrain that the user gives.
    scales_m2 : tuple of float
        Area thresholds of the scale-space, ascending, square metres.
    heights_m : tuple of float
        Height scales of ``area3d``, metres; empty where nothing is above ground.
    ndvi_threshold : float or None
        NDVI above which points are green in ``adaptive``; None where no point has an NDVI.
    classes : ClassPlan or None
        The classes of colours; None without imagery.
    basis : dict
        The parameters from which the values follow, by section.
    blocks : tuple of (float, float)
        South-western corners of the blocks that were looked at, metres; empty where the whole survey was.
    block_m : float
        Side of a block, metres; 0 where the whole survey was looked at.
    """

    crs: str
    cell_m: float
    density: float
    points: PointFacts | None
    ground_filter: str
    scales_m2: tuple[float, ...]
    heights_m: tuple[float, ...]
    ndvi_threshold: float | None
    classes: ClassPlan | None
    basis: dict[str, dict[str, Any]]
    blocks: tuple[tuple[float, float], ...] = ()
    block_m: float = 0.0

    def as_dict(self) -> dict[str, Any]:
        """Return the plan as plain values, with the version of their form."""
        found = {"form": FORM, **plain(self)}
        if self.points is not None and self.points.crown_split is None:
            # An older plan has no such name, and its run a digest of its text.
            del found["points"]["crown_split"]
        return found

    def as_json(self) -> str:
        """Return the plan as JSON: the same text for the same plan."""
        return exact_json(self.as_dict())

    def pairs(self) -> dict[str, str]:
        """Return the plan in words, by what they are about."""
        found = {
            "CRS": self.crs if len(self.crs) < len("EPSG:000000000") else "without a code",
            "cells": f"{self.cell_m:g} m",
            "ground": self.ground_filter,
            "scales": f"{_listed(self.scales_m2)} m²",
        }
        if self.points is not None:
            found |= _of_points(self.points)
        if self.heights_m:
            found["height scales of area3d"] = f"{_listed(self.heights_m)} m"
        if self.ndvi_threshold is not None:
            found["adaptive: green above an NDVI of"] = f"{self.ndvi_threshold:.2f}"
        if self.classes is not None:
            own = self.classes
            found["bands"] = ", ".join(
                f"{name} {low:.0f} to {high:.0f}" for name, low, high in zip(own.bands, own.low, own.high, strict=True)
            )
            found["classes of colours"] = ", ".join(own.labels)
            if own.vegetation_threshold is not None:
                found["classes: green above"] = f"{own.vegetation_index} of {own.vegetation_threshold:.2f}"
        return found

    @classmethod
    def from_dict(cls, values: object) -> Self:
        """Return a plan from what `as_dict` gave, or from its JSON read back.

        Raises
        ------
        InputError
            When it is no plan, or one of a newer msbdb.
        """
        known = _named(values, "the plan", {own.name for own in fields(cls)} | {"form"})
        if known["form"] != FORM:
            msg = f"The plan has the form {known['form']}; this msbdb reads form {FORM}. Make the plan again."
            raise InputError(msg)
        points, classes = known["points"], known["classes"]
        try:
            return cls(
                crs=str(known["crs"]),
                cell_m=float(known["cell_m"]),
                density=float(known["density"]),
                points=None if points is None else _as(PointFacts, _with_later_facts(points)),
                ground_filter=str(known["ground_filter"]),
                scales_m2=tuple(map(float, known["scales_m2"])),
                heights_m=tuple(map(float, known["heights_m"])),
                ndvi_threshold=None if known["ndvi_threshold"] is None else float(known["ndvi_threshold"]),
                classes=None if classes is None else _as(ClassPlan, _with_roofs(classes)),
                basis=_in_order(known["basis"]),
                blocks=_tuples(known["blocks"]),
                block_m=float(known["block_m"]),
            )
        except (TypeError, ValueError, AttributeError) as error:
            raise InputError(NO_PLAN.format(error)) from error

    @classmethod
    def from_json(cls, text: str) -> Self:
        """Return a plan from its JSON; errors are those of `from_dict`."""
        try:
            return cls.from_dict(json.loads(text))
        except ValueError as error:
            raise InputError(NO_PLAN.format(error)) from error

    def require_basis(self, parameters: Mapping[str, Mapping[str, Any]]) -> None:
        """Refuse parameters from which other values would follow.

        Raises
        ------
        ParameterError
            With the first of them.
        """
        for section, own in self.basis.items():
            for name, value in own.items():
                given = plain(parameters.get(section, {}).get(name, value))
                if given != plain(value):
                    msg = (
                        f"The plan follows from {section}.{name} = {value}; the build has {given}. "
                        "Make another plan with this value, or build with the plan's."
                    )
                    raise ParameterError(msg)


def _listed(values: tuple[float, ...]) -> str:
    """Return numbers in words."""
    return ", ".join(f"{value:.1f}".removesuffix(".0") for value in values)


def _of_points(facts: PointFacts) -> dict[str, str]:
    """Return the facts of points in words."""
    has = {"several echoes a pulse": facts.echoes, "later echoes without numbers": facts.under_m > 0}
    has |= {"intensity": facts.intensity} | dict.fromkeys(facts.colours, True)
    return {
        "points": f"{facts.points:,}, {100 * facts.ground_share:.0f} % in class 2",
        "density": _density(facts),
        "spacing": f"{facts.spacing_m:.2f} m on average, {facts.typical_m:.2f} m on the median ground, "
        f"{facts.sparse_m:.2f} m where it is sparse, links of {facts.link_m:.2f} m",
        "points have": ", ".join(name for name, there in has.items() if there) or "coordinates alone",
        **({} if facts.crown_split is None else {"crowns split": _splits(facts.crown_split)}),
        "elevations": "; ".join(f"{low:.1f} to {high:.1f} m" for low, high in facts.levels_m),
    }


def _splits(crown_split: tuple[float, ...]) -> str:
    """Return the shares of pulses that crowns split in words."""
    low, high = (f"{100 * share:.0f} % of the pulses" for share in (crown_split[0], crown_split[-1]))
    return low if low == high else f"{low} below {CROWN_CLASSES_M[0]:g} m, {high} above {CROWN_CLASSES_M[-1]:g} m"


def _density(facts: PointFacts) -> str:
    """Return the density in words, and how much of it is taken."""
    found = f"{facts.all_density:.1f} first echoes"
    return found if facts.density == facts.all_density else f"{found}, of which {facts.density:.1f} are taken"


def basis_of(parameters: Mapping[str, Mapping[str, Any]]) -> dict[str, dict[str, Any]]:
    """Return the parameters from which a plan follows."""
    return _in_order(
        {
            section: {name: plain(parameters[section][name]) for name in (names or parameters[section])}
            for section, names in BASIS.items()
        }
    )


def _in_order(basis: Mapping[str, Mapping[str, Any]]) -> dict[str, dict[str, Any]]:
    """Return parameters in the order of sections and names."""
    return {section: dict(sorted(own.items())) for section, own in sorted(basis.items())}


def known(values: "np.ndarray[Any, np.dtype[np.float64]]") -> tuple[float | None, ...]:
    """Return numbers as a plan has them: None for one that is not finite."""
    return tuple(float(value) if np.isfinite(value) else None for value in values)


def numbers(values: tuple[Any, ...]) -> "np.ndarray[Any, np.dtype[np.float64]]":
    """Return the numbers of a plan as an array: NaN where one is unknown."""
    return np.array(values, dtype=np.float64)


def _with_later_facts(points: object) -> object:
    """Return the facts of points. Of an earlier plan all parts are as sparse, and nothing is known of its crowns."""
    if not isinstance(points, Mapping) or "spacing_m" not in points:
        return points
    return {"sparse_m": points["spacing_m"], "crown_split": None, **points}


def _with_roofs(classes: object) -> object:
    """Return the classes of a plan; where an earlier plan does not tell their shares of roofs, these are unknown."""
    if not isinstance(classes, Mapping) or "roof_share" in classes or "labels" not in classes:
        return classes
    return {**classes, "roof_share": [None] * len(classes["labels"]), "all_roofs": None}


def _as(kind: type[T], values: object) -> T:
    """Return a section of a plan."""
    names = [own.name for own in fields(kind)]  # type: ignore[arg-type]  # a type variable cannot be bound to dataclasses
    found = _named(values, kind.__name__, set(names))
    return kind(**{name: _tuples(value) for name, value in found.items()})


def _named(values: object, what: str, names: set[str]) -> dict[str, Any]:
    """Return values by name; refuse other names than these."""
    if not isinstance(values, Mapping):
        raise InputError(NO_PLAN.format(f"{what} has no names"))
    if set(values) != names:
        unlike = ", ".join(sorted(map(str, set(values) ^ names)))
        raise InputError(NO_PLAN.format(f"{what} lacks, or should not have: {unlike}"))
    return dict(values)


def _tuples(value: Any) -> Any:  # noqa: ANN401  (any plain value)
    """Return lists as tuples."""
    return tuple(map(_tuples, value)) if isinstance(value, list | tuple) else value
