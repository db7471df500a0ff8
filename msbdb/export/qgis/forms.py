"""How QGIS names the columns of a layer, and shows a row: a form in tabs, with the tree of parts of a building."""

from collections.abc import Iterable, Mapping
from typing import Any
from xml.etree.ElementTree import Element, SubElement

from msbdb.export.qgis.symbology import DrawnAs, renderer
from msbdb.tables import Column
from msbdb.tables.aliases import words_of
from msbdb.tables.view_columns import IDS, SURVEY_NAME, computed_columns

PARTS_OF_BUILDING = "parts_of_building"
CHILDREN_OF_PART = "children_of_part"

RELATION_TABS = {"footprint": ("Parts", PARTS_OF_BUILDING), "part": ("Parts on it", CHILDREN_OF_PART)}
"""The tab of a layer that lists related rows, and the relation."""

TABS: Mapping[str, tuple[str, ...]] = {
    "Identity": (
        "uid", "building_id", "part_id", "supid", "supscale", "root_id", "version_id", "scale", "depth", "path",
        "survey", "run_id", "survey_date", "source", "valid_from", "valid_to", "began_as", "ended_in", "ended_as",
        "kind", "method", "rule", "date", "uid_before", "uid_after", "stage", "reason",
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

HIDDEN = ("run_id", "father_id", "class_id", "rejection_id", "row_digest", "fid")
"""Columns that serve the database alone, which a table of rows leaves out."""

DECIMALS = {"m": 2, "m2": 1, "m3": 0, "1": 3}
"""Decimals of a number by its unit; other numbers have three. Levels and heights are kept as they were measured."""

TITLES = {
    "footprint": """concat('Building ', "{key}", coalesce(', ' || round("h_p90", 1) || ' m high', ''))""",
    "part": """concat('Scale ', "scale", ', ', round("h_p90", 1), ' m high, ', round("area_m2"), ' m²')""",
    "part_evidence": """concat('Scale ', "scale", ', ', round("area_m2"), ' m²')""",
    "change": """concat("kind", coalesce(', ' || round("dh_m", 1) || ' m', ''))""",
    "history": """concat(coalesce("ended_as", "began_as"), ' on ', coalesce("valid_to", "valid_from"))""",
    "rejection": """concat("method", ': ', "reason")""",
}
"""How a row is named in lists, as expressions of QGIS; other layers name the id."""


def style_elements(
    layer: str,
    drawn: DrawnAs,
    columns: Iterable[Column],
    *,
    points: bool = False,
    runs: Mapping[str, int] | None = None,
) -> list[Element]:
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
    runs : mapping of str to int, optional
        The run of each survey: a column ``run_id`` shows the survey's name. Without it the column is hidden.
    """
    known = runs or {}
    own = tuple(column for column in columns if column.name != "run_id" or known)
    return [renderer(drawn, points=points), *_fields(layer, own, known), _table(own), *_form(layer, own)]


def _fields(layer: str, columns: tuple[Column, ...], runs: Mapping[str, int]) -> list[Element]:
    """Return how columns are named and shown: ids and words as text, measures with the decimals that they deserve."""
    shown, aliases = Element("fieldConfiguration"), Element("aliases")
    untyped = computed_columns(layer)
    for number, column in enumerate(columns):
        field = SubElement(shown, "field", name=column.name)
        if column.name == "run_id":
            values = {name: ("QString", str(run)) for name, run in runs.items()}
            _widget(field, "ValueMap", {"map": values})
        elif column.dtype == "float64" and column.name not in untyped:
            decimals = ("int", str(DECIMALS.get(column.unit, 3)))
            _widget(field, "Range", {"AllowNull": ("bool", "true"), "Precision": decimals})
        else:
            multiline = "true" if column.dtype == "json" else "false"
            _widget(field, "TextEdit", {"IsMultiline": ("bool", multiline)})
        words = words_of(SURVEY_NAME if column.name == "run_id" else column)
        SubElement(aliases, "alias", field=column.name, index=str(number), name=words)
    return [shown, aliases]


def _widget(field: Element, kind: str, values: Mapping[str, tuple[str, str] | Mapping[str, tuple[str, str]]]) -> None:
    """Add a widget with its values: type and text of each, or a map of such."""

    def add(parent: Element, pairs: Mapping[str, Any]) -> None:
        for name, value in pairs.items():
            if isinstance(value, Mapping):
                add(SubElement(parent, "Option", name=name, type="Map"), value)
            else:
                SubElement(parent, "Option", name=name, type=value[0], value=value[1])

    widget = SubElement(field, "editWidget", type=kind)
    add(SubElement(SubElement(widget, "config"), "Option", type="Map"), values)


def _table(columns: tuple[Column, ...]) -> Element:
    """Return which columns the table of rows shows."""
    table = Element("attributetableconfig", actionWidgetStyle="dropDown", sortExpression="", sortOrder="0")
    shown = SubElement(table, "columns")
    names = [column.name for column in columns]
    for name in (*names, *(own for own in HIDDEN if own not in names)):
        hidden = "0" if name in names else "1"
        SubElement(shown, "column", type="field", name=name, hidden=hidden, width="-1")
    return table


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
    key = next((name for name in IDS if name in place), columns[0].name if columns else "")
    title.text = TITLES.get(layer, '"{key}"').format(key=key)
    return [layout, form, title]


def _box(form: Element, name: str) -> Element:
    """Return a new tab of a form."""
    return SubElement(
        form, "attributeEditorContainer", name=name, groupBox="0", columnCount="1", showLabel="1",
        visibilityExpressionEnabled="0", visibilityExpression="", collapsed="0",
    )  # fmt: skip
