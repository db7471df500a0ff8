"""``msbdb info``, ``why``, ``view``, ``classes`` and ``evaluate``: what a database holds, and how well."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from click.core import ParameterSource

from msbdb.cli.build import emit_report
from msbdb.cli.command import (
    DATABASE,
    INPUT_FILE,
    OUTPUT_FILE,
    class_label,
    command,
    crs_name,
    declared_range,
    parameter,
    place,
    shared,
)
from msbdb.cli.output import emit, emit_json, emit_pairs, emit_table, refused, say
from msbdb.cli.progress import progress_bar, stages_of
from msbdb.params import REGION_DETECTORS, EvaluateParams

if TYPE_CHECKING:
    from msbdb.evaluate import Evaluation, PointEvaluation

BY_AREA = ("layer", "aoi", "height", "overlap", "cell_m")
"""Options without effect by point."""

BY_DATABASE = ("of", "survey")
"""Options without effect for a file of points."""


@command("info", examples=("msbdb info town.sqlite", "msbdb info postgresql://me@localhost/town --json"))
@shared("db", "json")
def info(*, db: str, as_json: bool) -> None:
    """Show what a database holds.

    The inventory comes first: its current buildings, and what each survey changed. The surveys follow with their runs
    and counts. With --json also what each run decided itself: the ground filter, the scales, the scaling of the bands
    and the centres of the classes.
    """
    from msbdb import api

    result = api.info(db)
    if as_json:
        emit_json(result)
        return
    runs, inventory = result.pop("runs", []), result.pop("inventory", {})
    emit(result)
    if inventory:
        _emit_inventory(inventory)
    elif runs:
        click.echo("\nNo inventory yet: 'msbdb update' and 'msbdb import' begin one.")
    for run in runs:
        _emit_run(run)
    if not runs:
        click.echo("No survey yet: 'msbdb build' adds one.")


def _emit_inventory(inventory: dict[str, Any]) -> None:
    """Print the inventory: buildings by state, and a line for each import and update."""
    states = {name: count for name, count in inventory["buildings"].items() if name != "all"}
    words = ", ".join(f"{count:,} {state}" for state, count in states.items())
    current = f"{inventory['buildings']['all']:,}{f': {words}' if words else ''}"
    emit_pairs({"current buildings": current, "decided by operators": inventory["decided"]}, "Inventory")
    kinds = list(dict.fromkeys(kind for event in inventory["events"] for kind in event["counts"] if kind != "versions"))
    rows = [
        {"date": event["date"], "name": event["name"], "kind": event["kind"]}
        | {kind: event["counts"].get(kind, 0 if event["kind"] == "update" else None) for kind in kinds}
        | {"new versions": event["counts"].get("versions", 0)}
        for event in inventory["events"]
    ]
    emit_table(rows, "Inventory · imports and updates")


def _emit_run(run: dict[str, Any]) -> None:
    """Print a survey and its run."""
    record, chosen = run.pop("survey_record", {}), run.pop("chosen", {})
    sources, notices = record.get("sources", ()), run.pop("notices", ())
    name, regions = run.pop("survey", "?"), run.pop("candidate_regions", {})
    west, south, east, north = record.get("bounds", [float("nan")] * 4)
    run["refused candidates"] = refused(run.pop("rejected"), run.pop("rejected_rows"))
    run |= {f"{method}_regions": count for method, count in regions.items()}
    run |= {"ground_filter": chosen.get("ground_filter"), "vertical_crs": record.get("vertical_crs")}
    run["extent"] = f"east {west:.1f} to {east:.1f}, north {south:.1f} to {north:.1f}"
    emit_pairs({name_: value for name_, value in run.items() if value not in (None, "")}, f"Survey {name}")
    if sources:
        short = [{**source, "sha256": f"{source['sha256'][:12]}..."} for source in sources]
        emit_table(short, f"Survey {name} · files")
    for sentence in notices:
        click.echo(f"Notice: {sentence}")


def _names(_ctx: click.Context, _param: click.Parameter, incomplete: str) -> list[str]:
    """Return the queries that a shell completes."""
    from msbdb.database.schema.sqlfiles import sql_names

    return [name for name in sql_names("queries") if name.startswith(incomplete)]


def _parameters(ctx: click.Context, _param: click.Parameter, incomplete: str) -> list[str]:
    """Return the parameters of the named query that a shell completes."""
    from msbdb.database import example_queries

    known = example_queries()
    # An option without its value ends the parsing, and leaves the words before it in ctx.args.
    chosen = next((known[word] for word in (ctx.params.get("name"), *ctx.args) if word in known), None)
    return [f"{name}=" for name in (chosen.defaults if chosen else ()) if name.startswith(incomplete)]


@command(
    "query",
    examples=(
        "msbdb query --list",
        "msbdb query town.sqlite tallest_buildings",
        "msbdb query town.sqlite tall_buildings_near --param storeys=3 --param easting=85210 --param northing=446512",
        "msbdb query town.sqlite storeys_histogram --param survey=spring --json",
    ),
)
@click.argument("db", type=DATABASE, metavar="DB", required=False)
@click.argument("name", metavar="NAME", required=False, shell_complete=_names)
@click.option(
    "--param",
    "given",
    type=parameter,
    multiple=True,
    metavar="NAME=VALUE",
    shell_complete=_parameters,
    help="A value of a parameter in place of its default; repeatable.",
)
@click.option("--list", "listed", is_flag=True, help="List the queries with their parameters; needs no database.")
@shared("json")
def query(*, db: str | None, name: str | None, given: tuple[tuple[str, str], ...], listed: bool, as_json: bool) -> None:
    """Run one of the example queries, and print its rows.

    The same queries are files of SQL, in the folder schema/queries, for any client of the database.
    """
    from msbdb import api

    if listed:
        _list_queries(as_json=as_json)
        return
    if db is None or name is None:
        msg = "Give DB and the NAME of a query; 'msbdb query --list' shows the names."
        raise click.UsageError(msg)
    twice = [own for own, _ in given if [other for other, _ in given].count(own) > 1]
    if twice:
        msg = f"--param {twice[0]} is given more than once; give it once."
        raise click.UsageError(msg)
    found = api.query(db, name, dict(given))
    plain = found.astype(object).where(found.notna(), None)
    rows = [dict(zip(plain.columns, row, strict=True)) for row in plain.itertuples(index=False)]
    if as_json:
        emit_json({"query": name, "parameters": api.queries()[name].values(dict(given)), "rows": rows})
    elif rows:
        emit_table(rows)
    else:
        click.echo("No row answers this query.")


def _list_queries(*, as_json: bool) -> None:
    """Print each query with its question and its parameters."""
    from msbdb import api

    found = api.queries().values()
    if as_json:
        names = ("name", "title", "defaults", "meanings")
        emit_json([{name: getattr(query, name) for name in names} for query in found])
        return
    for query in found:
        click.secho(query.name, bold=True)
        click.echo(f"  {query.title}")
        for name, meaning in query.meanings.items():
            default = query.defaults[name]
            shown = f"{default:g}" if isinstance(default, float) else default
            click.echo(f"    {name if shown is None else f'{name}={shown}'}  {meaning}")


@command(
    "why",
    examples=(
        "msbdb why town.sqlite --at 85210.5,446512",
        "msbdb why town.sqlite --at 4.3571,52.0116 --crs EPSG:4326 --json",
    ),
)
@shared("db")
@click.option(
    "--at",
    type=place,
    required=True,
    metavar="X,Y",
    help="The place: easting and northing; longitude and latitude in a geographic CRS.",
)
@click.option("--crs", type=crs_name, metavar="EPSG", help="CRS of the place. [default: that of the survey]")
@shared("survey", "json")
def why(*, db: str, at: tuple[float, float], crs: str | None, survey: str | None, as_json: bool) -> None:
    """Show the building at a place, or why no building was found there.

    The answer has the building or the decisive reason, the height above ground, the land cover, and what each detector
    decided there. A place outside of the survey ends with an error.
    """
    from dataclasses import asdict

    from msbdb import api

    found = api.why(db, *at, survey=survey, crs=crs)
    if as_json:
        name = None if found.reason is None else found.reason.name.lower()
        emit_json(asdict(found) | {"reason": name, "sentences": found.sentences})
    else:
        click.echo(f"{found.survey} at {found.easting:.1f}, {found.northing:.1f}")
        for sentence in found.sentences:
            click.echo(sentence)


@command(
    "view",
    examples=(
        "msbdb view town.sqlite --out town.html",
        "msbdb view town.sqlite --ortho rgb.tif --out town.html",
        "msbdb view town.sqlite --out town.png",
        "msbdb view town.sqlite --what reasons --out reasons.pdf",
        "msbdb view town.sqlite --what flatregions --aoi centre.gpkg --out zones.png",
    ),
)
@shared("db")
@click.option(
    "--out",
    type=OUTPUT_FILE,
    required=True,
    metavar="FILE",
    help="The file: .html for a page in 3-D; .png, .svg or .pdf for a map.",
)
@click.option(
    "--what",
    type=click.Choice(["parts", "footprints", "detectors", "change", "probability", "reasons", *REGION_DETECTORS]),
    default="parts",
    show_default=True,
    help="What a map shows; the page has all but regions.",
)
@click.option("--aoi", type=INPUT_FILE, metavar="FILE", help="Polygons: draw what meets them, within their bounds.")
@click.option("--ortho", type=INPUT_FILE, metavar="FILE", help="An orthophoto as a layer of the page.")
@shared("overwrite", "survey")
def view(
    *, db: str, out: Path, what: str, aoi: Path | None, ortho: Path | None, overwrite: bool, survey: str | None
) -> None:
    """Write a page of the town in 3-D, or draw a map of its buildings, of the reasons for none, or of regions.

    The page is one file that any browser opens without a network: parts as blocks from coarse to fine, colours, dates
    with what changed, a building's tree and evidence, and why there is no building at a place. Maps lie on a hillshade
    of the surface. Parts of buildings are outlined by scale and filled by height. Footprints are filled by height, by
    the number of detectors that support them, or by probability. Changes are those of 'msbdb changes'. Flat regions
    are coloured by their zone. Candidate regions are coloured by the height scale that accepted them, or by their
    height. Without --survey, the inventory is shown; without an inventory all surveys near the newest, which is on top.
    """
    from msbdb import api

    api.view(db, out, survey=survey, what=what, aoi=aoi, ortho=ortho, overwrite=overwrite)
    say(f"Wrote {out}.")


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
        with progress_bar(stages_of(["multiscale", *REGION_DETECTORS])) as progress:
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


@command(
    "evaluate",
    examples=(
        "msbdb evaluate town.sqlite --reference cadastre.gpkg --layer buildings --aoi area.gpkg",
        "msbdb evaluate town.sqlite --reference classified.laz --crs EPSG:28992 --json",
        "msbdb evaluate town.sqlite --reference classified.laz --by point --of area3d",
        "msbdb evaluate found.laz --reference classified.laz",
    ),
)
@click.argument("db", type=DATABASE, metavar="DB_OR_POINTS")
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
def evaluate(*, db: str, reference: Path, by: str | None, as_json: bool, **options: Any) -> None:  # noqa: ANN401  (options)
    """Compare the footprints of a database, or the class 6 of a point file, with a reference.

    Three lines say how good it is. The report that follows counts by area, by object (all, and those over 50 m2), by
    shape and by height, as the papers do. By point, it counts points. A point file is compared with a classified one of
    the same points.
    """
    from msbdb import api

    is_file = Path(db).suffix.lower() in (".las", ".laz")
    found: Evaluation | PointEvaluation
    if is_file or by == "point":
        _refuse(BY_AREA, "a comparison by point")
        if is_file:
            _refuse(BY_DATABASE, f"a file of points, {db}")
        if by == "area":
            msg = f"A file of points is compared by point, {db}; leave out --by area, or name a database."
            raise click.UsageError(msg)
        how = {name: value for name, value in options.items() if name not in BY_AREA}
        found = api.evaluate_points(db, reference, **how)
    else:
        found = api.evaluate(db, reference, **options)
    if as_json:
        emit_json(found.as_dict())
        return
    for sentence in found.sentences:
        click.echo(sentence)
    emit(found.as_dict())


def _refuse(names: tuple[str, ...], what: str) -> None:
    """Refuse options that were given on the command line and would have no effect."""
    ctx = click.get_current_context()
    flags = {str(param.name): param.opts[-1] for param in ctx.command.params}
    given = [flags[name] for name in names if ctx.get_parameter_source(name) is ParameterSource.COMMANDLINE]
    if given:
        msg = f"{', '.join(given)} has no meaning for {what}; leave it out."
        raise click.UsageError(msg)
