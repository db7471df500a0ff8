"""The net change of a period: many surveys' words on a building as one."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import geopandas as gpd
import numpy as np
import pandas as pd
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st
from shapely import box

from msbdb.change.netchange import COLUMNS, Net, net_changes

CRS = "EPSG:32631"
Rectangle = tuple[float, float, float, float]
State = tuple[Rectangle, float]
"""An outline and a height."""


@dataclass
class Story:
    """Buildings and what surveys do to them, written down as the database has it."""

    states: dict[int, State]
    date: int = 2000
    rows: list[dict[str, object]] = field(default_factory=list)
    versions: list[dict[str, object]] = field(default_factory=list)
    current: dict[int, int] = field(default_factory=dict)
    offsets: list[dict[str, float]] = field(default_factory=list)

    def __post_init__(self) -> None:
        """Enter what stands at the beginning."""
        for uid, state in self.states.items():
            self.current[uid] = self._version(uid, state, None)

    def _version(self, uid: int, state: State, survey: int | None) -> int:
        (west, south, east, north), height = state
        shape = box(west, south, east, north)
        values = {"state": "unsure", "storeys": 1, "h_max": height, "h_p90": height, "area_m2": shape.area}
        values |= {
            "probability": float("nan"),
            "volume_m3": height * shape.area,
            "attributes": None,
            "geometry": shapely.multipolygons([shape]),
        }
        self.versions.append({"version_id": len(self.versions) + 1, "uid": uid, "survey_id": survey, **values})
        return len(self.versions)

    def survey(
        self, *events: tuple[str, int | None, int | None, State | None, str], offset: Sequence[float] = (0, 0, 0)
    ) -> "Story":
        """Write one survey: kind, uid before and after, new state or None for the old one, and what was modified."""
        self.date += 1
        self.offsets.append(dict(zip(("survey_id", "dx_m", "dy_m", "dz_m"), (self.date, *offset), strict=True)))
        made = {after: self._version(after, state, self.date) for _, _, after, state, _ in events if after and state}
        rows = []
        for kind, before, after, _, flags in events:
            row: dict[str, object] = {"survey": f"s{self.date}", "date": f"{self.date}-01-01", "kind": kind, "note": ""}
            row |= {"uid_before": before, "uid_after": after, "version_before": self.current.get(before)}
            row |= {"version_after": made.get(after, self.current.get(before)) if after else None}
            rows.append(row | {name: name in flags.split() for name in ("outline", "height", "parts")})
        self.rows += rows
        for _, before, _, _, _ in events:
            self.current.pop(before, None)
        self.current |= {row["uid_after"]: row["version_after"] for row in rows if row["uid_after"]}
        return self

    def net(self) -> Net:
        """Return the net change."""
        names = ("uid_before", "uid_after", "version_before", "version_after")
        rows = pd.DataFrame(self.rows).astype(dict.fromkeys(names, "Int64"))
        versions = gpd.GeoDataFrame(self.versions, crs=CRS).astype({"survey_id": "Int64"})
        return net_changes(rows, versions, pd.DataFrame(self.offsets))

    def pairs(self) -> list[tuple[str, int | None, int | None]]:
        """Return kind and uids of the net change."""
        table = self.net().table
        pairs = [[None if pd.isna(v) else int(v) for v in table[name]] for name in ("uid_before", "uid_after")]
        return list(zip(table["kind"], *pairs, strict=True))


LEFT: State = ((0, 0, 10, 10), 6.0)
RIGHT: State = ((12, 0, 20, 10), 6.0)
BOTH: State = ((0, 0, 20, 10), 6.0)


def still(uid: int) -> tuple[str, int, int, None, str]:
    """Return the word on a building that stays as it is."""
    return ("unchanged", uid, uid, None, "")


def test_raised_and_then_demolished_is_demolished() -> None:
    """The states in between are not reported, and the state before is that of the beginning."""
    story = (
        Story({1: LEFT}).survey(("modified", 1, 1, (LEFT[0], 9.0), "height")).survey(("demolished", 1, None, None, ""))
    )
    assert story.pairs() == [("demolished", 1, None)]
    row = story.net().table.iloc[0]
    assert (row["h_p90_before"], row["dh_m"], row["darea_m2"], row["times"]) == (6.0, -6.0, -100.0, 2)
    assert not row[["outline", "height", "parts"]].any()
    assert (row["survey"], row["date"]) == ("s2002", "2002-01-01")


def test_built_and_demolished_in_between_is_counted_only() -> None:
    """It is in no row."""
    story = (
        Story({1: LEFT})
        .survey(still(1), ("new", None, 2, RIGHT, ""))
        .survey(still(1), ("demolished", 2, None, None, ""))
    )
    assert story.pairs() == [("unchanged", 1, 1)]
    assert story.net().passing["uid"].tolist() == [2]


def test_modified_twice_is_modified_once_in_all_respects() -> None:
    """Differences are those of the first and the last state, offsets taken out."""
    wider: State = ((0.5, 0, 15.5, 10), 6.0)
    higher: State = ((0.5, 0, 15.5, 10), 10.0)
    story = (
        Story({1: LEFT})
        .survey(("modified", 1, 1, wider, "outline"))
        .survey(("modified", 1, 1, higher, "height parts"), offset=(0.5, 0, 1.0))
        .survey(still(1))
    )
    row = story.net().table.iloc[0]
    assert story.pairs() == [("modified", 1, 1)]
    assert row[["outline", "height", "parts"]].all()
    assert (row["dh_m"], row["darea_m2"], row["times"], row["survey"]) == (3.0, 50.0, 2, "s2002")
    assert (row["overlap_m2"], row["iou"]) == (pytest.approx(100.0), pytest.approx(100 / 150))
    assert (row["h_p90_before"], row["h_p90_after"]) == (6.0, 10.0)


def test_merged_and_then_modified_is_merged() -> None:
    """Each pair has its row, with what was modified later."""
    story = (
        Story({1: LEFT, 2: RIGHT})
        .survey(("merged", 1, 1, BOTH, "outline"), ("merged", 2, 1, BOTH, "outline"))
        .survey(("modified", 1, 1, (BOTH[0], 12.0), "height"))
    )
    assert story.pairs() == [("merged", 1, 1), ("merged", 2, 1)]
    table = story.net().table
    assert table["height"].all()
    assert table["dh_m"].tolist() == [6.0, 6.0]
    assert len(set(table["version_after"])) == 1


def test_merged_and_then_demolished_is_demolished_twice() -> None:
    """Both buildings of the beginning are gone."""
    story = (
        Story({1: LEFT, 2: RIGHT})
        .survey(("merged", 1, 1, BOTH, "outline"), ("merged", 2, 1, BOTH, "outline"))
        .survey(("demolished", 1, None, None, ""))
    )
    assert story.pairs() == [("demolished", 1, None), ("demolished", 2, None)]


def test_what_was_joined_and_pulled_down_in_part_is_demolished() -> None:
    """The part that was a building of its own at the beginning is gone."""
    story = (
        Story({1: LEFT, 2: RIGHT})
        .survey(("merged", 1, 1, BOTH, "outline"), ("merged", 2, 1, BOTH, "outline"))
        .survey(("modified", 1, 1, LEFT, "outline"))
    )
    assert story.pairs() == [("modified", 1, 1), ("demolished", 2, None)]


def test_what_was_joined_and_parted_again_is_two_buildings() -> None:
    """Identities are followed by the ground on which they stand, though the second one has a new one."""
    story = (
        Story({1: LEFT, 2: RIGHT})
        .survey(("merged", 1, 1, BOTH, "outline"), ("merged", 2, 1, BOTH, "outline"))
        .survey(("split", 1, 1, LEFT, "outline"), ("split", 1, 3, RIGHT, "outline"))
    )
    assert story.pairs() == [("modified", 1, 1), ("modified", 2, 3)]


def test_split_and_then_demolished_in_part_is_modified() -> None:
    """One part is left, and goes on as the building."""
    story = (
        Story({1: BOTH})
        .survey(("split", 1, 1, LEFT, "outline"), ("split", 1, 2, RIGHT, "outline"))
        .survey(still(1), ("demolished", 2, None, None, ""))
    )
    assert story.pairs() == [("modified", 1, 1)]
    assert story.net().table["darea_m2"].tolist() == [-100.0]


def test_an_extension_that_was_parted_later_is_new() -> None:
    """It stands where the building of the beginning did not."""
    story = (
        Story({1: LEFT})
        .survey(("modified", 1, 1, BOTH, "outline"))
        .survey(("split", 1, 1, LEFT, "outline"), ("split", 1, 2, RIGHT, "outline"))
    )
    assert story.pairs() == [("modified", 1, 1), ("new", None, 2)]


def test_a_new_building_that_takes_an_old_one_in_goes_on_as_it() -> None:
    """The larger one gives the identity; both rows report the pair."""
    large: State = ((12, 0, 40, 10), 6.0)
    story = (
        Story({1: LEFT})
        .survey(still(1), ("new", None, 2, large, ""))
        .survey(("merged", 1, 2, ((0, 0, 40, 10), 6.0), "outline"), ("merged", 2, 2, ((0, 0, 40, 10), 6.0), "outline"))
    )
    assert story.pairs() == [("modified", 1, 2)]


def test_a_building_that_stood_before_counts_from_its_first_version() -> None:
    """First reported as unchanged, then gone: it was demolished, and never new."""
    story = Story({}).survey(("unchanged", None, 1, LEFT, ""), ("unchanged", None, 2, RIGHT, ""))
    story.survey(still(1), ("demolished", 2, None, None, ""))
    assert story.pairs() == [("unchanged", 1, 1), ("demolished", 2, None)]
    assert story.net().passing.empty


def test_a_period_without_a_survey_has_no_rows() -> None:
    """All columns are there."""
    story = Story({1: LEFT}).survey(still(1))
    net = net_changes(
        pd.DataFrame(story.rows).iloc[:0],
        gpd.GeoDataFrame(story.versions, crs=CRS).iloc[:0],
        pd.DataFrame(story.offsets),
    )
    assert len(net.table) == len(net.passing) == 0
    assert list(net.table.columns)[: len(COLUMNS)] == list(COLUMNS)


@given(st.data())
def test_rows_and_counts_add_up_over_any_history(data: st.DataObject) -> None:
    """Each building of the beginning and of the end is reported, and all that came is there, gone, or joined."""
    story = Story({uid: ((20.0 * uid, 0, 20.0 * uid + 10, 10), 6.0) for uid in range(1, 4)})
    states, free = dict(story.states), 10
    first = set(states)
    for _ in range(data.draw(st.integers(1, 4))):
        events: list[tuple[str, int | None, int | None, State | None, str]] = []
        for uid in sorted(states):
            act = data.draw(st.sampled_from(["unchanged", "modified", "demolished"]))
            if act == "modified":
                states[uid] = (states[uid][0], states[uid][1] + 3)
                events.append(("modified", uid, uid, states[uid], "height"))
            else:
                events.append((act, uid, uid if act == "unchanged" else None, None, ""))
        for event in events:
            if event[0] == "demolished":
                del states[event[1]]
        if data.draw(st.booleans()):
            states[free] = ((20.0 * free, 0, 20.0 * free + 10, 10), 6.0)
            events.append(("new", None, free, states[free], ""))
            free += 1
        if events:
            story.survey(*events)
    if not story.rows:
        return
    net = story.net()
    kinds = net.table["kind"]
    assert set(net.table["uid_before"].dropna()) == first
    assert set(net.table["uid_after"].dropna()) == set(states)
    assert (kinds == "demolished").sum() == len(first - set(states))
    assert (kinds == "new").sum() + len(net.passing) == free - 10
    rose = net.table["dh_m"][kinds.isin(["modified", "unchanged"])]
    assert np.array_equal(rose > 0, kinds[rose.index] == "modified")
