"""Labels to polygons and back."""

import itertools
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
import shapely
from affine import Affine
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from pyproj import CRS
from support.sizes import examples

from msbdb.errors import GridMismatchError, InputError
from msbdb.grid import GridSpec, lattice
from msbdb.labels import islands_of, label_zones
from msbdb.outline.polygons import polygonise, rasterise, rasterise_window, tidied, with_joined_corners

RD = CRS.from_epsg(28992)

label_arrays = hnp.arrays(np.int32, hnp.array_shapes(min_dims=2, max_dims=2, max_side=9), elements=st.integers(0, 3))
sparse_arrays = hnp.arrays(
    np.int32, hnp.array_shapes(min_dims=2, max_dims=2, max_side=14), elements=st.sampled_from([0, 0, 0, 1, 2, 3])
)


def spec_of(labels, cell_m=0.5):
    """Return a lattice far from the origin."""
    return GridSpec(labels.shape, Affine(cell_m, 0, 85_000.0, 0, -cell_m, 447_000.0), RD)


@examples(100)
@given(label_arrays)
def test_polygons_are_exactly_the_cells(labels):
    """Rasterising gives back the labels; areas are cells times cell area; all is valid and shares whole edges."""
    spec = spec_of(labels)
    polygons = polygonise(labels, spec, 4)
    assert polygons.shape == (4,)
    assert all(polygon.geom_type == "MultiPolygon" for polygon in polygons)
    assert np.array_equal(rasterise(polygons, spec), labels)
    cells = np.bincount(labels.ravel(), minlength=5)[1:]
    assert np.array_equal(shapely.area(polygons), cells * spec.cell_area_m2)
    assert shapely.is_valid(polygons).all()
    assert shapely.coverage_is_valid(polygons)


@examples(200)
@given(sparse_arrays)
def test_outlines_of_a_sheet_are_those_of_the_lattice(values):
    """Islands that are gathered on a sheet are tidied and outlined as on the lattice."""
    labels, count = label_zones(values)
    spec, joined = spec_of(labels), with_joined_corners(labels)
    islands = islands_of(joined > 0)
    sheet = polygonise(tidied(islands.gather(joined), 2), spec, count, islands=islands)
    lattice = polygonise(tidied(labels, 2), spec, count)
    assert shapely.equals_exact(shapely.normalize(sheet), shapely.normalize(lattice)).all()


@examples(50)
@given(label_arrays)
def test_shells_run_counter_clockwise(labels):
    """Every shell is counter-clockwise and every hole clockwise."""
    for polygon in shapely.get_parts(polygonise(labels, spec_of(labels), 3)):
        assert polygon.exterior.is_ccw
        assert not any(hole.is_ccw for hole in polygon.interiors)


def test_a_courtyard_is_a_hole_and_corner_contact_makes_two_polygons():
    """A ring keeps its hole; cells that touch at a corner are polygons of their own."""
    labels = np.zeros((5, 6), dtype=np.int32)
    labels[:3, :3] = 1
    labels[1, 1] = 0
    labels[3, 3] = 1
    (outline,) = polygonise(labels, spec_of(labels), 1)
    assert sorted(len(polygon.interiors) for polygon in outline.geoms) == [0, 1]
    assert sorted(polygon.area for polygon in outline.geoms) == [0.25, 2.0]
    assert outline.bounds == (85_000.0, 446_998.0, 85_002.0, 447_000.0)


def test_a_vertex_lies_where_three_labels_meet():
    """The long edge of one object has a vertex where its two neighbours meet."""
    labels = np.array([[1, 1, 1, 1], [2, 2, 3, 3]], dtype=np.int32)
    above, left, right = polygonise(labels, spec_of(labels), 3)
    shared = (85_001.0, 446_999.5)
    for outline in (above, left, right):
        assert shared in list(outline.geoms[0].exterior.coords)
    assert len(above.geoms[0].exterior.coords) == 6


def test_labels_that_do_not_occur_are_empty():
    """The array has an entry for every label; one that has no cells is empty."""
    labels = np.array([[0, 3]], dtype=np.int32)
    assert polygonise(labels, spec_of(labels), 4)[[0, 1, 3]].tolist() == [shapely.MultiPolygon()] * 3
    none = polygonise(np.zeros((2, 2), dtype=np.int32), spec_of(np.zeros((2, 2))), 0)
    assert none.shape == (0,)


def test_wrong_labels_and_shapes_are_refused():
    """A label above the count, a negative one and another shape are errors."""
    labels = np.array([[0, 3]], dtype=np.int32)
    with pytest.raises(InputError, match="between 0 and 2; got 0 to 3"):
        polygonise(labels, spec_of(labels), 2)
    with pytest.raises(InputError, match="got -1"):
        polygonise(np.array([[-1]], dtype=np.int32), spec_of(np.zeros((1, 1))), 2)
    with pytest.raises(GridMismatchError):
        polygonise(labels, spec_of(np.zeros((2, 2))), 3)


def test_rasterise_takes_the_cells_whose_centre_is_inside():
    """Half-covered cells count by their centre, and the later geometry wins."""
    spec = GridSpec((2, 4), Affine(1, 0, 0, 0, -1, 2), RD)
    first, second = shapely.box(0, 0, 2.4, 1), shapely.box(1.6, 0, 9, 1)
    assert rasterise([first, shapely.Polygon(), second], spec).tolist() == [[0, 0, 0, 0], [1, 1, 3, 3]]
    assert not rasterise([], spec).any()


@pytest.mark.long
def test_many_polygons_take_seconds():
    """A hundred thousand polygons of 16 million cells are traced at a usable speed."""
    rows, cols = np.arange(4000)[:, None] // 13, np.arange(4000)[None] // 13
    labels = (rows * 308 + cols + 1).astype(np.int32)
    start = time.perf_counter()
    polygons = polygonise(labels, spec_of(labels), int(labels.max()))
    assert time.perf_counter() - start < 30
    assert shapely.area(polygons).sum() == labels.size * 0.25


def test_threads_rasterise_one_at_a_time(monkeypatch):
    """Two at once would restore each other's warning filters, and a warning of rasterio would end one of them."""
    spec = lattice((0.0, 0.0, 9.0, 9.0), 1.0, CRS.from_epsg(32633))
    running, most = [], []

    def slow(*_args, **_options):
        running.append(1)
        most.append(len(running))
        time.sleep(0.02)
        running.pop()

    monkeypatch.setattr("rasterio.features.rasterize", slow)
    with ThreadPoolExecutor(4) as pool:
        list(pool.map(lambda _: rasterise([shapely.box(1, 1, 3, 3)], spec), range(8)))
    assert most == [1] * 8


@pytest.mark.parametrize(("cell_m", "beside"), [(0.5, 0.0), (2.0, 1.0), (0.3, 0.07)])
def test_a_window_has_the_cells_of_the_whole_also_on_edges_through_centres(cell_m, beside):
    """Corners lie on a fine raster of cells and half cells, so that many edges meet centres."""
    rng = np.random.default_rng(11)
    spec = GridSpec((90, 400), Affine(cell_m, 0, 389_040 + beside, 0, -cell_m, 5_821_020 - beside), CRS.from_epsg(2154))
    middles = rng.integers(0, (800, 180), (120, 1, 2)) / 2
    corners = (middles + rng.integers(-16, 17, (120, 5, 2)) / 2) * (cell_m, -cell_m)
    corners += (spec.transform.c, spec.transform.f)
    shapes = np.array([shapely.convex_hull(shapely.multipoints(one)) for one in corners])
    shapes = shapes[shapely.area(shapes) > 0]
    shapes[::2] = shapely.reverse(shapes[::2])
    whole = rasterise(shapes, spec)
    for top, left in itertools.product(range(0, 90, 23), range(0, 400, 57)):
        window = slice(top, min(top + 23, 90)), slice(left, min(left + 57, 400))
        assert np.array_equal(rasterise_window(shapes, spec, window), whole[window])
