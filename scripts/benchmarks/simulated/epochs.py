"""A second epoch of a real tile, made by editing its points: buildings and parts removed, added, raised and lowered.

The edits are known, so that what a comparison finds can be judged. Everything else differs as between two flights: the
points are thinned, shifted, and have noise of their own.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import geopandas as gpd
import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter
from shapely import box
from shapely.affinity import rotate, scale, translate

from msbdb.grid import Grid, GridSpec
from msbdb.outline.polygons import rasterise

Array = NDArray[np.float64]

EDITS = ("removed", "replaced", "raised", "lowered", "part removed", "extended", "added")
"""What is done to a tile."""

KINDS = {"removed": "demolished", "replaced": "new", "added": "new"}
"""What a comparison must call it; all else is modified. The place of what replaces a building is that of the new one."""


@dataclass(frozen=True)
class Edit:
    """A true change: what was done, and where."""

    what: str
    place: shapely.Geometry

    @property
    def kind(self) -> str:
        """What a comparison must call it."""
        return KINDS.get(self.what, "modified")

    @property
    def respect(self) -> str:
        """The column of the changes that tells in which respect a building was modified; empty for others."""
        if self.kind != "modified":
            return ""
        return "height" if self.what in ("raised", "lowered") else "outline"


@dataclass(frozen=True)
class Flight:
    """How a second flight differs from the first: the share of points that it has, and how it lies, in metres."""

    thin: float = 0.7
    shift: tuple[float, float] = (0.5, 0.0)
    noise_m: float = 0.03


FLIGHTS = (
    Flight(),
    Flight(thin=0.5, shift=(0.0, -0.5), noise_m=0.05),
    Flight(thin=0.85, shift=(-0.35, 0.35)),
)
"""Flights by seed, from 1 on; later seeds begin again with the first."""


@dataclass(frozen=True)
class Epoch:
    """The edited points, which points of the first epoch they are, and the truth."""

    x: Array
    y: Array
    z: Array
    kept: NDArray[np.intp]
    edits: tuple[Edit, ...]


NOISE_M = 0.03
"""Of a flat roof or of bare ground."""
FLOOR_M = 0.5
"""Below this height above ground nothing stands."""
BLOCK_SHARE = 0.45
"""The sides of a house that replaces a building, as a share of the sides of that building."""
OPEN_M = 1.0
"""Below this height above ground a place is open: grass and parked bicycles make way for a building."""
RAISE_M, LOWER_M = 4.0, 3.0
TALL_M = 7.0
"""Median height from which a building can be lowered."""
LEFT_M = 3.0
"""What is lowered stays as high as this, so that low wings stand on; no extension is lower."""
LARGE_M2 = 60.0
PARTED_M2 = 140.0
"""Areas from which a building can be edited, and from which a part of it can be removed."""
SIZES = ((9.0, 8.0), (8.0, 9.0), (6.0, 10.0), (10.0, 6.0))
"""Rectangles that are built, in metres; all have more than 50 m2."""
CLEAR_M = 6.0
"""No other edit is so near to what is built."""
APART_M = 4.0
"""What is added stands so far from all buildings."""
WALL_M = 0.75
"""So far from a footprint the heights may still be its wall's."""
TOUCH_M2 = (4.0, 14.0)
"""What is added to a building shares so much with its edge."""


def second_epoch(
    points: tuple[Array, Array, Array],
    buildings: gpd.GeoDataFrame,
    ndsm: Grid,
    heights: Array,
    *,
    each: int = 2,
    seed: int = 1,
    flight: Flight | None = None,
) -> Epoch:
    """Edit the points of a tile.

    Parameters
    ----------
    points : tuple of (N,) ndarray of float64
        Coordinates of the first epoch.
    buildings : GeoDataFrame
        Its buildings, with ``h_p50``, and ``z_ground_max`` where it is known. Where one or a part of it is removed, no
        point stays above this level, as the ground beneath a block is interpolated, also from light wells.
    ndsm : Grid
        Its heights above ground.
    heights : (N,) ndarray of float64
        Heights above ground of the points.
    each : int
        Edits of each kind, where there is room.
    seed : int
        Of noise and thinning, and of the choice.
    flight : Flight, optional
        How the second flight differs; that of the seed by default.
    """
    rng = np.random.default_rng(seed)
    flight = flight or FLIGHTS[(seed - 1) % len(FLIGHTS)]
    x, y, z = (axis.copy() for axis in points)
    ground = z - heights
    edits: list[Edit] = []
    built: list[tuple[Edit, float]] = []
    for what in ("extended", "added"):
        near = shapely.union_all([edit.place for edit, _ in built]).buffer(CLEAR_M)
        found = _open_places(buildings, ndsm, near, each, touching=what == "extended", rng=rng)
        built += [(Edit(what, place), height) for place, height in found]
    near = shapely.union_all([edit.place for edit, _ in built]).buffer(CLEAR_M)
    tree = shapely.STRtree(buildings.geometry.to_numpy())
    for edit, whole, level_m in _chosen(buildings[~buildings.intersects(near)], each, rng):
        others = shapely.union_all(buildings.geometry.iloc[tree.query(whole.buffer(2.0))].to_numpy()).difference(whole)
        gone = whole if edit.what == "replaced" else edit.place
        around = gone.buffer(1.0).difference(others).difference(whole.difference(gone)).union(gone)
        inside = _inside(x, y, around) & (heights > FLOOR_M)
        if edit.what == "raised":
            z[inside] += RAISE_M
        elif edit.what == "lowered":
            left = ground[inside] + np.minimum(heights[inside], LEFT_M)
            z[inside] = np.maximum(z[inside] - LOWER_M, left)
        else:
            z[inside] = np.fmin(ground[inside], level_m) + rng.normal(0, NOISE_M, int(inside.sum()))
        if edit.what == "replaced":
            taller = float(np.median(heights[inside])) + RAISE_M
            inside = _inside(x, y, edit.place)
            z[inside] = np.fmin(ground[inside], level_m) + taller + rng.normal(0, NOISE_M, int(inside.sum()))
        edits.append(edit)
    for edit, height in built:
        inside = _inside(x, y, edit.place)
        z[inside] = ground[inside] + height + rng.normal(0, NOISE_M, int(inside.sum()))
        edits.append(edit)
    kept = np.flatnonzero(rng.random(len(x)) < flight.thin)
    z += rng.normal(0, flight.noise_m, len(z))
    east, north = flight.shift
    return Epoch(x[kept] + east, y[kept] + north, z[kept], kept, tuple(edits))


def _chosen(
    buildings: gpd.GeoDataFrame, each: int, rng: np.random.Generator
) -> Iterator[tuple[Edit, shapely.Geometry, float]]:
    """Yield edits of buildings that are there, each of another one, its whole outline, and the ground's upper level."""
    wanted = {"part removed": each, "lowered": each, "removed": each, "raised": each}
    replaced = 0
    large = buildings[buildings.geometry.area >= LARGE_M2]
    levels = large.get("z_ground_max", np.full(len(large), np.nan))
    for at in rng.permutation(len(large)).tolist():
        shape, height = large.geometry.iloc[at], large["h_p50"].iloc[at]
        part = _part(shape) if wanted["part removed"] and shape.area >= PARTED_M2 else None
        can = {"part removed": part is not None, "lowered": height >= TALL_M, "removed": True, "raised": True}
        able = [what for what, left in wanted.items() if left and can[what]]
        # All kinds come in turn, those that few buildings are fit for first.
        what = max(able, key=lambda word: wanted[word], default=None)
        if what is None:
            # Replaced are buildings that no other kind needs, so that the other edits are the same with and without.
            block = _block(shape) if replaced < each else None
            if block is not None:
                replaced += 1
                yield Edit("replaced", block), shape, float(np.asarray(levels)[at])
            continue
        wanted[what] -= 1
        yield Edit(what, part if what == "part removed" else shape), shape, float(np.asarray(levels)[at])


def _block(shape: shapely.Geometry) -> shapely.Geometry | None:
    """Return a smaller house in a building, of some fifth of it."""
    whole = shapely.oriented_envelope(shape)
    block = scale(whole, BLOCK_SHARE, BLOCK_SHARE).intersection(shape)
    single = shapely.get_num_geometries(block.buffer(-1)) == 1 and not block.buffer(-1).is_empty
    return block if single and LARGE_M2 <= block.area <= shape.area / 4 else None


def _part(shape: shapely.Geometry) -> shapely.Geometry | None:
    """Return an end of a building, some two fifths of its length, without which the rest stays in one piece."""
    corners = shapely.get_coordinates(shapely.oriented_envelope(shape))[:4]
    sides = corners[1] - corners[0], corners[3] - corners[0]
    (along, across) = sides if np.hypot(*sides[0]) >= np.hypot(*sides[1]) else sides[::-1]
    cut = shapely.Polygon(
        [corners[0], corners[0] + 0.4 * along, corners[0] + 0.4 * along + across, corners[0] + across]
    )
    middle = shapely.centroid(shapely.oriented_envelope(shape))
    for cutter in (cut, rotate(cut, 180, origin=middle)):
        part, rest = shape.intersection(cutter.buffer(0.01)), shape.difference(cutter.buffer(0.01))
        single = [
            shapely.get_num_geometries(some.buffer(-1)) == 1 and not some.buffer(-1).is_empty for some in (part, rest)
        ]
        if all(single) and part.area >= LARGE_M2 and rest.area >= LARGE_M2:
            return part
    return None


def _inside(x: Array, y: Array, shape: shapely.Geometry) -> NDArray[np.bool_]:
    """Return the points in a polygon."""
    west, south, east, north = shape.bounds
    near = np.flatnonzero((x >= west) & (x <= east) & (y >= south) & (y <= north))
    found = np.zeros(len(x), dtype=np.bool_)
    found[near] = shapely.contains_xy(shape, x[near], y[near])
    return found


def _open_places(
    buildings: gpd.GeoDataFrame,
    ndsm: Grid,
    taken: shapely.Geometry,
    count: int,
    *,
    touching: bool,
    rng: np.random.Generator,
) -> list[tuple[shapely.Geometry, float]]:
    """Find open rectangles that touch just one building, or that stand apart from all; and heights."""
    spec = ndsm.spec
    labels = rasterise(buildings.geometry, spec)
    # A touching rectangle overlaps the building's own edge and its wall, whose cells are no open ground.
    walls = maximum_filter(labels > 0, 2 * int(WALL_M / spec.cell_m) + 1)
    blocked = ~ndsm.valid | ((np.asarray(ndsm.values) > OPEN_M) & ~(touching & walls))
    if not touching:
        blocked = maximum_filter(blocked, 3)
        blocked |= maximum_filter(labels > 0, 2 * int(APART_M / spec.cell_m) + 1)
    free = np.pad(np.cumsum(np.cumsum(blocked, axis=0), axis=1), ((1, 0), (1, 0)))
    built = np.pad(np.cumsum(np.cumsum(labels > 0, axis=0), axis=1), ((1, 0), (1, 0)))
    found: list[tuple[shapely.Geometry, float]] = []
    for place in _candidates(spec, free, built if touching else None, rng):
        if place.intersects(taken):
            continue
        under = labels[_window(spec, place)]
        own = np.unique(under[under > 0])
        if touching and len(own) != 1:
            continue
        height = max(float(buildings["h_p50"].iloc[own[0] - 1]), LEFT_M) if touching else 7.0
        found.append((place, height))
        taken = taken.union(place.buffer(CLEAR_M))
        if len(found) == count:
            break
    return found


def _candidates(
    spec: GridSpec, blocked: NDArray[np.int_], built: NDArray[np.int_] | None, rng: np.random.Generator
) -> Iterator[shapely.Geometry]:
    """Yield rectangles without a blocked cell, in a random order; of the counts of built cells those that touch."""
    fitting: list[tuple[int, int, float, float]] = []
    for width, depth in SIZES:
        rows, cols = int(depth / spec.cell_m), int(width / spec.cell_m)
        margin = int(3 / spec.cell_m)
        good = _sums(blocked, rows, cols) == 0
        if built is not None:
            edge = _sums(built, rows, cols) * spec.cell_area_m2
            good &= (edge >= TOUCH_M2[0]) & (edge <= TOUCH_M2[1])
        good[:margin], good[-margin:], good[:, :margin], good[:, -margin:] = False, False, False, False
        fitting += [(row, col, width, depth) for row, col in np.argwhere(good).tolist()]
    for at in rng.permutation(len(fitting)).tolist():
        row, col, width, depth = fitting[at]
        east, north = (float(value[0]) for value in spec.xy(np.array([row]), np.array([col])))
        # The first cell's centre, half a cell inside its corner.
        yield translate(box(0, -depth, width, 0), east - spec.cell_m / 2, north + spec.cell_m / 2)


def _sums(table: NDArray[np.int_], rows: int, cols: int) -> NDArray[np.int_]:
    """Return the sum over each window of some rows and columns, from a table of sums."""
    return table[rows:, cols:] - table[:-rows, cols:] - table[rows:, :-cols] + table[:-rows, :-cols]


def _window(spec: GridSpec, place: shapely.Geometry) -> tuple[slice, slice]:
    """Return the cells of a rectangle, and those beside them."""
    west, south, east, north = place.bounds
    row, col = spec.rowcol(np.array([west, east]), np.array([north, south]))
    return slice(max(int(row[0]) - 2, 0), int(row[1]) + 3), slice(max(int(col[0]) - 2, 0), int(col[1]) + 3)


def counts(edits: Sequence[Edit]) -> dict[str, int]:
    """Return the edits by what was done."""
    return {what: sum(edit.what == what for edit in edits) for what in EDITS}
