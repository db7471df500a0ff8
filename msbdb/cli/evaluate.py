"""``msbdb evaluate``: how well the buildings agree with a reference."""

from pathlib import Path
from typing import Any

import click
from click.core import ParameterSource

from msbdb.cli.command import command
from msbdb.cli.options import INPUT_FILE, crs_name, declared_range, shared
from msbdb.cli.output import emit, emit_json
from msbdb.params import REGION_DETECTORS, EvaluateParams

BY_AREA = ("layer", "aoi", "height", "overlap", "cell_m")
"""Options without effect by point."""

BY_DATABASE = ("of", "survey")
"""Options without effect for a file of points."""


@command(
    "evaluate",
    examples=(
        "msbdb evaluate town.sqlite --reference cadastre.gpkg --layer buildings --aoi area.gpkg",
        "msbdb evaluate town.sqlite --reference classified.laz --crs EPSG:28992 --json",
        "msbdb evaluate town.sqlite --reference classified.laz --by point --of area3d",
        "msbdb evaluate found.laz --reference classified.laz",
    ),
)
@click.argument("db", metavar="DB_OR_POINTS")
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
    type=declared_range(EvaluateParams, "overlap"),
    default=EvaluateParams().overlap,
    show_default=True,
    help="Share of an object's area that the other side must cover for it to count as found.",
)
@click.option(
    "--cell",
    "cell_m",
    type=declared_range(EvaluateParams, "cell_m"),
    default=EvaluateParams().cell_m,
    show_default=True,
    help="Cell of the grid on which areas are compared, metres.",
)
@click.option(
    "--of",
    type=click.Choice(["buildings", "confirmed", "parts", *REGION_DETECTORS]),
    default="buildings",
    show_default=True,
    help="What to compare with the reference.",
)
@click.option(
    "--by",
    type=click.Choice(["area", "point"]),
    help="Compare footprints, or points with those of a LAS or LAZ reference. [default: area; point for a point file]",
)
@shared("survey", "json")
def evaluate(*, db: str, reference: Path, by: str | None, as_json: bool, **options: Any) -> None:  # noqa: ANN401
    """Compare the footprints of a database, or the class 6 of a point file, with a reference.

    The report counts by area, by object (all, and those over 50 m2), by shape and by height, as the papers do. By
    point, it counts points. A point file is compared with a classified one of the same points.
    """
    from msbdb import api

    is_file = Path(db).suffix.lower() in (".las", ".laz")
    if is_file or by == "point":
        _refuse(BY_AREA, "a comparison by point")
        if is_file:
            _refuse(BY_DATABASE, f"a file of points, {db}")
        if by == "area":
            msg = f"A file of points is compared by point, {db}; leave out --by area, or name a database."
            raise click.UsageError(msg)
        how = {name: value for name, value in options.items() if name not in BY_AREA}
        result = api.evaluate_points(db, reference, **how).as_dict()
    else:
        result = api.evaluate(db, reference, **options).as_dict()
    if as_json:
        emit_json(result)
    else:
        emit(result)


def _refuse(names: tuple[str, ...], what: str) -> None:
    """Refuse options that were given on the command line and would have no effect."""
    ctx = click.get_current_context()
    flags = {str(param.name): param.opts[-1] for param in ctx.command.params}
    given = [flags[name] for name in names if ctx.get_parameter_source(name) is ParameterSource.COMMANDLINE]
    if given:
        msg = f"{', '.join(given)} has no meaning for {what}; leave it out."
        raise click.UsageError(msg)
