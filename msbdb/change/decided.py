"""What was decided in the windows of a comparison, joined to the changes and new states of the whole survey."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import geopandas as gpd
import pandas as pd
import shapely
from pyproj import CRS

CHANGE_COLUMNS = {
    "kind": "str",
    "before": "int64",
    "after": "int64",
    "version": "int64",
    "outline": "bool",
    "height": "bool",
    "parts": "bool",
    "overlap_m2": "float64",
    "iou": "float64",
    "dh_m": "float64",
    "darea_m2": "float64",
    "note": "str",
}


Rank = tuple[int, int, int]
"""Place of a decision among all: buildings of the inventory first, then those of the survey, then pieces by place."""

Version = tuple[Rank, int, int, bool, shapely.Geometry]
"""A new state: its rank, its rows before and after or -1, whether its outline is the survey's, and this outline."""


@dataclass(frozen=True, slots=True)
class Decided:
    """What was decided in a window: rows of the changes and new states, each with its rank.

    ``version`` of a row is the place in ``versions``; ``before`` and ``after`` are rows of the whole frames, or -1.
    """

    rows: list[tuple[Rank, dict[str, Any]]] = field(default_factory=list)
    versions: list[Version] = field(default_factory=list)

    def replace_outline(self, number: int, shape: shapely.Geometry) -> None:
        """Give a new state an outline of its own, and its rows the difference in area."""
        version = self.versions[number]
        self.versions[number] = (*version[:3], False, shape)
        for _, row in self.rows:
            if row["version"] == number:
                row["darea_m2"] += float(shapely.area(shape) - shapely.area(version[4]))


def joined(decided: Sequence[Decided], crs: CRS) -> tuple[pd.DataFrame, gpd.GeoDataFrame]:
    """Return the changes of all windows in order of the inventory, then of the survey, and the new states."""
    versions = sorted(
        (
            (*version, window, number)
            for window, one in enumerate(decided)
            for number, version in enumerate(one.versions)
        ),
        key=lambda version: (version[0], version[-1]),
    )
    place = {version[-2:]: number for number, version in enumerate(versions)}
    rows = [
        (rank, row | {"version": place.get((window, row["version"]), -1)})
        for window, one in enumerate(decided)
        for rank, row in one.rows
    ]
    rows.sort(key=lambda ranked: ranked[0])
    frame = pd.DataFrame([row for _, row in rows], columns=list(CHANGE_COLUMNS)).astype(CHANGE_COLUMNS)
    is_new = frame["before"] < 0
    changes = frame.assign(is_new=is_new).sort_values(["is_new", "before", "after"], kind="stable", ignore_index=True)
    states = gpd.GeoDataFrame(
        [version[1:4] for version in versions],
        columns=["before", "after", "adopted"],
        geometry=[version[4] for version in versions],
        crs=crs,
    )
    return changes[list(CHANGE_COLUMNS)], states.astype({"before": "int64", "after": "int64", "adopted": "bool"})
