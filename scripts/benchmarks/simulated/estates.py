"""Industrial estates: wide halls of several levels, and what hides their walls."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

SIDE_M = 500.0
MOST_HALLS, TRIES = 6, 40
NOISE_M = 0.03


@dataclass(frozen=True)
class Hall:
    """A hall in the axes of its estate, metres."""

    along: float
    across: float
    length: float
    width: float


@dataclass(frozen=True)
class Estate:
    """Points of an estate, metres, the hall that each lies on, or -1, and whether it lies on the terrain."""

    x: Floats
    y: Floats
    z: Floats
    on: NDArray[np.int64]
    bare: NDArray[np.bool_]
    halls: tuple[Hall, ...]


def estate(seed: int, density: float) -> Estate:
    """Scan an estate of 25 ha on a plane of up to 5 %.

    Halls are 30 to 260 m long, 25 to 180 m wide and 5 to 13 m high. A hall has up to three parts that are higher or
    lower, and may have a parapet and plant. Beside it are loading ramps, canopies, trucks, bushes and trees.

    Parameters
    ----------
    seed : int
    density : float
        Points a square metre; each is a first and only echo.
    """
    rng = np.random.default_rng(seed)
    x, y = rng.uniform(0, SIDE_M, (2, int(SIDE_M**2 * density)))
    slope, to = rng.choice([0, 0, 0.02, 0.05]), rng.uniform(0, 2 * np.pi)
    turn = rng.uniform(0, np.pi / 2)
    cos, sin = np.cos(turn), np.sin(turn)
    along = (x - SIDE_M / 2) * cos + (y - SIDE_M / 2) * sin
    across = (y - SIDE_M / 2) * cos - (x - SIDE_M / 2) * sin
    terrain = slope * (x * np.cos(to) + y * np.sin(to))
    z, on = terrain.copy(), np.full(len(x), -1)
    halls = _placed(rng)
    for number, hall in enumerate(halls):
        east = SIDE_M / 2 + hall.along * cos - hall.across * sin
        north = SIDE_M / 2 + hall.along * sin + hall.across * cos
        base = slope * (east * np.cos(to) + north * np.sin(to))
        a, b = along - hall.along, across - hall.across
        inside = (np.abs(a) < hall.length / 2) & (np.abs(b) < hall.width / 2)
        z = np.where(inside, _roof(rng, hall, a, b) + base, z)
        on[inside] = number
        for top in _beside(rng, hall, a, b):
            z = np.where(inside, z, np.maximum(z, top + base))
        z = np.where(inside, z, np.maximum(z, terrain + _planted(rng, hall, a, b)))
    return Estate(x, y, z + rng.normal(0, NOISE_M, len(z)), on, z <= terrain, halls)


def _placed(rng: np.random.Generator) -> tuple[Hall, ...]:
    """Return halls with yards of 14 m between them; the border may cut them."""
    halls: list[Hall] = []
    for _ in range(TRIES):
        hall = Hall(*rng.uniform(-220, 220, 2), rng.uniform(30, 260), rng.uniform(25, 180))
        apart = [
            abs(hall.along - other.along) >= (hall.length + other.length) / 2 + 14
            or abs(hall.across - other.across) >= (hall.width + other.width) / 2 + 14
            for other in halls
        ]
        if all(apart) and len(halls) < MOST_HALLS:
            halls.append(hall)
    return tuple(halls)


def _roof(rng: np.random.Generator, hall: Hall, a: Floats, b: Floats) -> Floats:
    """Return the heights of a hall above its floor."""
    top = rng.uniform(5, 13) + 0.015 * a
    for _ in range(rng.integers(0, 4)):
        at_a, at_b = rng.uniform(-0.5, 0.5, 2) * (hall.length, hall.width)
        part = (np.abs(a - at_a) < rng.uniform(0.05, 0.25) * hall.length) & (
            np.abs(b - at_b) < rng.uniform(0.1, 0.4) * hall.width
        )
        top = np.where(part, top + rng.choice([0.8, 1.0, 1.5, 3.0, 5.0, -1.5, -3.0]), top)
    if rng.random() < 0.4:
        top = np.where(np.minimum(hall.length / 2 - np.abs(a), hall.width / 2 - np.abs(b)) < 0.5, top + 1, top)
    for at_a, at_b in rng.uniform(-0.5, 0.5, (int(hall.length * hall.width / 400 * rng.random()), 2)):
        plant = (np.abs(a - at_a * hall.length) < 1.5) & (np.abs(b - at_b * hall.width) < 1.5)
        top = np.where(plant, top + 1.5, top)
    return np.asarray(top)


def _beside(rng: np.random.Generator, hall: Hall, a: Floats, b: Floats) -> list[Floats]:
    """Return what stands at the walls, heights above the floor: loading ramps, canopies, and rows of trucks."""
    found = []
    for _ in range(rng.integers(0, 5)):
        side, kind = rng.integers(4), rng.integers(3)
        at, off, length, width = (a, b, hall.length, hall.width) if side < 2 else (b, a, hall.width, hall.length)
        distance = off * (1 if side % 2 else -1) - width / 2
        near = (distance > 0) & (np.abs(at - rng.uniform(-0.5, 0.5) * length) < rng.uniform(0.025, 0.15) * length)
        if kind == 0:
            top, chosen = 1.3 - 0.08 * distance, near & (distance < rng.uniform(8, 20))
        elif kind == 1:
            top, chosen = np.full(len(a), rng.uniform(3, 5)), near & (distance < rng.uniform(3, 12))
        else:
            top, chosen = np.full(len(a), 3.8), near & (distance > 0.5) & (distance < 14) & (at % 4 < 2.6)
        found.append(np.where(chosen, top, -np.inf))
    return found


def _planted(rng: np.random.Generator, hall: Hall, a: Floats, b: Floats) -> Floats:
    """Return the heights of bushes and trees along the walls above the terrain."""
    top = np.full(len(a), -np.inf)
    around = 2 * (hall.length + hall.width)
    for _ in range(int(around / 16 * rng.random())):
        on_edge = rng.uniform(0, around)
        if on_edge < 2 * hall.length:
            at_a = on_edge % hall.length - hall.length / 2
            at_b = (hall.width / 2 + 1.5) * (1 if on_edge < hall.length else -1)
        else:
            rest = on_edge - 2 * hall.length
            at_a = (hall.length / 2 + 1.5) * (1 if rest < hall.width else -1)
            at_b = rest % hall.width - hall.width / 2
        crown = (a - at_a) ** 2 + (b - at_b) ** 2 < rng.uniform(1, 3.5) ** 2
        top[crown] = np.maximum(top[crown], rng.uniform(1, 8) * rng.uniform(0.3, 1, np.count_nonzero(crown)))
    return top
