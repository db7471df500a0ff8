"""Candidate regions of a build: from the points' extractors to the tables that the database takes."""

from dataclasses import dataclass

import geopandas as gpd
import numpy as np
import pandas as pd
from numpy.typing import NDArray

from msbdb.bands import Bands
from msbdb.detect.adaptive.bathurst import extract_adaptive
from msbdb.detect.area3d.caowu import extract_area3d
from msbdb.detect.pointregions import Candidates
from msbdb.ground.quadratic import ground_heights
from msbdb.outline.pointoutlines import outline_regions
from msbdb.outline.polygons import rasterise
from msbdb.params import Params
from msbdb.points.cloud import PointCloud
from msbdb.surface import Surface, heights_above


@dataclass(frozen=True, slots=True, eq=False)
class CandidateLayer:
    """The candidate regions of one extractor on the lattice.

    Parameters
    ----------
    method : str
        ``area3d`` or ``adaptive``, as in the ledger and the counts.
    labels : (H, W) ndarray of int32
        0 for none, otherwise row number + 1 in ``regions``.
    regions : GeoDataFrame
        ``tables.CANDIDATE_REGION``, in order of the ids, as the database gives them back.
    rejections : DataFrame
        ``tables.REJECTION`` without geometry.
    counts : dict
        By stage.
    """

    method: str
    labels: NDArray[np.int32]
    regions: gpd.GeoDataFrame
    rejections: pd.DataFrame
    counts: dict[str, dict[str, int]]


def point_heights(cloud: PointCloud, surface: Surface, params: Params) -> NDArray[np.float64]:
    """Return the points' heights above ground, metres.

    The quadratic ground filter gives them itself (C13, Eq. 6); any other filter gives a terrain to subtract.
    """
    if surface.ground_filter == "quadratic":
        return np.asarray(cloud.z - ground_heights(cloud, params.ground))
    return heights_above(cloud, surface.dtm)


def point_ndvi(bands: Bands | None, cloud: PointCloud) -> NDArray[np.float32] | None:
    """Return the vegetation index (nir - red) / (nir + red) of each point's cell.

    Parameters
    ----------
    bands : Bands, optional
        Of an orthophoto, or gridded from the points.
    cloud : PointCloud
        N points in the bands' CRS.

    Returns
    -------
    (N,) ndarray of float32 or None
        From -1 to 1; NaN where the cell has no colours or is black, or there is no cell. None without the bands
        ``red`` and ``nir``.
    """
    red, nir = (None, None) if bands is None else (bands.band("red"), bands.band("nir"))
    if bands is None or red is None or nir is None:
        return None
    total = red + nir
    usable = bands.valid & (total > 0)
    index: NDArray[np.float32] = np.full(red.shape, np.nan, dtype=np.float32)
    np.divide(nir - red, total, out=index, where=usable)
    return bands.spec.sample(index, cloud.x, cloud.y, outside=np.nan)


def point_candidates(
    method: str, cloud: PointCloud, surface: Surface, *, ndvi: NDArray[np.float32] | None, params: Params, survey: str
) -> Candidates:
    """Extract the candidate regions of one of ``POINT_DETECTORS``."""
    extract = extract_area3d if method == "area3d" else extract_adaptive
    heights = point_heights(cloud, surface, params)
    return extract(cloud, heights, spec=surface.ndsm.spec, survey=survey, params=params, ndvi=ndvi)


def find_regions(
    method: str, cloud: PointCloud, surface: Surface, *, ndvi: NDArray[np.float32] | None, params: Params, survey: str
) -> CandidateLayer:
    """Extract the candidate regions of one of ``POINT_DETECTORS``, and draw their outlines."""
    found = point_candidates(method, cloud, surface, ndvi=ndvi, params=params, survey=survey)
    spec = surface.ndsm.spec
    outlines = outline_regions(
        cloud.x, cloud.y, found.labels, len(found.regions), spacing_m=1 / surface.density**0.5, params=params.vector
    )
    regions = gpd.GeoDataFrame(found.regions, geometry=list(outlines), crs=spec.crs)
    return CandidateLayer(method, rasterise(outlines, spec), regions, found.rejections, found.counts)
