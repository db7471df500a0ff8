"""A second epoch of a real tile, made by editing its points: buildings removed, added, raised and extended.

The edits are known, so that what a comparison finds can be judged. Everything else differs as between two flights: the
points are thinned, shifted, and have noise of their own.
"""

from dataclasses import dataclass

import geopandas as gpd
import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter
from shapely import box

from msbdb.grid import Grid, GridSpec
from msbdb.vector.polygons import rasterise

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Edit:
    """A true change: its kind, and where."""

    kind: str
    place: shapely.Geometry


@dataclass(frozen=True)
class Epoch:
    """The edited points, which points of the first epoch they are, and the truth."""

    x: Array
    y: Array
    z: Array
    kept: NDArray[np.intp]
    edits: tuple[Edit, ...]


SHIFT_M = 0.5
NOISE_M = 0.03
FLOOR_M = 0.5
"""Below this height above ground nothing stands."""
OPEN_M = 1.0
"""Below this height above ground a place is open: grass and parked bicycles make way for a building."""


def second_epoch(
    points: tuple[Array, Array, Array],
    buildings: gpd.GeoDataFrame,
    ndsm: Grid,
    heights: Array,
    *,
    each: int = 2,
    seed: int = 1,
    thin: float = 0.7,
) -> Epoch:
    """Edit the points of a tile.

    Parameters
    ----------
    points : tuple of (N,) ndarray of float64
        Coordinates of the first epoch.
    buildings : GeoDataFrame
        Its buildings, with ``h_p50``.
    ndsm : Grid
        Its heights above ground.
    heights : (N,) ndarray of float64
        Heights above ground of the points.
    each : int
        Edits of each kind.
    seed : int
        Of noise and thinning, and of the choice.
    thin : float
        Share of the points that is kept.
    """
    rng = np.random.default_rng(seed)
    x, y, z = (axis.copy() for axis in points)
    ground = z - heights
    edits: list[Edit] = []
    large = buildings[buildings.geometry.area >= 60]
    chosen = rng.permutation(len(large))[: 2 * each]
    for n, place in enumerate(chosen.tolist()):
        shape = large.geometry.iloc[place]
        others = shapely.union_all(buildings.geometry.drop(large.index[place]).to_numpy())
        around = shape.buffer(1.0).difference(others).union(shape)
        inside = _inside(x, y, around) & (heights > FLOOR_M)
        if n < each:
            z[inside] = ground[inside] + rng.normal(0, NOISE_M, int(inside.sum()))
            edits.append(Edit("demolished", shape))
        else:
            z[inside] += 4.0
            edits.append(Edit("modified", shape))
    taken = shapely.union_all([edit.place for edit in edits]).buffer(8)
    for touching in (False, True):
        for place, height in _open_places(buildings, ndsm, taken, each, touching=touching, rng=rng):
            inside = _inside(x, y, place)
            z[inside] = ground[inside] + height + rng.normal(0, NOISE_M, int(inside.sum()))
            edits.append(Edit("modified" if touching else "new", place))
            taken = taken.union(place.buffer(8))
    kept = np.flatnonzero(rng.random(len(x)) < thin)
    z += rng.normal(0, NOISE_M, len(z))
    return Epoch(x[kept] + SHIFT_M, y[kept], z[kept], kept, tuple(edits))


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
    """Find open rectangles of 8 x 9 m that touch just one building, or of 9 x 8 m that touch none; and heights."""
    spec = ndsm.spec
    width, depth = (8.0, 9.0) if touching else (9.0, 8.0)
    labels = rasterise(buildings.geometry, spec)
    # A touching rectangle overlaps the building's own edge, whose cells are no open ground.
    blocked = ~ndsm.valid | ((np.asarray(ndsm.values) > OPEN_M) & (not touching or labels == 0))
    west, south, east, north = spec.bounds
    found: list[tuple[shapely.Geometry, float]] = []
    step = 1.0
    corners = [(e, n) for e in np.arange(west + 3, east - 15, step) for n in np.arange(south + 3, north - 13, step)]
    high = maximum_filter(blocked.astype(np.uint8), 3)
    for at in rng.permutation(len(corners)).tolist():
        place = box(corners[at][0], corners[at][1], corners[at][0] + width, corners[at][1] + depth)
        rows, cols = _window(spec, place)
        if place.intersects(taken) or (high if not touching else blocked)[rows, cols].any():
            continue
        under = labels[rows, cols]
        if not touching and not labels[_wider(rows, 4, spec), _wider(cols, 4, spec)].any():
            found.append((place, 7.0))
        own = np.unique(under[under > 0])
        edge = np.count_nonzero(under) * spec.cell_area_m2
        if touching and len(own) == 1 and 6.0 <= edge <= 12.0:
            found.append((place, float(buildings["h_p50"].iloc[own[0] - 1])))
        if found and found[-1][0] is place:
            taken = taken.union(place.buffer(8))
        if len(found) == count:
            break
    return found


def _window(spec: GridSpec, place: shapely.Geometry) -> tuple[slice, slice]:
    """Return the cells of a rectangle."""
    west, south, east, north = place.bounds
    row, col = spec.rowcol(np.array([west, east]), np.array([north, south]))
    return slice(int(row[0]), int(row[1]) + 1), slice(int(col[0]), int(col[1]) + 1)


def _wider(side: slice, metres: float, spec: GridSpec) -> slice:
    """Return a slice with a margin."""
    margin = int(metres / spec.cell_m)
    return slice(max(side.start - margin, 0), side.stop + margin)
