"""Every parameter of msbdb, declared once: the command line, the docs and the run table derive from here.

A stage has one frozen dataclass. Each field carries its unit, bounds, meaning and provenance: the paper's
requirement number where a paper gives the value, or ``ours`` with the reason. A profile is a set of other values.
"""

from msbdb.params.adaptive import AdaptiveParams
from msbdb.params.area3d import Area3dParams
from msbdb.params.change import ChangeParams
from msbdb.params.cover import CoverParams
from msbdb.params.declare import param
from msbdb.params.flatregions import FlatRegionParams
from msbdb.params.fuse import FuseParams
from msbdb.params.ground import GroundParams
from msbdb.params.profiles import PROFILES, profile
from msbdb.params.scale import GranulometryParams, ScaleParams
from msbdb.params.sections import Params, as_dict, declared, read_params, sections, with_values
from msbdb.params.spectral import SpectralParams
from msbdb.params.surface import SurfaceParams
from msbdb.params.vector import VectorParams

__all__ = [
    "PROFILES",
    "AdaptiveParams",
    "Area3dParams",
    "ChangeParams",
    "CoverParams",
    "FlatRegionParams",
    "FuseParams",
    "GranulometryParams",
    "GroundParams",
    "Params",
    "ScaleParams",
    "SpectralParams",
    "SurfaceParams",
    "VectorParams",
    "as_dict",
    "declared",
    "param",
    "profile",
    "read_params",
    "sections",
    "with_values",
]
