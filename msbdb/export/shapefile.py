"""Shapefile: one layer, parts under the paper's names and all columns under names of at most ten characters."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from msbdb.export.content import Content
from msbdb.export.fields import short_name
from msbdb.io.layers import write_layers


def write_shapefile(content: Content, path: Path, options: Mapping[str, str]) -> None:  # noqa: ARG001  (it has none)
    """Write the first layer; of parts, the footprints are those with SUPID '0' (V49).

    Parameters
    ----------
    content : Content
        The layer.
    path : Path
        The .shp; .shx, .dbf, .prj and .cpg (UTF-8) lie beside it.
    options : mapping
        None.

    Notes
    -----
    The names are those of `msbdb.export.fields.short_name`. Ids are texts, because programs read long numbers of a DBF
    as floating point. The format cuts texts at 254 characters, and has no place for a description: the outlines are
    edges of roofs.
    """
    name = next(iter(content.layers))
    layer = content.textual(name)
    columns = {short_name(own): values for own, values in layer.columns.items()}
    write_layers(path, {path.stem: replace(layer, columns=columns)}, "ESRI Shapefile", encoding="UTF-8")
