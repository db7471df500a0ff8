"""``msbdb evaluate``: how well the buildings agree with a reference."""

from pathlib import Path
from typing import Any

import click

from msbdb.cli.command import command
from msbdb.cli.options import INPUT_FILE, crs_name, shared
from msbdb.cli.output import emit, emit_json


@command(
    "evaluate",
    examples=(
        "msbdb evaluate town.sqlite --reference cadastre.gpkg --layer buildings --aoi area.gpkg",
        "msbdb evaluate town.sqlite --reference classified.laz --crs EPSG:28992 --json",
    ),
)
@shared("db")
@click.option(
    "--reference",
    type=INPUT_FILE,
    required=True,
    metavar="FILE",
    help="True footprints in any vector format, or a LAS or LAZ file whose class 6 is the truth.",
)
@click.option("--layer", metavar="NAME", help="Layer of the reference. [default: its only one]")
@click.option("--aoi", type=INPUT_FILE, metavar="FILE", help="Polygons within which to compare. [default: all]")
@click.option(
    "--height", metavar="COLUMN", help="Column of the reference with heights in metres. [default: one called height]"
)
@click.option("--crs", type=crs_name, metavar="EPSG", help="The reference's CRS where it does not state it.")
@click.option(
    "--overlap",
    type=click.FloatRange(0, 1, min_open=True),
    default=0.5,
    show_default=True,
    help="Share of an object's area that the other side must cover for it to count as found.",
)
@click.option(
    "--cell",
    "cell_m",
    type=click.FloatRange(0, min_open=True),
    default=0.5,
    show_default=True,
    help="Cell of the grid on which areas are compared, metres.",
)
@click.option(
    "--of",
    type=click.Choice(["buildings", "confirmed", "parts", "flatregions"]),
    default="buildings",
    show_default=True,
    help="What to compare with the reference.",
)
@shared("survey", "json")
def evaluate(*, db: str, reference: Path, as_json: bool, **options: Any) -> None:  # noqa: ANN401
    """Compare the footprints with a reference.

    The report counts by area, by object (all, and those over 50 m2), by shape and by height, as the papers do.
    """
    from msbdb import pipeline

    result = pipeline.evaluate(db, reference, **options).as_dict()
    if as_json:
        emit_json(result)
    else:
        emit(result)
