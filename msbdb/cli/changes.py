"""``msbdb changes``: what became of the buildings of the inventory between two dates."""

from pathlib import Path

import click

from msbdb.cli.command import command
from msbdb.cli.options import INPUT_FILE, OUTPUT_FILE, iso_date, shared
from msbdb.cli.output import emit_json, emit_pairs, emit_table

SHOWN = ("date", "survey", "kind", "uid_before", "uid_after", "dh_m", "darea_m2", "note")
MOST = 50
"""Rows that are printed; a file takes them all."""


@command(
    "changes",
    examples=(
        "msbdb changes town.sqlite",
        "msbdb changes town.sqlite --from 2020-01-01 --to 2024-12-31 --out changes.gpkg --figure changes.png",
        "msbdb changes town.sqlite --from 2023 --aoi district.gpkg --json",
        "msbdb changes town.sqlite --each --out surveys.csv",
    ),
)
@shared("db")
@click.option(
    "--from", "since", type=iso_date, metavar="DATE", help="From the state of this day; surveys after it count."
)
@click.option("--to", "until", type=iso_date, metavar="DATE", help="To the state of this day; surveys up to it count.")
@click.option("--survey", metavar="NAME", help="What this survey did, as with --each.")
@click.option("--each", is_flag=True, help="A row a building and survey that saw it, in place of the net change.")
@click.option(
    "--aoi", type=INPUT_FILE, metavar="FILE", help="Polygons: buildings that meet them, those not surveyed included."
)
@click.option("--out", type=OUTPUT_FILE, metavar="FILE", help="Write all rows as .gpkg, .geojson or .csv.")
@click.option("--figure", type=OUTPUT_FILE, metavar="FILE.png", help="Draw the buildings coloured by kind of change.")
@shared("json")
def changes(
    *,
    db: str,
    since: str | None,
    until: str | None,
    survey: str | None,
    each: bool,
    aoi: Path | None,
    out: Path | None,
    figure: Path | None,
    as_json: bool,
) -> None:
    """Tell what became of the buildings between two dates.

    The net change, a row a building: unchanged, modified (outline, height or parts), new, demolished, merged or split,
    with state, heights and area before and after. What surveys did one after the other is told as one change: raised
    and then demolished is demolished. Buildings that came and went in between are only counted; --each shows them.
    Unchanged ones are counted and not printed.
    """
    from msbdb import pipeline

    found = pipeline.changes(db, since=since, until=until, survey=survey, each=each, aoi=aoi, out=out, figure=figure)
    told = pipeline.summary(found)
    if as_json:
        emit_json(told)
        return
    if not found.counts and not found.in_between:
        click.echo("No survey of the period saw a building there.")
        return
    emit_pairs(found.counts | ({"came and went in between": found.in_between} if found.in_between else {}))
    rows = told["changes"]
    if rows:
        emit_table([{name: row[name] for name in SHOWN} for row in rows[:MOST]], "Changes")
    if len(rows) > MOST:
        click.echo(f"... and {len(rows) - MOST} more; --out writes them all.")
