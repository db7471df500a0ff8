"""``msbdb classes``: the spectral classes, and the operator's right to overrule their labels (V36)."""

from typing import Any

import click

from msbdb.cli.build import emit_report
from msbdb.cli.command import command
from msbdb.cli.options import class_label, shared
from msbdb.cli.output import emit_json, emit_table, progress_bars


@command(
    "classes",
    examples=(
        "msbdb classes town.sqlite",
        "msbdb classes town.sqlite --set 3=vegetation --set 7=building",
    ),
)
@shared("db")
@click.option(
    "--set", "labels", type=class_label, multiple=True, metavar="CLASS=LABEL", help="Label a class anew; repeatable."
)
@shared("survey", "json")
def classes(*, db: str, labels: tuple[tuple[int, str], ...], survey: str | None, as_json: bool) -> None:
    """List the land-cover classes, or label them anew.

    Without --set, the classes of a survey are listed with their statistics. A new label runs the build again from the
    classes on, without the source data. The labels are building, vegetation, shadow, water and other.
    """
    from msbdb import pipeline

    result: dict[str, Any] = {}
    report = None
    if labels:
        with progress_bars() as progress:
            report = pipeline.relabel(db, dict(labels), survey=survey, progress=progress)
        result["build"] = report.as_dict()
    result["classes"] = pipeline.classes(db, survey=survey).to_dict(orient="records")
    if as_json:
        emit_json(result)
        return
    if report is not None:
        emit_report(report)
    if result["classes"]:
        emit_table(result["classes"])
    else:
        click.echo("This survey has no classes.")
