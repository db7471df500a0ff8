"""How far the tiles of a survey are: a row each, written in a transaction each, by whoever builds the tile."""

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from os import PathLike
from typing import Any

from sqlalchemy import URL, ColumnElement, Connection, Engine, delete, insert, select, update

from msbdb.database.dialects.connection import PATIENCE_S, open_database
from msbdb.database.dialects.dialect import database_url, dialect_of, guarded
from msbdb.database.schema.sqltables import SQL

TILE = SQL["tile"]

WAITING, RUNNING, DONE, FAILED = "queued", "running", "done", "failed"

STATUS = tuple(
    TILE.c[name]
    for name in (
        "survey", "tile_row", "tile_column", "west", "south", "east", "north", "state", "points", "halo_m", "seconds",
        "reason",
    )
)  # fmt: skip
"""The columns that say how far a tile is."""


@dataclass(frozen=True, slots=True)
class TileStatus:
    """How far a tile is; the columns of the table ``tile`` without its result.

    Parameters
    ----------
    survey : str
        Name of the survey.
    tile_row, tile_column : int
        The place of the tile.
    west, south, east, north : float
        Its own ground, metres.
    state : str
        queued, running, done or failed.
    points : int
        Points on its own ground.
    halo_m : float
        How far it saw beyond, metres.
    seconds : float
        Time that it took.
    reason : str
        Why it failed, or has no building.
    """

    survey: str
    tile_row: int
    tile_column: int
    west: float
    south: float
    east: float
    north: float
    state: str = WAITING
    points: int = 0
    halo_m: float = 0.0
    seconds: float = 0.0
    reason: str = ""

    @property
    def key(self) -> tuple[int, int]:
        """Row and column."""
        return (self.tile_row, self.tile_column)

    def as_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        return asdict(self)


def begin_tiles(
    target: str | PathLike[str] | URL,
    tiles: Sequence[TileStatus],
    build: str,
    *,
    epsg: int,
    crs_wkt: str,
    resume: bool,
) -> list[TileStatus]:
    """Write the tiles of a build that begins, and return them as they are now.

    Parameters
    ----------
    target : str, path or URL
        The database, which is created where it is missing.
    tiles : sequence of TileStatus
        All tiles of one survey, queued.
    build : str
        Digest of the files, values and plan.
    epsg, crs_wkt : int, str
        The CRS of the survey.
    resume : bool
        Keep what an earlier build of this digest finished; tiles that are not done are queued again.
    """
    engine = open_database(target, create=True, srid=epsg, crs_wkt=crs_wkt, timeout_s=PATIENCE_S, keep_open=True)
    dialect, survey = dialect_of(engine.url), tiles[0].survey
    try:
        with guarded(engine.url), dialect.writing(engine) as connection:
            own = TILE.c.survey == survey
            if not resume:
                connection.execute(delete(TILE).where(own))
            connection.execute(delete(TILE).where(own, (TILE.c.build != build) | (TILE.c.state != DONE)))
            kept = {one.key: one for one in _status(connection, survey)}
            new = [asdict(one) | {"build": build, "result": None} for one in tiles if one.key not in kept]
            if new:
                connection.execute(insert(TILE), new)
        return [kept.get(one.key, one) for one in tiles]
    finally:
        engine.dispose()


def note_tile(target: str | PathLike[str] | URL, status: TileStatus) -> None:
    """Write how far a tile is, in one transaction."""
    _note(target, status, {})


def note_result(target: str | PathLike[str] | URL, status: TileStatus, result: bytes, build: str) -> None:
    """Write the result of a tile that is done, in one transaction.

    A worker may outlive the command that it works for. What it brings late, when the tile is done by another one or
    belongs to another build, is left out.
    """
    _note(target, status, {"result": result}, TILE.c.build == build, TILE.c.state != DONE)


def _note(
    target: str | PathLike[str] | URL, status: TileStatus, more: dict[str, Any], *where: ColumnElement[bool]
) -> None:
    """Write the row of a tile, where it is as it should be."""
    values = asdict(status) | more
    here = [TILE.c[name] == values.pop(name) for name in ("survey", "tile_row", "tile_column")]
    url = database_url(target)
    engine = dialect_of(url).make_engine(url, PATIENCE_S)
    try:
        with guarded(url), dialect_of(url).writing(engine) as connection:
            connection.execute(update(TILE).where(*here, *where).values(**values))
    finally:
        engine.dispose()


def read_result(engine: Engine, survey: str, key: tuple[int, int]) -> bytes | None:
    """Return the result of a tile that waits in the database; None if it has no result yet."""
    here = (TILE.c.survey == survey, TILE.c.tile_row == key[0], TILE.c.tile_column == key[1])
    with guarded(engine.url), engine.connect() as connection:
        found = connection.scalar(select(TILE.c.result).where(*here))
    return None if found is None else bytes(found)


def tiles_with_results(engine: Engine, survey: str) -> set[tuple[int, int]]:
    """Return the tiles whose results wait in the database, by row and column."""
    query = select(TILE.c.tile_row, TILE.c.tile_column).where(TILE.c.survey == survey, TILE.c.result.is_not(None))
    with guarded(engine.url), engine.connect() as connection:
        return {(row.tile_row, row.tile_column) for row in connection.execute(query)}


def forget_results(connection: Connection, survey: str) -> None:
    """Take the results away that are merged; the tiles' rows stay."""
    connection.execute(update(TILE).where(TILE.c.survey == survey).values(result=None))


def forget_tiles(connection: Connection, survey: str) -> None:
    """Take the tiles of a survey away that is built as one."""
    connection.execute(delete(TILE).where(TILE.c.survey == survey))


def read_tile_status(engine: Engine, survey: str | None = None) -> list[TileStatus]:
    """Return the tiles of a survey, or of all, in order; none where nothing was built in tiles."""
    with guarded(engine.url), engine.connect() as connection:
        return list(_status(connection, survey))


def _status(connection: Connection, survey: str | None) -> Iterator[TileStatus]:
    """Yield the rows of the table without results, those of one survey or all."""
    query = select(*STATUS).order_by(TILE.c.tile_row, TILE.c.tile_column)
    if survey is not None:
        query = query.where(TILE.c.survey == survey)
    rows = [TileStatus(*row) for row in connection.execute(query)]
    yield from sorted(rows, key=lambda one: (one.survey, one.key))
