"""Flat regions of a build: from points or rasters to the tables that the database takes."""

from dataclasses import dataclass
from pathlib import Path

import geopandas as gpd
import numpy as np
import pandas as pd
from numpy.typing import NDArray

from msbdb.detect.flatregions.initialisation import initialise
from msbdb.detect.flatregions.mongus2013 import extract_flat_regions
from msbdb.grid import Grid, GridSpec
from msbdb.labels import reorder
from msbdb.outline.polygons import polygonise
from msbdb.outline.simplification import simplify_coverage
from msbdb.params import Params
from msbdb.points.cloud import PointCloud
from msbdb.surface import Surface
from msbdb.tables import FLAT_REGION, REJECTION
from msbdb.view.regionmap import draw_denoising


@dataclass(frozen=True, slots=True, eq=False)
class Flat:
    """The flat regions of a build.

    Parameters
    ----------
    labels : (H, W) ndarray of int32
        0 for none, otherwise row number + 1 in ``regions``.
    regions : GeoDataFrame
        ``tables.FLAT_REGION``, in order of the ids, as the database gives them back.
    rejections : DataFrame
        ``tables.REJECTION`` without geometry.
    counts : dict
        By stage.
    extracted : bool
        False where flat regions were not asked for: then nothing is known of any building's flat share.
    firm : (H, W) ndarray of bool, optional
        The cells of the regions that have a say in the fused footprints: those that R leaves without allowance for
        large cells. None where all have.
    """

    labels: NDArray[np.int32]
    regions: gpd.GeoDataFrame
    rejections: pd.DataFrame
    counts: dict[str, dict[str, int]]
    extracted: bool
    firm: NDArray[np.bool_] | None = None

    @property
    def firm_labels(self) -> NDArray[np.int32]:
        """``labels`` of the firm cells, 0 elsewhere."""
        return self.labels if self.firm is None else np.where(self.firm, self.labels, np.int32(0))


def no_flat_regions(spec: GridSpec) -> Flat:
    """Return what stands for flat regions where none were asked for."""
    regions = gpd.GeoDataFrame(FLAT_REGION.empty(), geometry=[], crs=spec.crs)
    return Flat(np.zeros(spec.shape, dtype=np.int32), regions, REJECTION.empty(), {}, extracted=False)


def find_flat_regions(
    surface: Surface, cloud: PointCloud | None, params: Params, *, survey: str, figure: Path | None
) -> Flat:
    """Extract the flat regions, and draw the surface before and after denoising where a figure is asked for.

    From points the lowest echo of each cell counts (M8); from rasters, the surface as it is.
    """
    spec = surface.ndsm.spec
    max_gap_m = params.surface.max_gap_m if params.flatregions.gaps == "near" else 0.0
    lowest = initialise(cloud, spec, max_gap_m=max_gap_m) if cloud is not None else surface.dsm
    if params.flatregions.on == "ndsm":
        lowest = above_ground(lowest, surface.dtm)
    found = extract_flat_regions(lowest, heights=surface.ndsm, survey=survey, params=params)
    if figure is not None:
        draw_denoising(lowest, found.denoised, figure, title=survey)
    order = np.argsort(found.regions["region_id"].to_numpy(), kind="stable")
    labels = reorder(found.labels, order, len(order))
    traced = polygonise(labels, spec, len(order))
    outlines = simplify_coverage(traced, params.vector.simplify_px * spec.cell_m)
    regions = found.regions.iloc[order].reset_index(drop=True)
    frame = gpd.GeoDataFrame(regions, geometry=list(outlines), crs=spec.crs)
    firm = None if found.firm[found.labels > 0].all() else found.firm
    frame = frame[[*FLAT_REGION.names, "geometry"]]
    return Flat(labels, frame, found.rejections, found.counts, extracted=True, firm=firm)


def above_ground(surface: Grid, dtm: Grid) -> Grid:
    """Subtract the terrain from another surface than the DSM."""
    valid = surface.valid & dtm.valid
    height = np.asarray(surface.values, dtype=np.float32) - np.asarray(dtm.values, dtype=np.float32)
    return Grid(np.where(valid, height, np.float32(0)), valid, surface.spec)
