"""What the tables of a build say of its witnesses, and how a kept run gives them back."""

from dataclasses import replace

import geopandas as gpd
import numpy as np
import pandas as pd
import pytest
from affine import Affine
from pyproj import CRS
from simulated.files import write_points
from simulated.scenes import SCENES

import msbdb
from msbdb.database import open_database, read_build, read_tables, write_build
from msbdb.detect.detectors import detect_multiscale
from msbdb.detect.scene import Regions, Scene
from msbdb.grid import Grid, GridSpec
from msbdb.kept import KeptRun, Rasters, lattice_of
from msbdb.landcover import ClassMap
from msbdb.outline.polygons import polygonise
from msbdb.params import Params
from msbdb.run.describe import count_cells, make_frames
from msbdb.run.store import recall_regions
from msbdb.spectral.coverclasses import Cover
from msbdb.tables import (
    CANDIDATE_REGION,
    FLAT_REGION,
    PART_CANDIDATE,
    REJECTION,
    SPECTRAL_CLASS,
    SPECTRAL_CLASS_BAND,
    Counts,
    Run,
    Survey,
)

SPEC = GridSpec((30, 60), Affine(1.0, 0, 389_000, 0, -1.0, 5_821_000), CRS.from_epsg(32633))
WEST, MIDDLE, EAST = (slice(5, 15), slice(5, 15)), (slice(5, 15), slice(25, 35)), (slice(5, 15), slice(45, 55))
"""Three roofs of 10 x 10 m."""


def images(*regions, spec=SPEC):
    """Return labels 1 to n of windows of the lattice."""
    labels = np.zeros(spec.shape, dtype=np.int32)
    for number, window in enumerate(regions, start=1):
        labels[window] = number
    return labels


def rows(table, labels, first, spec=SPEC, **words):
    """Return a row a label, with ids from ``first`` and plausible numbers."""
    count = int(labels.max())
    frame = table.empty().reindex(range(count))
    for column in table.columns:
        frame[column.name] = pd.Series([words.get(column.name, 1)] * count).astype(column.dtype)
    frame[table.names[0]] = np.arange(first, first + count, dtype=np.int64)
    return gpd.GeoDataFrame(frame, geometry=list(polygonise(labels, spec, count)), crs=spec.crs)


def layer(method, *regions, spec=SPEC, first=1000):
    """Return the candidate regions of a detector, with one row in its ledger."""
    labels = images(*regions, spec=spec)
    height_scale = 3.0 if method == "area3d" else np.nan
    words = {"method": method, "rule": "rule 1", "height_scale_m": height_scale}
    found = rows(CANDIDATE_REGION, labels, first, spec, **words)
    dropped = (first + 500, method, "rules", "no rule", 0, 12.0, 389_001.0, 5_820_999.0)
    ledger = pd.DataFrame([dropped], columns=REJECTION.names).astype({c.name: c.dtype for c in REJECTION.columns})
    n = len(found)
    return Regions(method, labels, found, ledger, {f"{method} rules": {"in": n + 1, "kept": n, "dropped": 1}})


def flat(*regions):
    """Return flat regions."""
    labels = images(*regions)
    found = rows(FLAT_REGION, labels, 100)
    return Regions("flatregions", labels, found, REJECTION.empty(), {})


def town():
    """Return the scene of three roofs."""
    heights = np.zeros(SPEC.shape, dtype=np.float32)
    for roof in (WEST, MIDDLE, EAST):
        heights[roof] = 9.5
    classes = ClassMap((heights > 0).astype(np.uint8), {1: "building"}, SPEC)
    roofs = (1, "building", "automatic", "structure", 300, 1.0, np.nan, np.nan, 0.1, 9.5)
    table = pd.DataFrame([roofs], columns=SPECTRAL_CLASS.names)
    cover = Cover(classes, None, table, SPECTRAL_CLASS_BAND.empty(), False, False, {})
    survey = Survey("town", "", SPEC.crs.to_wkt(), 32633, "", 0.0, 1.0, SPEC.bounds, ())
    return Scene(survey, Grid(heights, np.ones(SPEC.shape, dtype=bool), SPEC), cover, None)


def frames(*witnesses):
    """Return the tables of a build of three roofs, in which these detectors and the multi-scale one were run."""
    scene, params = town(), Params()
    params = replace(params, scale=replace(params.scale, scales_m2=(20.0, 50.0)))
    found = detect_multiscale(scene, params)
    regions = {"multiscale": found, **{one.method: one for one in witnesses}}
    return make_frames(scene, regions, found.forest, params)


def test_every_pair_of_witnesses_is_linked():
    """Parts and flat regions, parts and candidates, flat regions and candidates, each with its ledger."""
    area3d = layer("area3d", WEST, (slice(5, 15), slice(30, 40)))
    adaptive = layer("adaptive", EAST, first=2000)
    found = frames(flat(WEST, (slice(20, 25), slice(0, 5))), area3d, adaptive)
    assert found["candidate_region"]["candidate_id"].tolist() == [2000, 1000, 1001]
    buildings = found["building"].assign(east=found["building"].geometry.centroid.x).sort_values("east")
    assert buildings["flat_share"].tolist() == [1, 0, 0]
    assert buildings["area3d_share"].tolist() == [1, 0.5, 0]
    assert buildings["adaptive_share"].tolist() == [0, 0, 1]
    assert buildings["multiscale_share"].tolist() == [1, 1, 1]
    # Mean shares of 0.75, 0.375 and 0.5, of 100 m² each.
    assert buildings["probability"].tolist() == pytest.approx([0.94, 0.31, 0.60], abs=0.01)
    assert set(buildings["state"]) == {"unsure"}
    links = found["part_candidate"].set_index("candidate_id")
    assert links["overlap_m2"].to_dict() == {2000: 100, 1000: 100, 1001: 50}
    assert links["candidate_share"].to_dict() == {2000: 1, 1000: 1, 1001: 0.5}
    assert found["flat_region_candidate"].to_numpy().tolist() == [[100, 1000, 100, 1, 1]]
    assert sorted(found["rejection"]["method"]) == ["adaptive", "area3d"]


def test_who_was_not_run_is_not_heard():
    """An extractor that found nothing speaks against a building; one that was not run has no say and no share."""
    nothing = frames(layer("area3d"))
    assert nothing["building"]["area3d_share"].tolist() == [0, 0, 0]
    assert set(nothing["building"]["state"]) == {"unsure"}
    unheard = frames()
    shares = unheard["building"][["flat_share", "area3d_share", "adaptive_share"]]
    assert shares.isna().all(axis=None)
    assert set(unheard["building"]["state"]) == {"confirmed"}
    assert [len(unheard[name]) for name in ("candidate_region", "part_candidate", "flat_region_candidate")] == [0] * 3


@pytest.mark.parametrize("methods", [(), ("area3d",), ("adaptive", "area3d")])
def test_a_kept_run_gives_its_regions_back(tmp_path, methods):
    """Labels, rows, ledger and counts of each detector, in the order of their names."""
    layers = [layer(method, WEST, EAST, first=1000 * n) for n, method in enumerate(methods, start=1)]
    found, scene = frames(*layers), town()
    stages = {"multiscale": {"opening": {"in": 3, "kept": 3, "dropped": 0}}}
    for one in layers:
        stages[one.method] = one.counts
    rule = {"colours_decide": 0, "green_decides": 0}
    counts = Counts(stages, count_cells(scene.heights, scene.cover), rule, {})
    run = Run(tuple(sorted([*methods, "multiscale"])), "default", "1", {}, counts, {}, ())
    rasters = Rasters.of_heights(scene.heights, scene.cover.structure.index)
    rasters = replace(rasters, regions={one.method: one.labels for one in layers})
    engine = open_database(tmp_path / "town.sqlite", create=True, srid=32633)
    write_build(engine, KeptRun(scene.survey, run, found, rasters))
    back = recall_regions(read_build(engine))
    assert list(back) == [one.method for one in back.values()] == list(methods)
    for one, other in zip(back.values(), layers, strict=True):
        np.testing.assert_array_equal(one.labels, other.labels, strict=True)
        pd.testing.assert_frame_equal(
            pd.DataFrame(one.table.drop(columns="geometry")), pd.DataFrame(other.table.drop(columns="geometry"))
        )
        assert one.table.geometry.geom_equals(other.table.geometry).all()
        assert one.ledger.to_numpy().tolist() == other.ledger.to_numpy().tolist()
        assert one.counts == other.counts


@pytest.mark.long
def test_labels_by_the_operator_keep_the_candidates(tmp_path):
    """Candidates, their links and ledger outlive another label of the classes, and speak for the buildings again."""
    points = write_points(tmp_path / "town.laz", SCENES["under_trees"]().points)
    db = tmp_path / "town.sqlite"
    msbdb.build([points], db=db, extract=["flatregions", "multiscale"])
    with msbdb.open(db) as opened:
        build, classes = read_build(opened.engine), opened.classes()
    added = layer("area3d", (slice(None), slice(None)), spec=lattice_of(build.survey))
    counts = replace(build.run.counts, regions=build.run.counts.regions | {"area3d": added.counts})
    ledger = build.frames["rejection"]
    extra = gpd.GeoDataFrame(added.ledger, geometry=[ledger.geometry.iloc[0]], crs=ledger.crs)
    kept = {"candidate_region": added.table, "rejection": pd.concat([ledger, extra], ignore_index=True)}
    run = replace(build.run, methods=("area3d", "flatregions", "multiscale"), counts=counts)
    rasters = replace(build.rasters, regions={**build.rasters.regions, "area3d": added.labels})
    roofs = classes.loc[classes["label"] == "building", "speindex"].tolist()
    with msbdb.open(db) as opened:
        write_build(opened.engine, replace(build, run=run, frames={**build.frames, **kept}, rasters=rasters))
    msbdb.relabel(db, dict.fromkeys(roofs, "building"))
    with msbdb.open(db) as opened:
        before = opened.dump()
        assert set(opened.buildings()["area3d_share"]) == {1}
        assert len(read_tables(opened.engine, [PART_CANDIDATE])["part_candidate"]) > 0
    msbdb.relabel(db, dict.fromkeys(roofs, "vegetation"))
    with msbdb.open(db) as opened:
        assert len(opened.buildings()) == len(read_tables(opened.engine, [PART_CANDIDATE])["part_candidate"]) == 0
        assert (opened.rejections()["method"] == "area3d").sum() == 1
    msbdb.relabel(db, dict.fromkeys(roofs, "building"))
    with msbdb.open(db) as opened:
        assert opened.dump() == before
