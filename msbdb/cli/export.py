"""``msbdb export``: layers for other programs."""

from pathlib import Path

import click

from msbdb.cli.command import command
from msbdb.cli.options import shared


@command(
    "export",
    examples=(
        "msbdb export town.sqlite town.gpkg",
        "msbdb export town.sqlite town.shp --overwrite",
        "msbdb export town.sqlite town.geojson --survey spring",
    ),
)
@shared("db")
@click.argument("out", type=click.Path(path_type=Path), metavar="OUT")
@click.option("--overwrite", is_flag=True, help="Replace files that exist.")
@shared("survey")
def export(*, db: str, out: Path, overwrite: bool, survey: str | None) -> None:
    """Write footprints and parts to a file.

    OUT names the format by its ending: .gpkg (GeoPackage with the layers footprint, part, flat_region,
    candidate_region and, where there are any, together: the footprints of parts and flat regions together), .shp
    (Shapefile of the parts with the paper's names of at most ten characters) or .geojson (the parts in longitude and
    latitude).
    """
    from msbdb import pipeline

    pipeline.export(db, out, survey=survey, overwrite=overwrite)
    click.echo(f"Wrote {out}.")
