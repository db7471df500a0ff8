"""Build a database of buildings from one survey."""

from collections.abc import Sequence
from pathlib import Path

from msbdb.params import DETECTORS, Params
from msbdb.params import profile as named_profile
from msbdb.run.reports import BuildReport
from msbdb.run.stages import Notices, Progress, Stages


def build(
    points: Sequence[Path] = (),
    *,
    ortho: Sequence[Path] = (),
    dsm: Path | None = None,
    dtm: Path | None = None,
    ndsm: Path | None = None,
    db: str | Path,
    survey: str | None = None,
    date: str | None = None,
    crs: str | None = None,
    ortho_crs: str | None = None,
    z_unit: str = "auto",
    params: Params | None = None,
    profile: str = "default",
    extract: Sequence[str] = DETECTORS,
    denoising_figure: Path | None = None,
    progress: Progress | None = None,
) -> BuildReport:
    """Build or extend a database of buildings from one survey.

    Parameters
    ----------
    points : sequence of path
        LAS, LAZ or COPC files; or give ``dsm`` with ``dtm``, or ``ndsm``, as GeoTIFF.
    ortho : sequence of path
        Orthophotos of any bands, each on its own grid and CRS. Without them the points' colours serve.
    dsm, dtm, ndsm : path, optional
        Rasters of heights.
    db : str or path
        A SpatiaLite file, made when it is missing, or a ``postgresql+psycopg://`` URL.
    survey : str, optional
        Name of the survey; the first file's name by default. Building it again replaces it, if anything differs.
    date : str, optional
        When the data were taken, ISO 8601.
    crs : str, optional
        CRS of point files and rasters of heights that state none.
    ortho_crs : str, optional
        CRS of orthophotos that state none.
    z_unit : str
        Unit of the heights: ``auto``, ``m``, ``ft`` or ``us-ft``.
    params : Params, optional
        Parameters; the profile's by default.
    profile : str
        Name of the profile that the parameters come from.
    extract : sequence of str
        The detectors: ``multiscale`` finds buildings as trees of parts, ``flatregions`` finds flat regions, ``area3d``
        and ``adaptive`` find candidate regions among the points. The last three are evidence for the buildings.
    denoising_figure : path, optional
        PNG of the surface before and after the denoising for the flat regions.
    progress : callable, optional
        Called with stage, steps done and steps in all.

    Returns
    -------
    BuildReport

    Raises
    ------
    MsbdbError
        One of its kinds, when the inputs or the database cannot be used. The database is then unchanged.
    """
    from msbdb.database import check_target, read_labelled_classes
    from msbdb.run.compose import Job, choose_detectors, run_survey
    from msbdb.run.prepare import Inputs, Label
    from msbdb.run.stages import collect_notices
    from msbdb.run.store import report_of, store_survey

    values = params or named_profile(profile)
    inputs = Inputs(tuple(map(Path, points)), tuple(map(Path, ortho)), dsm, dtm, ndsm, crs, ortho_crs, z_unit)
    notices, stages = Notices(), Stages(progress)
    with collect_notices(notices):
        methods = choose_detectors(extract, inputs)
    check_target(db)
    name = survey or inputs.default_survey()
    labelled = read_labelled_classes(db, name)
    job = Job(inputs, values, profile, Label(name, date or "", labelled), methods, denoising_figure)
    kept = run_survey(job, stages, notices)
    with stages.stage("write"):
        changed = store_survey(kept, db, labelled)
    return report_of(kept, stages, changed=changed, passing=notices.passing)
