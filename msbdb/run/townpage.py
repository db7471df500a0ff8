"""A database as the values of a page in 3-D: buildings, their parts as blocks on each scale, dates and changes."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import geopandas as gpd
import numpy as np
import pandas as pd
import shapely
from pyproj import Transformer

from msbdb.change.netchange import with_beginnings
from msbdb.database import (
    Engine,
    database_crs_of,
    footprint_at,
    opened,
    read_classes,
    read_pieces,
    read_scales,
    read_survey,
    read_tables,
    summarise_inventory,
    summarise_run,
)
from msbdb.database.history.periods import read_period
from msbdb.errors import InputError, PassingNotice, counted, give_notice
from msbdb.grid import Grid
from msbdb.io.files import require_output
from msbdb.run.contents import Choice, area_of, choose, of_one_place, photo_on, reason_rasters, relief_for, within
from msbdb.run.inventory.changed import NOT_SURVEYED, changes_of
from msbdb.tables import BUILDING, DETECTOR_SHARES, PART
from msbdb.tables.aliases import words_of
from msbdb.tables.view_columns import VIEW_COLUMNS
from msbdb.view.blocks import blocks_of
from msbdb.view.buildingmap import KINDS
from msbdb.view.groundimages import light_image, origin_of, photo_image, place_of, reason_image
from msbdb.view.page import DEGREE, read_library, shapes_of, texts, whole_numbers, write_page
from msbdb.view.townfeatures import archives_of, town_features

FEW_PARTS, MOST_PARTS = 25_000, 500_000
"""Buildings and parts whose outlines the page holds as they are, and all that it can have (ours)."""

MOST_DATES = 8
"""Dates of the inventory on the page, the newest ones (ours): each pair has its list of changes."""

DIGITS = {"m": 2, "m2": 1, "m3": 0, "1": 3, "1/m2": 2}
"""Digits of a number behind the point by its unit; the page has whole numbers."""

SHOWN = (
    "survey", "state", "found_state", "operator", "note", "probability", "valid_from", "valid_to", "storeys",
    "storeys_min", "storeys_max", "storeys_top", "eaves", "ridge", "h_mean", "z_ground", "z_ridge", "area_m2",
    "volume_m3", "floor_area_m2", "coverage", "density", "divided_by", "outline_source", "attributes",
)  # fmt: skip
"""The columns of a building that the page shows, in this order."""


@dataclass(frozen=True, slots=True)
class _Stock:
    """The buildings of a page with the views in which each is seen, and their parts.

    Parameters
    ----------
    views : list of dict
        Name and date of each view: dates of the inventory in their order, or surveys.
    buildings : GeoDataFrame
        Columns ``key`` (its id on the page), ``first`` and ``after`` (its views), and those of the database.
    parts : GeoDataFrame
        Columns of ``PART``, ``row`` (of the building) and ``survey``.
    """

    views: list[dict[str, str]]
    buildings: gpd.GeoDataFrame
    parts: gpd.GeoDataFrame


def view_page(
    db: str | Path, out: Path, *, survey: str | None, what: str, aoi: Path | None, ortho: Path | None, overwrite: bool
) -> None:
    """Write a page; see `msbdb.api.view`."""
    require_output(out, overwrite=overwrite, sources=[db, *(path for path in (aoi, ortho) if path)])
    if what != "parts":
        msg = (
            f"The page shows buildings and their parts; leave out --what {what}, or write a picture: .png, .svg, .pdf."
        )
        raise InputError(msg)
    library = read_library()
    with opened(db) as engine:
        town = town_of(db, engine, of_one_place(engine, choose(engine, survey)), aoi, ortho)
    archives = archives_of(town.pop("outlines"), len(town["scales"])) if "outlines" in town else []
    write_page(town, out, library, archives)


def town_of(
    db: str | Path, engine: Engine, choice: Choice, aoi: Path | None = None, ortho: Path | None = None
) -> dict[str, Any]:
    """Return what the page of a database shows, as values of JSON; of a large one ``outlines`` are a frame beside them.

    Parameters
    ----------
    db : str or path
        The database.
    engine : Engine
        The same, opened.
    choice : Choice
        The surveys, and whether the buildings are those of the inventory.
    aoi : path, optional
        A file of polygons: the buildings that meet them, and the ground within their bounds.
    ortho : path, optional
        An orthophoto, as a layer of the ground.

    Raises
    ------
    InputError
        When there are more buildings and parts than a page can hold, or the area lies beside the surveys.
    """
    if aoi is None:
        _require_few(
            sum(summarise_run(engine, name).rows[own.name] for name in choice.surveys for own in (BUILDING, PART))
        )
    stock = _inventory(engine, choice) if choice.present else _surveys(engine, choice)
    relief = relief_for(engine, choice, stock.buildings)
    if aoi is not None:
        area = area_of(aoi, relief)
        stock, relief = _inside(stock, area), within(relief, area)
        _require_few(len(stock.buildings) + len(stock.parts))
    to_degrees = Transformer.from_crs(relief.spec.crs, 4326, always_xy=True)
    origin = origin_of(relief, to_degrees)
    inventory = _changes(db, engine, stock) if choice.present else {}
    name = choice.surveys[0] if choice.is_one else "Inventory" if choice.present else f"{len(choice.surveys)} surveys"
    return {
        "title": name,
        "subtitle": _subtitle(stock, relief, choice),
        "crs": relief.spec.crs.name,
        "origin": list(origin),
        "views": stock.views,
        "inventory": choice.present,
        "scales": _scales(engine, choice, stock.parts),
        "detectors": [[name, column] for name, column in DETECTOR_SHARES.items()],
        "place": place_of(relief, to_degrees, origin),
        "ground": light_image(relief),
        "photo": None if ortho is None else photo_image(photo_on(relief, ortho), to_degrees, origin),
        "reasons": reason_image(relief, reason_rasters(engine, choice)),
        **_rows(engine, choice, stock, to_degrees, origin),
        **inventory,
    }


def _subtitle(stock: _Stock, relief: Grid, choice: Choice) -> str:
    """Return in words how much is shown, of when and where."""
    last = len(stock.views) - 1 if choice.present else None
    here = stock.buildings["after"] == last + 1 if last is not None else stock.buildings["after"] > 0
    counts = counted(int(here.sum()), "building"), counted(int(here.to_numpy()[stock.parts["row"]].sum()), "part")
    date = max((view["date"] for view in stock.views), default="")
    return " · ".join(word for word in (*counts, date, relief.spec.crs.name) if word)


def _require_few(rows: int) -> None:
    """Refuse what is too large for one page."""
    if rows > MOST_PARTS:
        msg = (
            f"The page would have {rows:,} buildings and parts; a browser is slow with more than {MOST_PARTS:,}. "
            "Choose a survey by --survey or an area by --aoi, or open the database in QGIS ('msbdb qgis')."
        )
        raise InputError(msg)


def _inside(stock: _Stock, area: shapely.Geometry) -> _Stock:
    """Return the buildings that meet an area, with their parts."""
    keep = np.asarray(stock.buildings.intersects(area), dtype=np.bool_)
    rows = stock.parts["row"].to_numpy(dtype=np.int64)
    parts = stock.parts[keep[rows]]
    numbers = (np.cumsum(keep) - 1)[rows[keep[rows]]]
    return _Stock(
        stock.views, stock.buildings[keep].reset_index(drop=True), parts.assign(row=numbers).reset_index(drop=True)
    )


def _inventory(engine: Engine, choice: Choice) -> _Stock:
    """Return the versions of the inventory on the dates of its imports and updates, and their parts."""
    events = summarise_inventory(engine)["events"]
    days = sorted({str(event["date"]) for event in events})
    if len(days) > MOST_DATES:
        msg = (
            f"The inventory has {len(days)} dates; the page shows the newest {MOST_DATES}, from {days[-MOST_DATES]} on."
        )
        give_notice(msg, PassingNotice, stacklevel=3)
        days = days[-MOST_DATES:]
    names = {day: ", ".join(str(event["name"]) for event in events if str(event["date"]) == day) for day in days}
    frames = []
    for number, day in enumerate(days):
        frame = footprint_at(engine, day)
        frames.append(frame[frame["survey"].isna() | frame["survey"].isin(choice.surveys)].assign(first=number))
    every = gpd.GeoDataFrame(pd.concat([frame.dropna(axis=1, how="all") for frame in frames], ignore_index=True))
    last = every.groupby("version_id")["first"].max()
    one = every.drop_duplicates("version_id").reset_index(drop=True).reindex(columns=frames[-1].columns)
    buildings = one.assign(key=one["uid"].astype(str), after=last.loc[one["version_id"]].to_numpy() + 1)
    row_of = {version: row for row, version in enumerate(buildings["version_id"].tolist())}
    rows_of: dict[int, list[int]] = {}
    for version, building in read_pieces(engine):
        if version in row_of:
            rows_of.setdefault(building, []).append(row_of[version])
    tables = {name: read_tables(engine, (BUILDING, PART), name) for name in choice.surveys}
    # What only the buildings of a survey have: the versions are copies of the main columns.
    more = pd.concat([pd.DataFrame(own["building"]) for own in tables.values()] or [pd.DataFrame(BUILDING.empty())])
    more = more.drop_duplicates("building_id").set_index("building_id")
    known = pd.Index(buildings["building_id"].fillna(0).astype("int64"))
    lacking = [name for name in (*SHOWN, *DETECTOR_SHARES.values()) if name in more and name not in buildings]
    for name in lacking:
        buildings[name] = more[name].reindex(known).to_numpy()
    views = [{"name": names[day], "date": day} for day in days]
    return _Stock(views, buildings, _with_rows({name: own["part"] for name, own in tables.items()}, rows_of))


def _surveys(engine: Engine, choice: Choice) -> _Stock:
    """Return the buildings and parts of surveys as each found them."""
    tables = {name: read_tables(engine, (BUILDING, PART), name) for name in choice.surveys}
    frames = [
        gpd.GeoDataFrame(own["building"]).assign(survey=name, first=number, after=number + 1)
        for number, (name, own) in enumerate(tables.items())
    ]
    buildings = gpd.GeoDataFrame(pd.concat(frames, ignore_index=True)) if frames else _nothing(engine)
    buildings = buildings.assign(key=buildings["building_id"].astype(str))
    rows_of = {building: [row] for row, building in enumerate(buildings["building_id"].tolist())}
    views = [{"name": name, "date": read_survey(engine, name).date} for name in choice.surveys]
    return _Stock(views, buildings, _with_rows({name: own["part"] for name, own in tables.items()}, rows_of))


def _nothing(engine: Engine) -> gpd.GeoDataFrame:
    """Return the frame of a database without buildings."""
    empty = gpd.GeoDataFrame(BUILDING.empty(), geometry=[], crs=database_crs_of(engine))
    return empty.assign(survey=pd.Series(dtype=object), first=0, after=0)


def _with_rows(tables: Mapping[str, Any], rows_of: Mapping[int, Sequence[int]]) -> gpd.GeoDataFrame:
    """Return the parts of surveys with the row of their building; a part of several versions is there for each."""
    found = []
    for name, table in tables.items():
        rows = [rows_of.get(building, ()) for building in table["building_id"].tolist()]
        times = np.array([len(own) for own in rows], dtype=np.int64)
        frame = gpd.GeoDataFrame(table.iloc[np.repeat(np.arange(len(table)), times)])
        found.append(frame.assign(survey=name, row=[row for own in rows for row in own]))
    if not found:
        return gpd.GeoDataFrame(PART.empty().assign(survey="", row=0), geometry=[])
    return gpd.GeoDataFrame(pd.concat(found, ignore_index=True))


def _rows(
    engine: Engine, choice: Choice, stock: _Stock, to_degrees: Transformer, origin: tuple[int, int]
) -> dict[str, Any]:
    """Return the buildings, parts and blocks by column."""
    parts, buildings = stock.parts, stock.buildings
    row_of = {key: row for row, key in enumerate(zip(parts["row"].tolist(), parts["part_id"].tolist(), strict=True))}
    fathers = [row_of.get(key, -1) for key in zip(parts["row"].tolist(), parts["supid"].tolist(), strict=True)]
    finest = int(parts["scale"].max()) if len(parts) else 0
    blocks = blocks_of(
        parts["scale"].to_numpy(dtype=np.int64),
        np.array(fathers, dtype=np.int64),
        parts["area_m2"].to_numpy(dtype=np.float64),
        parts["h_mean"].to_numpy(dtype=np.float64),
        np.array(parts.geometry.to_numpy(), dtype=object),
        finest=finest,
    )

    both = np.concatenate([np.array(buildings.geometry.to_numpy(), dtype=object), blocks.geometry])
    shapes = shapely.transform(both, to_degrees.transform, interleaved=False)
    outlines, pieces = np.split(shapes, [len(buildings)])
    columns = [column for column in _columns() if column.name in buildings]
    classes, class_of = _classes(engine, choice, parts)
    found: dict[str, Any] = {
        "fields": [[column.name, words_of(column), DIGITS.get(column.unit, 0)] for column in columns],
        "classes": classes,
        "buildings": {
            "id": buildings["key"].tolist(),
            "first": whole_numbers(buildings["first"]),
            "after": whole_numbers(buildings["after"]),
            "height": whole_numbers(_heights(buildings), 2),
            "version": texts(buildings["version_id"]) if "version_id" in buildings else [],
            "values": {column.name: _values(buildings[column.name], column.dtype, column.unit) for column in columns},
            "shares": {
                column: whole_numbers(buildings[column], 3) if column in buildings else [None] * len(buildings)
                for column in DETECTOR_SHARES.values()
            },
        },
        "parts": {
            "id": texts(parts["part_id"]),
            "building": whole_numbers(parts["row"]),
            "father": fathers,
            "scale": whole_numbers(parts["scale"]),
            "storeys": whole_numbers(parts["hindex"]),
            "height": whole_numbers(parts["h_mean"], 2),
            "top": whole_numbers(parts["h_max"], 2),
            "area": whole_numbers(parts["area_m2"]),
            "kind": class_of,
        },
        "blocks": {
            "part": blocks.row.tolist(),
            "low": blocks.low.tolist(),
            "high": blocks.high.tolist(),
            "height": np.rint(100 * blocks.height_m).astype(np.int64).tolist(),
        },
    }
    if len(buildings) + len(parts) > FEW_PARTS:
        boxes = np.rint(shapely.bounds(outlines) * DEGREE).astype(np.int64) - np.tile(origin, 2)
        found["buildings"]["box"] = boxes.tolist()
        found["outlines"] = town_features(found, finest, shapes)
        del found["blocks"]["low"], found["blocks"]["high"]
    else:
        found["buildings"]["shape"] = shapes_of(outlines, origin)
        found["blocks"]["shape"] = shapes_of(pieces, origin)
    return found


def _columns() -> list[Any]:
    """Return the declared columns of what the page shows of a building."""
    known = {column.name: column for column in (*VIEW_COLUMNS["footprint_current"], *BUILDING.columns)}
    return [known[name] for name in SHOWN]


def _values(values: pd.Series, dtype: str, unit: str) -> list[Any]:
    """Return a column of any kind: whole numbers, or texts; None for null."""
    if dtype in ("int64", "Int64", "float64"):
        return whole_numbers(values, DIGITS.get(unit, 0))
    return texts(values)


def _heights(buildings: gpd.GeoDataFrame) -> pd.Series:
    """Return the mean height of each building, or the nearest to it that is known; metres."""
    found = pd.Series(np.nan, index=buildings.index)
    for name in ("h_mean", "h_p50", "ridge", "h_p90", "h_max"):
        found = found.fillna(pd.to_numeric(buildings[name]).astype("float64"))
    return found


def _classes(engine: Engine, choice: Choice, parts: gpd.GeoDataFrame) -> tuple[list[str], list[int]]:
    """Return the names of the land-cover classes, and the number of each part's in this list; 0 is none."""
    labels = {
        (name, int(number)): f"{number} {label}"
        for name in choice.surveys
        for number, label in zip(*(read_classes(engine, name)[own] for own in ("speindex", "label")), strict=True)
    }
    found = [
        labels.get((str(name), int(number)), "none")
        for name, number in zip(parts["survey"], parts["speindex"], strict=True)
    ]
    order = ["none", *sorted(set(found) - {"none"}, key=lambda word: (int(word.split(" ")[0]), word))]
    return order, [order.index(word) for word in found]


def _scales(engine: Engine, choice: Choice, parts: gpd.GeoDataFrame) -> list[list[Any]]:
    """Return the scales, the coarsest first, each with its area threshold in square metres; None where they differ."""
    areas: dict[int, set[int]] = {}
    for name in choice.surveys:
        table = read_scales(engine, name)
        for scale, area in zip(table["scale"].tolist(), table["threshold_m2"].tolist(), strict=True):
            areas.setdefault(int(scale), set()).add(round(area))
    finest = int(parts["scale"].max()) if len(parts) else 0
    return [[scale, min(areas[scale]) if len(areas.get(scale, ())) == 1 else None] for scale in range(1, finest + 1)]


def _changes(db: str | Path, engine: Engine, stock: _Stock) -> dict[str, Any]:
    """Return the net changes between each two dates, and the history of the buildings.

    A change has its kind, the rows of the building before and after (-1 for none), and the changes of height (cm) and
    area (m2).
    """
    row_of = {version: row for row, version in enumerate(stock.buildings["version_id"].tolist())}
    days = [view["date"] for view in stock.views]
    pairs = {}
    for first, since in enumerate(days):
        for second in range(first + 1, len(days)):
            found = changes_of(db, since=since, until=days[second])
            table = found.table[~found.table["kind"].isin(["unchanged", NOT_SURVEYED])]
            pairs[f"{first}-{second}"] = _change_rows(_shown(table, row_of), row_of)
    period = read_period(engine)
    each = with_beginnings(period.changes, period.events, None)
    each = _shown(each[(each["kind"] != "unchanged") & each["date"].astype(str).isin(days)], row_of)
    number = {day: view for view, day in enumerate(days)}
    rows = _change_rows(each, row_of)
    history = [[number[str(day)], *row] for day, row in zip(each["date"], rows, strict=True)]
    return {"kinds": [[name, colour] for name, colour in KINDS.items()], "changes": pairs, "history": history}


def _shown(table: gpd.GeoDataFrame, row_of: Mapping[int, int]) -> gpd.GeoDataFrame:
    """Return the changes whose buildings are all on the page."""
    versions = table[["version_before", "version_after"]]
    return table[(versions.isna() | versions.isin(list(row_of))).all(axis=1)]


def _change_rows(table: gpd.GeoDataFrame, row_of: Mapping[int, int]) -> list[list[Any]]:
    """Return changes as short rows."""
    sides = [
        [row_of.get(version, -1) for version in table[name].astype("Int64").fillna(0).tolist()]
        for name in ("version_before", "version_after")
    ]
    number = [[*KINDS].index(kind) for kind in table["kind"]]
    differences = whole_numbers(table["dh_m"], 2), whole_numbers(table["darea_m2"])
    return [list(row) for row in zip(number, *sides, *differences, strict=True)]
