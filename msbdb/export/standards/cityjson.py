"""CityJSON 2.0 and CityJSONSeq: buildings as blocks of LoD 1.2, their parts as blocks of LoD 1.3.

A block rises from ``z_ground`` by the mean height above ground, so that it has the building's volume. The blocks of the
parts divide the building: each part has the mean height of its cells that are no child's, so their volumes add up to
that of the building.
"""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from msbdb.errors import PassingNotice, counted, give_notice
from msbdb.export.content import Content
from msbdb.export.standards.solids import GRID_M, Block, Vertices, block_of, on_grid, outlines_of
from msbdb.export.standards.town import ROOF_EDGE, Building, Record, Town
from msbdb.io.files import write_atomic

SURFACES = [{"type": "GroundSurface"}, {"type": "RoofSurface"}, {"type": "WallSurface"}]
"""Semantic surfaces, in the order of a block's faces; all faces after the second are walls."""

ROOF_REFERENCE = "mean height above ground"
"""What the top of a block is."""

NAMES = {"storeys": "storeysAboveGround", "hindex": "storeysAboveGround"}
"""Names of CityJSON for our columns; all others keep theirs."""

BUILDING_COLUMNS = (
    "survey", "valid_from", "state", "probability", "storeys", "storeys_min", "storeys_max", "storeys_top", "eaves",
    "ridge", "z_ground", "z_ground_min", "z_ground_max", "z_eaves", "z_ridge", "h_mean", "h_p50", "h_p90", "h_max",
    "area_m2", "volume_m3", "floor_area_m2", "outline_source",
)  # fmt: skip
"""Columns of buildings that are attributes."""

PART_COLUMNS = ("survey", "scale", "hindex", "h_mean", "h_p50", "h_p90", "h_max", "area_m2", "outline_source")
"""Columns of parts that are attributes."""

IDS = ("uid", "building_id")
"""Columns with ids, which are texts: they exceed 2^53."""

Solid = list[list[list[list[int]]]]
"""Shells of faces of rings of numbers of vertices."""


def write_cityjson(content: Content, path: Path, options: Mapping[str, str]) -> None:  # noqa: ARG001  (it has none)
    """Write the layers ``footprint`` and ``part`` as one CityJSON document; without buildings it has no objects."""
    town = Town.of(content)
    vertices = Vertices(origin_of(town))
    with write_atomic(path) as temporary, temporary.open("w", encoding="utf-8") as file:
        file.write(f'{_json(_head(town))[:-1]},"CityObjects":{{')
        for number, building in enumerate(placed(town)):
            objects = _city_objects(building, vertices)
            file.write(f"{',' if number else ''}{_json(objects)[1:-1]}")
        file.write(f'}},"vertices":{_json(vertices.coordinates())}}}\n')


def write_cityjsonseq(content: Content, path: Path, options: Mapping[str, str]) -> None:  # noqa: ARG001  (none)
    """Write a CityJSONSeq: the metadata on the first line, then a building with its parts on each line."""
    town = Town.of(content)
    with write_atomic(path) as temporary, temporary.open("w", encoding="utf-8") as file:
        file.write(f"{_json(_head(town) | {'CityObjects': {}, 'vertices': []})}\n")
        for building in placed(town):
            vertices = Vertices(origin_of(town))
            objects = _city_objects(building, vertices)
            feature = {"type": "CityJSONFeature", "id": next(iter(objects)), "CityObjects": objects}
            file.write(f"{_json(feature | {'vertices': vertices.coordinates()})}\n")


def _json(value: object) -> str:
    """Return a value on one line."""
    return json.dumps(value, ensure_ascii=False, allow_nan=False, separators=(",", ":"))


def _head(town: Town) -> Record:
    """Return the members of a document before its objects."""
    metadata: Record = {"title": town.name}
    if town.blocks:
        metadata["geographicalExtent"] = [round(value, 3) for corner in _extent(town) for value in corner]
    if len(town.date) == len("2021-05-31"):
        metadata["referenceDate"] = town.date
    metadata |= _reference(town)
    metadata |= {"horizontalGeometryReference": ROOF_EDGE, "lod1RoofReference": ROOF_REFERENCE}
    transform = {"scale": [GRID_M] * 3, "translate": origin_of(town).tolist()}
    return {"type": "CityJSON", "version": "2.0", "metadata": metadata, "transform": transform}


def _extent(town: Town) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Return the lowest and the highest corner of all blocks, metres."""
    bounds, low, high = [], [], []
    for building in town.buildings:
        if building.block is None:
            continue
        ground, height = building.block
        bounds += [building.geometry, *(part.own for part in building.parts)]
        low.append(ground)
        high += [ground + height, *(ground + part.own_height for part in building.parts)]
    west, south, east, north = shapely.total_bounds(bounds).tolist()
    return (west, south, min(low)), (east, north, max(high))


def origin_of(town: Town) -> NDArray[np.float64]:
    """Return what is subtracted from coordinates, so that they are small whole numbers: the lowest corner, metres."""
    return np.floor(_extent(town)[0]) if town.blocks else np.zeros(3)


def _reference(town: Town) -> Record:
    """Return the reference system: the compound one where EPSG has it, else the horizontal and the vertical one."""
    from pyproj import CRS
    from pyproj.database import query_crs_info
    from pyproj.enums import PJType

    horizontal = CRS.from_user_input(town.crs)
    found: Record = {}
    code = horizontal.to_epsg()
    if town.vertical:
        wanted = f"{horizontal.name} + {town.vertical}"
        compound = [info.code for info in query_crs_info("EPSG", PJType.COMPOUND_CRS) if info.name == wanted]
        code = int(compound[0]) if compound else code
        found["verticalReferenceSystem"] = town.vertical
    if code is None:
        return found | {"referenceSystemWKT": horizontal.to_wkt()}
    return {"referenceSystem": f"https://www.opengis.net/def/crs/EPSG/0/{code}"} | found


def placed(town: Town) -> tuple[Building, ...]:
    """Return the buildings; give a notice of those without a level or a height, which have no block."""
    missing = len(town.buildings) - len(town.blocks)
    if missing:
        msg = f"{counted(missing, 'building')} without a level of the ground or a height: written without a block."
        give_notice(msg, PassingNotice, stacklevel=3)
    return town.buildings


def _city_objects(building: Building, vertices: Vertices) -> dict[str, Any]:
    """Return a building and its parts as city objects, the building first."""
    key, record = f"building-{building.id}", building.record
    keys = [f"part-{part.id}" for part in building.parts]
    attributes: Record = {"id": building.id} | attributes_of(record, BUILDING_COLUMNS)
    if "building_id" in record and "uid" in record:
        attributes["building_id"] = str(record["building_id"])
    if record.get("attributes"):
        attributes["imported"] = _imported(record["attributes"])
    found: Record = {"type": "Building", "attributes": attributes, "geometry": []}
    if keys:
        found["children"] = keys
    outlines = on_grid(np.array([building.geometry, *(part.own for part in building.parts)], dtype=object))
    if building.block is not None:
        ground, height = building.block
        attributes["lod1Height"], attributes["lod1RoofReference"] = round(height, 3), ROOF_REFERENCE
        levels = ground, ground + height
        found["geometry"] = _geometry(outlines[0], levels, "1.2", vertices)
        if not keys:
            found["geometry"] += _geometry(outlines[0], levels, "1.3", vertices)
    objects = {key: found}
    for name, part, outline in zip(keys, building.parts, outlines[1:], strict=True):
        own: Record = {"id": part.id, "building": building.id} | attributes_of(part.record, PART_COLUMNS)
        if part.record["supid"]:
            own["father"] = str(part.record["supid"])
        shape: list[Record] = []
        if building.block is not None:
            own["lod1Height"], own["lod1RoofReference"] = round(part.own_height, 3), ROOF_REFERENCE
            shape = _geometry(outline, (ground, ground + part.own_height), "1.3", vertices)
        objects[name] = {"type": "BuildingPart", "parents": [key], "attributes": own, "geometry": shape}
    return objects


def _imported(attributes: object) -> object:
    """Return the columns of an imported inventory, which a layer holds as the text of JSON."""
    return json.loads(attributes) if isinstance(attributes, str) else attributes


def attributes_of(record: Record, columns: Sequence[str]) -> Record:
    """Return the named columns as attributes, numbers to three decimals."""
    found = {NAMES.get(name, name): record[name] for name in columns if name in record}
    rounded = {name: round(value, 3) if isinstance(value, float) else value for name, value in found.items()}
    return rounded | {"horizontalGeometryReference": ROOF_EDGE}


def _geometry(outline: shapely.Geometry, levels: tuple[float, float], lod: str, vertices: Vertices) -> list[Record]:
    """Return the blocks over an outline: a solid, several as a MultiSolid, or nothing where none is high enough."""
    low, high = levels
    made = [block_of(polygon, low, high, vertices) for polygon in outlines_of(outline)]
    blocks = [block for block in made if block is not None]
    if not blocks:
        return []
    solids: list[Solid] = [[block.faces] for block in blocks]
    values = [[_surfaces(block)] for block in blocks]
    several = len(blocks) > 1
    semantics = {"surfaces": SURFACES, "values": values if several else values[0]}
    kind = "MultiSolid" if several else "Solid"
    return [{"type": kind, "lod": lod, "boundaries": solids if several else solids[0], "semantics": semantics}]


def _surfaces(block: Block) -> list[int]:
    """Return the number of the semantic surface of each face."""
    return [min(number, 2) for number in range(len(block.faces))]
