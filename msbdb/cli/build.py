"""``msbdb build`` and ``classify``: from points or rasters to a database, and to classes of the points themselves."""

import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from msbdb.cli.command import (
    INPUT_FILE,
    OUTPUT_FILE,
    command,
    crs_name,
    detectors,
    iso_date,
    setting,
    shared,
)
from msbdb.cli.inputs import (
    Z_UNITS,
    aoi,
    check_figure,
    check_inputs,
    inputs,
    parameters,
    values,
    with_walls,
)
from msbdb.cli.output import emit_json, emit_pairs, is_quiet, refused
from msbdb.cli.progress import notice, progress_bar, stages_of
from msbdb.cli.tiles import tiled
from msbdb.errors import counted
from msbdb.params import DETECTORS, PROFILES

if TYPE_CHECKING:
    from msbdb.run.reports import BuildReport


@command(
    "build",
    examples=(
        "msbdb build --points town.laz --db town.sqlite",
        "msbdb build --points tiles/*.laz --crs EPSG:28992 --ortho rgb.tif --db town.sqlite --figure town.png",
        "msbdb build --points tiles --skip-bad --db town.sqlite --survey 2024",
        "msbdb build --dsm dsm.tif --dtm dtm.tif --db town.sqlite --survey spring --date 2021-04-20",
        "msbdb build --points town.laz --dtm terrain.tif --db town.sqlite",
        "msbdb build --points town.laz --parcels cadastre.gpkg --db town.sqlite",
        "msbdb build --points tiles --aoi district.gpkg --db district.sqlite",
        "msbdb build --points town.laz --db postgresql://me@localhost/town --scales 30,100,1000",
        "msbdb build --points town.laz --db town.sqlite --profile vu2009 --set surface.storey_m=2.7",
        "msbdb build --points town.laz --db town.sqlite --outline traced",
        "msbdb build --points town_corrected.laz --db town.sqlite --survey town --replace",
        "msbdb build --points east.laz --db town.sqlite --plan town.json",
        "msbdb build --points tiles --db town.sqlite --tile 1000 --workers 4",
        "msbdb build --dsm dsm.tif --dtm dtm.tif --db town.sqlite --tile 1000 --workers 4",
    ),
)
@inputs
@aoi
@click.option(
    "--survey",
    metavar="NAME",
    help="Name of the survey. [default: that of the file or folder; of one like 'points' with the folder around it]",
)
@click.option("--date", type=iso_date, metavar="DATE", help="When the data were taken: 2021-05-31, 2021-05 or 2021.")
@values
@tiled
@shared("overwrite", "json")
def build(*, as_json: bool, figure: Path | None, **given: Any) -> None:  # noqa: ANN401  (the options)
    """Build or extend a database of buildings from one survey.

    Give points, or a DSM with a DTM, or heights above ground. The ground is detected among the points, or taken from a
    DTM of your own. Height texture and echoes separate roofs from trees. An
    orthophoto, or the colours of the points, adds spectral classes. Building the same survey again leaves the database
    unchanged. With other values it replaces the survey, with a notice. Other files need another --survey, or --replace.
    """
    check_inputs(given)
    check_figure(figure, given)
    params = parameters(given["profile"], given.pop("params_file"), given.pop("settings"), given.pop("scales"))
    params = with_walls(params, given.pop("outline"))
    from msbdb import api

    with progress_bar(stages_of(given["extract"])) as progress:
        report = api.build(given.pop("points"), **given, params=params, progress=progress)
    if figure is not None:
        api.view(given["db"], figure, survey=report.survey, overwrite=given["overwrite"])
    if as_json:
        emit_json(report.as_dict())
    else:
        emit_report(report)


def emit_report(report: "BuildReport") -> None:
    """Print what a build found, what it refused, and what to look at; notices go to the standard error, each once."""
    shown = click.get_current_context().ensure_object(set)
    for sentence in report.notices:
        notice(sentence, shown)
    if is_quiet():
        return
    found, counts = report.overview, report.overview.counts
    states = ", ".join(f"{count:,} {state}" for state, count in found.states.items())
    others = {"flat region": report.flat_regions}
    others |= {f"{name} region": count for name, count in report.candidate_regions.items()}
    pairs: dict[str, object] = {
        "survey": report.survey,
        "buildings": f"{report.buildings:,}: {states}" if states else "0",
        "parts": report.parts,
        "largest": _one(found.largest),
        "highest": _one(found.highest),
        "evidence": ", ".join(counted(count, name) for name, count in others.items()),
    }
    emit_pairs({name: value for name, value in pairs.items() if value})
    if found.refused_m2:
        emit_pairs(
            {f"{area:,.0f} m²": why for why, area in found.refused_m2.items()},
            "Refused, though as high as a building",
        )
        click.echo(f" Refused candidates: {refused(report.rejected, found.refused_regions)}.")
    look = {}
    if counts["unsure"]:
        what = counted(counts["unsure"], "unsure building")
        look[what] = _some(found.unsure, counts["unsure"], "probability", "probability {:.2f}")
    if counts["uneven"]:
        what = f"{counted(counts['uneven'], 'building')} on unsure ground"
        look[what] = _some(found.uneven, counts["uneven"], "ground_range_m", "ground differs by {:.1f} m")
    if look:
        emit_pairs(look, "Look at")
    at = "X,Y" if not found.largest else f"{found.largest['easting']:.1f},{found.largest['northing']:.1f}"
    emit_pairs(
        {
            "database": report.database,
            "it is": "written" if report.changed else "unchanged: it has this build already",
            "time": f"{sum(report.timings.values()):.0f} s",
            "any place": f"msbdb why {shlex.quote(report.database)} --at {at}",
        },
        "Where it is",
    )


def _one(building: Mapping[str, Any]) -> str:
    """Return a building in words: its area, ridge, place and id."""
    if not building:
        return ""
    ridge = "" if building["ridge_m"] is None else f"ridge {building['ridge_m']:.1f} m, "
    place = f"at {building['easting']:.1f},{building['northing']:.1f}"
    return f"{building['area_m2']:,.0f} m², {ridge}{place}, id {building['building_id']}"


def _some(buildings: Sequence[Mapping[str, Any]], count: int, name: str, words: str) -> str:
    """Return the places of the first buildings of a kind with what is said of them."""
    places = [
        f"{building['easting']:.1f},{building['northing']:.1f}"
        + ("" if building[name] is None else f" ({words.format(building[name])})")
        for building in buildings
    ]
    return f"at {', '.join(places)}{' ...' if count > len(places) else ''}"


@command(
    "classify",
    examples=(
        "msbdb classify town.laz classified.laz",
        "msbdb classify town.laz classified.las --extract multiscale --crs EPSG:28992 --overwrite",
        "msbdb classify town.copc.laz classified.laz --extract area3d,adaptive --ortho cir.tif --json",
        "msbdb classify town.laz classified.laz --ground",
        "msbdb classify town.laz classified.laz --dtm terrain.tif",
    ),
)
@click.argument("source", type=INPUT_FILE, metavar="IN")
@click.argument("out", type=OUTPUT_FILE, metavar="OUT")
@click.option(
    "--extract",
    type=detectors,
    default=",".join(DETECTORS),
    show_default="all",
    metavar="NAME,NAME",
    help="The detectors to run. area3d and adaptive classify points; of multiscale and flatregions, the points in "
    "their regions count. Three or more with multiscale decide together, as in a build; of others, a point that any of "
    "them finds is a building.",
)
@click.option("--crs", type=crs_name, metavar="EPSG", help="The points' CRS where the file does not state it.")
@click.option(
    "--ortho", type=INPUT_FILE, multiple=True, metavar="FILE", help="An orthophoto of any bands and CRS; repeatable."
)
@click.option(
    "--dtm", type=INPUT_FILE, metavar="FILE", help="Ground heights as a raster. [default: detected among the points]"
)
@click.option("--ortho-crs", type=crs_name, metavar="EPSG", help="The orthophotos' CRS where they do not state it.")
@click.option(
    "--z-unit",
    type=click.Choice(Z_UNITS),
    default="auto",
    show_default=True,
    help="Unit of the heights; auto follows the CRS.",
)
@click.option(
    "--profile", type=click.Choice(list(PROFILES)), default="default", show_default=True, help="Set of values."
)
@click.option("--params", "params_file", type=INPUT_FILE, metavar="FILE.toml", help="Values over those of the profile.")
@click.option(
    "--set",
    "settings",
    type=setting,
    multiple=True,
    metavar="SECTION.NAME=VALUE",
    help="One value over all others; repeatable.",
)
@click.option("--ground", is_flag=True, help="Put the points of the ground in class 2, too.")
@click.option(
    "--keep",
    is_flag=True,
    help="Keep the points of class 6 of IN in class 6, found or not; those of class 2 with --ground.",
)
@shared("overwrite", "json")
def classify(*, source: Path, out: Path, as_json: bool, **options: Any) -> None:  # noqa: ANN401  (the options)
    """Write a copy of the points with the buildings in class 6.

    IN is LAS, LAZ or COPC. OUT is LAS or LAZ, by its ending, and has the same points in the same order. Only classes
    change: points of buildings get class 6, and with --ground those of the ground class 2. Points of these classes that
    were not found get class 1, unclassified. All others keep their class.
    """
    params = parameters(options["profile"], options.pop("params_file"), options.pop("settings"), None)
    from msbdb import api

    with progress_bar(stages_of(options["extract"])) as progress:
        report = api.classify(source, out, **options, params=params, progress=progress)
    if as_json:
        emit_json(report.as_dict())
        return
    shown = click.get_current_context().ensure_object(set)
    for sentence in report.notices:
        notice(sentence, shown)
    if is_quiet():
        return
    emit_pairs(
        {
            "points": report.points,
            "building points": report.building_points,
            **({"ground points": report.ground_points} if options["ground"] else {}),
            **{f"regions by {method}": count for method, count in report.regions.items()},
            "changed points": report.changed,
            "buildings before, not found": report.demoted,
            "written": str(out),
            "time": f"{sum(report.timings.values()):.0f} s",
        }
    )
