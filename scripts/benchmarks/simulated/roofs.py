"""Simulated single houses of known eaves and ridge, with roofs of all common forms."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pandas as pd

from msbdb.detect.scene import Elevations
from msbdb.fuse.roofheights import measure_heights
from msbdb.params import Params
from msbdb.run.preparation.drafts import build_surface
from simulated.scenes import DATUM_M, Array, Block, World, scan

DENSITIES = (0.5, 1.0, 2.0, 4.0, 16.0)
"""First echoes a square metre."""

SIDE_M = 70.0


@dataclass(frozen=True)
class House(Block):
    """A block with a roof of a form: flat, gable, hip, shed or pyramid; `ridge_m` is its rise above the eaves."""

    form: str = "gable"

    def top(self, x: Array, y: Array) -> Array:
        """Elevation of the roof; a ridge runs along the house's own east-west axis."""
        along, across = self._own(x, y)
        half, deep = self.width / 2, self.depth / 2
        share = {
            "flat": lambda: np.zeros_like(x),
            "gable": lambda: 1 - np.abs(across) / deep,
            "hip": lambda: np.minimum(1 - np.abs(across) / deep, (half - np.abs(along)) / deep),
            "shed": lambda: (across + deep) / self.depth,
            "pyramid": lambda: np.minimum(1 - np.abs(across) / deep, 1 - np.abs(along) / half),
        }[self.form]()
        return self.level_m + self.ridge_m * np.clip(share, 0, 1)


def houses() -> Iterator[House]:
    """Yield the houses, each along the cells and turned."""
    for form, width, depth, eaves_m, rise_m in (
        ("flat", 12, 10, 6.5, 0.0),
        ("flat", 20, 15, 12.5, 0.0),
        ("gable", 12, 9, 5.5, 4.5),
        ("gable", 8, 10, 3.2, 3.0),
        ("gable", 30, 12, 8.5, 5.0),
        ("gable", 12, 8, 6.3, 6.9),
        ("hip", 14, 10, 5.6, 4.0),
        ("shed", 12, 8, 3.3, 3.0),
        ("pyramid", 10, 10, 5.7, 4.0),
    ):
        for turn_deg in (0.0, 27.0):
            name = f"{form} {width} x {depth} m, {turn_deg:g} degrees"
            middle = (SIDE_M - width) / 2, (SIDE_M - depth) / 2
            yield House(
                name, *middle, width, depth, DATUM_M + eaves_m, 1, "building", "tiles", turn_deg, rise_m, form=form
            )


def measured(
    house: House, density: float, *, seed: int = 1, params: Params | None = None, world: World | None = None
) -> pd.Series:
    """Scan a house, in a world of its own or in a given one, and return its heights within its true footprint."""
    params, world = params or Params(), world or World("house", (SIDE_M, SIDE_M), (house,))
    points = scan(world, seed=seed, density=density).points
    surface = build_surface(points, params)
    east, north = np.broadcast_arrays(*surface.dsm.spec.centres())
    labels = house.inside(east - world.origin[0], north - world.origin[1]).astype(np.int32)
    return measure_heights(
        labels, 1, surface.ndsm, Elevations.of(surface, points), params=params.heights, surface=params.surface
    ).iloc[0]


def errors_of(density: float, *, seeds: tuple[int, ...] = (1, 2), params: Params | None = None) -> pd.DataFrame:
    """Return the errors of all houses: ``ground``, ``eaves``, ``ridge`` in metres, and ``storeys``."""
    rows = []
    for house in houses():
        eaves = house.level_m - DATUM_M
        for seed in seeds:
            found = measured(house, density, seed=seed, params=params)
            rows.append(
                {
                    "house": house.name,
                    "ground": found["z_ground"] - DATUM_M,
                    "eaves": found["eaves"] - eaves,
                    "ridge": found["ridge"] - eaves - house.ridge_m,
                    "storeys": found["storeys"] - (1 + (eaves - 2) // 3),
                }
            )
    return pd.DataFrame(rows)
