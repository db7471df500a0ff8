"""Maps of buildings on a hillshade: their parts by scale and height, and their changes between surveys."""

import io
import math
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import geopandas as gpd
import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.collections import PathCollection
from matplotlib.colors import Colormap, LinearSegmentedColormap, Normalize, to_rgba
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator, StrMethodFormatter
from numpy.typing import NDArray

from msbdb.errors import InputError
from msbdb.grid import Grid
from msbdb.io.files import PICTURES, write_atomic
from msbdb.view.furniture import BELOW_INCHES, legend_beside, north_arrow, outlines, scale_bar

MAP_INCHES = 9.0
"""Longer side of the map on paper; the resolution follows the data, so that fonts keep their size."""

LARGEST_RELIEF = 1200
"""Cells a side beyond which the hillshade is thinned, by means (ours): 130 dots an inch do for light and shadow."""

LEVELS = 16
"""Steps of light and of shadow (ours): finer ones are not seen, and make files several times as large."""

DOTS = (150, 200)
"""Fewest and most dots an inch of a picture (ours): a page of a report prints 200 well."""

GROUND = "#eeece6"

NO_DATA = "#d3dfe9"

NO_CLOCK = {"png": "Software", "svg": "Date", "pdf": "CreationDate"}
"""What is left out of a file of each format, so that the same map gives the same bytes."""

LIGHT_DEG = 45.0
"""Height of the light above the horizon; it comes from the north-west, as on most maps."""

HEIGHTS: Colormap = LinearSegmentedColormap.from_list(
    "heights", ["#fff6d5", "#fddc8a", "#fdb35a", "#f1803c", "#d2502c", "#9c2b25"]
)
"""Light to dark and yellow to red, which colour-blind readers can order, also in grey."""

KINDS = {
    "unchanged": "#c4c4c4",
    "first seen": "#dcdcdc",
    "not surveyed": "#ffffff",
    "unsure": "#f0e442",
    "modified": "#e69f00",
    "merged": "#56b4e9",
    "split": "#0072b2",
    "new": "#009e73",
    "demolished": "#d55e00",
}
"""Colours by Okabe and Ito, which colour-blind readers can distinguish, in the order in which they are drawn."""


def draw_map(
    parts: gpd.GeoDataFrame,
    buildings: gpd.GeoDataFrame,
    relief: Grid,
    out: Path,
    *,
    title: str,
    subtitle: str = "",
    thresholds_m2: Mapping[int, float] | None = None,
) -> None:
    """Draw footprints and parts on a hillshade and write the picture in one piece.

    Parts are filled by height, the coarsest first, so that each lies on its father; outlines go from dark and thick
    (coarse) to light and thin (fine). Footprints are drawn black above all.

    Parameters
    ----------
    parts : GeoDataFrame
        Columns ``scale`` (1 = coarsest), ``h_p90`` (metres) and polygons, in metres. May be empty.
    buildings : GeoDataFrame
        Footprints in the same CRS. May be empty.
    relief : Grid
        DSM, or heights above ground, metres; cells without data are left blank.
    out : Path
        The picture, ``.png``, ``.svg`` or ``.pdf``; folders are made as needed. An old picture stays whole until the
        new one is complete.
    title, subtitle : str
        What is shown; when, and in which CRS.
    thresholds_m2 : mapping of int to float, optional
        The scales' area thresholds, square metres, for the legend.

    Raises
    ------
    InputError
        When the file has another ending.
    FileError
        When it cannot be written.
    """
    require_picture(out)
    figure, axes = sheet(relief)
    draw_relief(axes, relief)
    norm = height_range(parts)
    scales = sorted(int(scale) for scale in parts["scale"].unique())
    thin = thinness(parts, axes)
    for order, scale in enumerate(scales):
        chosen = parts[parts["scale"] == scale]
        _draw_parts(axes, chosen, norm, order, _line(scale, scales, thin))
    draw_outlines(axes, buildings, 1.5 * thin)
    furnish(figure, axes, title, subtitle)
    _legend(figure, axes, scales, thresholds_m2=thresholds_m2 or {}, thin=thin, no_data=not bool(relief.valid.all()))
    if len(parts):
        height_bar(figure, axes, norm)
    write_picture(figure, out)


def sheet(relief: Grid) -> tuple[Figure, Axes]:
    """Return a figure with room for a title above and a legend beside the map, and the map's axes.

    The map's longer side is ``MAP_INCHES``; two dots a cell, within ``DOTS``.
    """
    rows, cols = relief.spec.shape
    longest = max(rows, cols)
    width, height = (max(MAP_INCHES * side / longest, 3.2) for side in (cols, rows))
    left, right, bottom, top = 0.75, 2.35, BELOW_INCHES, 0.8
    sheet_width, sheet_height = left + width + right, bottom + max(height, 4.2) + top
    figure = Figure(figsize=(sheet_width, sheet_height), dpi=min(max(2 * longest / MAP_INCHES, DOTS[0]), DOTS[1]))
    FigureCanvasAgg(figure)
    base = sheet_height - top - height
    axes = figure.add_axes(
        (left / sheet_width, base / sheet_height, width / sheet_width, height / sheet_height), facecolor=NO_DATA
    )
    west, south, east, north = relief.spec.bounds
    metres = max((east - west) / width, (north - south) / height)
    x, y = (west + east) / 2, (south + north) / 2
    axes.set_xlim(x - metres * width / 2, x + metres * width / 2)
    axes.set_ylim(y - metres * height / 2, y + metres * height / 2)
    return figure, axes


def draw_relief(axes: Axes, relief: Grid) -> None:
    """Draw the ground's colour where the relief is valid, and its light and shadow above the parts, roofs and all."""
    step = math.ceil(max(relief.spec.shape) / LARGEST_RELIEF)
    heights, valid = thinned(relief, step)
    if min(heights.shape) < 2 or not valid.any():
        return
    cell = relief.spec.cell_m * step
    west, _, _, north = relief.spec.bounds
    rows, cols = heights.shape
    extent = (west, west + cols * cell, north - rows * cell, north)
    ground = np.zeros((rows, cols, 4), dtype=np.uint8)
    ground[valid] = np.round(255 * np.array(to_rgba(GROUND))).astype(np.uint8)
    limits = axes.axis()
    for image, zorder in ((ground, 1.0), (shading(heights, valid, cell), 3.0)):
        axes.imshow(image, extent=extent, aspect="auto", interpolation="none", zorder=zorder)
    axes.axis(limits)  # an image sets the limits to its own


def thinned(relief: Grid, step: int) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Return the means of a grid's valid cells in blocks of ``step`` by ``step`` cells, and which blocks have one."""
    rows, cols = relief.spec.shape
    starts = np.arange(0, rows, step), np.arange(0, cols, step)

    def sums(values: NDArray[Any]) -> NDArray[np.float64]:
        down = np.add.reduceat(values.astype(np.float64), starts[0], axis=0)
        return np.asarray(np.add.reduceat(down, starts[1], axis=1))

    count = sums(relief.valid)
    total = sums(np.where(relief.valid, relief.values, 0.0))
    return (total / np.maximum(count, 1.0)).astype(np.float32), count > 0


def shading(heights: NDArray[np.float32], valid: NDArray[np.bool_], cell_m: float) -> NDArray[np.uint8]:
    """Return light and shadow of a surface lit from the north-west, to be laid over colours.

    Parameters
    ----------
    heights : (H, W) ndarray of float32, metres
        Two rows and columns at least.
    valid : (H, W) ndarray of bool
        Where the heights hold; elsewhere the picture is clear.
    cell_m : float
        Side of a cell, metres.

    Returns
    -------
    (H, W, 4) ndarray of uint8
        White on slopes to the light, black on those away from it, clear on the level.
    """
    down, east = np.gradient(np.where(valid, heights, heights[valid].min()), cell_m)
    level, flat = math.sin(math.radians(LIGHT_DEG)), math.cos(math.radians(LIGHT_DEG))
    shade = (level + flat / math.sqrt(2) * (east + down)) / np.sqrt(1.0 + down**2 + east**2)  # normal times light
    shadow = np.clip((level - shade) / level, 0.0, 1.0)
    light = np.clip((shade - level) / (1.0 - level), 0.0, 1.0)
    image = np.zeros((*heights.shape, 4), dtype=np.uint8)
    image[light > shadow, :3] = 255
    steps = np.round(LEVELS * np.maximum(shadow, light)) / LEVELS
    image[..., 3] = np.where(valid, np.round(255 * np.where(light > shadow, 0.4, 0.55) * steps), 0)
    return image


def height_range(parts: gpd.GeoDataFrame) -> Normalize:
    """Return the range of colours: from 0 to the 99th percentile, so that one tower does not flatten a town."""
    heights = parts["h_p90"].to_numpy(dtype=np.float64)
    heights = heights[np.isfinite(heights)]
    top = float(np.percentile(heights, 99)) if len(heights) else 1.0
    return Normalize(0.0, max(top, 1.0), clip=True)


def thinness(parts: gpd.GeoDataFrame, axes: Axes) -> float:
    """Return the factor of line widths: 1 where parts are large on paper, down to 0.5 where they are tiny."""
    if not len(parts):
        return 1.0
    west, east = axes.get_xlim()
    inches_a_metre = axes.get_window_extent().width / axes.figure.dpi / (east - west)
    side = float(np.sqrt(np.median(parts.geometry.area))) * inches_a_metre
    return float(np.clip(side / 0.25, 0.5, 1.0))


def _line(scale: int, scales: list[int], thin: float) -> tuple[tuple[float, float, float], float]:
    """Return colour and width of a scale's outlines: dark and thick for the coarsest, light and thin for the finest."""
    share = scales.index(scale) / max(len(scales) - 1, 1)
    dark, light = np.array([0.04, 0.10, 0.35]), np.array([0.00, 0.75, 0.95])
    red, green, blue = (dark + share * (light - dark)).tolist()
    return (red, green, blue), (1.3 - 0.7 * share) * thin


def _draw_parts(
    axes: Axes,
    parts: gpd.GeoDataFrame,
    norm: Normalize,
    order: int,
    line: tuple[tuple[float, float, float], float],
) -> None:
    """Fill the parts of a scale by height below the shading, and outline them above it."""
    colour, width = line
    paths = outlines(parts.geometry.to_numpy())
    heights = parts["h_p90"].fillna(0.0).to_numpy(dtype=np.float64)
    fills = PathCollection(paths, facecolors=HEIGHTS(norm(heights)), linewidths=0.0, zorder=2 + order / 100)
    edges = PathCollection(
        paths, facecolors="none", edgecolors=[colour], linewidths=width, joinstyle="round", zorder=4 - order / 100
    )
    axes.add_collection(fills, autolim=False)
    axes.add_collection(edges, autolim=False)


def draw_outlines(axes: Axes, buildings: gpd.GeoDataFrame, width: float) -> None:
    """Outline the footprints."""
    if not len(buildings):
        return
    paths = outlines(buildings.geometry.to_numpy())
    edges = PathCollection(paths, facecolors="none", edgecolors="black", linewidths=width, joinstyle="round", zorder=5)
    axes.add_collection(edges, autolim=False)


def furnish(figure: Figure, axes: Axes, title: str, subtitle: str) -> None:
    """Write the title and coordinates, and draw scale bar and north arrow."""
    box = axes.get_position()
    height = figure.get_figheight()
    # A survey may be called anything: dollar signs make no formula of it.
    plain: dict[str, Any] = {"va": "bottom", "parse_math": False}
    figure.text(box.x0, box.y1 + 0.34 / height, title, fontsize=15, fontweight="bold", **plain)
    figure.text(box.x0, box.y1 + 0.12 / height, subtitle, fontsize=9, color="#444444", **plain)
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(MaxNLocator(nbins=4, steps=[1, 2, 5, 10], integer=True, prune="both"))
        axis.set_major_formatter(StrMethodFormatter("{x:.0f}"))
    axes.tick_params(labelsize=7, colors="#555555", length=3, width=0.6)
    for label in axes.get_yticklabels():
        label.set_rotation(90)
        label.set_verticalalignment("center")
    for spine in axes.spines.values():
        spine.set_linewidth(0.8)
        spine.set_edgecolor("#333333")
    scale_bar(figure, axes)
    north_arrow(figure, axes)


def _legend(
    figure: Figure,
    axes: Axes,
    scales: list[int],
    *,
    thresholds_m2: Mapping[int, float],
    thin: float,
    no_data: bool,
) -> None:
    """Explain the lines beside the map, the scales from coarse to fine."""
    handles: list[Line2D | Patch] = [Line2D([], [], color="black", linewidth=1.8, label="footprint")]
    for scale in scales:
        colour, width = _line(scale, scales, thin)
        size = f", from {thresholds_m2[scale]:,.0f} m²" if scale in thresholds_m2 else ""
        handles.append(Line2D([], [], color=colour, linewidth=1.6 * width / thin, label=f"scale {scale}{size}"))
    if no_data:
        handles.append(Patch(facecolor=NO_DATA, edgecolor="#999999", linewidth=0.6, label="no data"))
    legend_beside(figure, axes, handles, "Parts by scale" if scales else "No parts")


def height_bar(figure: Figure, axes: Axes, norm: Normalize) -> None:
    """Explain the colours of the heights below the legend."""
    box = axes.get_position()
    width, height = figure.get_figwidth(), figure.get_figheight()
    length = min(1.6 / height, box.y1)
    bar = figure.add_axes((box.x1 + 0.2 / width, max(box.y0, 0.3 / height), 0.16 / width, length))
    figure.colorbar(ScalarMappable(norm, HEIGHTS), cax=bar, extend="max")
    bar.tick_params(labelsize=8)
    bar.set_title("Height, m", fontsize=9, loc="left", pad=8)


def require_picture(out: Path) -> None:
    """Refuse a picture of another format."""
    if out.suffix.lower() not in PICTURES:
        msg = f"A map is written as PNG, SVG or PDF; got the name {out.name}. Give it the ending .png, .svg or .pdf."
        raise InputError(msg)


def write_picture(figure: Figure, out: Path) -> None:
    """Write the picture beside its place and move it there, so that no half picture is ever seen."""
    picture = io.BytesIO()
    with warnings.catch_warnings():
        # Signs that the font lacks are drawn as boxes.
        warnings.filterwarnings("ignore", message="Glyph .* missing from font", category=UserWarning)
        kind = out.suffix.lower()[1:]
        with rc_context({"svg.hashsalt": "msbdb"}):
            figure.savefig(picture, format=kind, metadata={NO_CLOCK[kind]: None})
    with write_atomic(out) as temporary:
        temporary.write_bytes(picture.getvalue())


def draw_changes(changes: gpd.GeoDataFrame, relief: Grid, out: Path, *, title: str, subtitle: str = "") -> None:
    """Draw buildings coloured by kind of change, on a hillshade.

    Parameters
    ----------
    changes : GeoDataFrame
        Column ``kind`` and polygons, in metres. May be empty.
    relief, out, title, subtitle
        As for `draw_map`, which raises the same errors.
    """
    require_picture(out)
    figure, axes = sheet(relief)
    draw_relief(axes, relief)
    for order, (kind, colour) in enumerate(KINDS.items()):
        chosen = changes[changes["kind"] == kind]
        paths = outlines(chosen.geometry.to_numpy())
        is_quiet = kind in ("unchanged", "first seen", "not surveyed", "unsure")
        fills = PathCollection(
            paths, facecolors=colour, edgecolors="#555555" if is_quiet else "black",
            linewidths=0.4 if is_quiet else 1.0, joinstyle="round", zorder=2 + order / 100,
        )  # fmt: skip
        axes.add_collection(fills, autolim=False)
    furnish(figure, axes, title, subtitle)
    _change_legend(figure, axes, changes)
    write_picture(figure, out)


def _change_legend(figure: Figure, axes: Axes, changes: gpd.GeoDataFrame) -> None:
    """Explain the colours beside the map, with the number of rows of each kind that occurs."""
    counts = changes["kind"].value_counts()
    handles = [
        Patch(facecolor=colour, edgecolor="black", linewidth=0.6, label=f"{kind}: {counts[kind]}")
        for kind, colour in reversed(KINDS.items())
        if kind in counts.index
    ]
    legend_beside(figure, axes, handles, "Buildings")
