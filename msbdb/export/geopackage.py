"""GeoPackage: all layers in one file, with what QGIS and GDAL read beside them: names in words, styles, a project."""

import json
import sqlite3
from collections.abc import Mapping, Sequence
from contextlib import closing
from pathlib import Path

from msbdb.export.content import ROOF_EDGES, Content, with_text_ids
from msbdb.export.fields import FIELDS
from msbdb.export.qgis.project import layers_of, project, style_document
from msbdb.export.qgis.symbology import STYLES
from msbdb.io.layers import write_layers
from msbdb.tables import Column
from msbdb.tables.aliases import LAYER_WORDS, words_of

_DATA_COLUMNS = """
CREATE TABLE IF NOT EXISTS gpkg_data_columns (
  table_name TEXT NOT NULL, column_name TEXT NOT NULL, name TEXT, title TEXT, description TEXT, mime_type TEXT,
  constraint_name TEXT, CONSTRAINT pk_gdc PRIMARY KEY (table_name, column_name),
  CONSTRAINT gdc_tn UNIQUE (table_name, name)
)
"""

_STYLES = """
CREATE TABLE layer_styles (
  id INTEGER PRIMARY KEY AUTOINCREMENT NOT NULL, f_table_catalog TEXT(256), f_table_schema TEXT(256),
  f_table_name TEXT(256), f_geometry_column TEXT(256), styleName TEXT(30), styleQML TEXT, styleSLD TEXT,
  useAsDefault BOOLEAN, description TEXT, owner TEXT(30), ui TEXT(30),
  update_time DATETIME DEFAULT (strftime('%Y-%m-%dT%H:%M:%fZ', 'now'))
)
"""

STYLE_NAME = 30
"""The longest name of a style that QGIS takes, as its own table has it."""

_PROJECTS = "CREATE TABLE qgis_projects (name TEXT PRIMARY KEY, metadata BLOB, content BLOB)"

_SCHEMA_EXTENSION = "http://www.geopackage.org/spec/#extension_schema"


def write_geopackage(content: Content, path: Path, options: Mapping[str, str]) -> None:  # noqa: ARG001  (it has none)
    """Write all layers under their names, all columns and the CRS kept, ids as text.

    The layers' description says what outlines are. The table ``gpkg_data_columns`` has names and meanings of columns,
    ``layer_styles`` the styles that QGIS applies, ``qgis_projects`` a project. A foreign key relates parts to
    buildings.
    """

    def complete(written: Path) -> None:
        complete_geopackage(content, path.stem, written)

    how = {"DESCRIPTION": ROOF_EDGES, "VERSION": "1.2"}  # older GDAL warns of newer versions
    write_layers(path, content.layers, "GPKG", complete, with_text_ids, **how)


def complete_geopackage(content: Content, title: str, path: Path) -> None:
    """Write names, styles, the relation and the project into a GeoPackage of layers.

    Parameters
    ----------
    content : Content
        What GDAL wrote into it.
    title : str
        Title of the project, and name of the file without its ending.
    path : Path
        The file, which nobody reads yet.
    """
    fields = {name: [FIELDS[name][own] for own in layer.columns] for name, layer in content.layers.items()}
    with closing(sqlite3.connect(path)) as file, file:
        _write_words(file, fields)
        _write_styles(file, fields)
        _write_relation(file, content)
        _write_project(file, content, fields, title)


def _write_words(file: sqlite3.Connection, fields: dict[str, list[Column]]) -> None:
    """Write the names of layers and columns in words; the columns' are the schema extension of the standard."""
    file.execute(_DATA_COLUMNS)
    for layer, columns in fields.items():
        file.execute("UPDATE gpkg_contents SET identifier = ? WHERE table_name = ?", (LAYER_WORDS[layer], layer))
        rows = [(layer, column.name, words_of(column), words_of(column), column.comment) for column in columns]
        statement = (
            "INSERT INTO gpkg_data_columns (table_name, column_name, name, title, description) VALUES (?,?,?,?,?)"
        )
        file.executemany(statement, rows)
    own = ("gpkg_data_columns", "gpkg_data_column_constraints")
    file.execute(
        "CREATE TABLE IF NOT EXISTS gpkg_data_column_constraints (constraint_name TEXT NOT NULL, constraint_type TEXT "
        "NOT NULL, value TEXT, min NUMERIC, min_is_inclusive BOOLEAN, max NUMERIC, max_is_inclusive BOOLEAN, "
        "description TEXT, CONSTRAINT gdcc_ntv UNIQUE (constraint_name, constraint_type, value))"
    )
    for table in own:
        file.execute(
            "INSERT INTO gpkg_extensions (table_name, column_name, extension_name, definition, scope) "
            "VALUES (?, NULL, 'gpkg_schema', ?, 'read-write')",
            (table, _SCHEMA_EXTENSION),
        )


def _write_styles(file: sqlite3.Connection, fields: dict[str, list[Column]]) -> None:
    """Write the styles where QGIS looks for them; the first of each layer is applied when it is opened."""
    file.execute(_STYLES)
    file.execute(
        "INSERT INTO gpkg_contents (table_name, data_type, identifier, description, srs_id) "
        "VALUES ('layer_styles', 'attributes', 'layer_styles', 'Styles of QGIS', 0)"
    )
    for layer, columns in fields.items():
        for number, drawn in enumerate(STYLES[layer]):
            name = f"{LAYER_WORDS[layer]} {drawn.name}"
            qml = style_document(layer, drawn, columns)
            file.execute(
                "INSERT INTO layer_styles (f_table_catalog, f_table_schema, f_table_name, f_geometry_column, "
                "styleName, styleQML, styleSLD, useAsDefault, description, owner) "
                "VALUES ('', '', ?, 'geom', ?, ?, '', ?, ?, '')",
                (
                    layer,
                    name if len(name) <= STYLE_NAME else drawn.name,
                    qml,
                    number == 0,
                    name,
                ),
            )


def _write_relation(file: sqlite3.Connection, content: Content) -> None:
    """Declare that parts refer to buildings, by a foreign key, which GDAL and QGIS report as a relation.

    SQLite cannot add a key to a table, and documents the edit of its schema for such changes, which touch no row. A
    file in which a building of a survey stands twice, or a part has none, has no key.
    """
    if not {"footprint", "part"} <= set(content.layers):
        return
    twice = "SELECT 1 FROM footprint WHERE building_id IS NOT NULL GROUP BY building_id HAVING count(*) > 1"
    lost = (
        "SELECT 1 FROM part WHERE building_id NOT IN (SELECT building_id FROM footprint WHERE building_id IS NOT NULL)"
    )
    if file.execute(twice).fetchone() or file.execute(lost).fetchone():
        return
    file.execute("CREATE UNIQUE INDEX ix_footprint_building_id ON footprint (building_id)")
    file.execute("CREATE INDEX ix_part_building_id ON part (building_id)")
    [text] = file.execute("SELECT sql FROM sqlite_master WHERE type = 'table' AND name = 'part'").fetchone()
    key = "FOREIGN KEY (building_id) REFERENCES footprint (building_id)"
    body = text.rstrip().removesuffix(")")
    file.execute("PRAGMA writable_schema = ON")
    file.execute("UPDATE sqlite_master SET sql = ? WHERE type = 'table' AND name = 'part'", (f"{body}, {key})",))
    file.execute("PRAGMA writable_schema = OFF")


def _write_project(file: sqlite3.Connection, content: Content, fields: dict[str, list[Column]], title: str) -> None:
    """Write a project of QGIS with all layers, their styles and the relations."""
    query = "SELECT definition FROM gpkg_spatial_ref_sys WHERE srs_id = (SELECT min(srs_id) FROM gpkg_geometry_columns)"
    [crs_wkt] = file.execute(query).fetchone()
    layers = [
        layer
        for name, shown in _order(fields)
        for layer in layers_of(name, f"./{title}.gpkg|layername={name}", "ogr", fields[name], shown)
    ]
    box = file.execute(
        "SELECT min(min_x), min(min_y), max(max_x), max(max_y) FROM gpkg_contents WHERE data_type = 'features'"
    ).fetchone()
    authid = content.crs if content.crs.startswith("EPSG:") else ""
    packed = project(title, layers, crs_wkt, authid, None if None in box else box)
    file.execute(_PROJECTS)
    file.execute(
        "INSERT INTO gpkg_contents (table_name, data_type, identifier, description, srs_id) "
        "VALUES ('qgis_projects', 'attributes', 'qgis_projects', 'Projects of QGIS', 0)"
    )
    about = json.dumps({"last_modified_time": "", "last_modified_user": ""})
    file.execute("INSERT INTO qgis_projects VALUES (?, ?, ?)", (title, about, packed.hex()))


def _order(fields: dict[str, list[Column]]) -> Sequence[tuple[str, str]]:
    """Return the layers with the style that is shown, in the order of the legend: evidence above, buildings below."""
    shown = {"footprint": "by height", "change": "by kind", "building_evidence": "by probability"}
    if "footprint" not in fields:
        shown["part"] = "by scale"
    over = [name for name in fields if name not in ("part", "footprint")]
    return [(name, shown.get(name, "")) for name in (*over, *(own for own in ("part", "footprint") if own in fields))]
