"""Simulated airborne LiDAR over small scenes whose buildings, parts and ground are known exactly.

A scene is a ground surface, blocks with vertical walls (buildings, walls, decks) and trees. `scan` shoots a jittered
grid of vertical pulses at it: crowns scatter several echoes, edges split a pulse in two, every range has noise.
Everything is fixed by the seed. Roof heights lie in the middle of a 3 m storey above a mask of 2 m
(H = 1 + floor((h - 2) / 3)), and areas lie well between the usual scales, so that the forest follows from geometry.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pyproj import CRS

from msbdb.grid import GridSpec, lattice
from msbdb.points.cloud import PointCloud

UTM33 = CRS.from_epsg(32633)
ORIGIN = (389_000.0, 5_821_000.0)
"""World position of the local (0, 0) of every scene but the tile-crossing one, metres."""

DATUM_M = 35.0
"""Elevation of the flat ground."""

GROUND, VEGETATION, BUILDING, OTHER, BRIDGE = 2, 5, 6, 1, 17
"""ASPRS classes of the truth."""

KINDS = {"building": BUILDING, "wall": OTHER, "deck": BRIDGE}

# Red, green, blue and near infrared of the ortho (8 bits), laser intensity (8 bits), and the spread of them all.
MATERIALS: dict[str, tuple[float, float, float, float, float, float]] = {
    "grass": (105, 130, 80, 185, 160, 7),
    "crown": (70, 95, 60, 170, 90, 14),
    "asphalt": (95, 95, 98, 85, 35, 5),
    "soil": (150, 130, 105, 150, 110, 7),
    "tiles": (170, 105, 85, 140, 130, 8),
    "gravel": (160, 158, 150, 150, 95, 6),
    "metal": (185, 190, 200, 185, 200, 6),
    "concrete": (200, 196, 188, 195, 140, 6),
}
NAMES = tuple(MATERIALS)

Array = NDArray[np.float64]
Ground = Callable[[Array, Array], Array]


def level_ground(x: Array, y: Array) -> Array:
    """Return the datum everywhere."""
    return np.full(np.shape(x), DATUM_M)


@dataclass(frozen=True)
class Block:
    """A rectangular solid with vertical walls, in local metres; `level_m` is the elevation of its eaves."""

    name: str
    west: float
    south: float
    width: float
    depth: float
    level_m: float
    building: int = 0
    kind: str = "building"
    material: str = "tiles"
    turn_deg: float = 0.0
    ridge_m: float = 0.0
    hole: tuple[float, float, float, float] | None = None
    lawn_rim_m: float | None = None

    def _own(self, x: Array, y: Array) -> tuple[Array, Array]:
        """Coordinates from the block's centre along its own axes."""
        turn = np.deg2rad(self.turn_deg)
        east, north = x - (self.west + self.width / 2), y - (self.south + self.depth / 2)
        return east * np.cos(turn) + north * np.sin(turn), north * np.cos(turn) - east * np.sin(turn)

    def inside(self, x: Array, y: Array) -> NDArray[np.bool_]:
        """Whether local positions are on the block."""
        along, across = self._own(x, y)
        within = (np.abs(along) <= self.width / 2) & (np.abs(across) <= self.depth / 2)
        if self.hole is not None:
            west, south, width, depth = self.hole
            within &= ~((x > west) & (x < west + width) & (y > south) & (y < south + depth))
        return within

    def top(self, x: Array, y: Array) -> Array:
        """Elevation of the roof; a ridge, where there is one, runs along the block's east-west axis."""
        _, across = self._own(x, y)
        return self.level_m + self.ridge_m * np.clip(1 - np.abs(across) / (self.depth / 2), 0, 1)

    def surface(self, x: Array, y: Array) -> NDArray[np.int64]:
        """Index of the material of the roof."""
        material = np.full(x.shape, NAMES.index(self.material))
        if self.lawn_rim_m is not None:
            along, across = self._own(x, y)
            rim = self.lawn_rim_m
            lawn = (np.abs(along) < self.width / 2 - rim) & (np.abs(across) < self.depth / 2 - rim)
            material[lawn] = NAMES.index("grass")
        return material


@dataclass(frozen=True)
class Tree:
    """An ellipsoidal crown in local metres; heights above the ground at its stem."""

    x: float
    y: float
    radius: float = 4.0
    height: float = 11.0
    crown_base: float = 3.0

    def crown(self, x: Array, y: Array, foot: float) -> tuple[Array, Array]:
        """Elevation of the crown's upper and lower surface; NaN outside of it."""
        middle = foot + (self.height + self.crown_base) / 2
        half = (self.height - self.crown_base) / 2
        share = 1 - ((x - self.x) ** 2 + (y - self.y) ** 2) / self.radius**2
        reach = half * np.sqrt(np.where(share > 0, share, np.nan))
        return middle + reach, middle - reach


@dataclass(frozen=True)
class Fact:
    """A part that the multi-scale forest must hold: its area, eaves height above ground, and father (None: root).

    The area counts what stands at least 2 m above the ground, as the mask hides the rest from every extractor.
    """

    name: str
    building: int
    area_m2: float
    height_m: float
    father: str | None = None


@dataclass(frozen=True)
class World:
    """What is scanned: ground, blocks and trees over a rectangle of local metres."""

    name: str
    size: tuple[float, float] = (100.0, 100.0)
    blocks: tuple[Block, ...] = ()
    trees: tuple[Tree, ...] = ()
    relief: Ground = level_ground
    roads: tuple[tuple[float, float, float, float], ...] = ()
    origin: tuple[float, float] = ORIGIN
    forest: tuple[Fact, ...] = ()

    def solid(self, x: Array, y: Array) -> tuple[Array, NDArray[np.int64], NDArray[np.int64]]:
        """Elevation, material and block (-1 for ground) of the highest solid surface at local positions."""
        z = np.asarray(self.relief(x, y), dtype=np.float64).copy()
        material = np.full(x.shape, NAMES.index("grass"))
        for west, south, width, depth in self.roads:
            on_road = (x >= west) & (x < west + width) & (y >= south) & (y < south + depth)
            material[on_road] = NAMES.index("asphalt")
        block = np.full(x.shape, -1)
        for number, body in enumerate(self.blocks):
            top = body.top(x, y)
            above = body.inside(x, y) & (top > z)
            z[above], block[above] = top[above], number
            material[above] = body.surface(x, y)[above]
        return z, material, block

    def canopy(self, x: Array, y: Array) -> tuple[Array, Array]:
        """Upper and lower elevation of the highest crown at local positions; NaN where there is none."""
        upper, lower = np.full(x.shape, np.nan), np.full(x.shape, np.nan)
        for tree in self.trees:
            foot = float(self.relief(np.array([tree.x]), np.array([tree.y]))[0])
            top, base = tree.crown(x, y, foot)
            higher = ~np.isnan(top) & ~(upper >= top)
            upper[higher], lower[higher] = top[higher], base[higher]
        return upper, lower


@dataclass(frozen=True)
class Scene:
    """A scanned world with its truth.

    ``points`` carry no classes unless asked for; ``labels`` holds the true ASPRS class of each point. ``buildings``
    (int32, 0 for none), ``heights`` (float32, metres above ground, 0 off buildings) and ``cover`` (uint8 ASPRS class
    seen from above) lie on ``spec``, by cell centres. ``forest`` lists the parts that must come out.
    """

    name: str
    points: PointCloud
    labels: NDArray[np.uint8]
    spec: GridSpec
    buildings: NDArray[np.int32]
    heights: NDArray[np.float32]
    cover: NDArray[np.uint8]
    forest: tuple[Fact, ...]
    world: World

    def ground(self, easting: Array, northing: Array) -> Array:
        """Elevation of the true bare earth, metres."""
        x = np.asarray(easting, dtype=np.float64) - self.world.origin[0]
        y = np.asarray(northing, dtype=np.float64) - self.world.origin[1]
        return np.asarray(self.world.relief(x, y), dtype=np.float64)

    def ortho(self, spec: GridSpec, seed: int = 0) -> NDArray[np.float32]:
        """Return a true orthophoto: (4, H, W) red, green, blue and NIR of 8 bits on any lattice."""
        row, col = np.indices(spec.shape)
        east, north = spec.xy(row, col)
        x, y = east - self.world.origin[0], north - self.world.origin[1]
        z, material, _ = self.world.solid(x, y)
        upper, _ = self.world.canopy(x, y)
        material[upper > z] = NAMES.index("crown")
        noise = np.random.default_rng(seed).normal(size=(4, *spec.shape))
        return np.moveaxis(_shades(material), -1, 0)[:4].astype(np.float32) + _spread(material) * noise.astype("f4")


def _shades(material: NDArray[np.int64]) -> Array:
    """Return the mean colours and intensity (..., 5) of materials."""
    return np.array([MATERIALS[name][:5] for name in NAMES])[material]


def _spread(material: NDArray[np.int64]) -> NDArray[np.float32]:
    """Return the standard deviation of the colours of materials."""
    return np.array([MATERIALS[name][5] for name in NAMES], dtype=np.float32)[material]


def _pulses(size: tuple[float, float], density: float, rng: np.random.Generator) -> tuple[Array, Array]:
    """Return pulse positions: a grid of the mean spacing, each pulse moved by up to 0.4 of it."""
    columns, rows = (max(1, round(side * np.sqrt(density))) for side in size)
    row, col = np.divmod(np.arange(rows * columns), columns)
    x = (col + 0.5 + rng.uniform(-0.4, 0.4, col.size)) * size[0] / columns
    y = (row + 0.5 + rng.uniform(-0.4, 0.4, row.size)) * size[1] / rows
    return x, y


def _crown_hits(world: World, x: Array, y: Array, floor: Array, rng: np.random.Generator) -> tuple[Array, NDArray]:
    """Elevations (N, 3) of the echoes inside crowns, NaN for none, and whether the pulse passes through."""
    upper, lower = world.canopy(x, y)
    lower = np.fmax(lower, floor + 0.3)
    hits = np.full((x.size, 3), np.nan)
    at, alive = upper.copy(), ~np.isnan(upper)
    passes = np.ones(x.size, dtype=bool)
    for echo in range(3):
        at -= rng.exponential(0.7, x.size) + (0.6 if echo else 0.0)
        hit = alive & (at > lower)
        hits[hit, echo] = at[hit]
        stopped = hit & (rng.random(x.size) < 0.45)
        passes &= ~stopped
        alive = hit & ~stopped
    return hits, passes


def scan(
    world: World,
    *,
    seed: int = 0,
    density: float = 4.0,
    cell_m: float = 0.5,
    noise_m: float = 0.03,
    classified: bool = False,
) -> Scene:
    """Scan a world from above at `density` pulses a square metre and rasterise its truth at `cell_m`."""
    rng = np.random.default_rng(seed)
    x, y = _pulses(world.size, density, rng)
    shift = rng.uniform(-0.15, 0.15, (2, x.size))
    centre, side = world.solid(x, y), world.solid(x + shift[0], y + shift[1])
    split = np.abs(centre[0] - side[0]) > 1.0
    side_first = split & (side[0] > centre[0])
    high = [np.where(side_first, b, a) for a, b in zip(centre, side, strict=True)]
    low = [np.where(side_first, a, b) for a, b in zip(centre, side, strict=True)]
    crown, passes = _crown_hits(world, x, y, high[0], rng)
    z = np.column_stack([crown, np.where(passes, high[0], np.nan), np.where(passes & split, low[0], np.nan)])
    real = ~np.isnan(z)
    pulse, echo = np.nonzero(real)
    material = np.column_stack([np.full(crown.shape, NAMES.index("crown")), high[1], low[1]])
    kinds = np.array([GROUND, *(KINDS[block.kind] for block in world.blocks)], dtype=np.uint8)
    label = np.column_stack([np.full(crown.shape, VEGETATION), kinds[high[2] + 1], kinds[low[2] + 1]])
    labels = label[pulse, echo].astype(np.uint8)
    returns = real.sum(axis=1)
    seen = material[np.arange(x.size), real.argmax(axis=1)]
    colours = _shades(seen)[:, :4] + _spread(seen)[:, None] * rng.normal(size=(x.size, 4))
    power = _shades(material[pulse, echo])[:, 4] / np.sqrt(returns[pulse]) * rng.normal(1, 0.12, pulse.size)
    points = PointCloud(
        x=np.round(x[pulse] + world.origin[0], 3),
        y=np.round(y[pulse] + world.origin[1], 3),
        z=np.round(z[pulse, echo] + rng.normal(0, noise_m, pulse.size), 3),
        crs=UTM33,
        classification=labels.copy() if classified else None,
        return_number=np.cumsum(real, axis=1)[pulse, echo].astype(np.uint8),
        number_of_returns=returns[pulse].astype(np.uint8),
        intensity=(np.clip(power, 1, 255) * 100).astype(np.uint16),
        colours=(np.clip(colours, 0, 255) * 256).astype(np.uint16)[pulse],
        colour_names=("red", "green", "blue", "nir"),
    )
    return _with_truth(world, points, labels, cell_m)


def _with_truth(world: World, points: PointCloud, labels: NDArray[np.uint8], cell_m: float) -> Scene:
    """Rasterise the truth by cell centres."""
    east, north = world.origin
    spec = lattice((east, north + 1e-3, east + world.size[0] - 1e-3, north + world.size[1]), cell_m, UTM33)
    row, col = np.indices(spec.shape)
    x, y = (world_m - start for world_m, start in zip(spec.xy(row, col), world.origin, strict=True))
    z, _, block = world.solid(x, y)
    buildings = np.array([0, *(b.building for b in world.blocks)], dtype=np.int32)[block + 1]
    heights = np.where(buildings > 0, z - world.relief(x, y), 0).astype(np.float32)
    cover = np.array([GROUND, *(KINDS[b.kind] for b in world.blocks)], dtype=np.uint8)[block + 1]
    upper, _ = world.canopy(x, y)
    cover[upper > z] = VEGETATION
    return Scene(world.name, points, labels, spec, buildings, heights, cover, world.forest, world)


def flat_field(seed: int = 0, density: float = 4.0, **options: object) -> Scene:
    """Scan a meadow on a gentle slope with a track: nothing to find."""
    world = World("flat_field", relief=lambda x, y: DATUM_M + 0.02 * x + 0.01 * y, roads=((0, 45, 100, 4),))
    return scan(world, seed=seed, density=density, **options)


def podium_tower(seed: int = 0, density: float = 4.0, **options: object) -> Scene:
    """Scan a podium with a tower with a plant room: a tree of three levels."""
    blocks = (
        Block("podium", 30, 35, 40, 30, DATUM_M + 6.5, 1, material="gravel"),
        Block("tower", 40, 40, 20, 15, DATUM_M + 30.5, 1, material="concrete"),
        Block("plant", 46, 44, 6, 6, DATUM_M + 36.5, 1, material="metal"),
    )
    forest = (
        Fact("podium", 1, 1200, 6.5),
        Fact("tower", 1, 300, 30.5, "podium"),
        Fact("plant", 1, 36, 36.5, "tower"),
    )
    return scan(World("podium_tower", blocks=blocks, forest=forest), seed=seed, density=density, **options)


def courtyard(seed: int = 0, density: float = 4.0, **options: object) -> Scene:
    """Scan a perimeter block around a courtyard that coarse closings would fill."""
    block = Block("ring", 30, 30, 40, 40, DATUM_M + 12.5, 1, hole=(42, 42, 16, 16))
    world = World("courtyard", blocks=(block,), forest=(Fact("ring", 1, 40 * 40 - 16 * 16, 12.5),))
    return scan(world, seed=seed, density=density, **options)


def row_houses(seed: int = 0, density: float = 4.0, gap_m: float | None = None, **options: object) -> Scene:
    """Scan two rows of six equal houses; the gap between neighbours is one mean pulse spacing unless given."""
    gap = 1 / np.sqrt(density) if gap_m is None else gap_m
    blocks = tuple(
        Block(f"house {6 * row + n + 1}", 20 + n * (8 + gap), 25 + 35 * row, 8, 12, DATUM_M + 6.5, 6 * row + n + 1)
        for row in range(2)
        for n in range(6)
    )
    forest = tuple(Fact(b.name, b.building, 96, 6.5) for b in blocks)
    world = World("row_houses", blocks=blocks, roads=((0, 46, 100, 6),), forest=forest)
    return scan(world, seed=seed, density=density, **options)


def under_trees(seed: int = 0, density: float = 4.0, **options: object) -> Scene:
    """Scan a house with a crown over one corner, one touching a wall, and a grove apart."""
    house = Block("house", 40, 40, 16, 12, DATUM_M + 6.5, 1)
    trees = (
        Tree(56, 52, 4.5, 14.0, 5.0),
        Tree(36, 44, 4.2, 9.0, 2.5),
        *(Tree(15 + 7.0 * (n % 3), 12 + 6.5 * (n // 3), 3.8, 10.0 + n % 4, 2.5) for n in range(6)),
        Tree(80, 80, 4.0, 12.0, 3.0),
    )
    world = World("under_trees", blocks=(house,), trees=trees, forest=(Fact("house", 1, 192, 6.5),))
    return scan(world, seed=seed, density=density, **options)


def attached_to_slope(seed: int = 0, density: float = 4.0, **options: object) -> Scene:
    """Scan a bank of 8 m over 20 m, and a building whose rear roof edge is nearly level with it.

    Of its 480 m2, 396 m2 stand at least 2 m above the ground; heights fall from 7 m to 0.6 m along the bank.
    """

    def relief(x: Array, y: Array) -> Array:
        return DATUM_M + 0.4 * np.clip(y - 40, 0, 20) + np.zeros(np.shape(x))

    house = Block("house", 35, 36, 24, 20, DATUM_M + 7.0, 1, material="gravel")
    world = World(
        "attached_to_slope",
        blocks=(house,),
        relief=relief,
        forest=(Fact("house", 1, 396, 7.0),),
    )
    return scan(world, seed=seed, density=density, **options)


def plateau(seed: int = 0, density: float = 4.0, bank_m: float = 2.0, **options: object) -> Scene:
    """Scan an earthwork of 48 m by 48 m, 5 m high with banks of 2 m unless given, a house on it and one below."""

    def relief(x: Array, y: Array) -> Array:
        inward = np.minimum(np.minimum(x - 10, 58 - x), np.minimum(y - 40, 88 - y))
        return DATUM_M + 5.0 * np.clip(inward / bank_m, 0, 1)

    blocks = (
        Block("upper", 25, 55, 14, 12, DATUM_M + 5 + 6.5, 1),
        Block("lower", 65, 15, 16, 14, DATUM_M + 6.5, 2),
    )
    forest = (Fact("upper", 1, 168, 6.5), Fact("lower", 2, 224, 6.5))
    return scan(World("plateau", blocks=blocks, relief=relief, forest=forest), seed=seed, density=density, **options)


def wall(seed: int = 0, density: float = 4.0, **options: object) -> Scene:
    """Scan a free wall 3 m high, 80 m long and 0.5 m thick, and a house."""
    blocks = (
        Block("wall", 10, 30, 80, 0.5, DATUM_M + 3.0, kind="wall", material="concrete"),
        Block("house", 40, 55, 15, 12, DATUM_M + 6.5, 1),
    )
    world = World("wall", blocks=blocks, forest=(Fact("house", 1, 180, 6.5),))
    return scan(world, seed=seed, density=density, **options)


def elevated_road(seed: int = 0, density: float = 4.0, **options: object) -> Scene:
    """Scan a road deck 7 m up that crosses the scene, and a house on either side of it."""
    blocks = (
        Block("deck", 0, 44, 100, 12, DATUM_M + 7.0, kind="deck", material="asphalt"),
        Block("south", 20, 15, 16, 14, DATUM_M + 6.5, 1),
        Block("north", 60, 70, 15, 15, DATUM_M + 9.5, 2),
    )
    forest = (Fact("south", 1, 224, 6.5), Fact("north", 2, 225, 9.5))
    return scan(World("elevated_road", blocks=blocks, forest=forest), seed=seed, density=density, **options)


def green_roof(seed: int = 0, density: float = 4.0, **options: object) -> Scene:
    """Scan a hall with a lawn on its roof inside a gravel rim of 2 m, and one tree apart."""
    hall = Block("hall", 35, 40, 30, 20, DATUM_M + 9.5, 1, material="gravel", lawn_rim_m=2.0)
    world = World("green_roof", blocks=(hall,), trees=(Tree(15, 15),), forest=(Fact("hall", 1, 600, 9.5),))
    return scan(world, seed=seed, density=density, **options)


def large_building(seed: int = 0, density: float = 2.0, **options: object) -> Scene:
    """Scan a hall of 90 m by 60 m centred on a round kilometre, so that any usual tile grid cuts it in four."""
    blocks = (
        Block("hall", 35, 30, 90, 60, DATUM_M + 12.5, 1, material="metal"),
        Block("office", 90, 65, 25, 16, DATUM_M + 18.5, 1, material="gravel"),
    )
    forest = (Fact("hall", 1, 5400, 12.5), Fact("office", 1, 400, 18.5, "hall"))
    origin = (ORIGIN[0] - 80, ORIGIN[1] - 60)
    world = World("large_building", (160, 120), blocks=blocks, forest=forest, origin=origin)
    return scan(world, seed=seed, density=density, **options)


def city(seed: int = 0, density: float = 4.0, **options: object) -> Scene:
    """Scan a quarter with all of it: tower, perimeter block, gabled rows, turned villas, trees, wall and deck."""
    rng = np.random.default_rng(20_090_617)

    def relief(x: Array, y: Array) -> Array:
        return DATUM_M + 0.015 * x + 1.2 * np.sin(y / 45.0)

    def level(x: float, y: float, height: float) -> float:
        return float(relief(np.array([x]), np.array([y]))[0]) + height

    blocks = [
        Block("podium", 20, 20, 40, 30, level(40, 35, 6.5), 1, material="gravel"),
        Block("tower", 30, 25, 20, 15, level(40, 35, 30.5), 1, material="concrete"),
        Block("ring", 80, 18, 36, 34, level(98, 35, 12.5), 2, hole=(91, 28, 14, 14)),
        Block("hall", 140, 22, 40, 26, level(160, 35, 9.5), 3, material="gravel", lawn_rim_m=2.0),
        Block("wall", 15, 66, 50, 0.5, level(40, 66, 3.0), kind="wall", material="concrete"),
        Block("deck", 0, 150, 200, 12, level(100, 156, 8.0), kind="deck", material="asphalt"),
    ]
    for n in range(8):
        west = 20 + n * 9.0 + 0.5 * (n // 2)
        house = Block(f"row {n + 1}", west, 84, 9 if n % 2 == 0 else 8.5, 11, level(60, 90, 5.6), 4 + n, ridge_m=2.5)
        blocks.append(house)
    for n in range(8):
        west, south = 112 + 21.0 * (n % 4), 78 + 30.0 * (n // 4)
        turn, material = float(rng.uniform(-35, 35)), ("tiles", "gravel", "metal")[n % 3]
        rise = 3.0 if material == "tiles" else 0.0
        roof = level(west + 6, south + 5, 5.6 + n % 3)
        blocks.append(Block(f"villa {n + 1}", west, south, 13, 10, roof, 12 + n, "building", material, turn, rise))
    trees = [Tree(8 + 11.0 * n, 62 + float(rng.uniform(-1, 1)), 3.6, 9 + n % 4, 2.5) for n in range(17)]
    trees += [
        Tree(float(x), float(y), 2.5 + float(r), 8 + 2 * float(r), 2.0)
        for x, y, r in zip(rng.uniform(5, 195, 30), rng.uniform(168, 195, 30), rng.uniform(0.5, 2.5, 30), strict=True)
    ]
    trees += [Tree(122, 92, 3.5, 9.5, 2.0), Tree(146, 76, 4.0, 11.0, 3.0), Tree(104, 96, 3.5, 10.0, 3.0)]
    forest = (Fact("podium", 1, 1200, 6.5), Fact("tower", 1, 300, 30.5, "podium"), Fact("ring", 2, 1028, 12.5))
    roads = ((0, 55, 200, 6), (68, 0, 7, 61), (0, 100, 105, 5))
    world = World("city", (200, 200), tuple(blocks), tuple(trees), relief, roads, forest=forest)
    return scan(world, seed=seed, density=density, **options)


SCENES: dict[str, Callable[..., Scene]] = {
    make.__name__: make
    for make in (
        flat_field,
        podium_tower,
        courtyard,
        row_houses,
        under_trees,
        attached_to_slope,
        plateau,
        wall,
        elevated_road,
        green_roof,
        large_building,
        city,
    )
}
"""Every scene by name."""
