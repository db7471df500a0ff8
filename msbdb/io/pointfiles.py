"""The point files that a user means: single ones, a folder, a pattern, an index of files; and which of them fit."""

import json
import os
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pyogrio
import shapely
from pyogrio.errors import DataLayerError, DataSourceError

from msbdb.errors import (
    CRSError,
    FileError,
    GridMismatchError,
    InputError,
    MsbdbError,
    counted,
    give_notice,
)
from msbdb.io.crs import name_of, same_crs, split_crs
from msbdb.io.extents import same_points, twice
from msbdb.io.files import file_name, require_input, shown, url_of
from msbdb.io.lasheader import LasInfo, header_crs, read_las_header
from msbdb.io.laspoints import is_believed

LAS_ENDINGS = (".las", ".laz")
"""The endings of point files, COPC among them."""

CLOUD_ENDING = ".vpc"
"""The ending of a virtual point cloud: a STAC collection of files, as PDAL and QGIS write it."""

INDEX_ENDINGS = (".gpkg", ".geojson", ".json", ".shp", ".fgb", ".sqlite")
"""The endings of tile indexes: an outline of each file with its place, as pdal tindex and gdaltindex write them."""

PLACES = ("location", "url", "href", "path", "file", "filename", "file_name")
"""Columns of a tile index with the place of the file, in lower case; the first of them counts."""

PATTERN_SIGNS = "*?["
"""What a pattern has, and a name that is no pattern rarely."""

APART = 10_000.0
"""Units of the CRS between files that are of two places: a survey that is built at once has a few kilometres."""

SIDES = np.array([-1, -1, 1, 1])
"""What makes a box larger on all sides."""

LISTED = 10
"""As many files are named in a message."""


def point_files(given: Sequence[str | os.PathLike[str]]) -> tuple[Path, ...]:
    """Return the files that paths, folders, patterns, virtual point clouds and tile indexes name.

    Parameters
    ----------
    given : sequence of path
        A file stays as it is, also where it is missing, and so does an http or https URL. A folder means the LAS, LAZ
        and COPC files in it, without those of folders beneath; a pattern (``tiles/**/*.laz``) all files that it
        matches; a ``.vpc`` and a tile index (`INDEX_ENDINGS`) the files that they list.

    Returns
    -------
    tuple of Path
        Folders and patterns in the order of names; a file that is named twice is there twice.

    Raises
    ------
    FileError
        When a folder or pattern has no such file, or a virtual point cloud or tile index cannot be read.
    """
    return tuple(file for path in given for file in _files_of(Path(path)))


def is_many(given: str | os.PathLike[str]) -> bool:
    """Return whether a name means several files rather than being one."""
    if url_of(given) is not None:
        return False
    return Path(given).is_dir() or (any(sign in str(given) for sign in PATTERN_SIGNS) and not Path(given).exists())


def _files_of(path: Path) -> list[Path]:
    """Return the files that one path names."""
    if url_of(path) is not None:
        return [path]
    if path.is_dir():
        found = sorted(file for file in path.iterdir() if file.suffix.lower() in LAS_ENDINGS)
        what = (
            f"The folder {path} has no LAS, LAZ or COPC file. Name another one, or a pattern such as '{path}/**/*.laz'."
        )
    elif is_many(path):
        found = sorted(Path(path.anchor).glob(str(path.relative_to(path.anchor))))
        what = f"No file matches {path}. Check the pattern; relative ones begin in {Path.cwd()}."
    elif path.suffix.lower() == CLOUD_ENDING:
        require_input(path)
        found = _listed(path)
        what = f"The virtual point cloud {path} lists no file."
    elif path.suffix.lower() in INDEX_ENDINGS:
        require_input(path)
        found = _indexed(path)
        what = f"The tile index {path} lists no file."
    else:
        return [path]
    if not found:
        raise FileError(what)
    return found


def _listed(path: Path) -> list[Path]:
    """Return the files of a virtual point cloud; relative ones begin in its folder."""
    try:
        features = json.loads(path.read_text(encoding="utf-8"))["features"]
        assets = [asset for feature in features for asset in feature["assets"].values()]
        # Others are pictures and reports beside the points.
        names = [str(asset["href"]) for asset in assets if "data" in asset.get("roles", ["data"])]
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        msg = f"{path} cannot be read as a virtual point cloud: a STAC collection of files is expected."
        raise FileError(msg) from error
    return [Path(name) if ":/" in name else path.parent / name for name in names]


def _indexed(path: Path) -> list[Path]:
    """Return the files of a tile index; relative ones begin in its folder, or else where the command was started."""
    try:
        layers = [str(layer) for layer, _ in pyogrio.list_layers(path)]
        tables = [pyogrio.read_dataframe(path, layer=layer, read_geometry=False) for layer in layers]
    except (DataSourceError, DataLayerError) as error:
        msg = f"{path} cannot be read as a tile index: {error}."
        raise FileError(msg) from error
    for place in PLACES:
        for table in tables:
            column = next((name for name in table.columns if name.lower() == place), None)
            if column is not None:
                return [_beside(path, str(name)) for name in table[column].dropna()]
    columns = ", ".join(name for table in tables for name in table.columns) or "none"
    msg = f"The tile index {path} has no column with the place of the files ({', '.join(PLACES)}); it has {columns}."
    raise FileError(msg)


def _beside(index: Path, name: str) -> Path:
    """Return a file that an index names."""
    beside = index.parent / name
    return Path(name) if url_of(name) is not None or not beside.exists() else beside


def sound_files(paths: Sequence[Path], *, skip_bad: bool) -> tuple[Path, ...]:
    """Check the headers of several files before one of them is read, and return those that fit together.

    A file is bad that cannot be read, has no points, states another CRS than most do, or lies far from most. Where bad
    files are left out, so is one with the points of an earlier file (`msbdb.io.extents.require_other_points`).

    Parameters
    ----------
    paths : sequence of Path
        At least one. A single file is left to the reader.
    skip_bad : bool
        Whether bad files are left out with a notice.

    Raises
    ------
    MsbdbError
        The kind of the first bad file's error, naming all bad files; with ``skip_bad`` only when no file is left.
    """
    if len(paths) == 1:
        return tuple(paths)
    infos: dict[int, LasInfo] = {}
    bad: dict[int, MsbdbError] = {}
    for number, path in enumerate(paths):
        try:
            if url_of(path) is None:
                require_input(path)
            infos[number] = read_las_header(path)
        except MsbdbError as error:
            bad[number] = error
    bad |= _of_another_crs(infos)
    bad |= _elsewhere({number: info for number, info in infos.items() if number not in bad})
    if skip_bad:
        sound = {number: info for number, info in infos.items() if number not in bad}
        bad |= {number: InputError(twice(*pair)) for number, pair in same_points(sound)}
    if not bad:
        return tuple(paths)
    told = " ".join(str(error) for _, error in sorted(bad.items())[:LISTED])
    told += f" And {len(bad) - LISTED} more." if len(bad) > LISTED else ""
    which = f"{len(bad)} of {counted(len(paths), 'file')} of points"
    if not skip_bad or len(bad) == len(paths):
        kind = type(bad[min(bad)])
        msg = f"{which} cannot be used: {told}"
        raise kind(msg if skip_bad else f"{msg} Mend them, or leave them out with --skip-bad.")
    give_notice(f"{which} are left out: {told}", stacklevel=3)
    return tuple(path for number, path in enumerate(paths) if number not in bad)


def _of_another_crs(infos: dict[int, LasInfo]) -> dict[int, MsbdbError]:
    """Return the files whose header states another CRS than that of most files; a file may state none."""
    stated = {number: header_crs(info.projection) for number, info in infos.items()}
    known = {number: split_crs(crs)[0] for number, crs in stated.items() if crs is not None}
    alike: Counter[int] = Counter()
    first_of: dict[int, int] = {}
    for number, crs in known.items():
        first_of[number] = next((one for one in alike if same_crs(known[one], crs)), number)
        alike[first_of[number]] += 1
    if len(alike) <= 1:
        return {}
    most = alike.most_common(1)[0][0]
    words = (
        f"{file_name(infos[most].path)} in {name_of(known[most])}; files of one build share their CRS. Reproject one"
    )
    return {
        number: CRSError(f"{shown(infos[number].path)} is in the CRS {name_of(known[number])}, and {words}.")
        for number, first in first_of.items()
        if first != most
    }


def _elsewhere(infos: dict[int, LasInfo]) -> dict[int, MsbdbError]:
    """Return the files that lie far from most others; headers whose bounds are wrong are believed nothing."""
    numbers, boxes = list(infos), shapely.box(*np.array([info.bounds for info in infos.values()]).reshape(-1, 4).T)
    if not len(boxes) or not np.isfinite(shapely.bounds(boxes)).all():
        return {}
    near = shapely.get_parts(shapely.union_all(shapely.box(*(shapely.bounds(boxes) + APART / 2 * SIDES).T)))
    box, place = shapely.STRtree(near).query(boxes, predicate="intersects")
    most = int(np.bincount(place).argmax())
    first = infos[numbers[int(box[place == most].min())]]
    far = [numbers[one] for one in box[place != most].tolist() if is_believed(infos[numbers[one]])]
    words = (
        f"{APART / 1000:g} km and more from {file_name(first.path)} and the files around it. Give files of one place"
    )
    return {
        number: GridMismatchError(f"{shown(infos[number].path)} lies {words}, or correct a wrong CRS.")
        for number in far
    }
