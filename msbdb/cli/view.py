"""``msbdb view``: a map of the buildings."""

from pathlib import Path

import click

from msbdb.cli.command import command
from msbdb.cli.options import OUTPUT_FILE, shared


@command("view", examples=("msbdb view town.sqlite --out town.png",))
@shared("db")
@click.option("--out", type=OUTPUT_FILE, required=True, metavar="FILE.png", help="The picture to write.")
@shared("survey")
def view(*, db: str, out: Path, survey: str | None) -> None:
    """Draw a map of the buildings.

    Their parts are outlined by scale and filled by height, on a hillshade of the surface.
    """
    from msbdb import pipeline

    pipeline.view(db, out, survey=survey)
    click.echo(f"Wrote {out}.")
