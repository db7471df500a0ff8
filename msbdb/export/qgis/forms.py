"""How QGIS names the columns of a layer, and shows a row: a form in tabs, with the tree of parts of a building."""

from collections.abc import Iterable, Mapping
from xml.etree.ElementTree import Element, SubElement

from msbdb.export.qgis.symbology import DrawnAs, renderer
from msbdb.tables import Column
from msbdb.tables.aliases import words_of
from msbdb.tables.view_columns import IDS

PARTS_OF_BUILDING = "parts_of_building"
CHILDREN_OF_PART = "children_of_part"

RELATION_TABS = {"footprint": ("Parts", PARTS_OF_BUILDING), "part": ("Parts on it", CHILDREN_OF_PART)}
"""The tab of a layer that lists related rows, and the relation."""

TABS: Mapping[str, tuple[str, ...]] = {
    "Identity": (
        "uid", "building_id", "part_id", "supid", "supscale", "root_id", "version_id", "scale", "depth", "path",
        "survey", "survey_date", "source", "valid_from", "valid_to", "began_as", "ended_in", "ended_as", "kind",
        "method", "rule", "date", "uid_before", "uid_after", "stage", "reason",
        "region_id", "candidate_id", "change_id",
    ),
    "State": (
        "state", "found_state", "operator", "note", "probability", "classes_for", "extractors_for", "extractors_heard",
        "multiscale_share", "flat_share", "area3d_share", "adaptive_share", "building_share", "explained_share",
    ),
    "Heights": (
        "storeys", "storeys_min", "storeys_max", "storeys_top", "hindex", "eaves", "ridge", "z_ground", "z_ground_min",
        "z_ground_max", "z_eaves", "z_ridge", "h_max", "h_mean", "h_p50", "h_p90", "h_std", "height_scale_m",
        "vertical_crs",
    ),
}  # fmt: skip
"""The tabs of a form with their columns; other columns are on the last tab."""

OTHER_TAB = "Size and more"


def style_elements(layer: str, drawn: DrawnAs, columns: Iterable[Column], *, points: bool = False) -> list[Element]:
    """Return the elements of a style of QGIS: renderer, names of columns with units, and the form.

    Parameters
    ----------
    layer : str
        Its name, by which the form shows related rows.
    drawn : DrawnAs
        How it is drawn.
    columns : iterable of Column
        The declarations of its columns.
    points : bool
        Its geometries are points.
    """
    own = tuple(columns)
    return [renderer(drawn, points=points), *_fields(own), *_form(layer, own)]


def _fields(columns: tuple[Column, ...]) -> list[Element]:
    """Return how columns are named and shown: ids as plain text, and not as numbers with separators."""
    shown, aliases = Element("fieldConfiguration"), Element("aliases")
    for number, column in enumerate(columns):
        widget = SubElement(SubElement(shown, "field", name=column.name), "editWidget", type="TextEdit")
        options = SubElement(SubElement(widget, "config"), "Option", type="Map")
        multiline = "true" if column.dtype == "json" else "false"
        SubElement(options, "Option", name="IsMultiline", type="bool", value=multiline)
        SubElement(aliases, "alias", field=column.name, index=str(number), name=words_of(column))
    return [shown, aliases]


def _form(layer: str, columns: tuple[Column, ...]) -> list[Element]:
    """Return a form in tabs, and how a row is named in lists."""
    layout = Element("editorlayout")
    layout.text = "tablayout"
    form = Element("attributeEditorForm")
    place = {column.name: number for number, column in enumerate(columns)}
    known = {name for names in TABS.values() for name in names}
    tabs = {tab: [name for name in names if name in place] for tab, names in TABS.items()}
    tabs[OTHER_TAB] = [name for name in place if name not in known]
    for tab, names in tabs.items():
        if names:
            box = _box(form, tab)
            for name in names:
                SubElement(box, "attributeEditorField", name=name, index=str(place[name]), showLabel="1")
    if layer in RELATION_TABS:
        tab, relation = RELATION_TABS[layer]
        box = _box(form, tab)
        SubElement(
            box, "attributeEditorRelation", name=relation, relation=relation, showLabel="0",
            relationWidgetTypeId="relation_editor", forceSuppressFormPopup="0", nmRelationId="",
        )  # fmt: skip
    title = Element("previewExpression")
    title.text = next((f'"{name}"' for name in IDS if name in place), f'"{columns[0].name}"' if columns else "")
    return [layout, form, title]


def _box(form: Element, name: str) -> Element:
    """Return a new tab of a form."""
    return SubElement(
        form, "attributeEditorContainer", name=name, groupBox="0", columnCount="1", showLabel="1",
        visibilityExpressionEnabled="0", visibilityExpression="", collapsed="0",
    )  # fmt: skip
