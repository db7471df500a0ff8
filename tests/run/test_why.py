"""``msbdb why`` on places whose answer is known: simulated ones, places of Nîmes, and the law of the ledger."""

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from simulated.files import write_points
from simulated.scenes import DATUM_M, ORIGIN, Block, Tree, World, scan

import msbdb
from msbdb.cli.main import cli
from msbdb.database import Place, check_database, explain_places, open_database, read_build
from msbdb.errors import InputError
from msbdb.tables import Reason

POND = (70, 10, 20, 15)
"""West, south, width and depth of water, from which no echo comes back."""

WORLD = World(
    "places",
    blocks=(
        Block("house", 20, 55, 15, 12, DATUM_M + 6.5, 1),
        Block("hall", 50, 55, 30, 20, DATUM_M + 9.5, 2, material="metal"),
        Block("lawn hall", 10, 80, 25, 15, DATUM_M + 8.0, 3, material="gravel", lawn_rim_m=2.0),
        Block("hut", 45, 30, 2, 2, DATUM_M + 3.0, kind="wall", material="metal"),
        Block("van", 55, 30, 5, 2, DATUM_M + 1.8, kind="wall", material="metal"),
        Block("wall", 10, 47, 80, 0.5, DATUM_M + 3.0, kind="wall", material="concrete"),
    ),
    trees=(
        Tree(15, 15, 4.5, 12.0, 3.0),
        *(Tree(26 + 7.0 * (n % 3), 10 + 6.5 * (n // 3), 3.8, 10.0 + n % 4, 2.5) for n in range(6)),
        Tree(35.0, 67.0, 4.5, 14.0, 5.0),
    ),
    roads=((0, 28, 100, 8),),
)

KNOWN = {
    "a house": ((27, 61), Reason.BUILDING),
    "a hall": ((65, 65), Reason.BUILDING),
    "a roof with a lawn": ((22, 87), Reason.BUILDING),
    "a tree": ((15, 15), Reason.VEGETATION_BY_STRUCTURE),
    "a grove": ((33, 10), Reason.VEGETATION_BY_STRUCTURE),
    "a crown beside a house": ((37.5, 69), Reason.VEGETATION_BY_STRUCTURE),
    "a hut of 4 m2": ((46, 31), Reason.SMALL),
    "a van of 1.8 m": ((57.5, 31), Reason.LOW),
    "a road": ((20, 32), Reason.LOW),
    "a meadow": ((90, 85), Reason.LOW),
    "the middle of a pond": ((80, 17.5), Reason.NO_DATA),
}
"""The simulated places: local east and north, metres, and the answer."""


def world_place(local):
    """Return easting and northing of a local place."""
    return ORIGIN[0] + local[0], ORIGIN[1] + local[1]


@pytest.fixture(scope="module")
def simulated(tmp_path_factory):
    """Return the database of the simulated places."""
    folder = tmp_path_factory.mktemp("why")
    points = scan(WORLD, seed=3, density=6.0).points
    west, south = world_place(POND[:2])
    wet = (points.x > west) & (points.x < west + POND[2]) & (points.y > south) & (points.y < south + POND[3])
    msbdb.build([write_points(folder / "places.laz", points.take(np.flatnonzero(~wet)))], db=folder / "places.sqlite")
    return folder / "places.sqlite"


@pytest.fixture(scope="module")
def answers(simulated):
    """Return what the run says of all known places."""
    engine = open_database(simulated)
    found = explain_places(engine, [world_place(local) for local, _ in KNOWN.values()])
    engine.dispose()
    return dict(zip(KNOWN, found, strict=True))


@pytest.mark.parametrize("name", KNOWN)
def test_each_simulated_place_has_its_known_answer(answers: dict[str, Place], name):
    """Roofs, crowns, small and low things, ground and water, each for its own reason."""
    place, (_, reason) = answers[name], KNOWN[name]
    assert place.reason == reason, place.sentences
    assert (place.building is not None) == (reason == Reason.BUILDING)
    assert place.sentences[0].startswith("Building" if reason == Reason.BUILDING else "No building")
    assert [one.method for one in place.detectors] == ["multiscale", "flatregions", "area3d", "adaptive"]


def test_an_answer_has_heights_and_each_detector(answers):
    """All detectors take the hall for a building; of the tree they say why they do not, with its row in the ledger."""
    hall, tree, pond = answers["a hall"], answers["a tree"], answers["the middle of a pond"]
    assert hall.height_m == pytest.approx(9.5, abs=0.2)
    assert hall.building is not None
    assert hall.building["area_m2"] == pytest.approx(600, rel=0.05)
    assert all(one.supports and not one.reason for one in hall.detectors)
    said = {one.method: one for one in tree.detectors}
    assert not any(one.supports for one in tree.detectors)
    assert said["adaptive"].stage == "vegetation"
    assert said["adaptive"].area_m2 == pytest.approx(np.pi * 4.5**2, rel=0.2)
    assert said["adaptive"].rejection_at == pytest.approx(world_place((15, 15)), abs=1)
    assert pond.height_m is None


def test_the_command_says_the_same(simulated, answers):
    """In sentences, as JSON, and for a place in longitude and latitude."""
    east, north = world_place(KNOWN["a tree"][0])
    run = CliRunner().invoke
    plain = run(cli, ["why", str(simulated), "--at", f"{east},{north}"])
    assert plain.exit_code == 0, plain.output
    assert plain.stdout.splitlines()[1:] == answers["a tree"].sentences
    done = json.loads(run(cli, ["why", str(simulated), "--at", f"{east},{north}", "--json"]).stdout)
    assert (done["reason"], done["survey"]) == ("vegetation_by_structure", "places")
    assert done["detectors"][3]["stage"] == "vegetation"
    with msbdb.open(simulated) as opened:
        crs = opened.buildings().crs
    from pyproj import Transformer

    lon, lat = Transformer.from_crs(crs, 4326, always_xy=True).transform(east, north)
    there = msbdb.why(simulated, lon, lat, crs="EPSG:4326")
    assert (there.reason, there.easting) == (Reason.VEGETATION_BY_STRUCTURE, pytest.approx(east, abs=0.01))


@pytest.mark.parametrize("place", [(-500.0, 50.0), (50.0, 5000.0), (float("nan"), 50.0)])
def test_a_place_outside_of_the_survey_is_refused(simulated, place):
    """The error has the survey's extent; the command ends with 1."""
    east, north = world_place(place)
    with pytest.raises(InputError, match=r"is outside of the survey 'places', which covers eastings"):
        msbdb.why(simulated, east, north)
    done = CliRunner().invoke(cli, ["why", str(simulated), f"--at={east},{north}"])
    assert done.exit_code == 1
    assert "is outside of the survey 'places'" in done.stderr
    assert CliRunner().invoke(cli, ["why", str(simulated), "--at", "here"]).exit_code == 2


def test_a_roof_that_an_operator_takes_away_says_so(simulated, tmp_path):
    """Roofs' classes labelled other, or vegetation, are the reason; labelled building again, the hall is back."""
    db = Path(tmp_path / "labels.sqlite")
    db.write_bytes(simulated.read_bytes())
    hall = world_place(KNOWN["a hall"][0])
    with msbdb.open(db) as opened:
        classes = opened.classes()
    roofs = classes.loc[classes["label"] == "building", "speindex"].tolist()
    told = {}
    for label in ("other", "vegetation", "building"):
        msbdb.relabel(db, dict.fromkeys(roofs, label))
        told[label] = msbdb.why(db, *hall).reason
    assert told == {
        "other": Reason.OTHER_CLASS,
        "vegetation": Reason.VEGETATION_BY_COLOUR,
        "building": Reason.BUILDING,
    }
    assert msbdb.why(db, *world_place(KNOWN["a tree"][0])).detectors[3].stage == "vegetation"
    engine = open_database(db)
    assert check_database(engine) == []
    engine.dispose()


def test_the_raster_of_reasons_agrees_with_the_tables(simulated):
    """Buildings' cells say building, low and unknown ones their own; each detector's answer is of its ledger."""
    engine = open_database(simulated)
    build = read_build(engine)
    engine.dispose()
    rasters, frames = build.rasters, build.frames
    reason, buildings = rasters.reason, frames["building"]
    assert reason is not None
    assert rasters.support is not None
    area_m2 = build.survey.cell_m**2
    assert (reason == Reason.BUILDING).sum() * area_m2 == pytest.approx(buildings["area_m2"].sum())
    spec = build.heights.spec
    inside = spec.sample(reason, buildings["xin"].to_numpy(), buildings["yin"].to_numpy(), outside=0)
    assert set(inside.tolist()) == {Reason.BUILDING}
    high = rasters.valid & (rasters.heights_cm >= 200)
    assert ((reason == Reason.NO_DATA) == (~rasters.valid & (reason != Reason.BUILDING))).all()
    assert (high[reason == Reason.LOW] == 0).all()
    assert not np.isin(reason[high], (Reason.LOW, Reason.NO_DATA)).any()
    counts = frames["rejection_count"]
    for method, cells in rasters.answers.items():
        known = counts.loc[counts["method"] == method].set_index("number")
        assert set(np.unique(cells)) - {0} <= set(known.index)
        if method == "flatregions":
            for number, row in known.iterrows():
                # What a later stage dropped again is marked by its reason.
                assert (cells == number).sum() * area_m2 <= row["area_m2"] + 1e-6
            assert (cells == known.index.max()).sum() * area_m2 == pytest.approx(known["area_m2"].iloc[-1])


def test_every_row_of_the_ledger_is_where_its_raster_says_so(simulated):
    """Around the middle of each dropped region there are cells with its stage and reason, or a later stage's."""
    engine = open_database(simulated)
    build = read_build(engine)
    engine.dispose()
    counts, rows, spec = build.frames["rejection_count"], build.frames["rejection"], build.heights.spec
    east, north = spec.centres()
    kind = ["method", "stage", "reason"]
    number = rows.merge(counts[[*kind, "number"]], on=kind)["number"]
    assert len(number) == len(rows) > 5
    for row, own in zip(rows.itertuples(), number, strict=True):
        if row.method in build.rasters.answers:
            near = np.hypot(east - row.xcen, north - row.ycen) <= max(1.0, row.area_m2**0.5)
            assert (build.rasters.answers[row.method][near] >= own).any(), row


TILE = Path.home() / ".cache" / "msbdb" / "nimes.laz"

NIMES = {
    "the ring of the arena, west": ((809_306.7, 6_304_942.5), Reason.BUILDING),
    "the ring of the arena, east": ((809_411.0, 6_304_935.0), Reason.BUILDING),
    "the floor of the arena": ((809_361.0, 6_304_927.0), Reason.LOW),
    "a block of the old town, north-west": ((809_324.7, 6_305_032.5), Reason.BUILDING),
    "a block of the old town, north": ((809_534.7, 6_305_026.5), Reason.BUILDING),
    "the triangular block": ((809_462.7, 6_304_852.5), Reason.BUILDING),
    "trees beside the arena": ((809_330.7, 6_305_002.5), Reason.VEGETATION_BY_STRUCTURE),
    "trees of the esplanade": ((809_528.7, 6_304_864.5), Reason.VEGETATION_BY_STRUCTURE),
    "trees of the avenue": ((809_618.7, 6_304_924.5), Reason.VEGETATION_BY_STRUCTURE),
    "the open esplanade": ((809_546.7, 6_304_906.5), Reason.LOW),
    "the corner without echoes": ((809_277.9, 6_305_059.5), Reason.NO_DATA),
}
"""Places of the real tile that were looked at, and the answer."""


@pytest.mark.long
@pytest.mark.nimes
def test_places_of_a_real_town_have_their_known_answers(tmp_path):
    """The Roman arena and its floor, blocks of the old town, crowns, open ground, and a corner without data."""
    if not TILE.is_file():
        pytest.skip(f"{TILE} is not there; scripts/fetch_nimes brings it")
    msbdb.build([TILE], db=tmp_path / "nimes.sqlite", crs="EPSG:2154")
    engine = open_database(tmp_path / "nimes.sqlite")
    found = explain_places(engine, [place for place, _ in NIMES.values()])
    engine.dispose()
    told = {name: place.reason for name, place in zip(NIMES, found, strict=True)}
    assert told == {name: reason for name, (_, reason) in NIMES.items()}
