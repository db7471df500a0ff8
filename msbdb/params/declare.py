"""How a parameter is declared: its default, unit, bounds, meaning and provenance in one place."""

from dataclasses import field
from typing import Any


def param(
    default: Any,  # noqa: ANN401  (a parameter may be of any plain type)
    *,
    unit: str,
    doc: str,
    source: str,
    low: float | None = None,
    high: float | None = None,
    choices: tuple[str, ...] | None = None,
) -> Any:  # noqa: ANN401
    """Declare a parameter: its default, unit, bounds or choices, meaning and where the value comes from."""
    metadata = {"unit": unit, "doc": doc, "source": source, "low": low, "high": high, "choices": choices}
    return field(default=default, metadata=metadata)
