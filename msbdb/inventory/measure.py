"""What stands in an outline: its area, heights and volume, where no building of a survey has just this outline."""

import numpy as np
import shapely

from msbdb.grid import Grid, GridSpec
from msbdb.vector.polygons import rasterise


def measure(shape: shapely.MultiPolygon, heights: Grid) -> dict[str, float]:
    """Measure an outline on heights above ground.

    Parameters
    ----------
    shape : Polygon or MultiPolygon
        In the lattice's CRS.
    heights : Grid
        Heights above ground, metres.

    Returns
    -------
    dict of str to float
        ``area_m2`` of the outline itself; ``h_max``, ``h_mean``, ``h_p50`` and ``h_p90`` in metres, and ``volume_m3``,
        of the valid cells whose centre lies inside, heights below 0 counting as 0 in the volume; empty where the
        outline has no such cell.
    """
    spec, (rows, cols) = heights.spec, _box(shape, heights.spec)
    if rows.stop <= rows.start or cols.stop <= cols.start:
        return {}
    inside = (rasterise([shape], spec.crop(rows, cols)) > 0) & heights.valid[rows, cols]
    found = np.asarray(heights.values)[rows, cols][inside].astype(np.float64)
    if not found.size:
        return {}
    middle, high = np.percentile(found, [50, 90])
    return {
        "area_m2": float(shape.area),
        "h_max": float(found.max()),
        "h_mean": float(found.mean()),
        "h_p50": float(middle),
        "h_p90": float(high),
        "volume_m3": float(np.maximum(found, 0).sum() * spec.cell_area_m2),
    }


def _box(shape: shapely.MultiPolygon, spec: GridSpec) -> tuple[slice, slice]:
    """Return the rows and columns that an outline may cover."""
    west, south, east, north = shape.bounds
    row, col = spec.rowcol(np.array([west, east]), np.array([north, south]))
    limits = zip((row, col), spec.shape, strict=True)
    top, left = (slice(max(int(first), 0), min(int(last) + 1, size)) for (first, last), size in limits)
    return top, left
