"""Surveys of sensors that hardly split pulses in crowns, or measure heights roughly: what else decides there."""

from dataclasses import replace

import numpy as np
import pytest
from simulated import scenes
from simulated.files import write_points
from simulated.scenes import DATUM_M, ORIGIN, Block, Tree, World, scan

import msbdb
from msbdb.grid import Grid, lattice
from msbdb.params import Params, with_values
from msbdb.points.cloud import PointCloud
from msbdb.run.preparation import samples
from msbdb.run.preparation.drafts import build_surface
from msbdb.run.preparation.pointfacts import with_facts
from msbdb.run.preparation.prepare import FEW_ECHOES, NO_ECHOES, PART_ECHOES
from msbdb.surface import cover_from_surface, crown_cells, crown_split, recorded_echoes, structural_cover, texture_of
from msbdb.surface.structure import ROOF, VEGETATION
from msbdb.surface.texture import Echoes, Texture
from msbdb.surveyplan import USUAL_SPLIT, Plan

PARAMS = with_values(Params(), {"surface": {"cell_m": 0.5}})


def weaker(points: PointCloud, share: float) -> PointCloud:
    """Return points where a share of the pulses keeps its later echoes; a scene lists its echoes pulse by pulse."""
    first = points.first_echo
    drawn = (np.random.default_rng(3).random(np.count_nonzero(first)) < share)[np.cumsum(first) - 1]
    of = np.where(drawn, points.number_of_returns, 1).astype(np.uint8)
    return replace(points, number_of_returns=of).take(first | drawn)


@pytest.fixture(scope="module")
def grove():
    """Return a house among trees, by a sensor of several echoes."""
    return scenes.under_trees()


@pytest.mark.parametrize("share", [1.0, 0.5, 0.1, 0.0])
def test_crowns_are_no_roofs_whatever_share_of_the_pulses_is_split(grove, share):
    """With full trust nine in ten cells of crowns pass for roofs where a tenth of the pulses keeps its later echoes."""
    points = weaker(grove.points, share)
    surface = build_surface(points, PARAMS)
    texture = texture_of(surface, points, PARAMS)
    facts, splits = with_facts(points, 0.0).facts, crown_cells(texture, PARAMS.cover)
    known = replace(facts, crown_split=None if splits is None else crown_split([splits]))
    assert known.most_trust == pytest.approx(share, abs=0.15)
    spec = surface.dsm.spec
    row, col = spec.rowcol(*grove.spec.xy(*np.indices(grove.spec.shape)))
    inside = spec.inside(row, col)
    crowns = inside & (grove.cover == scenes.VEGETATION) & (grove.buildings == 0)
    roofs = inside & (grove.cover != scenes.VEGETATION) & (grove.buildings > 0)

    def built(survey):
        cover = structural_cover(texture, survey, PARAMS.cover).cover.labelled("building")
        return [cover[row[cells], col[cells]].mean() for cells in (crowns, roofs)]

    false, true = built(known)
    assert false < 0.1
    assert true > 0.95
    if share == 0.1:
        assert built(facts)[0] > 0.7


def structure_of(heights, rough_m, splits, trusts):
    """Return the structure of heights above ground on cells of 0.5 m, with the trust of each class of height.

    The shares of split pulses are those of the cells, of the best small window and of the wide one.
    """
    rows, cols = heights.shape
    spec = lattice((0, 0, (cols - 1) / 2, (rows - 1) / 2), 0.5, scenes.UTM33)
    rough, *shares = (np.broadcast_to(np.float32(each), spec.shape) for each in (rough_m, *splits, 1.0))
    ndsm = Grid(heights, np.ones(spec.shape, dtype=bool), spec)
    texture = Texture(ndsm, rough, rough, Echoes(*shares), 2.0)
    facts = with_facts(scenes.flat_field().points, 0.0).facts
    known = replace(facts, echoes=True, crown_split=tuple(trust * USUAL_SPLIT for trust in trusts))
    return structural_cover(texture, known, PARAMS.cover)


def cover_of(heights, rough_m, split, trusts):
    """Return the cover by `structure_of`, with one share of split pulses in all windows."""
    return structure_of(heights, rough_m, (split,) * 3, trusts).cover.index


def blocks_of(*blocks, shape=(40, 80)):
    """Return heights above ground with blocks on them: rows, columns and the height of each, metres."""
    heights = np.zeros(shape, dtype=np.float32)
    for rows, cols, height in blocks:
        heights[slice(*rows), slice(*cols)] = height
    return heights


@pytest.mark.parametrize("trust", [0.0, 0.3, 1.0])
@pytest.mark.parametrize(("rough_m", "split", "always"), [(0.02, 0.0, ROOF), (0.4, 0.7, VEGETATION), (0.4, 0.0, None)])
def test_trust_decides_only_what_is_rough_and_not_split(trust, rough_m, split, always):
    """A smooth block is a roof, and one whose echoes are split on a rough surface a crown, whatever the sensor."""
    heights = blocks_of(((10, 30), (10, 30), 6.0))
    found = cover_of(heights, rough_m, np.where(heights > 0, split, 0), (trust,) * 6)[heights > 0]
    assert set(found) == {always or (ROOF if trust == 1 else VEGETATION)}


@pytest.mark.parametrize(("trust", "split", "kind"), [(0.2, 0.04, ROOF), (0.2, 0.2, VEGETATION), (1.0, 0.04, ROOF)])
def test_the_fewer_pulses_a_sensor_splits_the_more_they_count(trust, split, kind):
    """A hardly rough block, of which a weak sensor splits a fifth of what it splits in crowns, or all of that."""
    heights = blocks_of(((10, 30), (10, 30), 6.0))
    found = cover_of(heights, 0.1, np.where(heights > 0, split, 0), (trust,) * 6)[heights > 0]
    assert set(found) == {kind}


@pytest.mark.parametrize("window", [1, 2])
def test_half_of_the_trust_doubles_the_log_odds_of_split_pulses(window):
    """In the best small window and in the wide one, each by itself."""
    heights, lost = blocks_of(((10, 30), (10, 30), 6.0)), []
    for trust in (1.0, 0.5):
        odds = []
        for split in (0.0, 0.1):
            splits = [split if number == window else 0.0 for number in range(3)]
            roof = structure_of(heights, 0.2, splits, (trust,) * 6).roof_probability[20, 20]
            odds.append(np.log(roof / (1 - roof)))
        lost.append(odds[0] - odds[1])
    assert lost[0] > 0.3
    assert lost[1] == pytest.approx(2 * lost[0], rel=1e-3)


@pytest.mark.parametrize(("share", "kind"), [(0.0, ROOF), (0.03, ROOF), (0.12, VEGETATION)])
def test_regions_are_judged_by_what_a_strong_sensor_would_have_split(share, kind):
    """Three tenths of a block are smooth: enough for half of the trust and few split pulses, not for an eighth."""
    heights = blocks_of(((10, 30), (10, 30), 6.0))
    rough = np.full(heights.shape, 0.2)
    rough[10:16] = 0.02
    assert set(structure_of(heights, rough, (share, 0.0, 0.0), (0.5,) * 6).cover.index[heights > 0]) == {kind}


def test_trust_goes_by_the_height_above_ground():
    """By a sensor that separates echoes 5 m apart, a rough low block of single echoes is a hedge, a high one a roof."""
    heights = blocks_of(((10, 30), (10, 30), 2.5), ((10, 30), (50, 70), 9.0))
    found = cover_of(heights, 0.4, 0.0, (0, 0, 0, 1, 1, 1))
    assert [set(found[heights == height]) for height in (2.5, 9.0)] == [{VEGETATION}, {ROOF}]


@pytest.mark.parametrize(("trust", "rows"), [(0.0, 12), (0.4, 7), (0.8, 3), (1.0, 0)])
def test_the_less_echoes_are_trusted_the_more_of_a_roof_must_be_smooth(trust, rows):
    """Half of its cells without any trust, and none with all of it; other rows are nearly as rough as leaves."""
    heights = blocks_of(((10, 30), (10, 30), 6.0))
    for smooth, kept in ((rows, True), (rows - 3, False)):
        if smooth >= 0:
            rough = np.full(heights.shape, 0.2)
            rough[10 : 10 + smooth] = 0.02
            found = cover_of(heights, rough, 0.0, (trust,) * 6)[heights > 0]
            assert set(found) == {ROOF if kept else VEGETATION}


@pytest.mark.parametrize(("trust", "joined"), [(0.0, False), (1.0, True)])
def test_necks_of_roofs_may_be_thinner_where_echoes_are_trusted(trust, joined):
    """Two houses and what joins them, 1.5 m wide: below 2 m a hedge without echoes, with them only below 1.2 m."""
    heights = blocks_of(((10, 30), (10, 30), 6.0), ((10, 30), (50, 70), 6.0), ((18, 21), (30, 50), 6.0))
    found = cover_of(heights, 0.02, 0.0, (trust,) * 6)
    assert (found[19, 20], found[19, 60]) == (ROOF, ROOF)
    assert (found[19, 40] == ROOF) == joined


def test_the_share_that_crowns_split_is_a_mean_over_all_blocks():
    """Of no cell it is unknown. By height it is that of all blocks together, and never falls as crowns get higher."""
    none = np.zeros((2, 0), dtype=np.float32)
    assert crown_split([]) is crown_split([none]) is None
    shares = np.linspace(0, 1, 401, dtype=np.float32)
    low, high = (np.stack([np.full_like(shares, height), shares * most]) for height, most in ((2.5, 0.2), (20.0, 0.5)))
    found = crown_split([low, high])
    assert found == pytest.approx((0.1, 0.175, 0.175, 0.175, 0.175, 0.25))  # without a cell: as all
    assert crown_split([low[:, ::2], high, low[:, 1::2]]) == found
    falling = crown_split([np.stack([22.5 - low[0], low[1]]), np.stack([22.5 - high[0], high[1]])])
    assert falling == pytest.approx((0.175,) * 6)


@pytest.mark.parametrize(
    ("most", "split"), [(0.6, 0.06), (0.75, USUAL_SPLIT / 2), (0.9, USUAL_SPLIT), (1.0, USUAL_SPLIT)]
)
def test_a_sensor_is_strong_where_some_crowns_split_nearly_all_pulses(most, split):
    """One rough cell in ten is a crown, and the others are roofs: a weak sensor splits most pulses nowhere."""
    cells = np.stack([np.full(1000, 9.0), np.where(np.arange(1000) < 101, most, 0.0)])
    assert crown_split([cells]) == pytest.approx((split,) * 6, abs=1e-3)


def test_the_facts_of_the_points_give_the_trust_in_single_echoes(grove, tmp_path):
    """In full from 0.55 of the pulses on, in proportion below, and not at all without echoes; an older plan trusts."""
    plan = msbdb.plan(write_points(tmp_path / "grove.laz", grove.points))
    assert min(plan.points.crown_split) >= 0.4
    assert "crowns split" in plan.pairs()
    heights = np.array([2.0, 4.5, 50.0])
    for split, trust in ((None, 1.0), (0.9, 1.0), (0.55, 1.0), (0.22, 0.4), (0.0, 0.0)):
        facts = replace(plan.points, crown_split=None if split is None else (split,) * 6)
        for each in (facts, replace(grove.points, facts=facts)):
            assert each.most_trust == pytest.approx(trust)
            np.testing.assert_allclose(each.echo_trust(heights), trust, rtol=1e-6)
    # A sensor that separates echoes 5 m apart: low crowns give single ones.
    apart = replace(plan.points, crown_split=(0.0, 0.11, 0.22, 0.55, 0.8, 0.8))
    np.testing.assert_allclose(apart.echo_trust(heights), [0, 0.4, 1], rtol=1e-6)
    assert apart.most_trust == 1
    assert replace(plan.points, echoes=False).most_trust == 0
    assert grove.points.most_trust == 1
    assert weaker(grove.points, 0).most_trust == 0
    kept = plan.as_dict()
    del kept["points"]["crown_split"]
    assert Plan.from_dict(kept).points == replace(plan.points, crown_split=None)
    # The digest of a run counts the text of its plan, so that an older one keeps it.
    assert Plan.from_dict(kept).as_dict() == kept
    assert Plan.from_dict(plan.as_dict()) == plan


def test_all_detectors_find_the_house_and_no_crown(grove, tmp_path):
    """By a sensor that splits a tenth of its pulses: the house alone is confirmed, and a notice gives the reason."""
    notices = []
    for share in (1.0, 0.1, 0.0):
        db = tmp_path / f"{share:g}.sqlite"
        report = msbdb.build(write_points(tmp_path / f"{share:g}.laz", weaker(grove.points, share)), db=db)
        houses = msbdb.open(db).buildings()
        confirmed = houses[houses["state"] == "confirmed"]
        assert len(confirmed) == 1
        assert confirmed["area_m2"].iloc[0] == pytest.approx(192, rel=0.15)
        assert houses["area_m2"].sum() < 250
        notices.append([each for each in report.notices if each in (FEW_ECHOES, NO_ECHOES)])
    assert notices == [[], [FEW_ECHOES], [NO_ECHOES]]


@pytest.mark.parametrize("planned_from", ["all", "blocks", "blocks of a wide cloud"])
def test_tiles_and_a_plan_of_blocks_trust_as_the_whole(planned_from, monkeypatch, tmp_path):
    """A tile without a crown knows the share from the plan: the database is that of one piece.

    A large survey in one piece has the share from a sample of blocks, and takes it before it tells roofs from crowns;
    so has one whose points lie in two corners of a lattice that is too wide, which no header tells.
    """
    points = weaker(scenes.under_trees(density=6.0).points, 0.2)
    if planned_from != "all":
        monkeypatch.setattr(samples, "BLOCK_M", 40.0)
        monkeypatch.setattr(samples, "LEAST_BLOCK_M", 20.0)
    if planned_from == "blocks":
        monkeypatch.setattr(samples, "MOST_POINTS", 12_000)
    elif planned_from == "blocks of a wide cloud":
        fields = points.arrays()
        moved = {name: np.append(fields[name], fields[name] + 400 * (name != "z")) for name in "xyz"}
        points = replace(points, **{name: np.append(each, each, axis=0) for name, each in fields.items()} | moved)
        monkeypatch.setattr(samples, "MOST_BYTES", samples.bytes_to_plan(len(points), 300.0**2, 0.4, Params()))
    file = write_points(tmp_path / "town.laz", points)
    plan, found = msbdb.plan(file), []
    assert bool(plan.blocks) == (planned_from != "all")
    assert 0 < plan.points.most_trust < 0.5
    for name, tile in (("whole", None), ("tiles", 50.0)):
        db = tmp_path / f"{name}.sqlite"
        assert FEW_ECHOES in msbdb.build(file, db=db, survey="town", tile=tile).notices
        houses = msbdb.open(db).buildings().sort_values("building_id")
        found.append([*zip(houses["building_id"], houses["state"], houses.geometry.to_wkb(), strict=True)])
    assert found[0] == found[1]


@pytest.mark.parametrize(("share", "houses"), [(1.0, 2), (0.1, 3), (0.0, 3)])
def test_colours_help_where_single_echoes_are_hardly_trusted(share, houses, tmp_path):
    """A roof as rough as a crown has the colour of smooth ones. Where the echoes are trusted they decide alone."""
    blocks = (
        Block("hall", 44, 44, 34, 34, DATUM_M + 12.5, 1),
        Block("rough", 15, 20, 14, 12, DATUM_M + 6.5, 2),
        Block("smooth", 90, 12, 12, 14, DATUM_M + 6.5, 3),
    )
    trees = tuple(Tree(8.0 + 10 * n, y, 3.5, 9.0 + n % 3, 2.5) for y in (36.0, 100.0) for n in range(11))
    points = scan(World("town", (120, 120), blocks, trees)).points
    (west, south), inside = ORIGIN, points.z > DATUM_M + 5
    inside &= (points.x - west > 15) & (points.x - west < 29) & (points.y - south > 20) & (points.y - south < 32)
    points = replace(points, z=points.z + inside * np.random.default_rng(2).normal(0, 0.4, len(points)))
    db = tmp_path / "town.sqlite"
    msbdb.build(write_points(tmp_path / "town.laz", weaker(points, share)), db=db, extract="multiscale")
    assert len(msbdb.open(db).buildings()) == houses


@pytest.mark.parametrize("noise_m", [0.0, 0.25])
def test_noise_of_the_heights_blinds_no_detector(noise_m, tmp_path):
    """Noise looks like leaves to the detectors on points, but bare ground shows how much of it there is."""
    points = scenes.city(density=9.0).points
    points = replace(points, z=points.z + np.random.default_rng(5).normal(0, noise_m, len(points)))
    db = tmp_path / "town.sqlite"
    msbdb.build(write_points(tmp_path / "town.laz", points), db=db)
    houses = msbdb.open(db).buildings()
    confirmed = houses[houses["state"] == "confirmed"]
    assert len(confirmed) >= 15
    for method in ("area3d", "adaptive"):
        assert confirmed[f"{method}_share"].mean() > 0.7


def half_recorded(share):
    """Return points of a grove, by a sensor of several echoes, west of it another one of which is weaker."""
    points = scenes.under_trees(density=6.0).points
    west = weaker(points, share)
    west = replace(west, x=west.x - 100)
    both = {name: np.append(each, getattr(points, name), axis=0) for name, each in west.arrays().items()}
    return replace(points, **both)


@pytest.mark.parametrize("share", [0.0, 0.05])
def test_crowns_of_a_weaker_sensor_are_no_roofs_beside_those_of_another(grove, share):
    """Where the other part shows that crowns are split, most cells of the crowns would be roofs in both."""
    points = half_recorded(share)
    facts = replace(with_facts(points, 0.0).facts, crown_split=(USUAL_SPLIT,) * 6)
    points = replace(points, facts=facts)
    surface = build_surface(points, PARAMS)
    found = cover_from_surface(surface, points, PARAMS)
    alone = structural_cover(texture_of(surface, points, PARAMS), facts, PARAMS.cover)
    spec = surface.dsm.spec
    x, y = grove.spec.xy(*np.indices(grove.spec.shape))
    crowns = (grove.cover == scenes.VEGETATION) & (grove.buildings == 0)
    houses = (grove.cover != scenes.VEGETATION) & (grove.buildings > 0)
    far = x < ORIGIN[0] + 50  # from the border, across which squares know both

    def roofs(structure, cells, aside_m=100):
        row, col = spec.rowcol(x[cells] - aside_m, y[cells])
        inside = spec.inside(row, col)
        return structure.cover.labelled("building")[row[inside], col[inside]].mean()

    assert roofs(alone, crowns & far) > 0.5
    assert roofs(found, crowns & far) < 0.1
    assert roofs(found, crowns, 0) < 0.1
    assert min(roofs(found, houses), roofs(found, houses, 0)) > 0.95


def test_tiles_of_two_sensors_are_as_the_whole(tmp_path):
    """What is recorded around a place is known in each window; a notice gives the reason."""
    file, found = write_points(tmp_path / "two.laz", half_recorded(0.05)), []
    for name, tile in (("whole", None), ("tiles", 50.0)):
        db = tmp_path / f"{name}.sqlite"
        assert PART_ECHOES in msbdb.build(file, db=db, survey="two", tile=tile).notices
        houses = msbdb.open(db).buildings().sort_values("building_id")
        assert len(houses[houses["state"] == "confirmed"]) == 2
        found.append([*zip(houses["building_id"], houses["state"], houses.geometry.to_wkb(), strict=True)])
    assert found[0] == found[1]


def rough_town(share, *, east_split=0.6):
    """Return the texture of rough cells all over, of which the western half splits another share of its pulses."""
    heights = np.full((200, 400), 6.0, dtype=np.float32)
    spec = lattice((450_000.0, 5_400_000.0, 450_399.0, 5_400_199.0), 1.0, scenes.UTM33)
    split = np.full(spec.shape, east_split, dtype=np.float32)
    split[:, :200] = share
    rough = np.full(spec.shape, 0.6, dtype=np.float32)
    ndsm = Grid(heights, np.ones(spec.shape, dtype=bool), spec)
    return Texture(ndsm, rough, rough, Echoes(split, split, split, 1 - split), 2.0)


@pytest.mark.parametrize(("share", "west"), [(0.0, 0.0), (0.06, 0.5), (0.12, 1.0), (0.3, 1.0)])
def test_echoes_count_as_recorded_as_far_as_rough_cells_split_pulses(share, west):
    """In full from 0.12 of the pulses on; in part below; and as there where nothing is rough."""
    facts = replace(with_facts(scenes.flat_field().points, 0.0).facts, echoes=True, crown_split=(0.4,) * 5 + (0.8,))
    texture = rough_town(share)
    found = recorded_echoes(texture, facts, PARAMS.cover)
    if west == 1:
        assert found is None
    else:
        np.testing.assert_allclose(found[:, :150], west, atol=0.01)
        np.testing.assert_array_equal(found[:, 250:], 1)
        # A window of the absolute lattice knows the same, from 50 m of its edges on.
        cut = slice(30, 180), slice(60, 390)
        spec = texture.ndsm.spec.crop(*cut)
        ndsm = Grid(texture.ndsm.values[cut], texture.ndsm.valid[cut], spec)
        fields = (
            each[cut]
            for each in (
                texture.echoes.split,
                texture.echoes.split_best,
                texture.echoes.split_wide,
                texture.echoes.solid,
            )
        )
        rough = texture.roughness_m[cut]
        window = recorded_echoes(Texture(ndsm, rough, rough, Echoes(*fields), 2.0), facts, PARAMS.cover)
        np.testing.assert_array_equal(window[50:-50, 50:-50], found[cut][50:-50, 50:-50])
    # A survey whose crowns split a fifth as many: so many are enough here, too.
    weak = recorded_echoes(rough_town(share / 5), replace(facts, crown_split=(0.2 * USUAL_SPLIT,) * 6), PARAMS.cover)
    assert (weak is None) == (west == 1)
    if weak is not None:
        np.testing.assert_allclose(weak[:, :150], west, atol=0.01)
    bare = replace(texture, ndsm=texture.ndsm.with_values(np.zeros_like(texture.ndsm.values), texture.ndsm.valid))
    assert recorded_echoes(bare, facts, PARAMS.cover) is None
    assert recorded_echoes(replace(texture, echoes=None), facts, PARAMS.cover) is None
    for unknown in (None, replace(facts, crown_split=None), replace(facts, crown_split=(0.0,) * 6)):
        assert recorded_echoes(texture, unknown, PARAMS.cover) is None
