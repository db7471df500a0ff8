"""Writing updates of the living inventory, each in one transaction.

An update is computed before the transaction, so that a writer needs its lock only for writing. The transaction first
checks that the inventory has not changed since it was read (`Basis`).
"""

import logging
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
import shapely
from sqlalchemy import Connection, Engine, delete, exists, func, select, update

from msbdb.database.dialects.dialect import Dialect, dialect_of, guarded
from msbdb.database.history.joins import Seams, batches, count_again, release, write_seams
from msbdb.database.history.standing import Basis, basis_of, require_begun
from msbdb.database.runs.basis import OutdatedError
from msbdb.database.runs.digests import digest_again, insert_digested
from msbdb.database.schema.sqltables import SQL
from msbdb.identity import plain, text_id, to_json
from msbdb.tables import ACROSS, HEIGHTS

if TYPE_CHECKING:
    import geopandas as gpd
    import pandas as pd

BUILDING_CHANGE = SQL["building_change"]

BUILDING_VERSION = SQL["building_version"]

INVENTORY_BUILDING = SQL["inventory_building"]

INVENTORY_EVENT = SQL["inventory_event"]

SURVEY_OFFSET = SQL["survey_offset"]

logger = logging.getLogger(__name__)

MEASURES = (
    "state", *HEIGHTS, "h_max", "h_mean", "h_p50", "h_p90", "area_m2", "volume_m3", "parts", "flat_share",
    "area3d_share", "adaptive_share", "probability",
)  # fmt: skip
"""Attributes of a version, besides its outline."""

_FIGURES = ("outline", "height", "parts", "overlap_m2", "iou", "dh_m", "darea_m2", "note")
"""Attributes of a change of a pair of buildings."""


@dataclass(frozen=True, slots=True, eq=False)
class Advance:
    """The content of an update.

    Parameters
    ----------
    survey, survey_id, date : str, int, str
        The survey and its day.
    area : MultiPolygon
        The surveyed area.
    digest : str
        Digest of everything that determines the result.
    basis : Basis
        The basis of the update.
    before : GeoDataFrame
        The inventory before: ``version_id``, ``uid``, ``attributes``.
    born : GeoDataFrame
        ``uid`` and geometry of the buildings that began in an earlier application of this survey.
    offset : mapping
        ``dx_m``, ``dy_m``, ``dz_m``, ``pairs`` and ``spread_m``.
    changes : DataFrame
        ``kind``, ``before`` and ``version`` (row numbers, or -1), and the columns of ``building_change`` with
        attributes of the pair.
    states : GeoDataFrame
        The new versions: ``before`` (row whose identity it continues, or -1), ``building_id``, ``MEASURES``, geometry.
    seams : Seams
        The buildings that a border cuts, made whole.
    """

    survey: str
    survey_id: int
    date: str
    area: shapely.MultiPolygon
    digest: str
    basis: Basis
    before: "gpd.GeoDataFrame"
    born: "gpd.GeoDataFrame"
    offset: dict[str, Any]
    changes: "pd.DataFrame"
    states: "gpd.GeoDataFrame"
    seams: Seams = field(default_factory=Seams)

    @property
    def counts(self) -> dict[str, int]:
        """Rows by kind of change, and versions."""
        kinds = [*self.changes["kind"], *(row["kind"] for row in self.seams.changes if self._is_own(row))]
        versions = len(self.states) + sum(self._is_own(row) for row in self.seams.versions)
        return {kind: kinds.count(kind) for kind in sorted(set(kinds))} | {"versions": versions}

    def _is_own(self, row: dict[str, Any]) -> bool:
        return bool(row["survey_id"] == self.survey_id)


def write_advance(engine: Engine, advance: Advance) -> str:
    """Write an update in one transaction, in place of an earlier application of the same survey.

    Returns
    -------
    str
        'created' or 'replaced'.

    Raises
    ------
    OutdatedError
        When the basis of the update has changed; nothing was written.
    DatabaseError
        When the database is locked, full or cannot be reached; nothing was written.
    """
    dialect = dialect_of(engine.url)
    with guarded(engine.url), dialect.writing(engine) as connection:
        if basis_of(connection, advance.survey_id, advance.area) != advance.basis:
            raise OutdatedError
        srid = dialect.database_srid(connection)
        _require_current(connection, advance.seams)
        others = release(connection, advance.seams.released)
        number = _take_back(connection, advance.survey_id)
        after = identities(advance)
        begins = advance.states["before"].to_numpy() < 0
        _close(connection, advance)
        born = [(uid, advance.survey) for (uid, _), is_new in zip(after, begins, strict=True) if is_new]
        insert_digested(connection, dialect, "inventory_building", ["uid", "source"], born, srid=srid)
        write_versions(connection, dialect, _version_rows(advance, after), srid)
        _write_changes(connection, dialect, advance, after, srid)
        offset = {"survey_id": advance.survey_id, **plain(advance.offset)}
        insert_digested(connection, dialect, "survey_offset", list(offset), [tuple(offset.values())], srid=srid)
        event = {"kind": "update", "name": advance.survey, "date": advance.date, "survey_id": advance.survey_id}
        event |= {"number": number, "counts": advance.counts, "content_sha256": advance.digest}
        write_event(connection, dialect, event, advance.area)
        others |= write_seams(connection, dialect, advance.seams, MEASURES, srid)
        count_again(connection, others)
        dialect.after_load(connection)
    return "replaced" if number else "created"


def identities(advance: Advance) -> list[tuple[int, int]]:
    """Return the building and the key of each new version."""
    return [(uid, text_id("version", "survey", advance.survey, uid)) for uid in _uids(advance)]


def _require_current(connection: Connection, seams: Seams) -> None:
    """Refuse to join what others joined or ended meanwhile; surveys two borders away are no part of the basis.

    Raises
    ------
    OutdatedError
        When a version to be released or ended is not as it was read.
    """
    for some in batches(seams.released):
        query = select(func.count()).where(BUILDING_VERSION.c.version_id.in_(some))
        if connection.scalar(query) != len(some):
            raise OutdatedError
    replaced = set(seams.released)
    for some in batches(key for key, _, _ in seams.ends):
        query = select(BUILDING_CHANGE.c.version_after).where(
            BUILDING_CHANGE.c.version_before.in_(some), BUILDING_CHANGE.c.note.startswith(ACROSS, autoescape=True)
        )
        if not replaced.issuperset(int(key) for key in connection.scalars(query)):
            raise OutdatedError


def _take_back(connection: Connection, survey_id: int) -> int:
    """Undo an application of a survey; return its event's number, 0 if there was none."""
    number = connection.scalar(select(INVENTORY_EVENT.c.number).where(INVENTORY_EVENT.c.survey_id == survey_id))
    if number is None:
        return 0
    connection.execute(delete(BUILDING_CHANGE).where(BUILDING_CHANGE.c.survey_id == survey_id))
    own = select(BUILDING_VERSION.c.uid).where(BUILDING_VERSION.c.survey_id == survey_id)
    touched = list(connection.scalars(own))
    connection.execute(delete(BUILDING_VERSION).where(BUILDING_VERSION.c.survey_id == survey_id))
    closed = list(
        connection.scalars(select(BUILDING_VERSION.c.version_id).where(BUILDING_VERSION.c.closed_by == survey_id))
    )
    _set_end(connection, closed, None, None)
    has_version = exists().where(BUILDING_VERSION.c.uid == INVENTORY_BUILDING.c.uid)
    for some in batches(touched):
        connection.execute(delete(INVENTORY_BUILDING).where(INVENTORY_BUILDING.c.uid.in_(some), ~has_version))
    connection.execute(delete(SURVEY_OFFSET).where(SURVEY_OFFSET.c.survey_id == survey_id))
    connection.execute(delete(INVENTORY_EVENT).where(INVENTORY_EVENT.c.survey_id == survey_id))
    return int(number)


def _uids(advance: Advance) -> list[int]:
    """Return the building of each new version: the one that it continues, or a new one.

    A building of an earlier application of the survey keeps its identity: by its place and the run's building if these
    are equal, else by the largest overlap of the outlines. So an operator's decision on it is kept.
    """
    states, known = advance.states, advance.before["uid"].to_numpy()
    fresh = np.flatnonzero(states["before"].to_numpy() < 0)
    uids = {int(row): int(known[before]) for row, before in enumerate(states["before"]) if before >= 0}
    shapes = states.geometry.to_numpy()
    corners = np.round(shapely.bounds(shapes) * 1000)
    for row in fresh.tolist():
        place = [int(value) for value in corners[row]]
        uids[row] = text_id("inventory building", "survey", advance.survey, states["building_id"].iloc[row], *place)
    old = {int(uid): shape for uid, shape in zip(advance.born["uid"], advance.born.geometry, strict=True)}
    lost = sorted(set(old) - set(uids.values()))
    strange = [row for row in fresh.tolist() if uids[row] not in old]
    for row, uid in _alike([shapes[row] for row in strange], [old[uid] for uid in lost]):
        uids[strange[row]] = lost[uid]
    return [uids[row] for row in range(len(states))]


def _alike(some: Sequence[shapely.Geometry], others: Sequence[shapely.Geometry]) -> list[tuple[int, int]]:
    """Return pairs of outlines that share at least half of the larger; each outline is in at most one pair."""
    if not some or not others:
        return []
    one, two = (np.array(shapes, dtype=object) for shapes in (some, others))
    pairs = shapely.STRtree(two).query(one, predicate="intersects")
    shared = shapely.area(shapely.intersection(one[pairs[0]], two[pairs[1]]))
    share = shared / np.maximum(shapely.area(one[pairs[0]]), shapely.area(two[pairs[1]]))
    taken: tuple[set[int], set[int]] = (set(), set())
    chosen = []
    for at in np.lexsort((pairs[1], pairs[0], -share)).tolist():
        a, b = int(pairs[0, at]), int(pairs[1, at])
        if share[at] >= 0.5 and a not in taken[0] and b not in taken[1]:
            taken[0].add(a)
            taken[1].add(b)
            chosen.append((a, b))
    return chosen


def _close(connection: Connection, advance: Advance) -> None:
    """End the versions with a successor, and those of demolished buildings."""
    changes = advance.changes
    ended = changes.loc[(changes["before"] >= 0) & ((changes["version"] >= 0) | (changes["kind"] == "demolished"))]
    rows = ended["before"].unique()
    require_begun(advance.before, rows, advance.survey, advance.date)
    ids = advance.before["version_id"].to_numpy()[rows].astype(int).tolist()
    _set_end(connection, ids, advance.date, advance.survey_id)


def _set_end(connection: Connection, versions: list[int], date: str | None, survey_id: int | None) -> None:
    """End versions on a day by a survey, or reopen them."""
    for some in batches(versions):
        own = BUILDING_VERSION.c.version_id.in_(some)
        connection.execute(update(BUILDING_VERSION).where(own).values(valid_to=date, closed_by=survey_id))
        digest_again(connection, SQL["building_version"], own)


def _version_rows(advance: Advance, after: list[tuple[int, int]]) -> "gpd.GeoDataFrame":
    """Return the new versions with the columns of building_version; imported attributes are kept."""
    import pandas as pd

    known = advance.before["attributes"].tolist()
    attributes = [known[before] if before >= 0 else None for before in advance.states["before"]]
    return advance.states.assign(
        version_id=[version for _, version in after],
        uid=[uid for uid, _ in after],
        valid_from=advance.date,
        source="survey",
        survey_id=advance.survey_id,
        attributes=pd.Series(attributes, dtype=object, index=advance.states.index),
    )


def write_versions(connection: Connection, dialect: Dialect, rows: "gpd.GeoDataFrame", srid: int) -> None:
    """Write versions in bulk."""
    columns = ["version_id", "uid", "valid_from", "source", "survey_id", "building_id", *MEASURES]
    cells: list[list[Any]] = [_values(rows[name]) for name in columns]
    cells.append([to_json(value if isinstance(value, dict) else {}) for value in rows["attributes"]])
    made, shapes = list(zip(*cells, strict=True)), _multi(rows.geometry.to_numpy())
    insert_digested(connection, dialect, "building_version", [*columns, "attributes"], made, srid=srid, shapes=shapes)


def _write_changes(
    connection: Connection, dialect: Dialect, advance: Advance, after: list[tuple[int, int]], srid: int
) -> None:
    """Write the changes in bulk, with buildings and versions for row numbers; ``after`` has the new versions."""
    known = list(zip(advance.before["uid"].astype(int), advance.before["version_id"].astype(int), strict=True))
    rows_of = advance.changes[["before", "version", "kind"]].to_numpy().tolist()
    changes = advance.changes.assign(iou=advance.changes["iou"].clip(upper=1.0))
    figures = zip(*(_values(changes[name]) for name in _FIGURES), strict=True)
    rows = []
    for (before, version, kind), cells in zip(rows_of, figures, strict=True):
        one = known[before] if before >= 0 else (None, None)
        two = after[version] if version >= 0 else (None, None) if kind == "demolished" else one
        key = text_id("change", advance.survey, kind, one[0], two[0])
        rows.append((key, advance.survey_id, kind, one[0], two[0], one[1], two[1], *cells))
    columns = ["change_id", "survey_id", "kind", "uid_before", "uid_after", "version_before", "version_after"]
    insert_digested(connection, dialect, "building_change", [*columns, *_FIGURES], sorted(rows), srid=srid)


def write_event(connection: Connection, dialect: Dialect, event: dict[str, Any], area: shapely.MultiPolygon) -> None:
    """Write the event of an import or update; a repeated update keeps its number."""
    last = connection.scalar(select(func.max(INVENTORY_EVENT.c.number))) or 0
    srid = dialect.database_srid(connection)
    row = {"number": event.pop("number", 0) or last + 1, **event, "counts": to_json(event["counts"])}
    shapes = np.array([area], dtype=object)
    insert_digested(connection, dialect, "inventory_event", list(row), [tuple(row.values())], srid=srid, shapes=shapes)


def _values(column: "pd.Series") -> list[Any]:
    """Return a column as plain values, None where one is missing."""
    import pandas as pd

    return [None if pd.isna(value) else plain(value) for value in column.tolist()]


def _multi(shapes: Any) -> Any:  # noqa: ANN401  (arrays of geometries)
    """Return polygons as multipolygons."""
    return np.array([s if s.geom_type == "MultiPolygon" else shapely.multipolygons([s]) for s in shapes], dtype=object)
