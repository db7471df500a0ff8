"""``msbdb state``: an operator's word on a building of the inventory."""

import getpass

import click

from msbdb.cli.command import command
from msbdb.cli.options import shared


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
@click.option("--operator", metavar="NAME", help="Who says so. [default: the user's name]")
def state(*, db: str, uid: int, state: str, note: str, operator: str | None) -> None:
    """Confirm or refute a building by hand, or take that back.

    UID is the building's number in the inventory (column uid of footprint_current). The operator's word wins over what
    the extractors say, and holds through every rebuild and update. The last word stands; the one before it is told.
    """
    from msbdb import pipeline

    word = None if state == "auto" else state
    before = pipeline.set_state(db, uid, word, operator=operator or getpass.getuser(), note=note)
    click.echo(f"Building {uid}: {'as the extractors say' if word is None else word}.")
    if before is not None:
        why = f" ({before['note']})" if before["note"] else ""
        click.echo(f"Before: {before['state']} by {before['operator']}, {before['decided_at']}{why}.")
