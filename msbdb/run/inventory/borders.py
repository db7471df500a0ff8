"""The buildings that borders of surveys cut, made whole: the pieces of an update, and the versions that they become."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import geopandas as gpd
import numpy as np
import pandas as pd
import shapely
from numpy.typing import NDArray

from msbdb.change.seams import REACH_CELLS, Surveyed, Whole, find_links, whole_buildings
from msbdb.database import Advance, Seams, Standing, identities
from msbdb.fuse.probability import states_of
from msbdb.identity import text_id
from msbdb.params import ChangeParams, FuseParams, TouchingParams
from msbdb.tables import ACROSS, EXTRACTOR_SHARES

ONE = ACROSS + "one building in the surveys {}; its heights are means by area, its ridge the highest"

LESS = ACROSS + "ground that it shares with a building of the survey {} is that building's"

ALONE = ACROSS + "no longer one building with that of another survey"

HIGHEST = ("z_ground_max", "z_ridge", "ridge", "storeys_max", "storeys_top", "h_max")

LOWEST = ("z_ground_min", "storeys_min")

MEANS = (
    "z_ground", "z_eaves", "eaves", "storeys", "h_mean", "h_p50", "h_p90", "probability", *EXTRACTOR_SHARES.values()
)  # fmt: skip

COUNTS = ("storeys", "storeys_min", "storeys_max", "storeys_top", "parts")


def pieces_of(standing: Standing, advance: Advance) -> tuple[gpd.GeoDataFrame, NDArray[np.bool_]]:
    """Return the pieces that may be one building with another, in order of their keys, and which may be joined.

    These are the buildings that begin in the survey, and those of surveys beside it that are near them. Both may be
    joined. Buildings that cross its border already take part as they are.
    """
    states, after = advance.states, identities(advance)
    begins = np.flatnonzero(states["before"].to_numpy() < 0)
    new = states.iloc[begins].assign(
        uid=[after[row][0] for row in begins], version_id=[after[row][1] for row in begins],
        survey_id=advance.survey_id, survey=advance.survey, valid_from=advance.date, began=advance.date,
        attributes=None, loose=True,
    )  # fmt: skip
    known = standing.known
    changes = advance.changes
    ended = changes.loc[(changes["before"] >= 0) & ((changes["version"] >= 0) | (changes["kind"] == "demolished"))]
    gone = set(advance.before["version_id"].iloc[ended["before"].unique()])
    known = known[~known["version_id"].isin(gone) & known["survey_id"].notna()]
    known = known.assign(loose=known["version_id"].isin(standing.loose))
    both = pd.concat([frame.dropna(axis=1, how="all") for frame in (new, known) if len(frame)] or [known])
    frame = gpd.GeoDataFrame(both.reindex(columns=known.columns), geometry="geometry", crs=advance.states.crs)
    frame = frame.sort_values("version_id", ignore_index=True)
    loose = frame["loose"].to_numpy(dtype=bool)
    return frame, loose


def near_pieces(pieces: gpd.GeoDataFrame, loose: NDArray[np.bool_], reach_m: float) -> NDArray[np.bool_]:
    """Return which pieces lie near one of another survey, where one of the two may be joined."""
    shapes, owners = pieces.geometry.to_numpy(), pieces["survey_id"].to_numpy(dtype=np.int64)
    found = np.zeros(len(pieces), dtype=np.bool_)
    pairs = shapely.STRtree(shapes).query(shapes, predicate="dwithin", distance=reach_m)
    one, other = pairs[:, (owners[pairs[0]] != owners[pairs[1]]) & (loose[pairs[0]] | loose[pairs[1]])]
    found[one] = found[other] = True
    return found


def make_seams(
    pieces: gpd.GeoDataFrame,
    loose: NDArray[np.bool_],
    surveys: Mapping[int, Surveyed],
    standing: Standing,
    *,
    params: ChangeParams,
    touching: TouchingParams,
) -> Seams:
    """Return the buildings that the pieces are together, as versions from day to day.

    Parameters
    ----------
    pieces : GeoDataFrame
        From `pieces_of`, those of `near_pieces`.
    loose : (N,) ndarray of bool
        The pieces that may be joined.
    surveys : mapping of int to Surveyed
        The surveys of the pieces by their key.
    standing : Standing
        ``released`` and ``decided``.
    params, touching : ChangeParams, TouchingParams
        See `find_links`.

    Notes
    -----
    The result follows from the pieces alone, not from the order of the surveys. On each day on which pieces begin,
    those that exist are joined. A building keeps the identity of the piece that an operator decided on, else of the one
    that began first, else of the lowest ``uid``.
    """
    timeline = _Timeline(pieces, standing)
    if len(pieces):
        links = find_links(pieces, loose, surveys, params=params, touching=touching)
        reach_m = REACH_CELLS / 2 * max(one.ground.spec.cell_m for one in surveys.values())
        days = pieces["valid_from"].to_numpy()
        for day in sorted(set(days)):
            rows = np.flatnonzero(days <= day)
            place = {int(row): at for at, row in enumerate(rows)}
            there = [
                type(link)(place[link.one], place[link.other], link.contact_m)
                for link in links
                if link.one in place and link.other in place
            ]
            wholes = whole_buildings(pieces.iloc[rows], loose[rows], there, reach_m=reach_m)
            timeline.advance(str(day), [_renumbered(whole, rows) for whole in wholes])
    return timeline.seams()


def _renumbered(whole: Whole, rows: NDArray[np.intp]) -> Whole:
    """Return a building with the rows of all pieces."""
    members, neighbours = (tuple(int(rows[at]) for at in side) for side in (whole.members, whole.neighbours))
    return Whole(members, neighbours, whole.shape)


@dataclass(eq=False)
class _Timeline:
    """The versions that pieces become from day to day; ``now`` has the version of each piece."""

    pieces: gpd.GeoDataFrame
    standing: Standing
    versions: list[dict[str, Any]] = field(default_factory=list)
    changes: list[dict[str, Any]] = field(default_factory=list)
    ends: list[tuple[int, str, int]] = field(default_factory=list)

    def __post_init__(self) -> None:
        """Begin with the pieces themselves."""
        keys = self.pieces["version_id"].astype("int64").tolist()
        self.now = dict(enumerate(keys))
        uids = self.pieces["uid"].astype("int64").tolist()
        areas = self.pieces["area_m2"].astype(float).tolist()
        self.state = {
            key: (uid, area, shape)
            for key, uid, area, shape in zip(keys, uids, areas, self.pieces.geometry, strict=True)
        }
        self.made: dict[int, Whole] = {}

    def advance(self, day: str, wholes: Sequence[Whole]) -> None:
        """Write what changes on a day; a building of the same pieces goes on."""
        ended: dict[int, set[int]] = {}
        new = []
        for whole in wholes:
            held = {self.now[row] for row in whole.members}
            former = self.made.get(next(iter(held))) if len(held) == 1 else None
            if former and (former.members, former.neighbours) == (whole.members, whole.neighbours):
                continue
            new.append(whole)
            for row in whole.members:
                ended.setdefault(self.now[row], set()).add(row)
        taken = {row for whole in new for row in whole.members}
        for key, rows in [*ended.items()]:
            # A piece that is left behind by its building is one of its own again.
            for row in self.made[key].members if key in self.made else ():
                if row not in taken and row not in rows:
                    new.append(Whole((row,), (), self.pieces.geometry.iloc[row]))
                    taken.add(row)
        for whole in new:
            self._write(day, whole)

    def _write(self, day: str, whole: Whole) -> None:
        """Write a version, the ends of those before it, and the rows of the change."""
        pieces = self.pieces.iloc[list(whole.members)]
        owner = self._owner([*whole.members, *whole.neighbours])
        keeper = self._keeper(whole.members)
        uid = int(self.pieces["uid"].iloc[keeper])
        key = text_id("version", "across", uid, day)
        values = combined(pieces, whole.shape)
        own = pieces[pieces["survey_id"] == owner]
        largest = (own if len(own) else pieces).sort_values(["area_m2", "version_id"], ascending=[False, True]).iloc[0]
        attributes = [self.pieces["attributes"].iloc[keeper], *pieces["attributes"]]
        self.versions.append(
            values
            | {
                "version_id": key,
                "uid": uid,
                "valid_from": day,
                "survey_id": owner,
                "building_id": largest["building_id"],
                "attributes": next((value for value in attributes if isinstance(value, dict)), None),
                "geometry": whole.shape,
            }
        )
        note = self._note(whole)
        for former in sorted({self.now[row] for row in whole.members}):
            before, area, shape = self.state[former]
            self.ends.append((former, day, owner))
            shared = float(shapely.intersection(shape, whole.shape).area)
            either = float(shapely.union(shape, whole.shape).area)
            self.changes.append(
                {
                    "survey_id": owner, "kind": "unchanged", "uid_before": before, "uid_after": uid,
                    "version_before": former, "version_after": key, "outline": False, "height": False, "parts": False,
                    "overlap_m2": shared, "iou": min(shared / either, 1.0), "dh_m": None,
                    "darea_m2": float(values["area_m2"]) - area, "note": note,
                }
            )  # fmt: skip
        for row in whole.members:
            self.now[row] = key
        self.state[key] = (uid, float(values["area_m2"]), whole.shape)
        self.made[key] = whole

    def _owner(self, rows: Sequence[int]) -> int:
        """Return the survey that makes the building: the latest one, of one day the last by name."""
        some = self.pieces.iloc[rows].sort_values(["valid_from", "survey"])
        return int(some["survey_id"].iloc[-1])

    def _keeper(self, rows: Sequence[int]) -> int:
        """Return the piece whose identity the building keeps."""
        uid, began = self.pieces["uid"], self.pieces["began"]
        decided = self.standing.decided
        return min(rows, key=lambda row: (int(uid.iloc[row]) not in decided, began.iloc[row], int(uid.iloc[row])))

    def _note(self, whole: Whole) -> str:
        """Return why a version was made."""
        if len(whole.members) > 1:
            return ONE.format(_named(self.pieces["survey"].iloc[list(whole.members)]))
        return LESS.format(_named(self.pieces["survey"].iloc[list(whole.neighbours)])) if whole.neighbours else ALONE

    def seams(self) -> Seams:
        """Return all rows."""
        lasts = {version: (day, owner) for version, day, owner in self.ends}
        for row in self.versions:
            row["valid_to"], row["closed_by"] = lasts.pop(row["version_id"], (None, None))
        ends = [(version, day, owner) for version, (day, owner) in lasts.items()]
        return Seams(tuple(self.standing.released), tuple(self.versions), tuple(self.changes), tuple(ends))


def _named(surveys: "pd.Series[str]") -> str:
    """Return surveys in words."""
    names = [f"'{name}'" for name in sorted(set(surveys))]
    return " and ".join(filter(None, [", ".join(names[:-1]), names[-1]]))


def combined(pieces: pd.DataFrame, shape: shapely.Geometry) -> dict[str, Any]:
    """Return the measures of a building from those of its pieces.

    Parameters
    ----------
    pieces : DataFrame
        Measures of one piece or more, and outlines.
    shape : Polygon or MultiPolygon
        The outline of all.

    Returns
    -------
    dict
        Areas, volumes and parts are sums, on the ground of the new outline; the highest and lowest values are those of
        all pieces; other heights, storeys, shares and the probability are means by area of the pieces that have them.
        The ridge stands above the mean ground. The state follows from the probability; where it is not known, it is
        that of most ground.
    """
    area = pieces["area_m2"].to_numpy(dtype=np.float64)
    whole = float(area.sum() + shape.area - shapely.area(np.asarray(pieces["geometry"], dtype=object)).sum())
    whole = max(whole, 1e-3)
    found: dict[str, Any] = {"area_m2": whole}
    for names, fold in ((HIGHEST, np.max), (LOWEST, np.min)):
        for name in names:
            known = _known(pieces, name)[0]
            found[name] = float(fold(known)) if known.size else None
    for name in MEANS:
        known, weights = _known(pieces, name)
        found[name] = float(np.average(known, weights=weights)) if known.size else None
    for name, factor in (("volume_m3", whole / float(area.sum())), ("parts", 1.0)):
        known = _known(pieces, name)[0]
        found[name] = float(known.sum() * factor) if known.size else None
    if found["z_ridge"] is not None and found["z_ground"] is not None:
        ridge = found["z_ridge"] - found["z_ground"]
        # By rounding, the difference may lie below the eaves of a level roof.
        found["ridge"] = ridge if found["eaves"] is None else max(ridge, found["eaves"])
    for name in COUNTS:
        if found[name] is not None:
            found[name] = round(found[name])
    probability = _known(pieces, "probability")[0]
    ground: dict[str, float] = {}
    for state, part in zip(pieces["state"], area, strict=True):
        ground[state] = ground.get(state, 0.0) + float(part)
    found["state"] = min(ground, key=lambda state: (-ground[state], state))
    if len(pieces) > 1 and len(probability) == len(pieces):
        found["state"] = str(states_of(np.array([found["probability"]]), FuseParams())[0])
    return found


def _known(pieces: pd.DataFrame, name: str) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the known values of a column, and the areas of their pieces."""
    values = pd.to_numeric(pieces[name]).to_numpy(dtype=np.float64, na_value=np.nan)
    known = np.isfinite(values)
    return values[known], pieces["area_m2"].to_numpy(dtype=np.float64)[known]
