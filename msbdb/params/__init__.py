"""Every parameter of msbdb, declared once: the command line, the docs and the run table derive from here.

A stage has one frozen dataclass, its section. Each field carries its unit, bounds, meaning and provenance: the paper's
requirement where a paper gives the value, ``ours`` with the reason where it does not. A profile is a set of other
values.
"""

from msbdb.params.declare import checked_value, param, read_params, with_values
from msbdb.params.detect import AdaptiveParams, Area3dParams, FlatRegionParams
from msbdb.params.parts import (
    ChangeParams,
    EvaluateParams,
    FuseParams,
    GranulometryParams,
    HeightParams,
    ScaleParams,
    TouchingParams,
    VectorParams,
)
from msbdb.params.preparation import CoverParams, GroundParams, SpectralParams, SurfaceParams
from msbdb.params.profiles import (
    DETECTORS,
    POINT_DETECTORS,
    PROFILES,
    REGION_DETECTORS,
    Params,
    as_dict,
    choose_detectors,
    declared,
    profile,
    sections,
)

__all__ = [
    "DETECTORS",
    "POINT_DETECTORS",
    "PROFILES",
    "REGION_DETECTORS",
    "AdaptiveParams",
    "Area3dParams",
    "ChangeParams",
    "CoverParams",
    "EvaluateParams",
    "FlatRegionParams",
    "FuseParams",
    "GranulometryParams",
    "GroundParams",
    "HeightParams",
    "Params",
    "ScaleParams",
    "SpectralParams",
    "SurfaceParams",
    "TouchingParams",
    "VectorParams",
    "as_dict",
    "checked_value",
    "choose_detectors",
    "declared",
    "param",
    "profile",
    "read_params",
    "sections",
    "with_values",
]
