"""Fused footprints: parts and flat regions together, with a decision on each piece that only one of them has.

The classes are smoothed over metres, so a crown beside a roof may count as roof. The flat regions have no roof below
their least area. So the cells of the piece itself decide: their heights, roughness and probability of roof.
"""

from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy import ndimage

from msbdb.detect.scene import CERTAIN, Regions, Scene
from msbdb.errors import GridMismatchError
from msbdb.grid import Grid
from msbdb.labels import EIGHT, Labels, boxes, chosen_cells, label_zones, reorder, sizes
from msbdb.params import FuseParams, Params
from msbdb.parts.forest import Forest

Mask = NDArray[np.bool_]
Field = NDArray[np.floating]


@dataclass(frozen=True, slots=True, eq=False)
class RoofEvidence:
    """The evidence of roof of each cell, independent of parts and flat regions.

    Parameters
    ----------
    heights : Grid
        Heights above ground, metres. Invalid cells do not count.
    roughness_m : (H, W) ndarray of float
        Residual of the best plane in the small window, metres (`msbdb.surface.texture.roughness`).
    roof_probability : (H, W) ndarray of float
        Of roof against vegetation from the cell's own echoes and texture, 0 to 1, before any smoothing.
    """

    heights: Grid
    roughness_m: Field
    roof_probability: Field


def fuse(forest: Forest, flat: Regions | None, scene: Scene, params: Params) -> Labels | None:
    """Fuse the footprints of the parts and the flat regions of a scene.

    Parameters
    ----------
    forest : Forest
        The parts.
    flat : Regions, optional
        The flat regions; None where that detector was not run.
    scene : Scene
        Heights, and the evidence of each cell.
    params : Params
        As `fuse_footprints` takes them.

    Returns
    -------
    (H, W) ndarray of int32 or None
        0 for none, otherwise row number + 1 in the buildings in order of their ids. A building may have no cell left.
        None where one of the two detectors was not run.
    """
    if scene.evidence is None or flat is None:
        return None
    evidence = RoofEvidence(
        scene.heights,
        scene.evidence.roughness_mm.astype(np.float32) / np.float32(1000),
        scene.evidence.roof_probability.astype(np.float32) / np.float32(CERTAIN),
    )
    labels = fuse_footprints(forest.root_labels, flat.firm_labels, evidence, params)
    parts = forest.parts
    roots = np.flatnonzero((parts["supid"] == 0).to_numpy())
    roots = roots[np.argsort(parts["part_id"].to_numpy()[roots])]
    return reorder(labels, roots, len(parts))


def fuse_footprints(root_labels: Labels, region_labels: Labels, evidence: RoofEvidence, params: Params) -> Labels:
    """Return the fused footprints of parts and flat regions.

    Parameters
    ----------
    root_labels : (H, W) ndarray of int32
        Label of the root that covers a cell, 0 for none (``Forest.root_labels``). Not modified.
    region_labels : (H, W) ndarray of int32
        Flat regions, 0 for none: their firm cells, which are left with R as given.
    evidence : RoofEvidence
        On the same lattice.
    params : Params
        Section ``fuse``, the mask, and R and λ_min of the flat regions.

    Returns
    -------
    (H, W) ndarray of int32
        The roots' labels on the fused footprints. A root may vanish or fall in two; none is new.

    Raises
    ------
    GridMismatchError
        When the images differ in shape.

    Notes
    -----
    The disputed cells are those that one detector alone takes for building. Their pieces are the 8-connected
    components after an opening with a square of twice ``edge_m``, so that differing edges neither count nor join
    pieces.

    A piece of the parts alone is dropped when it is smaller than R λ_min, the least area that a flat region can have,
    and

    - lies below the mask, in a building that flat regions cover: a light well that the area closing filled; or
    - is rough, and mostly no roof by its own cells, in a building that flat regions cover: a crown beside it; or
    - is rough and in a building without any flat region: a crown. So small a roof is one plane or two.

    A piece of a flat region alone is added when it lies above the mask, is smooth, is roof by its own cells, and
    touches a building: an annex. It gets the label of the building with most cells beside it (of equals, the smaller
    label). A piece that touches no building is not added.

    The rims that the opening removed follow their piece. A rim between a dropped and a kept piece stays as in the
    parts. Edges that a dropped piece leaves, joined to nothing else, are dropped with it.
    Border: the disputed cells continue beyond it. Nodata: invalid cells do not count in a piece's medians and means; a
    piece without a valid cell stays as in the parts. Linear in the cells, except for one sort of the disputed ones.
    """
    own = params.fuse
    _require_one_shape(root_labels, region_labels, evidence)
    cell_m = evidence.heights.spec.cell_m
    steps = max(1, int(own.edge_m / cell_m + 0.5))
    parts, regions = root_labels > 0, region_labels > 0
    fused = root_labels.copy()
    pieces, measures = _pieces(parts & ~regions, steps, evidence)
    share = _flat_share(pieces, len(measures), parts, regions)
    dropped = _is_false(measures.assign(flat_share=share), cell_m, params)
    gone = _with_rims(pieces, dropped, parts & ~regions, steps)
    firm = (parts & regions) | ((pieces > 0) & ~gone)
    fused[gone | _remains(parts & ~gone, firm, gone)] = 0
    pieces, measures = _pieces(regions & ~parts, steps, evidence)
    added = _is_roof(measures, params.surface.mask_m, cell_m, own) & (measures["probability"] >= own.roof_share)
    annexes = _with_rims(pieces, added.to_numpy(), regions & ~parts, steps)
    return _label_annexes(fused, annexes)


def _require_one_shape(root_labels: Labels, region_labels: Labels, evidence: RoofEvidence) -> None:
    """Refuse images of different shapes."""
    shapes = {
        "roots": root_labels.shape,
        "flat regions": region_labels.shape,
        "heights": evidence.heights.spec.shape,
        "roughness": evidence.roughness_m.shape,
        "probability": evidence.roof_probability.shape,
    }
    if len(set(shapes.values())) > 1:
        msg = (
            f"Footprints are fused on one lattice; the shapes are {', '.join(f'{k} {v}' for k, v in shapes.items())}. "
            "Take all from one build."
        )
        raise GridMismatchError(msg)


def _pieces(disputed: Mask, steps: int, evidence: RoofEvidence) -> tuple[Labels, pd.DataFrame]:
    """Label the pieces of the disputed cells, and measure them: row i is piece i, row 0 is for no piece."""
    size = 2 * steps + 1
    framed = np.pad(disputed, steps, mode="edge")
    opened = ndimage.binary_opening(framed, np.ones((size, size), dtype=np.bool_))
    labels, count = label_zones(opened[steps:-steps, steps:-steps])
    measured = (labels > 0) & evidence.heights.valid
    cells = pd.DataFrame(
        {
            "piece": labels[measured],
            "height": np.asarray(evidence.heights.values)[measured],
            "roughness": evidence.roughness_m[measured],
            "probability": evidence.roof_probability[measured],
        }
    ).groupby("piece")
    measures = cells[["height", "roughness"]].median().join(cells[["probability"]].mean())
    measures = measures.astype(np.float64).reindex(range(count + 1))
    area_m2 = sizes(labels, count) * evidence.heights.spec.cell_area_m2
    return labels, measures.assign(area_m2=np.append(np.nan, area_m2))


def _is_roof(measures: pd.DataFrame, mask_m: float, cell_m: float, own: FuseParams) -> "pd.Series[bool]":
    """Return which pieces lie above the mask and are smooth."""
    return (measures["height"] >= mask_m) & (measures["roughness"] <= own.smooth_m * max(1.0, cell_m))


def _is_false(measures: pd.DataFrame, cell_m: float, params: Params) -> Mask:
    """Return which pieces of the parts alone are no building."""
    own = params.fuse
    is_unseen = measures["flat_share"] == 0
    is_seen = ~is_unseen & (measures["flat_share"] >= own.seen_share)
    is_low = measures["height"] < params.surface.mask_m
    is_rough = measures["roughness"] > own.smooth_m * max(1.0, cell_m)
    is_small = measures["area_m2"] < params.flatregions.ratio * params.flatregions.lambda_min_m2
    is_leafy = measures["probability"] < own.roof_share
    false = is_small & ((is_seen & (is_low | (is_rough & is_leafy))) | (is_unseen & is_rough))
    return np.asarray(false, dtype=np.bool_)


def _flat_share(pieces: Labels, count: int, parts: Mask, regions: Mask) -> NDArray[np.float64]:
    """Return, for each piece, the share that flat regions cover of all connected buildings that it belongs to."""
    blocks, blocks_count = label_zones(parts)
    share = sizes(blocks[regions], blocks_count) / sizes(blocks, blocks_count)
    # A piece lies in one block; no piece, in none.
    block = np.zeros(count, dtype=np.intp)
    block[pieces[pieces > 0]] = blocks[pieces > 0]
    return np.concatenate([[0.0], share])[block]


def _with_rims(pieces: Labels, chosen: Mask, disputed: Mask, steps: int) -> Mask:
    """Return the cells of the chosen pieces, with the rims that no other piece reaches as well."""
    own_cells = chosen[pieces] & (pieces > 0)
    others = (pieces > 0) & ~own_cells
    if not own_cells.any():
        return own_cells
    reached = ndimage.binary_dilation(own_cells, EIGHT, iterations=steps, mask=disputed)
    if others.any():
        reached &= ~ndimage.binary_dilation(others, EIGHT, iterations=steps, mask=disputed)
    return np.asarray(reached | own_cells)


def _remains(left: Mask, firm: Mask, gone: Mask) -> Mask:
    """Return the remains of buildings beside a dropped piece that have no firm cell, only edges."""
    blocks, count = label_zones(left)
    beside = sizes(blocks[ndimage.binary_dilation(gone, EIGHT)], count) > 0
    return chosen_cells(blocks, beside & (sizes(blocks[firm], count) == 0))


def _label_annexes(fused: Labels, annexes: Mask) -> Labels:
    """Give each connected annex the label of the building with most cells beside it; those beside none stay out."""
    found, _ = label_zones(annexes)
    for number, window in boxes(found).items():
        around = tuple(slice(max(0, side.start - 1), side.stop + 1) for side in window)
        annex = found[around] == number
        beside = fused[around][ndimage.binary_dilation(annex, EIGHT) & ~annex]
        if beside.any():
            fused[around][annex] = np.bincount(beside[beside > 0]).argmax()
    return fused
