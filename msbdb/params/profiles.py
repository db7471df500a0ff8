"""All parameters of a build in sections, the detectors that use them, and the named profiles of values."""

from collections.abc import Iterator, Sequence
from dataclasses import Field, asdict, dataclass, field, fields
from typing import Any

from msbdb.errors import ParameterError
from msbdb.params.declare import with_values
from msbdb.params.detect import AdaptiveParams, Area3dParams, FlatRegionParams
from msbdb.params.parts import (
    ChangeParams,
    FuseParams,
    GranulometryParams,
    HeightParams,
    ScaleParams,
    TouchingParams,
    VectorParams,
)
from msbdb.params.preparation import CoverParams, GroundParams, SpectralParams, SurfaceParams

POINT_DETECTORS = ("area3d", "adaptive")
"""The detectors that search the points themselves, and find candidate regions."""

REGION_DETECTORS = ("flatregions", *POINT_DETECTORS)
"""The detectors whose regions support parts and buildings."""

DETECTORS = ("multiscale", *REGION_DETECTORS)
"""The names of all detectors; the first finds buildings as trees of parts."""


def choose_detectors(names: str | Sequence[str]) -> tuple[str, ...]:
    """Return the detectors to run, in order of their names.

    Raises
    ------
    ParameterError
        When one does not exist, or none is named.
    """
    names = (names,) if isinstance(names, str) else names
    unknown = sorted(set(names) - set(DETECTORS))
    if unknown or not names:
        msg = f"The detectors are {', '.join(sorted(DETECTORS))}; got {', '.join(unknown) or 'none'}."
        raise ParameterError(msg)
    return tuple(sorted(set(names)))


@dataclass(frozen=True, slots=True)
class Params:
    """All parameters of a build, a section for each stage."""

    surface: SurfaceParams = field(default_factory=SurfaceParams)
    ground: GroundParams = field(default_factory=GroundParams)
    cover: CoverParams = field(default_factory=CoverParams)
    scale: ScaleParams = field(default_factory=ScaleParams)
    granulometry: GranulometryParams = field(default_factory=GranulometryParams)
    spectral: SpectralParams = field(default_factory=SpectralParams)
    flatregions: FlatRegionParams = field(default_factory=FlatRegionParams)
    area3d: Area3dParams = field(default_factory=Area3dParams)
    adaptive: AdaptiveParams = field(default_factory=AdaptiveParams)
    fuse: FuseParams = field(default_factory=FuseParams)
    touching: TouchingParams = field(default_factory=TouchingParams)
    heights: HeightParams = field(default_factory=HeightParams)
    vector: VectorParams = field(default_factory=VectorParams)
    change: ChangeParams = field(default_factory=ChangeParams)


def sections(params: Params) -> Iterator[tuple[str, Any]]:
    """Yield each section's name and its dataclass."""
    for section in fields(params):
        yield section.name, getattr(params, section.name)


def as_dict(params: Params) -> dict[str, dict[str, Any]]:
    """Return all values as nested plain dictionaries, for TOML, JSON and the run table."""
    return asdict(params)


def declared() -> Iterator[tuple[str, Field[Any], Any]]:
    """Yield section, field and default of every parameter, in order of the stages."""
    for section, values in sections(Params()):
        for item in fields(values):
            yield section, item, item.default


def profile(name: str = "default") -> Params:
    """Return the parameters of a named profile.

    Raises
    ------
    ParameterError
        When there is no profile of this name.
    """
    if name not in PROFILES:
        msg = f"There is no profile '{name}'; the profiles are {', '.join(PROFILES)}."
        raise ParameterError(msg)
    return with_values(Params(), PROFILES[name])


ALONE: dict[str, dict[str, Any]] = {"fuse": {"votes": False}}
"""Each detector by itself, as in its paper."""

VU: dict[str, dict[str, Any]] = {
    "surface": {"cell_m": 1.0, "storeys_from": "zone", "below_top_m": 0.0},
    "ground": {"ground_filter": "wavelet"},
    "scale": {
        "scales_m2": (50.0, 100.0, 200.0, 500.0, 1000.0),
        "keep_courtyards": False,
        "fake_father_coverage": 0.0,
    },
    "spectral": {"decides": "spectral", "split_share": 0.4},
    **ALONE,
}
"""Vu et al. 2009 as written; the ratio of fake fathers, which the paper does not state, is ours."""

MONGUS: dict[str, Any] = {
    "on": "surface",
    "gaps": "all",
    "s_max_m": 3.0,
    "valley_factor": 2.0,
    "peak_factor": 4.0,
    "gradients": "denoised",
    "gradient_window_m": 0.0,
    "gradient_cap_m": 0.0,
    "lambda_min_m2": 30.0,
    "lambda_max_m2": 40_000.0,
    "lambda_step_m2": 250.0,
    "ratio": 1.5,
    "blind_ratio": 1.5,
    "largest_m2": 0.0,
    "leaf_probability": 0.0,
    "opening_m": 3.0,
    "max_compactness": 9.0,
    "compact_m2": 0.0,
    "grow_m": 0.0,
}
"""Mongus et al. 2013 as written, with Table 1's values of the data set DS1 (M23).

λ_max fits square kilometres: a tile whose ground has a smaller sum of gradients is one flat region.
"""

MONGUS_DS2 = {**MONGUS, "lambda_min_m2": 20.0, "lambda_step_m2": 500.0, "max_compactness": 11.0}
MONGUS_DS3 = {**MONGUS, "lambda_min_m2": 20.0, "lambda_step_m2": 300.0, "max_compactness": 10.5}

QUADRATIC = {"ground_filter": "quadratic", "quadratic_passes": 1}
"""The ground of Cao & Wu as written."""

CAO_WU: dict[str, Any] = {
    "mask_first": False,
    "histogram_tail_percent": 0.0,
    "thin_m": 0.0,
    "max_echo_share": 1.0,
    "max_crown": 1.0,
    "max_crown_curvature": 1.0,
    "max_ndvi": 1.0,
    "grow_m": 0.0,
    "grow_spacings": 0.0,
    "rectangularity_2": 0.4,
    "compactness": 3.0,
    "compactness_density": 0.0,
    "linearity": 0.45,
}
"""Cao & Wu as written; T_c, K, T_coc, R, E_s, n_b, n_s and σ_l, which they do not state, are ours."""

PROFILES: dict[str, dict[str, dict[str, Any]]] = {
    "default": {},
    "vu2009": VU,
    "mongus2013": {"flatregions": MONGUS, **ALONE},
    "mongus2013-ds2": {"flatregions": MONGUS_DS2, **ALONE},
    "mongus2013-ds3": {"flatregions": MONGUS_DS3, **ALONE},
    "cao-wu": {"ground": QUADRATIC, "area3d": CAO_WU, **ALONE},
    "cao-wu-ss": {"ground": QUADRATIC, "area3d": {**CAO_WU, "most_heights": 1}, **ALONE},
    "adaptive": {"ground": {"ground_filter": "adaptive"}, **ALONE},
}
"""The values of each profile that differ from the defaults."""
