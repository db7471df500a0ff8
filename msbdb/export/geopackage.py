"""GeoPackage: all layers in one file."""

from collections.abc import Mapping
from pathlib import Path

from msbdb.export.content import Content
from msbdb.io.layers import write_layers

ROOF_EDGES = (
    "Outlines are edges of roofs as seen from above, not walls at the ground: eaves are inside. 'fitted' outlines have "
    "straight walls, 'traced' ones follow cells (outline_source)."
)
"""The description that files carry, where their format has one."""


def write_geopackage(content: Content, path: Path, options: Mapping[str, str]) -> None:  # noqa: ARG001  (it has none)
    """Write all layers under their names, all columns and the CRS kept; their description says what outlines are."""
    write_layers(path, content.layers, "GPKG", DESCRIPTION=ROOF_EDGES)
