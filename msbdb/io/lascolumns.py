"""The columns of points while their files are read: filled chunk by chunk, and turned into a point cloud at the end."""

import logging
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from msbdb.errors import NodataError, counted
from msbdb.io.crs import Reference
from msbdb.points.cloud import PointCloud, lone_points
from msbdb.surveyplan import PointFacts

logger = logging.getLogger(__name__)

COLOURS = ("red", "green", "blue", "nir")

DTYPES = {
    "x": np.float64,
    "y": np.float64,
    "z": np.float64,
    "classification": np.uint8,
    "return_number": np.uint8,
    "number_of_returns": np.uint8,
    "intensity": np.uint16,
}


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
        """Make room for as many rows, and as many again, where nobody knows how many there will be."""
        size = max(rows, 2 * len(self.arrays["x"]))
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

    Where facts are known, the whole survey decides what is lone or constant.
    """
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
