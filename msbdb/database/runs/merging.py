"""Merging the tiles of a survey into one run, in one transaction, with a tile in memory at a time."""

import logging
from collections.abc import Iterable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, field
from os import PathLike
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray
from sqlalchemy import URL, Connection, insert, select, update

from msbdb.database.dialects.connection import PATIENCE_S, open_database, require_srid
from msbdb.database.dialects.dialect import Dialect, dialect_of, guarded, shown
from msbdb.database.runs.basis import BuildBasis
from msbdb.database.runs.checks import check_frames
from msbdb.database.runs.digests import (
    ColumnBytes,
    RunContent,
    column_bytes,
    limits_of,
    ordered,
    spooled,
    tables_digest,
)
from msbdb.database.runs.mosaics import mosaics_of
from msbdb.database.runs.tiles import forget_results
from msbdb.database.runs.writing import (
    BY_NAME,
    LOADED,
    keys_of,
    raster_row,
    rejection_ids,
    write_columns,
    write_head,
)
from msbdb.database.schema.sqltables import SQL
from msbdb.database.schema.srid import srid_of
from msbdb.identity import text_id
from msbdb.kept import ANSWER_NAMES, REGION_NAMES, KeptRun
from msbdb.tables import TABLES

if TYPE_CHECKING:
    import pandas as pd

RUN, RASTER_TILE = SQL["run"], SQL["raster_tile"]

WHOLE = ("scale", "spectral_class", "spectral_class_band", "rejection_count")
"""Tables of the run as a whole."""

LINKS = {
    "part_flat_region": ("part", "flat_region"),
    "part_candidate": ("part", "candidate_region"),
    "flat_region_candidate": ("flat_region", "candidate_region"),
}
"""Tables of links, each with the tables that it refers to by its first two columns."""

ROWS = ("building", "part", "flat_region", "candidate_region", "rejection")
"""Tables whose rows belong to one tile each."""

METHODS = {name: method for method, name in REGION_NAMES.items()}
"""The detector of each raster of regions."""

ANSWERED = {name: method for method, name in ANSWER_NAMES.items()}
"""The detector of each raster of answers."""

NOTHING = np.zeros(0, dtype=np.int64)


KEYS = {"building": "building_id", "part": "part_id", "flat_region": "region_id", "candidate_region": "candidate_id"}

logger = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, eq=False)
class Piece:
    """What a tile found on its own ground.

    Parameters
    ----------
    key : tuple of int
        Row and column of the tile.
    frames : dict of str to DataFrame
        The rows that it owns of `ROWS` or `LINKS`.
    origin : tuple of int
        Absolute row and column of the first cell of its rasters.
    rasters : mapping of str to (H, W) ndarray
        Its own cells, by the names of the rows in the database.
    ids : mapping of str to (N,) ndarray of int64
        By detector: the id of the region with label n at place n - 1, for the labels of its raster.
    kinds : mapping of str to list of (str, str)
        By detector: stage and reason of number n at place n - 1, for the numbers of its raster of answers.
    """

    key: tuple[int, int]
    frames: "dict[str, pd.DataFrame]"
    origin: tuple[int, int]
    rasters: Mapping[str, NDArray[Any]]
    ids: Mapping[str, NDArray[np.int64]]
    kinds: Mapping[str, list[tuple[str, str]]]


class TilePieces(Protocol):
    """Gives the pieces of all tiles, in order of the tiles."""

    def __call__(self, names: tuple[str, ...], /, *, rasters: bool) -> Iterable[Piece]:
        """Return them with these tables alone, and with rasters, ids and kinds if asked for."""


@dataclass(slots=True)
class MergeReport:
    """What a merge did.

    Attributes
    ----------
    status : str
        'created', 'replaced' or 'unchanged'.
    twice : int
        Parts, buildings and regions that two tiles claim. Of buildings the larger one is kept, with all of its parts;
        of regions that of the first tile in order.
    unlinked : int
        Links to parts or regions that no tile has.
    rows : dict of str to int
        Rows by table.
    """

    status: str = "created"
    twice: int = 0
    unlinked: int = 0
    rows: dict[str, int] = field(default_factory=dict)


class _UnchangedError(Exception):
    """The database has this content already."""


def _among(ids: NDArray[np.int64], known: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Return which ids are among known ones, which are sorted; it hardly depends on how many are known."""
    if not known.size:
        return np.zeros(ids.shape, dtype=np.bool_)
    found: NDArray[np.bool_] = known[np.minimum(np.searchsorted(known, ids), known.size - 1)] == ids
    return found


def _joined(known: NDArray[np.int64], ids: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return known ids, which are sorted, with others in their places.

    Examples
    --------
    >>> known = np.array([2, 5, 9])
    >>> _joined(known, np.array([7, 5, 1, 7]))
    array([1, 2, 5, 7, 9])
    >>> _among(np.array([9, 3, 10]), known)
    array([ True, False, False])
    """
    ids = np.unique(ids)
    ids = ids[~_among(ids, known)]
    return np.insert(known, np.searchsorted(known, ids), ids)


def overruled(pieces: TilePieces) -> dict[tuple[int, int], set[int]]:
    """Return the buildings of each tile that share a part with a larger building of another tile.

    Two tiles may see a building differently, so that one of them takes its annex for a separate building. The larger
    building keeps the annex; of equal ones that of the first tile in order. A building is kept or left out as a whole,
    with all of its parts.
    """
    known = repeated = NOTHING
    for piece in pieces(("part",), rasters=False):
        ids = piece.frames["part"]["part_id"].to_numpy(np.int64)
        repeated, known = _joined(repeated, ids[_among(ids, known)]), _joined(known, ids)
    if not repeated.size:
        return {}
    claims: list[tuple[float, int, int, tuple[int, int], set[int]]] = []
    for order, piece in enumerate(pieces(("building", "part"), rasters=False)):
        parts = piece.frames["part"]
        shared = parts[_among(parts["part_id"].to_numpy(np.int64), repeated)]
        sizes = piece.frames["building"][["building_id", "area_m2"]]
        areas = dict(sizes.itertuples(index=False, name=None))
        for building in shared["building_id"].unique().tolist():
            own: set[int] = set(shared.loc[shared["building_id"] == building, "part_id"].tolist())
            claims.append((-float(areas[building]), order, building, piece.key, own))
    taken: set[int] = set()
    lost: dict[tuple[int, int], set[int]] = {}
    for _, _, building, key, own in sorted(claims, key=lambda claim: claim[:3]):
        if taken.isdisjoint(own):
            taken |= own
        else:
            lost.setdefault(key, set()).add(building)
    return lost


@dataclass(eq=False)
class _Merge:
    """A merge in an open transaction."""

    connection: Connection
    dialect: Dialect
    head: KeptRun
    srid: int
    report: MergeReport
    lost: Mapping[tuple[int, int], set[int]]

    def __post_init__(self) -> None:
        """Begin without rows."""
        self.run_id = keys_of(self.head)[1]
        self.seen = dict.fromkeys(ROWS, NOTHING)
        self.left_out: dict[tuple[tuple[int, int], str], NDArray[np.int64]] = {}
        self.of_method: dict[str, NDArray[np.int64]] = {}
        counted = self.head.frames["rejection_count"]
        names = (counted[name].tolist() for name in ("method", "stage", "reason", "number"))
        self.numbers = {(method, stage, why): int(number) for method, stage, why, number in zip(*names, strict=True)}

    def write_whole(self) -> None:
        """Write the tables of the run as a whole."""
        for name, columns in check_frames({name: self.head.frames[name] for name in WHOLE}).items():
            self._write(name, columns)

    def write_rows(self, piece: Piece) -> None:
        """Write what a tile owns, but for what another tile has."""
        frames = {name: piece.frames[name] for name in ROWS}
        taken = {name: _among(frames[name][key].to_numpy(np.int64), self.seen[name]) for name, key in KEYS.items()}
        lost = self.lost.get(piece.key, set())
        taken |= {name: frames[name]["building_id"].isin(lost).to_numpy() for name in ("part", "building")}
        for name, key in KEYS.items():
            self.report.twice += int(taken[name].sum())
            self.left_out[piece.key, name] = frames[name].loc[taken[name], key].to_numpy(np.int64)
            frames[name] = frames[name][~taken[name]].reset_index(drop=True)
            self.seen[name] = _joined(self.seen[name], frames[name][key].to_numpy(np.int64))
        for method, rows in frames["candidate_region"].groupby("method"):
            known = self.of_method.get(str(method), NOTHING)
            self.of_method[str(method)] = _joined(known, rows["candidate_id"].to_numpy(np.int64))
        columns = check_frames(frames)
        ids = rejection_ids(self.head.survey.name, columns["rejection"])
        again = _among(ids, self.seen["rejection"])
        ids[again] = [text_id("rejection", int(one), *piece.key) for one in ids[again]]
        self.seen["rejection"] = _joined(self.seen["rejection"], ids)
        # Buildings come before the parts that refer to them.
        for name in ROWS:
            self._write(name, columns[name], ids if name == "rejection" else None)

    def write_rest(self, piece: Piece) -> None:
        """Write the links and the rasters of a tile, after the rows of all tiles.

        What another tile has comes with that tile's links.
        """
        frames = {}
        for name in LINKS:
            frames[name], unlinked = self._linked(piece, name)
            self.report.unlinked += unlinked
        for name, columns in check_frames(frames).items():
            self._write(name, columns)
        row, column = piece.origin
        place = {"run_id": self.run_id, "lattice_row": row, "lattice_column": column}
        for name, cells in piece.rasters.items():
            named = name, self._renumbered(piece, name, cells)
            self.connection.execute(insert(RASTER_TILE), [place | raster_row(named)])

    def kept(self, piece: Piece, name: str) -> "pd.DataFrame":
        """Return the rows of a piece that are written: of `LINKS`, or of `ROWS`, after the rows of all tiles."""
        if name in LINKS:
            return self._linked(piece, name)[0]
        frame = piece.frames[name]
        return frame[~np.isin(frame[KEYS[name]], self.left_out[piece.key, name])] if name in KEYS else frame

    def limits(self, name: str) -> NDArray[np.int64]:
        """Return where the digest cuts a table: links by what they refer to first, others by their own keys."""
        first = LINKS[name][0] if name in LINKS else name
        # Rejections are ordered by a region that many of them share; they are few, and one share.
        return NOTHING if name == "rejection" else limits_of(self.seen[first])

    def _linked(self, piece: Piece, name: str) -> "tuple[pd.DataFrame, int]":
        """Return the links of a piece between what is written, and the number of its other ones."""
        one, other = LINKS[name]
        frame = piece.frames[name]
        first, second = frame.columns[:2]
        frame = frame[~np.isin(frame[first], self.left_out[piece.key, one])]
        ends = (frame[first], self.seen[one]), (frame[second], self.seen[other])
        known = np.logical_and(*(_among(ids.to_numpy(np.int64), seen) for ids, seen in ends))
        return frame[known].reset_index(drop=True), int((~known).sum())

    def _renumbered(self, piece: Piece, name: str, cells: NDArray[Any]) -> NDArray[Any]:
        """Return the cells with the labels of the run in place of those of the tile."""
        method = METHODS.get(name, "")
        if method in piece.ids:
            own = piece.ids[method]
            known = self.seen["flat_region"] if method == "flatregions" else self.of_method.get(method, NOTHING)
            places = np.where(_among(own, known), np.searchsorted(known, own) + 1, 0)
            labels: NDArray[Any] = np.concatenate([[0], places]).astype(np.int32)[cells]
            return labels
        method = ANSWERED.get(name, "")
        if method in piece.kinds:
            numbers = [self.numbers.get((method, *kind), 0) for kind in piece.kinds[method]]
            answers: NDArray[Any] = np.array([0, *numbers], dtype=np.uint8)[cells]
            return answers
        return cells

    def _write(self, name: str, columns: dict[str, NDArray[Any]], ids: NDArray[np.int64] | None = None) -> None:
        """Write rows of a table."""
        count = len(next(iter(columns.values())))
        self.report.rows[name] = self.report.rows.get(name, 0) + count
        if not count:
            return
        if ids is None:
            columns = ordered(columns, BY_NAME[name])
        write_columns(self.connection, self.dialect, name, columns, run_id=self.run_id, srid=self.srid, ids=ids)


def _merged_tables(merge: _Merge, pieces: TilePieces) -> Iterator[tuple[str, Iterable[ColumnBytes]]]:
    """Yield the tables of a merged run, each with what the digest takes of its columns, in order.

    They come from the pieces, not from the database, so that a thread may read them beside the transaction.
    """
    for table in TABLES:
        name = table.name
        if name in WHOLE:
            columns = ordered(check_frames({name: merge.head.frames[name]})[name], table)
            yield name, ((column, (column_bytes(column, values),)) for column, values in columns.items())
        else:
            frames = (merge.kept(piece, name) for piece in pieces((name,), rasters=False))
            chunks = (check_frames({name: frame})[name] for frame in frames)
            yield name, spooled(chunks, table, merge.limits(name))


def merge_tiles(
    target: str | PathLike[str] | URL,
    head: KeptRun,
    pieces: TilePieces,
    *,
    coming: Mapping[str, int],
    basis: BuildBasis,
) -> MergeReport:
    """Write the tiles of a survey as its run, in one transaction; the pieces are taken one at a time.

    Their parts are looked at first (`overruled`). Then they are taken twice, and a table at a time once more: a thread
    makes the digest of them while links, rasters and indexes are written. Of each table the digest holds a share, and
    the rest waits in temporary files.

    Parameters
    ----------
    target : str, path or URL
        The database, which has the tiles' rows.
    head : KeptRun
        The survey, the run and the tables of `WHOLE`; it has no rasters.
    pieces : callable
        Returns the pieces of all tiles, in order of the tiles.
    coming : mapping of str to int
        About how many rows each table gets.
    basis : BuildBasis
        What may be replaced.

    Raises
    ------
    OutdatedError
        When the basis has changed; nothing was written.
    InputError
        When the basis keeps what the build would replace; nothing was written.
    DatabaseError
        When the database cannot be written.
    """
    srid = srid_of(head.survey.epsg, head.survey.crs_wkt)
    crs: dict[str, Any] = {"srid": head.survey.epsg, "crs_wkt": head.survey.crs_wkt}
    engine = open_database(target, create=True, **crs, timeout_s=PATIENCE_S, keep_open=True)
    dialect, report = dialect_of(engine.url), MergeReport()
    try:
        with guarded(engine.url):
            lost = overruled(pieces)
        with guarded(engine.url), suppress(_UnchangedError), dialect.writing(engine) as connection:
            require_srid(connection, dialect, srid, shown(engine.url))
            basis.require(connection, head)
            _merge(_Merge(connection, dialect, head, srid, report, lost), pieces, coming)
        with guarded(engine.url), dialect.writing(engine) as connection:
            forget_results(connection, head.survey.name)
    finally:
        engine.dispose()
    return report


def _merge(merge: _Merge, pieces: TilePieces, coming: Mapping[str, int]) -> None:
    """Write all in the caller's transaction; raise where the database has the same already."""
    connection, dialect, head, report, run_id = merge.connection, merge.dialect, merge.head, merge.report, merge.run_id
    before = connection.scalar(select(RUN.c.content_sha256).where(RUN.c.run_id == run_id))
    with ThreadPoolExecutor(1) as thread:
        with dialect.in_bulk(connection, coming):
            report.status = "replaced" if write_head(connection, dialect, head, "") else "created"
            with dialect.keys_in_sets(connection, LOADED, run_id):
                merge.write_whole()
                for piece in pieces(ROWS, rasters=False):
                    merge.write_rows(piece)
                # From here on it is known which rows are kept.
                tables = thread.submit(tables_digest, head.survey, head.run, _merged_tables(merge, pieces))
                for piece in pieces((*LINKS,), rasters=True):
                    merge.write_rest(piece)
        dialect.after_load(connection)
        content = RunContent(head.survey, head.run, {}, mosaics_of(connection, run_id), head.plan)
        digest = content.digest(tables.result())
    if digest == before:
        report.status = "unchanged"
        raise _UnchangedError
    connection.execute(update(RUN).where(RUN.c.run_id == run_id).values(content_sha256=digest))
    logger.info("Merged the tiles of the survey %s: %s", head.survey.name, report)
