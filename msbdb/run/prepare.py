"""Preparation: from the files of a survey to the scene in which the detectors look for buildings."""

import filecmp
import logging
import os
import re
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Any, Self

import numpy as np
import pandas as pd

from msbdb.database import require_past
from msbdb.detect.scene import Elevations, Evidence, Scene
from msbdb.errors import CRSError, InputError, MsbdbWarning
from msbdb.grid import Grid, GridSpec, lattice
from msbdb.ground.choice import terrain
from msbdb.ground.interpolation import interpolate_ground
from msbdb.io.crs import CrsLike, Fallback, name_of, reference, same_crs
from msbdb.io.extents import (
    Extent,
    extent_of_points,
    extent_of_polygons,
    extent_of_raster,
    require_common_place,
    require_other_points,
)
from msbdb.io.files import describe_source, require_input
from msbdb.io.las import read_points
from msbdb.io.ortho import read_bands
from msbdb.io.raster import align_grid, open_raster, read_grid, states_crs
from msbdb.io.vector import read_polygons
from msbdb.labels import Labels
from msbdb.outline.polygons import rasterise
from msbdb.params import Params
from msbdb.parts.tree import choose_scales
from msbdb.points.cloud import PointCloud
from msbdb.run.reports import Progress, Stages
from msbdb.spectral.colours import spectral_bands
from msbdb.spectral.coverclasses import classify_cover, keep_labels
from msbdb.surface import Surface, cover_from_surface, surface_from_rasters
from msbdb.surface.gridding import CELL_LADDER_M, cell_size, density
from msbdb.surface.heights import GIVEN_GROUND, grid_surface, normalise
from msbdb.tables import Source, Survey

logger = logging.getLogger(__name__)

Paths = str | os.PathLike[str] | Sequence[str | os.PathLike[str]]

NO_IMAGERY = "There is no imagery: height texture and echoes alone separate roofs from vegetation."

NO_ECHOES = "No pulse has a second echo, or none is recorded: height texture alone separates roofs from vegetation."


ANYWHERE = re.compile(
    r"(points?|point_?cloud|cloud|lidar|las|laz|dsm|dtm|dem|ndsm|chm|surface|terrain|ground|heights?|tiles?|data|input"
    r"|output|merged|classified|survey)[-_ ]?\d*",
    re.IGNORECASE,
)
"""Names of files that hold for any place, so that files of two places often have them."""


@dataclass(frozen=True, slots=True)
class Inputs:
    """The files of a build, and what the user states about them; ``fallback`` is the CRS where nothing states one."""

    points: tuple[Path, ...] = ()
    ortho: tuple[Path, ...] = ()
    dsm: Path | None = None
    dtm: Path | None = None
    ndsm: Path | None = None
    crs: str | None = None
    ortho_crs: str | None = None
    z_unit: str = "auto"
    parcels: Path | None = None
    fallback: Fallback | None = None

    @classmethod
    def of(cls, points: Paths = (), ortho: Paths = (), **given: Any) -> Self:  # noqa: ANN401  (the other fields)
        """Return the files as a user gives them: a single one in place of a list, and texts as paths."""
        files = {name: given[name] for name in ("dsm", "dtm", "ndsm", "parcels") if given.get(name) is not None}
        return cls(_paths(points), _paths(ortho), **given | {name: Path(file) for name, file in files.items()})

    def __post_init__(self) -> None:
        """Check that there is one kind of heights."""
        given = [name for name in ("points", "dsm", "ndsm") if getattr(self, name)]
        needless, missing = self.dtm and self.ndsm, self.dsm and not self.dtm
        if len(given) != 1 or needless or missing:
            msg = (
                "A build needs either points, with or without a DTM, or a DSM with a DTM, or an nDSM; "
                f"got {' and '.join(given) or 'none'}{' with' if self.dtm else ' without'} a DTM."
            )
            raise InputError(msg)

    def require_files(self) -> None:
        """Refuse what cannot be read, and two files of equal content: points twice, or heights above themselves.

        Raises
        ------
        FileError
            For a URL, a folder, a missing file, or one of another kind; points show this when they are read, first.
        InputError
            For a file that is given twice, also as a copy.
        """
        by_size: dict[int, list[tuple[Path, str]]] = {}
        for path, role in self.files():
            require_input(path)
            by_size.setdefault(path.stat().st_size, []).append((path, role))
        for alike in by_size.values():
            for (one, role), (other, its_role) in combinations(alike, 2):
                if filecmp.cmp(one, other, shallow=False):
                    roles = f"{role} and {its_role}" if role != its_role else f"{role} twice"
                    msg = f"The same file is given as {roles}: {one} and {other}. Leave one out, or correct its name."
                    raise InputError(msg)
        for path, role in self.files():
            if role == "parcels":
                require_polygons(path)
            elif role != "points":
                with open_raster(path):
                    pass

    def require_one_place(self) -> None:
        """Refuse files that cannot be of one survey by what their headers say, before the points are read.

        Raises
        ------
        CRSError
            For another CRS than that of the database.
        GridMismatchError
            For a DTM, orthophotos or parcels that lie apart from the heights.
        InputError
            For the same points in two files, such as a LAZ and the COPC made from it.
        """
        require_other_points(self.points)
        first = self.extent()
        if first is None:
            return
        if self.fallback is not None:
            metric = reference(first.crs, bounds=first.bounds, where=next(self.files())[0].name).crs
            if not same_crs(metric, self.fallback.crs):
                msg = (
                    f"{self.fallback.whose.capitalize()} is in the CRS {name_of(self.fallback.crs)}, the survey in "
                    f"{name_of(metric)}; a database has one CRS. Reproject the data, or build into another database."
                )
                raise CRSError(msg)
        if self.dtm is not None:
            crs = None if states_crs(self.dtm) else self.any_crs
            require_common_place(first, [extent_of_raster(self.dtm, crs, "DTM")])
        require_common_place(first, [extent_of_raster(path, self.any_ortho_crs, "image") for path in self.ortho])
        parcels = None if self.parcels is None else extent_of_polygons(self.parcels)
        require_common_place(first, [] if parcels is None else [parcels])

    def extent(self) -> Extent | None:
        """Return what the heights cover by their headers; None where these are wrong."""
        for path, role in ((self.dsm, "DSM"), (self.ndsm, "nDSM")):
            if path is not None:
                return extent_of_raster(path, self.any_crs, role)
        return extent_of_points(self.points, self.any_crs)

    def files(self) -> Iterator[tuple[Path, str]]:
        """Yield each file with its role."""
        heights = ((self.dsm, "dsm"), (self.dtm, "dtm"), (self.ndsm, "ndsm"))
        yield from ((Path(path), "points") for path in self.points)
        yield from ((Path(path), role) for path, role in heights if path is not None)
        yield from ((Path(path), "ortho") for path in self.ortho)
        if self.parcels is not None:
            yield Path(self.parcels), "parcels"

    def stated(self) -> dict[str, str]:
        """Return what the user stated about the files, where it is not the default."""
        words = {"crs": self.crs, "ortho_crs": self.ortho_crs, "z_unit": self.z_unit if self.z_unit != "auto" else None}
        return {name: str(word) for name, word in words.items() if word is not None}

    @property
    def any_crs(self) -> CrsLike | None:
        """The CRS of points and rasters of heights that state none."""
        return self.crs or self.fallback

    @property
    def any_ortho_crs(self) -> CrsLike | None:
        """The CRS of orthophotos that state none."""
        return self.ortho_crs or self.fallback

    def default_survey(self) -> str:
        """Name the survey after the first file, and after its folder too where the file's name holds for any place."""
        stem = self._stem()
        return self.longer_survey() if ANYWHERE.fullmatch(stem) else stem

    def longer_survey(self, taken: str = "") -> str:
        """Return a name of the first file with its folder; NAME where that is taken."""
        folder = next(self.files())[0].resolve().parent.name
        name = "-".join(word for word in (folder, self._stem()) if word)
        return "NAME" if name == taken else name

    def _stem(self) -> str:
        return next(self.files())[0].stem.removesuffix(".copc")

    def sources(self) -> tuple[Source, ...]:
        """Describe every file by name, role, size and checksum, in an order of content."""
        described = [describe_source(path, role) for path, role in self.files()]
        return tuple(sorted(described, key=lambda source: (source.role, source.sha256)))


def _paths(given: Paths) -> tuple[Path, ...]:
    """Return one path or several as a tuple."""
    return tuple(map(Path, (given,) if isinstance(given, str | os.PathLike) else given))


def require_polygons(path: Path) -> None:
    """Refuse a file without polygons; notices of the polygons come when they are used."""
    with warnings.catch_warnings(action="ignore", category=MsbdbWarning):
        read_polygons(path)


def read_cloud(inputs: Inputs, progress: Progress | None) -> PointCloud | None:
    """Read the points, where the build is from points."""
    if not inputs.points:
        return None
    return read_points(inputs.points, crs=inputs.any_crs, z_unit=inputs.z_unit, progress=progress)


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
    inputs: Inputs, cloud: PointCloud | None, params: Params, stages: Stages, label: Label
) -> tuple[Scene, Params]:
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

    Returns
    -------
    scene : Scene
        The survey on its lattice.
    params : Params
        The parameters, with the scales that were found where they give none (V8).
    """
    with stages.stage("surface"):
        surface = make_surface(inputs, cloud, params)
    spec = surface.ndsm.spec
    with stages.stage("cover"):
        structure = cover_from_surface(surface, cloud, params)
    with stages.stage("bands"):
        ortho = read_bands(list(inputs.ortho), spec, crs=inputs.any_ortho_crs) if inputs.ortho else None
        bands = spectral_bands(ortho, cloud, spec, max_gap_m=params.surface.max_gap_m)
    with stages.stage("classes"):
        echoes = cloud is not None and cloud.has_echoes
        params = choose_scales(surface.ndsm, structure.cover, params)
        cover = classify_cover(structure.cover, bands, surface.ndsm, structure.roughness_m, params, echoes=echoes)
        if label.classes is not None:
            cover = keep_labels(cover, label.classes)
    record = record_survey(inputs, name=label.name, date=label.date, surface=surface, cloud=cloud)
    evidence, elevations = Evidence.of(structure), Elevations.of(surface, cloud)
    parcels = None if inputs.parcels is None else read_parcels(inputs.parcels, spec)
    return Scene(record, surface.ndsm, cover, evidence, elevations, parcels, surface, cloud, bands), params


def read_parcels(path: Path, spec: GridSpec) -> Labels:
    """Return the parcel of each cell: row number + 1 in the file, 0 for none.

    Raises
    ------
    FileError, CRSError, NodataError
        As `msbdb.io.vector.read_polygons`.
    InputError
        When no parcel covers a cell of the survey.
    """
    parcels = rasterise(read_polygons(path, to=spec.crs).geometry, spec)
    if not parcels.any():
        msg = f"No parcel of {path} covers a cell of the survey. Check the file, and its CRS."
        raise InputError(msg)
    return parcels


def note_missing_sources(scene: Scene) -> None:
    """Give notice of sources that are missing, without which buildings are harder to recognise."""
    echoes = scene.cloud is not None and scene.cloud.has_echoes
    if scene.cover.spectral is None:
        warnings.warn(NO_IMAGERY, MsbdbWarning, stacklevel=2)
    if not echoes:
        warnings.warn(NO_ECHOES, MsbdbWarning, stacklevel=2)


def make_surface(inputs: Inputs, cloud: PointCloud | None, params: Params) -> Surface:
    """Build the surface from the points, or take it from the rasters."""
    if cloud is not None:
        return build_surface(cloud, params, None if inputs.dtm is None else read_terrain(inputs, inputs.dtm))
    if inputs.ndsm is not None:
        ndsm = read_grid(inputs.ndsm, crs=inputs.any_crs, role="nDSM", z_unit=inputs.z_unit)
        note_sparse(1 / ndsm.spec.cell_area_m2, f"cells of the nDSM {inputs.ndsm.name}")
        return surface_from_rasters(ndsm, flat_ground(ndsm), terrain_known=False)
    if inputs.dsm is None or inputs.dtm is None:  # kept from happening by Inputs
        msg = "A DSM needs a DTM."
        raise InputError(msg)
    dsm = read_grid(inputs.dsm, crs=inputs.any_crs, role="DSM", z_unit=inputs.z_unit)
    dtm = read_grid(inputs.dtm, crs=inputs.any_crs, role="DTM", z_unit=inputs.z_unit)
    note_sparse(1 / dsm.spec.cell_area_m2, f"cells of the DSM {inputs.dsm.name}")
    return note_offset(surface_from_rasters(dsm, without_gaps(align_grid(dtm, dsm.spec, role="DTM"), dsm)))


def read_terrain(inputs: Inputs, path: Path) -> Grid:
    """Read the terrain of a build from points; the stated CRS is of the points where the raster has its own."""
    return read_grid(path, crs=None if states_crs(path) else inputs.any_crs, role="DTM", z_unit=inputs.z_unit)


def note_sparse(points_m2: float, what: str) -> None:
    """Give notice of heights that are too far apart for any building: farther than the largest cell."""
    spacing, largest = points_m2**-0.5, CELL_LADDER_M[-1]
    if spacing > largest * (1 + 1e-6):
        msg = (
            f"The {what} are {spacing:.1f} m apart on average, too far for buildings, at most {largest:g} m. "
            "Check the CRS and the unit of the coordinates, or give denser data."
        )
        warnings.warn(msg, MsbdbWarning, stacklevel=2)


def build_surface(points: PointCloud, params: Params, given: Grid | None = None) -> Surface:
    """Grid the first echoes, detect the ground, and subtract it (V13 to V16).

    Parameters
    ----------
    points : PointCloud
        All echoes of the survey; outliers are gone.
    params : Params
        Sections ``surface`` and ``ground``.
    given : Grid, optional
        The terrain, on any lattice and CRS; without it the ground is detected among the points.

    Raises
    ------
    NodataError
        When there is no first echo, or no ground.
    GridMismatchError
        When the given terrain is of another place.
    """
    points_m2 = density(points)
    note_sparse(points_m2, "first echoes")
    cell_m = params.surface.cell_m or cell_size(points_m2, literal=params.surface.cell_rule == "literal")
    spec = lattice(points.bounds, cell_m, points.crs)
    aligned = None if given is None else align_grid(given, spec, role="DTM")
    dsm, samples = grid_surface(points, spec, params)
    if aligned is None:
        dtm, name = terrain(points, spec, params.ground)
    else:
        dtm, name = without_gaps(aligned, dsm), GIVEN_GROUND
    surface_is = "The surface has %d x %d cells of %s m from %.1f points/m2. The ground is by the filter '%s'"
    logger.info(surface_is, *spec.shape, cell_m, points_m2, name)
    surface = Surface(dsm, dtm, normalise(dsm, dtm), samples, name, points_m2)
    return surface if given is None else note_offset(surface)


LARGEST_OFFSET_M = 10.0
"""Ours: a surface has open ground somewhere, and other height references are farther away, such as the ellipsoid."""

LOW_PERCENT = 5.0
"""Ours: this share of a surface is ground, also in an old town or a park."""


def note_offset(surface: Surface) -> Surface:
    """Give notice of a given terrain that is nowhere near the lowest heights; return the surface as it is."""
    heights = np.asarray(surface.ndsm.values)[surface.ndsm.valid]
    low = float(np.percentile(heights, LOW_PERCENT)) if heights.size else 0.0
    if abs(low) > LARGEST_OFFSET_M:
        share, where = (100 - LOW_PERCENT, "above") if low > 0 else (LOW_PERCENT, "below")
        msg = (
            f"Of the surface, {share:.0f} % are {abs(low):.0f} m or more {where} the given DTM. "
            "Check its place, its unit and its height reference."
        )
        warnings.warn(msg, MsbdbWarning, stacklevel=2)
    return surface


def without_gaps(dtm: Grid, dsm: Grid) -> Grid:
    """Interpolate the terrain where it has no value but the surface has one: often under the middle of buildings."""
    gaps = int(np.count_nonzero(dsm.valid & ~dtm.valid))
    if not gaps:
        return dtm
    share = 100 * gaps / np.count_nonzero(dsm.valid)
    msg = f"The DTM has no value in {gaps} cells of the DSM ({share:.1f} %); they were interpolated."
    warnings.warn(msg, MsbdbWarning, stacklevel=2)
    return interpolate_ground(dtm.values, dtm.valid, dtm.spec)


def flat_ground(ndsm: Grid) -> Grid:
    """Return the terrain of heights that are above ground already: zero everywhere."""
    return Grid(np.zeros(ndsm.spec.shape, dtype=np.float32), np.ones(ndsm.spec.shape, dtype=np.bool_), ndsm.spec)


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
        density=round(surface.density, 6),
        cell_m=spec.cell_m,
        bounds=spec.bounds,
        sources=inputs.sources(),
    )
