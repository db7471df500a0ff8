"""``msbdb db`` and ``doctor``: the commands that look after a database, and after what is installed."""

import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import click

from msbdb.cli.command import DATABASE, OUTPUT_FILE, Command, command, crs_name, shared
from msbdb.cli.output import emit_json, emit_pairs, emit_table, say
from msbdb.cli.progress import progress_bar
from msbdb.errors import counted

UNSOUND = 1
"""Exit code of a check with findings."""

INCOMPLETE = 1
"""Exit code where something that msbdb needs is missing."""


class Commands(click.Group):
    """A command that consists of others, with their examples at the end of its help."""

    @property
    def examples(self) -> tuple[str, ...]:
        """The examples of all of its commands."""
        return tuple(line for made in self.commands.values() if isinstance(made, Command) for line in made.examples)

    def format_epilog(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Close the help with the examples."""
        super().format_epilog(ctx, formatter)
        with formatter.section("Examples"):
            for example in self.examples:
                formatter.write(f"{'':>{formatter.current_indent}}{example}\n")


@click.group("db", cls=Commands)
def db() -> None:
    """Look after a database: make, check, dump and copy it, change its schema, and grant roles."""


@command("create", examples=("msbdb db create town.sqlite --crs EPSG:28992",))
@shared("db")
@click.option("--crs", type=crs_name, required=True, metavar="EPSG", help="The database's one CRS, like EPSG:28992.")
@shared("json")
def create(*, db: str, crs: str, as_json: bool) -> None:
    """Create an empty database; one that exists stays unchanged.

    The CRS must be projected, in metres. It serves files that state none, with a notice. 'msbdb build' creates a
    database by itself in the CRS of its data.
    """
    from msbdb.database import create_database

    made = create_database(db, crs)
    if as_json:
        emit_json({"database": _shown(db), "crs": crs, "created": made})
    else:
        say(f"{'Created' if made else 'It exists already, unchanged:'} {_shown(db)}.")


@command("upgrade", examples=("msbdb db upgrade town.sqlite",))
@shared("db", "json")
def upgrade(*, db: str, as_json: bool) -> None:
    """Upgrade the schema of a database to this msbdb's, without loss."""
    from msbdb.database import upgrade_schema

    before, after = upgrade_schema(db)
    _emit_schema(db, before, after, [], as_json=as_json)


@command(
    "downgrade",
    examples=("msbdb db downgrade town.sqlite", "msbdb db downgrade town.sqlite --to 0004 --force"),
)
@shared("db")
@click.option("--to", metavar="REVISION", help="The schema to go back to. [default: the one before]")
@click.option("--force", is_flag=True, help="Change it even if rows or values are lost.")
@shared("json")
def downgrade(*, db: str, to: str | None, force: bool, as_json: bool) -> None:
    """Change the schema of a database to that of an older msbdb.

    Where the older schema has no place for rows or values, the command lists them and leaves the database unchanged.
    With --force they are deleted.
    """
    from msbdb.database import downgrade_schema

    before, after, lost = downgrade_schema(db, to, force=force)
    _emit_schema(db, before, after, [str(loss) for loss in lost], as_json=as_json)


@command("check", examples=("msbdb db check town.sqlite", "msbdb db check town.sqlite --json"))
@shared("db", "json")
def check(*, db: str, as_json: bool) -> None:
    """Check every row of a database, and report row by row what is wrong.

    Checked are keys and rules, the forest of parts, and the buildings with their trees. Geometries are checked with
    their SRIDs, extents and spatial indexes. The ledger, the kept rasters, the digest of each run, and the intervals of
    the inventory's versions follow. The database stays unchanged. The exit code is 1 when there are findings.
    """
    from dataclasses import asdict

    from msbdb.database import CHECKS, check_database, open_database

    engine = open_database(db)
    with progress_bar() as progress:
        findings = check_database(engine, progress=progress)
    engine.dispose()
    if as_json:
        emit_json({"database": _shown(db), "checks": list(CHECKS), "findings": [asdict(found) for found in findings]})
    elif findings:
        emit_table([asdict(found) for found in findings])
        click.echo(f"{counted(len(findings), 'finding')} in {_shown(db)}.")
    else:
        click.echo(f"{len(CHECKS)} checks passed: {_shown(db)}.")
    if findings:
        raise click.exceptions.Exit(UNSOUND)


@command("dump", examples=("msbdb db dump town.sqlite", "msbdb db dump town.sqlite --provenance --out town.txt"))
@shared("db")
@click.option("--provenance", is_flag=True, help="Also the source files and the notices that name them.")
@click.option("--out", type=OUTPUT_FILE, metavar="FILE", help="Write to this file, complete or not at all.")
@shared("overwrite")
def dump(*, db: str, provenance: bool, out: Path | None, overwrite: bool) -> None:
    """Print the content as text: equal content gives equal bytes, in SpatiaLite and in PostGIS.

    A line of names for each table and a line for each row, as JSON. Timings are left out.
    """
    from msbdb.database import canonical_dump, open_database
    from msbdb.io.files import require_output, write_atomic

    if out is not None:
        require_output(out, overwrite=overwrite, sources=[db])
    engine = open_database(db)
    lines = (f"{line}\n".encode() for line in canonical_dump(engine, provenance=provenance))
    if out is None:
        _write_lines(lines, sys.stdout.buffer)
        return
    with write_atomic(out) as growing, growing.open("wb") as file:
        _write_lines(lines, file)
    say(f"Wrote {out}.")


@command("copy", examples=("msbdb db copy town.sqlite postgresql://me@localhost/town",))
@click.argument("source", type=DATABASE, metavar="FROM")
@click.argument("target", type=DATABASE, metavar="TO")
@shared("json")
def copy(*, source: str, target: str, as_json: bool) -> None:
    """Copy a database into another, of the same or the other kind.

    All rows are written in one transaction. TO must be new or empty, and stays so if the copy fails.
    """
    from msbdb.database import copy_database

    with progress_bar() as progress:
        rows = copy_database(source, target, progress=progress)
    if as_json:
        emit_json({"from": _shown(source), "to": _shown(target), "rows": rows})
    else:
        emit_pairs({"from": _shown(source), "to": _shown(target), "rows": sum(rows.values())})


@command("grant", examples=("msbdb db grant postgresql://me@localhost/town --role reader --to anna",))
@shared("db")
@click.option(
    "--role",
    type=click.Choice(("reader", "operator", "owner", "none")),
    required=True,
    help="reader selects; operator also changes builds, states and samples; owner does all; none has no rights.",
)
@click.option("--to", "user", required=True, metavar="USER", help="A user of the PostgreSQL server.")
def grant(*, db: str, role: str, user: str) -> None:
    """Give a user of a PostGIS database a role, in place of the one that it had.

    Rights are kept through upgrades of the schema. A SpatiaLite file has only the rights of the file system.
    """
    from msbdb.database import grant_role, open_database

    engine = open_database(db)
    grant_role(engine, role, user)
    engine.dispose()
    say(f"The user {user} has the role {role} in {_shown(db)}.")


for _command in (create, upgrade, downgrade, check, dump, copy, grant):
    db.add_command(_command)


def _shown(target: str) -> str:
    """Return a path or URL without its password."""
    from msbdb.database import shown
    from msbdb.database.dialects.dialect import database_url

    return shown(database_url(target))


def _emit_schema(target: str, before: str, after: str, lost: list[str], *, as_json: bool) -> None:
    """Print which schema a database had and has."""
    found: dict[str, Any] = {"database": _shown(target), "before": before, "after": after, "lost": lost}
    if as_json:
        emit_json(found)
    else:
        emit_pairs(found)


def _write_lines(lines: Iterable[bytes], file: Any) -> None:  # noqa: ANN401  (any binary stream)
    """Write lines as they come."""
    for line in lines:
        file.write(line)
    file.flush()


@command("doctor", examples=("msbdb doctor", "msbdb doctor --json"))
@click.option(
    "--db", type=DATABASE, metavar="FILE|URL", help="A database to look at too: its server, PostGIS and schema."
)
@shared("json")
def doctor(*, db: str | None, as_json: bool) -> None:
    """List what is installed, with versions, and what to do about what is missing.

    With --db the server, PostGIS and the schema of a database are looked at too. Nothing is changed. The exit code is
    1 when something that msbdb needs is missing or faulty.
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
        click.echo("Something is missing or faulty, see above." if lacking else "All that msbdb needs is installed.")
    if lacking:
        sys.exit(INCOMPLETE)
