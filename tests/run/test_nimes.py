"""The real tile of Nîmes from the point file to the database, against numbers that were looked at.

``MSBDB_REGEN=1 pytest tests/run/test_nimes.py`` writes tests/golden/nimes.json anew. A difference in it is a
change of results: look at the map before, and tell users in CHANGELOG.md.
"""

import json
import os
from pathlib import Path

import pytest
import shapely
from click.testing import CliRunner

import msbdb
from msbdb.cli.main import cli
from msbdb.database import check_database, open_database, read_build
from msbdb.tables import validate_parts

pytestmark = pytest.mark.nimes

TILE = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "msbdb" / "nimes.laz"
GOLDEN = Path(__file__).parents[1] / "golden" / "nimes.json"

ARENA = (809_359.0, 6_304_927.0)
"""Middle of the Roman arena: an ellipse of 133 m by 101 m around a floor of 68 m by 38 m, in Lambert-93."""

RISE_DEG = 30.0
"""From east to the ellipse's long axis, counter-clockwise."""


@pytest.fixture(scope="module")
def nimes(tmp_path_factory):
    """Return the database of the tile by the default profile."""
    if not TILE.is_file():
        pytest.skip(f"{TILE} is not there; scripts/fetch_nimes brings it")
    db = tmp_path_factory.mktemp("nimes") / "nimes.sqlite"
    msbdb.build([TILE], db=db, crs="EPSG:2154")
    return db


def ellipse(long_m, short_m):
    """Return an ellipse around the middle of the arena, by its whole axes."""
    disc = shapely.Point(0, 0).buffer(0.5, quad_segs=32)
    turned = shapely.affinity.rotate(shapely.affinity.scale(disc, long_m, short_m), RISE_DEG, origin=(0, 0))
    return shapely.affinity.translate(turned, *ARENA)


def numbers(db):
    """Sum up a database in numbers that a person can follow."""
    engine = open_database(db)
    build = read_build(engine)
    engine.dispose()
    parts, buildings, lost = (build.frames[name] for name in ("part", "building", "rejection_count"))
    scales = build.frames["scale"].set_index("scale")["threshold_m2"]
    edges = parts[parts["supid"] != 0].groupby(["supscale", "scale"]).size()
    names = lost["method"].map({"multiscale": "", "flatregions": "flat "}).fillna(lost["method"] + " ") + lost["stage"]
    ledger = lost.groupby(names)[["regions", "area_m2"]].sum()
    return {
        "cell_m": build.survey.cell_m,
        "density": round(build.survey.density, 3),
        "buildings": len(buildings),
        "footprint_m2": round(float(buildings["area_m2"].sum()), 1),
        "volume_m3": round(float(buildings["volume_m3"].sum())),
        "highest_m": round(float(buildings["h_max"].max()), 2),
        "parts_by_threshold_m2": {f"{scales[k]:g}": int(n) for k, n in parts.groupby("scale").size().items()},
        "edges_by_thresholds_m2": {f"{scales[a]:g} > {scales[b]:g}": int(n) for (a, b), n in edges.items()},
        "rejected_by_stage": {
            str(k): [int(row["regions"]), round(float(row["area_m2"]), 1)] for k, row in ledger.iterrows()
        },
    }


def flat(values, prefix=""):
    """Yield the leaves of nested values by their paths."""
    if isinstance(values, dict):
        for name, value in values.items():
            yield from flat(value, f"{prefix}/{name}")
    elif isinstance(values, list):
        for number, value in enumerate(values):
            yield from flat(value, f"{prefix}/{number}")
    else:
        yield prefix, values


def test_the_numbers_are_those_that_were_looked_at(nimes):
    """Counts are equal; areas, volumes and heights agree to a thousandth."""
    found = numbers(nimes)
    if os.environ.get("MSBDB_REGEN"):
        GOLDEN.parent.mkdir(exist_ok=True)
        GOLDEN.write_text(json.dumps(found, indent=2, ensure_ascii=False) + "\n", encoding="utf-8")
    expected = dict(flat(json.loads(GOLDEN.read_text(encoding="utf-8"))))
    assert dict(flat(found)) == pytest.approx(expected, rel=1e-3)


def test_what_all_detectors_decide_is_sound(nimes):
    """Counts, links and forest of parts inside the cells of all detectors are as the check asks."""
    engine = open_database(nimes)
    assert check_database(engine) == []
    engine.dispose()


def test_the_command_line_tells_the_same(nimes):
    """``msbdb info --json`` gives the counts of the tables, and no notice of missing colours or echoes."""
    done = CliRunner().invoke(cli, ["info", str(nimes), "--json"])
    assert done.exit_code == 0, done.output
    run = json.loads(done.stdout)["runs"][0]
    expected = numbers(nimes)
    assert run["survey"] == "nimes"
    assert run["epsg"] == 2154
    assert run["buildings"] == expected["buildings"]
    assert run["parts"] == sum(expected["parts_by_threshold_m2"].values())
    assert run["rejected"] == sum(count for count, _ in expected["rejected_by_stage"].values())
    assert run["footprint_m2"] == expected["footprint_m2"]
    assert not any("no imagery" in notice or "no echo" in notice for notice in run["notices"])


def test_the_forest_of_a_real_town_is_sound(nimes):
    """Invariants (V33), valid outlines, heights in order, and no building under another."""
    with msbdb.open(nimes) as opened:
        parts, buildings, scales = opened.parts(), opened.buildings(), opened.scales()
    validate_parts(parts)
    assert shapely.is_valid(parts.geometry).all()
    assert (parts["h_p50"] <= parts["h_p90"]).all()
    assert (parts["h_p90"] <= parts["h_max"]).all()
    assert (parts["area_px"] >= scales["threshold_px"].min()).all()
    assert buildings.geometry.area.sum() == pytest.approx(shapely.union_all(buildings.geometry).area, rel=1e-3)
    assert buildings["storeys"].between(1, 25).all()


def test_the_arena_stands_where_it_stands(nimes):
    """The arena's ring is built, its floor is open, and its walls are the highest of it.

    The tiers step down from a wall of 21 m to the floor, and stay one building. It fills the ring, and hardly
    anything of it lies outside the ellipse.
    """
    with msbdb.open(nimes) as opened:
        buildings = opened.buildings()
    stone = ellipse(133, 101).difference(ellipse(72, 42))
    inside = shapely.area(shapely.intersection(buildings.geometry, ellipse(137, 105)))
    arena = buildings[inside > 0.9 * shapely.area(buildings.geometry)]
    built = shapely.union_all(buildings.geometry)
    assert arena["divided_by"].tolist() == [""]
    assert arena["area_m2"].sum() == pytest.approx(stone.area, rel=0.12)
    assert shapely.area(shapely.intersection(built, stone)) > 0.85 * stone.area
    assert shapely.area(shapely.intersection(built, ellipse(60, 32))) < 0.02 * ellipse(60, 32).area
    assert 19 < arena["h_max"].max() < 27
    assert arena["parts"].sum() >= 10


def test_a_park_is_no_quarter(nimes):
    """Of the esplanade and its trees beside the arena hardly anything is built."""
    with msbdb.open(nimes) as opened:
        buildings = opened.buildings()
    park = shapely.box(809_480, 6_304_865, 809_620, 6_304_960)
    built = shapely.area(shapely.intersection(buildings.geometry, park)).sum()
    assert built < 0.03 * park.area


@pytest.mark.long
def test_loading_twice_changes_nothing(nimes):
    """The same tile again is the same content."""
    with msbdb.open(nimes) as opened:
        before = opened.dump()
    report = msbdb.build([TILE], db=nimes, crs="EPSG:2154")
    with msbdb.open(nimes) as opened:
        after = opened.dump()
    assert not report.changed
    assert before == after
