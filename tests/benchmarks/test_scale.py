"""The measurement of large inventories, on two thousand buildings."""

import json
import os
import shutil
from types import ModuleType

import numpy as np
import pytest
import shapely
from simulated.builds import EVERY, small_build
from support.processes import BENCHMARKS, load_script, run_script

from msbdb.database import open_database, write_build
from msbdb.database.runs.checks import check_build
from msbdb.kept import KeptRun

SCRIPT = BENCHMARKS / "scale"
BUILDINGS = 2_000


@pytest.fixture(scope="module")
def script() -> ModuleType:
    """Return the script as a module."""
    return load_script(SCRIPT)


@pytest.fixture(scope="module")
def tile() -> KeptRun:
    """Return a small build."""
    return small_build()


def test_a_survey_of_copies_is_a_sound_build(script, tile):
    """As many rows as copies have, all keys their own, each outline at its place, and the tile itself as it was."""
    lattice = script.lattice_of(tile, 100)
    assert lattice.surveys * lattice.block[0] * lattice.block[1] * 4 >= 100
    before = shapely.to_wkb(np.asarray(tile.frames["building"]["geometry"]))
    surveys = [script.survey_of(script.thinned(tile, EVERY.split(",")), lattice, n) for n in range(lattice.surveys)]
    for survey in surveys:
        check_build(survey)
    ids = np.concatenate([survey.frames["part"]["part_id"] for survey in surveys])
    assert len(ids) == len(set(ids)) == len(surveys) * lattice.block[0] * lattice.block[1] * 6
    boxes = np.concatenate([shapely.bounds(np.asarray(s.frames["building"]["geometry"])) for s in surveys])
    assert len(np.unique(boxes, axis=0)) == len(boxes)
    np.testing.assert_allclose(boxes[:4] - boxes[4:8], [[-lattice.step[0], 0, -lattice.step[0], 0]] * 4)
    roots = surveys[0].frames["part"].set_index("part_id").loc[surveys[0].frames["building"]["building_id"]]
    shapes = np.asarray(surveys[0].frames["building"]["geometry"])
    assert shapely.intersects(shapes, shapely.points(roots["xin"], roots["yin"])).all()
    assert (shapely.to_wkb(np.asarray(tile.frames["building"]["geometry"])) == before).all()


def test_the_rows_of_some_extractors_are_a_sound_build(script, tile):
    """What the others gave is left out, their shares and links included."""
    few = script.thinned(tile, ["multiscale", "flatregions"])
    check_build(few)
    assert few.run.methods == ("flatregions", "multiscale")
    assert few.frames["building"]["area3d_share"].isna().all()
    assert few.frames["building"]["flat_share"].notna().all()
    assert len(few.frames["part_candidate"]) == len(few.frames["candidate_region"]) == 0
    assert len(few.frames["part_flat_region"]) == len(tile.frames["part_flat_region"])


def test_loads_in_turn_have_one_line_for_each_number_of_buildings(script):
    """A line has medians and the range of the ratios, and takes the place of the older one."""
    rows = {"building": 20_040, "part": 1_000}

    def figures(client: float, server: float) -> dict[str, object]:
        return {"rows": rows, "client_cpu_seconds": client, "server_cpu_seconds": server}

    rounds = [[figures(2.0, 3.0), figures(2.0, 2.0)], [figures(1.0, 3.0), figures(2.0, 2.0)]]
    line = script.turns_line(rounds)
    assert line == "| 20 040 | 21 040 | 2 | 1.5 | 3.0 | 2.0 | 2.0 | 1.12 (1.00 to 1.25) |"
    page = f"Before\n\n{script.HEAD}\n|---|\n| 20 040 | old |\n| 100 200 | kept |\n\nAfter\n"
    assert script.with_line(page, line) == page.replace("| 20 040 | old |", line)


@pytest.mark.campaign
@pytest.mark.postgis
@pytest.mark.skipif(not shutil.which("ogr2ogr"), reason="ogr2ogr is not installed")
def test_two_thousand_buildings(tile, tmp_path):
    """All rows arrive by each way, local questions scan no big table, and a rebuild touches its own rows alone."""
    server = os.environ.get("MSBDB_TEST_POSTGIS")
    if not server:
        pytest.skip("MSBDB_TEST_POSTGIS names no PostGIS server")
    source = tmp_path / "tile.sqlite"
    write_build(open_database(source, create=True, srid=tile.survey.epsg), tile)
    done = run_script(SCRIPT, "--buildings", BUILDINGS, "--source", source, "--db", server, "--copy", "--json")
    assert done.returncode == 0, done.stderr
    figures = json.loads(done.stdout)
    own, plain, same, copied = figures["loading"].values()
    assert own["rows"]["building"] >= BUILDINGS
    assert own["rows"]["part"] == 1.5 * own["rows"]["building"]
    assert plain["rows"] == same["rows"] == copied["rows"] == own["rows"]
    assert all(one["rows_per_second"] > 0 and one["server_cpu_seconds"] >= 0 for one in figures["loading"].values())
    local = {name: one for name, one in figures["queries"].items() if one["local"]}
    assert len(local) >= 10
    assert not [name for name, one in local.items() if one["scanned"]]
    for name in ("building_at_point", "close_neighbours", "tall_buildings_near"):
        assert "idx_building_geometry" in local[name]["indexes"]
    again = figures["rebuild"]
    assert again["status"] == "replaced"
    assert again["others_untouched"]
    assert again["only_own_rows"]
    assert again["inserted_updated_deleted"]["part"] == [again["rows"]["part"], 0, again["rows"]["part"]]
    assert {shape: set(methods) for shape, methods in figures["indexes"].items()} == {
        shape: {"gist", "spgist"} for shape in figures["indexes"]
    }


def test_wrong_arguments_are_explained():
    """Before any work is done."""
    done = run_script(SCRIPT, "--buildings", 0)
    assert done.returncode == 2
    assert "at least one building" in done.stderr
