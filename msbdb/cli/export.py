"""``msbdb export``, ``qgis`` and ``serve``: layers of a database as files, as a project of QGIS, and by a server."""

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


@command(
    "serve",
    examples=(
        "msbdb serve town.sqlite",
        "msbdb serve postgresql://reader@localhost/town --port 8081",
        "msbdb serve town.sqlite --host 0.0.0.0 --url https://town.example.org",
    ),
)
@shared("db")
@click.option(
    "--host",
    default="127.0.0.1",
    show_default=True,
    metavar="ADDRESS",
    help="The address to listen at; by default this machine alone reaches it. 0.0.0.0 opens it to the network.",
)
@click.option(
    "--port", type=click.IntRange(0, 65535), default=8080, show_default=True, help="The port; 0 takes a free one."
)
@click.option(
    "--url", metavar="URL", help="The address at which clients find the server, where it stands behind another one."
)
def serve(*, db: str, host: str, port: int, url: str | None) -> None:
    """Serve a database to browsers and GIS clients, by OGC API Features and Tiles and with the page in 3-D.

    Nothing can be written through it. There are no users and no passwords: give --host only in a network that you
    trust, or put a web server with both before it. Ctrl-C ends it. It needs: pip install "msbdb[serve]"
    """
    from msbdb import api

    def started(address: str) -> None:
        say(f"Page:             {address}/page")
        say(f"OGC API Features: {address}/")

    api.serve(db, host=host, port=port, url=url, started=started)
