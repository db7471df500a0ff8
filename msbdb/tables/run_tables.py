"""The tables of a survey and its run: provenance, detectors, rasters, scales, classes, and the rejected regions."""

from dataclasses import replace

from msbdb.params import DETECTORS
from msbdb.tables.declaration import (
    RUN_ID,
    RUN_KEY,
    Check,
    Column,
    Index,
    KeyReference,
    Table,
    Unique,
    one_of,
    only_stored,
)

CLASS_LABELS = ("building", "vegetation", "shadow", "water", "other")
"""The information classes (V36)."""

LABELLERS = ("automatic", "operator")
CLASS_SOURCES = ("spectral", "structure")

SURVEY = Table(
    "survey",
    "A survey: where and when the data were taken",
    only_stored(
        Column("survey_id", "int64", "-", "from the name", primary=True),
        Column("name", "str", "-", "name of the survey"),
        Column("date", "str", "-", "day of the survey, ISO 8601; empty where unknown"),
        Column("epsg", "int32", "-", "EPSG code of the horizontal CRS; 0 for a CRS without code"),
        Column("crs_wkt", "str", "-", "the full CRS as WKT"),
        Column("vertical_crs", "str", "-", "the vertical CRS; empty where unknown"),
        Column("density", "float64", "1/m2", "first echoes a square metre; 0 for rasters"),
        Column("cell_m", "float64", "m", "side of a cell of the lattice"),
        Column("west", "float64", "m", "western edge"),
        Column("south", "float64", "m", "southern edge"),
        Column("east", "float64", "m", "eastern edge"),
        Column("north", "float64", "m", "northern edge"),
    ),
    rules=(
        Unique(("name",)),
        Check("name", "name <> ''"),
        Check("density", "density >= 0 AND cell_m > 0"),
        Check("bounds", "west < east AND south < north"),
    ),
)

SOURCE = Table(
    "source",
    "An input file of a survey",
    only_stored(
        Column("survey_id", "int64", "-", "the survey", primary=True, refers="survey.survey_id", cascade=True),
        Column("number", "int32", "-", "1 to n, in the order of role, name and checksum", primary=True),
        Column("name", "str", "-", "name of the file"),
        Column("role", "str", "-", "what the file provides: points, ortho, dsm, dtm, ndsm, parcels, aoi"),
        Column("sha256", "str", "-", "checksum of the file"),
        Column("bytes", "int64", "bytes", "size of the file"),
    ),
    rules=(Check("bytes", "bytes >= 0"),),
)

RUN = Table(
    "run",
    "The run that built a survey; a survey has one run, written completely or not at all",
    only_stored(
        Column("run_id", "int64", "-", "from the survey's name", primary=True),
        Column("survey_id", "int64", "-", "the survey", refers="survey.survey_id", cascade=True),
        Column("profile", "str", "-", "the profile: the named set of parameters that it started from"),
        Column("version", "str", "-", "version of msbdb"),
        Column("parameters", "json", "-", "every parameter's value, by section"),
        Column("counts", "json", "-", "how many regions came in, were kept and dropped"),
        Column("timings", "json", "s", "seconds of each stage; not part of the content"),
        Column("notices", "json", "-", "warnings and remarks for people, in sentences"),
        Column("content_sha256", "str", "-", "digest of all content of the run except its timings"),
    ),
    indexes=(Index(("survey_id",), unique=True),),
)

RUN_METHOD = Table(
    "run_method",
    "A detector of a run",
    (
        RUN_KEY,
        *only_stored(Column("method", "str", "-", ", ".join(DETECTORS[:-1]) + " or " + DETECTORS[-1], primary=True)),
    ),
    rules=(one_of("method", DETECTORS),),
)

RUN_STATE = Table(
    "run_state",
    "A named raster of a run, by which classes can be labelled again without the source data",
    (
        RUN_KEY,
        *only_stored(
            Column("name", "str", "-", "name of the raster", primary=True),
            Column("dtype", "str", "-", "numpy dtype of the cells, with byte order"),
            Column("shape", "json", "cells", "lengths of the axes"),
            Column("data", "bytes", "-", "the cells in C order, packed as in msbdb.database.runs.packing"),
        ),
    ),
)

SURVEY_PLAN = Table(
    "survey_plan",
    "The plan by which a run was built: values that hold for the whole survey, and for each tile of it",
    (
        RUN_KEY,
        *only_stored(Column("plan", "json", "-", "the plan, as msbdb plan --json shows it")),
    ),
)

RASTER_TILE = Table(
    "raster_tile",
    "A tile's piece of a named raster of a run that was built in tiles; together they are a raster as in run_state",
    (
        RUN_KEY,
        *only_stored(
            Column("name", "str", "-", "name of the raster", primary=True),
            Column("lattice_row", "int64", "cells", "row of its first cell, southwards from northing 0", primary=True),
            Column("lattice_column", "int64", "cells", "column of its first cell, from easting 0", primary=True),
            Column("dtype", "str", "-", "numpy dtype of the cells, with byte order"),
            Column("shape", "json", "cells", "lengths of the axes"),
            Column("data", "bytes", "-", "the cells in C order, packed as in msbdb.database.runs.packing"),
        ),
    ),
)

TILE_STATES = ("queued", "running", "done", "failed")

TILE = Table(
    "tile",
    "A tile of a survey that is built in tiles: how far it is; its result waits here until all tiles are merged",
    only_stored(
        Column("survey", "str", "-", "name of the survey, which may not be built yet", primary=True),
        Column("tile_row", "int64", "-", "row of the tile, northwards from northing 0", primary=True),
        Column("tile_column", "int64", "-", "column of the tile, from easting 0", primary=True),
        Column("west", "float64", "m", "western edge of its own ground"),
        Column("south", "float64", "m", "southern edge"),
        Column("east", "float64", "m", "eastern edge"),
        Column("north", "float64", "m", "northern edge"),
        Column("state", "str", "-", "queued, running, done or failed"),
        Column("points", "int64", "count", "points on its own ground"),
        Column("halo_m", "float64", "m", "how far it saw beyond"),
        Column("seconds", "float64", "s", "time that it took"),
        Column("reason", "str", "-", "why it failed, or has no building; empty otherwise"),
        Column("build", "str", "-", "digest of the files, values and plan of the build that it belongs to"),
        Column("result", "bytes", "-", "what it found, until it is merged", nullable=True),
    ),
    rules=(
        Check("tile_bounds", "west < east AND south < north"),
        one_of("state", TILE_STATES),
    ),
)

SCALE = Table(
    "scale",
    "A scale of a run's scale-space",
    (
        RUN_KEY,
        Column("scale", "int64", "-", "SCALE: number of the scale, 1 = coarsest", primary=True),
        Column("threshold_px", "int64", "cells", "s: area threshold of opening and closing (Vu et al. 2009, Eq. 6)"),
        Column("threshold_m2", "float64", "m2", "s in square metres"),
    ),
    rules=(
        Check("scale", "scale >= 1"),
        Check("threshold", "threshold_px >= 1 AND threshold_m2 > 0"),
    ),
)

SPECTRAL_CLASS = Table(
    "spectral_class",
    "A class of land cover of a run",
    (
        RUN_KEY,
        Column("speindex", "int64", "-", "SPE: number of the class, from 1 in canonical order", primary=True),
        Column("label", "str", "-", "building, vegetation, shadow, water or other"),
        Column("labelled_by", "str", "-", "automatic or operator"),
        Column("source", "str", "-", "spectral: k-means on the bands; structure: height texture and echoes"),
        Column("cells", "int64", "cells", "number of cells of the class"),
        Column("share", "float64", "1", "share of all classified cells"),
        Column(
            "ndvi",
            "float64",
            "1",
            "mean of (NIR - red) / (NIR + red), or of its substitute; null without bands",
            nullable=True,
        ),
        Column(
            "brightness",
            "float64",
            "1",
            "mean over all bands of the values scaled to 0 to 1; null without imagery",
            nullable=True,
        ),
        Column(
            "roughness_m", "float64", "m", "median local roughness of the surface; null where unknown", nullable=True
        ),
        Column("height_m", "float64", "m", "mean height above ground"),
    ),
    rules=(
        Check("speindex", "speindex >= 1"),
        Check("cells", "cells >= 0 AND share >= 0"),
        one_of("label", CLASS_LABELS),
        one_of("labelled_by", LABELLERS),
        one_of("source", CLASS_SOURCES),
    ),
)

SPECTRAL_CLASS_BAND = Table(
    "spectral_class_band",
    "The mean of a band in a class",
    (
        replace(RUN_KEY, refers="", cascade=False),
        Column("speindex", "int64", "-", "the class", primary=True),
        Column("band", "str", "-", "name of the band", primary=True),
        Column("mean", "float64", "DN", "mean value of the band in the class, in the source's units"),
    ),
    rules=(KeyReference(("run_id", "speindex"), "spectral_class", ("run_id", "speindex"), cascade=True),),
)

REJECTION = Table(
    "rejection",
    "The ledger: a region that could have been a building by its area, but that a stage dropped, and the reason",
    (
        Column(
            "rejection_id",
            "int64",
            "-",
            "from the run, the region, the method, the stage and the reason",
            primary=True,
            in_frame=False,
        ),
        RUN_ID,
        Column("region_id", "int64", "-", "id of the dropped region, of the same kind as a part's"),
        Column("method", "str", "-", "the detector that dropped it: multiscale, flatregions, area3d or adaptive"),
        Column("stage", "str", "-", "the stage of the method that dropped it"),
        Column("reason", "str", "-", "why it was dropped"),
        Column("scale", "int64", "-", "its scale; 0 where none applies"),
        Column("area_m2", "float64", "m2", "its area"),
        Column("xcen", "float64", "m", "easting of its centroid"),
        Column("ycen", "float64", "m", "northing of its centroid"),
    ),
    rules=(
        one_of("method", DETECTORS),
        Check("reason", "stage <> '' AND reason <> ''"),
        Check("area", "scale >= 0 AND area_m2 >= 0"),
    ),
    indexes=(Index(("run_id", "method", "stage", "reason")),),
    geometry="POINT",
)

REJECTION_COUNT = Table(
    "rejection_count",
    "The ledger in numbers: the regions that a detector dropped at a stage for a reason, those without a row included",
    (
        RUN_KEY,
        Column("method", "str", "-", "the detector: multiscale, flatregions, area3d or adaptive", primary=True),
        Column(
            "number",
            "int64",
            "-",
            "number of the stage and reason among those of the detector, from 1; the value in its raster of answers",
            primary=True,
        ),
        Column("stage", "str", "-", "the stage that dropped them"),
        Column("reason", "str", "-", "why they were dropped"),
        Column("regions", "int64", "count", "number of the dropped regions"),
        Column("area_m2", "float64", "m2", "their area"),
        Column(
            "small",
            "int64",
            "count",
            "number of those smaller than the least building area, which have no row in rejection",
        ),
        Column("small_m2", "float64", "m2", "the area of these"),
    ),
    rules=(
        one_of("method", DETECTORS),
        Check("number", "number >= 1 AND number <= 255"),
        Check("reason", "stage <> '' AND reason <> ''"),
        Check("regions", "regions >= 1 AND small >= 0 AND small <= regions"),
        Check("area", "small_m2 >= 0 AND area_m2 >= small_m2"),
    ),
)
