"""How a parameter is declared, and how values are checked against the declarations.

A section is a frozen dataclass whose fields are made by `param`; a set of parameters is a frozen dataclass of sections.
A declaration is the only place of a default, its unit, its bounds, its meaning and its source.
"""

from collections.abc import Mapping
from dataclasses import Field, field, fields, replace
from pathlib import Path
from typing import Any, TypeVar

from msbdb.errors import FileError, ParameterError

T = TypeVar("T")


def param(
    default: Any,  # noqa: ANN401  (a parameter may be of any plain type)
    unit: str,
    doc: str,
    *,
    paper: str = "",
    ours: str = "",
    low: float | None = None,
    high: float | None = None,
    choices: tuple[str, ...] | None = None,
) -> Any:  # noqa: ANN401  (as dataclasses.field)
    """Declare a parameter of a section.

    Parameters
    ----------
    default : bool, int, float, str or tuple of float
        Its type is the parameter's type.
    unit : str
        ``1`` for a share or factor, ``-`` without a unit.
    doc : str
        The meaning, one sentence.
    paper : str
        The paper's requirement, and its value where it is not the default.
    ours : str
        The reason of a value that no paper gives, or that differs from the paper's.
    low, high : float, optional
        Bounds, both allowed; of each number of a tuple.
    choices : tuple of str, optional
        All allowed values of a text.

    Returns
    -------
    dataclasses.Field
        With the metadata ``unit``, ``doc``, ``source``, ``low``, ``high`` and ``choices``.
    """
    source = "; ".join([paper] * bool(paper) + [f"ours: {ours}"] * bool(ours))
    metadata = {"unit": unit, "doc": doc, "source": source, "low": low, "high": high, "choices": choices}
    return field(default=default, metadata=metadata)


def with_values(params: T, values: Mapping[str, Mapping[str, Any]]) -> T:
    """Return the parameters with some values replaced, checked against their declarations.

    Parameters
    ----------
    params : Params
        A dataclass of sections. Not modified.
    values : mapping of mappings
        New values by section and name, as TOML or JSON give them.

    Raises
    ------
    ParameterError
        For an unknown section or name, a wrong type, or a value out of bounds.
    """
    known: dict[str, Any] = {item.name: getattr(params, item.name) for item in _fields(params)}
    changed = {}
    for section, pairs in values.items():
        if section not in known or not isinstance(pairs, Mapping):
            msg = f"There is no parameter section '{section}'; the sections are {', '.join(known)}."
            raise ParameterError(msg)
        declared = {item.name: item for item in _fields(known[section])}
        for name in pairs:
            if name not in declared:
                msg = f"There is no parameter '{section}.{name}'; this section has {', '.join(declared)}."
                raise ParameterError(msg)
        checked = {name: checked_value(section, declared[name], value) for name, value in pairs.items()}
        changed[section] = replace(known[section], **checked)
    return replace(params, **changed)  # type: ignore[type-var]  # a TypeVar cannot be bound to dataclasses


def read_params(path: Path, base: T) -> T:
    """Read a TOML file with a table for each section, and return the base values with those of the file.

    Raises
    ------
    FileError
        When the file cannot be read.
    ParameterError
        When it is not valid TOML, or sets what is not declared.
    """
    import tomllib

    try:
        values = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        msg = f"The parameter file {path} cannot be read: {error.strerror}."
        raise FileError(msg) from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        msg = f"The parameter file {path} is no valid TOML: {error}."
        raise ParameterError(msg) from error
    return with_values(base, values)


def checked_value(section: str, item: Field[Any], value: Any) -> Any:  # noqa: ANN401  (as dataclasses.field)  (any plain type)
    """Return a value in the declared type of its parameter.

    Raises
    ------
    ParameterError
        For a wrong type, a value out of bounds, or none of the choices.
    """
    name, meta = f"{section}.{item.name}", item.metadata
    converted = _converted(name, type(item.default), value)
    if meta["choices"] and converted not in meta["choices"]:
        msg = f"{name} must be one of {', '.join(meta['choices'])}; got {value!r}."
        raise ParameterError(msg)
    for number in converted if isinstance(converted, tuple) else (converted,):
        # Written so that NaN, which no comparison holds for, is refused.
        too_low = meta["low"] is not None and not number >= meta["low"]
        too_high = meta["high"] is not None and not number <= meta["high"]
        if too_low or too_high:
            msg = f"{name} must lie between {meta['low']} and {meta['high']} {meta['unit']}; got {value!r}."
            raise ParameterError(msg)
    return converted


def require_rising(section: str, values: Any, lower: str, upper: str) -> None:  # noqa: ANN401  (a dataclass)
    """Refuse two limits between which something rises, when the lower one is not below the upper one.

    Raises
    ------
    ParameterError
        With both names and values.
    """
    low, high = getattr(values, lower), getattr(values, upper)
    if low >= high:
        msg = (
            f"'{section}.{lower}' must be below '{section}.{upper}'; got {low} and {high}. "
            f"Set both, or a smaller '{section}.{lower}'."
        )
        raise ParameterError(msg)


def _converted(name: str, kind: type, value: Any) -> Any:  # noqa: ANN401  (as dataclasses.field)  (any plain type)
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


def _fields(values: Any) -> tuple[Field[Any], ...]:  # noqa: ANN401  (any dataclass)
    """Return the fields of a dataclass."""
    return fields(values)
