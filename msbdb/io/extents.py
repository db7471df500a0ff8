"""Where files say they are: a check of headers before the work, as points take minutes to read.

Headers of points may be wrong. Only one that holds the first points of its file is believed.
"""

import struct
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyogrio
from pyogrio.errors import DataLayerError, DataSourceError
from pyproj import CRS, Transformer
from pyproj.exceptions import ProjError

from msbdb.errors import GridMismatchError, InputError, collected_notices
from msbdb.grid import Bounds
from msbdb.io.crs import CrsLike, name_of, reference, same_crs, settle, split_crs
from msbdb.io.files import file_name, shown
from msbdb.io.lasheader import LasInfo, header_crs, read_las_header
from msbdb.io.laspoints import is_believed
from msbdb.io.raster import open_raster, raster_bounds, raster_crs

IMAGE = "image"
"""The role of a raster that has no heights."""


@dataclass(frozen=True, slots=True, eq=False)
class Extent:
    """The rectangle that files cover.

    Parameters
    ----------
    bounds : tuple of float
        West, south, east and north in the unit of the CRS.
    crs : CRS
        Horizontal.
    what : str
        What covers it, for messages.
    """

    bounds: Bounds
    crs: CRS
    what: str

    def is_apart(self, other: "Extent") -> bool:
        """Return whether the two have no place in common; False where that cannot be known."""
        west, south, east, north = self.bounds
        theirs = other.bounds
        if not same_crs(self.crs, other.crs):
            try:
                transformer = Transformer.from_crs(other.crs, self.crs, always_xy=True)
                theirs = transformer.transform_bounds(*theirs)
            except ProjError:
                return False
        if not np.isfinite([*self.bounds, *theirs]).all():
            return False
        return theirs[2] < west or east < theirs[0] or theirs[3] < south or north < theirs[1]

    def __str__(self) -> str:
        """Return what it is, its bounds and its CRS."""
        digits = 1 if self.crs.is_projected else 5
        return f"{self.what} {tuple(round(value, digits) for value in self.bounds)} in {name_of(self.crs)}"


def extent_of_points(paths: Sequence[Path], crs: CrsLike | None) -> Extent | None:
    """Return what the headers of points cover together, or None where a header is wrong.

    Raises
    ------
    FileError, NodataError, CRSError
        As `msbdb.io.las.read_points`.
    """
    files = [read_las_header(path) for path in paths]
    found = [_settled(header_crs(info.projection), crs, info.path) for info in files]
    if not all(same_crs(one, found[0]) for one in found) or not all(map(is_believed, files)):
        return None
    west, south, east, north = zip(*(info.bounds for info in files), strict=True)
    return Extent((min(west), min(south), max(east), max(north)), found[0], "the points have the bounds")


def extent_of_raster(path: Path, crs: CrsLike | None, role: str) -> Extent:
    """Return what a raster of heights or an image covers.

    Raises
    ------
    FileError, CRSError
        As `msbdb.io.raster.read_grid`; an image may be in degrees.
    """
    with open_raster(path) as dataset, collected_notices():
        bounds, own = raster_bounds(dataset), raster_crs(dataset, crs)
        if role != IMAGE:
            reference(own, bounds=bounds, where=path.name, what=f"cells of the {role}")
        return Extent(bounds, split_crs(own)[0], f"the {role} {path.name} has")


def extent_of_polygons(path: Path) -> Extent | None:
    """Return what the only layer of a vector file covers; None where it has several, or states no CRS or bounds."""
    try:
        if len(pyogrio.list_layers(path)) != 1:
            return None
        info = pyogrio.read_info(path, force_total_bounds=True)
    except (DataSourceError, DataLayerError):
        return None
    if info["crs"] is None or info["total_bounds"] is None:
        return None
    return Extent(tuple(info["total_bounds"]), split_crs(CRS.from_user_input(info["crs"]))[0], f"{path.name} has")


def require_common_place(first: Extent, others: Sequence[Extent]) -> None:
    """Refuse files when none of them has a place in common with the first ones.

    Raises
    ------
    GridMismatchError
        With the bounds of both.
    """
    if others and all(first.is_apart(other) for other in others):
        msg = (
            f"The files are not of the same place: {first}, but {', '.join(map(str, others))}. "
            "Give files of one place, or correct a wrong CRS."
        )
        raise GridMismatchError(msg)


def require_other_points(paths: Sequence[Path]) -> None:
    """Refuse two files of the same points, such as a LAZ and the COPC made from it, by what their headers say.

    Raises
    ------
    InputError
        For files with the same number of points, and the same bounds in x, y and z.
    """
    for _, pair in same_points(dict(enumerate(map(read_las_header, paths)))):
        raise InputError(twice(*pair))


def twice(one: LasInfo, other: LasInfo) -> str:
    """Return the words for two files with the same points."""
    return (
        f"The same points are given twice: {shown(one.path)} and {shown(other.path)} have {one.points} points each, "
        "and the same bounds in x, y and z. Leave one out."
    )


def same_points(infos: Mapping[int, LasInfo]) -> Iterator[tuple[int, tuple[LasInfo, LasInfo]]]:
    """Yield the number of each file that has the points of an earlier one, with both."""
    by_count: dict[int, list[LasInfo]] = defaultdict(list)
    for number, info in infos.items():
        first = next((one for one in by_count[info.points] if _is_same_box(one, info)), None)
        if first is None:
            by_count[info.points].append(info)
        else:
            yield number, (first, info)


def _settled(found: CRS | None, stated: CrsLike | None, path: Path) -> CRS:
    """Return the horizontal CRS of a file, without the notices that come when it is read."""
    with collected_notices():
        return split_crs(settle(found, stated, file_name(path)))[0]


def _is_same_box(one: LasInfo, other: LasInfo) -> bool:
    """Return whether two headers have the same bounds, to the step of the coarser one, and not empty ones.

    Bounds in two CRSs are not the same.
    """
    crs = [
        None if found is None else split_crs(found)[0] for found in map(header_crs, (one.projection, other.projection))
    ]
    if crs[0] is not None and crs[1] is not None and not same_crs(crs[0], crs[1]):
        return False
    ours, theirs = (np.array(struct.unpack_from("<6d", info.header, 179)) for info in (one, other))
    step = np.repeat(np.maximum(np.abs(one.scales), np.abs(other.scales)), 2)
    wide = (ours[0] > ours[1]) and (ours[2] > ours[3])
    return bool(wide and (np.abs(ours - theirs) < 1.01 * step).all())
