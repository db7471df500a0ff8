"""What exports are made of: a simulated town, with a level of the ground that its heights above ground lack."""

from dataclasses import replace

import geopandas as gpd

from msbdb.export import Content
from msbdb.io.layers import Layer
from support.towns import House, town_build

HOUSES: list[House] = [
    (10, 10, 50, 40, 6.0),
    (20, 15, 30, 30, 15.0),
    (60, 10, 100, 50, 9.0),
    (72, 22, 88, 38, 0.0),
    (110, 10, 122, 22, 5.0),
]
"""A podium with a tower, a block around a courtyard, and a house; metres from the corner, and their heights."""

GROUND_M = 41.5
"""Level of the ground."""


def town_content(*, vertical: str = "EGM2008 height", empty: bool = False) -> Content:
    """Return the town as an export reads it from a database of one survey."""
    kept = town_build("spring", "2024-05-31", HOUSES)
    building, part = kept.frames["building"], kept.frames["part"]
    levels = dict.fromkeys(("z_ground", "z_ground_min", "z_ground_max"), GROUND_M)
    building = building.assign(**levels, eaves=building["h_p50"], ridge=building["h_max"])
    building = building.assign(z_eaves=GROUND_M + building["eaves"], z_ridge=GROUND_M + building["ridge"])
    frames = {"footprint": building, "part": part}
    layers = {name: Layer.of(gpd.GeoDataFrame(frame[: 0 if empty else None])) for name, frame in frames.items()}
    return Content("survey", layers, () if empty else (replace(kept.survey, vertical_crs=vertical),))
