"""GIS clients read every layer: GDAL's own tools list tables and views with type, SRID, extent and count."""

import csv
import io
import json
import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path

import pytest
from simulated.builds import (
    AWNING,
    BLOCK,
    CRANE,
    DECK,
    EPSG,
    HOUSE,
    LIFT,
    PITCH,
    PITCH_CLUSTER,
    PODIUM,
    SHED,
    SLAB,
    SLAB_ROOF,
    SOUTH,
    TERRACE,
    WEST,
    WING,
    small_build,
)
from sqlalchemy import Engine, make_url

from msbdb.database import open_database, write_build
from msbdb.database.schema.sqltables import SPATIAL

pytestmark = pytest.mark.skipif(shutil.which("ogrinfo") is None, reason="GDAL's tools (gdal-bin) are not installed")

PARTS = [PODIUM, SLAB, LIFT, HOUSE, BLOCK, SHED]
ROOTS = [PODIUM, HOUSE, BLOCK, SHED]


@dataclass(frozen=True)
class Layer:
    """What a client must find of a layer."""

    key: str
    kind: str
    extent: tuple[float, float, float, float]
    ids: list[int] | None
    others: tuple[str, ...] = ()


CANDIDATES = [*range(TERRACE, PITCH_CLUSTER + 1)]
WHOLE = (WEST, SOUTH, WEST + 306, SOUTH + 45)
LAYERS = {
    "part": Layer("part_id", "Multi Polygon", WHOLE, PARTS, ("supid", "root_id")),
    "building": Layer("building_id", "Multi Polygon", WHOLE, ROOTS),
    "rejection": Layer("rejection_id", "Point", (WEST + 20, SOUTH + 15, WEST + 160, SOUTH + 20), None),
    "footprint": Layer("building_id", "Multi Polygon", WHOLE, ROOTS),
    "part_tree": Layer("part_id", "Multi Polygon", WHOLE, PARTS, ("supid", "root_id")),
    "building_summary": Layer("building_id", "Multi Polygon", WHOLE, ROOTS),
    "flat_region": Layer(
        "region_id", "Multi Polygon", (WEST + 5, SOUTH, WEST + 220, SOUTH + 50), [SLAB_ROOF, WING, DECK, PITCH]
    ),
    "part_evidence": Layer("part_id", "Multi Polygon", WHOLE, PARTS, ("supid", "root_id")),
    "unexplained_flat_region": Layer(
        "region_id", "Multi Polygon", (WEST + 68, SOUTH + 10, WEST + 220, SOUTH + 50), [DECK, PITCH]
    ),
    "building_evidence": Layer("building_id", "Multi Polygon", WHOLE, ROOTS),
    "candidate_region": Layer("candidate_id", "Multi Polygon", (WEST, SOUTH, WEST + 303, SOUTH + 70), CANDIDATES),
    "candidate_evidence": Layer("candidate_id", "Multi Polygon", (WEST, SOUTH, WEST + 303, SOUTH + 70), CANDIDATES),
    "unexplained_candidate": Layer(
        "candidate_id",
        "Multi Polygon",
        (WEST + 30, SOUTH + 20, WEST + 220, SOUTH + 70),
        [CRANE, AWNING, PITCH_CLUSTER],
    ),
}


def source(engine: Engine) -> str:
    """Return GDAL's name of a database."""
    if engine.dialect.name == "sqlite":
        return str(engine.url.database)
    url = make_url(engine.url)
    return f"PG:host={url.query['host']} dbname={url.database} user={url.username}"


def run(*call: str) -> str:
    """Run a tool; warnings count as failures."""
    done = subprocess.run(call, capture_output=True, text=True, check=True)
    assert "Warning" not in done.stderr, done.stderr
    assert "ERROR" not in done.stderr, done.stderr
    return done.stdout


def test_all_layers_are_listed_with_their_types(loaded: Engine) -> None:
    """``ogrinfo`` without a layer's name lists tables with geometry and the views."""
    listed = run("ogrinfo", "-ro", source(loaded))
    for name, layer in LAYERS.items():
        assert f": {name} ({layer.kind})" in listed


@pytest.mark.parametrize("name", LAYERS)
def test_each_layer_reads_with_type_srid_extent_and_count(loaded: Engine, name: str) -> None:
    """A client sees geometry type, CRS, extent, key and number of features."""
    layer = LAYERS[name]
    words = run("ogrinfo", "-ro", "-so", source(loaded), name)
    west, south, east, north = layer.extent
    assert f"Geometry: {layer.kind}" in words
    assert f"Feature Count: {len(layer.ids or [1, 2, 3])}" in words
    assert f"Extent: ({west:.6f}, {south:.6f}) - ({east:.6f}, {north:.6f})" in words
    assert f'ID["EPSG",{EPSG}]]' in words
    if loaded.dialect.name == "sqlite" or name in SPATIAL:
        assert f"FID Column = {layer.key}" in words


@pytest.mark.parametrize("name", LAYERS)
def test_ids_come_out_whole(loaded: Engine, name: str, tmp_path: Path) -> None:
    """No client cuts a 59-bit id to 32 bits: keys, fathers and roots are those of the build."""
    layer = LAYERS[name]
    columns = ", ".join((f"CAST({layer.key} AS TEXT) AS key", *layer.others))
    query = f"SELECT {columns} FROM {name} ORDER BY {layer.key}"
    words = run("ogr2ogr", "-f", "CSV", "/vsistdout/", source(loaded), "-sql", query)
    rows = list(csv.DictReader(io.StringIO(words)))
    if layer.ids is not None:
        assert [int(row["key"]) for row in rows] == layer.ids
    if layer.others:
        assert [int(row["supid"]) for row in rows] == [0, PODIUM, SLAB, 0, 0, 0]
        assert [int(row["root_id"]) for row in rows] == [PODIUM, PODIUM, PODIUM, HOUSE, BLOCK, SHED]
    path = tmp_path / "layer.geojson"
    run("ogr2ogr", "-f", "GeoJSON", "-preserve_fid", str(path), source(loaded), name)
    features = json.loads(path.read_text())["features"]
    keys = [int(row["key"]) for row in rows]
    assert sorted(f["properties"].get(layer.key, f.get("id")) for f in features) == keys


def test_a_window_uses_the_index(loaded: Engine) -> None:
    """A client that asks for a window gets what lies in it, from tables and from views."""
    window = [str(v) for v in (WEST + 295, SOUTH, WEST + 400, SOUTH + 100)]
    for name in ("part", "footprint", "part_tree", "building_summary", "part_evidence", "building_evidence"):
        words = run("ogrinfo", "-ro", "-so", source(loaded), name, "-spat", *window)
        assert "Feature Count: 1\n" in words
    window = [str(v) for v in (WEST + 190, SOUTH, WEST + 250, SOUTH + 100)]
    for name in (
        "flat_region",
        "unexplained_flat_region",
        "candidate_region",
        "candidate_evidence",
        "unexplained_candidate",
    ):
        words = run("ogrinfo", "-ro", "-so", source(loaded), name, "-spat", *window)
        assert "Feature Count: 1\n" in words


def test_tables_without_geometry_are_read_too(loaded: Engine) -> None:
    """Surveys and classes can be joined in a client."""
    assert "delft" in run("ogrinfo", "-ro", "-al", source(loaded), "survey")
    assert "multiscale" in run("ogrinfo", "-ro", "-al", source(loaded), "run")


def test_extents_follow_the_content(tmp_path: Path) -> None:
    """After another load the registered figures are the new ones."""
    engine = open_database(tmp_path / "city.sqlite", create=True, srid=EPSG)
    write_build(engine, small_build())
    build = small_build(version="2")
    for name in ("part", "building"):
        build.frames[name] = build.frames[name][build.frames[name]["building_id"] != SHED]
    build.frames["part_candidate"] = build.frames["part_candidate"][build.frames["part_candidate"]["part_id"] != SHED]
    write_build(engine, build)
    for name, count in (("part", 5), ("footprint", 3), ("part_tree", 5), ("building_summary", 3)):
        words = run("ogrinfo", "-ro", "-so", source(engine), name)
        assert f"Feature Count: {count}\n" in words
        assert f"- ({WEST + 110:.6f}, {SOUTH + 30:.6f})" in words
