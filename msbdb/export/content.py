"""What an exported file is made of: layers with their CRS, and the surveys that they come from."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Self

from msbdb.errors import InputError
from msbdb.io.layers import Layer, texts
from msbdb.tables import Survey
from msbdb.tables.view_columns import IDS

if TYPE_CHECKING:
    import geopandas as gpd

ROOF_EDGES = (
    "Outlines are edges of roofs as seen from above, not walls at the ground: eaves are inside. 'fitted' outlines have "
    "straight walls, 'traced' ones follow cells (outline_source)."
)
"""The description that files carry, where their format has one."""

WHATS = ("current", "survey", "changes", "parts", "evidence")
"""What may be exported: the inventory, a survey as it found the buildings, changes, parts, or evidence by detector."""


@dataclass(frozen=True, slots=True, eq=False)
class Content:
    """What a file is made of, read from the database as one committed state.

    Parameters
    ----------
    what : str
        One of `WHATS`.
    layers : mapping of str to Layer
        The chosen layers by name, all in one CRS, which is horizontal; they may have no rows. Buildings are
        ``footprint`` and their parts ``part``, which has the same ``building_id``.
    surveys : tuple of Survey
        The surveys that the rows come from, the newest first; none for an empty database or imports alone.
    date : str
        The day of the inventory, ISO 8601; empty for its present state, and for surveys.
    chosen_crs : bool
        The user asked for the layers' CRS; otherwise it is the database's.
    """

    what: str
    layers: Mapping[str, Layer]
    surveys: tuple[Survey, ...] = ()
    date: str = ""
    chosen_crs: bool = False

    @property
    def crs(self) -> str:
        """The CRS of all layers as GDAL takes it: a code such as 'EPSG:2154', or WKT."""
        return next(iter(self.layers.values())).crs

    @property
    def vertical_crs(self) -> str:
        """The vertical CRS of the levels ``z_``, where all surveys state the same; otherwise empty."""
        found = {survey.vertical_crs for survey in self.surveys}
        return found.pop() if len(found) == 1 else ""

    @property
    def building_key(self) -> str:
        """The column of ``footprint`` that names a building: ``uid`` of the inventory, ``building_id`` of a survey."""
        return "uid" if "uid" in self.layers["footprint"].columns else "building_id"

    def frame(self, name: str) -> "gpd.GeoDataFrame":
        """Return a layer as a frame; whole numbers that may be null are ``Int64``, texts and None are objects."""
        return self.layers[name].frame()

    def textual(self, name: str) -> Layer:
        """Return a layer as files have it: ids as text."""
        return with_text_ids(self.layers[name])

    def only(self, *names: str) -> Self:
        """Return the content with these layers alone, in this order.

        Raises
        ------
        InputError
            When it has no such layer.
        """
        for name in names:
            if name not in self.layers:
                msg = f"There is no layer '{name}' in --what {self.what}; it has {', '.join(self.layers)}."
                raise InputError(msg)
        return replace(self, layers={name: self.layers[name] for name in names})


def with_text_ids(layer: Layer) -> Layer:
    """Return rows as files have them: ids as text."""
    columns = {own: texts(values) if own in IDS else values for own, values in layer.columns.items()}
    return replace(layer, columns=columns)
