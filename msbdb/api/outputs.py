"""What comes out of a database: data frames, plain values, maps, files, and the comparison with a reference."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import pandas as pd

    from msbdb.database import ExampleQuery, Place
    from msbdb.evaluate import Evaluation, PointEvaluation


def info(db: str | Path) -> dict[str, Any]:
    """Return what a database holds: a record a run, with counts and notices, and the inventory in numbers."""
    from msbdb.run.contents import info_of

    return info_of(db)


def queries() -> "dict[str, ExampleQuery]":
    """Return the example queries by name: the question that each answers, and its parameters."""
    from msbdb.database import example_queries

    return example_queries()


def query(db: str | Path, name: str, parameters: Mapping[str, object] | None = None) -> "pd.DataFrame":
    """Run an example query.

    Parameters
    ----------
    db : str or path
        The database.
    name : str
        Its name; see `queries`.
    parameters : mapping, optional
        Values of its parameters by name; the others have their defaults.

    Returns
    -------
    DataFrame

    Raises
    ------
    ParameterError
        For an unknown query or parameter, or a value that cannot be one.
    InputError
        For a survey that the database does not have.

    Examples
    --------
    >>> import msbdb
    >>> msbdb.query("town.sqlite", "tallest_buildings", {"count": 3})  # doctest: +SKIP
    """
    from msbdb.database import find_example, opened, run_example

    find_example(name).values(parameters or {})
    with opened(db) as engine:
        return run_example(engine, name, **(parameters or {}))


def why(db: str | Path, x: float, y: float, *, survey: str | None = None, crs: str | None = None) -> "Place":
    """Return what a run found at a place: the building, or the reason why no building was found.

    Parameters
    ----------
    db : str or path
        The database.
    x, y : float
        Easting and northing of the place, metres; in a geographic ``crs`` longitude and latitude, degrees.
    survey : str, optional
        Its name; not needed where the database holds only one.
    crs : str, optional
        CRS of the place, such as 'EPSG:4326'. By default the CRS of the survey.

    Returns
    -------
    Place
        The reason, the building, heights, land cover, and what each detector decided; ``sentences`` says it in words.

    Raises
    ------
    CRSError
        When PROJ does not know the CRS.
    InputError
        When there is no such survey, no name was given and there are several, or the place is outside of its extent.

    Examples
    --------
    >>> import msbdb
    >>> place = msbdb.why("town.sqlite", 809_000.0, 6_307_600.0)  # doctest: +SKIP
    >>> place.reason.name, place.sentences  # doctest: +SKIP
    """
    from msbdb.database import explain_places, opened, read_survey

    with opened(db) as engine:
        if crs is not None:
            from pyproj import CRS, Transformer

            from msbdb.io.crs import parse_crs

            own = CRS.from_wkt(read_survey(engine, survey).crs_wkt)
            x, y = Transformer.from_crs(parse_crs(crs), own, always_xy=True).transform(x, y)
        return explain_places(engine, [(x, y)], survey)[0]


def view(
    db: str | Path,
    out: Path,
    *,
    survey: str | None = None,
    what: str = "parts",
    aoi: Path | None = None,
    ortho: Path | None = None,
    overwrite: bool = False,
) -> None:
    """Write a page of the town in 3-D, or draw a map on a hillshade.

    Parameters
    ----------
    db : str or path
        The database.
    out : path
        The file: ``.html`` for the page, ``.png``, ``.svg`` or ``.pdf`` for a map.
    survey : str, optional
        By default the current inventory; without an inventory all surveys, the newest on top. Surveys too far from the
        newest one for the same map are left out, with a notice.
    what : str
        Of a map: 'parts' by scale and height; 'footprints' by height; 'detectors', how many support each building;
        'change', the net changes of the inventory; 'probability'; 'reasons', why there is no building; 'flatregions' by
        their zone; candidate regions of 'area3d' or 'adaptive' by their height. The page has them all but regions.
    aoi : path, optional
        A file of polygons: draw what meets them, and the surface within their bounds.
    ortho : path, optional
        An orthophoto of any bands, grid and CRS, which the page contains as a layer of the ground.
    overwrite : bool
        Replace the file if it exists.

    Raises
    ------
    InputError
        For another ending, an unknown survey or map, an area beside the surveys, or a page of more buildings and parts
        than a browser can show.
    FileError
        When the file exists already, or cannot be written.
    MissingDependencyError
        When this copy of msbdb lacks MapLibre GL JS, which the page contains.

    Notes
    -----
    The page is one file that opens without a network. It shows the dates of the inventory, or the surveys of a database
    without an inventory; docs/view.md describes it.
    """
    from msbdb.io.files import PAGE

    aoi, ortho = (None if path is None else Path(path) for path in (aoi, ortho))
    if Path(out).suffix.lower() == PAGE:
        from msbdb.run.townpage import view_page

        view_page(db, Path(out), survey=survey, what=what, aoi=aoi, ortho=ortho, overwrite=overwrite)
        return
    if ortho is not None:
        from msbdb.errors import InputError

        msg = "An orthophoto is a layer of the page. Leave out --ortho, or write a page: .html."
        raise InputError(msg)
    from msbdb.run.contents import draw

    draw(db, Path(out), survey=survey, what=what, aoi=aoi, overwrite=overwrite)


def serve(
    db: str | Path,
    *,
    host: str = "127.0.0.1",
    port: int = 8080,
    url: str | None = None,
    started: Callable[[str], None] = print,
) -> None:
    """Serve a database to browsers and GIS clients until an interrupt; nothing can be written through it.

    Parameters
    ----------
    db : str or path
        The database.
    host : str
        The address to listen at. The default one is reached from this machine alone.
    port : int
        0 takes a free one.
    url : str, optional
        The address at which clients find the server, where it stands behind another one.
    started : callable
        Called with the address as soon as the server listens.

    Raises
    ------
    DatabaseError
        When the database cannot be read.
    InputError
        When the server cannot listen at this address.
    MissingDependencyError
        When pygeoapi or waitress is not installed.

    Notes
    -----
    At ``/`` are OGC API Features and Tiles, at ``/page`` the page in 3-D; docs/serve.md describes both.
    """
    try:
        from msbdb.serve.httpserver import run_server
    except ModuleNotFoundError as error:
        if str(error.name).startswith("msbdb"):
            raise
        from msbdb.errors import MissingDependencyError

        msg = f'The server needs the library {error.name}. Install it with: pip install "msbdb[serve]"'
        raise MissingDependencyError(msg) from error
    run_server(str(db), host=host, port=port, url=url, started=started)


def export(
    db: str | Path,
    out: str | Path,
    *,
    what: str | None = None,
    survey: str | None = None,
    layers: Sequence[str] | str = (),
    crs: str | None = None,
    aoi: str | Path | None = None,
    at: str | None = None,
    format: str | None = None,
    options: Mapping[str, str] | None = None,
    overwrite: bool = False,
) -> dict[str, int]:
    """Write layers to a file for other programs, as one committed state.

    Parameters
    ----------
    db : str or path
        The database.
    out : str or path
        The file. Its ending decides the format: .gpkg, .geojson, .fgb, .parquet, .shp, .csv, .kml, .dxf, and others.
    what : {'current', 'survey', 'changes', 'parts', 'evidence'}, optional
        The inventory with its parts and regions; what a survey found; the net changes since the first state of each
        place; the parts alone; or buildings, parts and regions with what each detector found. By default 'survey'
        where one is named, else 'current'; where there is no inventory, all surveys, the newest first.
    survey : str, optional
        The survey, for 'survey', 'parts' and 'evidence'.
    layers : sequence of str
        Some of the layers. By default all, or the main one where the format holds one.
    crs : str, optional
        The CRS of the file, such as 'EPSG:4326'. By default that of the database; longitude and latitude for GeoJSON
        and KML.
    aoi : path, optional
        A file of polygons: what meets them is written as a whole, and of buildings all parts.
    at : str, optional
        The inventory on this day, ISO 8601; with 'changes', the changes up to it.
    format : str, optional
        A format by its name, where others have the same ending; a key of `msbdb.export.FORMATS`.
    options : mapping of str to str, optional
        The format's own options.
    overwrite : bool
        Replace files that exist.

    Returns
    -------
    dict
        The number of rows of each layer that was written.

    Raises
    ------
    InputError
        For an unknown format, layer, survey or option, or options that contradict each other.
    FileError
        When the file exists already, or cannot be written.

    Notes
    -----
    Ids are texts in files. A notice reports what was taken where that is not one survey. An empty database gives an
    empty file. docs/export.md has the fields.
    """
    from msbdb.run.export import export_database

    return export_database(
        db,
        Path(out),
        what=what,
        survey=survey,
        layers=[layers] if isinstance(layers, str) else list(layers),
        crs=crs,
        aoi=None if aoi is None else Path(aoi),
        at=at,
        name=format,
        options=options or {},
        overwrite=overwrite,
    )


def qgis(db: str | Path, out: str | Path, *, overwrite: bool = False) -> list[str]:
    """Write a project of QGIS whose layers are in the database: nothing is copied.

    Parameters
    ----------
    db : str or path
        The database. The project names a file by its relative path, and a server without the password.
    out : str or path
        Ends in .qgz.
    overwrite : bool
        Replace the file if it exists.

    Returns
    -------
    list of str
        The titles of the layers: buildings by height and by state, parts by scale, evidence by detector, and changes
        where there is an inventory.

    Raises
    ------
    FileError
        When the file exists already, or cannot be written.
    """
    from msbdb.run.export import write_project

    return write_project(db, Path(out), overwrite=overwrite)


def evaluate(
    db: str | Path,
    reference: Path,
    *,
    layer: str | None = None,
    aoi: Path | None = None,
    crs: str | None = None,
    height: str | None = None,
    overlap: float = 0.5,
    cell_m: float = 0.5,
    survey: str | None = None,
    of: str = "buildings",
) -> "Evaluation":
    """Compare what was found in a survey with a reference.

    Parameters
    ----------
    db : str or path
        The database.
    reference : path
        Footprints in any vector format, or LAS or LAZ points whose class 6 is the truth.
    layer : str, optional
        Layer of a vector reference.
    aoi : path, optional
        Polygons within which to compare.
    crs : str, optional
        The reference's CRS where it states none.
    height : str, optional
        Column of the reference that holds heights above ground, metres; one called ``height`` (in any case) is found.
    overlap, cell_m : float
        Share that counts as found; cell of the grid on which areas are compared, metres.
    survey : str, optional
        Not needed where the database holds one.
    of : {'buildings', 'confirmed', 'parts', 'flatregions', 'area3d', 'adaptive'}
        What is compared: all buildings, the confirmed ones, the parts of all scales, the flat regions, or the
        candidate regions of a detector on points.
    """
    from msbdb.run.evaluate import evaluate_survey

    return evaluate_survey(
        db,
        Path(reference),
        layer=layer,
        aoi=aoi,
        crs=crs,
        height=height,
        overlap=overlap,
        cell_m=cell_m,
        survey=survey,
        of=of,
    )


def evaluate_points(
    found: str | Path, reference: Path, *, crs: str | None = None, survey: str | None = None, of: str = "buildings"
) -> "PointEvaluation":
    """Compare by point what was found with points whose class 6 is the truth (C20, C21).

    Parameters
    ----------
    found : str or path
        A LAS or LAZ file of the same points whose class 6 was found, or a database.
    reference : path
        A LAS or LAZ file. Its noise points (classes 7 and 18) and points with absurd coordinates are not scored. With a
        database, withheld and lone points are not scored either, because no build reads them.
    crs : str, optional
        CRS of files that state none.
    survey : str, optional
        Survey of the database; not needed where it holds one.
    of : str
        What of the database is compared, as for `msbdb.api.evaluate`.

    Returns
    -------
    PointEvaluation

    Raises
    ------
    InputError
        When the reference is no point file, or the two files are not of the same points.
    CRSError
        When the CRS differ.

    Notes
    -----
    The database keeps heights above ground on the lattice, and no points. A point of the reference counts as found
    when its cell's centre lies in an outline and it is high enough above the terrain, by the run's mask. The terrain
    is the surface of the reference's own first echoes, minus the height that the database has there.
    """
    from msbdb.run.evaluate import evaluate_file

    return evaluate_file(found, Path(reference), crs=crs, survey=survey, of=of)
