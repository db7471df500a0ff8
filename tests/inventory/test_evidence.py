"""Links between parts and flat regions."""

import numpy as np
import pandas as pd
import pytest

from msbdb.errors import GridMismatchError, TableError
from msbdb.inventory.evidence import flat_shares, link_parts, witnessed
from msbdb.tables import PART_FLAT_REGION

PARTS = np.array([501, 502, 503])
REGIONS = np.array([901, 902])


def scene():
    """Return two scales: parts 1 and 2 apart, part 3 around both; region 1 over part 1 and a gap, 2 over half of 2."""
    fine, coarse, flat = (np.zeros((4, 10), dtype=np.int32) for _ in range(3))
    fine[:, 0:4], fine[:, 6:10] = 1, 2
    coarse[:] = 3
    flat[:, 0:5], flat[0:2, 6:10] = 1, 2
    return (fine, coarse), flat


def test_overlaps_and_shares_are_counted_in_cells():
    """Every pair that shares a cell has one row, with both shares."""
    labels, flat = scene()
    links = link_parts(labels, PARTS, flat, REGIONS, cell_area_m2=0.25)
    assert list(links.columns) == PART_FLAT_REGION.names
    rows = {
        (row.part_id, row.region_id): (row.overlap_m2, row.part_share, row.region_share) for row in links.itertuples()
    }
    assert rows == {
        (501, 901): (4.0, 1.0, 0.8),
        (502, 902): (2.0, 0.5, 1.0),
        (503, 901): (5.0, 0.5, 1.0),
        (503, 902): (2.0, 0.2, 1.0),
    }


def test_links_equal_a_count_pair_by_pair():
    """On random labels every overlap is the number of cells that have both labels."""
    rng = np.random.default_rng(3)
    labels = rng.integers(0, 6, (20, 30)).astype(np.int32)
    flat = rng.integers(0, 5, (20, 30)).astype(np.int32)
    ids, regions = np.arange(1, 6) * 10, np.arange(1, 5) * 100
    links = link_parts([labels], ids, flat, regions, cell_area_m2=1.0)
    naive = [
        (ids[i], regions[j], float(cells), cells / (labels == i + 1).sum(), cells / (flat == j + 1).sum())
        for i in range(5)
        for j in range(4)
        if (cells := np.count_nonzero((labels == i + 1) & (flat == j + 1)))
    ]
    assert list(links.itertuples(index=False, name=None)) == naive
    assert flat_shares(ids, links) == pytest.approx([np.mean(flat[labels == i] > 0) for i in range(1, 6)])


def test_flat_share_adds_the_regions_up_and_is_zero_without_any():
    """A part under no region has a share of 0; a building has its root's."""
    labels, flat = scene()
    links = link_parts(labels, PARTS, flat, REGIONS, cell_area_m2=0.25)
    assert flat_shares(np.array([503, 501, 777]), links) == pytest.approx([0.7, 1.0, 0.0])


def test_nothing_gives_an_empty_table():
    """No parts, or no flat regions: no rows, and the declared columns and types."""
    labels, flat = scene()
    none = np.zeros_like(flat)
    for links in (
        link_parts(labels, PARTS, none, REGIONS[:0], cell_area_m2=1.0),
        link_parts([none], PARTS[:0], flat, REGIONS, cell_area_m2=1.0),
        link_parts([], PARTS[:0], flat, REGIONS, cell_area_m2=1.0),
    ):
        assert {c.name: c.dtype for c in PART_FLAT_REGION.columns} == {k: str(v) for k, v in links.dtypes.items()}
        assert len(links) == 0


def test_labels_of_another_extraction_are_refused():
    """Other lattices, and labels without an id, are named."""
    labels, flat = scene()
    with pytest.raises(GridMismatchError, match="one lattice"):
        link_parts([flat[:2]], PARTS, flat, REGIONS, cell_area_m2=1.0)
    with pytest.raises(TableError, match="label 2 has no flat region"):
        link_parts(labels, PARTS, flat, REGIONS[:1], cell_area_m2=1.0)
    with pytest.raises(TableError, match="label 3 has no part"):
        link_parts(labels, PARTS[:2], flat, REGIONS, cell_area_m2=1.0)


def test_a_building_without_flat_evidence_is_unsure():
    """The classes' word stands where flat regions agree; neither alone confirms."""
    buildings = pd.DataFrame({"state": ["confirmed", "confirmed", "unsure"], "flat_share": np.nan})
    heard = witnessed(buildings, np.array([0.9, 0.0, 0.9]))
    assert heard["state"].tolist() == ["confirmed", "unsure", "unsure"]
    assert heard["flat_share"].tolist() == [0.9, 0.0, 0.9]
