"""``msbdb measure``: footprints that an office has, with heights, storeys, parts and state from a survey."""

from pathlib import Path
from typing import Any

import click

from msbdb.cli.build import check_figure, check_inputs, emit_report, inputs, parameters, values, with_walls
from msbdb.cli.command import INPUT_FILE, OUTPUT_FILE, command, iso_date, shared
from msbdb.cli.output import emit_json, emit_pairs, is_quiet
from msbdb.cli.progress import progress_bar, stages_of
from msbdb.errors import counted


@command(
    "measure",
    examples=(
        "msbdb measure cadastre.gpkg --points town.laz --db town.sqlite --id number --out measured.gpkg",
        "msbdb measure footprints.geojson --points tiles/*.laz --dtm terrain.tif --db town.sqlite",
        "msbdb measure cadastre.gpkg --layer buildings --points town.laz --db postgresql://me@localhost/town",
    ),
)
@click.argument("footprints", type=INPUT_FILE, metavar="FOOTPRINTS")
@inputs
@click.option(
    "--id",
    "id_column",
    metavar="COLUMN",
    help="Column with an id for each footprint. [default: the places of the footprints]",
)
@click.option("--layer", metavar="NAME", help="The layer of FOOTPRINTS, where it has several.")
@click.option("--name", metavar="NAME", help="Name of the footprints in the inventory. [default: the file's name]")
@click.option(
    "--out", type=OUTPUT_FILE, metavar="FILE", help="Also write the measured footprints as .gpkg, .geojson or .csv."
)
@click.option("--survey", metavar="NAME", help="Name of the survey. [default: as for 'msbdb build']")
@click.option("--date", type=iso_date, metavar="DATE", help="When the data were taken: 2021-05-31, 2021-05 or 2021.")
@values
@shared("overwrite", "json")
def measure(*, as_json: bool, footprints: Path, figure: Path | None, **given: Any) -> None:  # noqa: ANN401  (the options)
    """Measure footprints that you have on a survey: heights, storeys, parts, and whether a building is there.

    FOOTPRINTS are polygons of any vector format and CRS. The survey is built as by 'msbdb build', with the footprints
    as its parcels. Each footprint keeps its outline and all its columns. It gets the levels of ground, eaves and ridge,
    storeys, the share of its points on detected buildings, and a state: confirmed, unsure, or refuted where no building
    is detected. Detected buildings without a footprint are listed too. All of them become the inventory of the
    database (footprint_current), which later surveys update.
    """
    check_inputs(given)
    check_figure(figure, given)
    params = parameters(given["profile"], given.pop("params_file"), given.pop("settings"), given.pop("scales"))
    params = with_walls(params, given.pop("outline"))
    from msbdb import api

    with progress_bar(stages_of(given["extract"], "measure")) as progress:
        report = api.measure(footprints, given.pop("points"), **given, params=params, progress=progress)
    if figure is not None:
        api.view(given["db"], figure, survey=report.survey, overwrite=given["overwrite"])
    if as_json:
        emit_json(report.as_dict())
        return
    if report.build is not None:
        emit_report(report.build)
    if is_quiet():
        return
    pairs: dict[str, object] = {
        "measured": counted(report.footprints, "footprint"),
        **{f"· {state}": count for state, count in report.states.items()},
        "without footprint": counted(report.others, "detected building"),
        "inventory": "unchanged: it has these measures already" if report.status == "unchanged" else report.status,
        "database": report.database,
    }
    if given["out"] is not None:
        pairs["written"] = str(given["out"])
    emit_pairs(pairs, f"Footprints {report.name}")
