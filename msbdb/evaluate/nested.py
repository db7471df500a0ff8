"""Measures as nested plain values: what a report hands to JSON and to tables."""

import math
from typing import Any


def plain(value: Any) -> Any:  # noqa: ANN401 (nested values of any plain type)
    """Return the value with None in the place of NaN, at every depth."""
    if isinstance(value, dict):
        return {key: plain(item) for key, item in value.items()}
    return None if isinstance(value, float) and math.isnan(value) else value


def flat(values: dict[str, Any], prefix: str = "") -> list[tuple[str, float | None]]:
    """Return the leaves of nested values with their names joined by dots; those of 'rates' go by their own names."""
    leaves: list[tuple[str, float | None]] = []
    for name, value in values.items():
        if isinstance(value, dict):
            leaves += flat(value, prefix if name == "rates" else f"{prefix}{name}.")
        else:
            leaves.append((prefix + name, value))
    return leaves
