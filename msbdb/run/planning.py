"""The plan of a survey: what its drafts give together, from the whole of it or from a sample of blocks."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING

import geopandas as gpd
import numpy as np
import shapely
from numpy.typing import NDArray

from msbdb.detect.adaptive.offground import ndvi_threshold
from msbdb.detect.area3d.heightscales import height_scales
from msbdb.detect.pointregions import heights_of_points, point_ndvi
from msbdb.errors import InputError, collected_notices
from msbdb.grid import Bands, Bounds, Grid
from msbdb.ground.choice import POINT_FILTERS
from msbdb.io.crs import CrsLike, reference, same_crs
from msbdb.io.extents import extent_of_points
from msbdb.io.lasheader import read_las_header
from msbdb.io.vector import Area
from msbdb.morphology.scalespace import scales_of_sizes
from msbdb.params import Params, as_dict, with_values
from msbdb.parts.tree import cell_sizes
from msbdb.points.cloud import GROUND_CLASS, LONE_GAP_Z_M, PointCloud, levels_of, measure_spacing
from msbdb.points.laterechoes import numbered_by_place, under_distance
from msbdb.points.lots import thinned
from msbdb.spectral.coverclasses import Fitted, is_imagery, sample_to_classify
from msbdb.spectral.kmeans import lattice_keys, pooled
from msbdb.spectral.model import ClassModel, fit_model
from msbdb.surface import Surface
from msbdb.surface.gridding import CELL_LADDER_M, cell_size, density
from msbdb.surface.heights import GIVEN_GROUND
from msbdb.surface.structure import Structure
from msbdb.surveyplan import Plan, PointFacts, basis_of
from msbdb.threads import together

if TYPE_CHECKING:
    from pyproj import CRS


MOST_POINTS = 12_000_000
"""Ours: as many points are read for a plan at once."""

MOST_BYTES = 1.7 * 2**30
"""Ours: what a plan may take of 2 GiB beside the program."""

POINT_BYTES, CELL_BYTES, GROUND_CELL_BYTES = 45, 100, 250
"""Ours, measured (docs/scale.md): what a plan takes for each point, cell, and cell of the ground filter."""

BLOCK_M = 500.0
"""Ours: side of a block of a sample, metres, several times as wide as the largest building."""

LEAST_BLOCK_M = 62.5
"""Ours: blocks of very fine cells are halved down to this."""

BLOCK_SHARE = 4
"""Ours: a block takes at most this part of the memory, so that several make a sample."""


def bytes_to_plan(points: float, area_m2: float, cell_m: float, params: Params) -> float:
    """Return what a plan of so many points on a lattice of this area takes, bytes beside the program."""
    ground_m = max(params.ground.ground_cell_m, cell_m / 2)
    return POINT_BYTES * points + area_m2 * (CELL_BYTES / cell_m**2 + GROUND_CELL_BYTES / ground_m**2)


def is_small(points: float, bounds: Bounds, cell_m: float, params: Params) -> bool:
    """Return whether a plan looks at all points of a survey: they and the lattice over them are not too many."""
    west, south, east, north = bounds
    need = bytes_to_plan(points, (east - west) * (north - south), cell_m, params)
    return points <= MOST_POINTS and need <= MOST_BYTES


@dataclass(frozen=True, slots=True, eq=False)
class SampledBlocks:
    """The blocks of a sample, by their south-western corners and their side, metres, in the CRS of the points."""

    corners: tuple[tuple[float, float], ...]
    side_m: float
    crs: "CRS"

    @classmethod
    def over(
        cls, ground: shapely.Geometry, points: float, cell_m: float, crs: "CRS", params: Params
    ) -> "SampledBlocks":
        """Draw blocks of a ground with points, about as many as a plan may look at.

        The blocks lie at whole multiples of their side. Their order is a hash of their place and of the seed, so that
        it does not depend on the files.
        """
        side_m = BLOCK_M
        while side_m > LEAST_BLOCK_M and bytes_to_plan(0, side_m**2, cell_m, params) * BLOCK_SHARE > MOST_BYTES:
            side_m /= 2
        west, south, east, north = shapely.bounds(ground)
        columns, rows = (
            np.arange(math.floor(low / side_m), math.floor(high / side_m) + 1)
            for low, high in ((west, east), (south, north))
        )
        column, row = (each.ravel() for each in np.meshgrid(columns, rows))
        squares = shapely.box(column * side_m, row * side_m, (column + 1) * side_m, (row + 1) * side_m)
        area = shapely.area(shapely.intersection(squares, ground))
        order = np.argsort(lattice_keys(row, column, params.spectral.seed), kind="stable")
        order = order[area[order] > 0]
        held = area[order] / area.sum() * points
        need = np.cumsum([bytes_to_plan(*each, cell_m, params) for each in zip(held, area[order], strict=True)])
        enough = min(np.searchsorted(np.cumsum(held), MOST_POINTS), np.searchsorted(need, MOST_BYTES))
        corners = ((float(column[one] * side_m), float(row[one] * side_m)) for one in order[: int(enough) + 1])
        return cls(tuple(corners), side_m, crs)

    @classmethod
    def of_cloud(cls, cloud: PointCloud, cell_m: float, params: Params) -> "SampledBlocks":
        """Draw blocks of a cloud, of those that hold points."""
        places = (np.floor(axis / LEAST_BLOCK_M).astype(np.int64) for axis in (cloud.x, cloud.y))
        column, row = np.unique(np.column_stack([*places]), axis=0).T * LEAST_BLOCK_M
        squares = shapely.box(column, row, column + LEAST_BLOCK_M, row + LEAST_BLOCK_M)
        return cls.over(shapely.union_all(squares), len(cloud), cell_m, cloud.crs, params)

    def area_in(self, interest: Area | None) -> Area:
        """Return the ground of all blocks, or what of it lies in an area of interest with its margin."""
        west, south = np.array(self.corners).T
        shape = shapely.union_all(shapely.box(west, south, west + self.side_m, south + self.side_m))
        if interest is not None:
            shape = shapely.intersection(shape, interest.shape_in(self.crs))
        return Area(gpd.GeoSeries([shape], crs=self.crs), 0.0, "the sample of blocks")

    def cut(self, cloud: PointCloud) -> Iterator[tuple[tuple[float, float], PointCloud]]:
        """Yield the points of each block that has first echoes, in the order of the corners."""
        column, row = np.floor(cloud.x / self.side_m), np.floor(cloud.y / self.side_m)
        for west, south in self.corners:
            own = cloud.take((column == west // self.side_m) & (row == south // self.side_m))
            if own.first_echo.any():
                yield (west, south), own


def blocks_to_sample(
    paths: Sequence[Path], crs: CrsLike | None, params: Params, interest: Area | None = None
) -> SampledBlocks | None:
    """Draw the blocks of a sample by what the headers of points say; None where a plan can read all points.

    How large the cells of a block will be follows from the points a square metre of the files' boxes. Files whose
    boxes cannot be right draw no blocks.
    """
    infos = [read_las_header(path) for path in paths]
    with collected_notices():
        extent = extent_of_points(paths, crs) if infos else None
        how = None if extent is None else reference(extent.crs, bounds=extent.bounds, where=paths[0].name)
    if how is None or how.transformer is not None:
        return None
    boxes = shapely.box(*(np.array([info.bounds for info in infos]) * how.xy_factor).T)
    counts = np.array([info.points for info in infos])
    # A stray point widens the box of its file: by such a box the points are too far apart for any building.
    sound = counts >= shapely.area(boxes) / CELL_LADDER_M[-1] ** 2
    every = shapely.union_all(boxes[sound])
    ground = every if interest is None else shapely.intersection(every, interest.shape_in(how.crs))
    if not ground.area:
        return None
    points_m2 = counts[sound].sum() / every.area
    cell_m = params.surface.cell_m or cell_size(points_m2, literal=params.surface.cell_rule == "literal")
    points = points_m2 * ground.area
    # How wide fewer points lie is known once they are read.
    if points <= MOST_POINTS:
        return None
    return SampledBlocks.over(ground, points, cell_m, how.crs, params)


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


def with_facts(cloud: PointCloud, most_density: float) -> PointCloud:
    """Return a cloud that knows what holds for all its points.

    Echoes without numbers are numbered by their place; then what is denser than ``most_density`` is thinned.
    """
    if cloud.facts is None:
        cloud, under_m = told_apart(cloud)
        cloud, facts = sparse_enough(cloud, under_m, most_density)
        return replace(cloud, facts=facts)
    if cloud.facts.under_m:
        cloud = numbered_by_place(cloud, cloud.facts.under_m)
    return thinned(cloud, most_density)


def sparse_enough(cloud: PointCloud, under_m: float, most_density: float) -> tuple[PointCloud, PointFacts]:
    """Return a cloud that is nowhere denser than asked, and what holds for all its points (`facts_of`)."""
    fewer = thinned(cloud, most_density)
    facts = facts_of(fewer, under_m)
    if fewer is not cloud:
        facts = replace(facts, all_density=density(cloud, facts.link_m))
    return fewer, facts


def told_apart(cloud: PointCloud) -> tuple[PointCloud, float]:
    """Return a whole survey whose later echoes are known, and the distance within which they lie under others."""
    under_m = under_distance(cloud)
    return (numbered_by_place(cloud, under_m) if under_m else cloud), under_m


def facts_of(cloud: PointCloud, under_m: float = 0.0) -> PointFacts:
    """Return what holds for all points of a cloud; ``under_m`` was found before.

    Raises
    ------
    NodataError
        When there is no first echo.
    """
    spacing_m, typical_m, link_m = measure_spacing(cloud.x, cloud.y, cloud.first_echo)
    points_m2 = density(cloud, link_m)
    return PointFacts(
        points=len(cloud),
        density=points_m2,
        all_density=points_m2,
        spacing_m=spacing_m,
        typical_m=typical_m,
        link_m=link_m,
        numbered=cloud.return_number is not None,
        echoes=cloud.has_echoes,
        under_m=under_m,
        ground_share=float(np.count_nonzero(cloud.in_class(GROUND_CLASS))) / max(len(cloud), 1),
        colours=cloud.colour_names,
        intensity=cloud.intensity is not None,
        levels_m=levels_of(cloud.z),
    )


def joined_facts(facts: Sequence[PointFacts]) -> PointFacts:
    """Return what holds for the points of several blocks together.

    The density is that of their covered ground. Of the typical spacings and of the links the median counts, by
    covered ground.
    """
    if len(facts) == 1:
        return facts[0]
    points = sum(each.points for each in facts)
    # A block covers as many square metres as its points fill at its spacing, but for later echoes.
    covered = np.array([each.points * each.spacing_m**2 for each in facts])

    def middle(values: list[float]) -> float:
        order = np.argsort(values, kind="stable")
        return values[int(order[np.searchsorted(np.cumsum(covered[order]), covered.sum() / 2)])]

    names = [name for name in ("red", "green", "blue", "nir") if any(name in each.colours for each in facts)]
    return PointFacts(
        points=points,
        density=points / sum(each.points / each.density for each in facts),
        all_density=sum(each.points / each.density * each.all_density for each in facts)
        / sum(each.points / each.density for each in facts),
        spacing_m=math.sqrt(float(covered.sum()) / points),
        typical_m=middle([each.typical_m for each in facts]),
        link_m=middle([each.link_m for each in facts]),
        numbered=any(each.numbered for each in facts),
        echoes=any(each.echoes for each in facts),
        under_m=max(each.under_m for each in facts),
        ground_share=sum(each.ground_share * each.points for each in facts) / points,
        colours=tuple(names),
        intensity=any(each.intensity for each in facts),
        levels_m=_joined_levels([each.levels_m for each in facts]),
    )


def _joined_levels(levels: Sequence[tuple[tuple[float, float], ...]]) -> tuple[tuple[float, float], ...]:
    """Return the groups of elevations of several blocks, those joined that no wide gap separates."""
    found: list[tuple[float, float]] = []
    for low, high in sorted(chain.from_iterable(levels)):
        if found and low <= found[-1][1] + LONE_GAP_Z_M:
            found[-1] = (found[-1][0], max(found[-1][1], high))
        else:
            found.append((low, high))
    return tuple(found)


def decide(drafts: Sequence[Draft], params: Params) -> tuple[Plan, list[Fitted | None]]:
    """Fix the plan by what drafts have in common.

    Parameters
    ----------
    drafts : sequence of Draft
        The whole survey as one, or blocks of it; all on one lattice, their points with the facts of the survey.
    params : Params
        As given, before the plan.

    Returns
    -------
    plan : Plan
    fitted : list of Fitted or None
        For each draft the classes of colours, and the filtered bands; None without imagery.
    """
    first = drafts[0]
    scales = params.scale.scales_m2
    if not scales:
        sizes = [cell_sizes(each.surface.ndsm, each.structure.cover, params) for each in drafts]
        scales = scales_of_sizes(np.concatenate(sizes), params.granulometry)
    with_scales = with_values(params, {"scale": {"scales_m2": scales}})
    fitted, (heights_m, ndvi) = together(
        partial(_fit, drafts, with_scales), lambda: (_heights(drafts, params), _ndvi(drafts, params))
    )
    model = next((each.model for each in fitted if each is not None), None)
    facts = None if first.cloud is None else first.cloud.facts
    spec = first.surface.ndsm.spec
    plan = Plan(
        crs=words_of(spec.crs),
        cell_m=spec.cell_m,
        density=first.surface.density,
        points=facts,
        ground_filter=first.surface.ground_filter,
        scales_m2=tuple(map(float, scales)),
        heights_m=heights_m,
        ndvi_threshold=ndvi,
        classes=None if model is None else model.plan,
        basis=basis_of(as_dict(params)),
    )
    return plan, fitted


def _fit(drafts: Sequence[Draft], params: Params) -> list[Fitted | None]:
    """Fit the classes of colours to the cells of all drafts that have imagery."""
    filtered: list[Bands | None] = []
    samples = []
    for each in drafts:
        if each.bands is None or not is_imagery(each.bands):
            filtered.append(None)
            continue
        rough = each.structure.filled_m
        sample, bands = sample_to_classify(each.bands, each.surface.ndsm, rough, params)
        samples.append(sample)
        filtered.append(bands)
    if not samples:
        return [None] * len(drafts)
    sample = pooled(samples, params.spectral.sample)
    model = fit_model(sample, params.spectral) if len(sample) else None
    return [None if bands is None else Fitted(model, bands) for bands in filtered]


def _heights(drafts: Sequence[Draft], params: Params) -> tuple[float, ...]:
    """Return the height scales of area3d; none without points."""
    above = [each.above for each in drafts if each.above is not None and len(each.above)]
    if not above:
        return ()
    every = above[0] if len(above) == 1 else np.concatenate(above)
    return height_scales(every, params.area3d, mask_m=params.surface.mask_m)


def _ndvi(drafts: Sequence[Draft], params: Params) -> float | None:
    """Return the threshold of the points' NDVI; None where no point above the mask has one."""
    found = []
    for each in drafts:
        if each.cloud is None or each.above is None:
            continue
        ndvi = point_ndvi(each.bands, each.cloud)
        if ndvi is not None:
            found.append(ndvi[(each.above >= params.surface.mask_m) & np.isfinite(ndvi)])
    known = np.concatenate(found) if found else np.zeros(0, dtype=np.float32)
    return ndvi_threshold(known, params.adaptive) if len(known) else None


def settled(params: Params, plan: Plan) -> Params:
    """Return the parameters with the values of a plan in place of those that a build finds."""
    area3d, adaptive = params.area3d, params.adaptive
    if plan.heights_m:
        area3d = replace(area3d, heights_m=plan.heights_m)
    if plan.ndvi_threshold is not None:
        adaptive = replace(adaptive, ndvi_bounds=(plan.ndvi_threshold, plan.ndvi_threshold))
    return replace(params, area3d=area3d, adaptive=adaptive, scale=replace(params.scale, scales_m2=plan.scales_m2))


def fitted_by(plan: Plan, bands: Bands | None) -> Fitted | None:
    """Return the classes of colours of a plan.

    Raises
    ------
    InputError
        When the plan is for other bands.
    """
    if bands is None or not is_imagery(bands):
        return None
    if plan.classes is not None and plan.classes.bands != bands.names:
        msg = (
            f"The plan has classes of the bands {', '.join(plan.classes.bands)}; the survey has "
            f"{', '.join(bands.names)}. Give images of these bands, or make a plan of this survey."
        )
        raise InputError(msg)
    return Fitted(None if plan.classes is None else ClassModel.of_plan(plan.classes))


def require_fitting(plan: Plan, surface: Surface, cloud: PointCloud | None) -> None:
    """Refuse a survey in another CRS, on another lattice or of another kind of source than a plan.

    Raises
    ------
    InputError
        With what differs.
    """
    from pyproj import CRS

    spec = surface.ndsm.spec
    kinds = {True: "points", False: "rasters"}
    given = {True: "a given terrain", False: "the ground detected among the points"}
    terrain, planned = (name == GIVEN_GROUND for name in (surface.ground_filter, plan.ground_filter))
    differ = [
        (words_of(spec.crs), plan.crs, same_crs(CRS.from_user_input(plan.crs), spec.crs)),
        (kinds[cloud is not None], kinds[plan.points is not None], (cloud is None) == (plan.points is None)),
        (given[terrain], given[planned], terrain == planned),
        (f"cells of {spec.cell_m:g} m", f"cells of {plan.cell_m:g} m", spec.cell_m == plan.cell_m),
    ]
    for ours, theirs, alike in differ:
        if not alike:
            msg = f"The survey has {ours}, its plan {theirs}. Give a plan that was made of such a survey."
            raise InputError(msg)


def words_of(crs: "CRS") -> str:
    """Return a CRS as its authority's code, or as WKT where it has none."""
    code = crs.to_authority()
    return crs.to_wkt() if code is None else ":".join(code)
