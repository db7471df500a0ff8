"""The options by which the files and values of a survey are given, and what is refused of them beforehand."""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from msbdb.cli.command import (
    DATABASE,
    INPUT_FILE,
    OUTPUT_FILE,
    POINT_FILES,
    F,
    crs_name,
    detectors,
    scales_m2,
    setting,
)
from msbdb.params import DETECTORS, PROFILES, Params

if TYPE_CHECKING:
    pass

Z_UNITS = ("auto", "m", "ft", "us-ft")
WALLS = ("fitted", "traced")

_SOURCES = (
    click.option(
        "--points",
        type=POINT_FILES,
        multiple=True,
        metavar="FILE...",
        help="LAS, LAZ or COPC files of one survey; a folder, a pattern in quotes, a virtual point cloud (.vpc), a "
        "tile index, or the URL of a COPC file.",
    ),
    click.option(
        "--ortho", type=INPUT_FILE, multiple=True, metavar="FILE...", help="Orthophotos of any bands, grid and CRS."
    ),
    click.option(
        "--dsm", type=INPUT_FILE, metavar="FILE", help="Surface heights as a raster, or a VRT of many; needs --dtm."
    ),
    click.option(
        "--dtm", type=INPUT_FILE, metavar="FILE", help="Ground heights as a raster, for --dsm or for --points."
    ),
    click.option("--ndsm", type=INPUT_FILE, metavar="FILE", help="Heights above ground as a raster."),
)
"""Options of the heights and images of a survey."""

_HEIGHTS = (
    *_SOURCES,
    click.option(
        "--parcels",
        type=INPUT_FILE,
        metavar="FILE",
        help="Polygons that divide touching houses: parcels, cadastre or footprints, of any vector format and CRS.",
    ),
    click.option(
        "--db", type=DATABASE, required=True, metavar="PATH_OR_URL", help="A SpatiaLite file or a postgresql:// URL."
    ),
)
"""Options of what a survey is made from."""

_STATED = (
    click.option(
        "--crs", type=crs_name, metavar="EPSG", help="The data's CRS where the files do not state it, like EPSG:2154."
    ),
    click.option("--ortho-crs", type=crs_name, metavar="EPSG", help="The orthophotos' CRS where they do not state it."),
    click.option(
        "--z-unit",
        type=click.Choice(Z_UNITS),
        default="auto",
        show_default=True,
        help="Unit of the heights; auto follows the CRS.",
    ),
    click.option(
        "--scales",
        type=scales_m2,
        metavar="auto|M2,M2,...",
        help="Area thresholds in m2, or 'auto' to find them by granulometry.",
    ),
    click.option(
        "--profile", type=click.Choice(list(PROFILES)), default="default", show_default=True, help="Set of values."
    ),
    click.option(
        "--params", "params_file", type=INPUT_FILE, metavar="FILE.toml", help="Values over those of the profile."
    ),
    click.option(
        "--set",
        "settings",
        type=setting,
        multiple=True,
        metavar="SECTION.NAME=VALUE",
        help="One value over all others; repeatable.",
    ),
)
"""Options of what is stated about the files, and of the parameters."""

_SKIP_BAD = click.option(
    "--skip-bad",
    is_flag=True,
    help="Leave out point files that cannot be read, are empty, or are in another CRS than most, with a notice.",
)

_VALUES = (
    *_STATED,
    click.option(
        "--outline",
        type=click.Choice(WALLS),
        help="Outlines of straight walls on shared arcs, or traced along the cells and simplified. [default: fitted]",
    ),
    click.option(
        "--extract",
        type=detectors,
        default=",".join(DETECTORS),
        show_default=True,
        metavar="NAME,NAME",
        help="The detectors to run. multiscale finds buildings as trees of parts, flatregions finds flat regions. "
        "area3d and adaptive find candidate regions among the points, as evidence.",
    ),
    click.option(
        "--denoising-figure",
        type=OUTPUT_FILE,
        metavar="PICTURE",
        help="Also draw the surface before and after the denoising for the flat regions.",
    ),
    click.option("--figure", type=OUTPUT_FILE, metavar="PICTURE", help="Also draw the map of 'msbdb view'."),
    click.option(
        "--replace",
        is_flag=True,
        help="Replace a survey of this name also where it is of other files or another place, or has results of "
        "detectors that are not run now.",
    ),
    _SKIP_BAD,
    click.option(
        "--plan",
        type=DATABASE,
        metavar="FILE_OR_DB",
        help="Values of a larger survey or an earlier one: a file of 'msbdb plan --json', or a database of one survey.",
    ),
)
"""Options of how it is made."""


def inputs(function: F) -> F:
    """Decorate a command with the options of a survey's files."""
    return _decorated(function, _HEIGHTS)


def aoi(function: F) -> F:
    """Decorate a command with the option of an area that is built."""
    words = "Polygons of any vector format and CRS: only what lies in them is built. Points up to 50 m beyond are read."
    return click.option("--aoi", type=INPUT_FILE, metavar="FILE", help=words)(function)


def sources(function: F) -> F:
    """Decorate a command with the options of what a plan is made from."""
    return _decorated(function, (*_SOURCES, *_STATED, _SKIP_BAD))


def values(function: F) -> F:
    """Decorate a command with the options of CRS, units, parameters, detectors and the map."""
    return _decorated(function, _VALUES)


def _decorated(function: F, options: tuple[Callable[[F], F], ...]) -> F:
    """Add options in the order in which the help lists them."""
    for option in reversed(options):
        function = option(function)
    return function


def parameters(
    profile: str,
    file: Path | None,
    settings: tuple[tuple[str, str, object], ...],
    scales: tuple[float, ...] | None,
) -> Params:
    """Return the parameters: the profile, then the file, then single settings, then the scales."""
    from msbdb import params as declared

    values = declared.profile(profile)
    if file is not None:
        values = declared.read_params(file, values)
    for section, name, value in settings:
        values = declared.with_values(values, {section: {name: value}})
    if scales is not None:
        values = declared.with_values(values, {"scale": {"scales_m2": scales}})
    return values


def with_walls(params: Params, walls: str | None) -> Params:
    """Return the parameters with the outlines that ``--outline`` asks for; without it as they are."""
    from msbdb import params as declared

    return params if walls is None else declared.with_values(params, {"vector": {"walls": walls}})


def check_inputs(inputs: dict[str, Any]) -> None:
    """Refuse a set of inputs that cannot make heights above ground."""
    given = [name for name in ("points", "dsm", "ndsm") if inputs[name]]
    if not given:
        msg = "Give --points FILE..., or --dsm FILE with --dtm FILE, or --ndsm FILE."
        raise click.UsageError(msg)
    if len(given) > 1:
        msg = f"Give one kind of heights; got --{' and --'.join(given)}."
        raise click.UsageError(msg)
    if given == ["dsm"] and not inputs["dtm"]:
        msg = "--dsm needs --dtm FILE, or give heights above ground by --ndsm FILE."
        raise click.UsageError(msg)
    if inputs["dtm"] and inputs["ndsm"]:
        msg = "--ndsm has heights above ground already. Leave --dtm out, or give it with --dsm or --points."
        raise click.UsageError(msg)


def check_figure(figure: Path | None, inputs: dict[str, Any]) -> None:
    """Refuse a figure that could not be drawn after the build."""
    from msbdb.io.files import PICTURES, require_output

    if figure is None:
        return
    if figure == inputs["denoising_figure"]:
        msg = f"--figure and --denoising-figure name the same file, {figure}. Give each a name of its own."
        raise click.UsageError(msg)
    single = [inputs[name] for name in ("dsm", "dtm", "ndsm", "parcels", "aoi", "db") if inputs.get(name)]
    sources = [*inputs["points"], *inputs["ortho"], *single]
    require_output(figure, overwrite=inputs["overwrite"], endings=PICTURES, sources=sources)
