"""``msbdb update``, ``import``, ``state``, ``changes`` and ``measure``: the inventory, and footprints of an office."""

import getpass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from msbdb.cli.build import emit_report
from msbdb.cli.command import DATABASE, INPUT_FILE, OUTPUT_FILE, assignment, command, crs_name, iso_date, shared
from msbdb.cli.inputs import check_figure, check_inputs, inputs, parameters, values, with_walls
from msbdb.cli.output import emit_json, emit_pairs, emit_table, is_quiet, say
from msbdb.cli.progress import notice, progress_bar, stages_of
from msbdb.cli.tiles import tiled
from msbdb.errors import counted

if TYPE_CHECKING:
    from msbdb.run.reports import AdvanceReport


SHOWN = ("date", "survey", "kind", "uid_before", "uid_after", "dh_m", "darea_m2", "note")
"""Columns of the changes that are printed."""

MOST = 50
"""Rows of the changes that are printed; a file takes them all."""


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
@tiled
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


@command(
    "update",
    examples=(
        "msbdb update --points spring.laz --db town.sqlite --survey spring --date 2024-04-20",
        "msbdb update --points tiles/*.laz --crs EPSG:28992 --db postgresql://me@localhost/town "
        "--survey ahn4 --date 2022-01-15 --aoi district.gpkg",
        "msbdb update --points tiles --db town.sqlite --survey 2024 --date 2024-04-20 --tile 1000 --workers 4",
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
@click.option("--aoi", type=INPUT_FILE, metavar="FILE", help="Polygons: only buildings in them are compared.")
@values
@tiled
@shared("overwrite", "json")
def update(*, as_json: bool, figure: Path | None, **given: Any) -> None:  # noqa: ANN401  (the options)
    """Build a survey and update the inventory by it.

    The survey's buildings are compared with those of the inventory: each is unchanged, modified, new, demolished,
    merged or split, and keeps its identity. Update surveys in the order of their dates. The last one of a place may be
    repeated; the same content leaves the inventory unchanged. After an interruption, run the command again.
    """
    check_inputs(given)
    check_figure(figure, given)
    params = parameters(given["profile"], given.pop("params_file"), given.pop("settings"), given.pop("scales"))
    params = with_walls(params, given.pop("outline"))
    from msbdb import api

    with progress_bar(stages_of(given["extract"], "inventory")) as progress:
        report = api.update(given.pop("points"), **given, params=params, progress=progress)
    if figure is not None:
        api.changes(given["db"], survey=given["survey"], figure=figure, overwrite=given["overwrite"])
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
    if is_quiet():
        return
    counts = {kind: n for kind, n in report.counts.items() if kind != "versions"}
    offset = report.offset
    pairs: dict[str, object] = {
        "inventory": "unchanged: this update was applied already" if report.status == "unchanged" else report.status,
        "date": report.date,
        **counts,
        "new versions": report.counts["versions"],
        "offset, m": f"{offset['dx_m']:.2f} east, {offset['dy_m']:.2f} north, {offset['dz_m']:.2f} up",
        "measured on": f"{counted(int(offset['pairs'] or 0), 'pair')} of buildings",
    }
    emit_pairs(pairs, "Inventory")


@command(
    "import",
    examples=(
        "msbdb import cadastre.gpkg --as inventory --db town.sqlite --date 2019-01-01 --id FID --map height=HGT",
        "msbdb import roofs.geojson --as roof-samples --db town.sqlite --map material=MATERIAL",
    ),
)
@click.argument("file", type=INPUT_FILE, metavar="FILE")
@click.option(
    "--as",
    "what",
    type=click.Choice(["inventory", "roof-samples"]),
    required=True,
    help="Footprints that later surveys update, or points with the material of a roof.",
)
@click.option(
    "--db", type=DATABASE, required=True, metavar="PATH_OR_URL", help="A SpatiaLite file or a postgresql:// URL."
)
@click.option("--name", metavar="NAME", help="Name of the imported inventory. [default: the file's name]")
@click.option("--layer", metavar="NAME", help="The layer to read, where the file has several.")
@click.option("--date", type=iso_date, metavar="DATE", help="The day from which the footprints hold. [default: always]")
@click.option(
    "--map",
    "mapping",
    type=assignment,
    multiple=True,
    metavar="NAME=COLUMN",
    help="What a column becomes: height (m) and storeys are measures, material and note those of samples, other names "
    "are attributes; repeatable.",
)
@click.option(
    "--id",
    "id_column",
    metavar="COLUMN",
    help="Column with an id for each building. [default: the places of the buildings]",
)
@click.option("--crs", type=crs_name, metavar="EPSG", help="The file's CRS where it does not state it, like EPSG:2154.")
@shared("json")
def import_(
    *,
    file: Path,
    what: str,
    db: str,
    name: str | None,
    layer: str | None,
    date: str | None,
    mapping: tuple[tuple[str, str], ...],
    id_column: str | None,
    crs: str | None,
    as_json: bool,
) -> None:
    """Import footprints as the start of the inventory, or roof samples.

    FILE is of any vector format. All its columns are kept as attributes of the buildings through every update. The
    first survey measures the buildings, and reports what has changed since.
    """
    from msbdb import api

    if what == "inventory":
        report = api.import_inventory(
            db, file, name=name, layer=layer, date=date, mapping=dict(mapping), id_column=id_column, crs=crs
        )
    else:
        report = api.import_roof_samples(db, file, layer=layer, mapping=dict(mapping), crs=crs)
    if as_json:
        emit_json(report.as_dict())
        return
    rows = "buildings" if what == "inventory" else "samples"
    if is_quiet():
        return
    emit_pairs({"import": report.name, "status": report.status, rows: report.rows})


@command(
    "state",
    examples=(
        'msbdb state town.sqlite 380763480517989761 refuted --note "a crane"',
        "msbdb state town.sqlite 380763480517989761 auto",
    ),
)
@shared("db")
@click.argument("uid", type=click.IntRange(min=1), metavar="UID")
@click.argument("state", type=click.Choice(["confirmed", "refuted", "auto"]), metavar="STATE")
@click.option("--note", default="", metavar="TEXT", help="Why.")
@click.option("--operator", metavar="NAME", help="Who decides it. [default: the user's name]")
def state(*, db: str, uid: int, state: str, note: str, operator: str | None) -> None:
    """Confirm or refute a building by hand, or take that back.

    UID is the building's number in the inventory (column uid of footprint_current). The operator's decision takes
    precedence over the detectors, and is kept through every rebuild and update. A later decision replaces it, and the
    command prints the replaced one.
    """
    from msbdb import api

    decision = None if state == "auto" else state
    before = api.set_state(db, uid, decision, operator=operator or getpass.getuser(), note=note)
    say(f"Building {uid}: {decision or 'decided by the detectors'}.")
    if before is not None:
        why = f" ({before['note']})" if before["note"] else ""
        say(f"Before: {before['state']} by {before['operator']}, {before['decided_at']}{why}.")


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
@click.option(
    "--out", type=OUTPUT_FILE, metavar="FILE", help="Write all rows, by the ending: .gpkg, .geojson, .csv, .parquet …"
)
@click.option("--figure", type=OUTPUT_FILE, metavar="PICTURE", help="Draw the buildings coloured by kind of change.")
@shared("overwrite", "json")
def changes(*, out: Path | None, figure: Path | None, as_json: bool, **options: Any) -> None:  # noqa: ANN401  (the options)
    """Report how the buildings changed between two dates.

    Without --from, the period begins with the first state of each place, which is no change. The result is the net
    change, a row a building: unchanged, modified (outline, height or parts), new, demolished, merged or split. State,
    heights and area are given before and after. Changes by several surveys count as one: raised and then demolished is
    demolished. Buildings that were new and then demolished between the dates are only counted; --each shows them.
    Unchanged buildings are counted and not printed. So are unsure ones, which came or went without ever being
    confirmed.
    """
    from msbdb import api

    found = api.changes(**options, out=out, figure=figure)
    summary = api.summary(found)
    if as_json:
        emit_json(summary)
        return
    for written in (out, figure):
        if written is not None:
            say(f"Wrote {written}.")
    if not found.counts and not found.in_between:
        click.echo("No survey of the period covers a building there.")
        return
    emit_pairs(found.counts | ({"new and demolished in between": found.in_between} if found.in_between else {}))
    rows = summary["changes"]
    if rows:
        emit_table([{name: row[name] for name in SHOWN} for row in rows[:MOST]], "Changes")
    if len(rows) > MOST:
        click.echo(f"... and {len(rows) - MOST} more; --out writes them all.")
