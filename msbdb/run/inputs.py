"""The files of a survey, and what is stated about them: checked before they are read."""

import filecmp
import os
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

from msbdb.errors import CRSError, InputError, NodataError, collected_notices
from msbdb.grid import Bounds, GridSpec
from msbdb.io.crs import CrsLike, Fallback, Reference, name_of, reference, same_crs
from msbdb.io.extents import (
    Extent,
    extent_of_points,
    extent_of_polygons,
    extent_of_raster,
    require_common_place,
    require_other_points,
)
from msbdb.io.files import describe_source, file_name, require_input, url_of
from msbdb.io.lasheader import read_las_header
from msbdb.io.pointfiles import point_files, sound_files
from msbdb.io.raster import lattice_of_raster, open_raster, raster_pieces, states_crs
from msbdb.io.vector import Area, read_polygons
from msbdb.tables import Source

if TYPE_CHECKING:
    from pyproj import CRS

Paths = str | os.PathLike[str] | Sequence[str | os.PathLike[str]]

AOI_MARGIN_M = 50.0
"""Ours: points so far beyond the area of interest help to find its ground: the windows of the filters reach less."""

BUILD_BYTES = 190
"""Ours, measured: a build takes more for each point; Autzen takes 250, dense towns and small surveys far more."""

ANYWHERE = re.compile(
    r"(points?|point_?cloud|cloud|lidar|las|laz|dsm|dtm|dem|ndsm|chm|surface|terrain|ground|heights?|tiles?|data|input"
    r"|output|merged|classified|survey)[-_ ]?\d*",
    re.IGNORECASE,
)
"""Names of files that hold for any place, so that files of two places often have them."""


@dataclass(frozen=True, slots=True)
class Inputs:
    """The files of a build, and what the user states about them; ``fallback`` is the CRS where nothing states one.

    Points that must be reprojected go to the CRS ``target``, by default to that of ``fallback``, or to their UTM zone.
    ``known`` describes the files of a whole survey, and ``bounds`` are those of all its points in their own unit; these
    files are a part of them.
    """

    points: tuple[Path, ...] = ()
    ortho: tuple[Path, ...] = ()
    dsm: Path | None = None
    dtm: Path | None = None
    ndsm: Path | None = None
    crs: str | None = None
    ortho_crs: str | None = None
    z_unit: str = "auto"
    parcels: Path | None = None
    aoi: Path | None = None
    fallback: Fallback | None = None
    target: "CRS | None" = None
    known: tuple[Source, ...] | None = None
    bounds: Bounds | None = None

    @classmethod
    def of(
        cls,
        points: Paths = (),
        ortho: Paths = (),
        *,
        skip_bad: bool = False,
        **given: Any,  # noqa: ANN401  (the other fields)
    ) -> Self:
        """Return the files as a user gives them: a single one in place of a list, and texts as paths.

        Points may also be a folder, a pattern, a virtual point cloud, a tile index or the URL of a COPC file. The
        headers of several files are checked together; those that do not fit are an error, or left out with a notice
        (`msbdb.io.pointfiles.sound_files`).
        """
        clouds = point_files(_paths(points))
        if clouds:
            clouds = sound_files(clouds, skip_bad=skip_bad)
        files = {name: given[name] for name in ("dsm", "dtm", "ndsm", "parcels", "aoi") if given.get(name) is not None}
        return cls(clouds, _paths(ortho), **given | {name: Path(file) for name, file in files.items()})

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
            For a URL, a folder, a missing file, or one of another kind; points show this when they are read, first, and
            may be at http and https URLs.
        InputError
            For a file that is given twice, also as a copy.
        """
        by_size: dict[int, list[tuple[Path, str]]] = {}
        for path, role in self.files():
            if role == "points" and url_of(path) is not None:
                continue
            require_input(path)
            by_size.setdefault(path.stat().st_size, []).append((path, role))
        for alike in by_size.values():
            for (one, role), (other, its_role) in combinations(alike, 2):
                if filecmp.cmp(one, other, shallow=False):
                    roles = f"{role} and {its_role}" if role != its_role else f"{role} twice"
                    msg = f"The same file is given as {roles}: {one} and {other}. Leave one out, or correct its name."
                    raise InputError(msg)
        for path, role in self.files():
            if role in ("parcels", "aoi"):
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
            For a DTM, orthophotos, parcels or an area of interest that lie apart from the heights.
        InputError
            For the same points in two files, such as a LAZ and the COPC made from it.
        """
        require_other_points(self.points)
        first = self.extent()
        if first is None:
            return
        if self.fallback is not None:
            where = next(self.files())[0].name
            metric = reference(first.crs, bounds=first.bounds, where=where, target=self.any_target).crs
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
        for polygons in (self.parcels, self.aoi):
            extent = None if polygons is None else extent_of_polygons(polygons)
            require_common_place(first, [] if extent is None else [extent])

    def bytes_to_build(self) -> int:
        """Return what a build takes at the least beside the program, by the points that headers promise; 0 for rasters.

        Where an area of interest leaves out points it is 0, too.
        """
        if self.aoi is not None:
            return 0
        return BUILD_BYTES * sum(read_las_header(path).points for path in self.points)

    def reference_of_points(self) -> Reference | None:
        """Return how the points' coordinates become metric, by all headers; None where one of these is wrong."""
        with collected_notices():
            extent = extent_of_points(self.points, self.any_crs)
            if extent is None:
                return None
            where = file_name(self.points[0])
            return reference(extent.crs, bounds=extent.bounds, where=where, target=self.any_target)

    def extent(self) -> Extent | None:
        """Return what the heights cover by their headers; None where these are wrong."""
        for path, role in ((self.dsm, "DSM"), (self.ndsm, "nDSM")):
            if path is not None:
                return extent_of_raster(path, self.any_crs, role)
        return extent_of_points(self.points, self.any_crs)

    def cells(self) -> GridSpec | None:
        """Return the lattice of a DSM or an nDSM; None for points.

        With an area of interest it is the part that the box of the area and of its margin holds.

        Raises
        ------
        NodataError
            When the area of interest lies beside it.
        MsbdbError
            As `msbdb.io.raster.read_grid`.
        """
        file, role = (self.ndsm, "nDSM") if self.dsm is None else (self.dsm, "DSM")
        if file is None:
            return None
        with collected_notices():
            whole, area = lattice_of_raster(file, crs=self.any_crs, role=role, z_unit=self.z_unit), self.area()
            if area is None:
                return whole
            west, south, east, north = area.shape_in(whole.crs).bounds
        rows, cols = whole.within((west, south, east, north))
        if rows.start == rows.stop:
            msg = f"No cell of the {role} {file.name} lies in {area.what}. Check the area, and the CRS of both."
            raise NodataError(msg)
        return whole.crop(rows, cols)

    def area(self) -> Area | None:
        """Return the area of interest with its margin; None where the user gave none."""
        if self.aoi is None:
            return None
        return Area(read_polygons(self.aoi).geometry, AOI_MARGIN_M, f"the area of interest {self.aoi}")

    def files(self) -> Iterator[tuple[Path, str]]:
        """Yield each file with its role."""
        heights = ((self.dsm, "dsm"), (self.dtm, "dtm"), (self.ndsm, "ndsm"))
        yield from ((Path(path), "points") for path in self.points)
        yield from ((Path(path), role) for path, role in heights if path is not None)
        yield from ((Path(path), "ortho") for path in self.ortho)
        if self.parcels is not None:
            yield Path(self.parcels), "parcels"
        if self.aoi is not None:
            yield Path(self.aoi), "aoi"

    def stated(self) -> dict[str, str]:
        """Return what the user stated about the files, where it is not the default."""
        words = {"crs": self.crs, "ortho_crs": self.ortho_crs, "z_unit": self.z_unit if self.z_unit != "auto" else None}
        return {name: str(word) for name, word in words.items() if word is not None}

    @property
    def any_target(self) -> "CRS | None":
        """The CRS to which points go that must be reprojected; None for their UTM zone."""
        return self.fallback.crs if self.target is None and self.fallback is not None else self.target

    @property
    def any_crs(self) -> CrsLike | None:
        """The CRS of points and rasters of heights that state none."""
        return self.crs or self.fallback

    @property
    def any_ortho_crs(self) -> CrsLike | None:
        """The CRS of orthophotos that state none."""
        return self.ortho_crs or self.fallback

    def default_survey(self) -> str:
        """Name the survey after its file, or after the folder of several files of points; see `longer_survey`."""
        name, _ = self._called()
        return self.longer_survey() if ANYWHERE.fullmatch(name) else name

    def longer_survey(self, taken: str = "") -> str:
        """Return that name with the folder around it, for names that hold for any place; NAME where that is taken."""
        name, around = self._called()
        longer = "-".join(word for word in (around, name) if word)
        return "NAME" if longer == taken else longer

    def _called(self) -> tuple[str, str]:
        """Return the name of the first file, or of the one folder of several files of points, and of what it is in."""
        first = next(self.files())[0]
        folder = first.resolve().parent
        # Not the first of many files: the name would change with a tile that comes or goes.
        if len(self.points) > 1 and folder.name and len({path.parent for path in self.points}) == 1:
            return folder.name, folder.parent.name
        return Path(file_name(first)).stem.removesuffix(".copc"), folder.name

    def sources(self) -> tuple[Source, ...]:
        """Describe every file by name, role, size and checksum, in an order of content."""
        if self.known is not None:
            return self.known
        pieces = {path: raster_pieces(path) for path, _ in self.files() if path.suffix.lower() == ".vrt"}
        described = [describe_source(path, role, pieces.get(path, ())) for path, role in self.files()]
        return tuple(sorted(described, key=lambda source: (source.role, source.sha256)))


def _paths(given: Paths) -> tuple[Path, ...]:
    """Return one path or several as a tuple."""
    return tuple(map(Path, (given,) if isinstance(given, str | os.PathLike) else given))


def require_polygons(path: Path) -> None:
    """Refuse a file without polygons; notices of the polygons come when they are used."""
    with collected_notices():
        read_polygons(path)
