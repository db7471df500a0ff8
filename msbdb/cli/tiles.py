"""``msbdb tiles`` and the options of a build in tiles: how large they are, who builds them, and how far each is."""

from collections import Counter

import click

from msbdb.cli.command import DATABASE, F, command, shared
from msbdb.cli.output import emit_json, emit_pairs, emit_table
from msbdb.errors import counted

MOST = 50
"""Ours: so many tiles are listed for people; of more only those that are not done."""

_OPTIONS = (
    click.option(
        "--tile",
        type=click.FloatRange(min=0, min_open=True),
        metavar="METRES",
        help="Build in square tiles of this side, one in memory at a time, whatever the area. [default: one piece; "
        "with --workers, --scheduler or --resume tiles for 2 GiB of memory each]",
    ),
    click.option(
        "--workers",
        type=click.IntRange(min=1),
        metavar="N",
        help="Build the tiles by so many processes of this machine; needs pip install 'msbdb[cluster]'.",
    ),
    click.option(
        "--scheduler",
        metavar="ADDRESS",
        help="Build the tiles by the workers of a scheduler of dask.distributed: tcp://HOST:PORT, or its JSON file.",
    ),
    click.option(
        "--resume", is_flag=True, help="Repeat only the tiles that an interrupted build of the same did not finish."
    ),
)


def tiled(function: F) -> F:
    """Decorate a command with the options of a build in tiles."""
    for option in reversed(_OPTIONS):
        function = option(function)
    return function


@command(
    "tiles",
    examples=("msbdb tiles town.sqlite", "msbdb tiles postgresql://me@localhost/town --survey 2024 --json"),
)
@click.argument("db", type=DATABASE, metavar="DB")
@click.option("--survey", metavar="NAME", help="The survey. [default: all that are built in tiles]")
@shared("json")
def tiles(*, db: str, survey: str | None, as_json: bool) -> None:
    """Show how far the tiles of a survey are that is built by 'msbdb build --tile'.

    A tile is queued, running, done or failed. The survey is written when all of its tiles are done. After a failure or
    an interruption, the same command with --resume repeats only the others.
    """
    from msbdb import api

    found = api.tiles(db, survey)
    if as_json:
        emit_json([one.as_dict() for one in found])
        return
    for name in sorted({one.survey for one in found}):
        own = [one for one in found if one.survey == name]
        states = Counter(one.state for one in own)
        emit_pairs(
            {
                "survey": name,
                "tiles": f"{len(own):,}: {', '.join(f'{count:,} {state}' for state, count in sorted(states.items()))}",
                "points": sum(one.points for one in own),
                "time": f"{sum(one.seconds for one in own):.0f} s",
            }
        )
        listed = own if len(own) <= MOST else [one for one in own if one.state != "done"][:MOST]
        records = [
            {
                "row": one.tile_row,
                "column": one.tile_column,
                "west": one.west,
                "south": one.south,
                "state": one.state,
                "points": one.points,
                "halo_m": one.halo_m,
                "seconds": one.seconds,
                "reason": one.reason,
            }
            for one in listed
        ]
        if records:
            emit_table(records, counted(len(records), "tile"))
    if not found:
        click.echo("No survey of this database is built in tiles.")
