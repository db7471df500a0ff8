"""The shortest possible definitions of the morphology: slow, obvious, and never to be optimised."""

import numpy as np
from scipy import ndimage, sparse
from scipy.spatial import cKDTree

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


def components(values, valid, connectivity):
    """Return the mask and level of every component of every threshold set of the valid cells, each once."""
    found = {}
    for level in np.unique(values[valid]):
        labels, count = ndimage.label(valid & (values >= level), STRUCTURES[connectivity])
        for label in range(1, count + 1):
            mask = labels == label
            found[mask.tobytes()] = (mask, values[mask].min())
    return list(found.values())


def attribute_opening(values, valid, connectivity, attribute, threshold):
    """Give each valid cell the highest level of a component around it with enough; else its area's lowest; 0 beside."""
    result = np.zeros_like(values)
    areas, count = ndimage.label(valid, STRUCTURES[connectivity])
    for area in range(1, count + 1):
        result[areas == area] = values[areas == area].min()
    for mask, level in components(values, valid, connectivity):
        if attribute(mask) >= threshold:
            result[mask] = np.maximum(result[mask], level)
    return result


def theta(zones):
    """Return the highest response of each cell, and the largest zone that has it; 0 where none responds (M5)."""
    response = np.max(zones, axis=0)
    largest = np.zeros(response.shape, dtype=int)
    for i, zone in enumerate(zones, start=1):
        largest[(zone == response) & (zone > 0)] = i
    return response, largest


def window_opening(values, valid, window_px):
    """Give each valid cell the highest minimum, over valid cells, of all windows on the lattice that hold it."""
    half = window_px // 2
    result = np.full(values.shape, -np.inf)
    for row, col in np.ndindex(values.shape):
        window = np.s_[max(row - half, 0) : row + half + 1, max(col - half, 0) : col + half + 1]
        lowest = np.min(values[window], where=valid[window], initial=np.inf)
        result[window] = np.maximum(result[window], lowest)
    return np.where(valid, result, 0)


def window_extremes(values, valid, window_px):
    """Return the lowest and the highest valid value around each valid cell, 0 in others."""
    half = window_px // 2
    lowest, highest = np.zeros(values.shape), np.zeros(values.shape)
    for row, col in zip(*np.nonzero(valid), strict=True):
        window = np.s_[max(row - half, 0) : row + half + 1, max(col - half, 0) : col + half + 1]
        lowest[row, col] = values[window][valid[window]].min()
        highest[row, col] = values[window][valid[window]].max()
    return lowest, highest


def connected_pairs(x, y, z, distance):
    """Return all ordered pairs of points that are nearer to each other than a distance (Cao & Wu, Definition 1)."""
    square = sum((column[:, None] - column[None, :]) ** 2 for column in (x, y, z))
    near = square < distance * distance
    np.fill_diagonal(near, val=False)
    return [(int(one), int(other)) for one, other in np.argwhere(near)]


def tree_pairs(x, y, z, distance):
    """Return the same pairs as a search tree finds them; it takes a distance of just the limit for near."""
    pairs = cKDTree(np.stack([x, y, z], axis=1)).query_pairs(distance, output_type="ndarray")
    return sorted((int(one), int(other)) for a, b in pairs for one, other in ((a, b), (b, a)))


def point_components(mask, graph):
    """Label the components of the graph between the points of a set, in the order of their first points; 0 outside."""
    matrix = sparse.csr_array((np.ones(graph.indices.size), graph.indices, graph.indptr), shape=(mask.size, mask.size))
    labels = np.zeros(mask.size, dtype=np.int32)
    if mask.any():
        _, found = sparse.csgraph.connected_components(matrix[mask][:, mask], directed=False)
        _, first, inverse = np.unique(found, return_index=True, return_inverse=True)
        labels[mask] = np.argsort(np.argsort(first))[inverse] + 1
    return labels


def point_opening(mask, graph, threshold, weights=None):
    """Keep the components of a set whose points weigh at least T_a together (Cao & Wu, Eq. 1)."""
    labels = point_components(mask, graph)
    areas = np.bincount(labels, weights=weights, minlength=1)
    return mask & (areas >= threshold)[labels]


def point_closing(mask, graph, threshold, weights=None):
    """Add to a set the components of the others that weigh less than T_a together (Cao & Wu, Eq. 2)."""
    return ~point_opening(~mask, graph, threshold, weights)
