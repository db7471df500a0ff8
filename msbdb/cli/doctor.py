"""``msbdb doctor``: what is installed, and what to do about what is missing."""

import sys

import click

from msbdb.cli.command import DATABASE, command, shared
from msbdb.cli.output import emit_json, emit_table

INCOMPLETE = 1
"""Exit code where something that msbdb needs is missing."""


@command("doctor", examples=("msbdb doctor", "msbdb doctor --json"))
@click.option(
    "--db", type=DATABASE, metavar="FILE|URL", help="A database to look at too: its server, PostGIS and schema."
)
@shared("json")
def doctor(*, db: str | None, as_json: bool) -> None:
    """List what is installed, with versions, and what to do about what is missing.

    With --db the server, PostGIS and the schema of a database are looked at too. Nothing is changed. The exit code is
    1 when something that msbdb needs is missing.
    """
    from dataclasses import asdict

    from msbdb.database.admin.installation import installation

    found = installation(db)
    lacking = [component for component in found if component.state not in ("ok", "optional")]
    if as_json:
        emit_json({"complete": not lacking, "components": [asdict(component) for component in found]})
    else:
        emit_table([{"component": one.name, "version": one.version, "state": one.state} for one in found])
        for component in found:
            if component.advice:
                click.echo(f"{component.name}: {component.advice}")
        click.echo("Something is missing, see above." if lacking else "All that msbdb needs is installed.")
    if lacking:
        sys.exit(INCOMPLETE)
