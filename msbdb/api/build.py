"""Build a database from survey files, label its classes, and classify the points of a file."""

import dataclasses
from collections.abc import Mapping, Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING

from msbdb.params import DETECTORS, Params, as_dict, choose_detectors
from msbdb.params import profile as named_profile
from msbdb.run.reports import BuildReport, ClassifyReport, Notices, Progress, Stages

if TYPE_CHECKING:
    import pandas as pd

    from msbdb.database import TileStatus
    from msbdb.surveyplan import Plan

File = str | Path

Files = File | Sequence[File]
"""One file, or several."""


def build(
    points: Files = (),
    *,
    ortho: Files = (),
    dsm: File | None = None,
    dtm: File | None = None,
    ndsm: File | None = None,
    parcels: File | None = None,
    aoi: File | None = None,
    db: str | Path,
    survey: str | None = None,
    date: str | None = None,
    crs: str | None = None,
    ortho_crs: str | None = None,
    z_unit: str = "auto",
    params: Params | None = None,
    profile: str = "default",
    extract: str | Sequence[str] = DETECTORS,
    denoising_figure: Path | None = None,
    replace: bool = False,
    skip_bad: bool = False,
    plan: "Plan | str | Path | None" = None,
    tile: float | None = None,
    workers: int | None = None,
    scheduler: str | None = None,
    resume: bool = False,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> BuildReport:
    """Build or extend a database of buildings from one survey.

    Parameters
    ----------
    points : path or sequence of path
        LAS, LAZ or COPC files, with or without ``dtm``; or give ``dsm`` with ``dtm``, or ``ndsm``, as GeoTIFF. A
        folder, a pattern such as ``tiles/*.laz``, a virtual point cloud (``.vpc``), or a tile index with a column
        ``location`` or ``url`` stands for its files. COPC files may be at http and https URLs.
    ortho : path or sequence of path
        Orthophotos of any bands, each on its own grid and CRS. Without them the points' colours serve.
    dsm, dtm, ndsm : path, optional
        Rasters of heights. With points, ``dtm`` is the ground, and none is detected.
    parcels : path, optional
        Polygons of any vector format and CRS that divide touching houses: parcels, cadastre or footprints.
    aoi : path, optional
        Polygons of any vector format and CRS: only what lies in them is built. A cell is inside where its centre is.
        Points up to 50 m beyond are read, because they help to find the ground.
    db : str or path
        A SpatiaLite file, made when it is missing, or a ``postgresql+psycopg://`` URL.
    survey : str, optional
        Name of the survey; by default that of the file, or of the folder of several files, with the folder's around it
        where it is one like 'points'.
        Building the same files again with other values replaces the survey, with a notice.
    date : str, optional
        When the data were taken, ISO 8601.
    crs : str, optional
        CRS of point files and rasters of heights that state none; by default that of a database that exists, with a
        notice.
    ortho_crs : str, optional
        CRS of orthophotos that state none; by default as for ``crs``.
    z_unit : str
        Unit of the heights: ``auto``, ``m``, ``ft`` or ``us-ft``.
    params : Params, optional
        Parameters; the profile's by default.
    profile : str
        Name of the profile that the parameters come from.
    extract : str or sequence of str
        The detectors: ``multiscale`` finds buildings as trees of parts, ``flatregions`` finds flat regions, ``area3d``
        and ``adaptive`` find candidate regions among the points. The last three are evidence for the buildings.
    denoising_figure : path, optional
        PNG of the surface before and after the denoising for the flat regions.
    replace : bool
        Replace a survey of this name also where it is of other files or of another place, or where it has results of
        detectors that ``extract`` lacks.
    skip_bad : bool
        Leave out point files that cannot be read, have no points or another CRS than most, or the points of another
        file, with a notice. Otherwise they are an error, which names all of them.
    plan : Plan or path or str, optional
        The plan of a larger survey that this one is a part of, or of an earlier one of the place. It is what
        `msbdb.plan` returns, its JSON file, or a database whose survey has one. By default the survey makes its own.
    tile : float, optional
        Build in square tiles of this side, metres: a tile is in memory at a time, whatever the area (docs/scale.md).
        By default in one piece; with ``workers``, ``scheduler`` or ``resume`` in tiles for 2 GiB of memory each.
    workers : int, optional
        Build the tiles by so many processes of this machine; needs ``msbdb[cluster]``.
    scheduler : str, optional
        Build the tiles by the workers of a scheduler of dask.distributed: its address, or its JSON file.
    resume : bool
        Repeat only the tiles that an interrupted build of the same files and values did not finish.
    overwrite : bool
        Replace the figure if it exists.
    progress : callable, optional
        Called with stage, steps done and steps in all.

    Returns
    -------
    BuildReport

    Raises
    ------
    MsbdbError
        One of its kinds, when the inputs or the database cannot be used, or when what is there may not be replaced. The
        database is then unchanged.
    """
    from msbdb.database import check_target, read_fallback, read_labelled_classes
    from msbdb.io.crs import parse_crs
    from msbdb.io.files import PICTURES, require_output
    from msbdb.run.inputs import Inputs
    from msbdb.run.reports import collect_notices
    from msbdb.threads import memory_reused

    values = params or named_profile(profile)
    known = read_plan(plan) if isinstance(plan, str | Path) else plan
    if known is not None:
        known.require_basis(as_dict(values))
    heights = {"dsm": dsm, "dtm": dtm, "ndsm": ndsm}
    stated = {"crs": crs, "ortho_crs": ortho_crs, "z_unit": z_unit}
    notices, stages = Notices(), Stages(progress)
    with collect_notices(notices):
        inputs = Inputs.of(points, ortho, **heights, **stated, parcels=parcels, aoi=aoi, skip_bad=skip_bad)
    if denoising_figure is not None:
        sources = [db, *(path for path, _ in inputs.files())]
        require_output(denoising_figure, overwrite=overwrite, endings=PICTURES, sources=sources)
    methods = choose_detectors(extract)
    inputs.require_files()
    check_target(db)
    target = None if known is None else parse_crs(known.crs)
    inputs = dataclasses.replace(inputs, fallback=read_fallback(db), target=target)
    inputs.require_one_place()
    tiled = tile is not None or workers is not None or scheduler is not None or resume
    with nullcontext() if tiled else memory_reused(ahead=inputs.bytes_to_build()):
        from msbdb.run.compose import Job, run_survey
        from msbdb.run.preparation.prepare import Label
        from msbdb.run.store import replaced, report_of, require_replaceable, store_survey

        label = Label(survey or inputs.default_survey(), date or "")
        former = require_replaceable(db, label.name, inputs, methods, replace=replace)
        labelled = read_labelled_classes(db, label.name)
        label = dataclasses.replace(label, classes=labelled)
        job = Job(inputs, values, profile, label, methods, denoising_figure, known)
        if tiled:
            from msbdb.database import BuildBasis
            from msbdb.scale.tiledbuild import build_with

            basis = BuildBasis(labelled=labelled, replace=replace)
            return build_with(
                job, str(db), tile, stages, notices, basis=basis, resume=resume, workers=workers, scheduler=scheduler
            )
        kept = run_survey(job, stages, notices)
        with stages.stage("write"):
            changed = store_survey(kept, db, labelled, replace=replace)
    passing = (*notices.passing, *(replaced(former, kept) if changed else ()))
    return report_of(kept, stages, db, changed=changed, passing=passing)


def plan(
    points: Files = (),
    *,
    ortho: Files = (),
    dsm: File | None = None,
    dtm: File | None = None,
    ndsm: File | None = None,
    aoi: File | None = None,
    crs: str | None = None,
    ortho_crs: str | None = None,
    z_unit: str = "auto",
    params: Params | None = None,
    profile: str = "default",
    skip_bad: bool = False,
    progress: Progress | None = None,
) -> "Plan":
    """Make the plan of a survey: all values that a tile of it cannot know by itself.

    These are the size of the cells, the spacing of the points, and which of their attributes hold information. The
    scales, thresholds that come from histograms and the classes of colours belong to them too (docs/plan.md).

    Parameters
    ----------
    points, ortho, dsm, dtm, ndsm, aoi, crs, ortho_crs, z_unit, params, profile, skip_bad, progress
        As for `build`.

    Returns
    -------
    Plan
        With ``as_json`` for a file, and ``pairs`` for people. A build of the same files makes and keeps the same.

    Raises
    ------
    MsbdbError
        One of its kinds, when the inputs cannot be used.
    """
    from msbdb.run.inputs import Inputs
    from msbdb.run.preparation.planning import make_plan
    from msbdb.run.reports import collect_notices
    from msbdb.threads import memory_reused

    heights = {"dsm": dsm, "dtm": dtm, "ndsm": ndsm}
    with collect_notices(Notices()), memory_reused():
        stated = {"crs": crs, "ortho_crs": ortho_crs, "z_unit": z_unit}
        inputs = Inputs.of(points, ortho, **heights, **stated, aoi=aoi, skip_bad=skip_bad)
        inputs.require_files()
        inputs.require_one_place()
        return make_plan(inputs, params or named_profile(profile), Stages(progress))


def read_plan(source: File, survey: str | None = None) -> "Plan":
    """Return the plan in a JSON file, or the one by which a survey in a database was built.

    Parameters
    ----------
    source : path or str
        A file whose name ends in ``.json``, or a database.
    survey : str, optional
        Name of the survey, where the database has several.

    Raises
    ------
    FileError, InputError
        When there is no plan, or several.
    """
    from msbdb.database import opened, shown
    from msbdb.database import read_plan as of_survey
    from msbdb.errors import FileError, InputError
    from msbdb.surveyplan import Plan

    if str(source).lower().endswith(".json"):
        try:
            text = Path(source).read_text(encoding="utf-8")
        except (OSError, UnicodeDecodeError) as error:
            msg = f"The plan {source} cannot be read: {error}. Write one by 'msbdb plan ... --json'."
            raise FileError(msg) from error
        return Plan.from_json(text)
    with opened(source) as engine:
        found = of_survey(engine, survey)
        if found is None:
            msg = f"The survey in {shown(engine.url)} has no plan: an older msbdb built it. Build the survey again."
            raise InputError(msg)
        return found


def tiles(db: str | Path, survey: str | None = None) -> "list[TileStatus]":
    """Return how far the tiles of a survey are, or those of all surveys that are built in tiles; in order.

    Each has its place, its state (queued, running, done or failed), points, seconds and the reason of a failure.
    """
    from msbdb.database import opened, read_tile_status

    with opened(db) as engine:
        return read_tile_status(engine, survey)


def classes(db: str | Path, survey: str | None = None) -> "pd.DataFrame":
    """Return the land-cover classes of a survey with their statistics."""
    from msbdb.database import opened, read_classes

    with opened(db) as engine:
        return read_classes(engine, survey)


def relabel(
    db: str | Path, labels: Mapping[int, str], *, survey: str | None = None, progress: Progress | None = None
) -> BuildReport:
    """Give classes the operator's labels (V36), and repeat the build from there on.

    The source data are not needed: the heights and class maps of the run are in the database. Labels that others give
    to the same survey at the same time are kept.

    Raises
    ------
    InputError
        When a class, a label or the survey does not exist.
    DatabaseError
        When the database cannot be written, or the survey was built again meanwhile, so that its classes changed.
    """
    from msbdb.run.store import relabel_survey

    return relabel_survey(db, labels, survey=survey, progress=progress)


def classify(
    source: File,
    out: File,
    *,
    extract: str | Sequence[str] = DETECTORS,
    crs: str | None = None,
    ortho: Files = (),
    dtm: File | None = None,
    ortho_crs: str | None = None,
    z_unit: str = "auto",
    params: Params | None = None,
    profile: str = "default",
    ground: bool = False,
    keep: bool = False,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> ClassifyReport:
    """Detect the buildings among the points of a file, and write a copy with these points in class 6.

    Parameters
    ----------
    source : path
        LAS, LAZ or COPC.
    out : path
        LAS or LAZ, by its ending; everything but the classes is as in the source.
    extract : str or sequence of str
        The detectors; all by default. Three or more with ``multiscale`` decide together, as in a build: the points in
        the cells of buildings count, and those of the regions of ``area3d`` that lie in buildings. Of others, a point
        that any of them finds is a building. ``area3d`` and ``adaptive`` find points. Of ``multiscale`` and
        ``flatregions``, the points in the cells of a part or flat region count. In cells, points must be at least
        ``surface.mask_m`` above ground.
    crs, ortho_crs : str, optional
        CRS of points and orthophotos that state none.
    ortho : path or sequence of path
        Orthophotos of any bands, each on its own grid and CRS. Without them the points' colours serve.
    dtm : path, optional
        Raster of the ground's heights; without it the ground is detected among the points.
    z_unit : str
        Unit of the heights: ``auto``, ``m``, ``ft`` or ``us-ft``.
    params : Params, optional
        Parameters; the profile's by default.
    profile : str
        Name of the profile that the parameters come from.
    ground : bool
        Put the points of the ground in class 2: those within ``ground.height_m`` of the terrain that are no building.
    keep : bool
        Keep the points of class 6 of the source in class 6, found or not; otherwise they become unclassified (1). With
        ``ground`` this holds for class 2, too.
    overwrite : bool
        Replace ``out`` if it exists.
    progress : callable, optional
        Called with stage, steps done and steps in all.

    Returns
    -------
    ClassifyReport

    Raises
    ------
    MsbdbError
        One of its kinds, when the file cannot be used or written. No file is written then.
    """
    from msbdb.run.classify import classify_points
    from msbdb.run.inputs import Inputs

    inputs = Inputs.of(source, ortho, dtm=dtm, crs=crs, ortho_crs=ortho_crs, z_unit=z_unit)
    values = params or named_profile(profile)
    return classify_points(
        inputs,
        Path(out),
        extract=extract,
        params=values,
        ground=ground,
        keep=keep,
        overwrite=overwrite,
        progress=progress,
    )
