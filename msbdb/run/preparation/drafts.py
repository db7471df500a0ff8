"""Drafts: a survey, or a block of it, on its lattice: surface, cover by structure and bands."""

import logging
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from msbdb.detect.pointregions import heights_of_points
from msbdb.errors import GridMismatchError, NodataError
from msbdb.grid import Bands, Bounds, Grid, GridSpec, lattice
from msbdb.ground.choice import POINT_FILTERS, terrain, with_decks
from msbdb.io.las import read_points
from msbdb.io.ortho import read_bands
from msbdb.io.raster import align_grid
from msbdb.io.vector import Area
from msbdb.outline.polygons import rasterise
from msbdb.params import Params
from msbdb.points.cloud import PointCloud
from msbdb.run.inputs import Inputs
from msbdb.run.preparation.rastersurface import note_offset, note_sparse, read_terrain, surface_of_rasters, without_gaps
from msbdb.run.reports import Progress, Stages
from msbdb.spectral.colours import spectral_bands
from msbdb.spectral.coverclasses import is_imagery
from msbdb.spectral.kmeans import load_solver
from msbdb.surface import Surface, cover_from_surface
from msbdb.surface.cover import roughness_by_window
from msbdb.surface.gridding import Samples, cell_size, density
from msbdb.surface.heights import GIVEN_GROUND, grid_surface, normalise
from msbdb.surface.structure import Structure
from msbdb.surveyplan import PointFacts
from msbdb.threads import together

logger = logging.getLogger(__name__)

WINDOW_CELLS = 3
"""Least width of a window of the texture, cells."""


@dataclass(frozen=True, slots=True, eq=False)
class Draft:
    """A survey, or a block of it, on its lattice: as far as that goes without the plan's other values.

    Parameters
    ----------
    surface : Surface
        DSM, DTM and nDSM.
    structure : Structure
        Land cover by structure.
    bands : Bands or None
        Colours and intensity on the lattice.
    cloud : PointCloud or None
        The points, which know the facts of the survey; None for rasters.
    above : (N,) ndarray of float64 or None
        Heights of the points above ground, metres; None where nobody asks for them.
    """

    surface: Surface
    structure: Structure
    bands: Bands | None
    cloud: PointCloud | None
    above: NDArray[np.float64] | None

    @classmethod
    def of(
        cls,
        surface: Surface,
        structure: Structure,
        bands: Bands | None,
        cloud: PointCloud | None,
        params: Params,
        *,
        planned: bool = False,
    ) -> "Draft":
        """Return a draft; with the heights of its points where no plan is known, or they are slow to find again."""
        known = cloud is None or (planned and surface.ground_filter not in POINT_FILTERS)
        above = None if cloud is None or known else heights_of_points(surface, cloud, params)
        return cls(surface, structure, bands, cloud, above)

    def within(self, inside: NDArray[np.bool_]) -> "Draft":
        """Return the draft without all that lies outside of the (H, W) cells of an area; the terrain stays."""
        surface, cover, cloud, bands = self.surface, self.structure.cover, self.cloud, self.bands
        points = None if cloud is None else surface.ndsm.spec.sample(inside, cloud.x, cloud.y, outside=False)
        cover = replace(cover, index=np.where(inside, cover.index, np.uint8(0)))
        if bands is not None:
            bands = Bands(np.where(inside, bands.values, np.float32(0)), bands.names, bands.valid & inside, bands.spec)
        return Draft(
            replace(surface, dsm=_cut(surface.dsm, inside), ndsm=_cut(surface.ndsm, inside)),
            replace(self.structure, cover=cover),
            bands,
            None if cloud is None or points is None else cloud.take(points),
            None if self.above is None or points is None else self.above[points],
        )


def _cut(grid: Grid, inside: NDArray[np.bool_]) -> Grid:
    """Return a grid that is valid inside an area alone."""
    values = np.where(inside, np.asarray(grid.values), np.float32(0)).astype(np.float32)
    return grid.with_values(values, grid.valid & inside)


def read_cloud(
    inputs: Inputs, progress: Progress | None, facts: PointFacts | None = None, area: Area | None = None
) -> PointCloud | None:
    """Read the points, where the build is from points.

    ``facts`` are those of a survey that they are a part of. Only points in the ``area`` are read, by default that of
    interest with its margin.
    """
    if not inputs.points:
        return None
    area = inputs.area() if area is None else area
    return read_points(
        inputs.points,
        crs=inputs.any_crs,
        z_unit=inputs.z_unit,
        target=inputs.any_target,
        bounds=inputs.bounds,
        facts=facts,
        area=area,
        progress=progress,
    )


def make_draft(
    inputs: Inputs,
    cloud: PointCloud | None,
    params: Params,
    stages: Stages,
    *,
    sampled: bool = False,
    planned: bool = False,
    seen: Bounds | None = None,
) -> Draft:
    """Return the surface, its cover by structure and its bands: all that needs no other value of the plan.

    A block that is ``sampled`` has no bands where it lies beyond the images. What only a plan asks for is left out
    where this is ``planned``. Of rasters of heights only what lies in the bounds ``seen`` is read.
    """

    def separate() -> tuple[Surface, Structure]:
        with stages.stage("surface"):
            surface = make_surface(inputs, cloud, params, seen)
        with stages.stage("cover"):
            return replace(surface, roughness={}), cover_from_surface(surface, cloud, params, planned=planned)

    def gather(spec: GridSpec) -> Bands | None:
        with stages.stage("bands"):
            try:
                ortho = read_bands(list(inputs.ortho), spec, crs=inputs.any_ortho_crs) if inputs.ortho else None
                bands = spectral_bands(ortho, cloud, spec, max_gap_m=params.surface.max_gap_m)
            except GridMismatchError:
                if not sampled:
                    raise
                return None
            if is_imagery(bands) and not planned:
                load_solver()  # while the surface is still being made
            return bands

    if cloud is None:
        surface, structure = separate()
        spec = surface.ndsm.spec
        bands = gather(spec)
    else:
        spec = lattice_of_points(cloud, params)
        with stages.side_by_side():
            (surface, structure), bands = together(separate, partial(gather, spec))
    draft, area = Draft.of(surface, structure, bands, cloud, params, planned=planned), inputs.area()
    if area is None:
        return draft
    inside = rasterise([area.shape_in(spec.crs, margin=False)], spec) > 0
    if not (inside & surface.ndsm.valid).any():
        msg = f"No cell of the survey has its centre in {area.what}. Check the area, its CRS, and that of the heights."
        raise NodataError(msg)
    return draft.within(inside)


def make_surface(inputs: Inputs, cloud: PointCloud | None, params: Params, seen: Bounds | None = None) -> Surface:
    """Build the surface from the points, or take it from the rasters, perhaps only from their part ``seen``."""
    if cloud is None:
        return surface_of_rasters(inputs, params.surface.max_gap_m, seen)
    return build_surface(cloud, params, None if inputs.dtm is None else partial(read_terrain, inputs, inputs.dtm))


def build_surface(points: PointCloud, params: Params, given: Callable[[GridSpec], Grid] | None = None) -> Surface:
    """Grid the first echoes, detect the ground, and subtract it (V13 to V16); measure the roughness meanwhile.

    Parameters
    ----------
    points : PointCloud
        All echoes of the survey; outliers are gone.
    params : Params
        Sections ``surface`` and ``ground``.
    given : callable, optional
        Takes a lattice, and returns the terrain around it on any lattice and CRS; without it the ground is detected
        among the points.

    Raises
    ------
    NodataError
        When there is no first echo, or no ground.
    GridMismatchError
        When the given terrain is of another place.
    """
    points_m2 = density(points)
    note_sparse(points_m2, "first echoes")
    spec = lattice_of_points(points, params)
    aligned = None if given is None else align_grid(given(spec), spec, role="DTM")

    def measure() -> tuple[Grid, Samples, dict[tuple[float, int], NDArray[np.float32]]]:
        dsm, samples = grid_surface(points, spec, params)
        return dsm, samples, roughness_by_window(samples, params.cover)

    if aligned is None:
        (dsm, samples, rough), (dtm, name) = together(measure, partial(terrain, points, spec, params.ground))
    else:
        dsm, samples, rough = measure()
        dtm, name = with_decks(without_gaps(aligned, dsm), points, params.ground), GIVEN_GROUND
    surface_is = "The surface has %d x %d cells of %s m from %.1f points/m2. The ground is by the filter '%s'"
    logger.info(surface_is, *spec.shape, spec.cell_m, points_m2, name)
    surface = Surface(dsm, dtm, normalise(dsm, dtm), samples, name, points_m2, roughness=rough)
    if given is not None:
        note_offset([surface.ndsm])
    return surface


def lattice_of_points(points: PointCloud, params: Params) -> GridSpec:
    """Return the lattice on which a survey from points is built."""
    cell_m = params.surface.cell_m or cell_of_points(points, density(points), params)
    return lattice(points.bounds, cell_m, points.crs)


def cell_of_points(points: PointCloud, points_m2: float, params: Params) -> float:
    """Return the cell size by the mean spacing; a larger one where the texture would see single scan lines, metres.

    A window of the texture needs points of two lines for a plane. It is three cells wide at least. Where much of the
    ground is far sparser than the rest, the spacing is `PointFacts.even_m`: smaller cells would be empty there.
    """
    if params.surface.cell_rule == "literal":
        return cell_size(points_m2, literal=True)
    facts = points.facts
    sparser, two_lines_m = (1.0, 0.0) if facts is None else (facts.spacing_m / facts.even_m, 2 * facts.link_m)
    cell_m = cell_size(points_m2 * sparser**2)
    if two_lines_m <= params.cover.window_m:
        return cell_m
    return max(cell_m, cell_size((WINDOW_CELLS / two_lines_m) ** 2))
