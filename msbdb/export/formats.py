"""The formats of exported files, by name and by the ending of the file; a new one is a function and a line here."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Protocol

from msbdb.errors import InputError
from msbdb.export.content import Content
from msbdb.export.geojson import write_geojson
from msbdb.export.geopackage import write_geopackage
from msbdb.export.shapefile import write_shapefile
from msbdb.io.files import require_output

NO_OPTIONS: Mapping[str, str] = MappingProxyType({})


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
    """

    name: str
    title: str
    suffixes: tuple[str, ...]
    write: Writer
    single: bool = False
    needs: tuple[str, ...] = ()
    options: Mapping[str, str] = field(default_factory=lambda: NO_OPTIONS)


FORMATS: dict[str, Format] = {
    own.name: own
    for own in (
        Format("geopackage", "GeoPackage", (".gpkg",), write_geopackage),
        Format("shapefile", "Shapefile", (".shp",), write_shapefile, single=True, needs=("part",)),
        Format("geojson", "GeoJSON", (".geojson", ".json"), write_geojson, single=True),
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
    if not fitting:
        words = ", ".join(suffix for own in known for suffix in own.suffixes)
        msg = f"Results are written as {words}, by the ending of the name; got '{path.name}'."
        raise InputError(msg)
    return endings[max(fitting, key=len)]


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
