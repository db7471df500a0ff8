"""GeoPackage: all layers in one file, with names in words, styles and a project for QGIS."""

from collections.abc import Mapping
from pathlib import Path

from msbdb.export.content import ROOF_EDGES, Content
from msbdb.export.geopackagetables import complete_geopackage
from msbdb.io.layers import write_layers


def write_geopackage(content: Content, path: Path, options: Mapping[str, str]) -> None:  # noqa: ARG001  (it has none)
    """Write all layers under their names, all columns and the CRS kept, ids as text.

    The layers' description says what outlines are. The table ``gpkg_data_columns`` has names and meanings of columns,
    ``layer_styles`` the styles that QGIS applies, ``qgis_projects`` a project. A foreign key relates parts to
    buildings.
    """

    def complete(written: Path) -> None:
        complete_geopackage(content, path.stem, written)

    layers = {name: content.textual(name) for name in content.layers}
    write_layers(
        path, layers, "GPKG", complete, DESCRIPTION=ROOF_EDGES, VERSION="1.2"
    )  # older GDAL warns of newer ones
