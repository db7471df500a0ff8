"""Links between regions of two detectors, and the states of buildings that follow."""

import numpy as np
import pandas as pd
import pytest

from msbdb.errors import GridMismatchError, TableError
from msbdb.fuse.buildings import covered_shares, link_labels, with_support
from msbdb.tables import FLAT_REGION_CANDIDATE, PART_CANDIDATE, PART_FLAT_REGION

PARTS = np.array([501, 502, 503])
REGIONS = np.array([901, 902])
LINKS = (PART_FLAT_REGION, PART_CANDIDATE, FLAT_REGION_CANDIDATE)


def scene():
    """Return two scales: parts 1 and 2 apart, part 3 around both; region 1 over part 1 and a gap, 2 over half of 2."""
    fine, coarse, flat = (np.zeros((4, 10), dtype=np.int32) for _ in range(3))
    fine[:, 0:4], fine[:, 6:10] = 1, 2
    coarse[:] = 3
    flat[:, 0:5], flat[0:2, 6:10] = 1, 2
    return (fine, coarse), flat


def link(labels, ids, others, other_ids, table=PART_FLAT_REGION):
    """Return the links of the table's two kinds."""
    return link_labels(labels, ids, others, other_ids, table=table, cell_area_m2=0.25)


@pytest.mark.parametrize("table", LINKS, ids=lambda table: table.name)
def test_overlaps_and_shares_are_counted_in_cells(table):
    """Every pair that shares a cell has one row, with both shares, in the declared columns."""
    labels, flat = scene()
    links = link(labels, PARTS, flat, REGIONS, table)
    assert {c.name: c.dtype for c in table.columns} == {name: str(dtype) for name, dtype in links.dtypes.items()}
    assert list(links.itertuples(index=False, name=None)) == [
        (501, 901, 4.0, 1.0, 0.8),
        (502, 902, 2.0, 0.5, 1.0),
        (503, 901, 5.0, 0.5, 1.0),
        (503, 902, 2.0, 0.2, 1.0),
    ]


def test_links_equal_a_count_pair_by_pair():
    """On random labels every overlap is the number of cells that have both labels."""
    rng = np.random.default_rng(3)
    labels = rng.integers(0, 6, (20, 30)).astype(np.int32)
    flat = rng.integers(0, 5, (20, 30)).astype(np.int32)
    ids, regions = np.arange(1, 6) * 10, np.arange(1, 5) * 100
    links = link([labels], ids, flat, regions)
    naive = [
        (ids[i], regions[j], cells / 4, cells / (labels == i + 1).sum(), cells / (flat == j + 1).sum())
        for i in range(5)
        for j in range(4)
        if (cells := np.count_nonzero((labels == i + 1) & (flat == j + 1)))
    ]
    assert list(links.itertuples(index=False, name=None)) == naive
    covered = [np.mean(flat[labels == i] > 0) for i in range(1, 6)]
    assert covered_shares(labels, 5, flat) == pytest.approx(covered)


def test_links_seen_from_either_side_are_the_same():
    """Which kind comes first does not matter, and a region's shares add up to what the other image covers of it."""
    rng = np.random.default_rng(8)
    one, other = (rng.integers(0, n, (15, 25)).astype(np.int32) for n in (4, 7))
    ids, others = np.arange(1, 4), np.arange(1, 7) * 10
    forth = link([one], ids, other, others, FLAT_REGION_CANDIDATE)
    back = link([other], others, one, ids, FLAT_REGION_CANDIDATE)
    turned = back[["candidate_id", "region_id", "overlap_m2", "candidate_share", "region_share"]]
    turned = turned.sort_values(["candidate_id", "region_id"])
    assert np.array_equal(forth.to_numpy(), turned.to_numpy())
    sums = forth.groupby("candidate_id")["candidate_share"].sum()
    assert sums.to_numpy() == pytest.approx([np.mean(one[other == k] > 0) for k in range(1, 7)])


def test_a_region_without_a_cell_has_no_link():
    """A region of points that share all their cells with a stronger one is in the table, and in no link."""
    labels, flat = scene()
    links = link(labels, PARTS, flat, np.array([901, 902, 903]))
    assert sorted(set(links["region_id"])) == [901, 902]
    links = link([np.where(labels[0] == 2, 3, labels[0])], PARTS, flat, REGIONS)
    assert sorted(set(links["part_id"])) == [501, 503]


def test_the_support_of_a_building_is_the_share_of_its_cells():
    """All regions of a detector count together; a building under none has a share of 0."""
    buildings = np.array([[1, 1, 1, 1, 0, 2, 2, 3]])
    regions = np.array([[7, 7, 0, 4, 4, 0, 0, 9]])
    assert covered_shares(buildings, 3, regions).tolist() == [0.75, 0.0, 1.0]
    assert covered_shares(0 * buildings, 0, regions).tolist() == []


@pytest.mark.parametrize("table", LINKS, ids=lambda table: table.name)
def test_nothing_gives_an_empty_table(table):
    """No regions on either side: no rows, and the declared columns and types."""
    labels, flat = scene()
    none = np.zeros_like(flat)
    for links in (
        link(labels, PARTS, none, REGIONS[:0], table),
        link([none], PARTS[:0], flat, REGIONS, table),
        link([], PARTS[:0], flat, REGIONS, table),
    ):
        assert {c.name: c.dtype for c in table.columns} == {name: str(dtype) for name, dtype in links.dtypes.items()}
        assert len(links) == 0


def test_labels_of_another_build_are_refused():
    """Other lattices, and labels without an id, are named."""
    labels, flat = scene()
    with pytest.raises(GridMismatchError, match="part_flat_region must lie on one lattice"):
        link([flat[:2]], PARTS, flat, REGIONS)
    with pytest.raises(TableError, match="label 2 has no region_id"):
        link(labels, PARTS, flat, REGIONS[:1])
    with pytest.raises(TableError, match="label 3 has no part_id"):
        link(labels, PARTS[:2], flat, REGIONS)


STATES = ["confirmed", "confirmed", "unsure"]


def supported(**shares):
    """Return three buildings with the support of detectors; the classes confirm the first two."""
    none = dict.fromkeys(("flat_share", "area3d_share", "adaptive_share"), np.nan)
    buildings = pd.DataFrame({"state": STATES, **none})
    return with_support(buildings, {name: np.array(values) for name, values in shares.items()})


def test_one_detector_must_support_the_building():
    """The classes' word stands where flat regions agree; neither alone confirms."""
    buildings = supported(flatregions=[0.1, 0.0999, 0.9])
    assert buildings["state"].tolist() == ["confirmed", "unsure", "unsure"]
    assert buildings["flat_share"].tolist() == [0.1, 0.0999, 0.9]
    assert buildings[["area3d_share", "adaptive_share"]].isna().all(axis=None)


def test_half_of_the_detectors_are_enough():
    """One of two must support a building, or two of three."""
    two = supported(flatregions=[0.0, 0.0, 1.0], area3d=[0.5, 0.05, 1.0])
    assert two["state"].tolist() == ["confirmed", "unsure", "unsure"]
    three = supported(flatregions=[0.0, 0.0, 1.0], area3d=[0.5, 0.5, 1.0], adaptive=[0.2, 0.0, 1.0])
    assert three["state"].tolist() == ["confirmed", "unsure", "unsure"]
    assert three["adaptive_share"].tolist() == [0.2, 0.0, 1.0]


def test_without_other_detectors_the_classes_decide():
    """The state stays, and all shares are unknown."""
    buildings = supported()
    assert buildings["state"].tolist() == STATES
    assert buildings.drop(columns="state").isna().all(axis=None)
