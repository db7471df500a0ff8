"""The example queries run on both dialects and find what is known of the small build."""

import re
import shutil
import subprocess
from collections.abc import Iterable
from contextlib import closing
from pathlib import Path
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
from msbdb.database.examples import _column
from msbdb.database.schema.sqlfiles import packaged
from msbdb.errors import InputError, ParameterError

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
    """SQL in a parameter stays a value: of a number it is refused, of a text it is a text."""
    with pytest.raises(ParameterError, match=r"min_area_m2 .* is a number"):
        run_example(loaded, "plain_buildings", min_area_m2="0; DROP TABLE building CASCADE; COMMIT")
    with pytest.raises(InputError, match="no survey"):
        run_example(loaded, "plain_buildings", survey="'; DROP TABLE building CASCADE; COMMIT; --")
    assert len(run_example(loaded, "parts_of_building")) == 3


@pytest.mark.parametrize(
    ("name", "values", "says"),
    [
        ("plain_buildings", {"survey": "delfd"}, "no survey 'delfd'. Give one of them: delft"),
        ("tallest_buildings", {"count": -1}, "whole number of at least 0"),
        ("tallest_buildings", {"count": None}, "whole number of at least 0"),
        ("tallest_buildings", {"count": 2.5}, "whole number of at least 0"),
        ("tallest_buildings", {"count": 1.5e300}, "whole number of at least 0"),
        ("plain_buildings", {"min_area_m2": "nan"}, "is a number"),
        ("inventory_at_date", {"date": "2021"}, "a day such as 2021-05-31"),
        ("tallest_building", {}, "Did you mean tallest_buildings"),
        ("Tallest", {}, "Did you mean tallest_buildings"),
    ],
)
def test_a_value_that_cannot_be_is_refused_and_gives_no_wrong_answer(
    loaded: Engine, name: str, values: dict[str, Any], says: str
) -> None:
    """An empty or endless answer would look like a true one."""
    with pytest.raises(InputError, match=re.escape(says)):
        run_example(loaded, name, **values)


def test_whole_numbers_beside_nulls_stay_whole(loaded: Engine) -> None:
    """Ids have more digits than floating point numbers."""
    found = run_example(loaded, "buildings_by_class")
    assert str(found["speindex"].dtype) == "int64"
    assert str(pd.DataFrame({"id": _column([2**62 + 1, None])})["id"].dtype) == "Int64"
    assert _column([2**62 + 1, None])[0] == 2**62 + 1


def files() -> list[Path]:
    """Return the files of the example queries."""
    return [packaged("schema") / "queries" / f"{name}.sql" for name in example_queries()]


def rows_of(found: Iterable[Any]) -> list[list[Any]]:
    """Return rows of plain values."""
    return [[None if pd.isna(value) else value for value in row] for row in found]


def test_a_user_runs_the_files_as_they_are(loaded: Engine) -> None:
    """Each file answers as the query of its name does with the defaults, without parameters of the driver."""
    with closing(loaded.raw_connection()) as connection:
        for path in files():
            cursor = connection.cursor()
            cursor.execute(path.read_text(encoding="utf-8"))
            assert rows_of(cursor.fetchall()) == rows_of(run_example(loaded, path.stem).itertuples(index=False)), path


def test_a_user_edits_the_values_at_the_top_of_a_file(loaded: Engine) -> None:
    """The values of ``param`` decide, as the parameters do."""
    words = (packaged("schema") / "queries" / "tallest_buildings.sql").read_text(encoding="utf-8")
    edited = words.replace("CAST(10 AS INTEGER)", "CAST(1 AS INTEGER)").replace("NULL AS TEXT", "'delft' AS TEXT")
    with closing(loaded.raw_connection()) as connection:
        cursor = connection.cursor()
        cursor.execute(edited)
        assert [row[0] for row in cursor.fetchall()] == [PODIUM]
        cursor.execute(edited.replace("'delft'", "'spring'"))
        assert not cursor.fetchall()


def test_a_user_runs_the_files_in_the_client_of_the_database(loaded: Engine) -> None:
    """All of them by sqlite3 or psql, where it is installed; the first error would end the client."""
    if loaded.dialect.name == "postgresql":
        url = loaded.url.set(drivername="postgresql").render_as_string(hide_password=False)
        command = [
            "psql",
            "-X",
            "-At",
            "-v",
            "ON_ERROR_STOP=1",
            *(word for path in files() for word in ("-f", path)),
            url,
        ]
        script = ""
    else:
        command = ["sqlite3", "-bail", "-cmd", ".load mod_spatialite", str(loaded.url.database)]
        script = "".join(f".read {path}\n" for path in files())
    if shutil.which(str(command[0])) is None:
        pytest.skip(f"{command[0]} is not installed")
    done = subprocess.run(command, input=script, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    assert len(done.stdout.splitlines()) == sum(len(run_example(loaded, path.stem)) for path in files())
