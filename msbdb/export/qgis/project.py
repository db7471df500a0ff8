"""A project of QGIS: layers with their styles in a tree, and the relations of buildings, parts and children."""

import io
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from xml.etree.ElementTree import Element, SubElement, tostring

from msbdb.export.qgis.forms import CHILDREN_OF_PART, PARTS_OF_BUILDING, style_elements
from msbdb.export.qgis.symbology import STYLES, DrawnAs
from msbdb.tables import Column
from msbdb.tables.aliases import LAYER_WORDS

QGIS_VERSION = "3.22.16"
"""The last release of the oldest series for which projects are written, which opens them without a word."""

PAPER, SELECTED = (255, 255, 255, 255), (255, 255, 0, 255)
"""Colours of the map's ground and of what is selected; without them QGIS 3.22 selects in white."""

EVIDENCE = ("building_evidence", "part_evidence", "flat_region", "candidate_region", "candidate_evidence", "rejection")
"""Layers in a group of their own, above the buildings."""

EVIDENCE_GROUP = "Evidence"

Bounds = tuple[float, float, float, float]


@dataclass(frozen=True, slots=True)
class ProjectLayer:
    """A layer of a project.

    Parameters
    ----------
    name : str
        The name of its styles, a key of `STYLES`.
    source, provider : str
        Where QGIS reads it, in the words of its provider: ``spatialite``, ``postgres`` or ``ogr``.
    columns : tuple of Column
        The declarations of its columns.
    drawn : DrawnAs
        How it is drawn.
    title : str
        Its name for people.
    visible : bool
        It is shown when the project is opened.
    group : str
        The group of the legend in which it stands; empty for none.
    read_only : bool
        QGIS does not edit it.
    runs : mapping of str to int
        The run of each survey, for layers that name the run alone.
    """

    name: str
    source: str
    provider: str
    columns: tuple[Column, ...]
    drawn: DrawnAs
    title: str
    visible: bool = False
    group: str = ""
    read_only: bool = False
    runs: Mapping[str, int] = field(default_factory=dict)

    @property
    def id(self) -> str:
        """Its id within the project."""
        return f"{self.name}_{self.drawn.name}".replace(" ", "_")

    @property
    def points(self) -> bool:
        """Whether its geometries are points."""
        return self.name == "rejection"


def layers_of(
    name: str,
    source: str,
    provider: str,
    columns: Sequence[Column],
    shown: str = "",
    *,
    runs: Mapping[str, int] | None = None,
    read_only: bool = False,
) -> list[ProjectLayer]:
    """Return a layer in each of its styles; the style ``shown`` is visible when the project is opened."""
    words = LAYER_WORDS.get(name, "Changes")
    several = len(STYLES[name]) > 1
    return [
        ProjectLayer(
            name, source, provider, tuple(columns), drawn,
            f"{words} {drawn.name}" if several or drawn.name.startswith("by ") else words, drawn.name == shown,
            EVIDENCE_GROUP if name in EVIDENCE else "", read_only, runs or {},
        )
        for drawn in STYLES[name]
    ]  # fmt: skip


def project(title: str, layers: Sequence[ProjectLayer], crs_wkt: str, authid: str, bounds: Bounds | None) -> bytes:
    """Return a project as QGIS packs it, a .qgz.

    Parameters
    ----------
    title : str
        Its title; the project inside of the archive has the same name.
    layers : sequence of ProjectLayer
        In the order of the legend, the first on top.
    crs_wkt, authid : str
        The CRS of the project and of all layers, as WKT and by its code, such as 'EPSG:2154'; the code may be empty.
    bounds : tuple of float, optional
        West, south, east and north of the map, metres.
    """
    root = Element("qgis", projectname=title, version=QGIS_VERSION)
    SubElement(root, "title").text = title
    SubElement(root, "projectCrs").append(_crs(crs_wkt, authid))
    root.append(_tree(layers))
    root.append(_canvas(crs_wkt, authid, bounds))
    shown = SubElement(root, "projectlayers")
    for layer in layers:
        shown.append(_map_layer(layer, crs_wkt, authid))
    root.append(_relations(layers))
    properties = SubElement(root, "properties")
    SubElement(SubElement(properties, "Paths"), "Absolute", type="bool").text = "false"
    SubElement(SubElement(properties, "SpatialRefSys"), "ProjectionsEnabled", type="int").text = "1"
    canvas = SubElement(properties, "Gui")
    for what, colour in (("Canvas", PAPER), ("Selection", SELECTED)):
        for part, value in zip(("Red", "Green", "Blue", "Alpha"), colour, strict=True):
            SubElement(canvas, f"{what}Color{part}Part", type="int").text = str(value)
    head = b"<!DOCTYPE qgis PUBLIC 'http://mrcc.com/qgis.dtd' 'SYSTEM'>\n"
    return _packed(f"{title}.qgs", head + tostring(root, encoding="utf-8"))


def style_document(name: str, drawn: DrawnAs, columns: Sequence[Column]) -> str:
    """Return a style as QGIS keeps it in a file or in the table ``layer_styles``: QML."""
    root = Element("qgis", version=QGIS_VERSION, styleCategories="Symbology|Fields|Forms|AttributeTable")
    root.extend(style_elements(name, drawn, columns, points=name == "rejection"))
    head = "<!DOCTYPE qgis PUBLIC 'http://mrcc.com/qgis.dtd' 'SYSTEM'>\n"
    return head + tostring(root, encoding="unicode")


def _crs(crs_wkt: str, authid: str) -> Element:
    """Return a CRS."""
    root = Element("spatialrefsys", nativeFormat="Wkt")
    SubElement(root, "wkt").text = crs_wkt
    SubElement(root, "authid").text = authid
    return root


def _tree(layers: Sequence[ProjectLayer]) -> Element:
    """Return the legend: layers one below the other, those of a group in it; what is not shown is folded up."""
    root = Element("layer-tree-group")
    groups: dict[str, Element] = {"": root}
    for layer in layers:
        if layer.group not in groups:
            seen = any(own.visible for own in layers if own.group == layer.group)
            groups[layer.group] = SubElement(
                root, "layer-tree-group", name=layer.group, checked="Qt::Checked", expanded="1" if seen else "0"
            )
        checked = "Qt::Checked" if layer.visible else "Qt::Unchecked"
        SubElement(
            groups[layer.group], "layer-tree-layer", id=layer.id, name=layer.title, checked=checked,
            expanded="1" if layer.visible else "0", providerKey=layer.provider, source=layer.source,
        )  # fmt: skip
    return root


def _canvas(crs_wkt: str, authid: str, bounds: Bounds | None) -> Element:
    """Return the map's place and CRS."""
    root = Element("mapcanvas", name="theMapCanvas", annotationsVisible="1")
    SubElement(root, "units").text = "meters"
    if bounds is not None:
        extent = SubElement(root, "extent")
        for name, value in zip(("xmin", "ymin", "xmax", "ymax"), bounds, strict=True):
            SubElement(extent, name).text = f"{value:.3f}"
    SubElement(root, "destinationsrs").append(_crs(crs_wkt, authid))
    return root


def _map_layer(layer: ProjectLayer, crs_wkt: str, authid: str) -> Element:
    """Return a layer with its source and style."""
    kind = "Point" if layer.points else "Polygon"
    root = Element(
        "maplayer", type="vector", geometry=kind, wkbType=f"Multi{kind}" if kind == "Polygon" else kind,
        readOnly="1" if layer.read_only else "0",
    )  # fmt: skip
    SubElement(root, "id").text = layer.id
    SubElement(root, "datasource").text = layer.source
    SubElement(root, "layername").text = layer.title
    SubElement(root, "srs").append(_crs(crs_wkt, authid))
    SubElement(root, "provider", encoding="UTF-8").text = layer.provider
    root.extend(style_elements(layer.name, layer.drawn, layer.columns, points=layer.points, runs=layer.runs))
    return root


def _relations(layers: Sequence[ProjectLayer]) -> Element:
    """Return the relations: parts of a building, and children of a part."""
    root = Element("relations")
    first = {layer.name: layer.id for layer in reversed(layers)}
    found = []
    if {"part", "footprint"} <= set(first):
        found.append((PARTS_OF_BUILDING, "Parts", "footprint", ("building_id", "building_id")))
    if "part" in first:
        found.append((CHILDREN_OF_PART, "Parts on it", "part", ("supid", "part_id")))
    for relation, name, father, (own, referred) in found:
        ends = {"referencingLayer": first["part"], "referencedLayer": first[father]}
        made = SubElement(root, "relation", ends, id=relation, name=name, strength="Association")
        SubElement(made, "fieldRef", referencingField=own, referencedField=referred)
    return root


def _packed(name: str, content: bytes) -> bytes:
    """Return an archive of one file, equal for equal content."""
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w") as archive:
        archive.writestr(zipfile.ZipInfo(name), content, compress_type=zipfile.ZIP_DEFLATED)
    return packed.getvalue()
