"""Images read from a component tree: the direct rule of filtering by nodes."""


def opened(tree, keep):
    """Return the image without the nodes that are not kept: a cell has the level of the smallest kept node around it.

    Roots always stay; invalid cells become 0.
    """
    return tree.paint(tree.level[tree.innermost(keep | tree.is_root)])
