"""Pictures over rasters of heights: real orthophotos, the colours of the points, and painted ones with known roofs."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import laspy
import numpy as np
from numpy.typing import NDArray
from pyproj import CRS
from rasterio.fill import fillnodata
from scipy import ndimage

from cases.kinds import THINNED, as_they_are
from cases.labelled import NAMED, Reference, reference_of
from cases.measures import Case
from msbdb.grid import GridSpec, lattice
from msbdb.points.cloud import NOISE_CLASSES

PICTURE_M = 0.5
"""Cells of the rasters and of the pictures, metres."""

ORTHOPHOTOS = {
    "montpellier": {"RGB": ("montpellier/ortho_rgb.tif",), "near infrared": ("montpellier/ortho_irc.tif",)},
    "beziers_left": {
        "RGB": ("beziers/ortho_rgb_0.tif", "beziers/ortho_rgb_1.tif"),
        "near infrared": ("beziers/ortho_irc_0.tif", "beziers/ortho_irc_1.tif"),
    },
}
"""The orthophotos of places, each of which covers a part."""

COLOURED = "sevilla_plaza"
"""The place whose points have colours."""

RED = (150, 85, 70)
ROOFS = {
    "red": [RED],
    "six colours": [RED, (120, 120, 120), (70, 70, 75), (200, 200, 195), (110, 100, 85), (90, 110, 95)],
}
"""Colours of the roofs of painted pictures, one an object at random."""

ASPHALT, LAWN, CROWN = (125, 122, 118), (95, 115, 70), (75, 100, 60)

TALL_M = 2.0
"""What is no roof and reaches so far above the lowest echoes around it is painted as a crown."""

REACH_M = 30.0
"""The lowest echoes are searched in a square of this side."""


def with_pictures(data: Path, names: set[str]) -> Iterator[Case]:
    """Yield places as rasters of heights with a picture."""
    for case in as_they_are(data, names & {*THINNED, *ORTHOPHOTOS}):
        reference = reference_of(NAMED[case.name], case.clouds, data, max(case.reference.spec.cell_m, PICTURE_M))
        base = replace(case, reference=reference, known={}, raster_m=PICTURE_M)
        for kind, files in ORTHOPHOTOS.get(case.name, {}).items():
            yield replace(base, name=f"{case.name}, {kind}", ortho=tuple(data / file for file in files))
        if case.name == COLOURED:
            yield replace(base, name=f"{case.name}, RGB", picture=coloured(case.clouds[0], case.crs))
        if case.name in THINNED:
            pictures = {kind: painted(case.clouds, reference, colours) for kind, colours in ROOFS.items()}
            pictures["black and white"] = np.repeat(pictures["six colours"].mean(axis=0, keepdims=True), 3, axis=0)
            for kind, picture in pictures.items():
                yield replace(base, name=f"{case.name}, {kind}", picture=(picture, reference.spec))


def painted(
    clouds: list[laspy.LasData], reference: Reference, colours: list[tuple[int, int, int]]
) -> NDArray[np.float64]:
    """Paint roofs, crowns, lawns and asphalt, (3, H, W): each with its light and shade, crowns with the strongest."""
    rng = np.random.default_rng(1)
    spec = reference.spec
    top, low = np.full(spec.shape, -np.inf), np.full(spec.shape, np.inf)
    for cloud in clouds:
        z = np.asarray(cloud.z)
        row, col = spec.rowcol(np.asarray(cloud.x), np.asarray(cloud.y))
        kept = (row >= 0) & (row < spec.shape[0]) & (col >= 0) & (col < spec.shape[1])
        kept &= ~np.isin(np.asarray(cloud.classification), NOISE_CLASSES)
        np.maximum.at(top, (row[kept], col[kept]), z[kept])
        np.minimum.at(low, (row[kept], col[kept]), z[kept])
    low = np.where(np.isfinite(low), low, np.median(low[np.isfinite(low)]))
    ground = ndimage.percentile_filter(low, 5, size=max(3, round(REACH_M / spec.cell_m)))
    crowns = (top - ground > TALL_M) & ~reference.built
    grown = ndimage.gaussian_filter(rng.normal(size=spec.shape), 5 / spec.cell_m)
    picture = np.where((grown > np.quantile(grown, 0.7))[..., None], np.array(LAWN), np.array(ASPHALT)).astype(float)
    roofs, count = ndimage.label(reference.built)
    chosen = np.array(colours)[rng.integers(len(colours), size=count + 1)]
    picture[reference.built] = chosen[roofs[reference.built]]
    picture[crowns] = CROWN
    light = ndimage.gaussian_filter(rng.normal(size=spec.shape), 1.0)
    light /= light.std()
    picture *= np.clip(1 + np.where(crowns, 0.35, 0.1) * light, 0.3, 1.7)[..., None]
    picture += rng.normal(scale=4, size=picture.shape)
    return np.moveaxis(np.floor(np.clip(picture, 1, 255)), 2, 0)


def coloured(cloud: laspy.LasData, crs: str) -> tuple[NDArray[np.float32], GridSpec]:
    """Return the colours of the first echoes as a picture, gaps filled."""
    first = np.asarray(cloud.return_number) <= 1
    x, y = np.asarray(cloud.x)[first], np.asarray(cloud.y)[first]
    spec = lattice((x.min(), y.min(), x.max(), y.max()), PICTURE_M, CRS.from_user_input(crs))
    row, col = spec.rowcol(x, y)
    bands = []
    for name in ("red", "green", "blue"):
        values, seen = np.zeros(spec.shape, dtype=np.float32), np.zeros(spec.shape, dtype=bool)
        values[row, col] = np.asarray(cloud[name])[first] / 256
        seen[row, col] = True
        bands.append(fillnodata(values, seen, max_search_distance=8))
    return np.stack(bands), spec
