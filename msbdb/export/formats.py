"""The formats of exported files, by name and by the ending of the file; a new one is a function and a line here."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Protocol

from msbdb.errors import InputError
from msbdb.export.content import Content
from msbdb.export.geopackage import write_geopackage
from msbdb.export.plainfiles import (
    write_csv,
    write_dxf,
    write_flatgeobuf,
    write_geojson,
    write_kml,
    write_parquet,
    write_shapefile,
)
from msbdb.export.standards.cityjson import write_cityjson, write_cityjsonseq
from msbdb.export.standards.exposure import OPTIONS as EXPOSURE
from msbdb.export.standards.exposure import write_exposure
from msbdb.export.standards.gltf import write_gltf
from msbdb.export.standards.inspire import OPTIONS as INSPIRE
from msbdb.export.standards.inspire import write_inspire
from msbdb.export.standards.overture import write_overture, write_parts
from msbdb.io.files import require_output

NO_OPTIONS: Mapping[str, str] = MappingProxyType({})

TOWN = ("footprint", "part")
"""The layers of formats with buildings and their parts."""


class Writer(Protocol):
    """Writes one file, completely or not at all."""

    def __call__(self, content: Content, path: Path, options: Mapping[str, str], /) -> None:
        """Write the content's layers; an existing file is replaced. ``options`` are those that the format declares."""


@dataclass(frozen=True, slots=True)
class Format:
    """A format of files.

    Parameters
    ----------
    name : str
        The word by which ``--format`` names it.
    title : str
        Its name for people.
    suffixes : tuple of str
        Endings of its files, in lower case with their dots; an ending may have two dots.
    write : Writer
        Writes a file. Libraries that take time to load are imported when it is called.
    single : bool
        A file holds one layer.
    needs : tuple of str
        The layers that it is made of, which are read whatever else is chosen; empty where it takes any layers. With
        ``single``, the layer that it takes by default.
    options : mapping of str to str
        Its own options by name, with their meaning.
    encoded : bool
        It takes geometries as WKB, too, which need less memory.
    """

    name: str
    title: str
    suffixes: tuple[str, ...]
    write: Writer
    single: bool = False
    needs: tuple[str, ...] = ()
    options: Mapping[str, str] = field(default_factory=lambda: NO_OPTIONS)
    encoded: bool = False


FORMATS: dict[str, Format] = {
    own.name: own
    for own in (
        Format("geopackage", "GeoPackage", (".gpkg",), write_geopackage, encoded=True),
        Format("geojson", "GeoJSON", (".geojson", ".json"), write_geojson, single=True),
        Format("flatgeobuf", "FlatGeobuf", (".fgb",), write_flatgeobuf, single=True),
        Format("geoparquet", "GeoParquet", (".parquet", ".geoparquet"), write_parquet, single=True),
        Format("shapefile", "Shapefile", (".shp",), write_shapefile, single=True, needs=("part",)),
        Format("csv", "CSV", (".csv",), write_csv, single=True),
        Format("kml", "KML", (".kml",), write_kml, single=True),
        Format("dxf", "DXF", (".dxf",), write_dxf, single=True),
        Format("cityjson", "CityJSON 2.0", (".city.json", ".json"), write_cityjson, needs=TOWN),
        Format("cityjsonseq", "CityJSONSeq", (".city.jsonl", ".jsonl"), write_cityjsonseq, needs=TOWN),
        Format("gltf", "glTF, binary", (".glb",), write_gltf, needs=TOWN),
        Format("openquake", "OpenQuake exposure", (".xml", ".csv"), write_exposure, needs=TOWN, options=EXPOSURE),
        Format("overture", "Overture buildings", (".building.parquet", ".parquet"), write_overture, needs=TOWN),
        Format("overture-parts", "Overture parts", (".building_part.parquet", ".parquet"), write_parts, needs=TOWN),
        Format("inspire", "INSPIRE Buildings", (".inspire.gpkg", ".gpkg"), write_inspire, needs=TOWN, options=INSPIRE),
    )
}
"""All formats by name. Of several with the same ending, the first is meant where no name is given."""


def find_format(path: Path, name: str | None = None) -> Format:
    """Return the named format, or that of a file's ending.

    Raises
    ------
    InputError
        For an unknown name or ending, or an ending that the named format does not have.
    """
    if name is not None and name not in FORMATS:
        msg = f"There is no format '{name}'. The formats are {', '.join(FORMATS)}."
        raise InputError(msg)
    known = [FORMATS[name]] if name is not None else list(FORMATS.values())
    endings = {suffix: own for own in reversed(known) for suffix in own.suffixes}
    fitting = [suffix for suffix in endings if path.name.lower().endswith(suffix)]
    if not fitting and path.suffix.lower() in (".las", ".laz"):
        msg = f"The database keeps no points, so '{path.name}' cannot be made of it. 'msbdb classify IN OUT' does it."
        raise InputError(msg)
    if not fitting:
        words = ", ".join(suffix for own in known for suffix in own.suffixes)
        msg = f"Results are written as {words}, by the ending of the name; got '{path.name}'."
        raise InputError(msg)
    return endings[max(fitting, key=len)]


def choose_layers(chosen: Format, there: Sequence[str], names: Sequence[str] = ()) -> tuple[str, ...]:
    """Return the layers of a file in their order.

    Parameters
    ----------
    chosen : Format
        The format.
    there : sequence of str
        The layers that there are.
    names : sequence of str
        Those that the user asks for; by default all, or the first where the format holds one.

    Raises
    ------
    InputError
        When there is no such layer, or the format holds one layer alone, or needs others.
    """
    for name in (*names, *(chosen.needs if not chosen.single else ())):
        if name not in there:
            needed = f"{chosen.title} is made of it; choose another format." if name in chosen.needs else "Choose one."
            msg = f"There is no layer '{name}'; the layers are {', '.join(there)}. {needed}"
            raise InputError(msg)
    if not chosen.single:
        return tuple(dict.fromkeys((*chosen.needs, *names))) if chosen.needs or names else tuple(there)
    if len(set(names)) > 1:
        msg = f"A file of {chosen.title} holds one layer; got {', '.join(names)}. Give one --layer for each file."
        raise InputError(msg)
    return tuple(names[:1]) or next(((name,) for name in chosen.needs if name in there), (there[0],))


def check_options(chosen: Format, options: Mapping[str, str]) -> None:
    """Refuse options that a format does not have.

    Raises
    ------
    InputError
        With those that it has.
    """
    for name in options:
        if name not in chosen.options:
            known = f"It has {', '.join(chosen.options)}" if chosen.options else "It has none"
            msg = f"The format {chosen.name} has no option '{name}'. {known}."
            raise InputError(msg)


def export(
    content: Content,
    path: Path,
    *,
    name: str | None = None,
    options: Mapping[str, str] = NO_OPTIONS,
    overwrite: bool = False,
) -> None:
    """Write the layers in the named format, or that of the file's ending.

    Parameters
    ----------
    content : Content
        The layers; a format of one layer takes the first.
    path : Path
        The file.
    name : str, optional
        A key of `FORMATS`.
    options : mapping of str to str
        Options of the format.
    overwrite : bool
        Replace files that exist.

    Raises
    ------
    InputError
        For an unknown format, ending or option.
    FileError
        When a file exists already, or cannot be written.
    """
    chosen = find_format(path, name)
    check_options(chosen, options)
    require_output(path, overwrite=overwrite)
    chosen.write(content, path, options)
