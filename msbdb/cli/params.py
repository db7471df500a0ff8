"""``msbdb params`` and ``plan``: every parameter with its provenance, and the values that a survey gives by itself."""

import json
from dataclasses import dataclass
from typing import Any

import click

from msbdb.cli.command import DATABASE, command, shared
from msbdb.cli.inputs import aoi, check_inputs, parameters, sources
from msbdb.cli.output import emit_json, emit_pairs, emit_table
from msbdb.cli.progress import SECONDS, progress_bar
from msbdb.params import PROFILES, as_dict, declared
from msbdb.params import profile as profile_values

PLANNED = ("read", "surface", "cover", "bands", "classes")
"""The stages of a build that a plan needs."""


@dataclass(frozen=True, slots=True)
class Row:
    """One parameter as it is shown."""

    name: str
    value: object
    default: object
    unit: str
    bounds: str
    doc: str
    source: str


@command(
    "params",
    examples=(
        "msbdb params",
        "msbdb params --profile vu2009",
        "msbdb params --toml > mine.toml",
    ),
)
@click.option(
    "--profile", type=click.Choice(list(PROFILES)), default="default", show_default=True, help="Set of values."
)
@click.option("--toml", "form", flag_value="toml", help="Print a parameter file to edit and give to 'build --params'.")
@click.option("--markdown", "form", flag_value="markdown", help="Print the table of the documentation.")
@click.option("--json", "form", flag_value="json", help="Print the result as JSON on the standard output.")
def params(*, profile: str, form: str | None) -> None:
    """List every parameter.

    Each comes with its unit, default, bounds, meaning and provenance: the paper's requirement, or ours and why.
    """
    rows = parameter_rows(profile)
    if form == "json":
        emit_json([{name: getattr(row, name) for name in Row.__slots__} for row in rows])
    elif form == "toml":
        click.echo(toml(profile), nl=False)
    elif form == "markdown":
        click.echo(markdown(), nl=False)
    else:
        emit_table([_shown(row, profile) for row in rows])


@command(
    "plan",
    examples=(
        "msbdb plan --points town.laz",
        "msbdb plan --points tiles/*.laz --ortho cir.tif --json > town.json",
        "msbdb plan town.sqlite --survey 2024",
    ),
    instead=True,
)
@click.argument("db", type=DATABASE, metavar="DB", required=False)
@click.option("--survey", metavar="NAME", help="The survey in the database; needed where there are several.")
@sources
@aoi
@shared("json")
def plan(*, db: str | None, survey: str | None, as_json: bool, **given: Any) -> None:  # noqa: ANN401  (the options)
    """Show the plan of a survey: all values that a tile of it cannot know by itself.

    These are the cells' size, the spacing of the points, the scales, thresholds from histograms, and the classes of
    colours. Give DB for the plan by which a survey was built, or files for the plan that a build of them makes. With
    --json it is a file for 'build --plan': then a tile is built as if it was built with the whole.
    """
    from msbdb import api

    if (db is None) == (not any(given[name] for name in ("points", "dsm", "ndsm"))):
        msg = "Give DB, or the files of a survey by --points, --dsm with --dtm, or --ndsm."
        raise click.UsageError(msg)
    if db is not None:
        found = api.read_plan(db, survey)
    else:
        check_inputs(given)
        own = parameters(given["profile"], given.pop("params_file"), given.pop("settings"), given.pop("scales"))
        with progress_bar({name: SECONDS[name] for name in PLANNED}) as progress:
            found = api.plan(given.pop("points"), **given, params=own, progress=progress)
    if as_json:
        emit_json(found.as_dict())
    else:
        emit_pairs(found.pairs())


def parameter_rows(profile: str = "default") -> list[Row]:
    """Return every parameter of a profile, in the order of the stages."""
    values = as_dict(profile_values(profile))
    rows = []
    for section, item, default in declared():
        meta = item.metadata
        rows.append(
            Row(
                name=f"{section}.{item.name}",
                value=values[section][item.name],
                default=default,
                unit=meta["unit"],
                bounds=_bounds(meta["low"], meta["high"], meta["choices"]),
                doc=meta["doc"],
                source=meta["source"],
            )
        )
    return rows


def toml(profile: str = "default") -> str:
    """Return a parameter file with all values of a profile, each under its explanation."""
    lines = [f"# Parameters of msbdb, profile {profile}. Delete what you do not change."]
    section = ""
    for row in parameter_rows(profile):
        head, _, name = row.name.partition(".")
        if head != section:
            section = head
            lines += ["", f"[{section}]"]
        unit = "" if row.unit == "-" else f" Unit: {row.unit}."
        bounds = f" Bounds: {row.bounds}." if row.bounds else ""
        lines += [f"# {row.doc}{unit}{bounds} Source: {row.source}.", f"{name} = {literal(row.value)}"]
    return "\n".join(lines) + "\n"


def markdown() -> str:
    """Return the documentation's page of parameters: a table a section, and what each profile changes."""
    lines: list[str] = []
    section = ""
    for row in parameter_rows():
        head, _, name = row.name.partition(".")
        if head != section:
            section = head
            lines += ["", f"## {section}", "", "| name | default | unit | bounds | meaning | source |"]
            lines += ["|---|---|---|---|---|---|"]
        cells = (f"`{name}`", f"`{literal(row.default)}`", row.unit, row.bounds, row.doc, row.source)
        lines.append(f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in cells)} |")
    lines += ["", "## Profiles", ""]
    for profile, changes in PROFILES.items():
        pairs = [
            f"`{part}.{name} = {literal(value)}`" for part, items in changes.items() for name, value in items.items()
        ]
        lines.append(f"- **{profile}**: {', '.join(pairs) if pairs else 'the defaults above'}.")
    return "\n".join(lines).lstrip("\n") + "\n"


def literal(value: object) -> str:
    """Return a value as TOML writes it.

    Examples
    --------
    >>> literal((20.0, 50.0)), literal(True), literal("auto"), literal(0.5)
    ('[20.0, 50.0]', 'true', '"auto"', '0.5')
    """
    return json.dumps(value)


def _shown(row: Row, profile: str) -> dict[str, str]:
    """Return a parameter as a line of the table for people; the profile's value where there is one."""
    values = {"default": literal(row.default)}
    if profile != "default":
        values[profile] = literal(row.value) if row.value != row.default else ""
    return {
        "parameter": row.name,
        **values,
        "unit": row.unit,
        "bounds": row.bounds,
        "source": row.source,
        "doc": row.doc,
    }


def _bounds(low: float | None, high: float | None, choices: tuple[str, ...] | None) -> str:
    """Return the bounds or choices of a parameter as text."""
    if choices:
        return ", ".join(choices)
    if low is None and high is None:
        return ""
    return f"{'' if low is None else f'{low:.10g}'} to {'' if high is None else f'{high:.10g}'}".strip()
