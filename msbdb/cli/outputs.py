"""``msbdb info``, ``view``, ``export`` and ``classes``: the commands that show what a database holds."""

from pathlib import Path
from typing import Any

import click

from msbdb.cli.build import emit_report
from msbdb.cli.command import command
from msbdb.cli.options import OUTPUT_FILE, class_label, shared
from msbdb.cli.output import emit, emit_json, emit_table, progress_bars
from msbdb.params import REGION_DETECTORS


@command("info", examples=("msbdb info town.sqlite", "msbdb info postgresql://me@localhost/town --json"))
@shared("db", "json")
def info(*, db: str, as_json: bool) -> None:
    """Show what a database holds.

    The surveys with their sources, the runs with their counts, and the version of the schema. With --json also what
    each run decided itself: the ground filter, the scales, the scaling of the bands and the centres of the classes.
    """
    from msbdb import api

    result = api.info(db)
    if as_json:
        emit_json(result)
    else:
        for run in result.get("runs", []):
            run["ground_filter"] = run.pop("chosen").get("ground_filter")
        emit(result)


@command(
    "view",
    examples=("msbdb view town.sqlite --out town.png", "msbdb view town.sqlite --of flatregions --out zones.png"),
)
@shared("db")
@click.option("--out", type=OUTPUT_FILE, required=True, metavar="FILE.png", help="The picture to write.")
@click.option(
    "--of",
    type=click.Choice(["buildings", *REGION_DETECTORS]),
    default="buildings",
    show_default=True,
    help="What to draw.",
)
@shared("survey")
def view(*, db: str, out: Path, of: str, survey: str | None) -> None:
    """Draw a map of the buildings, or of the regions of another detector, on a hillshade of the surface.

    Parts of buildings are outlined by scale and filled by height. Flat regions are coloured by their zone. Candidate
    regions are coloured by the height scale that accepted them, or by their height.
    """
    from msbdb import api

    api.view(db, out, survey=survey, of=of)
    click.echo(f"Wrote {out}.")


@command(
    "export",
    examples=(
        "msbdb export town.sqlite town.gpkg",
        "msbdb export town.sqlite town.shp --overwrite",
        "msbdb export town.sqlite town.geojson --survey spring",
    ),
)
@shared("db")
@click.argument("out", type=click.Path(path_type=Path), metavar="OUT")
@click.option("--overwrite", is_flag=True, help="Replace files that exist.")
@shared("survey")
def export(*, db: str, out: Path, overwrite: bool, survey: str | None) -> None:
    """Write footprints and parts to a file.

    The ending of OUT decides the format. A GeoPackage (.gpkg) has the layers footprint, part, flat_region and
    candidate_region. A Shapefile (.shp) has the parts, under the paper's names of at most ten characters. GeoJSON
    (.geojson) has the parts in longitude and latitude.
    """
    from msbdb import api

    api.export(db, out, survey=survey, overwrite=overwrite)
    click.echo(f"Wrote {out}.")


@command(
    "classes",
    examples=(
        "msbdb classes town.sqlite",
        "msbdb classes town.sqlite --set 3=vegetation --set 7=building",
    ),
)
@shared("db")
@click.option(
    "--set",
    "labels",
    type=class_label,
    multiple=True,
    metavar="CLASS=LABEL",
    help="Give a class another label; repeatable.",
)
@shared("survey", "json")
def classes(*, db: str, labels: tuple[tuple[int, str], ...], survey: str | None, as_json: bool) -> None:
    """List the land-cover classes, or give them other labels.

    Without --set, the classes of a survey are listed with their statistics. A new label repeats the build from the
    classes on, without the source data. The labels are building, vegetation, shadow, water and other.
    """
    from msbdb import api

    result: dict[str, Any] = {}
    report = None
    if labels:
        with progress_bars() as progress:
            report = api.relabel(db, dict(labels), survey=survey, progress=progress)
        result["build"] = report.as_dict()
    result["classes"] = api.classes(db, survey=survey).to_dict(orient="records")
    if as_json:
        emit_json(result)
        return
    if report is not None:
        emit_report(report)
    if result["classes"]:
        emit_table(result["classes"])
    else:
        click.echo("This survey has no classes.")
