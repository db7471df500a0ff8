"""Which cells of a mask are thick: a disc fits into them. Thinner ones are slivers along outlines, and no change."""

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray
from skimage.morphology import isotropic_dilation, isotropic_erosion, isotropic_opening

from msbdb.grid import GridSpec
from msbdb.labels import Labels, chosen_cells, label_zones, renumber, sizes
from msbdb.params import ChangeParams

Mask = NDArray[np.bool_]

BAND_CELLS = 1 << 19
"""Cells of a band: distances and places of all cells at once would take more memory than both surveys."""


def bands(shape: tuple[int, int]) -> Iterator[slice]:
    """Yield the rows of a lattice in bands of about `BAND_CELLS` cells.

    Examples
    --------
    >>> list(bands((3, BAND_CELLS // 2)))
    [slice(0, 2, None), slice(2, 3, None)]
    """
    step = max(BAND_CELLS // max(shape[1], 1), 1)
    for first in range(0, shape[0], step):
        yield slice(first, min(first + step, shape[0]))


def thick(mask: Mask, spec: GridSpec, params: ChangeParams) -> Labels:
    """Label the 8-connected pieces of a mask that a disc fits into and that are large enough, in row order."""
    reach = params.thickness_m / spec.cell_m
    # The disc rounds corners off; dilation inside of the mask gives them back.
    pieces, count = label_zones(opened_and_dilated(mask, reach) & mask)
    return renumber(pieces, sizes(pieces, count) * spec.cell_area_m2 >= params.least_m2)[0]


def opened_and_dilated(mask: Mask, reach: float, halo: int | None = None) -> Mask:
    """Return where a disc fits into a mask, and the cells within its radius of that, band by band.

    Parameters
    ----------
    mask : (H, W) ndarray of bool
        It goes on beyond the lattice as at its border, which must not make a piece thin.
    reach : float
        Radius of the disc, cells.
    halo : int, optional
        Rows that a band sees beyond its own; by default as many as it needs.

    Notes
    -----
    Erosion and both dilations look at cells within the radius, so that a cell depends on those within three of them.
    Bands that see so many whole rows more give what the whole mask gives; with a row less they do not.
    """
    halo = 3 * math.floor(reach) if halo is None else halo
    margin = math.ceil(reach) + 1
    padded = np.pad(mask, margin, mode="edge")
    found = np.zeros_like(mask)
    for rows in bands(mask.shape):
        first = max(rows.start + margin - halo, 0)
        part = padded[first : rows.stop + margin + halo]
        if part.any():
            whole = _dilated(_dilated(_eroded(part, reach), reach), reach)
            found[rows] = whole[rows.start + margin - first : rows.stop + margin - first, margin:-margin]
    return found


def _eroded(cells: Mask, reach: float) -> Mask:
    """Return the cells that no cell outside of a mask lies near; a distance to nothing is not defined."""
    return cells if cells.all() else isotropic_erosion(cells, reach)  # type: ignore[no-untyped-call]  # scikit-image


def _dilated(cells: Mask, reach: float) -> Mask:
    """Return the cells near those of a mask."""
    return isotropic_dilation(cells, reach) if cells.any() else cells  # type: ignore[no-untyped-call]  # scikit-image


def core(cells: Mask, spec: GridSpec, params: ChangeParams) -> Mask:
    """Return the cells of a mask that a disc inside of it covers; beyond the array there is no mask."""
    reach = params.thickness_m / spec.cell_m
    margin = int(np.ceil(reach)) + 1
    opened = isotropic_opening(np.pad(cells, margin), reach)  # type: ignore[no-untyped-call]  # scikit-image
    return np.asarray(opened[margin:-margin, margin:-margin] & cells)


def without_slivers(cells: Mask, spec: GridSpec, params: ChangeParams) -> Mask:
    """Return a footprint without its pieces that no disc fits into, unless none else is left.

    After a part was pulled down, strips too thin to be a change can be left along the old outline.
    """
    pieces, count = label_zones(cells, connectivity=4)  # as outlines are traced
    whole = sizes(pieces[core(cells, spec, params)], count) > 0
    return chosen_cells(pieces, whole) if whole.any() else cells
