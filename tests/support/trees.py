"""Images read from a component tree: the direct rule of filtering by nodes."""

import numpy as np


def innermost(tree, selected):
    """Return the smallest of the selected nodes that holds each node, itself included; -1 where none."""
    found = np.full(tree.size, -1)
    for node, parent in enumerate(tree.parent):
        found[node] = node if selected[node] else -1 if parent == node else found[parent]
    return found


def opened(tree, keep):
    """Return the image without the nodes that are not kept: a cell has the level of the smallest kept node around it.

    Roots always stay; invalid cells become 0.
    """
    return tree.paint(tree.level[innermost(tree, keep | tree.is_root)])
