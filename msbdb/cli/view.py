"""``msbdb view``: a map of the buildings."""

from pathlib import Path

import click

from msbdb.cli.command import command
from msbdb.cli.options import OUTPUT_FILE, shared
from msbdb.params import REGION_DETECTORS


@command(
    "view",
    examples=("msbdb view town.sqlite --out town.png", "msbdb view town.sqlite --of flatregions --out zones.png"),
)
@shared("db")
@click.option("--out", type=OUTPUT_FILE, required=True, metavar="FILE.png", help="The picture to write.")
@click.option(
    "--of",
    type=click.Choice(["buildings", *REGION_DETECTORS]),
    default="buildings",
    show_default=True,
    help="What to draw.",
)
@shared("survey")
def view(*, db: str, out: Path, of: str, survey: str | None) -> None:
    """Draw a map of the buildings, or of what another extractor found.

    Parts of buildings are outlined by scale and filled by height, flat regions are coloured by their zone, candidate
    regions by the height scale that accepted them or by their height, on a hillshade of the surface.
    """
    from msbdb import pipeline

    pipeline.view(db, out, survey=survey, of=of)
    click.echo(f"Wrote {out}.")
