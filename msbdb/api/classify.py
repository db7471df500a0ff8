"""Classify the points of a file: those of buildings get class 6."""

from collections.abc import Sequence
from pathlib import Path

from msbdb.params import Params
from msbdb.params import profile as named_profile
from msbdb.run.reports import ClassifyReport
from msbdb.run.stages import Progress


def classify(
    source: Path,
    out: Path,
    *,
    extract: Sequence[str] = ("area3d",),
    crs: str | None = None,
    ortho: Sequence[Path] = (),
    ortho_crs: str | None = None,
    z_unit: str = "auto",
    params: Params | None = None,
    profile: str = "default",
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
    extract : sequence of str
        The detectors. Three or more with ``multiscale`` decide together, as in a build; of others, a point that any of
        them finds is a building. ``area3d`` and ``adaptive`` find points. Of ``multiscale`` and ``flatregions``, the
        points in the cells of a part or flat region count. They must be at least ``surface.mask_m`` above ground.
    crs, ortho_crs : str, optional
        CRS of points and orthophotos that state none.
    ortho : sequence of path
        Orthophotos of any bands, each on its own grid and CRS. Without them the points' colours serve.
    z_unit : str
        Unit of the heights: ``auto``, ``m``, ``ft`` or ``us-ft``.
    params : Params, optional
        Parameters; the profile's by default.
    profile : str
        Name of the profile that the parameters come from.
    keep : bool
        Keep the points of class 6 of the source in class 6, found or not; otherwise they become unclassified (1).
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
    from msbdb.run.prepare import Inputs

    inputs = Inputs((Path(source),), tuple(map(Path, ortho)), crs=crs, ortho_crs=ortho_crs, z_unit=z_unit)
    values = params or named_profile(profile)
    return classify_points(
        inputs, Path(out), extract=extract, params=values, keep=keep, overwrite=overwrite, progress=progress
    )
