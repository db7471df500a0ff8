"""The plan of a survey: what its drafts give together, from the whole of it or from a sample of blocks."""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from msbdb.detect.adaptive.offground import ndvi_threshold
from msbdb.detect.area3d.heightscales import height_scales
from msbdb.detect.pointregions import point_ndvi
from msbdb.errors import InputError, NodataError, give_notice
from msbdb.grid import Bands, Bounds, GridSpec
from msbdb.io.crs import same_crs
from msbdb.morphology.scalespace import scales_of_sizes
from msbdb.params import Params, as_dict, with_values
from msbdb.parts.tree import cell_sizes
from msbdb.points.cloud import PointCloud
from msbdb.run.inputs import Inputs
from msbdb.run.preparation.cellblocks import block_side, drawn_blocks, is_large_raster, looked_at
from msbdb.run.preparation.drafts import Draft, lattice_of_points, make_draft, read_cloud
from msbdb.run.preparation.pointfacts import THINNED, joined_facts, sparse_enough, sparse_with_facts, with_later_echoes
from msbdb.run.preparation.rastersurface import note_offset
from msbdb.run.preparation.samples import MOST_BYTES, SampledBlocks, blocks_to_sample, bytes_to_plan, is_small
from msbdb.run.reports import Stages
from msbdb.spectral.coverclasses import Fitted, is_imagery, sample_to_classify
from msbdb.spectral.kmeans import pooled
from msbdb.spectral.model import ClassModel, fit_model
from msbdb.surface import Surface, crown_split, density_of_cells, heights_of_cells, points_of_cells
from msbdb.surface.heights import GIVEN_GROUND
from msbdb.surveyplan import Plan, PointFacts, basis_of
from msbdb.threads import together

if TYPE_CHECKING:
    from pyproj import CRS


def make_plan(inputs: Inputs, params: Params, stages: Stages) -> Plan:
    """Return the plan of a survey: that which a build of it makes and keeps.

    A plan looks at a limited number of points and cells. Where the headers promise more points, or more cells of
    rasters, a seeded hash draws blocks that hold about as many. One pass over the files that the blocks meet reads
    these. Where all points are read and their lattice has too many cells, blocks are drawn from the points.
    """
    cells = inputs.cells()
    if cells is not None and is_large_raster(cells):
        return _plan_of_cells(inputs, cells, params, stages)
    interest = inputs.area()
    blocks = blocks_to_sample(inputs, params, interest)
    with stages.stage("read"):
        cloud = read_cloud(inputs, stages.progress, area=None if blocks is None else blocks.area_in(interest))
    if cloud is None or blocks is None:
        cloud = sparse_with_facts(cloud, params)
        if cloud is not None and not is_small_cloud(cloud, params):
            return plan_of_wide_cloud(inputs, cloud, params, stages)
        plan, _ = decide([make_draft(inputs, cloud, params, stages)], params)
        return plan
    cloud, under_m = with_later_echoes(cloud)
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


def is_large(inputs: Inputs, params: Params) -> bool:
    """Return whether a plan looks at a sample of the points or cells, by what their headers promise."""
    cells = inputs.cells()
    if cells is not None:
        return is_large_raster(cells)
    return blocks_to_sample(inputs, params, inputs.area()) is not None


def is_small_cloud(cloud: PointCloud, params: Params) -> bool:
    """Return whether a plan looks at all of a cloud: its points may lie in few places of a wide lattice."""
    return is_small(len(cloud), cloud.bounds, lattice_of_points(cloud, params).cell_m, params)


def plan_of_wide_cloud(inputs: Inputs, cloud: PointCloud, params: Params, stages: Stages) -> Plan:
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
    if facts is not None:
        crowns = [each.structure.crowns for each in drafts]
        facts = replace(facts, crown_split=crown_split([each for each in crowns if each is not None]))
    spec = first.surface.ndsm.spec
    plan = Plan(
        crs=words_of(spec.crs),
        cell_m=spec.cell_m,
        density=density_of_cells([each.surface for each in drafts]) if first.cloud is None else first.surface.density,
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
        rough, roof = each.structure.filled_m, each.structure.cover.labelled("building")
        sample, bands = sample_to_classify(each.bands, each.surface.ndsm, rough, params, roof)
        samples.append(sample)
        filtered.append(bands)
    if not samples:
        return [None] * len(drafts)
    sample = pooled(samples, params.spectral.sample)
    model = fit_model(sample, params.spectral) if len(sample) else None
    return [None if bands is None else Fitted(model, bands) for bands in filtered]


def _heights(drafts: Sequence[Draft], params: Params) -> tuple[float, ...]:
    """Return the height scales of area3d; none where no point, or cell of a raster, has a height above ground."""
    every = (heights_of_cells(each.surface) if each.cloud is None else each.above for each in drafts)
    above = [heights for heights in every if heights is not None and len(heights)]
    if not above:
        return ()
    joined = above[0] if len(above) == 1 else np.concatenate(above)
    return height_scales(joined, params.area3d, mask_m=params.surface.mask_m)


def _ndvi(drafts: Sequence[Draft], params: Params) -> float | None:
    """Return the threshold of the points' NDVI; None where no point, or cell of a raster, above the mask has one."""
    found = []
    for each in drafts:
        if each.bands is None or each.bands.band("nir") is None:
            continue  # before cells become points
        cloud, above = each.cloud, each.above
        if cloud is None:
            cloud, above = points_of_cells(each.surface), heights_of_cells(each.surface)
        ndvi = point_ndvi(each.bands, cloud)
        if ndvi is not None and above is not None:
            found.append(ndvi[(above >= params.surface.mask_m) & np.isfinite(ndvi)])
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
