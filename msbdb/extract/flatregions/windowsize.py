"""From metres to the cells of a square window."""


def window_px(size_m: float, cell_m: float) -> int:
    """Return the side of the window w_S: S in whole cells, and one more where that is even; at least one cell (M11).

    Examples
    --------
    >>> window_px(3.0, 0.3), window_px(3.0, 0.5), window_px(0.2, 0.5)
    (11, 7, 1)
    """
    cells = int(size_m / cell_m + 0.5)
    return max(1, cells + (cells + 1) % 2)
