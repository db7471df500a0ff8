"""Where two surveys differ: pieces of the lattice that were built, are gone, or rose or sank."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from skimage.morphology import isotropic_dilation, isotropic_opening

from msbdb.grid import Grid, GridSpec
from msbdb.inventory.offset import Offset
from msbdb.labels import Labels, boxes, chosen_cells, label_zones, renumber, sizes
from msbdb.params import ChangeParams

Mask = NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class Epochs:
    """Both sides of a comparison on the lattice of the later survey, the inventory shifted onto it.

    Parameters
    ----------
    before, after : (H, W) ndarray of int32
        Footprints: 0 for none, otherwise row number + 1 of the frame.
    surveyed : (H, W) ndarray of bool
        Where the later survey has heights, within the area of interest.
    rise : Grid
        Height above ground now less that of before, without the vertical offset, metres; invalid where the earlier one
        is not known.
    heights, earlier : Grid
        Height above ground now and before, metres; the latter is invalid where it is not known.
    """

    before: Labels
    after: Labels
    surveyed: Mask
    rise: Grid
    heights: Grid
    earlier: Grid


@dataclass(frozen=True, slots=True, eq=False)
class Pieces:
    """Labelled pieces of change, each of ``least_m2`` and thick: ``gain``, ``loss`` and ``lift``, 0 for none.

    ``fallen`` has all cells of the earlier footprints whose heights are gone, ``rose`` and ``sank`` those that stand
    higher or lower than before, thick or not.
    """

    gain: Labels
    loss: Labels
    lift: Labels
    fallen: Mask
    rose: Mask
    sank: Mask


def earlier_heights(grids: Sequence[Grid], spec: GridSpec, offset: Offset) -> Grid:
    """Return the heights above ground that the inventory knows, on another lattice, by the nearest cell.

    Parameters
    ----------
    grids : sequence of Grid
        Heights of earlier surveys in the same CRS; the first one that is valid at a place tells.
    spec : GridSpec
        The later survey's lattice.
    offset : Offset
        How the later survey lies to them.
    """
    values = np.zeros(spec.shape, dtype=np.float32)
    valid = np.zeros(spec.shape, dtype=np.bool_)
    east, north = spec.centres()
    places = east - offset.dx_m, north - offset.dy_m
    for grid in grids:
        new = grid.spec.sample(grid.valid, *places, outside=False) & ~valid
        np.copyto(values, grid.spec.sample(np.asarray(grid.values), *places, outside=0), where=new)
        valid |= new
    return Grid(values, valid, spec)


def find_pieces(epochs: Epochs, params: ChangeParams) -> Pieces:
    """Find the pieces of change.

    A cell of one footprint alone counts where its height changed as well; where the earlier height is not known, what
    is open now is gone, and what stands in the later footprint alone was built.
    What two extractions merely saw otherwise (a crown that leans on a roof, a courtyard) is no change, and neither is
    a sliver along an outline.
    """
    in_before, in_after, rise = epochs.before > 0, epochs.after > 0, epochs.rise
    values = np.asarray(rise.values)
    rose = ~rise.valid | (values >= params.rise_m)
    # Where the earlier height is not known, a building is gone only where its place is open now.
    fell = np.where(rise.valid, values <= -params.rise_m, np.asarray(epochs.heights.values) < params.rise_m)
    # A courtyard that an extraction closed over carries no roof.
    stood = in_before & ~(epochs.earlier.valid & (np.asarray(epochs.earlier.values) < params.rise_m))
    stands = in_after & (np.asarray(epochs.heights.values) >= params.rise_m)
    gain = stands & ~stood & epochs.surveyed & rose
    loss = in_before & ~stands & epochs.surveyed & fell
    # A roof that was raised rises as a whole, also where the later extraction overlooked a part of it.
    still = np.asarray(epochs.heights.values) >= params.rise_m
    lift = still & stood & epochs.surveyed & rise.valid & (np.abs(values) >= params.rise_m)
    # Raised and sunken parts may touch, but are not one piece.
    higher, lower = lift & (values > 0), lift & (values < 0)
    up, down = (thick(side, rise.spec, params) for side in (higher, lower))
    down[down > 0] += up.max(initial=0)
    lifts = np.where(up > 0, up, down)
    return Pieces(thick(gain, rise.spec, params), thick(loss, rise.spec, params), lifts, loss, higher, lower)


def touching(piece: Labels, other: Labels, reach_m: float, cell_m: float) -> dict[int, set[int]]:
    """Return, for each piece, the other labels within reach of it, but for those that it touches with a corner.

    A label counts with a third or more of the cells within reach that the label with most of them has.
    """
    count = int(piece.max(initial=0))
    found: dict[int, set[int]] = {number: set() for number in range(1, count + 1)}
    reach = reach_m / cell_m
    margin = int(np.ceil(reach)) + 1
    for number, (rows, cols) in boxes(piece).items():
        box = (
            slice(max(rows.start - margin, 0), rows.stop + margin),
            slice(max(cols.start - margin, 0), cols.stop + margin),
        )
        near = isotropic_dilation(piece[box] == number, reach)  # type: ignore[no-untyped-call]
        labels, cells = np.unique(other[box][near & (other[box] > 0)], return_counts=True)
        found[number] = set(labels[3 * cells >= cells.max(initial=0)].tolist())
    return found


def thick(mask: Mask, spec: GridSpec, params: ChangeParams) -> Labels:
    """Label the 8-connected pieces of a mask that a disc fits into and that are large enough, in row order."""
    # Beyond the lattice nothing is known, which must not make a piece thin.
    margin = int(np.ceil(params.thickness_m / spec.cell_m)) + 1
    padded = np.pad(mask, margin, mode="edge")
    reach = params.thickness_m / spec.cell_m
    opened = isotropic_opening(padded, reach)  # type: ignore[no-untyped-call]
    # The disc rounds corners off, which are given back.
    whole = isotropic_dilation(opened, reach)[margin:-margin, margin:-margin] & mask  # type: ignore[no-untyped-call]
    pieces, count = label_zones(whole)
    return renumber(pieces, sizes(pieces, count) * spec.cell_area_m2 >= params.least_m2)[0]


def without_crumbs(cells: Mask, spec: GridSpec, params: ChangeParams) -> Mask:
    """Return a footprint without its pieces that no disc fits into, unless none else is left.

    Of a part that was pulled down, what is too thin to be a change stays along the old outline.
    """
    reach = params.thickness_m / spec.cell_m
    core = isotropic_opening(np.pad(cells, int(np.ceil(reach)) + 1), reach)  # type: ignore[no-untyped-call]
    margin = (core.shape[0] - cells.shape[0]) // 2
    pieces, count = label_zones(cells, connectivity=4)  # as outlines are traced
    whole = sizes(pieces[core[margin:-margin, margin:-margin] & cells], count) > 0
    return chosen_cells(pieces, whole) if whole.any() else cells
