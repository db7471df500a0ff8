"""The map: what it shows, and that it is written whole or not at all."""

import subprocess
import sys

import geopandas as gpd
import numpy as np
import pytest
import shapely
from affine import Affine
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.image import imread
from matplotlib.patches import Rectangle
from pyproj import CRS

from msbdb.errors import FileError, InputError
from msbdb.grid import Grid, GridSpec
from msbdb.tables import Reason
from msbdb.view.buildingmap import draw_map, furnish, shading, sheet, thinned
from msbdb.view.buildingthemes import draw_heights, draw_probability, draw_reasons, draw_support
from msbdb.view.furniture import outlines, round_length, scale_bar
from msbdb.view.groundimages import REASON_COLOURS

LAMBERT = CRS.from_epsg(2154)
WEST, NORTH = 800_000.0, 6_300_100.0


def relief(rows: int = 100, cols: int = 160, *, hole: bool = False) -> Grid:
    """Return a level surface with one tower of 20 by 20 cells, 1 m each."""
    heights = np.zeros((rows, cols), dtype=np.float32)
    heights[20:40, 30:50] = 30.0
    valid = np.ones((rows, cols), dtype=np.bool_)
    valid[: rows // 4, cols // 2 :] = not hole
    return Grid(np.where(valid, heights, 0), valid, GridSpec((rows, cols), Affine(1, 0, WEST, 0, -1, NORTH), LAMBERT))


def city(n: int = 3) -> tuple[gpd.GeoDataFrame, gpd.GeoDataFrame]:
    """Return n by n podiums with a courtyard, each with a tower part, and their footprints."""
    side = 90 / n
    parts, roots = [], []
    for index in range(n * n):
        west, south = WEST + 5 + side * (index % n), NORTH - 95 + side * (index // n)
        shell = shapely.box(west, south, west + 0.8 * side, south + 0.8 * side)
        court = shapely.box(west + 0.3 * side, south + 0.3 * side, west + 0.5 * side, south + 0.5 * side)
        podium = shapely.MultiPolygon([shapely.difference(shell, court)])
        tower = shapely.MultiPolygon([shapely.box(west, south, west + 0.2 * side, south + 0.2 * side)])
        parts += [(1, 6.0, podium), (3, 6.0 + index % 25, tower)]
        roots.append(podium)
    frame = gpd.GeoDataFrame(
        {"scale": [part[0] for part in parts], "h_p90": [part[1] for part in parts]},
        geometry=[part[2] for part in parts],
        crs=LAMBERT,
    )
    return frame, gpd.GeoDataFrame(geometry=roots, crs=LAMBERT)


def draw(path, parts, buildings, grid, **more):
    """Draw with a title."""
    draw_map(parts, buildings, grid, path, title="town", **more)
    return imread(path)


def test_the_map_shows_fills_and_outlines(tmp_path):
    """Parts are filled in the colours of heights, and a picture with parts differs from one without."""
    parts, buildings = city()
    picture = draw(tmp_path / "full.png", parts, buildings, relief(), subtitle="EPSG:2154", thresholds_m2={1: 1000.0})
    empty = draw(tmp_path / "empty.png", parts.iloc[:0], buildings.iloc[:0], relief())

    def warm(image):
        return ((image[..., 0] - image[..., 2]) > 0.25).mean()

    assert warm(picture) > 0.1
    assert warm(empty) < 0.001
    blue = (picture[..., 2] - picture[..., 0]) > 0.2
    assert blue.any(), "the scales' outlines are blue"


def test_a_courtyard_stays_open():
    """A hole is no part of the path's inside, whichever way its ring turns."""
    shell = [(0, 0), (10, 0), (10, 10), (0, 10)]
    for hole in ([(4, 4), (6, 4), (6, 6), (4, 6)], [(4, 4), (4, 6), (6, 6), (6, 4)]):
        geometries = np.array([shapely.Polygon(shell, [hole]), shapely.MultiPolygon()], dtype=object)
        path, nothing = outlines(geometries)
        figure = Figure(figsize=(1, 1), dpi=100)
        canvas = FigureCanvasAgg(figure)
        axes = figure.add_axes((0, 0, 1, 1))
        axes.axis([0, 10, 0, 10])
        from matplotlib.patches import PathPatch

        axes.add_patch(PathPatch(path, facecolor="black"))
        canvas.draw()
        image = np.asarray(canvas.buffer_rgba())
        assert image[50, 50, 0] == 255
        assert image[20, 50, 0] == 0
        assert len(nothing.vertices) == 0
    assert outlines(np.array([], dtype=object)) == []


def test_the_same_input_gives_the_same_bytes(tmp_path):
    """Nothing of the clock or the machine's state is in the picture."""
    parts, buildings = city()
    first, second = tmp_path / "a.png", tmp_path / "b.png"
    for path in (first, second):
        draw(path, parts, buildings, relief(hole=True))
    assert first.read_bytes() == second.read_bytes()


@pytest.mark.parametrize(("rows", "cols"), [(1, 1), (1, 400), (400, 20), (60, 60)])
def test_any_shape_of_tile_is_drawn(rows, cols, tmp_path):
    """Narrow, tall and single-cell tiles give a picture with the map inside."""
    valid = np.ones((rows, cols), dtype=np.bool_)
    grid = Grid(
        np.zeros((rows, cols), dtype=np.float32),
        valid,
        GridSpec((rows, cols), Affine(1, 0, WEST, 0, -1, NORTH), LAMBERT),
    )
    parts, buildings = city()
    picture = draw(tmp_path / "x.png", parts, buildings, grid)
    assert min(picture.shape[:2]) > 500


def test_a_tile_without_data_is_drawn(tmp_path):
    """A grid with no valid cell and no parts gives a picture all the same."""
    grid = relief()
    void = Grid(np.zeros(grid.spec.shape, np.float32), np.zeros(grid.spec.shape, np.bool_), grid.spec)
    parts, buildings = city()
    assert draw(tmp_path / "x.png", parts.iloc[:0], buildings.iloc[:0], void).size


def test_missing_heights_are_drawn(tmp_path):
    """A part without a height takes the lowest colour, and does not blank the others."""
    parts, buildings = city()
    parts.loc[0, "h_p90"] = np.nan
    assert draw(tmp_path / "x.png", parts, buildings, relief()).size


def test_light_comes_from_the_north_west():
    """A slope to the north-west is lit white, one to the south-east black; the level is clear beside a tower too."""
    row, col = np.mgrid[0:40, 0:40].astype(np.float32)
    valid = np.ones((40, 40), dtype=np.bool_)
    lit = shading(0.3 * (row + col), valid, 1.0)
    dark = shading(-0.3 * (row + col), valid, 1.0)
    tower = np.zeros((40, 40), dtype=np.float32)
    tower[10:20, 10:20] = 30.0
    level = shading(tower, valid, 1.0)[25:]
    assert lit[20, 20, 0] == 255
    assert lit[20, 20, 3] > 12
    assert dark[20, 20, 0] == 0
    assert dark[20, 20, 3] > 25
    assert level[..., 3].max() == 0


def test_an_old_picture_survives_a_failure(tmp_path, monkeypatch):
    """When writing fails the old file stays, nothing is left beside it, and the error says what to do."""
    parts, buildings = city()
    path = tmp_path / "x.png"
    path.write_bytes(b"old")

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("pathlib.Path.replace", full)
    with pytest.raises(FileError, match="No space left"):
        draw_map(parts, buildings, relief(), path, title="town")
    assert path.read_bytes() == b"old"
    assert [file.name for file in tmp_path.iterdir()] == ["x.png"]


def test_a_place_that_cannot_be_written_is_refused(tmp_path):
    """A folder that is a file gives a clear error."""
    (tmp_path / "file").touch()
    parts, buildings = city()
    with pytest.raises(FileError, match="cannot be written"):
        draw_map(parts, buildings, relief(), tmp_path / "file" / "x.png", title="town")


def test_other_formats_are_refused(tmp_path):
    """Another ending is refused before anything is drawn."""
    parts, buildings = city()
    with pytest.raises(InputError, match="PNG, SVG or PDF"):
        draw_map(parts, buildings, relief(), tmp_path / "x.jpg", title="town")


@pytest.mark.parametrize(("ending", "first"), [("svg", b"<?xml"), ("pdf", b"%PDF")])
def test_a_report_takes_vectors(ending, first, tmp_path):
    """SVG and PDF have the same bytes each time, and begin as their formats do."""
    parts, buildings = city()
    files = [tmp_path / f"{name}.{ending}" for name in "ab"]
    for path in files:
        draw_map(parts, buildings, relief(), path, title="town")
    assert files[0].read_bytes().startswith(first)
    assert files[0].read_bytes() == files[1].read_bytes()


def test_the_scale_bar_has_a_round_length():
    """The bar's label is 1, 2 or 5 times a power of ten, and fits its share of the map."""
    for longest in (0.7, 3.0, 49.0, 51.0, 999.0, 12_345.0):
        length = round_length(longest)
        assert length <= longest < 2.5 * length
        assert f"{length:.0e}"[0] in "125"
    figure, axes = sheet(relief(400, 400))
    axes.axis([0, 10_000, 0, 10_000])
    scale_bar(figure, axes)
    assert {text.get_text() for text in figure.texts} == {"0", "2 km"}


@pytest.mark.parametrize(("rows", "cols"), [(100, 160), (400, 20), (1, 400)])
def test_nothing_lies_on_the_map(rows, cols):
    """Scale bar, north arrow and their words are drawn on the sheet, outside the map, and as long as they say."""
    figure, axes = sheet(relief(rows, cols))
    furnish(figure, axes, "town", "today")
    figure.canvas.draw()
    within = axes.get_window_extent()
    drawn = [*figure.texts, *figure.artists]
    assert len(drawn) > 6
    for artist in drawn:
        box = artist.get_window_extent()
        assert not within.overlaps(box), artist
        assert box.x0 >= 0 <= box.y0, artist
    west, east = axes.get_xlim()
    bar = sum(artist.get_window_extent().width for artist in figure.artists if isinstance(artist, Rectangle))
    said = next(text.get_text() for text in figure.texts if text.get_text().endswith(" m"))
    assert bar * (east - west) / within.width == pytest.approx(float(said.removesuffix(" m")), rel=0.02)


def test_no_global_state_of_matplotlib_is_touched():
    """Drawing never imports pyplot, so that it is safe in threads, servers and notebooks."""
    code = "import sys, msbdb.view.buildingmap; print('matplotlib.pyplot' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"


def themed(path, what, buildings, grid):
    """Draw one of the maps of buildings."""
    if what == "footprints":
        draw_heights(buildings, grid, path, title="town")
    elif what == "detectors":
        draw_support(buildings, {"one": "one_share", "other": "other_share"}, grid, path, title="town")
    elif what == "probability":
        draw_probability(buildings, grid, path, title="town")
    else:
        reasons = np.full(grid.spec.shape, Reason.LOW, dtype=np.uint8)
        reasons[:, 80:] = Reason.VEGETATION_BY_STRUCTURE
        draw_reasons(buildings, [(grid.spec, reasons)], grid, path, title="town")


def colours_at(path, grid, x, y):
    """Return the colour of a map near a place, red, green and blue from 0 to 1."""
    _, axes = sheet(grid)
    box, size = axes.get_position(), imread(path).shape
    west, east = axes.get_xlim()
    south, north = axes.get_ylim()
    column = round(size[1] * (box.x0 + (box.x1 - box.x0) * (x - west) / (east - west)))
    row = round(size[0] * (1 - box.y0 - (box.y1 - box.y0) * (y - south) / (north - south)))
    return imread(path)[row, column, :3]


@pytest.mark.parametrize("what", ["footprints", "detectors", "probability", "reasons"])
@pytest.mark.parametrize("ending", ["png", "svg", "pdf"])
def test_each_theme_is_drawn_in_each_format(what, ending, tmp_path):
    """With buildings, without any, and with values that are not known; the same input gives the same bytes."""
    buildings = city()[1].assign(h_p90=12.0, one_share=0.5, other_share=np.nan, probability=0.7)
    buildings.loc[0, ["h_p90", "probability"]] = np.nan
    pictures = []
    for number, rows in enumerate((buildings, buildings, buildings.iloc[:0])):
        themed(tmp_path / f"{number}.{ending}", what, rows, relief(hole=True))
        pictures.append((tmp_path / f"{number}.{ending}").read_bytes())
    assert pictures[0] == pictures[1] != pictures[2]


def test_the_colours_of_themes_have_the_order_of_their_values(tmp_path):
    """More detectors and a higher probability are brighter; cells with other reasons have other colours."""
    grid = relief()
    level = Grid(np.zeros(grid.spec.shape, np.float32), grid.valid, grid.spec)
    boxes = [shapely.box(WEST + 10 + 40 * n, NORTH - 60, WEST + 30 + 40 * n, NORTH - 40) for n in range(3)]
    values = {"one_share": [0.0, 0.5, 0.5], "other_share": [0.05, 0.0, 0.9], "probability": [0.1, 0.5, 0.95]}
    buildings = gpd.GeoDataFrame(values, geometry=boxes, crs=LAMBERT)
    for what in ("detectors", "probability"):
        path = tmp_path / f"{what}.png"
        themed(path, what, buildings, level)
        seen = [colours_at(path, level, WEST + 20 + 40 * n, NORTH - 50).mean() for n in range(3)]
        assert seen[0] < seen[1] < seen[2]
    path = tmp_path / "reasons.png"
    themed(path, "reasons", buildings.iloc[:0], level)
    for x, reason in ((20, Reason.LOW), (140, Reason.VEGETATION_BY_STRUCTURE)):
        assert colours_at(path, level, WEST + x, NORTH - 80) == pytest.approx(to_rgb(REASON_COLOURS[reason]), abs=0.01)


def test_pictures_suit_a_report(tmp_path):
    """A rough surface of 2000 by 2000 cells has fewer than 2500 dots a side and 4 MB as PNG and PDF, 6 MB as SVG."""
    heights = np.random.default_rng(1).uniform(0, 3, (2000, 2000)).astype(np.float32)
    spec = GridSpec(heights.shape, Affine(1, 0, WEST, 0, -1, NORTH), LAMBERT)
    grid = Grid(heights, np.ones(heights.shape, dtype=np.bool_), spec)
    parts, buildings = city()
    for ending, most in (("png", 4e6), ("pdf", 4e6), ("svg", 6e6)):
        draw_map(parts, buildings, grid, tmp_path / f"x.{ending}", title="town")
        assert (tmp_path / f"x.{ending}").stat().st_size < most
    assert max(imread(tmp_path / "x.png").shape) < 2500


def test_a_thinned_surface_has_the_means_of_its_blocks():
    """Blocks of valid cells alone; a block without any is not valid; the last ones may be smaller."""
    values = np.arange(35, dtype=np.float32).reshape(5, 7)
    valid = np.ones((5, 7), dtype=np.bool_)
    valid[:2, :2] = False
    valid[2, 2] = False
    spec = GridSpec((5, 7), Affine(1, 0, WEST, 0, -1, NORTH), LAMBERT)
    means, known = thinned(Grid(np.where(valid, values, 0), valid, spec), 2)
    for row in range(3):
        for col in range(4):
            block = (slice(2 * row, 2 * row + 2), slice(2 * col, 2 * col + 2))
            assert known[row, col] == valid[block].any()
            if known[row, col]:
                assert means[row, col] == pytest.approx(values[block][valid[block]].mean())
