"""The main job as a whole: what it promises of its result, whatever the order and kind of its inputs."""

import json
import shutil
import subprocess
from dataclasses import replace
from functools import partial

import geopandas as gpd
import numpy as np
import pytest
import rasterio.warp
import shapely
from click.testing import CliRunner
from pyproj import CRS, Transformer
from simulated import scenes
from simulated.files import write_heights, write_image, write_points
from support.sizes import sample

import msbdb
from msbdb.cli.main import cli
from msbdb.database import canonical_dump, open_database, read_build, read_candidates
from msbdb.errors import DatabaseError, InputError
from msbdb.fuse.probability import building_probability
from msbdb.grid import Grid, lattice
from msbdb.outline.polygons import rasterise
from msbdb.params import FuseParams, Params, profile, with_values
from msbdb.run.reports import STAGES
from msbdb.tables import DETECTOR_SHARES, validate_parts

FOOT = 0.3048
OREGON_METRES, OREGON_FEET = CRS.from_epsg(2993), CRS.from_epsg(2994)
OREGON = (200_000.0, 300_000.0)
"""A place in Oregon, metres of EPSG:2993."""

COUNTED_ONLY = {"duplicates", "duplicates after vegetation", "duplicates after split"}
"""Stages whose dropped regions live on in their coarser ones, and so are not lost."""


@pytest.fixture(scope="module")
def scene():
    """House, grove and crowns: small, with parts and rejections."""
    return scenes.under_trees()


@pytest.fixture(scope="module")
def tower():
    """Podium, tower and plant room."""
    return scenes.podium_tower()


@pytest.fixture(scope="module")
def points(scene, tmp_path_factory):
    """Return the scene's point file."""
    return write_points(tmp_path_factory.mktemp("points") / "town.laz", scene.points)


@pytest.fixture(scope="module")
def town(points, tmp_path_factory):
    """Return a database of the scene, which no test changes."""
    db = tmp_path_factory.mktemp("town") / "town.sqlite"
    report = msbdb.build([points], db=db, date="2026-01-31")
    return db, report


def dump(db, *, files=True):
    """Return the content, with or without the names and checksums of the files and the notices on them."""
    engine = open_database(db)
    lines = list(canonical_dump(engine, provenance=files))
    engine.dispose()
    return lines


def colourless(cloud):
    """Return a cloud without colours."""
    return replace(cloud, colours=None, colour_names=())


def rasters(scene):
    """Return the true DSM and DTM of a scene."""
    row, col = np.indices(scene.spec.shape)
    east, north = scene.spec.xy(row, col)
    ground = scene.ground(east, north)
    solid, _, _ = scene.world.solid(east - scene.world.origin[0], north - scene.world.origin[1])
    every = np.ones(scene.spec.shape, dtype=np.bool_)
    return tuple(Grid(values.astype(np.float32), every, scene.spec) for values in (solid, ground))


def test_the_report_says_what_the_database_holds(town):
    """Counts, stages and notices of the report agree with the database's own."""
    db, report = town
    run = msbdb.info(db)["runs"][0]
    assert report.survey == run["survey"] == "town"
    assert (report.buildings, report.parts, report.rejected) == (run["buildings"], run["parts"], run["rejected"])
    assert report.buildings == 1
    assert report.rejected > 0
    assert list(report.notices) == run["notices"]
    assert set(report.timings) == set(STAGES)
    assert report.changed
    assert json.loads(json.dumps(report.as_dict()))["parts"] == report.parts
    assert run["survey_record"]["date"] == "2026-01-31"
    assert run["survey_record"]["density"] == pytest.approx(4, rel=0.02)
    assert run["survey_record"]["sources"][0]["name"] == "town.laz"


def command(*words):
    """Run the program; return what --json prints."""
    result = CliRunner().invoke(cli, [*map(str, words), "--json"])
    assert result.exit_code == 0, result.stderr
    return json.loads(result.stdout)


@pytest.mark.parametrize("coloured", sample([True, False], 2))
def test_scales_auto_works_with_and_without_colours(scene, tmp_path, coloured):
    """--scales auto finds the scales once, for the filter of the bands and for the parts; labels do not change them."""
    file = write_points(tmp_path / "town.laz", scene.points if coloured else colourless(scene.points))
    db = tmp_path / "town.sqlite"
    report = command("build", "--points", file, "--db", db, "--scales", "auto", "--extract", "multiscale")
    assert report["parts"] > 0
    run = command("info", db)["runs"][0]
    scales = run["chosen"]["scales_m2"]
    assert scales == sorted(scales)
    assert run["scales_m2"] == scales[::-1]
    assert (run["chosen"]["spectral"] is not None) == coloured
    with msbdb.open(db) as opened:
        table = opened.classes()
    number = int(table["speindex"].iloc[0])
    msbdb.relabel(db, {number: "vegetation"})
    assert command("info", db)["runs"][0]["chosen"] == run["chosen"]
    assert command("info", db)["runs"][0]["scales_m2"] == scales[::-1]


def test_what_a_run_decided_itself_is_kept(town):
    """The ground filter, the scaling of the bands and the centres of the classes are in the run (V21, X2)."""
    db, _ = town
    chosen = command("info", db)["runs"][0]["chosen"]
    assert chosen["ground_filter"] == "walls"
    assert chosen["scales_m2"] == list(profile().scale.scales_m2)
    spectral = chosen["spectral"]
    assert {"red", "green", "blue", "nir", "intensity"} == set(spectral["bands"])
    assert spectral["vegetation_index"] == "ndvi"
    with msbdb.open(db) as opened:
        classes = opened.classes()
    colours = classes[classes["source"] == "spectral"]
    centres = np.array(spectral["centres"])
    assert centres.shape == (len(colours), len(spectral["bands"]))
    assert ((centres >= 0) & (centres <= 1)).all()
    assert all(low < high for low, high in zip(spectral["low"], spectral["high"], strict=True))
    shares = np.array(spectral["roof_share"])
    assert shares.shape == (len(colours),)
    assert 0 <= shares.min() < spectral["all_roofs"] < shares.max() <= 1


def test_info_for_people_names_the_ground_filter_and_no_centres(town):
    """The record for people stays short."""
    result = CliRunner().invoke(cli, ["info", str(town[0])])
    assert "walls" in result.stdout
    assert "centres" not in result.stdout


def test_a_second_build_changes_nothing(town, points, tmp_path):
    """The same build again reports no change and leaves the same content."""
    db = shutil.copy(town[0], tmp_path / "again.sqlite")
    before = dump(db)
    report = msbdb.build([points], db=db, date="2026-01-31")
    assert not report.changed
    assert dump(db) == before == dump(town[0])


def test_other_parameters_replace_the_survey(town, points, tmp_path):
    """Building a survey again with other values replaces it, and back gives what was."""
    db = shutil.copy(town[0], tmp_path / "other.sqlite")
    before = dump(db)
    report = msbdb.build([points], db=db, date="2026-01-31", profile="vu2009")
    assert report.changed
    assert len(msbdb.info(db)["runs"]) == 1
    assert dump(db) != before
    assert msbdb.build([points], db=db, date="2026-01-31").changed
    assert dump(db) == before


def test_the_order_of_points_does_not_matter(town, scene, tmp_path):
    """Shuffled points give the same content; only the file is another."""
    order = np.random.default_rng(1).permutation(len(scene.points))
    shuffled = write_points(tmp_path / "shuffled.laz", scene.points.take(order))
    msbdb.build([shuffled], db=tmp_path / "shuffled.sqlite", survey="town", date="2026-01-31")
    assert dump(tmp_path / "shuffled.sqlite", files=False) == dump(town[0], files=False)


def test_the_cut_into_files_does_not_matter(town, scene, tmp_path):
    """Two tiles, cut through the house, give the content of one file; their order changes nothing at all."""
    west = scene.points.x < scene.world.origin[0] + 47.3
    tiles = [write_points(tmp_path / f"{n}.laz", scene.points.take(side)) for n, side in enumerate((west, ~west))]
    for name, order in (("forth", tiles), ("back", tiles[::-1])):
        msbdb.build(order, db=tmp_path / f"{name}.sqlite", survey="town", date="2026-01-31")
    assert dump(tmp_path / "forth.sqlite") == dump(tmp_path / "back.sqlite")
    assert dump(tmp_path / "forth.sqlite", files=False) == dump(town[0], files=False)


@pytest.mark.long
def test_surveys_live_side_by_side(town, tower, tmp_path):
    """A second survey leaves the first as it is; each is read by its name, and one must be named."""
    db = shutil.copy(town[0], tmp_path / "both.sqlite")
    before = set(dump(db))
    msbdb.build([write_points(tmp_path / "centre.laz", tower.points)], db=db)
    assert before <= set(dump(db))
    with msbdb.open(db) as opened, msbdb.open(town[0]) as alone:
        assert sorted(opened.runs()["survey"]) == ["centre", "town"]
        assert opened.buildings("town").equals(alone.buildings())
        assert len(opened.parts("centre")) == 3
        with pytest.raises(InputError, match=r"centre.*town|town.*centre"):
            opened.buildings()


def test_the_forest_and_the_ledger_balance(town):
    """Parts form a forest (V33), every stage's counts balance, and the ledger holds what the stages dropped."""
    with msbdb.open(town[0]) as opened:
        parts, rows, counted = opened.parts(), opened.rejections(), opened.rejection_counts()
        engine = open_database(town[0])
        counts = read_build(engine).run.counts.regions
        engine.dispose()
    validate_parts(parts)
    stages = {(method, name): stage for method, own in counts.items() for name, stage in own.items()}
    assert all(stage["in"] == stage["kept"] + stage["dropped"] for stage in stages.values())
    dropped = {key: stage["dropped"] for key, stage in stages.items() if key[1] not in COUNTED_ONLY}
    lost = counted.groupby(["method", "stage"])["regions"].sum().to_dict()
    assert lost == {name: number for name, number in dropped.items() if number}
    kind = ["method", "stage", "reason"]
    large = counted.assign(large=counted["regions"] - counted["small"]).set_index(kind)["large"]
    assert rows.groupby(kind).size().to_dict() == large[large > 0].to_dict()
    assert rows["area_m2"].min() >= Params().fuse.piece_m2
    assert counts["multiscale"]["fake fathers"]["kept"] == len(parts)


def test_geometries_are_valid_and_agree_with_their_tables(tower, tmp_path):
    """All outlines are valid and of their stated areas; footprints are those of the roots."""
    msbdb.build([write_points(tmp_path / "tower.laz", tower.points)], db=tmp_path / "tower.sqlite")
    with msbdb.open(tmp_path / "tower.sqlite") as opened:
        parts, buildings = opened.parts(), opened.buildings()
    assert parts.crs == buildings.crs == tower.points.crs
    for table in (parts, buildings):
        assert shapely.is_valid(table.geometry).all()
        assert not shapely.is_empty(table.geometry).any()
        assert table.geometry.area.to_numpy() == pytest.approx(table["area_m2"].to_numpy(), rel=0.05)
    roots = parts[parts["supid"] == 0]
    for row in buildings.itertuples():
        own = roots[roots["building_id"] == row.building_id]
        assert len(own) == row.trees
        assert own["area_m2"].sum() == pytest.approx(row.area_m2)
        assert own.union_all().symmetric_difference(row.geometry).area < 0.1 * row.area_m2
    assert set(roots["building_id"]) == set(buildings["building_id"])
    inside = gpd.GeoSeries(gpd.points_from_xy(parts["xin"], parts["yin"]), crs=parts.crs)
    assert parts.geometry.reset_index(drop=True).covers(inside).all()


def test_relabelling_moves_buildings_to_the_ledger_and_back(town, tmp_path):
    """With every roof class called vegetation no building is left; called roofs again, all is as it was."""
    db = shutil.copy(town[0], tmp_path / "labels.sqlite")
    with msbdb.open(db) as opened:
        classes, before = opened.classes(), opened.buildings()
    roofs = classes.loc[classes["label"] == "building", "speindex"].tolist()
    # The operator's word first agrees with the automatic one, and differs from it in who said it.
    msbdb.relabel(db, dict.fromkeys(roofs, "building"))
    agreed = dump(db)
    report = msbdb.relabel(db, dict.fromkeys(roofs, "vegetation"))
    assert report.buildings == 0
    assert report.changed
    with msbdb.open(db) as opened:
        told, lost = opened.classes().set_index("speindex"), opened.rejection_counts()
    assert set(told.loc[roofs, "label"]) == {"vegetation"}
    assert set(told["labelled_by"]) == {"operator", "automatic"}
    assert (told.loc[roofs, "labelled_by"] == "operator").all()
    assert lost["area_m2"].sum() > before["area_m2"].sum()
    msbdb.relabel(db, dict.fromkeys(roofs, "building"))
    assert dump(db) == agreed


@pytest.mark.long
def test_the_operator_takes_a_deck_away(tmp_path):
    """The elevated road that passes for a building goes to the ledger when its class is labelled other.

    The houses stay.
    """
    scene = scenes.elevated_road()
    db = tmp_path / "road.sqlite"
    few = with_values(profile(), {"spectral": {"classes": 2}})
    msbdb.build([write_points(tmp_path / "road.laz", scene.points)], db=db, params=few)
    with msbdb.open(db) as opened:
        found = opened.buildings()
    deck = found.loc[found["area_m2"] > 1000, "speindex"].item()
    assert (found.loc[found["area_m2"] < 1000, "speindex"] != deck).all()
    msbdb.relabel(db, {int(deck): "other"})
    with msbdb.open(db) as opened:
        left, classes, lost = opened.buildings(), opened.classes().set_index("speindex"), opened.rejection_counts()
    assert sorted(left["area_m2"]) == pytest.approx([224, 225], rel=0.02)
    assert tuple(classes.loc[deck, ["label", "labelled_by"]]) == ("other", "operator")
    labelled = lost[lost["reason"] == "its class is labelled as no building"]
    assert labelled[["method", "stage", "regions"]].to_numpy().tolist() == [["multiscale", "houses", 1]]
    assert labelled["area_m2"].item() == pytest.approx(1200, rel=0.02)


def test_a_class_or_label_that_is_not_there_is_refused(town):
    """Nothing changes when the operator names a class or label that does not exist."""
    before = dump(town[0])
    for wrong in ({99: "building"}, {1: "castle"}):
        with pytest.raises(InputError, match="cannot be labelled"):
            msbdb.relabel(town[0], wrong)
    assert dump(town[0]) == before


@pytest.mark.parametrize("kind", ["dsm and dtm", "ndsm"])
def test_rasters_serve_instead_of_points(tower, tmp_path, kind):
    """True rasters give the true forest, whether heights are above sea level or above ground."""
    dsm, dtm = rasters(tower)
    if kind == "ndsm":
        heights = replace(dsm, values=dsm.values - dtm.values)
        write_heights(tmp_path / "ndsm.tif", heights)
        given = {"ndsm": tmp_path / "ndsm.tif"}
    else:
        write_heights(tmp_path / "dsm.tif", dsm)
        write_heights(tmp_path / "dtm.tif", dtm)
        given = {"dsm": tmp_path / "dsm.tif", "dtm": tmp_path / "dtm.tif"}
    report = msbdb.build(**given, db=tmp_path / "raster.sqlite")
    assert report.buildings == 1
    assert sorted(report.candidate_regions) == ["adaptive", "area3d"]
    assert min(report.candidate_regions.values()) > 0
    assert any("height texture alone" in notice for notice in report.notices)
    with msbdb.open(tmp_path / "raster.sqlite") as opened:
        parts = opened.parts().sort_values("area_m2")
        buildings = opened.buildings()
    footprint = rasterise(buildings.geometry, tower.spec) > 0
    assert (footprint == (tower.buildings > 0)).mean() > 0.99
    shares = buildings.loc[0, list(DETECTOR_SHARES.values())].to_numpy(dtype=float)
    odds = building_probability(
        shares.mean()[None], buildings["area_m2"].to_numpy(), FuseParams().of_rasters(tower.spec.cell_m)
    )
    assert buildings["probability"].tolist() == pytest.approx(odds.tolist())
    assert buildings["state"].tolist() == ["confirmed"]
    assert parts["area_m2"].tolist() == pytest.approx([36, 300, 1200], rel=0.02)
    assert parts["h_max"].tolist() == pytest.approx([36.5, 36.5, 36.5], abs=0.01)


def test_without_imagery_the_notices_say_so(scene, tmp_path):
    """Points without colours still give the house, and the run tells what was missing."""
    points = write_points(tmp_path / "grey.laz", colourless(scene.points))
    report = msbdb.build([points], db=tmp_path / "grey.sqlite")
    assert report.buildings == 1
    assert any("no imagery" in notice for notice in report.notices)
    with msbdb.open(tmp_path / "grey.sqlite") as opened:
        assert set(opened.classes()["source"]) == {"structure"}
        assert opened.runs()["survey"].tolist() == ["grey"]


def test_an_ortho_on_another_grid_and_crs_serves(scene, tmp_path):
    """An orthophoto of the neighbouring UTM zone, at another cell, tells roof from crown where it was put.

    Splitting is off, as the classes of the one roof differ by noise alone (docs/limits.md).
    """
    points = write_points(tmp_path / "grey.laz", colourless(scene.points))
    fine = lattice(tuple(scene.spec.bounds), 0.25, scenes.UTM33)
    to = Transformer.from_crs(scenes.UTM33, CRS.from_epsg(32632), always_xy=True)
    over = lattice(tuple(to.transform_bounds(*scene.spec.bounds)), 0.3, CRS.from_epsg(32632))
    image = np.zeros((4, *over.shape), dtype=np.float32)
    places = {
        "src_transform": fine.transform,
        "src_crs": fine.crs,
        "dst_transform": over.transform,
        "dst_crs": over.crs,
    }
    rasterio.warp.reproject(scene.ortho(fine), image, **places)
    names = ("red", "green", "blue", "nir")
    ortho = write_image(tmp_path / "ortho.tif", image, over, names)
    report = msbdb.build([points], ortho=[ortho], db=tmp_path / "ortho.sqlite")
    assert report.buildings == 1
    assert not any("no imagery" in notice for notice in report.notices)
    with msbdb.open(tmp_path / "ortho.sqlite") as opened:
        classes, house = opened.classes().set_index("speindex"), opened.buildings().iloc[0]
        roles = {source["role"] for source in msbdb.info(opened.db)["runs"][0]["survey_record"]["sources"]}
    assert roles == {"points", "ortho"}
    assert house["speindex"] > 0
    assert classes.loc[house["speindex"], "ndvi"] < 0.1
    crowns = classes[(classes["source"] == "spectral") & (classes["label"] == "vegetation")]
    assert crowns["ndvi"].max() > 0.3


@pytest.mark.long
def test_feet_give_what_metres_give(tower, tmp_path):
    """The same city in Oregon feet has the buildings of the one in metres, and the run says what was converted."""
    shift = [home - start for home, start in zip(OREGON, tower.world.origin, strict=True)]
    cloud = tower.points
    moved = replace(cloud, x=cloud.x + shift[0], y=cloud.y + shift[1], crs=OREGON_METRES)
    write = partial(write_points, cloud=moved)
    metric = msbdb.build([write(tmp_path / "m.laz")], db=tmp_path / "m.sqlite", survey="town")
    feet = write(tmp_path / "ft.laz", metres=FOOT, crs=OREGON_FEET)
    foreign = msbdb.build([feet], db=tmp_path / "ft.sqlite", survey="town")
    assert (foreign.buildings, foreign.parts) == (metric.buildings, metric.parts) == (1, 3)
    assert any("2993" in notice for notice in foreign.notices)
    with msbdb.open(tmp_path / "m.sqlite") as one, msbdb.open(tmp_path / "ft.sqlite") as other:
        ours, theirs = (opened.parts().sort_values("area_m2") for opened in (one, other))
    assert theirs.crs.to_epsg() == ours.crs.to_epsg() == 2993
    assert theirs["area_m2"].tolist() == pytest.approx(ours["area_m2"].tolist(), rel=0.005)
    for column in ("h_max", "h_p50"):
        assert theirs[column].tolist() == pytest.approx(ours[column].tolist(), abs=0.02)


def test_an_empty_database_is_a_database(tmp_path):
    """Nothing found is a valid result: a database with all layers, which GDAL opens."""
    field = scenes.flat_field()
    db = tmp_path / "field.sqlite"
    report = msbdb.build([write_points(tmp_path / "field.laz", field.points)], db=db)
    assert report.buildings == 0
    assert msbdb.info(db)["runs"][0]["highest_m"] is None
    if shutil.which("ogrinfo") is None:
        pytest.skip("no ogrinfo here; scripts/setup test installs it")
    for layer in ("part", "building", "rejection"):
        said = subprocess.run(["ogrinfo", "-so", db, layer], capture_output=True, text=True, check=True)
        assert "Feature Count: 0" in said.stdout
        assert "32633" in said.stdout


def test_views_and_exports_are_written(town, tmp_path):
    """The map is a PNG, and the three formats hold parts or footprints."""
    with msbdb.open(town[0]) as opened:
        opened.view(tmp_path / "town.png")
        for name in ("town.gpkg", "town.shp", "town.geojson"):
            opened.export(tmp_path / name)
        parts, buildings = opened.parts(), opened.buildings()
    assert (tmp_path / "town.png").read_bytes().startswith(b"\x89PNG")
    assert len(gpd.read_file(tmp_path / "town.gpkg", layer="footprint")) == len(buildings)
    for name, layer, rows in (("gpkg", "part", parts), ("shp", None, parts), ("geojson", None, buildings)):
        read = gpd.read_file(tmp_path / f"town.{name}", **({"layer": layer} if layer else {}))
        assert len(read) == len(rows)
        assert read.to_crs(parts.crs).geometry.area.sum() == pytest.approx(rows.geometry.area.sum(), rel=1e-3)


def test_nothing_is_written_when_inputs_cannot_be_used(tmp_path):
    """A build that fails on its inputs leaves no database behind."""
    (tmp_path / "broken.laz").write_bytes(b"LASF but nothing more")
    with pytest.raises(msbdb.MsbdbError):
        msbdb.build([tmp_path / "broken.laz"], db=tmp_path / "none.sqlite")
    assert not (tmp_path / "none.sqlite").exists()
    with pytest.raises(InputError, match="either points"):
        msbdb.build(db=tmp_path / "none.sqlite")
    with pytest.raises(DatabaseError):
        msbdb.open(tmp_path / "none.sqlite")


def test_the_name_of_a_survey_changes_no_outline(tmp_path):
    """Names are part of the ids; where two candidate regions meet, their places decide which has the shared points."""
    points = write_points(tmp_path / "hall.laz", scenes.large_building(density=0.5).points)
    found = []
    for survey in ("a", "b"):
        msbdb.build([points], db=tmp_path / f"{survey}.sqlite", survey=survey, extract=["area3d"])
        candidates = read_candidates(open_database(tmp_path / f"{survey}.sqlite"))
        found.append(sorted(shapely.to_wkb(candidates.normalize())))
    assert len(found[0]) == 2
    assert found[0] == found[1]
