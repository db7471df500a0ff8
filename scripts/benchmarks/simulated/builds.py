"""Small synthetic builds for tests: four buildings with known trees, one courtyard, and one dropped tree crown.

On a lattice of 1 m cells, with the origin at ``WEST``, ``SOUTH``:

- A, a podium of 40 x 30 m with 3 storeys, on it a slab of 20 x 10 m with 6, on it a lift house of 4 x 5 m with 7;
- B, a house of 10 x 10 m with 2 storeys;
- C, a block of 30 x 30 m with 4 storeys around a courtyard of 10 x 10 m;
- D, a shed of 6 x 5 m with 1 storey, found on the finest scale only, 300 m to the east.

Flat regions lie on the slab (all of it), on the block's southern wing of 30 x 10 m, on 8 x 10 m of which a quarter is
the house's, and on 20 x 30 m without any part; none lies on the shed.

Candidate regions of area3d lie on the podium (all of it), on the block's southern wing, and on a crane of 10 x 10 m;
those of the adaptive filter on the slab, on an awning of 40 x 10 m of which a quarter is the podium's, on the house,
on half of the shed, and on half of the flat region without any part.
"""

from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from typing import Any

import geopandas as gpd
import numpy as np
import pandas as pd
import shapely
from pyproj import CRS

from msbdb.kept import PER_METRE, KeptRun, Rasters
from msbdb.ledger import sum_up
from msbdb.params import POINT_DETECTORS
from msbdb.tables import (
    BUILDING,
    CANDIDATE_REGION,
    EXTRACTOR_SHARES,
    FLAT_REGION,
    FLAT_REGION_CANDIDATE,
    PART,
    PART_CANDIDATE,
    PART_FLAT_REGION,
    REJECTION,
    REJECTION_COUNT,
    SCALE,
    SPECTRAL_CLASS,
    SPECTRAL_CLASS_BAND,
    Counts,
    Run,
    Source,
    Survey,
    Table,
)

EPSG = 28992
WEST, SOUTH = 85_000.0, 446_000.0
BASE = 2**58
"""First id: ids of real builds are as wide."""

PODIUM, SLAB, LIFT, HOUSE, BLOCK, SHED = (BASE + n for n in range(1, 7))
CROWN = BASE + 99
SLAB_ROOF, WING, DECK, PITCH = (BASE + n for n in range(201, 205))
"""The flat regions."""
TERRACE, SOUTH_WING, CRANE = (BASE + n for n in range(301, 304))
"""The candidate regions of area3d."""
SLAB_CLUSTER, AWNING, HOUSE_CLUSTER, SHED_CLUSTER, PITCH_CLUSTER = (BASE + n for n in range(304, 309))
"""The candidate regions of the adaptive filter."""

EVERY = "adaptive,area3d,flatregions,multiscale"
"""All detectors."""

HOSTILE = "x'; DROP TABLE part; --"
"""A name of a survey that is harmless only where it is quoted."""


def small_build(survey: str = "delft", method: str = EVERY, *, shift: int = 0, **run: Any) -> KeptRun:
    """Return the build of the module's text; ``shift`` moves all ids, for a second survey in the same database.

    A detector that is not in ``method`` has no regions, and buildings have null as its share. The frames are the
    caller's own.
    """
    made = _small_build(survey, method, shift)
    frames = {name: frame.copy() for name, frame in made.frames.items()}
    return replace(made, run=replace(made.run, **run), frames=frames)


@cache
def _small_build(survey: str, method: str, shift: int) -> KeptRun:
    methods = method.split(",")
    parts = _parts(shift)
    regions = _flat_regions(shift)
    if "flatregions" not in methods:
        regions = regions[:0]
    candidates = _candidates(shift)
    candidates = candidates[candidates["method"].isin(methods)].reset_index(drop=True)
    links = _links(parts, regions, PART_FLAT_REGION)
    part_candidates = _links(parts, candidates, PART_CANDIDATE)
    made_by = part_candidates["candidate_id"].map(candidates.set_index("candidate_id")["method"])
    links_of = {"flatregions": links} | {name: part_candidates[made_by == name] for name in POINT_DETECTORS}
    frames: dict[str, pd.DataFrame] = {
        "scale": _frame(SCALE, [(1, 200, 200.0), (2, 50, 50.0), (3, 20, 20.0)]),
        "part": parts,
        "spectral_class": _frame(
            SPECTRAL_CLASS,
            [
                (1, "vegetation", "automatic", "spectral", 500, 0.25, 0.61, 0.3, 1.2, 6.5),
                (2, "building", "automatic", "spectral", 1000, 0.5, -0.05, 0.6, 0.1, 9.0),
                (3, "building", "operator", "structure", 500, 0.25, np.nan, np.nan, 0.2, 5.0),
            ],
        ),
        "spectral_class_band": _frame(
            SPECTRAL_CLASS_BAND, [(k, band, 10.0 * k + n) for k in (1, 2, 3) for n, band in enumerate(("red", "nir"))]
        ),
        "rejection": _geo(
            REJECTION,
            [
                (CROWN + shift, "multiscale", "spectral", "vegetation", 3, 36.0, WEST + 150, SOUTH + 20),
                (CROWN + 1 + shift, "multiscale", "spectral", "vegetation", 2, 60.0, WEST + 160, SOUTH + 20),
                (PODIUM + 50 + shift, "multiscale", "duplicates", "same storeys", 2, 1150.0, WEST + 20, SOUTH + 15),
            ],
            [shapely.Point(WEST + x, SOUTH + y) for x, y in ((150, 20), (160, 20), (20, 15))],
        ),
        "building": _buildings(parts, {name: found for name, found in links_of.items() if name in methods}),
        "flat_region": regions,
        "part_flat_region": links,
        "candidate_region": candidates,
        "part_candidate": part_candidates,
        "flat_region_candidate": _links(regions, candidates, FLAT_REGION_CANDIDATE),
    }
    frames["rejection_count"] = ledger_counts(frames["rejection"])
    values: Mapping[str, Any] = {
        "methods": tuple(methods),
        "profile": "default",
        "version": "0.1.0",
        "parameters": {"scale": {"scales_m2": (20.0, 50.0, 200.0)}},
        "counts": counts_of(frames),
        "timings": {"read": 0.5},
        "notices": ("The heights were in feet.",),
    }
    return KeptRun(
        survey=Survey(
            name=survey,
            date="2020-04-01",
            crs_wkt=CRS.from_epsg(EPSG).to_wkt(),
            epsg=EPSG,
            vertical_crs="NAP height",
            density=10.5,
            cell_m=1.0,
            bounds=(WEST, SOUTH, WEST + 400, SOUTH + 100),
            sources=(
                Source("tile.laz", "points", "ab" * 32, 123_456_789_012),
                Source("ortho.tif", "ortho", "cd" * 32, 1000),
            ),
        ),
        run=Run(**values),
        frames=frames,
        rasters=slope((100, 400)),
    )


def big_build(count: int, *, epsg: int = EPSG, height_m: float = 6.0) -> KeptRun:
    """Return a build of so many buildings, each a root with one child, for loads that take a while."""
    base = small_build()
    cols = int(np.ceil(np.sqrt(count)))
    number = np.arange(count)
    west, south = WEST + (number % cols) * 20.0, SOUTH + (number // cols) * 20.0
    ids = BASE + number * 2
    rows = []
    for is_child, side in ((False, 10.0), (True, 5.0)):
        n = np.ones(count, dtype=np.int64)
        rows.append(
            pd.DataFrame(
                {
                    "part_id": ids + is_child,
                    "supid": ids * is_child,
                    "supscale": n * is_child,
                    "root_id": ids,
                    "building_id": ids,
                    "scale": n + is_child,
                    "hindex": n + is_child,
                    "hzone": n + is_child,
                    "speindex": n * 2,
                    "area_px": n * int(side**2),
                    "area_m2": side**2,
                    **dict.fromkeys(("xo", "xcen", "xin"), west + side / 2),
                    **dict.fromkeys(("yo", "ycen", "yin"), south + side / 2),
                    "stddis": np.nan if is_child else 0.0,
                    **dict.fromkeys(("h_max", "h_mean", "h_p50", "h_p90"), height_m),
                    "h_std": 0.0,
                    "building_share": 1.0,
                    "outline_source": "traced",
                    "geometry": shapely.box(west, south, west + side, south + side),
                }
            )
        )
    parts = pd.concat(rows, ignore_index=True)[[*PART.names, "geometry"]]
    evidence = (FLAT_REGION, PART_FLAT_REGION, CANDIDATE_REGION, PART_CANDIDATE, FLAT_REGION_CANDIDATE)
    none = {table.name: base.frames[table.name][:0] for table in evidence}
    links_of = dict.fromkeys(POINT_DETECTORS, none["part_candidate"]) | {"flatregions": none["part_flat_region"]}
    frames = {**base.frames, **none, "part": parts, "building": _buildings(parts, links_of)}
    lattice = max(-(-count // cols), 5), max(cols, 20)
    north, east = (20.0 * cells for cells in lattice)
    survey = replace(base.survey, epsg=epsg, cell_m=20.0, bounds=(WEST, SOUTH, WEST + east, SOUTH + north))
    level = np.full(lattice, round(height_m * PER_METRE), dtype=np.int32)
    rasters = Rasters(level, np.ones(lattice, dtype=np.bool_), np.zeros(lattice, dtype=np.uint8))
    return KeptRun(survey, replace(base.run, counts=counts_of(frames)), frames, rasters)


def ledger_counts(rejections: pd.DataFrame, least_m2: float = 0.0) -> pd.DataFrame:
    """Return the numbers of a ledger, each of whose regions has a row."""
    own = [sum_up(rows, REJECTION_COUNT.empty(), least_m2)[1] for _, rows in rejections.groupby("method")]
    return pd.concat([REJECTION_COUNT.empty(), *own], ignore_index=True)


LOST = (
    ("denoising", "sharp peak"),
    ("denoising", "steep valley"),
    ("ratio", "too rough for its size in every zone"),
    ("opening", "thinner than the opening"),
)
"""Stages and reasons of the ledger's rows in ``ledger_build``."""


def ledger_build(count: int, survey: str = "delft", *, shift: int = 0, north_m: float = 0.0, **run: Any) -> KeptRun:
    """Return the small build with a ledger of so many rows: single cells of 0.4 m on a square, in no order."""
    base = small_build(survey, shift=shift, **run)
    rng = np.random.default_rng(7)
    side = int(np.ceil(np.sqrt(2 * count)))
    row, col = np.divmod(rng.choice(side * side, count, replace=False), side)
    kind = rng.integers(0, len(LOST), count)
    x, y = WEST + 0.2 + 0.4 * col, SOUTH + 0.2 + 0.4 * row + north_m
    rows = pd.DataFrame(
        {
            "region_id": BASE + 1000 + shift + rng.permutation(count),
            "method": "flatregions",
            "stage": np.array([stage for stage, _ in LOST], dtype=object)[kind],
            "reason": np.array([reason for _, reason in LOST], dtype=object)[kind],
            "scale": 0,
            "area_m2": 0.16,
            "xcen": x,
            "ycen": y,
        }
    )
    ledger = rows.astype({c.name: c.dtype for c in REJECTION.columns})
    geo = gpd.GeoDataFrame(ledger, geometry=shapely.points(x, y), crs=f"EPSG:{EPSG}")
    frames = {**base.frames, "rejection": geo, "rejection_count": ledger_counts(geo)}
    return KeptRun(base.survey, replace(base.run, counts=counts_of(frames)), frames, base.rasters)


def counts_of(frames: Mapping[str, pd.DataFrame]) -> Counts:
    """Return counts that agree with the parts and the ledger: each stage keeps what will be parts."""
    kept = len(frames["part"])
    dropped = frames["rejection"].groupby(["method", "stage"]).size().to_dict() | {("multiscale", "fake fathers"): 0}
    regions: dict[str, dict[str, dict[str, int]]] = {}
    for (method, stage), rows in dropped.items():
        numbers = {"in": kept + rows, "pieces": 0, "kept": kept, "dropped": int(rows)}
        regions.setdefault(method, {})[stage] = numbers
    cells = {"all": 40_000, "valid": 40_000, "building": 13_333, "vegetation": 13_333}
    return Counts(regions, cells, {"colours_decide": 1, "green_decides": 0}, {})


def slope(shape: tuple[int, int]) -> Rasters:
    """Return rasters of a slope that falls by 20 cm a row to the north, with columns of each class by structure."""
    row, col = np.indices(shape)
    return Rasters((row * 20).astype(np.int32), np.ones(shape, dtype=np.bool_), (col % 3).astype(np.uint8))


def _box(west: float, south: float, width: float, height: float, hole: shapely.Polygon | None = None) -> Any:
    shape = shapely.box(WEST + west, SOUTH + south, WEST + west + width, SOUTH + south + height)
    return shapely.MultiPolygon([shape if hole is None else shape.difference(hole)])


def _parts(shift: int) -> gpd.GeoDataFrame:
    court = shapely.box(WEST + 90, SOUTH + 10, WEST + 100, SOUTH + 20)
    described = [
        # id, father, its scale, root, scale, storeys, class, outline
        (PODIUM, 0, 0, PODIUM, 1, 3, 2, _box(0, 0, 40, 30)),
        (SLAB, PODIUM, 1, PODIUM, 2, 6, 2, _box(5, 5, 20, 10)),
        (LIFT, SLAB, 2, PODIUM, 3, 7, 3, _box(10, 6, 4, 5)),
        (HOUSE, 0, 0, HOUSE, 2, 2, 2, _box(60, 10, 10, 10)),
        (BLOCK, 0, 0, BLOCK, 1, 4, 3, _box(80, 0, 30, 30, court)),
        (SHED, 0, 0, SHED, 3, 1, 0, _box(300, 40, 6, 5)),
    ]
    rows, shapes = [], []
    for part, father, supscale, root, scale, storeys, speindex, shape in described:
        moved = [i + shift if i else 0 for i in (part, father)]
        west, south, east, north = shape.bounds
        inside = shape.representative_point()
        area = shape.area
        places = (west + 0.5, north - 0.5, (west + east) / 2, (south + north) / 2, inside.x, inside.y)
        heights = (3.0 * storeys + 0.5, 3.0 * storeys, 3.0 * storeys, 3.0 * storeys + 0.25, 0.125)
        stddis = 0.0 if part in (PODIUM, SLAB) else np.nan
        rows.append(
            (
                *moved,
                supscale,
                root + shift,
                root + shift,
                scale,
                storeys,
                storeys,
                speindex,
                *places,
                int(area),
                area,
                stddis,
                *heights,
                0.875,
                "traced",
            )
        )
        shapes.append(shape)
    return _geo(PART, rows, shapes)


def _flat_regions(shift: int) -> gpd.GeoDataFrame:
    described = [
        # id, zone, height, outline
        (SLAB_ROOF, 2, 18.0, _box(5, 5, 20, 10)),
        (WING, 3, 12.0, _box(80, 0, 30, 10)),
        (DECK, 1, 6.0, _box(68, 10, 8, 10)),
        (PITCH, 3, 3.0, _box(200, 20, 20, 30)),
    ]
    rows = []
    for region, zone, height, shape in described:
        gradients = 0.25 * shape.area, 0.25
        sizes = shape.area, shape.length, shape.length**2 / (4 * np.pi * shape.area)
        heights = (height + 0.5, height, height, height + 0.25, 0.125)
        place = shape.centroid.x, shape.centroid.y
        rows.append((region + shift, zone, 20.0 * (zone - 1), 20.0 * zone, *gradients, *sizes, *heights, *place))
    return _geo(FLAT_REGION, rows, [shape for *_, shape in described])


def _candidates(shift: int) -> gpd.GeoDataFrame:
    described = [
        # id, method, rule, height scale, height, outline
        (TERRACE, "area3d", "rule 1", 3.5, 9.0, _box(0, 0, 40, 30)),
        (SOUTH_WING, "area3d", "rule 2", 3.5, 12.0, _box(80, 0, 30, 10)),
        (CRANE, "area3d", "rule 2", 7.25, 30.0, _box(150, 60, 10, 10)),
        (SLAB_CLUSTER, "adaptive", "clustering", np.nan, 18.0, _box(5, 5, 20, 10)),
        (AWNING, "adaptive", "clustering", np.nan, 3.0, _box(30, 20, 40, 10)),
        (HOUSE_CLUSTER, "adaptive", "clustering", np.nan, 6.0, _box(60, 10, 10, 10)),
        (SHED_CLUSTER, "adaptive", "clustering", np.nan, 3.0, _box(300, 40, 3, 5)),
        (PITCH_CLUSTER, "adaptive", "clustering", np.nan, 3.0, _box(200, 20, 20, 15)),
    ]
    rows = []
    for candidate, method, rule, height_scale, height, shape in described:
        points = int(shape.area * 8)
        sought = (3.5, 0.5, 0.0, 90.0) if method == "area3d" else (np.nan,) * 4
        shapes = (points, shape.area, points // 8 if method == "area3d" else 0, shape.area, 1.0, *sought, -0.125)
        heights = (height + 0.5, height, height, height + 0.25, 0.125)
        place = shape.centroid.x, shape.centroid.y
        rows.append((candidate + shift, method, rule, height_scale, *shapes, *heights, *place))
    return _geo(CANDIDATE_REGION, rows, [shape for *_, shape in described])


def _links(ones: gpd.GeoDataFrame, others: gpd.GeoDataFrame, table: Table) -> pd.DataFrame:
    """Return the links between parts or regions and regions that share ground."""
    one_id, other_id = table.names[:2]
    rows = []
    for one, outline in ones[[one_id, "geometry"]].itertuples(index=False):
        for other, shape in others[[other_id, "geometry"]].itertuples(index=False):
            overlap = outline.intersection(shape).area
            if overlap > 0:
                rows.append((one, other, overlap, overlap / outline.area, overlap / shape.area))
    return _frame(table, rows)


def _buildings(parts: pd.DataFrame, links_of: Mapping[str, pd.DataFrame]) -> gpd.GeoDataFrame:
    """Return the roots as buildings; the footprint's mean height is used for all cells.

    ``links_of`` has the links of the parts to the regions of each detector that was run.
    """
    trees = parts.groupby("root_id")
    roots = parts[parts["supid"] == 0].set_index("root_id", drop=False)
    storeys = trees["hindex"].max()
    own = parts.set_index("part_id")
    rises = (own["hindex"] - own["supid"].map(own["hindex"]).fillna(0)) * own["area_m2"]
    made = pd.DataFrame(
        {
            "building_id": roots["part_id"],
            "state": "confirmed",
            "probability": 0.96875,
            "multiscale_share": 1.0,
            **{f"z_ground{end}": 10.0 + more for end, more in (("", 0.0), ("_min", -0.25), ("_max", 0.5))},
            "z_eaves": trees["h_p90"].max() + 10,
            "z_ridge": trees["h_max"].max() + 10,
            "eaves": trees["h_p90"].max(),
            "ridge": trees["h_max"].max(),
            "storeys": storeys,
            "storeys_min": storeys,
            "storeys_max": storeys + 1,
            "storeys_top": storeys,
            "floor_area_m2": rises.groupby(own["root_id"]).sum(),
            "coverage": 0.75,
            "nodata_share": 0.125,
            "density": 8.0,
            "outline_source": "traced",
            "h_max": trees["h_max"].max(),
            "h_mean": roots["h_mean"],
            "h_p50": roots["h_p50"],
            "h_p90": roots["h_p90"],
            "area_m2": roots["area_m2"],
            "volume_m3": roots["area_m2"] * roots["h_mean"],
            "trees": 1,
            "divided_by": "",
            "parts": trees.size(),
            "scales": trees["scale"].nunique(),
            **{name: roots[name] for name in ("speindex", "building_share", "xcen", "ycen", "xin", "yin")},
            **dict.fromkeys(EXTRACTOR_SHARES.values(), np.nan),
        }
    ).reset_index(drop=True)
    for name, links in links_of.items():
        covered = links.groupby("part_id")["part_share"].sum()
        made[EXTRACTOR_SHARES[name]] = made["building_id"].map(covered).fillna(0.0)
    return gpd.GeoDataFrame(BUILDING.typed(made), geometry=list(roots["geometry"]), crs=f"EPSG:{EPSG}")


def _frame(table: Table, rows: list[tuple[Any, ...]]) -> pd.DataFrame:
    frame = pd.DataFrame(rows, columns=table.names)
    return frame.astype({c.name: c.dtype for c in table.columns})


def _geo(table: Table, rows: list[tuple[Any, ...]], shapes: list[Any]) -> gpd.GeoDataFrame:
    return gpd.GeoDataFrame(_frame(table, rows), geometry=shapes, crs=f"EPSG:{EPSG}")
