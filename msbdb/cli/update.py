"""``msbdb update``: a survey brought into the living inventory."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from msbdb.cli.build import check_inputs, emit_report, inputs, parameters, values
from msbdb.cli.command import command, notice
from msbdb.cli.options import INPUT_FILE, iso_date, shared
from msbdb.cli.output import emit_json, emit_pairs, progress_bars

if TYPE_CHECKING:
    from msbdb.pipeline import AdvanceReport


@command(
    "update",
    examples=(
        "msbdb update --points spring.laz --db town.sqlite --survey spring --date 2024-04-20",
        "msbdb update --points tiles/*.laz --crs EPSG:28992 --db postgresql://me@localhost/town "
        "--survey ahn4 --date 2022-01-15 --aoi district.gpkg",
    ),
)
@inputs
@click.option("--survey", required=True, metavar="NAME", help="Name of the survey.")
@click.option(
    "--date",
    type=iso_date,
    required=True,
    metavar="DATE",
    help="When the data were taken: 2021-05-31, 2021-05 or 2021.",
)
@click.option("--aoi", type=INPUT_FILE, metavar="FILE", help="Polygons: only buildings in them take part.")
@values
@shared("json")
def update(*, as_json: bool, figure: Path | None, **given: Any) -> None:  # noqa: ANN401
    """Build a survey and update the inventory by it.

    The survey's buildings are compared with those of the inventory: each is unchanged, modified, new, demolished,
    merged or split, and keeps its identity. Surveys come in the order of their dates. The last one of a place may be
    repeated; the same content changes nothing. After an interruption, run the command again.
    """
    check_inputs(given)
    params = parameters(given["profile"], given.pop("params_file"), given.pop("settings"), given.pop("scales"))
    from msbdb import pipeline

    with progress_bars() as progress:
        report = pipeline.update(given.pop("points"), **given, params=params, progress=progress)
    if figure is not None:
        pipeline.changes(given["db"], survey=given["survey"], figure=figure)
    if as_json:
        emit_json(report.as_dict())
        return
    if report.build is not None:
        emit_report(report.build)
    emit_advance(report.inventory)


def emit_advance(report: "AdvanceReport") -> None:
    """Print what an update did to the inventory."""
    shown = click.get_current_context().ensure_object(set)
    for sentence in report.notices:
        notice(sentence, shown)
    counts = {kind: n for kind, n in report.counts.items() if kind != "versions"}
    offset = report.offset
    pairs: dict[str, object] = {
        "inventory": "unchanged: this update was applied already" if report.status == "unchanged" else report.status,
        "date": report.date,
        **counts,
        "new versions": report.counts["versions"],
        "offset, m": f"{offset['dx_m']:.2f} east, {offset['dy_m']:.2f} north, {offset['dz_m']:.2f} up",
        "told by": f"{offset['pairs']} pairs of buildings",
    }
    emit_pairs(pairs, "Inventory")
