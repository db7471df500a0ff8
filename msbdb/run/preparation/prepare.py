"""Preparation: from the files of a survey to the scene in which the detectors look for buildings."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from msbdb.database import require_past
from msbdb.detect.scene import Elevations, Evidence, Scene
from msbdb.errors import InputError, collected_notices, give_notice
from msbdb.grid import Bounds, Grid, GridSpec
from msbdb.io.vector import Area, read_polygons
from msbdb.labels import Labels
from msbdb.outline.polygons import rasterise
from msbdb.params import Params
from msbdb.points.cloud import PointCloud
from msbdb.run.inputs import Inputs
from msbdb.run.preparation.drafts import make_draft
from msbdb.run.preparation.planning import (
    decide,
    fitted_by,
    is_small_cloud,
    plan_of_wide_cloud,
    require_fitting,
    settled,
)
from msbdb.run.preparation.pointfacts import evenly_dense
from msbdb.run.reports import Stages
from msbdb.spectral.colours import kept_intensity
from msbdb.spectral.coverclasses import Cover, classify_cover, keep_labels
from msbdb.surface import Surface, density_of_cells
from msbdb.surveyplan import Plan
from msbdb.tables import Survey
from msbdb.threads import together

NO_IMAGERY = "There is no imagery: height texture and echoes alone separate roofs from vegetation."


NO_ECHOES = "No pulse has a second echo, or none is recorded: height texture alone separates roofs from vegetation."


FEW_ECHOES = (
    "Few pulses have a second echo, even where the surface is as rough as crowns. So height texture, more than echoes, "
    "separates roofs from vegetation."
)

PART_ECHOES = (
    "In a part of the survey hardly a pulse has a second echo, as by a weaker sensor. There height texture, more than "
    "echoes, separates roofs from vegetation."
)

TRUSTED = 0.5
"""Ours: where single echoes are trusted less, the classes of colours help as without echoes."""


CAN_BE_ROOF = 64
"""Ours: a quarter of the certainty of roof, in 255ths; with all crowns the kept intensity would be half larger."""


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

    def held_points(self, cloud: PointCloud) -> tuple[int, Bounds | None]:
        """Return how many points lie in the own ground, and how far they reach; those on its west or south edge do."""
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

    def held_cells(self, heights: Grid) -> tuple[int, Bounds | None]:
        """Return how many cells with a value have their centre in the own ground, and how far all its cells reach."""
        rows, cols = heights.spec.within(self.own)
        if rows.start == rows.stop:
            return 0, None
        return int(np.count_nonzero(heights.valid[rows, cols])), heights.spec.crop(rows, cols).bounds


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
        The points with the facts of the survey (`pointfacts.sparse_with_facts`); None for rasters.
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
    if plan is None and cloud is not None and not is_small_cloud(cloud, params):
        with collected_notices():
            plan = plan_of_wide_cloud(inputs, cloud, params, stages)
        cloud = replace(cloud, facts=plan.points)
    own, seen = (None, None) if window is None else (window.own, window.seen)
    draft = make_draft(inputs, cloud, params, stages, sampled=own is not None, planned=plan is not None, seen=seen)
    if cloud is None:
        # That of the survey, whose measured cells may be denser or sparser in a part.
        density = density_of_cells([draft.surface]) if plan is None else plan.density
        draft = replace(draft, surface=replace(draft.surface, density=density))
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
            structure,
            bands,
            surface.ndsm,
            settled(params, chosen),
            echoes=chosen.points is not None and chosen.points.most_trust >= TRUSTED,
            fitted=fitted,
            counted=counted,
        )
        return cover if label.classes is None else keep_labels(cover, label.classes), settled(params, chosen), chosen

    def keep() -> tuple[Survey, Evidence, Elevations, NDArray[np.uint8] | None]:
        record = record_survey(inputs, name=label.name, date=label.date, surface=surface, cloud=cloud)
        evidence = Evidence.of(structure)
        # What is too low for a building, or is no roof, has no intensity that is read.
        high = np.asarray(surface.ndsm.values, dtype=np.float32) >= params.surface.mask_m
        intensity = kept_intensity(bands, high & (evidence.roof_probability >= CAN_BE_ROOF))
        return record, evidence, Elevations.of(surface, cloud), intensity

    with stages.stage("classes"):
        (cover, known, planned), (record, evidence, elevations, intensity) = together(classify, keep)
    parcels = None if inputs.parcels is None else read_parcels(inputs.parcels, spec, everywhere=own is None)
    points, above = None, None
    if draft.cloud is not None:
        points, above = evenly_dense(replace(draft.cloud.places(), facts=planned.points), draft.above)
    scene = Scene(
        record,
        surface.ndsm,
        cover,
        evidence,
        elevations,
        parcels=parcels,
        surface=surface,
        cloud=points,
        bands=bands,
        above=above,
        noise_m=structure.noise_m,
        recorded=structure.recorded,
        intensity=intensity,
    )
    return scene, known, planned


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
    trust = 0.0 if scene.cloud is None else scene.cloud.most_trust
    if scene.cover.spectral is None:
        give_notice(NO_IMAGERY)
    if trust < TRUSTED:
        give_notice(NO_ECHOES if scene.cloud is None or not scene.cloud.has_echoes else FEW_ECHOES)
    elif scene.recorded is not None and scene.recorded.min() < TRUSTED:
        give_notice(PART_ECHOES)


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
