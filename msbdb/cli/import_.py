"""``msbdb import``: what an office has already, as the starting point of the inventory, and roof samples."""

from pathlib import Path

import click

from msbdb.cli.command import command
from msbdb.cli.options import INPUT_FILE, assignment, crs_name, iso_date, shared
from msbdb.cli.output import emit_json, emit_pairs


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
    help="Footprints that surveys update from now on, or points with the material of a roof.",
)
@click.option("--db", required=True, metavar="PATH_OR_URL", help="A SpatiaLite file or a postgresql:// URL.")
@click.option("--name", metavar="NAME", help="Name of the imported inventory. [default: the file's name]")
@click.option("--layer", metavar="NAME", help="The layer to read, where the file has several.")
@click.option(
    "--date", type=iso_date, metavar="DATE", help="The day from which the footprints hold. [default: since ever]"
)
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
    "--id", "id_column", metavar="COLUMN", help="Column that tells the buildings apart, else their places do."
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
    """Take footprints as the start of the inventory, or roof samples.

    FILE is of any vector format. All its columns are kept as attributes of the buildings through every update. The
    first survey measures the buildings and tells what has changed since.
    """
    from msbdb import pipeline

    if what == "inventory":
        report = pipeline.import_inventory(
            db, file, name=name, layer=layer, date=date, mapping=dict(mapping), id_column=id_column, crs=crs
        )
    else:
        report = pipeline.import_roof_samples(db, file, layer=layer, mapping=dict(mapping), crs=crs)
    if as_json:
        emit_json(report.as_dict())
        return
    rows = "buildings" if what == "inventory" else "samples"
    emit_pairs({"import": report.name, "status": report.status, rows: report.rows})
