"""The buildings and parts of an export as plain records, for formats with a schema of their own."""

from dataclasses import dataclass
from typing import Any, Self

import numpy as np
import shapely
from numpy.typing import NDArray

from msbdb.errors import CRSError
from msbdb.export.content import Content
from msbdb.export.standards.solids import outlines_of
from msbdb.io.layers import Layer

ROOF_EDGE = "roofEdge"
"""What outlines are, by INSPIRE's code list HorizontalGeometryReferenceValue."""

Record = dict[str, Any]
"""The plain values of a row by column; null values are left out."""


@dataclass(frozen=True, slots=True)
class Part:
    """A part of a building, with what of it no part on a finer scale covers.

    Parameters
    ----------
    id : str
        Its id.
    record : dict
        Columns of ``PART``.
    geometry : Geometry
        Its whole outline.
    own : Geometry
        Its outline without its children's.
    own_height : float
        Mean height above ground of its cells that are no child's, metres.
    """

    id: str
    record: Record
    geometry: shapely.Geometry
    own: shapely.Geometry
    own_height: float


@dataclass(frozen=True, slots=True)
class Building:
    """A building with its parts, the largest first.

    Parameters
    ----------
    id : str
        In the inventory that of all surveys, else that of its survey.
    record : dict
        Columns of the layer ``footprint``.
    geometry : Geometry
        Its outline of roof edges.
    parts : tuple of Part
        Empty where it was imported.
    """

    id: str
    record: Record
    geometry: shapely.Geometry
    parts: tuple[Part, ...]

    @property
    def block(self) -> tuple[float, float] | None:
        """Level of the ground and mean height above it, metres; None where one of them is unknown."""
        ground, height = self.record.get("z_ground"), self.record.get("h_mean")
        return None if ground is None or height is None else (ground, height)


@dataclass(frozen=True, slots=True)
class Town:
    """What is exported; refuted buildings are left out.

    Parameters
    ----------
    buildings : tuple of Building
        In the order of the layer.
    crs : str
        Their horizontal CRS in metres, by its code or as WKT.
    vertical : str
        Name of their vertical CRS; empty where it is unknown.
    date : str
        Date of the newest survey, ISO 8601; may be empty.
    name : str
        Name of what is exported.
    """

    buildings: tuple[Building, ...]
    crs: str
    vertical: str = ""
    date: str = ""
    name: str = "buildings"

    @property
    def blocks(self) -> tuple[Building, ...]:
        """The buildings whose level and height are known."""
        return tuple(building for building in self.buildings if building.block is not None)

    @classmethod
    def of(cls, content: Content) -> Self:
        """Return the buildings and parts of a content with the layers ``footprint`` and ``part``.

        Raises
        ------
        CRSError
            When the CRS is not in metres.
        """
        from pyproj import CRS

        if CRS.from_user_input(content.crs).is_geographic:
            msg = f"This format needs a CRS in metres; got {content.crs}. Leave out --crs, or name one in metres."
            raise CRSError(msg)
        footprint, key = content.layers["footprint"], content.building_key
        parts: dict[int, list[Part]] = {}
        for found in _parts(content.layers["part"]):
            parts.setdefault(found.record["building_id"], []).append(found)
        buildings = [
            Building(str(record[key]), record, geometry, tuple(parts.pop(record.get("building_id", 0), ())))
            for record, geometry in zip(records(footprint), footprint.geometry, strict=True)
            if record.get("state") != "refuted"
        ]
        date = content.date or max((survey.date for survey in content.surveys), default="")
        name = ", ".join(survey.name for survey in content.surveys) or "buildings"
        return cls(tuple(buildings), content.crs, content.vertical_crs, date, name)


def side_by_side(building: Building) -> list[tuple[Part, shapely.Geometry]]:
    """Return the parts of a building with what no finer part covers, where there are several; slivers are left out."""
    found = [(part, shapely.multipolygons(outlines_of(part.own))) for part in building.parts]
    found = [(part, own) for part, own in found if not own.is_empty]
    return found if len(found) > 1 else []


def records(layer: Layer) -> list[Record]:
    """Return the rows of a layer as plain values by column, without null values."""
    columns = {name: _plain(values) for name, values in layer.columns.items()}
    rows: list[Record] = [{} for _ in range(len(layer))]
    for name, values in columns.items():
        for row, value in zip(rows, values, strict=True):
            if value is not None:
                row[name] = value
    return rows


def _plain(values: NDArray[Any]) -> list[Any]:
    """Return a column as plain values; NaN and masked values are None."""
    found: list[Any] = values.tolist()  # None where masked
    return [None if isinstance(value, float) and value != value else value for value in found]  # noqa: PLR0124  (NaN)


def _parts(layer: Layer) -> list[Part]:
    """Return the parts, the largest first, with what of each its children do not cover."""
    rows = records(layer)
    children: dict[int, list[int]] = {}
    for number, row in enumerate(rows):
        if row["supid"]:
            children.setdefault(row["supid"], []).append(number)
    found = []
    for row, geometry in zip(rows, layer.geometry, strict=True):
        inner = children.get(row["part_id"], [])
        own = shapely.difference(geometry, shapely.union_all(layer.geometry[inner])) if inner else geometry
        found.append(
            Part(str(row["part_id"]), row, geometry, own, _own_height(row, [rows[number] for number in inner]))
        )
    return sorted(found, key=lambda part: (-part.record["area_m2"], part.record["part_id"]))


def _own_height(row: Record, children: list[Record]) -> float:
    """Return the mean height of a part's cells that are no child's.

    Means weighted by area add up: A h = A₀ h₀ + Σ Aᵢ hᵢ, with A₀ and h₀ of the rest. Where hardly a cell is left, it
    is the part's own mean.
    """
    area = row["area_m2"] - sum(child["area_m2"] for child in children)
    volume = row["area_m2"] * row["h_mean"] - sum(child["area_m2"] * child["h_mean"] for child in children)
    if not children or area <= 0 or volume <= 0:
        return float(row["h_mean"])
    return float(np.clip(volume / area, 0.0, row["h_max"]))
