"""The raster of reasons: why each cell is a building or not, from all that was decided about it."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from msbdb.detect.scene import CERTAIN, Regions, Scene
from msbdb.fuse.cells import count_votes
from msbdb.labels import chosen_cells, label_zones, sizes
from msbdb.params import DETECTORS, Params
from msbdb.parts.forest import Forest
from msbdb.tables import Reason

Mask = NDArray[np.bool_]
Cells = NDArray[np.uint8]


def support_of(regions: Mapping[str, Regions], shape: tuple[int, int]) -> Cells:
    """Return which detectors take a cell for building: bit n is that of ``params.DETECTORS[n]``.

    Parameters
    ----------
    regions : mapping of str to Regions
        Of each detector that was run.
    shape : tuple of int
        (H, W) of the lattice.

    Returns
    -------
    (H, W) ndarray of uint8
    """
    found = np.zeros(shape, dtype=np.uint8)
    for place, method in enumerate(DETECTORS):
        if method in regions:
            found |= (regions[method].labels > 0).astype(np.uint8) << np.uint8(place)
    return found


def explain_cells(
    scene: Scene, regions: Mapping[str, Regions], built: Mask | None, forest: Forest, params: Params
) -> Cells:
    """Return the decisive reason of each cell, the first of these that holds.

    Without a height there is *no data*. Cells of buildings are *building*, cells below the mask *low*. Where the
    detectors took a cell together, the tree of parts dropped it, and its reason counts. The cells of objects smaller
    than the least building area are *small*. Land cover gives *vegetation*, by structure or by colour. Then the votes
    of the detectors decide.

    Parameters
    ----------
    scene : Scene
        Heights, land cover and evidence.
    regions : mapping of str to Regions
        Of each detector that was run.
    built : (H, W) ndarray of bool, optional
        The cells that the detectors took together; None where they did not decide together.
    forest : Forest
        The final tree of parts.
    params : Params
        ``surface.mask_m`` and ``fuse.piece_m2``.

    Returns
    -------
    (H, W) ndarray of uint8
        `msbdb.tables.Reason`.

    Notes
    -----
    An object is an 8-connected set of cells at or above the mask. Border: objects end at the lattice. Nodata: invalid
    cells belong to no object. Linear in the cells.
    """
    heights = scene.heights
    high = heights.valid & (np.asarray(heights.values) >= params.surface.mask_m)
    found = np.where(heights.valid, np.uint8(Reason.LOW), np.uint8(Reason.NO_DATA))
    found[high] = _by_detectors(scene, regions, built, forest, params)[high]
    found[forest.root_labels > 0] = Reason.BUILDING
    return found


def _by_detectors(
    scene: Scene, regions: Mapping[str, Regions], built: Mask | None, forest: Forest, params: Params
) -> Cells:
    """Return the reasons of cells at or above the mask that are no building."""
    shape = scene.heights.spec.shape
    taken = np.zeros(shape, dtype=np.bool_)
    for region in regions.values():
        taken |= region.labels > 0
    if built is not None:
        coloured = scene.cover.spectral is not None
        votes, _, needed = count_votes(regions, of_points=scene.elevations.of_points, coloured=coloured)
        enough = np.where(votes >= needed, np.uint8(Reason.OUTVOTED), np.uint8(Reason.HARDLY_SUPPORTED))
    else:
        enough = np.full(shape, Reason.NO_PARTS if "multiscale" not in regions else Reason.HARDLY_SUPPORTED, np.uint8)
    found = np.where(taken, enough, np.uint8(Reason.UNSUPPORTED))
    _overlay_objects(found, scene, params, open_=found != Reason.OUTVOTED)
    _overlay_parts(found, scene, built, forest, params)
    return found


def _overlay_objects(found: Cells, scene: Scene, params: Params, *, open_: Mask) -> None:
    """Write vegetation and small objects into the open cells."""
    cover = scene.cover
    green = open_ & cover.classes.labelled("vegetation")
    rough = cover.structure.labelled("vegetation")
    if cover.spectral is not None and scene.evidence is not None:
        # A dense crown that looked like a roof is vegetation by its colour.
        like_roof = 2 * scene.evidence.roof_probability.astype(np.int16) > CERTAIN
        rough &= ~(like_roof & cover.spectral.labelled("vegetation"))
    found[green & rough] = Reason.VEGETATION_BY_STRUCTURE
    found[green & ~rough] = Reason.VEGETATION_BY_COLOUR
    heights = scene.heights
    objects, count = label_zones(heights.valid & (np.asarray(heights.values) >= params.surface.mask_m))
    least = params.fuse.piece_m2 / heights.spec.cell_area_m2
    found[open_ & chosen_cells(objects, sizes(objects, count) < least)] = Reason.SMALL


def _overlay_parts(found: Cells, scene: Scene, built: Mask | None, forest: Forest, params: Params) -> None:
    """Write why the tree of parts dropped cells that were taken for building."""
    if forest.reasons is None:
        return
    if built is None:
        # The land cover has said why cells are vegetation.
        lost = (forest.reasons > 0) & (forest.reasons != Reason.VEGETATION_BY_STRUCTURE)
        found[lost] = forest.reasons[lost]
        return
    found[built] = np.where(forest.reasons[built] > 0, forest.reasons[built], np.uint8(Reason.OTHER_CLASS))
    classes = scene.cover.with_buildings(built, scene.heights, params.surface.mask_m).classes
    relabelled = built & ~classes.labelled("building")
    found[relabelled] = Reason.OTHER_CLASS
    found[relabelled & classes.labelled("vegetation")] = Reason.VEGETATION_BY_COLOUR
