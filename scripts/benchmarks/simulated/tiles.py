"""Two epochs of a real tile in files, and what is found of the known edits between them."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import geopandas as gpd
import laspy
import numpy as np
import pandas as pd
import shapely

from msbdb.database import open_database, read_buildings, read_rasters, read_survey
from msbdb.io.las import read_points
from msbdb.kept import heights_of
from msbdb.params import profile
from msbdb.points.cloud import PointCloud
from msbdb.run.preparation.drafts import build_surface
from msbdb.run.reports import Notices, collect_notices
from msbdb.surface import heights_above
from simulated.epochs import EDITS, Edit, second_epoch

LEAST_M2 = 50.0
"""Changes of this area must be found."""

FOUND_SHARE = 0.5
"""An edit is found when a change of its kind covers this much of its place."""

UNTOUCHED_SHARE = 0.1
"""A building is untouched when edits cover less of it (and it less of them)."""

UNCLASSIFIED = 1


@dataclass(frozen=True)
class Judgement:
    """Edits that were found and missed, and the kinds of changes that were told of untouched buildings."""

    found: tuple[Edit, ...]
    missed: tuple[Edit, ...]
    invented: tuple[str, ...]

    def by_edit(self) -> dict[str, tuple[int, int]]:
        """Return what was found and missed of each edit."""
        return {
            what: (sum(edit.what == what for edit in self.found), sum(edit.what == what for edit in self.missed))
            for what in EDITS
        }


def write_first(sources: Sequence[Path], folder: Path) -> list[Path]:
    """Write the files of the first epoch: the tile with its classes wiped."""
    written = []
    for source in sources:
        las = laspy.read(source)
        las.classification = np.full(len(las.points), UNCLASSIFIED, dtype=np.uint8)
        written.append(folder / f"{source.stem}.laz")
        las.write(written[-1])
    return written


def write_second(
    first: Sequence[Path], db: Path, survey: str, folder: Path, *, seed: int, each: int, crs: str | None
) -> tuple[list[Path], tuple[Edit, ...]]:
    """Write the files of the second epoch, edited by what the database knows of the first; return the edits too."""
    files = [laspy.read(path) for path in first]
    xyz = [np.concatenate([np.asarray(las[axis], dtype=np.float64) for las in files]) for axis in "xyz"]
    with collect_notices(Notices()):  # the build of the same files reported them
        points = read_points(list(first), crs=crs)
    engine = open_database(db)
    ndsm = heights_of(read_survey(engine, survey), read_rasters(engine, survey))
    buildings = read_buildings(engine, survey)
    engine.dispose()
    heights = heights_above(PointCloud(*xyz, points.crs), build_surface(points, profile()).dtm)
    epoch = second_epoch((xyz[0], xyz[1], xyz[2]), buildings, ndsm, heights, each=each, seed=seed)
    starts = np.cumsum([0, *(len(las.points) for las in files)])
    written = []
    for las, path, begin, end in zip(files, first, starts, starts[1:], strict=False):
        inside = (epoch.kept >= begin) & (epoch.kept < end)
        out = laspy.LasData(las.header, las.points[epoch.kept[inside] - begin].copy())
        for name, values, offset, scale in zip(
            "XYZ", (epoch.x, epoch.y, epoch.z), las.header.offsets, las.header.scales, strict=True
        ):
            setattr(out, name, np.round((values[inside] - offset) / scale).astype(np.int32))
        written.append(folder / path.name)
        out.write(written[-1])
    return written, epoch.edits


def judge(edits: Sequence[Edit], told: gpd.GeoDataFrame, before: gpd.GeoDataFrame) -> Judgement:
    """Compare the changes that were told with the edits that were made.

    Parameters
    ----------
    edits : sequence of Edit
        The truth.
    told : GeoDataFrame
        Changes of the second survey (`msbdb.database.read_changes`).
    before : GeoDataFrame
        Versions of the inventory, by ``version_id``.
    """
    told = told[told["kind"] != "unchanged"]
    outlines = dict(zip(before["version_id"].astype(int), before.geometry, strict=True))
    places = [
        shape if pd.isna(version) else shape.union(outlines[int(version)])
        for shape, version in zip(told.geometry, told["version_before"], strict=True)
    ]
    told = told.assign(now=told.geometry).set_geometry(gpd.GeoSeries(places, index=told.index, crs=told.crs))
    large = [edit for edit in edits if edit.place.area >= LEAST_M2]
    found = tuple(edit for edit in large if _is_found(edit, told))
    everywhere = shapely.union_all([edit.place for edit in edits])
    invented = tuple(
        kind for kind, place in zip(told["kind"], places, strict=True) if not _is_touched(place, edits, everywhere)
    )
    return Judgement(found, tuple(edit for edit in large if edit not in found), invented)


def _is_found(edit: Edit, told: gpd.GeoDataFrame) -> bool:
    """Tell whether changes of an edit's kind, in the respect that it changes, cover half of it.

    A building may fall apart when a part is removed. What is built against a wall is new where the survey has it as a
    building of its own, and so is what replaces a building; else it is built onto its neighbour.
    """
    right = told["kind"] == edit.kind
    if edit.respect:
        right = told["kind"].isin(["modified", "merged", "split"]) & told[edit.respect]
    if edit.what == "extended":
        right |= told["kind"] == "new"
    shapes = told.geometry
    if edit.what == "replaced":
        right |= told["kind"].isin(["modified", "merged"]) & told["outline"]
        shapes = told["now"]  # the replaced building stood there before
    covered = shapely.union_all(shapes[right].to_numpy()).intersection(edit.place).area
    return bool(covered >= FOUND_SHARE * edit.place.area)


def _is_touched(place: shapely.Geometry, edits: Sequence[Edit], everywhere: shapely.Geometry) -> bool:
    """Tell whether edits cover a tenth of a building, or it a tenth of one of them."""
    if place.intersection(everywhere).area >= UNTOUCHED_SHARE * place.area:
        return True
    return any(place.intersection(edit.place).area >= UNTOUCHED_SHARE * edit.place.area for edit in edits)
