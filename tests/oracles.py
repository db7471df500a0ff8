"""The shortest possible definitions of the morphology: slow, obvious, and never to be optimised."""

import numpy as np
from scipy import ndimage

STRUCTURES = {4: ndimage.generate_binary_structure(2, 1), 8: ndimage.generate_binary_structure(2, 2)}


def binary_area_opening(mask, threshold_px, connectivity):
    """Keep the connected components of at least s cells (V2)."""
    labels, count = ndimage.label(mask, STRUCTURES[connectivity])
    areas = np.bincount(labels.ravel(), minlength=count + 1)
    return mask & (areas >= threshold_px)[labels]


def binary_area_closing(mask, threshold_px, connectivity):
    """Open the complement, and take the complement of that (V3)."""
    return ~binary_area_opening(~mask, threshold_px, connectivity)


def area_opening(values, threshold_px, connectivity):
    """Give each cell the highest level whose opened threshold set holds it (V4); the minimum where none does."""
    return _highest_level(values, lambda mask: binary_area_opening(mask, threshold_px, connectivity))


def area_closing(values, threshold_px, connectivity):
    """Give each cell the highest level whose closed threshold set holds it (V4)."""
    return _highest_level(values, lambda mask: binary_area_closing(mask, threshold_px, connectivity))


def area_open_close(values, threshold_px, connectivity):
    """Open, then close (V5)."""
    return area_closing(area_opening(values, threshold_px, connectivity), threshold_px, connectivity)


def flat_zones(values, connectivity):
    """Label the components of each value but 0, and number them by their first cells in row-major order (V25)."""
    zones = []
    for value in np.unique(values[values != 0]):
        labels, count = ndimage.label(values == value, STRUCTURES[connectivity])
        zones += [labels == label for label in range(1, count + 1)]
    zones.sort(key=lambda zone: np.flatnonzero(zone)[0])
    result = np.zeros(values.shape, dtype=np.int32)
    for number, zone in enumerate(zones, start=1):
        result[zone] = number
    return result


def linear_opening(values, length):
    """Open each row by a horizontal segment: the highest level whose runs around a cell reach the length."""

    def keep_long_runs(mask):
        result = np.zeros_like(mask)
        for row in range(mask.shape[0]):
            labels, count = ndimage.label(mask[row])
            for label in range(1, count + 1):
                run = labels == label
                result[row] |= run & (run.sum() >= length)
        return result

    return _highest_level(values, keep_long_runs)


def _highest_level(values, binary_filter):
    """Filter each threshold set, and stack the results by the supremum."""
    levels = np.unique(values)
    result = np.full_like(values, levels[0])
    for level in levels:
        result[binary_filter(values >= level)] = level
    return result
