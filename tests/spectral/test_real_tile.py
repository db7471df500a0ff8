"""Suggested labels on a real survey whose points are classified; skipped without the real tiles."""

import os
from pathlib import Path

import numpy as np
import pytest
from scipy import ndimage
from support.notices import with_notices

from msbdb.grid import Bands, Grid, lattice
from msbdb.io.las import read_points
from msbdb.io.ortho import read_bands
from msbdb.params import Params, with_values
from msbdb.spectral.colours import spectral_bands
from msbdb.spectral.coverclasses import classify
from msbdb.surface.gridding import sample_nearest
from msbdb.surface.texture import roughness

DATA = os.environ.get("MSBDB_DATA", "")
pytestmark = [pytest.mark.data, pytest.mark.skipif(not DATA, reason="MSBDB_DATA names no real tiles")]


@pytest.fixture(scope="module")
def tile():
    """Read the part of a tile under its orthophotos: bands, nDSM, roughness, and crowns and roofs by the classes."""
    folder = Path(DATA) / "montpellier"
    points, _ = with_notices(read_points, folder / "points.laz", crs=2154)
    spec = lattice((770550.1, 6277550.1, 770599.9, 6277599.9), 0.5, points.crs)
    row, col = spec.rowcol(points.x, points.y)
    points = points.take((row >= 0) & (row < spec.shape[0]) & (col >= 0) & (col < spec.shape[1]))
    row, col = spec.rowcol(points.x, points.y)
    lowest = np.full(spec.shape, np.inf)
    ground = points.classification == 2
    np.minimum.at(lowest, (row[ground], col[ground]), points.z[ground])
    terrain = lowest[tuple(ndimage.distance_transform_edt(np.isinf(lowest), return_indices=True)[1])]
    samples = sample_nearest(points, spec)
    valid = np.isfinite(samples.z)
    ndsm = Grid(np.where(valid, samples.z - terrain, 0).astype(np.float32), valid, spec)
    share = {}
    for name, classes in {"crown": (3, 4, 5), "roof": (6,)}.items():
        chosen = np.isin(points.classification, classes) & points.first_echo
        share[name] = np.bincount((row * spec.shape[1] + col)[chosen], minlength=valid.size).reshape(spec.shape)
    images = read_bands([folder / "ortho_rgb.tif", folder / "ortho_irc.tif"], spec, crs=2154)
    bands = spectral_bands(images, points, spec, max_gap_m=5.0)
    return bands, ndsm, roughness(samples, 1.5), share["crown"] > share["roof"], share["roof"] > share["crown"]


def _without_infrared(bands):
    """Drop the near infrared."""
    kept = [number for number, name in enumerate(bands.names) if name != "nir"]
    names = tuple(bands.names[number] for number in kept)
    return Bands(bands.values[kept].copy(), names, bands.valid.copy(), bands.spec)


@pytest.mark.parametrize("infrared", [True, False])
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_crowns_are_told_from_roofs(tile, infrared, seed):
    """Nine of ten crown cells are vegetation and nine of ten roof cells building, with near infrared or without."""
    bands, ndsm, rough, crown, roof = tile
    params = with_values(Params(), {"spectral": {"seed": seed}})
    classes, *_ = classify(bands if infrared else _without_infrared(bands), ndsm, rough, params)
    seen = classes.index > 0
    assert seen.sum() > 3000
    assert classes.labelled("vegetation")[seen & crown].mean() > 0.9
    assert classes.labelled("building")[seen & roof].mean() > 0.9
