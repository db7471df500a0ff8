"""What one worker does for one tile: paths and keys come in, the result goes to its place, a summary comes out."""

import logging
import os
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import geopandas as gpd
from pyproj import CRS

from msbdb.database import TileStatus, note_result
from msbdb.errors import NodataError, collected_notices
from msbdb.grid import Bounds
from msbdb.io.vector import Area
from msbdb.run.compose import Detected, Job, counts_of, find_regions, fuse_and_decompose
from msbdb.run.preparation.prepare import Window
from msbdb.run.reports import Stages
from msbdb.scale.tileresults import Found, packed
from msbdb.scale.tiling import Tile, cut_islands
from msbdb.surveyplan import Plan
from msbdb.threads import alone_on, memory_reused

logger = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, eq=False)
class TileTask:
    """One tile of a survey, for a worker.

    Parameters
    ----------
    tile : Tile
        Which.
    job : Job
        What to do; its files are those that the tile may need.
    plan : Plan
        The plan of the survey.
    survey : tuple of float
        West, south, east and north of the whole survey by the headers, metres.
    halos_m : tuple of float
        How far the tile sees beyond its own ground, metres: at first, where islands of roofs need it, and where a
        single building does.
    status : TileStatus
        As it is queued.
    place : str
        A folder for the result, or the URL of a server that keeps it.
    build : str
        Digest of the build that it belongs to.
    cores : int, optional
        Cores of the machine that are the worker's; by default all.
    """

    tile: Tile
    job: Job
    plan: Plan
    survey: Bounds
    halos_m: tuple[float, float, float]
    status: TileStatus
    place: str
    build: str
    cores: int | None = None

    @property
    def is_file(self) -> bool:
        """Whether the result is a file."""
        return "://" not in self.place


Outcome = tuple[TileTask, TileStatus | None, str]
"""A task, the status of its tile, and why there is none."""


def work(task: TileTask) -> TileStatus:
    """Build a tile, and put its result in its place; a repetition puts the same there.

    A worker with several threads builds one tile at a time, which all of them share: memory is bounded by the tile.

    Raises
    ------
    MsbdbError
        When the files or the database cannot be used.
    """
    begin = time.perf_counter()
    found, reason, cut = None, "", 0
    halo_m, wide_m, long_m = task.halos_m
    with alone_on(task.cores), collected_notices() as notices, memory_reused(bounded=True):
        while True:
            try:
                seen = _in_window(task, halo_m)
            except NodataError as error:
                reason = str(error)
                break
            decomposed = fuse_and_decompose(seen.scene, seen.regions, seen.params, Stages(None))
            # Now it is known whether the window holds its islands of roofs whole; no outlines are made of a narrow one.
            window = task.tile.window(halo_m)
            spec = seen.scene.heights.spec
            cut = cut_islands(task.tile, decomposed.roofs, spec, window, task.survey)
            enough_m = wide_m
            if cut and halo_m >= wide_m and cut_islands(task.tile, decomposed.houses, spec, window, task.survey):
                enough_m = long_m
            if not cut or halo_m >= enough_m:
                made = decomposed.described(Stages(None))
                found = Found(seen, made, counts_of(seen, made, task.job))
                break
            del seen, decomposed
            # At once as far as it may: how far a cut island goes on is not known, and each step is a whole build.
            halo_m = enough_m
            logger.info("Tile %s: %d islands reach beyond its window; it sees %g m now", task.tile, cut, halo_m)
    least_m2 = task.job.params.fuse.piece_m2
    content = packed(task.tile, found, halo_m=halo_m, cut=cut, least_m2=least_m2, notices=notices)
    status = replace(
        task.status,
        state="done",
        points=0 if found is None else found.window.points,
        halo_m=halo_m,
        seconds=round(time.perf_counter() - begin, 3),
        reason=reason,
    )
    if task.is_file:
        put_file(result_file(task.place, task.tile), content)
    else:
        note_result(task.place, status, content, task.build)
    return status


def result_file(folder: str, tile: Tile) -> Path:
    """Return the file of a tile's result."""
    return Path(folder) / f"{tile.row}_{tile.column}.zip"


def put_file(path: Path, content: bytes) -> None:
    """Write a file completely or not at all."""
    growing = path.with_name(f".{path.name}.{os.getpid()}.partial")
    try:
        growing.write_bytes(content)
        growing.replace(path)
    finally:
        growing.unlink(missing_ok=True)


def _in_window(task: TileTask, halo_m: float) -> Detected:
    """Return what the detectors find in the tile and its halo."""
    bounds = task.tile.window(halo_m)
    crs = CRS.from_user_input(task.plan.crs)
    area = Area.of_box(bounds, crs)
    interest = task.job.inputs.area()
    if interest is not None:
        shape = interest.shape_in(crs).intersection(area.shape_in(crs))
        if shape.is_empty:
            msg = f"The tile {task.tile} has no ground in {interest.what}."
            raise NodataError(msg)
        area = Area(gpd.GeoSeries([shape], crs=crs), 0.0, f"{interest.what}, in the tile {task.tile}")
    return find_regions(task.job, task.plan, Stages(None), Window(area, task.tile.bounds, bounds))


def one_by_one(tasks: Sequence[TileTask], begin: Callable[[TileTask], None]) -> Iterator[Outcome]:
    """Build tiles in this process, and yield what became of each: without a cluster."""
    for task in tasks:
        begin(task)
        try:
            yield task, work(task), ""
        except Exception as error:  # the others are built all the same
            logger.info("The tile %s failed", task.tile, exc_info=True)
            yield task, None, f"{type(error).__name__}: {error}"
