"""A build in tiles: the plan first, then every tile by itself, then one run of all of them in the database."""

import hashlib
import shutil
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from msbdb.database import (
    BuildBasis,
    Engine,
    MergeReport,
    OutdatedError,
    Piece,
    TileStatus,
    begin_tiles,
    merge_tiles,
    note_tile,
    open_database,
    read_result,
    read_tables,
    read_value_counts,
    shown,
    summarise_run,
    tiles_with_results,
)
from msbdb.database.dialects.dialect import database_url
from msbdb.errors import DatabaseError, InputError, TilesError, counted
from msbdb.grid import Bounds, GridSpec
from msbdb.identity import plain, to_json
from msbdb.io.lasheader import read_las_header
from msbdb.params import as_dict
from msbdb.run.compose import Job
from msbdb.run.preparation.planning import make_plan
from msbdb.run.reports import BuildReport, Notices, Stages, collect_notices
from msbdb.run.store import OVERVIEW, overview_of, refused_areas
from msbdb.scale.tileresults import Result
from msbdb.scale.tilesums import sum_up_tiles
from msbdb.scale.tilework import Outcome, TileTask, one_by_one, result_file
from msbdb.scale.tiling import HALO_M, Tile, over_cells, side_for, tiles_over
from msbdb.surveyplan import Plan
from msbdb.tables import BUILDING, Reason
from msbdb.threads import cores
from msbdb.version import __version__

MOST_HALO_M = 250.0
"""Ours: a tile sees at most so far beyond; a larger block of houses is cut, and counted."""

LONG = 2.0
"""Ours: it sees so many times as far where a single building needs it, as halls of 500 m do."""

NO_POINTS = ("No point", "The tile")
"""How the reasons of tiles begin that lie beside the points or the area of interest."""

FOLDER = ".tiles"
"""What the name of a file of SpatiaLite gets for the folder of its tiles' results, in which each build has its own."""

Runner = Callable[[Sequence[TileTask], Callable[[TileTask], None]], Iterable[Outcome]]
"""Builds tiles, and yields what became of each; calls its second argument when one begins."""


@dataclass(frozen=True, slots=True, eq=False)
class TiledBuild:
    """A build in tiles, as it is decided before the first of them.

    Parameters
    ----------
    job : Job
        What to do, with the sources of all files.
    plan : Plan
        The plan of the survey.
    target : str
        The database.
    tiles : tuple of Tile
        All tiles, in order.
    boxes : tuple of tuple of float
        West, south, east and north of each point file, or of the rasters of heights, metres.
    build : str
        Digest of all that decides the result.
    cells : GridSpec, optional
        The lattice of rasters of heights.
    """

    job: Job
    plan: Plan
    target: str
    tiles: tuple[Tile, ...]
    boxes: tuple[Bounds, ...]
    build: str
    cells: GridSpec | None = None

    @classmethod
    def of(cls, job: Job, target: str, side_m: float | None, stages: Stages) -> "TiledBuild":
        """Make the plan of a survey where none is given, and cut the survey; without a side by its density.

        Raises
        ------
        InputError, ParameterError
            For what cannot be built in tiles, and for tiles that are too small.
        """
        extent = job.inputs.extent()
        # In which CRS a tile is read follows from the centre of all files, not from that of its own.
        inputs = replace(job.inputs, known=job.inputs.sources(), bounds=None if extent is None else extent.bounds)
        job = replace(job, inputs=inputs)
        cells, boxes = inputs.cells(), _boxes(job)
        plan = make_plan(inputs, job.params, stages) if job.plan is None else job.plan
        interest = inputs.area()
        side_m = side_m or side_for(0.0 if plan.points is None else plan.points.all_density, plan.cell_m)
        within = None if interest is None else interest.shape_in(plan_crs(plan))
        tiles = tiles_over(boxes, side_m, within) if cells is None else over_cells(cells, side_m, within)
        words = {
            "sources": sorted((source.role, source.sha256) for source in inputs.sources()),
            "stated": inputs.stated(),
            "values": as_dict(job.params),
            "build": [job.profile, job.label.name, job.label.date, list(job.methods), __version__],
            "plan": plan.as_dict(),
            "tiles": [side_m, HALO_M, MOST_HALO_M, LONG],
        }
        build = hashlib.sha256(to_json(plain(words)).encode()).hexdigest()
        return cls(job, plan, target, tiles, boxes, build, cells)

    @property
    def name(self) -> str:
        """Name of the survey."""
        return self.job.label.name

    @property
    def survey(self) -> Bounds:
        """What the files cover together, metres."""
        west, south, east, north = np.array(self.boxes).T
        return (float(west.min()), float(south.min()), float(east.max()), float(north.max()))

    @property
    def place(self) -> str:
        """Where the results wait: a folder of this build beside the file, or the server."""
        url = database_url(self.target)
        return f"{url.database}{FOLDER}/{self.build[:16]}" if url.get_backend_name() == "sqlite" else self.target

    @property
    def is_file(self) -> bool:
        """Whether they are files."""
        return self.place != self.target

    def queued(self, tile: Tile) -> TileStatus:
        """Return the row of a tile that waits."""
        return TileStatus(self.name, tile.row, tile.column, *tile.bounds)

    def task(self, tile: Tile) -> TileTask:
        """Return what a worker needs for a tile: of the files those that its widest window meets."""
        west, south, east, north = tile.window(LONG * MOST_HALO_M)
        inputs = self.job.inputs
        near = tuple(
            path
            for path, box in zip(inputs.points, self.boxes, strict=self.cells is None)
            if box[0] <= east and box[2] >= west and box[1] <= north and box[3] >= south
        )
        job = replace(self.job, inputs=replace(inputs, points=near), plan=self.plan)
        halos_m, status = (HALO_M, MOST_HALO_M, LONG * MOST_HALO_M), self.queued(tile)
        return TileTask(tile, job, self.plan, self.survey, halos_m, status, self.place, self.build)

    def results(self, engine: Engine) -> Iterator[Result]:
        """Yield the results of all tiles in order, one in memory at a time."""
        for tile in self.tiles:
            content = self.content(tile, engine)
            if content is None:
                msg = f"The result of the tile {tile} of '{self.name}' is gone. Repeat the command with --resume."
                raise DatabaseError(msg)
            yield Result.of((tile.row, tile.column), content)

    def held(self, engine: Engine) -> Iterator[Result]:
        """Yield the results that have points or heights."""
        return (found for found in self.results(engine) if not found.is_empty)

    def content(self, tile: Tile, engine: Engine) -> bytes | None:
        """Return the result of a tile; None if it has no result yet."""
        if not self.is_file:
            return read_result(engine, self.name, (tile.row, tile.column))
        path = result_file(self.place, tile)
        return path.read_bytes() if path.exists() else None

    def with_results(self, engine: Engine) -> set[Tile]:
        """Return the tiles whose results wait."""
        if self.is_file:
            return {tile for tile in self.tiles if result_file(self.place, tile).exists()}
        there = tiles_with_results(engine, self.name)
        return {tile for tile in self.tiles if (tile.row, tile.column) in there}

    def clear(self) -> None:
        """Take the files of results away, once they are merged."""
        if self.is_file:
            # Also what a worker that was killed began to write.
            shutil.rmtree(self.place, ignore_errors=True)
            with suppress(OSError):
                Path(self.place).parent.rmdir()


def plan_crs(plan: Plan) -> Any:  # noqa: ANN401  (pyproj loads late)
    """Return the CRS of a plan."""
    from pyproj import CRS

    return CRS.from_user_input(plan.crs)


def _boxes(job: Job) -> tuple[Bounds, ...]:
    """Return the box of each point file, or of the rasters of heights, metres; refuse what cannot be cut."""
    inputs = job.inputs
    if job.denoising_figure is not None:
        msg = "A build in tiles does not take a picture of the denoising. Leave --tile out, or the picture."
        raise InputError(msg)
    cells = inputs.cells()
    if cells is not None:
        return (cells.bounds,)
    how = inputs.reference_of_points()
    if how is None:
        msg = (
            "A build in tiles needs the bounds of each point file, and some header is wrong or in another CRS than the "
            "others. Write the files again, for instance with 'pdal translate' and filters.reprojection."
        )
        raise InputError(msg)
    return tuple(how.box_in_metres(read_las_header(path).bounds) for path in inputs.points)


def build_with(
    job: Job,
    target: str,
    side_m: float | None,
    stages: Stages,
    notices: Notices,
    *,
    basis: BuildBasis,
    resume: bool,
    workers: int | None,
    scheduler: str | None,
) -> BuildReport:
    """Build a survey in tiles, one by one in this process, or by a cluster; see `build_tiles` and `cluster_of`."""
    if workers is None and scheduler is None:
        return build_tiles(job, target, side_m, stages, notices, runner=one_by_one, resume=resume, basis=basis)
    from msbdb.scale.cluster import beginning, cluster_of, work_on

    # Workers of this machine share its cores. They start while the plan is made, and end while the tiles are merged.
    share = None if scheduler or not workers else cores() // workers
    with beginning(cluster_of(workers, scheduler), aside=scheduler is None) as crew:

        def runner(tasks: Sequence[TileTask], begin: Callable[[TileTask], None]) -> Iterator[Outcome]:
            if tasks:
                yield from work_on(crew.client(), tasks, begin, share)
            crew.dismiss()

        return build_tiles(job, target, side_m, stages, notices, runner=runner, resume=resume, basis=basis)


def build_tiles(
    job: Job,
    target: str,
    side_m: float | None,
    stages: Stages,
    notices: Notices,
    *,
    runner: Runner,
    resume: bool,
    basis: BuildBasis,
) -> BuildReport:
    """Build a survey in tiles, and write it as one run.

    Parameters
    ----------
    job : Job
        What to do.
    target : str
        Path or URL of the database.
    side_m : float, optional
        Side of a tile, metres; by default that of `msbdb.scale.tiling.side_for`.
    stages : Stages
        For timings and progress.
    notices : Notices
        Receives the notices.
    runner : Runner
        Builds the tiles: `one_by_one`, or a cluster.
    resume : bool
        Repeat only the tiles that an interrupted build of the same did not finish.
    basis : BuildBasis
        What may be replaced.

    Raises
    ------
    TilesError
        When tiles failed. The others are done; the survey is written when all are.
    MsbdbError
        As `msbdb.run.store.store_survey`.
    """
    if basis.labelled is not None and len(basis.labelled) and not basis.replace:
        msg = (
            f"An operator labelled classes of the survey '{job.label.name}', and a build in tiles would lose the "
            "labels. Build it without --tile, or give the labels up by --replace."
        )
        raise InputError(msg)
    with collect_notices(notices):
        build = TiledBuild.of(job, target, side_m, stages)
    epsg, wkt = plan_crs(build.plan).to_epsg() or 0, plan_crs(build.plan).to_wkt()
    if build.is_file:
        Path(build.place).mkdir(parents=True, exist_ok=True)
    rows = [build.queued(tile) for tile in build.tiles]
    begun = begin_tiles(target, rows, build.build, epsg=epsg, crs_wkt=wkt, resume=resume)
    engine = open_database(target)
    try:
        there = build.with_results(engine)
        done = [tile for tile, status in zip(build.tiles, begun, strict=True) if status.state == "done"]
        merged = MergeReport("unchanged")
        # The results go when they are merged.
        if len(done) < len(build.tiles) or there:
            with stages.stage("tiles"):
                waiting = [tile for tile in build.tiles if tile not in done or tile not in there]
                _run(build, waiting, runner, stages)
            with stages.stage("write"):
                merged = _merge(build, engine, stages, notices, basis)
        build.clear()
        return _report(engine, build, merged, stages, notices)
    finally:
        engine.dispose()


def _run(build: TiledBuild, waiting: Sequence[Tile], runner: Runner, stages: Stages) -> None:
    """Build the tiles that are not done, and keep how far each is."""
    tasks = [build.task(tile) for tile in waiting]
    failed: list[tuple[Tile, str]] = []

    def begin(task: TileTask) -> None:
        note_tile(build.target, replace(task.status, state="running"))

    done = len(build.tiles) - len(waiting)
    for ended, (task, status, reason) in enumerate(runner(tasks, begin), start=done + 1):
        if status is None:
            failed.append((task.tile, reason))
            note_tile(build.target, replace(task.status, state="failed", reason=reason))
        elif build.is_file:
            note_tile(build.target, status)
        if stages.progress is not None:
            stages.progress("tiles", ended, len(build.tiles))
    if failed:
        tile, reason = min(failed)
        msg = (
            f"{counted(len(failed), 'tile')} of {len(build.tiles)} of '{build.name}' failed, the first at {tile}: "
            f"{reason} The others are done, and wait. 'msbdb tiles {shown(database_url(build.target))}' shows all. "
            "Remove the cause, and repeat the command with --resume."
        )
        raise TilesError(msg)


def _merge(build: TiledBuild, engine: Engine, stages: Stages, notices: Notices, basis: BuildBasis) -> MergeReport:
    """Write the run from the results of all tiles."""
    head = sum_up_tiles(
        build.results(engine),
        build.job,
        build.plan,
        timings=stages.timings,
        notices=notices,
        most_m=MOST_HALO_M,
        cells=build.cells,
    )
    coming: dict[str, int] = {}
    for found in build.held(engine):
        for name, count in found.about["rows"].items():
            coming[name] = coming.get(name, 0) + count

    def pieces(names: tuple[str, ...], *, rasters: bool) -> Iterator[Piece]:
        return (found.piece(names, rasters=rasters) for found in build.held(engine))

    try:
        return merge_tiles(build.target, head, pieces, coming=coming, basis=basis)
    except OutdatedError as error:
        msg = (
            f"An operator labelled classes of the survey '{build.name}' while it was built. The database is "
            "unchanged. Build it without --tile, or give the labels up by --replace."
        )
        raise DatabaseError(msg) from error


def _report(engine: Engine, build: TiledBuild, merged: MergeReport, stages: Stages, notices: Notices) -> BuildReport:
    """Sum up the run as the database has it."""
    name = build.name
    found = summarise_run(engine, name)
    buildings = read_tables(engine, (BUILDING.narrowed(*OVERVIEW),), name)["building"]
    cells = read_value_counts(engine, name, "reason", len(Reason))
    if merged.twice:
        words = f"{counted(merged.twice, 'row')} of two tiles are about the same place, and were left out"
        notices.passing.append(f"{words}. Of buildings the larger one is kept.")
    if merged.unlinked:
        notices.passing.append(f"{counted(merged.unlinked, 'link')} to what a neighbouring tile sees otherwise went.")
    return BuildReport(
        survey=name,
        buildings=found.rows["building"],
        parts=found.rows["part"],
        flat_regions=found.rows["flat_region"],
        candidate_regions=found.candidates,
        rejected=found.rejected,
        notices=(*found.run.notices, *notices.passing),
        timings=stages.rounded(),
        changed=merged.status != "unchanged",
        database=shown(engine.url),
        overview=overview_of(buildings, refused_areas(cells, build.plan.cell_m**2), found.rejected_rows),
    )
