"""``msbdb classify``: buildings as class 6 of the points themselves."""

from pathlib import Path
from typing import Any

import click

from msbdb.cli.build import Z_UNITS, parameters
from msbdb.cli.command import command, notice
from msbdb.cli.options import INPUT_FILE, OUTPUT_FILE, crs_name, detectors, setting, shared
from msbdb.cli.output import emit_json, emit_pairs, progress_bars
from msbdb.params import PROFILES


@command(
    "classify",
    examples=(
        "msbdb classify town.laz classified.laz",
        "msbdb classify town.laz classified.las --extract multiscale --crs EPSG:28992 --overwrite",
        "msbdb classify town.copc.laz classified.laz --extract area3d,adaptive --ortho cir.tif --json",
    ),
)
@click.argument("source", type=INPUT_FILE, metavar="IN")
@click.argument("out", type=OUTPUT_FILE, metavar="OUT")
@click.option(
    "--extract",
    type=detectors,
    default="area3d",
    show_default=True,
    metavar="NAME,NAME",
    help="The detectors to run. area3d and adaptive classify points; of multiscale and flatregions, the points in "
    "their regions count. With several detectors, a point that any of them finds is a building.",
)
@click.option("--crs", type=crs_name, metavar="EPSG", help="The points' CRS where the file does not state it.")
@click.option(
    "--ortho", type=INPUT_FILE, multiple=True, metavar="FILE", help="An orthophoto of any bands and CRS; repeatable."
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
@click.option("--keep", is_flag=True, help="Keep the points of class 6 of IN in class 6, found or not.")
@click.option("--overwrite", is_flag=True, help="Replace OUT if it exists.")
@shared("json")
def classify(*, source: Path, out: Path, as_json: bool, **options: Any) -> None:  # noqa: ANN401
    """Write a copy of the points with the buildings in class 6.

    IN is LAS, LAZ or COPC. OUT is LAS or LAZ, by its ending, and has the same points in the same order. Only classes
    change: points of buildings get class 6. Points of class 6 that were not found get class 1, unclassified. All others
    keep their class.
    """
    params = parameters(options["profile"], options.pop("params_file"), options.pop("settings"), None)
    from msbdb import api

    with progress_bars() as progress:
        report = api.classify(source, out, **options, params=params, progress=progress)
    if as_json:
        emit_json(report.as_dict())
        return
    shown = click.get_current_context().ensure_object(set)
    for sentence in report.notices:
        notice(sentence, shown)
    emit_pairs(
        {
            "points": report.points,
            "building points": report.building_points,
            **{f"regions by {method}": count for method, count in report.regions.items()},
            "changed points": report.changed,
            "buildings before, not found": report.demoted,
            "written": str(out),
            "seconds": float(sum(report.timings.values())),
        }
    )
