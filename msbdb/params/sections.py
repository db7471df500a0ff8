"""All parameters of a build, section by section, and how values are set and checked."""

import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import MISSING, Field, asdict, dataclass, field, fields, replace
from pathlib import Path
from typing import Any

from msbdb.errors import FileError, ParameterError
from msbdb.params.adaptive import AdaptiveParams
from msbdb.params.area3d import Area3dParams
from msbdb.params.change import ChangeParams
from msbdb.params.cover import CoverParams
from msbdb.params.flatregions import FlatRegionParams
from msbdb.params.fuse import FuseParams
from msbdb.params.ground import GroundParams
from msbdb.params.scale import GranulometryParams, ScaleParams
from msbdb.params.spectral import SpectralParams
from msbdb.params.surface import SurfaceParams
from msbdb.params.vector import VectorParams


@dataclass(frozen=True, slots=True)
class Params:
    """All parameters of a build, a section a stage."""

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
    vector: VectorParams = field(default_factory=VectorParams)
    change: ChangeParams = field(default_factory=ChangeParams)


def sections(params: Params) -> Iterator[tuple[str, Any]]:
    """Yield each section's name and its dataclass."""
    for section in fields(params):
        yield section.name, getattr(params, section.name)


def as_dict(params: Params) -> dict[str, dict[str, Any]]:
    """Return all values as nested plain dictionaries, for TOML, JSON and the run table."""
    return asdict(params)


def with_values(params: Params, values: Mapping[str, Mapping[str, Any]]) -> Params:
    """Return the parameters with some values replaced, checked against their declarations.

    Raises
    ------
    ParameterError
        For an unknown section or name, a wrong type, or a value out of bounds.
    """
    known = dict(sections(params))
    changed = {}
    for section, pairs in values.items():
        if section not in known or not isinstance(pairs, Mapping):
            msg = f"There is no parameter section '{section}'; the sections are {', '.join(known)}."
            raise ParameterError(msg)
        declared = {f.name: f for f in fields(known[section])}
        for name in pairs:
            if name not in declared:
                msg = f"There is no parameter '{section}.{name}'; this section has {', '.join(declared)}."
                raise ParameterError(msg)
        checked = {name: _checked(section, declared[name], value) for name, value in pairs.items()}
        changed[section] = replace(known[section], **checked)
    return replace(params, **changed)


def read_params(path: Path, base: Params) -> Params:
    """Read a TOML file with a table a section over the base values.

    Raises
    ------
    FileError
        When the file cannot be read.
    ParameterError
        When it is no TOML, or sets what is not declared.
    """
    try:
        values = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        msg = f"The parameter file {path} cannot be read: {error.strerror}."
        raise FileError(msg) from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        msg = f"The parameter file {path} is no valid TOML: {error}."
        raise ParameterError(msg) from error
    return with_values(base, values)


def declared() -> Iterator[tuple[str, Field[Any], Any]]:
    """Yield section, field and default of every parameter, in order of the stages."""
    for section, values in sections(Params()):
        for item in fields(values):
            yield section, item, item.default if item.default is not MISSING else getattr(values, item.name)


def _checked(section: str, item: Field[Any], value: Any) -> Any:  # noqa: ANN401
    """Return the value in its declared type, or refuse it."""
    name = f"{section}.{item.name}"
    meta = item.metadata
    converted = _converted(name, type(item.default), value)
    if meta["choices"] and converted not in meta["choices"]:
        msg = f"{name} must be one of {', '.join(meta['choices'])}; got {value!r}."
        raise ParameterError(msg)
    numbers = converted if isinstance(converted, tuple) else (converted,)
    for number in numbers:
        too_low = meta["low"] is not None and not number >= meta["low"]
        too_high = meta["high"] is not None and not number <= meta["high"]
        if too_low or too_high:
            msg = f"{name} must lie between {meta['low']} and {meta['high']} {meta['unit']}; got {value!r}."
            raise ParameterError(msg)
    return converted


def _converted(name: str, kind: type, value: Any) -> Any:  # noqa: ANN401
    """Convert a plain TOML or JSON value to the type of the default."""
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    if kind is float and is_number:
        return float(value)
    if kind is tuple and isinstance(value, list | tuple):
        return tuple(_converted(name, float, item) for item in value)
    if kind is int and is_number and value == int(value):
        return int(value)
    if kind in (bool, str) and isinstance(value, kind):
        return value
    msg = f"{name} must be of type {kind.__name__}; got {value!r}."
    raise ParameterError(msg)
