"""Reading points from LAS, LAZ and COPC files of any point format, in chunks, on all cores.

Withheld points, noise (classes 7 and 18) and points with absurd coordinates are dropped. A notice counts them, and
``read_points_indexed`` returns the places of the others. Class 17 is kept: the standard says bridge deck, but some
surveys mark strip overlap with it, roofs included. What a person should know is warned as `MsbdbWarning`.
"""

import logging
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import laspy
import numpy as np
import shapely
from laspy import DecompressionSelection as Fields
from numpy.typing import NDArray
from pyproj import CRS

from msbdb.errors import CRSError, InputError, NodataError, give_notice
from msbdb.grid import Bounds
from msbdb.io.crs import CrsLike, Reference, misplaced, name_of, reference, same_crs, settle
from msbdb.io.files import file_name, open_input
from msbdb.io.lasheader import (
    COLOURED_FORMATS,
    INFRARED_FORMATS,
    LasInfo,
    decoding,
    header_crs,
    read_las_header,
    vertical_unit,
)
from msbdb.io.laspoints import (
    COLOURS,
    Columns,
    as_cloud,
    is_believed,
    read_chunks,
    settle_echoes,
    widen_colours,
)
from msbdb.io.vector import Area, held
from msbdb.points.cloud import NOISE_CLASSES, PointCloud
from msbdb.surveyplan import PointFacts

# laspy logs what it then raises; without a handler, Python would also write it to the terminal.
logging.getLogger("laspy").addHandler(logging.NullHandler())

CHUNK_POINTS = 1_000_000
"""Points in memory in their raw form at a time."""

MORE = 1.05
"""Share of room for points in an area beyond what headers promise if points are spread evenly."""

MAX_EASTING_M = 1e8
"""Beyond it no projected CRS has a point: the largest false origins, with a zone's number in front, end at 6.1e7."""

MAX_HEIGHT_M = 2e4
"""Beyond it, up or down, there is no ground, building or aircraft."""

EXTRA_NAMES = {"red": "red", "green": "green", "blue": "blue", "nir": "nir", "infrared": "nir", "near_infrared": "nir"}
"""Names of extra bytes, in lower case, that hold a colour."""

Progress = Callable[[str, int, int], None]
"""Called with the step's name, the points done and the points in all."""


def read_points(
    paths: str | os.PathLike[str] | Sequence[str | os.PathLike[str]],
    *,
    crs: CrsLike | None = None,
    z_unit: str = "auto",
    target: CRS | None = None,
    bounds: Bounds | None = None,
    facts: PointFacts | None = None,
    area: Area | None = None,
    progress: Progress | None = None,
) -> PointCloud:
    """Read the points of one or many files of one survey, in metres.

    Parameters
    ----------
    paths : path or sequence of paths
        LAS 1.0 to 1.4, LAZ or COPC files, of point formats 0 to 10; COPC also at http and https URLs.
    crs : int, str or CRS, optional
        The CRS of files whose headers have none; where a header has one, it must be the same.
    z_unit : {'auto', 'm', 'ft', 'us-ft'}
        Unit of the heights; see ``msbdb.io.crs.reference``.
    target : CRS, optional
        A metric CRS for coordinates that must be reprojected; by default their UTM zone.
    bounds : tuple of float, optional
        Those of the whole survey in its own unit, where the files are a part of it: the CRS follows from its centre.
    facts : PointFacts, optional
        What holds for the whole survey, where the files are a part of it.
    area : Area, optional
        Only points in it are kept. Files that lie elsewhere by their headers are not read, nor are the nodes of
        COPC files that lie elsewhere.
    progress : callable, optional
        Called with ('read', points done, points in all).

    Returns
    -------
    PointCloud
        All points that were kept, in the files' order. Points that are there more than once count once; the last
        points then go to the places of those left out. 8-bit colours in the 16-bit fields (no value of a file above
        255) are multiplied by 257. Echoes are None where all are zero; intensity and colours where one value is
        everywhere. Colours are kept if every file has them.

    Raises
    ------
    FileError
        If a file is missing, damaged or truncated: a part of a file is never returned.
    CRSError
        If the CRS is missing, geographic, in conflict with ``crs``, or not the same in all files.
    NodataError
        If no points are left.

    Warns
    -----
    MsbdbWarning
        What was dropped, converted or assumed, with counts; each kind once, after all files are read.
    """
    wanted = Wanted(indexed=False, noise=False, target=target, bounds=bounds, facts=facts, area=area)
    return _read(paths, wanted, crs=crs, z_unit=z_unit, progress=progress)[0]


def read_points_indexed(
    paths: str | os.PathLike[str] | Sequence[str | os.PathLike[str]],
    *,
    crs: CrsLike | None = None,
    z_unit: str = "auto",
    noise: bool = False,
    progress: Progress | None = None,
) -> tuple[PointCloud, NDArray[np.int64]]:
    """Read points as `read_points` does, with their places in the files.

    Parameters
    ----------
    paths, crs, z_unit, progress
        As for `read_points`.
    noise : bool
        Keep points that are withheld, noise or far from all others as well; only absurd coordinates are dropped.

    Returns
    -------
    cloud : PointCloud
        The N points that were kept; those that are there more than once all are.
    index : (N,) ndarray of int64
        For each of them its number in the file, from 0, rising; over many files it runs on.

    Raises
    ------
    MsbdbError
        As `read_points` does.

    Warns
    -----
    MsbdbWarning
        As `read_points` does.
    """
    return _read(paths, Wanted(indexed=True, noise=noise), crs=crs, z_unit=z_unit, progress=progress)


@dataclass(frozen=True, slots=True)
class Wanted:
    """What is read of the files: ``indexed`` and ``noise`` of `read_points_indexed`, the rest as in `read_points`."""

    indexed: bool
    noise: bool
    target: CRS | None = None
    bounds: Bounds | None = None
    facts: PointFacts | None = None
    area: Area | None = None


def _read(
    paths: str | os.PathLike[str] | Sequence[str | os.PathLike[str]],
    wanted: Wanted,
    *,
    crs: CrsLike | None,
    z_unit: str,
    progress: Progress | None,
) -> tuple[PointCloud, NDArray[np.int64]]:
    """Return the points, and their places in the files where these are asked for; warn of what the notices say."""
    chosen = [paths] if isinstance(paths, str | os.PathLike) else list(paths)
    if not chosen:
        msg = "No point files were given; name at least one LAS, LAZ or COPC file."
        raise InputError(msg)
    files = [read_las_header(path) for path in chosen]
    references = _references(files, crs, z_unit, wanted)
    if wanted.area is not None:
        files, references = _meeting(wanted.area, files, references)
    colours = [set(_colour_fields(info)) for info in files]
    common = tuple(name for name in COLOURS if name in set.intersection(*colours))
    count = sum(info.points for info in files)
    room = count if wanted.area is None else min(count, _expected(wanted.area, files, references))
    columns = Columns(room, common, indexed=wanted.indexed, noise=wanted.noise)
    columns.shape = None if wanted.area is None else wanted.area.shape_in(references[0].crs)
    for info, each in zip(files, references, strict=True):
        for notice in each.notices:
            columns.note(notice, file_name(info.path))
    partly = set.union(*colours).difference(columns.colour_names)
    if partly:
        columns.note(f"colours that not every file has were left out: {', '.join(sorted(partly))}.")
    has_echoes = _fill(files, references, columns, progress)
    cloud, index = as_cloud(columns, references, has_echoes=has_echoes, facts=wanted.facts)
    wrong_place = misplaced(cloud.crs, cloud.bounds)
    if wrong_place is not None:
        columns.note(wrong_place)
    for notice in columns.notices:
        give_notice(notice, stacklevel=3)
    return cloud, index


def _fill(
    files: Sequence[LasInfo], references: Sequence[Reference], columns: Columns, progress: Progress | None
) -> bool:
    """Fill the columns file by file; return whether any file has echo numbers."""
    total = sum(info.points for info in files)
    echoes: list[bool] = []
    done = 0
    for info, each in zip(files, references, strict=True):
        name = file_name(info.path)
        begin, after = columns.filled, done + info.points
        for part in _fill_from(info, each, columns):
            done += part
            if progress is not None:
                progress("read", done, total)
        if progress is not None and done < after:
            progress("read", after, total)
        done = after
        if columns.filled > begin:
            own = {name: column[begin : columns.filled] for name, column in columns.arrays.items()}
            if widen_colours(own["colours"]):
                columns.note("colours of 8 bits (none above 255) were multiplied by 257.", name)
            if _leaves_bounds(info, each, own):
                columns.note("points lie outside of the bounds in the header, which is not trusted.", name)
            echoes.append(settle_echoes(own))
            if not echoes[-1]:
                columns.note("no echo information, so that every point counts as a first echo.", name)
    return any(echoes)


def _references(files: Sequence[LasInfo], crs: CrsLike | None, z_unit: str, wanted: Wanted) -> list[Reference]:
    """Return how each file's coordinates become metric, checking that all files have one CRS."""
    bounds = wanted.bounds or _union([info.bounds for info in files])
    found = []
    for info in files:
        where = file_name(info.path)
        own = settle(header_crs(info.projection), crs, where)
        hint = vertical_unit(info.projection)
        found.append(reference(own, bounds=bounds, where=where, z_unit=z_unit, z_hint=hint, target=wanted.target))
    for info, each in zip(files, found, strict=True):
        if not same_crs(each.source, found[0].source):
            msg = (
                f"{file_name(files[0].path)} has the CRS {name_of(found[0].source)}, but {file_name(info.path)} has "
                f"{name_of(each.source)}. Reproject one of them, for instance with 'pdal translate'."
            )
            raise CRSError(msg)
    verticals = {each.vertical_crs for each in found} - {None}
    if len(verticals) > 1:
        names = " and ".join(sorted(f"'{vertical.name}'" for vertical in verticals if vertical is not None))
        msg = f"The files' heights have different vertical CRSs, {names}. Transform one of them first."
        raise CRSError(msg)
    return found


def _meeting(
    area: Area, files: Sequence[LasInfo], references: Sequence[Reference]
) -> tuple[list[LasInfo], list[Reference]]:
    """Return the files that may have points in an area; headers with wrong bounds decide nothing.

    Raises
    ------
    NodataError
        When all of them lie elsewhere.
    """
    shape = area.shape_in(references[0].crs)
    shapely.prepare(shape)
    found = []
    for info, each in zip(files, references, strict=True):
        box = each.box_in_metres(info.bounds)
        apart = np.isfinite(box).all() and not shapely.intersects(shape, shapely.box(*box))
        if not apart or not is_believed(info):
            found.append((info, each))
    if not found:
        msg = f"No point file lies in {area.what}. Check the area, its CRS, and that of the points."
        raise NodataError(msg)
    return [info for info, _ in found], [each for _, each in found]


def _expected(area: Area, files: Sequence[LasInfo], references: Sequence[Reference]) -> int:
    """Return about how many points lie in an area, as far as headers tell that; room for more is made if needed."""
    shape, found = area.shape_in(references[0].crs), 0.0
    for info, each in zip(files, references, strict=True):
        box = each.box_in_metres(info.bounds)
        ground = shapely.box(*box)
        if np.isfinite(box).all() and shapely.is_valid(ground) and ground.area > 0:
            found += info.points * shapely.intersection(ground, shape).area / ground.area
    return max(round(MORE * found), CHUNK_POINTS)


def _union(bounds: Sequence[Bounds]) -> Bounds:
    """Return the bounds of all bounds."""
    west, south, east, north = zip(*bounds, strict=True)
    return (min(west), min(south), max(east), max(north))


def _colour_fields(info: LasInfo) -> dict[str, str]:
    """Return the fields that hold colours, by colour: those of the point format, else extra bytes so named."""
    if info.point_format in COLOURED_FORMATS:
        return {name: name for name in COLOURS if name != "nir" or info.point_format in INFRARED_FORMATS}
    with decoding(info.path), laspy.open(open_input(info.path), read_evlrs=False) as reader:
        extra = list(reader.header.point_format.extra_dimensions)
    named = {EXTRA_NAMES.get(dim.name.lower()): dim.name for dim in extra if dim.dtype.kind in "ui"}
    if {"red", "green", "blue"} <= named.keys():
        return {name: named[name] for name in COLOURS if name in named}
    return {}


def _fill_from(info: LasInfo, how: Reference, columns: Columns) -> Iterator[int]:
    """Append a file's points to the columns, yielding the number of points read after each chunk."""
    fields = _colour_fields(info)
    wanted = Fields.XY_RETURNS_CHANNEL | Fields.Z | Fields.CLASSIFICATION | Fields.FLAGS | Fields.INTENSITY
    if columns.colour_names:
        wanted |= Fields.RGB | Fields.NIR | Fields.ALL_EXTRA_BYTES
    for chunk in read_chunks(info, CHUNK_POINTS, wanted, _box(columns.shape, how)):
        _append(chunk, info, how, columns, {name: fields[name] for name in columns.colour_names})
        yield len(chunk)


def _box(shape: shapely.Geometry | None, how: Reference) -> Bounds | None:
    """Return the bounds of an area in a file's own units; None for all."""
    if shape is None:
        return None
    west, south, east, north = shapely.bounds(shape).tolist()
    box = how.box_in_units((west, south, east, north))
    return box if np.isfinite(box).all() else None


def _append(
    chunk: laspy.ScaleAwarePointRecord, info: LasInfo, how: Reference, columns: Columns, colour_fields: dict[str, str]
) -> None:
    """Append a chunk's good points to the columns."""
    raw = (chunk.X, chunk.Y, chunk.Z)
    with np.errstate(over="ignore"):
        x, y, z = (a * s + o for a, s, o in zip(raw, info.scales, info.offsets, strict=True))
        x, y, z = how.to_metres(x, y, z)
    classes = np.asarray(chunk.classification, dtype=np.uint8)
    withheld = np.asarray(chunk.withheld, dtype=np.bool_)
    noise = np.isin(classes, NOISE_CLASSES)
    # A comparison with NaN is false, so that points which are not finite are absurd as well.
    sound = (np.abs(x) <= MAX_EASTING_M) & (np.abs(y) <= MAX_EASTING_M) & (np.abs(z) <= MAX_HEIGHT_M)
    if columns.noise:
        withheld, noise = np.zeros_like(withheld), np.zeros_like(noise)
    keep = sound & ~withheld & ~noise
    if columns.shape is not None:
        inside = held(columns.shape, x, y)
        keep, withheld, noise, sound = keep & inside, withheld & inside, noise & inside, sound | ~inside
    columns.dropped["flagged as withheld"] += int(withheld.sum())
    columns.dropped["of the noise classes 7 and 18"] += int((noise & ~withheld).sum())
    columns.dropped["of absurd coordinates"] += int((~sound & ~withheld & ~noise).sum())
    values: dict[str, NDArray[Any]] = {"x": x, "y": y, "z": z, "classification": classes}
    plain = {name: name for name in ("return_number", "number_of_returns", "intensity")}
    values |= {name: np.asarray(chunk[source]) for name, source in (plain | colour_fields).items()}
    columns.append(values, keep)


def _leaves_bounds(info: LasInfo, how: Reference, own: Mapping[str, NDArray[Any]]) -> bool:
    """Return whether a file's points lie more than a metre outside of the bounds that its header states."""
    west, south, east, north = how.box_in_metres(info.bounds)
    # Bounds that are no numbers fail the comparison, and count as wrong.
    inside = (west - 1 <= own["x"].min(), own["x"].max() <= east + 1)
    return not all((*inside, south - 1 <= own["y"].min(), own["y"].max() <= north + 1))
