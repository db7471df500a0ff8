"""The bar that explains a map's colours."""

from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.figure import Figure


def colour_bar(figure: Figure, axes: Axes, mapper: ScalarMappable, title: str) -> None:
    """Explain the colours beside the map, in its upper right corner.

    Parameters
    ----------
    figure : Figure
        With a margin to the right of the map, as `msbdb.view.figure.sheet` leaves.
    axes : Axes
        The map.
    mapper : ScalarMappable
        From values to colours.
    title : str
        What the values are.
    """
    box = axes.get_position()
    width, height = figure.get_figwidth(), figure.get_figheight()
    length = min(2.4 / height, box.y1)
    bar = figure.add_axes((box.x1 + 0.2 / width, box.y1 - length - 0.4 / height, 0.16 / width, length))
    figure.colorbar(mapper, cax=bar)
    bar.tick_params(labelsize=8)
    bar.set_title(title, fontsize=9, loc="left", pad=8)
