"""The example queries run on both dialects and find what is known of the small build."""

from contextlib import nullcontext
from typing import Any

import pandas as pd
import pytest
from simulated.builds import (
    AWNING,
    BLOCK,
    CRANE,
    DECK,
    HOUSE,
    LIFT,
    PITCH,
    PITCH_CLUSTER,
    PODIUM,
    SHED,
    SLAB,
    SOUTH,
    WEST,
)
from sqlalchemy import Engine

from msbdb.database import example_queries, run_example
from msbdb.errors import DatabaseError, ParameterError

KNOWN: list[tuple[str, dict[str, Any], list[str], list[tuple[Any, ...]]]] = [
    ("tall_buildings_near", {}, ["building_id", "storeys"], [(PODIUM, 7)]),
    (
        "tall_buildings_near",
        {"storeys": 2, "easting": WEST + 95, "northing": SOUTH + 15, "radius_m": 50},
        ["building_id", "distance_m"],
        [(BLOCK, 5.0), (HOUSE, 25.0)],
    ),
    ("building_at_point", {}, ["building_id"], [(PODIUM,)]),
    ("building_at_point", {"easting": WEST + 95, "northing": SOUTH + 15}, ["building_id"], []),
    ("building_at_point", {"easting": WEST + 85, "northing": SOUTH + 15}, ["building_id"], [(BLOCK,)]),
    (
        "parts_of_building",
        {},
        ["depth", "part_id", "hindex", "threshold_m2"],
        [(0, PODIUM, 3, 200.0), (1, SLAB, 6, 50.0), (2, LIFT, 7, 20.0)],
    ),
    ("parts_of_building", {"building_id": SHED}, ["part_id", "supid"], [(SHED, 0)]),
    (
        "built_volume_by_block",
        {},
        ["west", "south", "buildings", "volume_m3"],
        [(WEST, SOUTH, 3, 21_000.0), (WEST + 300, SOUTH, 1, 90.0)],
    ),
    ("tallest_buildings", {"count": 2}, ["building_id", "h_max"], [(PODIUM, 21.5), (BLOCK, 12.5)]),
    (
        "buildings_by_class",
        {},
        ["speindex", "labelled_by", "buildings", "area_m2"],
        [(0, None, 1, 30.0), (2, "automatic", 2, 1300.0), (3, "operator", 1, 800.0)],
    ),
    ("courtyards", {}, ["building_id", "courtyards", "courtyard_m2"], [(BLOCK, 1, 100.0)]),
    ("courtyards", {"min_area_m2": 101}, ["building_id"], []),
    (
        "rejections_by_stage",
        {},
        ["method", "stage", "reason", "regions", "area_m2", "small", "small_m2"],
        [
            ("multiscale", "spectral", "vegetation", 2, 96.0, 0, 0.0),
            ("multiscale", "duplicates", "same storeys", 1, 1150.0, 0, 0.0),
        ],
    ),
    ("rejections_near", {}, ["stage", "area_m2", "distance_m"], [("duplicates", 1150.0, 0.0)]),
    (
        "rejections_near",
        {"easting": WEST + 154, "northing": SOUTH + 20, "radius_m": 10},
        ["reason", "area_m2", "distance_m"],
        [("vegetation", 36.0, 4.0), ("vegetation", 60.0, 6.0)],
    ),
    ("storeys_histogram", {}, ["storeys", "buildings"], [(1, 1), (2, 1), (4, 1), (7, 1)]),
    (
        "floor_area_by_block",
        {"block_m": 1000},
        ["buildings", "floor_area_m2"],
        [(4, 4220.0 + 200 + 3200 + 30)],
    ),
    ("plain_buildings", {}, ["building_id", "area_m2"], [(BLOCK, 800.0), (HOUSE, 100.0)]),
    ("densest_blocks", {"count": 1}, ["buildings", "built_share", "most_storeys"], [(3, 0.21, 7)]),
    ("towers_on_podiums", {}, ["part_id", "rises_storeys", "podium_id"], [(SLAB, 3, PODIUM)]),
    ("parts_by_scale", {}, ["scale", "parts", "roots"], [(1, 2, 2), (2, 2, 1), (3, 2, 1)]),
    ("close_neighbours", {}, ["building_id", "distance_m"], [(HOUSE, 20.0)]),
    ("close_neighbours", {"building_id": HOUSE}, ["building_id", "distance_m"], [(BLOCK, 10.0), (PODIUM, 20.0)]),
    (
        "surveys",
        {},
        ["survey", "multiscale", "adaptive", "buildings", "parts", "rejections", "flat_regions", "candidates"],
        [("delft", 1, 1, 4, 6, 3, 4, 8)],
    ),
    ("parts_with_flat_region", {}, ["part_id", "flat_share", "flat_regions"], [(SLAB, 1.0, 1), (LIFT, 1.0, 1)]),
    ("parts_with_flat_region", {"share": 0.375}, ["part_id"], [(SLAB,), (LIFT,), (BLOCK,)]),
    ("unexplained_flat_regions", {}, ["region_id", "explained_share"], [(PITCH, 0.0), (DECK, 0.25)]),
    ("unexplained_flat_regions", {"min_area_m2": 100}, ["region_id"], [(PITCH,)]),
    ("buildings_without_flat_region", {}, ["building_id", "flat_share"], [(SHED, 0.0)]),
    ("buildings_without_flat_region", {"share": 0.2}, ["building_id"], [(PODIUM,), (HOUSE,), (SHED,)]),
    (
        "flat_regions_by_scale",
        {},
        ["scale", "parts", "confirmed", "flat_share"],
        [(1, 2, 0, 0.25), (2, 2, 1, 220 / 300), (3, 2, 1, 0.4)],
    ),
    (
        "candidates_by_method",
        {},
        ["method", "rule", "regions", "area_m2", "unexplained"],
        [
            ("adaptive", "clustering", 5, 1015.0, 2),
            ("area3d", "rule 1", 1, 1200.0, 0),
            ("area3d", "rule 2", 2, 400.0, 1),
        ],
    ),
    (
        "unexplained_candidates",
        {},
        ["candidate_id", "method", "explained_share"],
        [(AWNING, "adaptive", 0.25), (PITCH_CLUSTER, "adaptive", 0.0), (CRANE, "area3d", 0.0)],
    ),
    ("unexplained_candidates", {"min_area_m2": 400}, ["candidate_id"], [(AWNING,)]),
    ("overlooked_roofs", {}, ["candidate_id", "explained_share", "flat_share"], [(PITCH_CLUSTER, 0.0, 1.0)]),
    ("overlooked_roofs", {"flat": 0}, ["candidate_id"], [(AWNING,), (PITCH_CLUSTER,), (CRANE,)]),
    (
        "buildings_by_witnesses",
        {},
        ["state", "classes_for", "extractors_heard", "extractors_for", "buildings", "area_m2"],
        [("confirmed", 1, 3, 1, 1, 30.0), ("confirmed", 1, 3, 2, 2, 900.0), ("confirmed", 1, 3, 3, 1, 1200.0)],
    ),
    ("doubtful_buildings", {}, ["building_id", "extractors_for", "adaptive_share"], [(SHED, 1, 0.5)]),
    ("doubtful_buildings", {"witnesses": 3}, ["building_id"], [(BLOCK,), (HOUSE,), (SHED,)]),
    # The small build is in no inventory; what these find is tested with the inventory.
    ("inventory_at_date", {}, ["state", "buildings"], []),
    ("changes_by_survey", {}, ["survey", "kind", "changes"], []),
    ("history_of_building", {}, ["uid", "valid_from"], []),
    ("roof_materials_by_class", {}, ["material", "speindex", "samples"], []),
    ("parts_with_candidates", {}, ["part_id", "area3d_share", "adaptive_share"], [(SLAB, 1.0, 1.0), (LIFT, 1.0, 1.0)]),
    ("parts_with_candidates", {"share": 0.25}, ["part_id"], [(PODIUM,), (SLAB,), (LIFT,)]),
]


@pytest.mark.parametrize(("name", "values", "columns", "expected"), KNOWN, ids=[f"{k[0]}-{k[1]}" for k in KNOWN])
def test_queries_find_what_is_known(
    loaded: Engine, name: str, values: dict[str, Any], columns: list[str], expected: list[tuple[Any, ...]]
) -> None:
    """The rows follow from the build's description."""
    found = run_example(loaded, name, **values)[columns]
    rows = [tuple(None if pd.isna(value) else value for value in row) for row in found.itertuples(index=False)]
    assert rows == [pytest.approx(row) if None not in row else row for row in expected]


def test_every_query_is_known_and_says_what_one_learns() -> None:
    """Each file asks a question, explains its parameters, and has known rows above."""
    queries = example_queries()
    assert len(queries) >= 10
    assert set(queries) == {name for name, *_ in KNOWN}
    for query in queries.values():
        assert "?" in query.title
        used = {word for word in query.defaults if f":{word}" in query.sql}
        assert used == set(query.defaults)


def test_unknown_queries_and_parameters_are_refused(loaded: Engine) -> None:
    """The message lists what there is."""
    with pytest.raises(ParameterError, match="tallest_buildings"):
        run_example(loaded, "smallest_buildings")
    with pytest.raises(ParameterError, match="it has count"):
        run_example(loaded, "tallest_buildings", number=3)


def test_values_are_bound_not_pasted(loaded: Engine) -> None:
    """SQL in a parameter stays a value."""
    with pytest.raises(DatabaseError) if loaded.dialect.name == "postgresql" else nullcontext():
        run_example(loaded, "plain_buildings", min_area_m2="0; DROP TABLE building CASCADE; COMMIT")
    assert len(run_example(loaded, "parts_of_building")) == 3
