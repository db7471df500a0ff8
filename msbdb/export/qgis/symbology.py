"""How QGIS draws a layer: rules with a colour each, by height, state, scale, kind of change or probability."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from xml.etree.ElementTree import Element, SubElement

HEIGHTS_M = (4.0, 7.0, 10.0, 13.0, 16.0, 20.0, 30.0, 50.0)
"""Limits between the classes of heights, metres: a class for each of the first storeys, and then towers."""

HEIGHT_COLOURS = (
    "#ffffcc", "#ffeda0", "#fed976", "#feb24c", "#fd8d3c", "#fc4e2a", "#e31a1c", "#bd0026", "#800026",
)  # fmt: skip
SCALE_COLOURS = (
    "#440154", "#472d7b", "#3b528b", "#2c728e", "#21918c", "#28ae80", "#5ec962", "#addc30", "#fde725",
)  # fmt: skip
STATE_COLOURS = {"confirmed": "#4c78a8", "unsure": "#f2b134", "refuted": "#c44e52"}
CHANGE_COLOURS = {
    "new": "#009e73", "demolished": "#d55e00", "modified": "#e69f00", "merged": "#56b4e9", "split": "#0072b2",
}  # fmt: skip
"""By Okabe and Ito, which colour-blind readers can distinguish; as on the maps of `msbdb.view`."""

NO_CHANGE_COLOURS = {
    "unchanged": "#d9d9d9", "first seen": "#ececec", "unsure": "#f0e442", "not surveyed": "#ffffff",
}  # fmt: skip
"""What a list of changes has besides them."""

METHOD_COLOURS = {"multiscale": "#4c78a8", "flatregions": "#56b4e9", "area3d": "#d55e00", "adaptive": "#009e73"}
CANDIDATE_METHODS = ("area3d", "adaptive")
UNKNOWN = "#bdbdbd"

CLEAR, GLASS, SOLID = 0, 200, 255
"""Opacity of an area, of 255: only its outline is drawn; what lies beneath shows through; nothing does."""


@dataclass(frozen=True, slots=True)
class Rule:
    """A rule of a style: the rows that fulfil an expression of QGIS have this colour; 'ELSE' is for all others."""

    expression: str
    label: str
    colour: str


@dataclass(frozen=True, slots=True)
class DrawnAs:
    """A style of a layer.

    Parameters
    ----------
    name : str
        Its name for people.
    rules : tuple of Rule
        In the order of the legend.
    opacity : int
        Of an area: `CLEAR`, `GLASS` or `SOLID`.
    order : str
        Expression by which rows are drawn, the smallest first; empty for any order.
    """

    name: str
    rules: tuple[Rule, ...]
    opacity: int = GLASS
    order: str = ""


def _by_height() -> DrawnAs:
    """Return the style by height: classes of the 90th percentile of the height above ground."""
    lows, highs = (None, *HEIGHTS_M), (*HEIGHTS_M, None)
    rules = []
    for low, high, colour in zip(lows, highs, HEIGHT_COLOURS, strict=True):
        above = [] if low is None else [f'"h_p90" >= {low:g}']
        below = [] if high is None else [f'"h_p90" < {high:g}']
        label = (
            f"below {high:g} m" if low is None else f"{low:g} m and more" if high is None else f"{low:g} to {high:g} m"
        )
        rules.append(Rule(" AND ".join(above + below), label, colour))
    return DrawnAs("by height", (*rules, Rule("ELSE", "height not known", UNKNOWN)))


def _by_words(name: str, column: str, colours: Mapping[str, str], *, opacity: int = GLASS) -> DrawnAs:
    """Return a style by the words of a column or expression, which has no others."""
    rules = tuple(Rule(f"{column} = '{word}'", word, colour) for word, colour in colours.items())
    return DrawnAs(name, rules, opacity)


def _by_detector(methods: Iterable[str], *, opacity: int) -> DrawnAs:
    """Return the style of regions: a colour for each detector."""
    return _by_words("by detector", '"method"', {name: METHOD_COLOURS[name] for name in methods}, opacity=opacity)


def _outlined(label: str, method: str) -> DrawnAs:
    """Return the style of the regions of one detector."""
    return DrawnAs("outlined", (Rule("", label, METHOD_COLOURS[method]),), CLEAR)


def _by_scale() -> DrawnAs:
    """Return the style of parts: a colour for each scale, finer ones on top, which hide the coarser ones."""
    finest = len(SCALE_COLOURS)
    rules = [Rule(f'"scale" = {n}', f"scale {n}", colour) for n, colour in enumerate(SCALE_COLOURS[:-1], start=1)]
    rules.append(Rule(f'"scale" >= {finest}', f"scale {finest} and finer", SCALE_COLOURS[-1]))
    return DrawnAs("by scale", tuple(rules), SOLID, order='"scale"')


def _by_probability() -> DrawnAs:
    """Return the style of evidence: the probability that it is a building."""
    return DrawnAs(
        "by probability",
        (
            Rule('"probability" >= 0.9', "0.9 and more", "#08519c"),
            Rule('"probability" >= 0.5 AND "probability" < 0.9', "0.5 to 0.9", "#6baed6"),
            Rule('"probability" < 0.5', "below 0.5", "#fcae91"),
            Rule("ELSE", "not known", UNKNOWN),
        ),
    )


HISTORY_KIND = "CASE WHEN \"ended_as\" = 'demolished' THEN 'demolished' ELSE \"began_as\" END"
"""The kind of change that a version of a building shows: how it ended, if it is gone, else how it began."""

STYLES: Mapping[str, tuple[DrawnAs, ...]] = {
    "footprint": (_by_height(), _by_words("by state", '"state"', STATE_COLOURS)),
    "part": (_by_scale(),),
    "change": (_by_words("by kind", '"kind"', CHANGE_COLOURS | NO_CHANGE_COLOURS, opacity=SOLID),),
    "history": (_by_words("by kind", HISTORY_KIND, CHANGE_COLOURS, opacity=SOLID),),
    "building_evidence": (_by_probability(),),
    "part_evidence": (_outlined("part", "multiscale"),),
    "flat_region": (_outlined("flat region", "flatregions"),),
    "candidate_region": (_by_detector(CANDIDATE_METHODS, opacity=CLEAR),),
    "candidate_evidence": (_by_detector(CANDIDATE_METHODS, opacity=CLEAR),),
    "rejection": (_by_detector(METHOD_COLOURS, opacity=SOLID),),
}
"""The styles of each layer, the default one first."""


def renderer(drawn: DrawnAs, *, points: bool = False) -> Element:
    """Return the element ``renderer-v2`` of a style."""
    ordered = "1" if drawn.order else "0"
    root = Element("renderer-v2", type="RuleRenderer", symbollevels="0", forceraster="0", enableorderby=ordered)
    rules = SubElement(root, "rules", key="{all}")
    symbols = SubElement(root, "symbols")
    for number, rule in enumerate(drawn.rules):
        SubElement(rules, "rule", key=f"{{{number}}}", filter=rule.expression, label=rule.label, symbol=str(number))
        symbols.append(_symbol(str(number), rule.colour, opacity=drawn.opacity, points=points))
    if drawn.order:
        clauses = SubElement(root, "orderby")
        SubElement(clauses, "orderByClause", asc="1", nullsFirst="0").text = drawn.order
    return root


def _symbol(name: str, colour: str, *, opacity: int, points: bool) -> Element:
    """Return a symbol of one colour: a filled area with a thin dark border, an outline, or a point."""
    root = Element("symbol", type="marker" if points else "fill", name=name, alpha="1", clip_to_extent="1")
    kind = {"class": "SimpleMarker" if points else "SimpleFill"}
    drawn = SubElement(root, "layer", kind, enabled="1", locked="0")
    values = {
        "color": _rgba(colour, opacity),
        "outline_color": "60,60,60,255" if opacity else _rgba(colour, SOLID),
        "outline_style": "solid",
        "outline_width": "0.1" if opacity else "0.4",
        "outline_width_unit": "MM",
        **({"name": "circle", "size": "1.6", "size_unit": "MM"} if points else {"style": "solid" if opacity else "no"}),
    }
    options = SubElement(drawn, "Option", type="Map")
    for key, value in values.items():
        SubElement(options, "Option", name=key, type="QString", value=value)
    for key, value in values.items():  # QGIS before 3.20 reads these
        SubElement(drawn, "prop", k=key, v=value)
    return root


def _rgba(colour: str, alpha: int) -> str:
    """Return a colour as QGIS writes it.

    Examples
    --------
    >>> _rgba("#4c78a8", 255)
    '76,120,168,255'
    """
    return ",".join(str(int(colour[place : place + 2], 16)) for place in (1, 3, 5)) + f",{alpha}"
