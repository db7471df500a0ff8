"""What the results of all tiles say together: extent, classes, the ledger in numbers, and where neighbours differ."""

from collections.abc import Iterable
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from pyproj import CRS

from msbdb.errors import NodataError, counted
from msbdb.grid import GridSpec, lattice
from msbdb.kept import KeptRun, Rasters
from msbdb.run.compose import Job, record_run
from msbdb.run.reports import Notices
from msbdb.scale.tileresults import Result
from msbdb.scale.tiling import GUARD_M
from msbdb.surveyplan import Plan
from msbdb.tables import REJECTION_COUNT, SPECTRAL_CLASS, Counts, Survey

Place = tuple[int, ...]
"""Absolute row and column of a first cell, and numbers of rows and columns."""


def sum_up_tiles(
    results: Iterable[Result],
    job: Job,
    plan: Plan,
    *,
    timings: dict[str, float],
    notices: Notices,
    most_m: float,
    cells: GridSpec | None = None,
) -> KeptRun:
    """Return the survey, the run and its tables as a whole, summed over the results of all tiles.

    Parameters
    ----------
    results : iterable of Result
        Those of all tiles in order; each is taken once.
    job, plan : Job, Plan
        What was done.
    timings : dict
        Seconds by stage.
    notices : Notices
        Receives what a person should know of the tiles and of the cut.
    most_m : float
        How far a tile sees beyond its own ground at most, metres.
    cells : GridSpec, optional
        The lattice of the survey; by default what the points reach.

    Returns
    -------
    KeptRun
        Without rasters and without the rows that belong to one tile.

    Raises
    ------
    NodataError
        When no tile has points or heights.
    """
    sums = _Sums()
    told = set(notices.kept)
    for found in results:
        # What counts points of one tile would be told for each; a tile that is built again says the same twice.
        told.update(each for each in found.about["notices"] if not any(letter.isdigit() for letter in each))
        if not found.is_empty:
            sums.add(found)
    notices.kept[:] = sorted(told)
    if sums.survey is None:
        what = "points" if cells is None else "heights"
        msg = f"No tile of '{job.label.name}' has {what} on its ground. Check the area and the CRS."
        raise NodataError(msg)
    low, high = np.min(sums.reach, axis=0), np.max(sums.reach, axis=0)
    spec = cells or lattice((low[0], low[1], high[2], high[3]), plan.cell_m, CRS.from_user_input(plan.crs))
    survey = Survey(**{**sums.survey, "bounds": spec.bounds, "sources": job.inputs.sources()})
    if sums.cut:
        words = f"{counted(sums.cut, 'island')} of roofs reach more than {most_m - GUARD_M:g} m beyond their tile"
        notices.kept.append(f"{words}, and may be cut there. Give larger tiles.")
    seen, differ = sums.compared()
    if differ:
        notices.kept.append(
            f"Neighbouring tiles see {differ} of {seen} cells along their borders differently "
            f"({100 * differ / seen:.2f} %), as building or not."
        )
    rejected = sums.rejected()
    regions: dict[str, dict[str, dict[str, int]]] = {}
    names = (rejected[name].tolist() for name in ("method", "stage", "regions"))
    for method, stage, count in zip(*names, strict=True):
        own = regions.setdefault(str(method), {}).setdefault(str(stage), {"dropped": 0})
        own["dropped"] += int(count)
    counts = Counts(
        regions=regions,
        cells={**sums.cells, "all": spec.shape[0] * spec.shape[1]},
        cover=sums.cover,
        stated=job.inputs.stated(),
        chosen=sums.chosen,
    )
    run = record_run(job, counts, timings, notices)
    frames = {**sums.whole, "spectral_class": sums.classes(), "rejection_count": rejected}
    empty = np.zeros((1, 1), dtype=np.uint8)
    return KeptRun(survey, run, frames, Rasters(empty.astype(np.int32), empty > 0, empty), plan)


class _Sums:
    """The totals of all tiles."""

    def __init__(self) -> None:
        self.survey: dict[str, Any] | None = None
        self.reach: list[list[float]] = []
        self.cut = 0
        self.cells: dict[str, int] = {}
        self.cover: dict[str, int] = {}
        self.chosen: dict[str, Any] = {}
        self.whole: dict[str, pd.DataFrame] = {}
        self._classes: list[pd.DataFrame] = []
        self._rejected: list[pd.DataFrame] = []
        self._near: dict[tuple[int, int], tuple[Place, Place, NDArray[Any]]] = {}

    def add(self, found: Result) -> None:
        """Add a tile; of what is the same in all, the first one counts."""
        about = found.about
        frames = found.frames("scale", "spectral_class", "spectral_class_band", "rejection_count")
        if self.survey is None:
            self.survey, self.cover, self.chosen = about["survey"], about["cover"], about["chosen"]
            self.whole = {name: frames[name] for name in ("scale", "spectral_class_band")}
        self.reach.append(about["reach"])
        self.cut += about["cut"]
        for label, count in about["cells"].items():
            self.cells[label] = self.cells.get(label, 0) + count
        self._classes.append(frames["spectral_class"])
        self._rejected.append(frames["rejection_count"])
        if about["near"]:
            self._near[found.key] = tuple(about["near"]), (*about["origin"], *about["own"]), found.array("near")

    def classes(self) -> pd.DataFrame:
        """Return the classes with the cells of all tiles; means of structural ones are weighed by cells."""
        every = pd.concat(self._classes, ignore_index=True)
        first = self._classes[0]
        by_class = every.groupby("speindex")
        cells = by_class["cells"].sum().reindex(first["speindex"]).to_numpy()
        table = first.assign(cells=cells)
        for name in ("roughness_m", "height_m"):
            weighed = (every[name] * every["cells"]).fillna(0.0).groupby(every["speindex"]).sum()
            found = weighed.reindex(first["speindex"]).to_numpy() / np.maximum(cells, 1)
            if name == "roughness_m":
                found = np.where(cells > 0, found, np.nan)
            table[name] = np.where(table["source"] == "structure", found, table[name])
        totals = table.groupby("source")["cells"].transform("sum")
        return SPECTRAL_CLASS.typed(table.assign(share=cells / np.maximum(totals, 1)))

    def rejected(self) -> pd.DataFrame:
        """Return the numbers of the ledger over all tiles."""
        sums = ["regions", "area_m2", "small", "small_m2"]
        every = pd.concat(self._rejected, ignore_index=True)
        found = every.groupby(["method", "stage", "reason"], as_index=False)[sums].sum()
        return REJECTION_COUNT.typed(found.assign(number=found.groupby("method").cumcount() + 1))

    def compared(self) -> tuple[int, int]:
        """Count the cells that tiles see on ground of others, and those that only one of both takes for building."""
        seen = differ = 0
        for key, (near, _, bits) in self._near.items():
            mask = _unpacked(near, bits)
            for row in (-1, 0, 1):
                for column in (-1, 0, 1):
                    other = self._near.get((key[0] + row, key[1] + column))
                    if (row or column) and other is not None:
                        its_near, its_own, its_bits = other
                        one = _cut_out(mask, near, its_own)
                        two = _cut_out(_unpacked(its_near, its_bits), its_near, _shared(near, its_own))
                        seen += one.size
                        differ += int(np.count_nonzero(one != two))
        return seen, differ


def _unpacked(place: Place, bits: NDArray[Any]) -> NDArray[Any]:
    """Return the cells of a place from their bits."""
    return np.unpackbits(bits, count=place[2] * place[3]).reshape(place[2], place[3])


def _shared(one: Place, other: Place) -> Place:
    """Return the place that two places have in common, without cells where they have nothing in common."""
    top, left = max(one[0], other[0]), max(one[1], other[1])
    bottom, right = min(one[0] + one[2], other[0] + other[2]), min(one[1] + one[3], other[1] + other[3])
    return (top, left, max(bottom - top, 0), max(right - left, 0))


def _cut_out(cells: NDArray[Any], place: Place, within: Place) -> NDArray[Any]:
    """Return the cells that lie within another place."""
    top, left, rows, columns = _shared(place, within)
    return cells[top - place[0] : top - place[0] + rows, left - place[1] : left - place[1] + columns]
