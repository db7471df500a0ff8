"""The ledger: what goes in is kept or dropped, and what is dropped has a row or is counted, with its cells."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from msbdb.errors import TableError
from msbdb.ledger import Ledger, sum_up
from msbdb.tables import REASONS, REJECTION, REJECTION_COUNT, Reason, validate

STAGES = st.sampled_from(["opening", "rules", "vegetation"])
WORDS = st.sampled_from(["rough", "small", "green"])
DROPPED = st.lists(st.tuples(STAGES, WORDS, st.floats(0.01, 500, allow_nan=False)), max_size=40)


def ledger_of(dropped):
    """Return rows of the ledger for dropped regions."""
    rows = REJECTION.empty()
    for number, (stage, reason, area_m2) in enumerate(dropped):
        rows.loc[number] = [number + 1, "area3d", stage, reason, 0, area_m2, 0.0, 0.0]
    return REJECTION.typed(rows)


@given(DROPPED, st.sampled_from([0.0, 4.0, 10.0, 1000.0]))
def test_every_dropped_region_has_a_row_or_is_counted(dropped, least_m2):
    """By stage and reason: regions are rows plus small ones, and areas add up; kinds are numbered without a gap."""
    rows, counts = sum_up(ledger_of(dropped), REJECTION_COUNT.empty(), least_m2)
    validate(counts, REJECTION_COUNT)
    assert (rows["area_m2"] >= least_m2).all()
    assert counts["regions"].sum() == len(dropped)
    assert counts["number"].tolist() == list(range(1, len(counts) + 1))
    assert sorted(zip(counts["stage"], counts["reason"], strict=True)) == sorted({kind[:2] for kind in dropped})
    for stage, reason, regions, area_m2, small, small_m2 in counts[
        ["stage", "reason", "regions", "area_m2", "small", "small_m2"]
    ].to_numpy():
        own = [area for s, r, area in dropped if (s, r) == (stage, reason)]
        kept = rows[(rows["stage"] == stage) & (rows["reason"] == reason)]
        assert (regions, small) == (len(own), len(own) - len(kept))
        assert area_m2 == pytest.approx(sum(own))
        assert small_m2 == pytest.approx(sum(own) - kept["area_m2"].sum(), abs=1e-9)


@given(DROPPED, st.randoms(use_true_random=False))
def test_a_ledger_read_back_sums_up_to_the_same(dropped, random):
    """From the rows and counts of a database follow the same, to the last bit, in whatever order the rows come."""
    rows, counts = sum_up(ledger_of(dropped), REJECTION_COUNT.empty(), 10.0)
    mixed = list(range(len(rows)))
    random.shuffle(mixed)
    again, counted = sum_up(rows.iloc[mixed].reset_index(drop=True), counts, 10.0)
    pd.testing.assert_frame_equal(counted, counts)
    assert sorted(again["region_id"]) == sorted(rows["region_id"])


def test_cells_are_marked_by_the_last_stage_that_dropped_them():
    """Numbers are those of the counts; of two reasons in a cell the later in the alphabet stays."""
    ledger = Ledger("area3d")
    one = pd.DataFrame({"reason": ["rough", "green"], "area_m2": [3.0, 2.0]})
    ledger.mark("rules", one["reason"].to_numpy(), np.array([1, 1, 1, 2, 2]), np.array([0, 1, 2, 2, 3]))
    assert ledger.write("rules", one) == 2
    ledger.count("rules", 3, 1, 2)
    ledger.mark("late", np.array(["thin"], dtype=object), np.array([1]), np.array([3]))
    ledger.write("late", pd.DataFrame({"reason": ["thin"], "area_m2": [1.0]}))
    ledger.count("late", 1, 0, 1)
    # In order: late thin, rules green, rules rough.
    assert ledger.marked().on((2, 3)).tolist() == [[3, 3, 3], [1, 0, 0]]


def test_a_ledger_without_dropped_regions_marks_nothing():
    """No cell has an answer."""
    assert not Ledger("area3d").marked().on((2, 2)).any()


def test_books_that_do_not_balance_are_refused():
    """In = kept + dropped, and each dropped region is written."""
    ledger = Ledger("area3d")
    with pytest.raises(TableError, match="does not balance"):
        ledger.count("rules", 3, 1, 1)
    with pytest.raises(TableError, match="dropped 2 regions, but wrote 0"):
        ledger.count("rules", 3, 1, 2)


def test_every_reason_is_declared_once_and_on_its_page():
    """The codes of the raster are those that docs/database.md lists, with their meanings."""
    assert list(REASONS) == list(Reason)
    page = (Path(__file__).parents[1] / "docs" / "database.md").read_text(encoding="utf-8")
    for reason, meaning in REASONS.items():
        assert f"| {int(reason)} | `{reason.name}` | {meaning} |" in page
