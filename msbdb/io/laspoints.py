"""The points of files: read chunk by chunk, of COPC by its nodes, into columns that become a point cloud at the end."""

import logging
import os
import struct
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, BinaryIO

import laspy
import lazrs
import numpy as np
import shapely
from laspy import DecompressionSelection as Fields
from numpy.typing import NDArray

from msbdb.errors import FileError, NodataError, counted
from msbdb.grid import Bounds
from msbdb.io.crs import Reference
from msbdb.io.files import open_input, shown, url_of
from msbdb.io.lasheader import COPC, LAZ_RECORD, LasInfo, count_layers, decoding, is_whole
from msbdb.points.cloud import PointCloud
from msbdb.points.lonepoints import lone_points
from msbdb.points.repeated import repeated
from msbdb.surveyplan import PointFacts

logger = logging.getLogger(__name__)

COLOURS = ("red", "green", "blue", "nir")

FIRST_POINTS = 10_000
"""Points of a file that are read to see whether its header is right."""

NODE = np.dtype(
    [("level", "<i4"), ("x", "<i4"), ("y", "<i4"), ("z", "<i4"), ("offset", "<u8"), ("size", "<i4"), ("points", "<i4")]
)
"""A node of COPC as a page holds it. Points of -1 mean another page, and 0 no points of its own."""

MOST_POINTS = 10_000_000
"""In a node; writers put about 100,000 there."""

GROWTH = 1.3
"""Factor by which columns grow: the larger, the more memory is left over, and the less is copied."""

REPEATED = "{} {} another one in place and echo number. Each place counts once."

DTYPES = {
    "x": np.float64,
    "y": np.float64,
    "z": np.float64,
    "classification": np.uint8,
    "return_number": np.uint8,
    "number_of_returns": np.uint8,
    "intensity": np.uint16,
}


def read_chunks(
    info: LasInfo, at_once: int, wanted: Fields | None = None, box: Bounds | None = None
) -> Iterator[laspy.ScaleAwarePointRecord]:
    """Yield the points of a file in their order.

    Parameters
    ----------
    info : LasInfo
        The file's header.
    at_once : int
        Points in each chunk but the last; of the nodes of COPC as many or fewer, but one node at least.
    wanted : DecompressionSelection, optional
        The fields that are decompressed, which only point formats from 6 on keep apart; by default all.
    box : tuple of float, optional
        West, south, east and north in the file's units: of a COPC file only nodes that meet it are read. They have all
        of the points in it, and others beside it.

    Raises
    ------
    FileError
        If the points cannot be decoded, or are fewer than the header promises.
    """
    if info.is_copc and (box is not None or url_of(info.path) is not None):
        yield from _read_nodes(info, at_once, Fields.all() if wanted is None else wanted, box)
        return
    with (
        decoding(info.path),
        laspy.open(
            info.path,
            laz_backend=laspy.LazBackend.LazrsParallel,
            read_evlrs=False,
            decompression_selection=Fields.all() if wanted is None else wanted,
        ) as reader,
    ):
        read = 0
        for chunk in reader.chunk_iterator(at_once):
            read += len(chunk)
            yield chunk
        if read != info.points:
            msg = f"only {read} of {info.points} points could be read"
            raise OSError(msg)


def octree(info: LasInfo) -> tuple[float, float, float, float, int, int]:
    """Return middle and half size of the cube of a COPC file in its units, and place and size of its first page.

    Raises
    ------
    FileError
        If its first record has no such numbers.
    """
    first = info.records[0]
    if (first.user_id, first.record_id) != (COPC, 1) or len(first.record_data) < 56:
        raise FileError(_no_copc(info, "its first record does not describe the octree"))
    x, y, z, half, _, place, size = struct.unpack_from("<5d2Q", first.record_data)
    if not (np.isfinite([x, y, z, half]).all() and half > 0):
        raise FileError(_no_copc(info, f"its cube at {x:g}, {y:g} has half a side of {half:g}"))
    return x, y, z, half, place, size


def _no_copc(info: LasInfo, why: str) -> str:
    """Return the words for a damaged COPC file."""
    return f"{shown(info.path)} is not a valid COPC file: {why}. Fetch or export it again."


def _find_nodes(file: BinaryIO, info: LasInfo, box: Bounds | None) -> NDArray[np.void]:
    """Return the nodes with points that meet a box, or all, in the order of the file."""
    x, y, _, half, place, size = octree(info)
    end, pages, seen = file.seek(0, os.SEEK_END), [(place, size)], set[int]()
    found = [np.zeros(0, dtype=NODE)]
    while pages:
        place, size = pages.pop()
        if place in seen or size <= 0 or size % NODE.itemsize or place + size > end:
            raise FileError(_no_copc(info, f"a page of its nodes cannot be at byte {place} with {size} bytes"))
        seen.add(place)
        file.seek(place)
        page = np.frombuffer(file.read(size), dtype=NODE)
        side = 2 * half / 2.0 ** np.clip(page["level"], 0, 31)
        west, south = x - half + page["x"] * side, y - half + page["y"] * side
        meets = np.ones(len(page), dtype=np.bool_)
        if box is not None:
            # A unit more, as coordinates are rounded.
            meets = (west <= box[2] + 1) & (west + side >= box[0] - 1)
            meets &= (south <= box[3] + 1) & (south + side >= box[1] - 1)
        chosen = page[meets]
        pages += [(int(one["offset"]), int(one["size"])) for one in chosen[chosen["points"] == -1]]
        found.append(chosen[chosen["points"] > 0])
    nodes = np.sort(np.concatenate(found), order="offset")
    offsets, sizes = nodes["offset"].astype(np.int64), nodes["size"].astype(np.int64)
    total = int(nodes["points"].astype(np.int64).sum())
    apart = np.all(sizes > 0) and np.all(offsets[:-1] + sizes[:-1] <= offsets[1:])
    if not apart or (len(nodes) and offsets[-1] + sizes[-1] > info.points_end) or np.any(nodes["points"] > MOST_POINTS):
        raise FileError(_no_copc(info, "its nodes lie over each other or beyond the points, or are too large"))
    if total > info.points or (box is None and total != info.points):
        raise FileError(_no_copc(info, f"its nodes hold {total} points, and the header promises {info.points}"))
    return nodes


def _read_nodes(
    info: LasInfo, at_once: int, wanted: Fields, box: Bounds | None
) -> Iterator[laspy.ScaleAwarePointRecord]:
    """Yield the points of the nodes that meet a box; neighbours in the file are read together."""
    laz = next(record.record_data for record in info.records if (record.user_id, record.record_id) == LAZ_RECORD)
    layers = count_layers(laz)
    with decoding(info.path), laspy.open(open_input(info.path), read_evlrs=False) as reader:
        point_format = reader.header.point_format
    with decoding(info.path), open_input(info.path) as file:
        nodes = _find_nodes(file, info, box)
        group = np.maximum(nodes["points"].astype(np.int64).cumsum() - 1, 0) // at_once
        for chosen in np.split(nodes, np.flatnonzero(np.diff(group)) + 1):
            chunks: list[bytes] = []
            follows = np.append(np.diff(chosen["offset"].astype(np.int64)) == chosen["size"][:-1], False)
            for run in np.split(chosen, np.flatnonzero(~follows) + 1):
                if len(run):
                    file.seek(int(run["offset"][0]))
                    whole = file.read(int(run["size"].astype(np.int64).sum()))
                    ends = run["size"].astype(np.int64).cumsum().tolist()
                    chunks += [whole[end - size : end] for end, size in zip(ends, run["size"].tolist(), strict=True)]
            if not all(is_whole(chunk, len(chunk), info.record_size, layers) for chunk in chunks):
                raise FileError(_no_copc(info, "the layers of a node do not fill it"))
            raw = np.zeros(int(chosen["points"].sum()) * info.record_size, dtype=np.uint8)
            table = list(zip(chosen["points"].tolist(), chosen["size"].tolist(), strict=True))
            lazrs.decompress_points_with_chunk_table(b"".join(chunks), laz, raw, table, wanted.to_lazrs())
            points = laspy.PackedPointRecord.from_buffer(raw, point_format)
            yield laspy.ScaleAwarePointRecord(points.array, point_format, info.scales, info.offsets)


def is_believed(info: LasInfo) -> bool:
    """Return whether the bounds in a header hold the first points; of a remote file, whether they lie in its cube."""
    west, south, east, north = info.bounds
    if url_of(info.path) is not None:
        across, along, _, half = octree(info)[:4]
        wide = across - half - 1 <= west <= east <= across + half + 1
        return bool(wide and along - half - 1 <= south <= north <= along + half + 1)
    chunk = next(read_chunks(info, FIRST_POINTS, Fields.XY_RETURNS_CHANNEL))
    x, y = (np.asarray(raw) * info.scales[axis] + info.offsets[axis] for axis, raw in enumerate((chunk.X, chunk.Y)))
    beside = 1 + max(info.scales[:2])
    inside = (x > west - beside) & (x < east + beside) & (y > south - beside) & (y < north + beside)
    return bool(inside.all())


class Columns:
    """The columns of all points, filled file by file; ``filled`` counts the rows in use, ``seen`` what was offered.

    ``shape`` is the area in which points are kept; None for all.
    """

    def __init__(self, points: int, colour_names: tuple[str, ...], *, indexed: bool, noise: bool) -> None:
        """Make room for that many points; ``indexed`` keeps their places in the files, ``noise`` keeps noise points."""
        self.arrays: dict[str, NDArray[Any]] = {name: np.empty(points, dtype) for name, dtype in DTYPES.items()}
        self.arrays["colours"] = np.empty((points, len(colour_names)), dtype=np.uint16)
        self.index = np.empty(points if indexed else 0, dtype=np.int64)
        self.colour_names = colour_names
        self.indexed, self.noise = indexed, noise
        self.shape: shapely.Geometry | None = None
        self.filled = self.seen = 0
        self.dropped: Counter[str] = Counter()
        self._notices: dict[str, list[str]] = {}

    def note(self, notice: str, *files: str) -> None:
        """Keep a notice about files, or about all points."""
        self._notices.setdefault(notice, []).extend(files)

    @property
    def notices(self) -> list[str]:
        """The notices, each once, with the first file that it is about and the number of others."""
        found = []
        for notice, files in self._notices.items():
            others = f" (and {len(files) - 1} more)" if len(files) > 1 else ""
            found.append(f"{files[0]}{others}: {notice}" if files else notice)
        return found

    def _grow(self, rows: int) -> None:
        """Make room for as many rows, and some more, where nobody knows how many there will be."""
        size = max(rows, round(GROWTH * len(self.arrays["x"])))
        if self.indexed:
            self.index = _longer(self.index, self.filled, size)
        for name, column in self.arrays.items():
            self.arrays[name] = _longer(column, self.filled, size)

    def append(self, values: Mapping[str, NDArray[Any]], keep: NDArray[np.bool_]) -> None:
        """Append the kept rows of a chunk."""
        begin, end = self.filled, self.filled + int(keep.sum())
        if end > len(self.arrays["x"]):
            self._grow(end)
        every = end - begin == len(keep)
        for name, column in values.items():
            target = self.arrays["colours"][:, self.colour_names.index(name)] if name in COLOURS else self.arrays[name]
            target[begin:end] = column if every else column[keep]
        if self.indexed:
            self.index[begin:end] = self.seen + np.flatnonzero(keep)
        self.filled = end
        self.seen += len(keep)

    def leave_out_repeated(self) -> None:
        """Leave out the points that repeat another one, and note how many there are."""
        used = {name: column[: self.filled] for name, column in self.arrays.items()}
        others = [used[name] for name in ("number_of_returns", "intensity", "colours")]
        again = repeated((used["x"], used["y"], used["z"]), used["return_number"], used["classification"], others)
        if not len(again):
            return
        self.note(REPEATED.format(counted(len(again), "point"), "repeats" if len(again) == 1 else "repeat"))
        self.filled -= len(again)
        # The last points go to the places that become free: nothing else is moved, and no column is copied.
        last = np.ones(len(again), dtype=np.bool_)
        last[again[again >= self.filled] - self.filled] = False
        free = again[again < self.filled]
        for column in used.values():
            column[free] = column[self.filled :][last]


def _longer(column: NDArray[Any], filled: int, size: int) -> NDArray[Any]:
    """Return a column with more rows."""
    longer = np.empty((size, *column.shape[1:]), dtype=column.dtype)
    longer[:filled] = column[:filled]
    return longer


def widen_colours(colours: NDArray[np.uint16]) -> bool:
    """Stretch a file's 8-bit colours to 16 bits in place, so that 255 becomes 65535; return whether they were."""
    narrow = 0 < int(colours.max(initial=0)) <= 255
    if narrow:
        colours *= np.uint16(257)
    return narrow


def settle_echoes(own: Mapping[str, NDArray[Any]]) -> bool:
    """Return whether a file has echo information; without, its points become single echoes, in place."""
    if own["return_number"].any():
        return True
    own["return_number"][:] = 1
    own["number_of_returns"][:] = 1
    return False


def as_cloud(
    columns: Columns, references: Sequence[Reference], *, has_echoes: bool, facts: PointFacts | None = None
) -> tuple[PointCloud, NDArray[np.int64]]:
    """Drop lone points, leave out constant attributes, and count in the notices; return the points' places, too.

    Points that are there more than once count once, unless their places in the files are asked for: then all of them
    are. Where facts are known, the whole survey decides what is lone or constant.
    """
    if not columns.indexed:
        columns.leave_out_repeated()
    used = {name: column[: columns.filled] for name, column in columns.arrays.items()}
    index = columns.index[: columns.filled]
    lone = np.zeros(columns.filled, dtype=np.bool_)
    if not columns.noise:
        lone = lone_points(used["x"], used["y"], used["z"], facts)
    columns.dropped["far from all others"] = int(lone.sum())
    for why, count in columns.dropped.items():
        if count:
            columns.note(f"{counted(count, 'point')} {why} {'was' if count == 1 else 'were'} dropped.")
    if lone.all():  # also where nothing is left to be lone
        msg = f"No points are left of {columns.seen}. {' '.join(columns.notices)}"
        raise NodataError(msg)
    colours, intensity = used["colours"], used["intensity"]
    varied = _varied_colours(colours, columns.colour_names)
    kept = varied if facts is None else [i for i, name in enumerate(columns.colour_names) if name in facts.colours]
    if len(kept) < len(columns.colour_names):
        plain = ", ".join(name for i, name in enumerate(columns.colour_names) if i not in kept)
        columns.note(f"colours that are the same for all points were left out: {plain}.")
        colours = colours[:, kept]
    varies = intensity.min() != intensity.max() if facts is None else facts.intensity
    has_echoes = has_echoes if facts is None else facts.numbered
    cloud = PointCloud(
        used["x"],
        used["y"],
        used["z"],
        crs=references[0].crs,
        vertical_crs=next((each.vertical_crs for each in references if each.vertical_crs is not None), None),
        classification=used["classification"] if used["classification"].any() else None,
        return_number=used["return_number"] if has_echoes else None,
        number_of_returns=used["number_of_returns"] if has_echoes else None,
        intensity=intensity if varies else None,
        colours=colours if kept else None,
        colour_names=tuple(columns.colour_names[i] for i in kept),
        facts=facts,
    )
    dropped = ", ".join(f"{count} {why}" for why, count in columns.dropped.items() if count)
    logger.info("Read %d points; dropped are %s", len(cloud), dropped or "none")
    if not lone.any():
        return cloud, index
    return cloud.take(~lone), index[~lone] if columns.indexed else index


def _varied_colours(colours: NDArray[np.uint16], names: tuple[str, ...]) -> list[int]:
    """Return the columns of the colours that vary; red, green and blue are kept together."""
    varied = [bool(len(colours)) and bool(colours[:, i].min() != colours[:, i].max()) for i in range(len(names))]
    visible = any(varies for varies, name in zip(varied, names, strict=True) if name != "nir")
    return [i for i, name in enumerate(names) if (varied[i] if name == "nir" else visible)]
