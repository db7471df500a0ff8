"""The file of measured footprints: an office's own columns beside the measures, in GeoPackage, GeoJSON or CSV."""

from collections.abc import Iterable
from pathlib import Path

import geopandas as gpd
import numpy as np
import pandas as pd
import shapely

from msbdb.export import Content
from msbdb.export.plainfiles import write_csv
from msbdb.io.layers import Layer, texts, write_layers

FORMATS = (".gpkg", ".geojson", ".csv")
"""The endings of such a file."""

RESERVED = ("has_footprint", "easting", "northing", "wkt", "fid", "geom", "geometry")
"""Names that the file gives to columns itself, or that GeoPackage does."""

DIGITS = {"seen_share": 3, "building_share": 3, "point_share": 3, "probability": 3, "volume_m3": 1}
"""Digits behind the point; lengths, levels and areas have two."""


def write_footprints(
    footprints: gpd.GeoDataFrame, others: gpd.GeoDataFrame, given: gpd.GeoDataFrame, out: Path
) -> None:
    """Write the footprints with their own columns and their measures, and the buildings without one.

    Parameters
    ----------
    footprints, others : GeoDataFrame
        Measures of the footprints, and of the detected buildings without one.
    given : GeoDataFrame
        The footprints in the same order with their own columns; see `own_names` for those with the name of a measure.
    out : path
        A GeoPackage with the layers ``footprint`` and ``without_footprint``, or a GeoJSON or CSV with all of them. In
        these the rows of buildings without a footprint have nulls in the office's columns; ``has_footprint`` is false.
    """
    measures = _rounded(footprints).drop(columns="geometry")
    own = given.drop(columns=given.geometry.name).reset_index(drop=True)
    own.columns = pd.Index(own_names(map(str, own.columns), [*measures.columns, *RESERVED]))
    first = gpd.GeoDataFrame(
        pd.concat([own, measures], axis=1).assign(has_footprint=True), geometry=[*given.geometry], crs=given.crs
    )
    second = _rounded(others).assign(has_footprint=False)
    if out.suffix.lower() == ".gpkg":
        write_layers(out, {"footprint": _layer(first), "without_footprint": _layer(second)}, "GPKG")
        return
    parts = [part.astype({name: object for name in part.columns if name != "geometry"}) for part in (first, second)]
    every = gpd.GeoDataFrame(pd.concat([part for part in parts if len(part)], ignore_index=True), crs=given.crs)
    every = gpd.GeoDataFrame(every.infer_objects(), geometry="geometry", crs=given.crs)
    if out.suffix.lower() == ".geojson":
        write_layers(out, {out.stem: _layer(every)}, "GeoJSON", RFC7946="YES")
        return
    write_csv(Content("current", {"footprint": _layer(every)}), out, {})


def own_names(names: Iterable[str], taken: Iterable[str]) -> list[str]:
    """Return an office's names of columns beside those that are taken, whatever their case: with ``_given`` behind.

    Examples
    --------
    >>> own_names(["Number", "Storeys", "storeys_given", "number"], ["storeys", "ridge"])
    ['Number', 'Storeys_given_given', 'storeys_given', 'number_given']
    """
    own, used = list(names), {name.lower() for name in taken}
    free = [name for position, name in enumerate(own) if _is_new(name, own[:position], used)]
    used |= {name.lower() for name in free}
    found = []
    for name in own:
        new = name
        if name in free:
            free.remove(name)
        else:
            while new.lower() in used:
                new = f"{new}_given"
            used.add(new.lower())
        found.append(new)
    return found


def _is_new(name: str, before: list[str], used: set[str]) -> bool:
    """Return whether a name is neither used nor one of those before it."""
    return name.lower() not in used and name.lower() not in {other.lower() for other in before}


def _rounded(frame: gpd.GeoDataFrame) -> gpd.GeoDataFrame:
    """Return measures with the digits that they deserve."""
    numbers = frame.select_dtypes("float").columns
    return frame.assign(**{name: frame[name].round(DIGITS.get(name, 2)) for name in numbers})


def _layer(frame: gpd.GeoDataFrame) -> Layer:
    """Return rows as a layer of multipolygons, with the ids as texts, which browsers do not round."""
    whole = [shape if shape.geom_type == "MultiPolygon" else shapely.MultiPolygon([shape]) for shape in frame.geometry]
    made = frame.set_geometry(gpd.GeoSeries(whole, index=frame.index, crs=frame.crs))
    layer = Layer.of(made)
    ids = texts(np.asarray(made["building_id"].astype("Int64").astype(object).where(made["building_id"].notna(), None)))
    return Layer({**layer.columns, "building_id": ids}, layer.geometry, layer.crs)
