"""Loading builds and reading them back: the same content, once, whole or not at all."""

import shutil
from dataclasses import replace
from typing import Any

import geopandas as gpd
import numpy as np
import pandas as pd
import pytest
import shapely
from geopandas.testing import assert_geodataframe_equal
from simulated.builds import (
    AWNING,
    BLOCK,
    CRANE,
    DECK,
    EPSG,
    EVERY,
    HOUSE,
    HOUSE_CLUSTER,
    LIFT,
    PITCH,
    PITCH_CLUSTER,
    PODIUM,
    SHED,
    SHED_CLUSTER,
    SLAB,
    SLAB_CLUSTER,
    SLAB_ROOF,
    SOUTH_WING,
    TERRACE,
    WING,
    small_build,
)
from sqlalchemy import Engine, text
from sqlalchemy.exc import IntegrityError

from msbdb.database import (
    canonical_dump,
    check_database,
    list_runs,
    open_database,
    pack_rasters,
    read_build,
    read_buildings,
    read_candidates,
    read_classes,
    read_flat_regions,
    read_parts,
    read_rasters,
    read_rejections,
    read_run,
    read_scales,
    read_survey,
    read_tables,
    summarise_run,
    write_build,
)
from msbdb.database.dialects.dialect import dialect_of
from msbdb.database.schema.sqlfiles import VIEWS
from msbdb.database.schema.sqltables import METADATA
from msbdb.errors import InputError, LoadError, TableError
from msbdb.kept import KeptRun
from msbdb.tables import FLAT_REGION_CANDIDATE, PART_CANDIDATE, PART_FLAT_REGION, SPECTRAL_CLASS_BAND, TABLES

FILLED = {table.name for table in TABLES}
"""The tables that a build fills; those of the inventory have tests of their own."""


def changed(build: KeptRun, table: str, row: int = 0, **columns: Any) -> KeptRun:
    """Return a build with other values in one row of a table."""
    frame = build.frames[table].copy()
    for name, value in columns.items():
        if name == "geometry":
            frame[name] = np.array([value, *frame["geometry"][1:]], dtype=object)
        else:
            frame.loc[frame.index[row], name] = value
    return replace(build, frames={**build.frames, table: frame})


def assert_same_build(found: KeptRun, expected: KeptRun) -> None:
    """Check that two builds hold the same, whatever the order of rows and sources."""
    assert replace(found.survey, sources=()) == replace(expected.survey, sources=())
    assert set(found.survey.sources) == set(expected.survey.sources)
    assert (found.run.methods, found.run.version) == (expected.run.methods, expected.run.version)
    assert (found.run.notices, found.run.counts) == (expected.run.notices, expected.run.counts)
    for table in TABLES:
        key = table.names[:2]
        one = found.frames[table.name].sort_values(key, ignore_index=True)
        two = expected.frames[table.name].sort_values(key, ignore_index=True)
        check = assert_geodataframe_equal if table.geometry else pd.testing.assert_frame_equal
        check(one, two)
    named = found.rasters.by_name()
    assert sorted(named) == sorted(expected.rasters.by_name())
    for name, values in expected.rasters.by_name().items():
        np.testing.assert_array_equal(named[name], values, strict=True)


def test_what_is_written_is_read(engine: Engine) -> None:
    """Survey, run, all tables with their types and geometries, and the rasters come back as they were."""
    report = write_build(engine, small_build())
    assert report.status == "created"
    assert report.rows["part"] == 6
    assert_same_build(read_build(engine), small_build())


def test_each_table_is_read_by_itself(engine: Engine) -> None:
    """The readers of single tables agree with the build."""
    build = small_build()
    write_build(engine, build)
    assert read_survey(engine).vertical_crs == "NAP height"
    assert read_run(engine).timings == {"read": 0.5}
    assert read_run(engine).parameters == {"scale": {"scales_m2": [20.0, 50.0, 200.0]}}
    assert read_parts(engine)["part_id"].tolist() == [PODIUM, SLAB, LIFT, HOUSE, BLOCK, SHED]
    assert read_parts(engine).crs.to_epsg() == EPSG
    assert read_buildings(engine)["building_id"].tolist() == [PODIUM, HOUSE, BLOCK, SHED]
    assert read_rejections(engine)["reason"].tolist() == ["same storeys", "vegetation", "vegetation"]
    assert read_scales(engine)["threshold_m2"].tolist() == [200, 50, 20]
    assert read_classes(engine)["labelled_by"].tolist() == ["automatic", "automatic", "operator"]
    assert read_tables(engine, [SPECTRAL_CLASS_BAND])["spectral_class_band"]["mean"].tolist() == [
        11,
        10,
        21,
        20,
        31,
        30,
    ]
    assert read_rasters(engine).heights_cm.dtype == np.int32
    assert read_flat_regions(engine)["region_id"].tolist() == [SLAB_ROOF, WING, DECK, PITCH]
    links = read_tables(engine, [PART_FLAT_REGION])["part_flat_region"]
    assert links["part_id"].tolist() == [PODIUM, SLAB, LIFT, HOUSE, BLOCK]
    assert links["region_share"].tolist() == [1, 1, 0.1, 0.25, 1]
    runs = list_runs(engine)[["survey", "methods", "epsg"]].to_numpy().tolist()
    assert runs == [["delft", EVERY.replace(",", ", "), EPSG]]


def test_candidates_are_read_by_method(engine: Engine) -> None:
    """Both detectors' regions are in one table, in order of ids; the links have the shared area."""
    write_build(engine, small_build())
    area3d, adaptive = [TERRACE, SOUTH_WING, CRANE], [SLAB_CLUSTER, AWNING, HOUSE_CLUSTER, SHED_CLUSTER, PITCH_CLUSTER]
    assert read_candidates(engine)["candidate_id"].tolist() == [*area3d, *adaptive]
    assert read_candidates(engine, "delft", "area3d")["candidate_id"].tolist() == area3d
    found = read_candidates(engine, method="adaptive")
    assert found["candidate_id"].tolist() == adaptive
    assert found["height_scale_m"].isna().all()
    assert found.crs.to_epsg() == EPSG
    with pytest.raises(InputError, match="come from area3d and adaptive; got 'flatregions'"):
        read_candidates(engine, method="flatregions")
    links = read_tables(engine, [PART_CANDIDATE])["part_candidate"].set_index(["part_id", "candidate_id"])
    assert len(links) == 10
    assert links.loc[(SLAB, TERRACE)].tolist() == [200, 1, 1 / 6]
    assert links.loc[(PODIUM, AWNING)].tolist() == [100, 1 / 12, 0.25]
    links = read_tables(engine, [FLAT_REGION_CANDIDATE])["flat_region_candidate"].set_index(
        ["region_id", "candidate_id"]
    )
    assert sorted(links.index) == [
        (SLAB_ROOF, TERRACE),
        (SLAB_ROOF, SLAB_CLUSTER),
        (WING, SOUTH_WING),
        (DECK, HOUSE_CLUSTER),
        (PITCH, PITCH_CLUSTER),
    ]
    assert links.loc[(DECK, HOUSE_CLUSTER)].tolist() == [20, 0.25, 0.2]


def test_loading_twice_changes_nothing(engine: Engine) -> None:
    """The second load finds its content and leaves all of it alone, with the timings of the first."""
    first = write_build(engine, small_build())
    before = list(canonical_dump(engine))
    second = write_build(engine, small_build(timings={"read": 99.0}))
    assert second == replace(first, status="unchanged")
    assert list(canonical_dump(engine)) == before
    assert read_run(engine).timings == {"read": 0.5}


def test_the_order_of_rows_and_sources_is_of_no_matter(engine: Engine) -> None:
    """Shuffled rows and sources are the same content."""
    build = small_build()
    write_build(engine, build)
    shuffled = {name: frame.sample(frac=1, random_state=7) for name, frame in build.frames.items()}
    survey = replace(build.survey, sources=build.survey.sources[::-1])
    assert write_build(engine, replace(build, frames=shuffled, survey=survey)).status == "unchanged"


def test_where_a_ring_begins_is_of_no_matter(engine: Engine) -> None:
    """The same outline from another corner is the same content."""
    build = small_build()
    write_build(engine, build)
    turned = [shapely.reverse(shape) for shape in build.frames["part"]["geometry"]]
    frames = {**build.frames, "part": build.frames["part"].set_geometry(turned, crs=EPSG)}
    assert write_build(engine, replace(build, frames=frames)).status == "unchanged"


def test_other_content_replaces_the_runs_rows(engine: Engine) -> None:
    """After a change the database holds what a fresh one would hold."""
    write_build(engine, small_build())
    other = changed(small_build(version="0.2.0"), "part", h_max=50.0)
    frames = {**other.frames, "rejection": other.frames["rejection"][:1]}
    other = replace(other, frames=frames, survey=replace(other.survey, date="2021-01-01", sources=()))
    assert write_build(engine, other).status == "replaced"
    assert_same_build(read_build(engine), other)


def test_a_changed_raster_is_a_change(engine: Engine) -> None:
    """The rasters are part of the content."""
    build = small_build()
    write_build(engine, build)
    rasters = replace(build.rasters, heights_cm=build.rasters.heights_cm + np.int32(1))
    assert write_build(engine, replace(build, rasters=rasters)).status == "replaced"
    assert read_rasters(engine).heights_cm[0, 0] == 1


def test_rasters_that_are_packed_already_are_written_as_they_are(engine: Engine) -> None:
    """And a raster that took the place of a packed one is packed anew."""
    build = small_build()
    packed = pack_rasters(build.rasters.by_name())
    marked = {name: (values, row | {"data": row["data"] + b" "}) for name, (values, row) in packed.items()}
    write_build(engine, replace(build, packed=marked))
    with engine.connect() as connection:
        kept = dict(connection.execute(text("SELECT name, data FROM run_state")).all())
    assert kept["structure"] == packed["structure"][1]["data"] + b" "
    higher = replace(build.rasters, heights_cm=build.rasters.heights_cm + np.int32(1))
    write_build(engine, replace(build, rasters=higher, packed=packed))
    assert read_rasters(engine).heights_cm[0, 0] == 1


def test_rows_that_were_deleted_by_hand_come_back(engine: Engine) -> None:
    """The digest alone is not believed."""
    write_build(engine, small_build())
    before = list(canonical_dump(engine))
    with engine.begin() as connection:
        connection.execute(text("DELETE FROM rejection"))
    assert write_build(engine, small_build()).status == "replaced"
    assert list(canonical_dump(engine)) == before


def test_surveys_live_side_by_side(engine: Engine) -> None:
    """Replacing one survey leaves the others alone, and the order of loading is of no matter."""
    write_build(engine, small_build("delft"))
    write_build(engine, small_build("leiden", shift=1000))
    before = list(canonical_dump(engine))
    write_build(engine, small_build("delft", version="9"))
    assert list(canonical_dump(engine)) != before
    assert write_build(engine, small_build("leiden", shift=1000)).status == "unchanged"
    write_build(engine, small_build("delft"))
    assert list(canonical_dump(engine)) == before
    with pytest.raises(InputError, match=r"2 surveys.*delft; leiden"):
        read_parts(engine)
    assert read_parts(engine, "leiden")["part_id"].min() == PODIUM + 1000


def test_a_survey_has_one_run(engine: Engine) -> None:
    """Building it again with other detectors replaces it, there and back, and the run keeps its key."""
    both = write_build(engine, small_build())
    before = list(canonical_dump(engine))
    one = write_build(engine, small_build(method="multiscale"))
    assert (one.status, one.run_id) == ("replaced", both.run_id)
    assert list_runs(engine)["methods"].tolist() == ["multiscale"]
    assert_same_build(read_build(engine, "delft"), small_build(method="multiscale"))
    assert read_flat_regions(engine).empty
    assert read_candidates(engine).empty
    assert read_buildings(engine)[["flat_share", "area3d_share", "adaptive_share"]].isna().all(axis=None)
    assert write_build(engine, small_build()).status == "replaced"
    assert list(canonical_dump(engine)) == before
    second = text("INSERT INTO run SELECT 1, survey_id, '', '', '{}', '{}', '{}', '[]', '' FROM run")
    with pytest.raises(IntegrityError), engine.begin() as connection:
        connection.execute(second)


def test_flat_regions_and_parts_go_with_their_links(engine: Engine) -> None:
    """A link needs both of its ends, and goes with either."""
    write_build(engine, small_build())
    count = text("SELECT count(*) FROM part_flat_region")
    with engine.begin() as connection:
        connection.execute(text("DELETE FROM flat_region WHERE region_id = :region"), {"region": WING})
        assert connection.scalar(count) == 4
        connection.execute(text("DELETE FROM part WHERE part_id = :part"), {"part": LIFT})
        assert connection.scalar(count) == 3
    for column, number in (("part_id", LIFT), ("region_id", WING), ("run_id", 1)):
        change = text(f"UPDATE part_flat_region SET {column} = :number WHERE part_id = :part")
        with pytest.raises(IntegrityError), engine.begin() as connection:
            connection.execute(change, {"number": number, "part": SLAB})


def test_candidates_go_with_their_links(engine: Engine) -> None:
    """A link goes with either of its ends, and needs both."""
    write_build(engine, small_build())
    with engine.begin() as connection:
        connection.execute(text("DELETE FROM candidate_region WHERE method = 'adaptive'"))
        connection.execute(text("DELETE FROM flat_region WHERE region_id = :region"), {"region": WING})
        connection.execute(text("DELETE FROM part WHERE part_id = :part"), {"part": LIFT})
    assert read_tables(engine, [PART_CANDIDATE])["part_candidate"]["part_id"].tolist() == [PODIUM, SLAB, BLOCK]
    assert read_tables(engine, [FLAT_REGION_CANDIDATE])["flat_region_candidate"]["region_id"].tolist() == [SLAB_ROOF]
    for table, column in (("part_candidate", "candidate_id"), ("flat_region_candidate", "region_id")):
        with pytest.raises(IntegrityError), engine.begin() as connection:
            connection.execute(text(f"UPDATE {table} SET {column} = 4711"))


CANDIDATES = {
    "another detector": "method = 'multiscale'",
    "no rule": "rule = ''",
    "a height scale of the adaptive filter": "method = 'adaptive'",
    "no points": "points = 0",
    "a direction beyond the half circle": "direction_1 = 181",
    "a linearity above 1": "linearity = 1.5",
    "an NDVI below -1": "ndvi = -2",
    "no area": "area_m2 = 0",
    "a run that does not exist": "run_id = 1",
}


@pytest.mark.parametrize("case", CANDIDATES)
def test_the_database_itself_refuses_wrong_candidates(engine: Engine, case: str) -> None:
    """Checks hold what the columns mean, whoever writes."""
    write_build(engine, small_build())
    change = text(f"UPDATE candidate_region SET {CANDIDATES[case]} WHERE candidate_id = :candidate")
    with pytest.raises(IntegrityError), engine.begin() as connection:
        connection.execute(change, {"candidate": TERRACE})


def test_a_build_without_buildings_is_stored(engine: Engine) -> None:
    """A flat field gives an empty but valid database."""
    build = small_build()
    frames = {name: frame if name == "scale" else frame[:0] for name, frame in build.frames.items()}
    empty = replace(build, frames=frames)
    assert write_build(engine, empty).rows["part"] == 0
    assert_same_build(read_build(engine), empty)
    assert write_build(engine, empty).status == "unchanged"


@pytest.mark.parametrize("buildings", [True, False])
def test_a_summary_counts_the_rows_of_the_frames(engine: Engine, buildings: bool) -> None:
    """Counted by SQL, the numbers are those of the tables that were read."""
    build = small_build()
    if not buildings:
        build = replace(build, frames={name: frame.iloc[:0] for name, frame in build.frames.items()})
    write_build(engine, build)
    found, read = summarise_run(engine), read_build(engine)
    frames = read.frames
    assert (found.survey, found.run) == (read.survey, read.run)
    assert found.rows == {name: len(frames[name]) for name in ("part", "building", "flat_region")}
    assert found.rejected == frames["rejection_count"]["regions"].sum()
    assert found.candidates == read.candidate_counts
    assert found.footprint_m2 == pytest.approx(frames["building"]["area_m2"].sum())
    assert found.volume_m3 == pytest.approx(frames["building"]["volume_m3"].sum())
    assert found.highest_m == (frames["building"]["h_max"].max() if buildings else None)
    assert found.scales_m2 == frames["scale"].sort_values("scale")["threshold_m2"].tolist()


def test_a_missing_raster_is_named(engine: Engine) -> None:
    """The error has the survey, the missing rasters and the next step."""
    write_build(engine, small_build())
    with engine.begin() as connection:
        connection.execute(text("DELETE FROM run_state WHERE name = 'valid'"))
    with pytest.raises(TableError, match=r"survey 'delft' .* needs the rasters ndsm_cm, structure, valid; .* db check"):
        read_rasters(engine)


def test_polygons_become_multipolygons(engine: Engine) -> None:
    """Single outlines are stored as the declared type."""
    build = small_build()
    parts = build.frames["part"]
    single = parts.set_geometry([shape.geoms[0] for shape in parts["geometry"]], crs=EPSG)
    write_build(engine, replace(build, frames={**build.frames, "part": single}))
    assert_same_build(read_build(engine), build)
    assert write_build(engine, build).status == "unchanged"


def test_words_stay_words(engine: Engine) -> None:
    """Names with quotes, SQL, wildcards and foreign letters are data."""
    name = 'Robert\'); DROP TABLE part; -- "x" %s :run ? ø\\n日本'
    write_build(engine, small_build(name, notices=("a 'quoted' \"sentence\"; --", "tab\tand\nline")))
    assert list_runs(engine)["survey"].tolist() == [name]
    assert read_build(engine, name).run.notices == ("a 'quoted' \"sentence\"; --", "tab\tand\nline")
    with pytest.raises(InputError, match="has no survey"):
        read_parts(engine, "' OR 1=1 --")


BAD = {
    "an orphan": ("part", {"row": 1, "supid": 4711}, "father that does not exist"),
    "a missing height": ("part", {"h_max": np.nan}, "h_max is missing"),
    "an infinite area": ("building", {"area_m2": np.inf}, "area_m2 is missing or infinite"),
    "an unknown scale": ("part", {"scale": 9}, "scale refers to no row"),
    "an unknown class": ("building", {"speindex": 9}, "speindex refers to no row"),
    "a part without building": ("part", {"row": 5, "building_id": SLAB}, "building_id refers to no row"),
    "a part in another building": ("part", {"row": 1, "building_id": HOUSE}, "in another building than its father"),
    "a scale given twice": ("scale", {"scale": 2}, "scale is given twice"),
    "a flat region given twice": ("flat_region", {"region_id": WING}, "region_id is given twice"),
    "a link given twice": (
        "part_flat_region",
        {"row": 1, "part_id": PODIUM},
        "part_id with region_id is given twice",
    ),
    "a link to no part": ("part_flat_region", {"part_id": 4711}, "part_id refers to no row"),
    "a link to no flat region": ("part_flat_region", {"region_id": 4711}, "region_id refers to no row"),
    "an infinite perimeter": ("flat_region", {"perimeter_m": np.inf}, "perimeter_m is missing or infinite"),
    "a candidate given twice": ("candidate_region", {"candidate_id": CRANE}, "candidate_id is given twice"),
    "a candidate of no detector of the run": ("candidate_region", {"method": "multiscale"}, "method refers to no row"),
    "a region dropped by no detector": ("rejection", {"method": "other"}, "method refers to no row"),
    "a candidate without points": ("candidate_region", {"area_m2": np.nan}, "area_m2 is missing"),
    "a link to no candidate": ("part_candidate", {"candidate_id": 4711}, "candidate_id refers to no row"),
    "a link of no part": ("part_candidate", {"part_id": 4711}, "part_id refers to no row"),
    "a link of no flat region": ("flat_region_candidate", {"region_id": 4711}, "region_id refers to no row"),
    "a flat region linked to no candidate": (
        "flat_region_candidate",
        {"candidate_id": 4711},
        "candidate_id refers to no row",
    ),
    "no geometry": ("part", {"geometry": None}, "is no MULTIPOLYGON"),
    "a line": ("part", {"geometry": shapely.LineString([(0, 0), (1, 1)])}, "is no MULTIPOLYGON"),
    "an empty geometry": ("building", {"geometry": shapely.MultiPolygon()}, "is empty"),
    "a bow tie": ("part", {"geometry": shapely.Polygon([(0, 0), (1, 1), (1, 0), (0, 1)])}, "is not valid"),
}


@pytest.mark.parametrize("case", BAD)
def test_what_breaks_the_declaration_is_refused_by_name(tmp_path, empty_file, case: str) -> None:
    """The error names the table, the rule and the row, before anything is written."""
    engine = open_database(shutil.copy(empty_file(EPSG), tmp_path / "city.sqlite"))
    table, columns, message = BAD[case]
    before = list(canonical_dump(engine))
    with pytest.raises(TableError, match=message):
        write_build(engine, changed(small_build(), table, **columns))
    assert list(canonical_dump(engine)) == before


def test_missing_tables_and_names_are_refused(tmp_path) -> None:
    """A build has all tables, a survey's name and a method."""
    engine = open_database(tmp_path / "city.sqlite", create=True, srid=EPSG)
    build = small_build()
    with pytest.raises(TableError, match="needs the tables"):
        write_build(engine, replace(build, frames={"part": build.frames["part"]}))
    with pytest.raises(InputError, match="name"):
        write_build(engine, small_build(" "))
    for method in ("", "multiscale,flatregions", "multiscale,multiscale", "multiscale,", "other"):
        with pytest.raises(InputError, match="alphabetical order"):
            write_build(engine, small_build(method=method))


def test_refused_rows_leave_everything_as_it_was(engine: Engine) -> None:
    """Ids that another survey holds are refused by the database, and nothing of the build stays."""
    write_build(engine, small_build("delft"))
    before = list(canonical_dump(engine))
    with pytest.raises(LoadError, match="refused"):
        write_build(engine, small_build("leiden"))
    with pytest.raises(LoadError, match="refused"):
        write_build(engine, changed(small_build("delft", version="2"), "building", state="perhaps"))
    assert list(canonical_dump(engine)) == before


FOREST = {
    "a father that does not exist": "supid = 4711",
    "a father of another scale": "supscale = 2, scale = 3",
    "a father of another tree": f"root_id = {HOUSE}",
    "a father on no coarser scale": "scale = 1",
    "a child without SUPSCALE": "supscale = 0",
    "a root in another's tree": "supid = 0, supscale = 0",
    "a scale that does not exist": "scale = 9",
    "a class that does not exist": "speindex = 9",
    "a run that does not exist": "run_id = 1",
    "no area": "area_m2 = 0",
}


def test_the_database_itself_holds_the_forest(engine: Engine) -> None:
    """Keys and checks refuse a broken tree, whoever writes it."""
    write_build(engine, small_build())
    for change in FOREST.values():
        update = text(f"UPDATE part SET {change} WHERE part_id = :part")
        with pytest.raises(IntegrityError), engine.begin() as connection:
            connection.execute(update, {"part": SLAB})
    assert_same_build(read_build(engine), small_build())


def test_a_father_with_children_cannot_be_deleted(engine: Engine) -> None:
    """Deleting a survey deletes all that it made; deleting a father alone is refused."""
    write_build(engine, small_build())
    with pytest.raises(IntegrityError), engine.begin() as connection:
        connection.execute(text("DELETE FROM part WHERE part_id = :part"), {"part": SLAB})
    with engine.begin() as connection:
        connection.execute(text("DELETE FROM survey WHERE name = 'delft'"))
    with engine.connect() as connection:
        for table in sorted(set(METADATA.tables)):
            assert connection.scalar(text(f"SELECT count(*) FROM {table}")) == 0


def test_readers_see_the_old_state_until_the_commit(engine: Engine) -> None:
    """A reader is neither disturbed by a writer nor shown half of its work."""
    write_build(engine, small_build())
    count = text("SELECT count(*) FROM part")
    with dialect_of(engine.url).writing(engine) as writer:
        writer.execute(text("DELETE FROM run"))
        assert writer.scalar(count) == 0
        with engine.connect() as reader:
            assert reader.scalar(count) == 6
    with engine.connect() as reader:
        assert reader.scalar(count) == 0


def test_a_reader_that_stays_keeps_its_state(engine: Engine) -> None:
    """An open reader does not stop a writer that began, and the file is whole afterwards."""
    write_build(engine, small_build())
    count = text("SELECT count(*) FROM rejection")
    with dialect_of(engine.url).writing(engine) as writer:
        # A plain PostgreSQL reader sees each commit at once; SQLite keeps a reader's state by itself.
        level = {"isolation_level": "REPEATABLE READ"} if engine.dialect.name == "postgresql" else {}
        reader = engine.connect().execution_options(**level)
        assert reader.scalar(count) == 3
        writer.execute(text("DELETE FROM rejection"))
    assert reader.scalar(count) == 3
    reader.close()
    with engine.connect() as later:
        assert later.scalar(count) == 0
    assert write_build(engine, small_build()).status == "replaced"


def test_a_file_at_rest_is_one_file(tmp_path) -> None:
    """After a load there is no journal beside the file, so that it opens on read-only media."""
    engine = open_database(tmp_path / "city.sqlite", create=True, srid=EPSG)
    write_build(engine, small_build())
    assert [p.name for p in tmp_path.iterdir()] == ["city.sqlite"]
    with engine.connect() as connection:
        assert connection.scalar(text("PRAGMA journal_mode")) == "delete"


def test_the_dump_is_the_content_and_nothing_else(engine: Engine) -> None:
    """Timings stay out; a metre of height shows."""
    write_build(engine, small_build())
    before = list(canonical_dump(engine))
    assert not any('"timings"' in line or '"read"' in line for line in before)
    assert '["scale", ' in "".join(before)
    write_build(engine, changed(small_build(), "building", h_max=22.5))
    after = list(canonical_dump(engine))
    assert sum(one != two for one, two in zip(before, after, strict=True)) == 1


@pytest.mark.postgis
def test_both_dialects_dump_the_same(tmp_path, new_postgis) -> None:
    """The content is equal line by line, the views row by row."""
    engines = [open_database(t, create=True, srid=EPSG) for t in (tmp_path / "city.sqlite", new_postgis())]
    for engine in engines:
        write_build(engine, small_build("Ävila"))
        write_build(engine, small_build("a b", shift=1000))
        write_build(engine, small_build("A c", shift=2000))
    one, two = (list(canonical_dump(engine)) for engine in engines)
    assert one == two
    for view, key in ((view.name, view.key) for view in VIEWS if view.base in FILLED):
        frames = []
        for engine in engines:
            with engine.connect() as connection:
                rows = connection.execute(text(f"SELECT * FROM {view} ORDER BY {key}")).mappings().all()
            frames.append([{name: value for name, value in row.items() if name != "geometry"} for row in rows])
        assert frames[0] == frames[1]
        # Without an inventory there are no parts of one.
        assert bool(frames[0]) == (view != "part_current")


def test_views_show_the_trees(engine: Engine) -> None:
    """Footprints are the buildings, the tree has depths and paths, and the summary estimates floor areas."""
    write_build(engine, small_build())
    with engine.connect() as connection:
        roots = connection.execute(text("SELECT building_id, state, trees FROM footprint ORDER BY building_id")).all()
        tree = connection.execute(text("SELECT part_id, depth, path FROM part_tree ORDER BY part_id")).all()
        floors = connection.execute(text("SELECT floor_area_m2 FROM building_summary ORDER BY building_id")).all()
    assert roots == [(building, "confirmed", 1) for building in (PODIUM, HOUSE, BLOCK, SHED)]
    assert tree[2] == (LIFT, 2, f"{PODIUM}/{SLAB}/{LIFT}")
    assert [depth for _, depth, _ in tree] == [0, 1, 2, 0, 0, 0]
    assert [area for (area,) in floors] == [3 * 1200 + 3 * 200 + 20, 200, 3200, 30]


def test_views_show_what_parts_and_flat_regions_say_of_each_other(engine: Engine) -> None:
    """A part has its flat share; a region is explained by the roots on it alone; without extraction all is null."""
    write_build(engine, small_build())
    write_build(engine, small_build("leiden", "multiscale", shift=1000))
    evidence = "SELECT part_id, flat_share, flat_regions FROM part_evidence WHERE survey = :survey ORDER BY part_id"
    unexplained = "SELECT region_id, explained_share FROM unexplained_flat_region ORDER BY region_id"
    with engine.connect() as connection:
        found = connection.execute(text(evidence), {"survey": "delft"}).all()
        unknown = connection.execute(text(evidence), {"survey": "leiden"}).all()
        left = connection.execute(text(unexplained)).all()
        shares = connection.scalars(text("SELECT flat_share FROM building_summary ORDER BY building_id")).all()
    assert [part for part, *_ in found] == [PODIUM, SLAB, LIFT, HOUSE, BLOCK, SHED]
    assert [share for _, share, _ in found] == [1 / 6, 1, 1, 0.2, 0.375, 0]
    assert [regions for *_, regions in found] == [1, 1, 1, 1, 1, 0]
    assert {row[1:] for row in unknown} == {(None, None)}
    assert left == [(DECK, 0.25), (PITCH, 0.0)]
    assert shares == [1 / 6, 0.2, 0.375, 0, None, None, None, None]


def test_views_show_evidence_of_the_detectors_on_points(engine: Engine) -> None:
    """Shares by method of parts and of candidates; null where a detector was not run."""
    write_build(engine, small_build())
    write_build(engine, small_build("leiden", "area3d", shift=1000))
    write_build(engine, small_build("gouda", "multiscale", shift=2000))
    parts = "SELECT part_id, area3d_share, area3d_regions, adaptive_share, adaptive_regions FROM part_evidence"
    regions = "SELECT candidate_id, method, explained_share, flat_share FROM candidate_evidence"
    of = " WHERE survey = :survey ORDER BY 1"
    with engine.connect() as connection:
        found = connection.execute(text(parts + of), {"survey": "delft"}).all()
        unknown = connection.execute(text(parts + of), {"survey": "gouda"}).all()
        candidates = connection.execute(text(regions + of), {"survey": "delft"}).all()
        alone = connection.execute(text(regions + of), {"survey": "leiden"}).all()
        left = connection.execute(
            text("SELECT candidate_id, explained_share FROM unexplained_candidate" + of), {"survey": "delft"}
        ).all()
    assert found == [
        (PODIUM, 1, 1, pytest.approx(0.25), 2),
        (SLAB, 1, 1, 1, 1),
        (LIFT, 1, 1, 1, 1),
        (HOUSE, 0, 0, 1, 1),
        (BLOCK, 0.375, 1, 0, 0),
        (SHED, 0, 0, 0.5, 1),
    ]
    assert {row[1:] for row in unknown} == {(None,) * 4}
    assert candidates == [
        (TERRACE, "area3d", 1, pytest.approx(1 / 6)),
        (SOUTH_WING, "area3d", 1, 1),
        (CRANE, "area3d", 0, 0),
        (SLAB_CLUSTER, "adaptive", 1, 1),
        (AWNING, "adaptive", 0.25, 0),
        (HOUSE_CLUSTER, "adaptive", 1, 0.2),
        (SHED_CLUSTER, "adaptive", 1, 0),
        (PITCH_CLUSTER, "adaptive", 0, 1),
    ]
    assert [row[2:] for row in alone] == [(None, None)] * 3
    assert left == [(CRANE, 0), (AWNING, 0.25), (PITCH_CLUSTER, 0)]


def test_a_building_shows_its_evidence(engine: Engine) -> None:
    """The number of other detectors that were run, and of those that cover enough of it to confirm it."""
    write_build(engine, small_build())
    write_build(engine, small_build("leiden", "flatregions,multiscale", shift=1000))
    build = changed(small_build("gouda", "multiscale", shift=2000), "building", 1, building_share=0.4375)
    write_build(engine, build)
    query = "SELECT survey, classes_for, extractors_heard, extractors_for FROM building_evidence ORDER BY building_id"
    with engine.connect() as connection:
        found = connection.execute(text(query)).all()
    assert found == [
        *(("delft", 1, 3, witnesses) for witnesses in (3, 2, 2, 1)),
        *(("leiden", 1, 1, witnesses) for witnesses in (1, 1, 1, 0)),
        *(("gouda", classes, 0, 0) for classes in (1, 0, 1, 1)),
    ]


def test_half_a_region_is_enough(engine: Engine) -> None:
    """The threshold itself explains; parts below the root do not add to it."""
    build = changed(small_build(), "part_flat_region", 3, region_share=0.5)
    write_build(engine, changed(build, "part_flat_region", 0, region_share=0.4375))
    with engine.connect() as connection:
        left = connection.scalars(text("SELECT region_id FROM unexplained_flat_region ORDER BY region_id")).all()
    assert left == [SLAB_ROOF, PITCH]


def test_frames_of_plain_pandas_are_taken(engine: Engine) -> None:
    """Geometries may come in a plain frame."""
    build = small_build()
    plain = {name: pd.DataFrame(frame) for name, frame in build.frames.items()}
    assert not any(isinstance(frame, gpd.GeoDataFrame) for frame in plain.values())
    write_build(engine, replace(build, frames=plain))
    assert_same_build(read_build(engine), build)


def test_the_sign_of_zero_is_no_content(engine: Engine) -> None:
    """SQLite keeps -0.0 as 0.0: a build with either has the digest of its rows, and is the same to the next build."""
    build = small_build()
    frames = {name: frame.copy() for name, frame in build.frames.items()}
    level = np.zeros(len(frames["building"]))
    signed = {name: frame.copy() for name, frame in frames.items()}
    frames["building"]["z_ground"], signed["building"]["z_ground"] = level, -level
    frames["part"]["h_std"], signed["part"]["h_std"] = 0.0, -0.0
    west = (0.0, *build.survey.bounds[1:])
    survey = replace(build.survey, bounds=west), replace(build.survey, bounds=(-0.0, *west[1:]))
    run = replace(build.run, parameters={"a": 0.0}), replace(build.run, parameters={"a": -0.0})
    plain = replace(build, frames=frames, survey=survey[0], run=run[0])
    assert write_build(engine, replace(build, frames=signed, survey=survey[1], run=run[1])).status == "created"
    assert [found for found in check_database(engine) if found.check == "content"] == []
    assert write_build(engine, plain).status == "unchanged"
