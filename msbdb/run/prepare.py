"""Preparation: from the files of a survey to the scene in which the detectors look for buildings."""

import logging
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from msbdb.database import require_past
from msbdb.detect.scene import Elevations, Evidence, Scene
from msbdb.errors import GridMismatchError, InputError, NodataError, collected_notices, give_notice
from msbdb.grid import Bands, Bounds, Grid, GridSpec, lattice
from msbdb.ground.choice import terrain
from msbdb.io.las import read_points
from msbdb.io.ortho import read_bands
from msbdb.io.raster import align_grid
from msbdb.io.vector import Area, read_polygons
from msbdb.labels import Labels
from msbdb.outline.polygons import rasterise
from msbdb.params import Params
from msbdb.points.cloud import PointCloud
from msbdb.run.inputs import Inputs
from msbdb.run.planning import (
    MOST_BYTES,
    Draft,
    SampledBlocks,
    blocks_to_sample,
    bytes_to_plan,
    decide,
    fitted_by,
    is_small,
    joined_facts,
    require_fitting,
    settled,
    sparse_enough,
    told_apart,
    with_facts,
)
from msbdb.run.rasters.cellblocks import block_side, drawn_blocks, is_large_raster, looked_at
from msbdb.run.rasters.rastersurface import note_offset, note_sparse, read_terrain, surface_of_rasters, without_gaps
from msbdb.run.reports import Progress, Stages
from msbdb.spectral.colours import kept_intensity, spectral_bands
from msbdb.spectral.coverclasses import Cover, classify_cover, is_imagery, keep_labels
from msbdb.spectral.kmeans import load_solver
from msbdb.surface import Surface, cover_from_surface
from msbdb.surface.gridding import cell_size, density
from msbdb.surface.heights import GIVEN_GROUND, grid_surface, normalise
from msbdb.surface.structure import Structure
from msbdb.surveyplan import Plan, PointFacts
from msbdb.tables import Survey
from msbdb.threads import together

logger = logging.getLogger(__name__)

NO_IMAGERY = "There is no imagery: height texture and echoes alone separate roofs from vegetation."

NO_ECHOES = "No pulse has a second echo, or none is recorded: height texture alone separates roofs from vegetation."

THINNED = (
    "Where first echoes are denser than surface.most_density, a share of the points was left out, by lot. "
    "The values of the detectors were not judged on denser ones."
)
"""Without numbers, so that the tiles of a build agree in it."""

WINDOW_CELLS = 3
"""Least width of a window of the texture, cells."""

CAN_BE_ROOF = 64
"""Ours: a quarter of the certainty of roof, in 255ths; with all crowns the kept intensity would be half larger."""


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
        inputs.points, crs=inputs.any_crs, z_unit=inputs.z_unit, facts=facts, area=area, progress=progress
    )


@dataclass(frozen=True, slots=True, eq=False)
class Window:
    """A part of a survey that is built by itself.

    Parameters
    ----------
    area : Area
        Points in it are read.
    own : tuple of float
        West, south, east and north of the ground whose cells count, metres; what lies beyond is seen, and not counted.
    seen : tuple of float
        Those of all that is seen: of rasters of heights, the cells with their centre there are read.
    """

    area: Area
    own: Bounds
    seen: Bounds

    def held(self, cloud: PointCloud | None, heights: Grid) -> tuple[int, Bounds | None]:
        """Return how many points lie in the own ground, and how far they reach; of rasters, cells with a value.

        Points on the west or south edge count. Cells count by their centre; the reach is that of all cells.
        """
        if cloud is None:
            rows, cols = heights.spec.within(self.own)
            if rows.start == rows.stop:
                return 0, None
            return int(np.count_nonzero(heights.valid[rows, cols])), heights.spec.crop(rows, cols).bounds
        west, south, east, north = self.own
        held = (cloud.x >= west) & (cloud.x < east) & (cloud.y >= south) & (cloud.y < north)
        if not held.any():
            return 0, None
        # Without copies of the coordinates, which would be the highest peak of all.
        (west, east), (south, north) = (
            (float(each.min(where=held, initial=np.inf)), float(each.max(where=held, initial=-np.inf)))
            for each in (cloud.x, cloud.y)
        )
        return int(np.count_nonzero(held)), (west, south, east, north)


@dataclass(frozen=True, slots=True)
class Label:
    """The name and date of a survey, and the classes that an operator labelled in it before.

    The date is a day, month or year of ISO 8601, or empty. One in the future is refused.
    """

    name: str
    date: str = ""
    classes: pd.DataFrame | None = None

    def __post_init__(self) -> None:
        """Check the date."""
        if self.date:
            require_past(self.date, f"the survey '{self.name}'")


def prepare(
    inputs: Inputs,
    cloud: PointCloud | None,
    params: Params,
    stages: Stages,
    label: Label,
    *,
    plan: Plan | None = None,
    window: Window | None = None,
) -> tuple[Scene, Params, Plan]:
    """Bring the files of a survey onto one lattice, for the detectors.

    Parameters
    ----------
    inputs : Inputs
        The files; the points are read already.
    cloud : PointCloud or None
        What `read_cloud` returned.
    params : Params
        Sections ``surface``, ``ground``, ``cover`` and ``spectral``.
    stages : Stages
        For timings and progress.
    label : Label
        Name, date and operator's labels.
    plan : Plan, optional
        The plan of a survey that this one is a part of; without it the survey itself decides.
    window : Window, optional
        A part of the survey: the classes count the cells of its own ground alone, and images may lie beyond it.

    Returns
    -------
    scene : Scene
        The survey on its lattice.
    params : Params
        The parameters, with the values of the plan where they give none (V8).
    plan : Plan
        That given, or that of the survey.
    """
    cloud = None if cloud is None else _sparse_enough(cloud, params)
    if plan is None and cloud is not None and not _is_small(cloud, params):
        with collected_notices():
            plan = _plan_of_wide(inputs, cloud, params, stages)
    own, seen = (None, None) if window is None else (window.own, window.seen)
    draft = make_draft(inputs, cloud, params, stages, sampled=own is not None, planned=plan is not None, seen=seen)
    surface, structure, bands = draft.surface, draft.structure, draft.bands
    spec = surface.ndsm.spec
    counted = None if own is None else spec.holding(own)

    def classify() -> tuple[Cover, Params, Plan]:
        if plan is None:
            chosen, [fitted] = decide([draft], params)
        else:
            require_fitting(plan, surface, cloud)
            chosen, fitted = plan, fitted_by(plan, bands)
        cover = classify_cover(
            structure.cover,
            bands,
            surface.ndsm,
            structure.filled_m,
            settled(params, chosen),
            echoes=cloud is not None and cloud.has_echoes,
            fitted=fitted,
            counted=counted,
        )
        return cover if label.classes is None else keep_labels(cover, label.classes), settled(params, chosen), chosen

    def keep() -> tuple[Evidence, Elevations, NDArray[np.uint8] | None]:
        evidence = Evidence.of(structure)
        # What is too low for a building, or is no roof, has no intensity that is read.
        high = np.asarray(surface.ndsm.values, dtype=np.float32) >= params.surface.mask_m
        intensity = kept_intensity(bands, high & (evidence.roof_probability >= CAN_BE_ROOF))
        return evidence, Elevations.of(surface, cloud), intensity

    with stages.stage("classes"):
        (cover, known, planned), (evidence, elevations, intensity) = together(classify, keep)
    record = record_survey(inputs, name=label.name, date=label.date, surface=surface, cloud=cloud)
    parcels = None if inputs.parcels is None else read_parcels(inputs.parcels, spec, everywhere=own is None)
    scene = Scene(
        record,
        surface.ndsm,
        cover,
        evidence,
        elevations,
        parcels=parcels,
        surface=surface,
        cloud=None if draft.cloud is None else draft.cloud.places(),
        bands=bands,
        above=draft.above,
        intensity=intensity,
    )
    return scene, known, planned


def _sparse_enough(cloud: PointCloud, params: Params) -> PointCloud:
    """Return a cloud that knows what holds for all its points, and give notice if some were left out for it."""
    found = with_facts(cloud, params.surface.most_density)
    if len(found) < len(cloud):
        give_notice(THINNED)
    return found


def is_large(inputs: Inputs, params: Params) -> bool:
    """Return whether a plan looks at a sample of the points or cells, by what their headers promise."""
    cells = inputs.cells()
    if cells is not None:
        return is_large_raster(cells)
    return blocks_to_sample(inputs.points, inputs.any_crs, params, inputs.area()) is not None


def make_plan(inputs: Inputs, params: Params, stages: Stages) -> Plan:
    """Return the plan of a survey: that which a build of it makes and keeps.

    A plan looks at a limited number of points and cells. Where the headers promise more points, or more cells of
    rasters, a seeded hash draws blocks that hold about as many, and one pass over the files that they meet reads these.
    Where all points are read and their lattice has too many cells, blocks are drawn from the points.
    """
    cells = inputs.cells()
    if cells is not None and is_large_raster(cells):
        return _plan_of_cells(inputs, cells, params, stages)
    interest = inputs.area()
    blocks = blocks_to_sample(inputs.points, inputs.any_crs, params, interest)
    with stages.stage("read"):
        cloud = read_cloud(inputs, stages.progress, area=None if blocks is None else blocks.area_in(interest))
    if cloud is None or blocks is None:
        cloud = None if cloud is None else _sparse_enough(cloud, params)
        if cloud is not None and not _is_small(cloud, params):
            return _plan_of_wide(inputs, cloud, params, stages)
        plan, _ = decide([make_draft(inputs, cloud, params, stages)], params)
        return plan
    cloud, under_m = told_apart(cloud)
    known: dict[tuple[float, float], tuple[PointCloud, PointFacts]] = {}
    need, thinned = 0.0, False
    for corner, each in blocks.cut(cloud):
        known[corner] = sparse_enough(each, under_m, params.surface.most_density)
        own, facts = known[corner]
        thinned |= len(own) < len(each)
        # Where points lie closer than the headers promise, fewer blocks are enough.
        cell_m = lattice_of_points(replace(own, facts=facts), params).cell_m
        need += bytes_to_plan(len(own), blocks.side_m**2, cell_m, params)
        if need > MOST_BYTES:
            break
    del cloud
    if thinned:
        give_notice(THINNED)
    joined = joined_facts([facts for _, facts in known.values()]) if known else None
    clouds = {corner: replace(own, facts=joined) for corner, (own, _) in known.items()}
    return _plan_of_blocks(inputs, clouds, blocks.side_m, params, stages)


def _is_small(cloud: PointCloud, params: Params) -> bool:
    """Return whether a plan looks at all of a cloud: its points may lie in few places of a wide lattice."""
    return is_small(len(cloud), cloud.bounds, lattice_of_points(cloud, params).cell_m, params)


def _plan_of_wide(inputs: Inputs, cloud: PointCloud, params: Params, stages: Stages) -> Plan:
    """Return the plan of a cloud that knows its facts, from blocks of it: its lattice has too many cells."""
    blocks = SampledBlocks.of_cloud(cloud, lattice_of_points(cloud, params).cell_m, params)
    return _plan_of_blocks(inputs, dict(blocks.cut(cloud)), blocks.side_m, params, stages)


def _plan_of_blocks(
    inputs: Inputs,
    clouds: Mapping[tuple[float, float], PointCloud],
    side_m: float,
    params: Params,
    stages: Stages,
) -> Plan:
    """Return the plan that the blocks of a sample give, whose points have the facts of the survey."""
    drafts = {}
    for corner, cloud in clouds.items():
        with suppress(NodataError):  # no cell of the block lies in the area of interest
            drafts[corner] = make_draft(inputs, cloud, params, stages, sampled=True)
    if not drafts:
        msg = "No block of the sample for the plan has first echoes and ground. Check the area, and the return numbers."
        raise NodataError(msg)
    with stages.stage("classes"):
        plan, _ = decide([*drafts.values()], params)
    return replace(plan, blocks=tuple(drafts), block_m=side_m)


def _plan_of_cells(inputs: Inputs, cells: GridSpec, params: Params, stages: Stages) -> Plan:
    """Return the plan of large rasters of heights by blocks of their cells."""
    drawn = drawn_blocks(cells, seed=params.spectral.seed)

    def draft_of(block: Bounds) -> Draft:
        return make_draft(inputs, None, params, stages, sampled=True, seen=block)

    drafts = looked_at(drawn, draft_of)
    if not drafts:
        msg = "No block of the rasters of heights has a valid cell in the survey. Check their nodata values."
        raise NodataError(msg)
    if inputs.ndsm is None:
        note_offset([each.surface.ndsm for each in drafts.values()])
    with stages.stage("classes"):
        plan, _ = decide(list(drafts.values()), params)
    corners = tuple(block[:2] for block in drafts)
    return replace(plan, blocks=corners, block_m=block_side(cells.cell_m))


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
            return surface, cover_from_surface(surface, cloud, params)

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


def read_parcels(path: Path, spec: GridSpec, *, everywhere: bool = True) -> Labels:
    """Return the parcel of each cell: row number + 1 in the file, 0 for none.

    A window of a survey may lie beside all parcels, but not ``everywhere``.

    Raises
    ------
    FileError, CRSError, NodataError
        As `msbdb.io.vector.read_polygons`.
    InputError
        When no parcel covers a cell of the survey.
    """
    parcels = rasterise(read_polygons(path, to=spec.crs).geometry, spec)
    if everywhere and not parcels.any():
        msg = f"No parcel of {path} covers a cell of the survey. Check the file, and its CRS."
        raise InputError(msg)
    return parcels


def note_missing_sources(scene: Scene) -> None:
    """Give notice of sources that are missing, without which buildings are harder to recognise."""
    echoes = scene.cloud is not None and scene.cloud.has_echoes
    if scene.cover.spectral is None:
        give_notice(NO_IMAGERY)
    if not echoes:
        give_notice(NO_ECHOES)


def make_surface(inputs: Inputs, cloud: PointCloud | None, params: Params, seen: Bounds | None = None) -> Surface:
    """Build the surface from the points, or take it from the rasters, of which only ``seen`` may be wanted."""
    if cloud is None:
        return surface_of_rasters(inputs, seen)
    return build_surface(cloud, params, None if inputs.dtm is None else partial(read_terrain, inputs, inputs.dtm))


def build_surface(points: PointCloud, params: Params, given: Callable[[GridSpec], Grid] | None = None) -> Surface:
    """Grid the first echoes, detect the ground, and subtract it (V13 to V16).

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
    if aligned is None:
        gridding, filtering = partial(grid_surface, points, spec, params), partial(terrain, points, spec, params.ground)
        (dsm, samples), (dtm, name) = together(gridding, filtering)
    else:
        dsm, samples = grid_surface(points, spec, params)
        dtm, name = without_gaps(aligned, dsm), GIVEN_GROUND
    surface_is = "The surface has %d x %d cells of %s m from %.1f points/m2. The ground is by the filter '%s'"
    logger.info(surface_is, *spec.shape, spec.cell_m, points_m2, name)
    surface = Surface(dsm, dtm, normalise(dsm, dtm), samples, name, points_m2)
    if given is not None:
        note_offset([surface.ndsm])
    return surface


def lattice_of_points(points: PointCloud, params: Params) -> GridSpec:
    """Return the lattice on which a survey from points is built."""
    cell_m = params.surface.cell_m or cell_of_points(points, density(points), params)
    return lattice(points.bounds, cell_m, points.crs)


def cell_of_points(points: PointCloud, points_m2: float, params: Params) -> float:
    """Return the cell size by the mean spacing; a larger one where the texture would see single scan lines, metres.

    A window of the texture needs points of two lines for a plane. It is three cells wide at least.
    """
    cell_m = cell_size(points_m2, literal=params.surface.cell_rule == "literal")
    two_lines_m = 0.0 if points.facts is None else 2 * points.facts.link_m
    if two_lines_m <= params.cover.window_m or params.surface.cell_rule == "literal":
        return cell_m
    return max(cell_m, cell_size((WINDOW_CELLS / two_lines_m) ** 2))


def record_survey(inputs: Inputs, *, name: str, date: str, surface: Surface, cloud: PointCloud | None) -> Survey:
    """Return the record of the survey: place, time, density, CRS and files."""
    spec: GridSpec = surface.ndsm.spec
    vertical = cloud.vertical_crs if cloud is not None else None
    return Survey(
        name=name,
        date=date,
        crs_wkt=spec.crs.to_wkt(),
        epsg=spec.crs.to_epsg() or 0,
        vertical_crs=vertical.name if vertical is not None else "",
        density=round(surface.density if cloud is None or cloud.facts is None else cloud.facts.all_density, 6),
        cell_m=spec.cell_m,
        bounds=spec.bounds,
        sources=inputs.sources(),
    )
