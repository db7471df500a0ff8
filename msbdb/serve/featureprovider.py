"""The layers of a database as collections of pygeoapi: one provider for SpatiaLite and PostGIS, which only reads."""

import re
from collections.abc import Mapping, Sequence
from datetime import date
from functools import cache, partial
from typing import Any

import shapely
from flask import current_app, g
from pygeoapi.provider.base import BaseProvider, ProviderInvalidQueryError, ProviderItemNotFoundError
from pygeofilter.ast import Node
from pygeofilter.backends.sqlalchemy import to_filter
from pyproj import CRS, Transformer

from msbdb.database import LAYERS, FeatureLayer, FeatureQuery, Rows, read_feature, read_page
from msbdb.errors import InputError
from msbdb.identity import to_json
from msbdb.tables import Column
from msbdb.tables.aliases import words_of
from msbdb.tables.view_columns import IDS

ENGINE, SYSTEM = "MSBDB_ENGINE", "MSBDB_CRS"
"""Where the app keeps the database, and its CRS."""

TYPES: Mapping[str, str] = {
    "int64": "integer", "Int64": "integer", "int32": "integer", "float64": "number", "str": "string",
    "bool": "boolean", "json": "object",
}  # fmt: skip
"""The JSON Schema types of columns."""

STEPS = (9, 3)
"""Digits of coordinates behind the point: of degrees (0.1 mm), and of metres."""


class FeatureProvider(BaseProvider):  # type: ignore[misc]  # the library has no type information
    """A layer of the database that the app serves.

    Parameters
    ----------
    provider_def : dict
        ``data`` is the name of a layer of `msbdb.database.LAYERS`.
    """

    def __init__(self, provider_def: dict[str, Any]) -> None:
        super().__init__(provider_def)
        self.layer: FeatureLayer = LAYERS[self.data]
        self._fields = {column.name: field_of(column) for column in self.layer.columns}
        self.engine, self.crs = current_app.config[ENGINE], current_app.config[SYSTEM]
        self.is_stored = "storage_crs" in provider_def

    def query(
        self,
        *,
        offset: int = 0,
        limit: int = 10,
        resulttype: str = "results",
        datetime_: str | None = None,
        properties: Sequence[tuple[str, str]] = (),
        sortby: Sequence[Mapping[str, str]] = (),
        select_properties: Sequence[str] = (),
        skip_geometry: bool = False,
        filterq: Node | None = None,
        crs_transform_spec: object = None,
        **_: object,
    ) -> dict[str, Any]:
        """Return a page of features as GeoJSON.

        The window is the app's, the whole box in the database's CRS: pygeoapi would transform two corners alone.

        Raises
        ------
        ProviderInvalidQueryError
            For values that do not fit the layer.
        """
        try:
            condition = partial(to_filter, filterq, undefined_as_null=False)
            wanted = FeatureQuery(
                window=g.get("window"),
                days=days_of(datetime_),
                equal=properties,
                condition=None if filterq is None else condition,
                order=[(by["property"], by["order"] == "-") for by in sortby],
                names=select_properties,
                with_shape=not skip_geometry,
                offset=offset,
                limit=0 if resulttype == "hits" else limit,
            )
            nothing = wanted.window is not None and wanted.window.is_empty
            page = Rows([], 0) if nothing else read_page(self.engine, self.layer, wanted)
        except InputError as error:
            raise ProviderInvalidQueryError(user_msg=str(error)) from error
        except (AttributeError, KeyError, NotImplementedError, TypeError) as error:  # those of pygeofilter
            if filterq is None:
                raise
            msg = "The filter has a name or an operation that is not supported; compare columns with values."
            raise ProviderInvalidQueryError(user_msg=msg) from error
        return {
            "type": "FeatureCollection",
            "features": self._features(page.rows, crs_transform_spec),
            "numberMatched": page.matched,
            "numberReturned": len(page.rows),
        }

    def get(self, identifier: str, *, crs_transform_spec: object = None, **_: object) -> dict[str, Any]:
        """Return one feature as GeoJSON.

        Raises
        ------
        ProviderItemNotFoundError
            When there is none.
        """
        row = read_feature(self.engine, self.layer, identifier)
        if row is None:
            msg = f"The layer {self.layer.name} has no feature {identifier[:40]!r}."
            raise ProviderItemNotFoundError(user_msg=msg)
        return self._features([row], crs_transform_spec)[0]

    def _features(self, rows: Sequence[dict[str, Any]], spec: object) -> list[dict[str, Any]]:
        """Return rows as features, in the CRS that is asked for."""
        shapes: list[Any] = [None] * len(rows)
        if rows and "wkb" in rows[0]:
            shapes = _shapes([bytes(row.pop("wkb")) for row in rows], self.crs, self._target(spec))
        return [
            {"type": "Feature", "id": row[self.layer.key], "geometry": shape, "properties": _plain(row)}
            for row, shape in zip(rows, shapes, strict=True)
        ]

    def _target(self, spec: object) -> CRS | None:
        """Return the CRS of pygeoapi's transformation; None for that of the database."""
        words = getattr(spec, "target_crs_wkt", None)
        if words is not None:
            return CRS.from_wkt(words)
        # pygeoapi takes a database whose CRS has no code for one in longitude and latitude.
        return None if self.is_stored else CRS("OGC:CRS84")


def field_of(column: Column) -> dict[str, str]:
    """Return a column as JSON Schema."""
    unit = {} if column.unit in ("-", "1") else {"x-ogc-unit": column.unit}
    kind = "string" if column.name in IDS else TYPES[column.dtype]
    return {"type": kind, "title": words_of(column), "description": column.doc} | unit


def days_of(text: str | None) -> tuple[date | None, date | None] | None:
    """Return the first and last day of a time of OGC API, an instant or an interval; None for no end, and for no time.

    Raises
    ------
    InputError
        For a text that is no time.

    Examples
    --------
    >>> days_of("2020-05-01T12:00:00Z")
    (datetime.date(2020, 5, 1), datetime.date(2020, 5, 1))
    >>> days_of("2020-05-01/..")
    (datetime.date(2020, 5, 1), None)
    """
    if text is None:
        return None
    sides = text.split("/")
    if len(sides) > 2 or sides in ([".."], [""]):
        raise InputError(_no_time(text))
    first, last = (None if side in ("", "..") else _day(side, text) for side in (sides[0], sides[-1]))
    if first is not None and last is not None and first > last:
        raise InputError(_no_time(text))
    return first, last


def _day(side: str, text: str) -> date:
    """Return the day of a time of RFC 3339."""
    if not re.fullmatch(r"\d{4}-\d{2}-\d{2}(T\d{2}:\d{2}(:\d{2}(\.\d+)?)?(Z|[+-]\d{2}:\d{2})?)?", side, re.ASCII):
        raise InputError(_no_time(text))
    try:
        return date.fromisoformat(side[:10])
    except ValueError as error:
        raise InputError(_no_time(text)) from error


def _no_time(text: str) -> str:
    return (
        f"{text[:60]!r} is no time. Write datetime as 2020-05-01, 2020-05-01/2022-05-01, ../2022-05-01 or 2020-05-01/.."
    )


def north_first(crs: CRS) -> bool:
    """Return whether the first coordinate of a CRS is the northing or latitude, as in EPSG:4326.

    Examples
    --------
    >>> north_first(CRS.from_epsg(4326)), north_first(CRS.from_epsg(2154))
    (True, False)
    """
    return bool(crs.axis_info) and crs.axis_info[0].direction.lower() == "north"


@cache
def transformer(own: CRS, target: CRS) -> Transformer:
    """Return the transformation between two CRSs, easting or longitude first; PROJ looks long for the best one.

    Few CRSs are offered, so that few are kept. Each thread makes its own inside of it.
    """
    return Transformer.from_crs(own, target, always_xy=True)


def _shapes(wkb: list[bytes], own: CRS, target: CRS | None) -> list[dict[str, Any]]:
    """Return geometries as GeoJSON, coordinates in the order of the target's axes."""
    shown = own if target is None else target
    steps = STEPS[0] if shown.is_geographic else STEPS[1]
    shapes = shapely.from_wkb(wkb)
    if target is not None:
        shapes = shapely.transform(shapes, transformer(own, target).transform, interleaved=False)
    turned = north_first(shown)
    shapes = shapely.transform(shapes, lambda xy: (xy[:, ::-1] if turned else xy).round(steps))
    return [shapely.geometry.mapping(shape) for shape in shapes]


def _plain(row: Mapping[str, Any]) -> dict[str, Any]:
    """Return a row as values of JSON; an empty object is none."""
    return {name: None if isinstance(value, dict) and to_json(value) == "{}" else value for name, value in row.items()}
