"""``msbdb export`` and ``qgis``: layers of a database as files, and as a project of QGIS."""

from pathlib import Path

import click

from msbdb.cli.command import INPUT_FILE, OUTPUT_FILE, command, crs_name, iso_date, parameter, shared
from msbdb.cli.output import say

WHATS = ("current", "survey", "changes", "parts", "evidence")
"""What may be exported; told again here, as the export's own room takes time to load."""


def _formats(_ctx: click.Context, _param: click.Parameter, incomplete: str) -> list[str]:
    """Return the names of formats that a shell completes."""
    from msbdb.export import FORMATS

    return [name for name in FORMATS if name.startswith(incomplete)]


def _layers(ctx: click.Context, _param: click.Parameter, incomplete: str) -> list[str]:
    """Return the layers that a shell completes."""
    from msbdb.run.export import LAYERS_OF

    what = ctx.params.get("what") or "current"
    return [name for name in LAYERS_OF[what] if name.startswith(incomplete)]


@command(
    "export",
    examples=(
        "msbdb export town.sqlite town.gpkg",
        "msbdb export town.sqlite district.parquet --aoi district.gpkg --at 2023-01-01",
        "msbdb export town.sqlite parts.shp --what parts --crs EPSG:25832 --overwrite",
        "msbdb export town.sqlite spring.geojson --survey spring",
        "msbdb export town.sqlite changes.csv --what changes",
    ),
)
@shared("db")
@click.argument("out", type=OUTPUT_FILE, metavar="OUT")
@click.option(
    "--what",
    type=click.Choice(WHATS),
    help="The inventory, one survey, changes, parts, or evidence by detector. [default: current; survey with --survey]",
)
@click.option(
    "--layer",
    "layers",
    multiple=True,
    metavar="NAME",
    shell_complete=_layers,
    help="Write this layer alone; repeatable. [default: all, or the main one where the format holds one]",
)
@click.option(
    "--crs", type=crs_name, metavar="EPSG", help="CRS of the file. [default: the database's; EPSG:4326 for .geojson]"
)
@click.option("--aoi", type=INPUT_FILE, metavar="FILE", help="Polygons: buildings that meet them, with all parts.")
@click.option("--at", type=iso_date, metavar="DATE", help="The inventory on this day; changes up to it.")
@click.option(
    "--format",
    metavar="NAME",
    shell_complete=_formats,
    help="The format, where several have the same ending. [default: the usual one of the ending]",
)
@click.option(
    "--option",
    "given",
    type=parameter,
    multiple=True,
    metavar="NAME=VALUE",
    help="An option of the format; repeatable.",
)
@shared("overwrite", "survey")
def export(
    *,
    db: str,
    out: Path,
    what: str | None,
    layers: tuple[str, ...],
    crs: str | None,
    aoi: Path | None,
    at: str | None,
    format: str | None,
    given: tuple[tuple[str, str], ...],
    overwrite: bool,
    survey: str | None,
) -> None:
    """Write the buildings to a file for other programs.

    The ending of OUT decides the format: .gpkg (GeoPackage), .geojson, .fgb (FlatGeobuf), .parquet (GeoParquet), .shp
    (Shapefile), .csv, .kml or .dxf. A GeoPackage has all layers, with styles, names in words, and a project for QGIS;
    the other formats have one layer. docs/export.md has the fields of each.

    Formats with a schema of their own have buildings with their parts: .city.json (CityJSON), .city.jsonl
    (CityJSONSeq), .glb (glTF), .xml (exposure for OpenQuake), .building.parquet and .building_part.parquet (Overture),
    and .inspire.gpkg (INSPIRE). docs/export-standards.md has their fields and options.

    By default the file has the current inventory: footprint and part, flat_region and candidate_region. Without an
    inventory all surveys are written, the newest first, with the survey of each row. An empty database gives an empty
    file. Outlines are edges of roofs, not walls at the ground. Ids are texts.
    """
    from msbdb import api

    rows = api.export(
        db,
        out,
        what=what,
        survey=survey,
        layers=layers,
        crs=crs,
        aoi=aoi,
        at=at,
        format=format,
        options=dict(given),
        overwrite=overwrite,
    )
    say(f"Wrote {out}: {', '.join(f'{name} {count}' for name, count in rows.items())}.")


@command(
    "qgis",
    examples=(
        "msbdb qgis town.sqlite --out town.qgz",
        "msbdb qgis postgresql://me@localhost/town --out town.qgz --overwrite",
    ),
)
@shared("db")
@click.option("--out", type=OUTPUT_FILE, required=True, metavar="FILE.qgz", help="The project to write.")
@shared("overwrite")
def qgis(*, db: str, out: Path, overwrite: bool) -> None:
    """Write a project of QGIS that shows the database.

    The layers are buildings by height and by state, parts by scale, the evidence of the detectors, and changes where
    there is an inventory. Columns have names in words with units. The form of a building lists its parts, and that of a
    part the parts on it. A file is named by its relative path, a server without the password.
    """
    from msbdb import api

    titles = api.qgis(db, out, overwrite=overwrite)
    say(f"Wrote {out}: {', '.join(titles)}.")
