"""The result of a tile: what it owns of all that its window has, as bytes that a file or a server keeps."""

import io
import json
import zipfile
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from typing import Any

import geopandas as gpd
import numpy as np
import pandas as pd
from numpy.typing import NDArray
from pyproj import CRS

from msbdb.database import METHODS, Piece
from msbdb.errors import MsbdbWarning
from msbdb.grid import GridSpec
from msbdb.identity import to_json
from msbdb.ledger import sum_up
from msbdb.params import POINT_DETECTORS
from msbdb.run.compose import Detected
from msbdb.run.describe import Description
from msbdb.scale.tiling import Tile, first_cells, owned_buildings
from msbdb.tables import TABLES, Counts, Reason

RING_M = 20.0
"""Ours: neighbours are compared so far beyond a tile: what lies there belongs to whole islands of the tile."""

STRAIGHT = ("scale", "spectral_class", "spectral_class_band")
"""Tables that each tile has for the run as a whole."""


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """What the steps found in the window of a tile.

    Parameters
    ----------
    window : Detected
        Its scene, and what the detectors found.
    description : Description
        Tables, rasters and counts.
    counts : Counts
        What the run keeps of them.
    """

    window: Detected
    description: Description
    counts: Counts


def packed(
    tile: Tile,
    found: Found | None,
    *,
    halo_m: float,
    cut: int,
    least_m2: float,
    notices: Iterable[MsbdbWarning] = (),
) -> bytes:
    """Return what a tile owns as the bytes of a zip file: tables as Parquet, rasters as npy, and the rest as JSON.

    Parameters
    ----------
    tile : Tile
        The tile.
    found : Found or None
        What its window has; None where it has no data.
    halo_m : float
        How far it saw beyond, metres.
    cut : int
        Islands of roofs that its window cuts.
    least_m2 : float
        Least area of a building: dropped regions from this on have a row in the ledger.
    notices : iterable of MsbdbWarning
        What a person should know of the tile. They wait with the result: a command that merges it may be another one.
    """
    about: dict[str, Any] = {"points": 0, "halo_m": halo_m, "cut": cut, "notices": [str(each) for each in notices]}
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as file:
        if found is not None and found.window.reach is not None:
            frames, kinds = _owned(tile, found, least_m2)
            spec = found.window.scene.heights.spec
            for name, frame in frames.items():
                with file.open(f"{name}.parquet", "w", force_zip64=True) as own:
                    frame.to_parquet(own, compression=None)
            rows, columns = spec.within(tile.bounds)
            arrays = _rasters(found, rows, columns)
            near = spec.within(tile.window(RING_M))
            reason = found.description.rasters.reason
            if reason is not None:
                arrays["near"] = np.packbits(reason[near] == Reason.BUILDING)
            for name, array in arrays.items():
                with file.open(f"{name}.npy", "w", force_zip64=True) as own:
                    np.save(own, array, allow_pickle=False)
            row, column = spec.origin
            about |= {
                "points": found.window.points,
                "reach": found.window.reach,
                "origin": [row + rows.start, column + columns.start],
                "own": [rows.stop - rows.start, columns.stop - columns.start],
                "near": [row + near[0].start, column + near[1].start, *reason[near].shape]
                if reason is not None
                else [],
                "kinds": kinds,
                "survey": asdict(replace(found.window.scene.survey, sources=())),
                "reasons": [] if reason is None else np.bincount(reason[rows, columns].ravel(), minlength=len(Reason)),
                "cells": _counted(found, rows, columns),
                "cover": found.counts.cover,
                "chosen": found.counts.chosen,
                "rows": {name: len(frame) for name, frame in frames.items()},
            }
        file.writestr("about.json", to_json(about))
    return content.getvalue()


def _rasters(found: Found, rows: slice, columns: slice) -> dict[str, NDArray[Any]]:
    """Return the own cells of all rasters; those of regions are numbered anew, with the ids of the numbers."""
    arrays: dict[str, NDArray[Any]] = {}
    kept, frames = found.description.rasters, found.description.frames
    for name, cells in kept.by_name().items():
        own = np.ascontiguousarray(cells[rows, columns])
        method = METHODS.get(name)
        if method is not None:
            labels, places = np.unique(np.append(own.ravel(), 0), return_inverse=True)
            arrays[f"ids_{method}"] = np.sort(_region_ids(frames, method))[labels[1:] - 1]
            own = places[:-1].reshape(own.shape).astype(np.int32)
        arrays[f"raster_{name}"] = own
    return arrays


def _region_ids(frames: Mapping[str, pd.DataFrame], method: str) -> NDArray[np.int64]:
    """Return the ids of a detector's regions."""
    if method == "flatregions":
        return frames["flat_region"]["region_id"].to_numpy(np.int64)
    table = frames["candidate_region"]
    return table.loc[table["method"] == method, "candidate_id"].to_numpy(np.int64)


def _counted(found: Found, rows: slice, columns: slice) -> dict[str, int]:
    """Count the own cells: all, valid, and a class label each."""
    classes, valid = found.window.scene.cover.classes, found.window.scene.heights.valid[rows, columns]
    index = np.bincount(classes.index[rows, columns].ravel(), minlength=256)
    counts = {"all": int(valid.size), "valid": int(np.count_nonzero(valid))}
    for number, label in sorted(classes.labels.items()):
        counts[label] = counts.get(label, 0) + int(index[number])
    return counts


def _owned(tile: Tile, found: Found, least_m2: float) -> tuple[dict[str, pd.DataFrame], dict[str, list[list[str]]]]:
    """Return the rows that a tile owns, and the stages and reasons that the numbers of its answers mean."""
    frames, kept = found.description.frames, found.description.rasters
    spec = found.window.scene.heights.spec
    buildings = owned_buildings(tile, frames["part"])
    own = {name: frames[name] for name in STRAIGHT}
    for name in ("building", "part"):
        own[name] = frames[name][frames[name]["building_id"].isin(buildings)]
    own["flat_region"] = _begun(
        tile, frames["flat_region"].sort_values("region_id"), kept.regions.get("flatregions"), spec
    )
    candidates = frames["candidate_region"].sort_values("candidate_id")
    some = [
        _begun(tile, candidates[candidates["method"] == method], kept.regions.get(method), spec)
        for method in sorted(POINT_DETECTORS)
    ]
    own["candidate_region"] = pd.concat(some)
    for name, key in (
        ("part_flat_region", "part"),
        ("part_candidate", "part"),
        ("flat_region_candidate", "flat_region"),
    ):
        first = frames[name].columns[0]
        own[name] = frames[name][frames[name][first].isin(own[key][first])]
    dropped = found.description.dropped
    dropped = dropped[tile.owns(dropped["xcen"].to_numpy(), dropped["ycen"].to_numpy())]
    numbered = frames["rejection_count"]
    counts = [sum_up(rows, numbered.iloc[:0], least_m2)[1] for _, rows in dropped.groupby("method")]
    own["rejection_count"] = pd.concat(counts or [numbered.iloc[:0]])
    ledger = frames["rejection"]
    own["rejection"] = ledger[tile.owns(ledger["xcen"].to_numpy(), ledger["ycen"].to_numpy())]
    kinds = {
        str(method): rows.sort_values("number")[["stage", "reason"]].to_numpy().tolist()
        for method, rows in numbered.groupby("method")
    }
    return {name: frame.reset_index(drop=True) for name, frame in own.items()}, kinds


def _begun(tile: Tile, regions: pd.DataFrame, labels: NDArray[np.int32] | None, spec: GridSpec) -> pd.DataFrame:
    """Return the regions, in order of their ids, whose first cell is the tile's; without a cell the centroid counts."""
    if labels is None or not len(regions):
        return regions
    x, y = first_cells(labels, len(regions), spec)
    x = np.where(np.isnan(x), regions["xcen"], x)
    y = np.where(np.isnan(y), regions["ycen"], y)
    return regions[tile.owns(x, y)]


@lru_cache(maxsize=4)
def _crs(wkt: str) -> CRS:
    """Return the CRS of a survey, made once for all of its tiles."""
    return CRS.from_wkt(wkt)


@dataclass(frozen=True, slots=True, eq=False)
class Result:
    """The result of a tile, read when it is asked for.

    Parameters
    ----------
    key : tuple of int
        Row and column of the tile.
    about : dict
        Its counts, and its share of the record of the survey.
    content : bytes
        The zip file.
    """

    key: tuple[int, int]
    about: dict[str, Any]
    content: bytes

    @classmethod
    def of(cls, key: tuple[int, int], content: bytes) -> "Result":
        """Return the result in the bytes that `packed` made."""
        with zipfile.ZipFile(io.BytesIO(content)) as file:
            return cls(key, json.loads(file.read("about.json")), content)

    @property
    def is_empty(self) -> bool:
        """Whether there is no point on the tile's ground."""
        return "origin" not in self.about

    def frames(self, *names: str) -> dict[str, pd.DataFrame]:
        """Return tables by name."""
        spatial = {table.name for table in TABLES if table.geometry}
        found = {}
        with zipfile.ZipFile(io.BytesIO(self.content)) as file:
            for name in names:
                frame = pd.read_parquet(io.BytesIO(file.read(f"{name}.parquet")))
                if name in spatial:
                    # geopandas would make a CRS of each table of each tile.
                    shapes = gpd.GeoSeries.from_wkb(frame["geometry"], crs=_crs(self.about["survey"]["crs_wkt"]))
                    frame = gpd.GeoDataFrame(frame.assign(geometry=shapes), geometry="geometry")
                found[name] = frame
        return found

    def array(self, name: str) -> NDArray[Any]:
        """Return an array."""
        with zipfile.ZipFile(io.BytesIO(self.content)) as file:
            found: NDArray[Any] = np.load(io.BytesIO(file.read(f"{name}.npy")), allow_pickle=False)
            return found

    def piece(self, names: tuple[str, ...], *, rasters: bool) -> Piece:
        """Return what the database takes, with these tables, and with rasters if asked for."""
        arrays: dict[str, NDArray[Any]] = {}
        if rasters:
            with zipfile.ZipFile(io.BytesIO(self.content)) as file:
                held = [name.removesuffix(".npy") for name in file.namelist() if name.endswith(".npy")]
            arrays = {name: self.array(name) for name in held}
        row, column = self.about["origin"]
        return Piece(
            self.key,
            self.frames(*names),
            (int(row), int(column)),
            {name.removeprefix("raster_"): cells for name, cells in arrays.items() if name.startswith("raster_")},
            {name.removeprefix("ids_"): ids for name, ids in arrays.items() if name.startswith("ids_")},
            {name: [(stage, why) for stage, why in kinds] for name, kinds in self.about["kinds"].items()},
        )
