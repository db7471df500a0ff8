"""Rasters: heights with their nodata and units, alignment, image bands, and writing."""

import os
import warnings
from pathlib import Path

import numpy as np
import pytest
import rasterio
from affine import Affine
from pyproj import CRS, Transformer
from rasterio.enums import ColorInterp
from support.notices import with_notices

from msbdb.errors import CRSError, FileError, GridMismatchError, InputError, MsbdbWarning, NodataError
from msbdb.grid import Grid, GridSpec, lattice
from msbdb.io.las import read_points
from msbdb.io.ortho import read_bands
from msbdb.io.raster import align_grid, read_grid

LAMBERT = CRS.from_epsg(2154)
NORTH_UP = Affine(1.0, 0.0, 700000.0, 0.0, -1.0, 6600010.0)
SPEC = GridSpec((10, 12), NORTH_UP, LAMBERT)


def write(path, values, *, transform=NORTH_UP, crs=LAMBERT, descriptions=(), colours=None, units=None, **profile):
    """Write a raster of (B, H, W) values, and return its path."""
    values = np.atleast_3d(values) if values.ndim == 3 else values[np.newaxis]
    count, rows, cols = values.shape
    profile |= {} if crs is None else {"crs": crs.to_wkt()}
    with rasterio.open(
        path,
        "w",
        driver="GTiff",
        height=rows,
        width=cols,
        count=count,
        dtype=values.dtype,
        transform=transform,
        **profile,
    ) as dataset:
        dataset.write(values)
        for i, text in enumerate(descriptions, start=1):
            dataset.set_band_description(i, text)
        if units:
            dataset.units = (units,)
        if colours:
            dataset.colorinterp = colours
    return path


def slope(dtype=np.float32):
    """Return heights that rise by row and column."""
    return (np.arange(10)[:, None] * 2 + np.arange(12)[None, :] + 5).astype(dtype)


def test_heights_are_read_with_their_lattice(tmp_path):
    """Values, validity and position are the file's."""
    grid = read_grid(write(tmp_path / "dsm.tif", slope()))
    np.testing.assert_array_equal(grid.values, slope())
    assert grid.values.dtype == np.float32
    assert grid.valid.all()
    assert grid.spec.same_lattice(SPEC)


@pytest.mark.parametrize("dtype", [np.int16, np.uint8, np.float64])
def test_heights_of_other_types_become_float32(tmp_path, dtype):
    """Whole numbers are heights too."""
    grid = read_grid(write(tmp_path / "dsm.tif", slope(dtype)))
    np.testing.assert_array_equal(grid.values, slope())


@pytest.mark.parametrize("hole", [-9999.0, -32768.0, np.float32(-3.4028234663852886e38), np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("tagged", [False, True])
def test_every_stand_in_for_no_value_is_invalid(tmp_path, hole, tagged):
    """Tagged or not; below the mask the value is 0."""
    values = slope()
    values[3, 4] = hole
    grid = read_grid(write(tmp_path / "dsm.tif", values, **({"nodata": float(hole)} if tagged else {})))
    assert not grid.valid[3, 4]
    assert grid.values[3, 4] == 0
    assert grid.valid.sum() == grid.valid.size - 1


def test_a_nodata_tag_of_an_ordinary_value_is_honoured(tmp_path):
    """Zero may be tagged as nodata; untagged it is a height."""
    values = slope()
    values[0, 0] = 0
    assert not read_grid(write(tmp_path / "a.tif", values, nodata=0)).valid[0, 0]
    assert read_grid(write(tmp_path / "b.tif", values)).valid[0, 0]


def test_feet_are_converted_to_the_metric_twin(tmp_path):
    """Lattice and heights are scaled, with warnings; without a twin the next step is told."""
    feet = Affine(3.0, 0.0, 636000.0, 0.0, -3.0, 850000.0)
    path = write(tmp_path / "dsm.tif", slope(), transform=feet, crs=CRS.from_epsg(2994))
    with pytest.warns(MsbdbWarning) as notices:
        grid = read_grid(path)
    assert len(notices) == 2
    assert grid.spec.crs == CRS.from_epsg(2993)
    assert grid.spec.cell_m == pytest.approx(3 * 0.3048)
    assert grid.spec.bounds[0] == pytest.approx(636000 * 0.3048)
    np.testing.assert_allclose(grid.values, slope() * 0.3048, rtol=1e-6)
    other = write(tmp_path / "b.tif", slope(), transform=Affine(3, 0, 1.6e6, 0, -3, 1e7), crs=CRS.from_epsg(32064))
    with pytest.raises(CRSError, match="gdalwarp -t_srs EPSG:"):
        read_grid(other)


def test_heights_on_a_web_map_are_refused(tmp_path):
    """Their cells are 62 % too wide in Delft; the command that warps them names the UTM zone."""
    web = Affine(1.0, 0, 485_400.0, 0, -1.0, 6_801_200.0)
    path = write(tmp_path / "dsm.tif", slope(), transform=web, crs=CRS.from_epsg(3857))
    with pytest.raises(CRSError, match=r"Pseudo-Mercator.*gdalwarp -t_srs EPSG:32631 -r bilinear dsm.tif"):
        read_grid(path)


def test_a_terrain_on_a_web_map_is_resampled(tmp_path):
    """It comes onto the lattice of others in any case: a plane that rises eastwards keeps its heights."""
    web = CRS.from_epsg(3857)
    plane = np.broadcast_to(np.arange(60, dtype=np.float32), (50, 60))
    path = write(tmp_path / "dtm.tif", plane, transform=Affine(5.0, 0, 485_400.0, 0, -5.0, 6_801_200.0), crs=web)
    east, north = Transformer.from_crs(web, 32631, always_xy=True).transform(485_550.0, 6_801_075.0)
    onto = lattice((east, north, east + 20, north + 20), 1.0, CRS.from_epsg(32631))
    grid = align_grid(read_grid(path, role="DTM", over=onto), onto)
    x, y = onto.xy(np.arange(21), np.arange(21))
    there = Transformer.from_crs(32631, web, always_xy=True).transform(x, y)[0]
    np.testing.assert_allclose(np.diagonal(grid.values), (there - 485_400.0) / 5 - 0.5, atol=0.05)


def test_a_band_in_feet_on_a_metric_lattice_is_scaled(tmp_path):
    """The band's unit tag is believed; a stated unit goes before it."""
    path = write(tmp_path / "dsm.tif", slope(), units="US survey foot")
    with pytest.warns(MsbdbWarning, match="multiplied"):
        np.testing.assert_allclose(read_grid(path).values, slope() * 1200 / 3937, rtol=1e-6)
    np.testing.assert_array_equal(read_grid(path, z_unit="m").values, slope())


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        ({"transform": Affine(1.0, 0.2, 7e5, 0.2, -1.0, 6.6e6)}, InputError, "rotated"),
        ({"transform": Affine(1.0, 0.0, 7e5, 0.0, 1.0, 6.6e6)}, InputError, "north-up"),
        ({"transform": Affine(1.0, 0.0, 7e5, 0.0, -1.1, 6.6e6)}, InputError, "must be square"),
        ({"transform": Affine(1e-5, 0, 3, 0, -1e-5, 45), "crs": CRS.from_epsg(4326)}, CRSError, "UTM zone 31N"),
        ({"crs": None}, CRSError, "--crs"),
        ({"nodata": 1.0, "values": np.ones((4, 4), dtype=np.float32)}, NodataError, "no valid cell"),
        ({"values": np.ones((2, 4, 4), dtype=np.float32)}, InputError, "2 bands"),
    ],
)
def test_unsuitable_heights_are_refused(tmp_path, change, error, message):
    """Each with its reason."""
    with pytest.raises(error, match=message):
        read_grid(write(tmp_path / "dsm.tif", **({"values": slope()} | change)))


def test_files_that_are_no_rasters_are_refused(tmp_path):
    """Missing, empty, text and torn files alike."""
    with pytest.raises(FileError, match="does not exist"):
        read_grid(tmp_path / "none.tif")
    (tmp_path / "text.tif").write_text("no raster")
    with pytest.raises(FileError, match="cannot be read"):
        read_grid(tmp_path / "text.tif")
    noise = np.random.default_rng(1).random((300, 300)).astype(np.float32)
    path = write(tmp_path / "torn.tif", noise)
    path.write_bytes(path.read_bytes()[:100_000])
    with pytest.raises(FileError, match="cannot be read"):
        read_grid(path)


def test_a_grid_on_the_lattice_is_returned_as_it_is():
    """Nothing is resampled without need."""
    grid = Grid(slope(), np.ones((10, 12), dtype=bool), SPEC)
    assert align_grid(grid, SPEC) is grid


def test_heights_are_aligned_bilinearly_and_holes_stay():
    """A plane survives resampling inside; cells that only a hole covers stay invalid."""
    coarse = GridSpec((10, 12), Affine(2.0, 0.0, 699995.0, 0.0, -2.0, 6600015.0), LAMBERT)
    rows, cols = np.mgrid[0:10, 0:12]
    east, north = coarse.xy(rows, cols)
    plane = ((east - 700000) * 0.5 + (north - 6600000) * 0.25).astype(np.float32)
    valid = np.ones(coarse.shape, dtype=bool)
    valid[4:7, 4:7] = False
    with pytest.warns(MsbdbWarning, match="without a value"):
        aligned = align_grid(Grid(np.where(valid, plane, 0), valid, coarse), SPEC)
    rows, cols = np.mgrid[0:10, 0:12]
    east, north = SPEC.xy(rows, cols)
    expected = (east - 700000) * 0.5 + (north - 6600000) * 0.25
    hole = (east > 700002) & (east < 700010) & (north < 6600008) & (north > 6600000)
    np.testing.assert_allclose(aligned.values[~hole], expected[~hole], atol=1e-3)
    inner = (east > 700004) & (east < 700008) & (north < 6600006) & (north > 6600002)
    assert inner.any()
    assert not aligned.valid[inner].any()
    assert (aligned.values[~aligned.valid] == 0).all()


def test_grids_apart_are_refused():
    """The message gives both extents."""
    far = GridSpec((10, 12), NORTH_UP @ Affine.translation(1000, 0), LAMBERT)
    with pytest.raises(GridMismatchError, match="same place"):
        align_grid(Grid(slope(), np.ones((10, 12), dtype=bool), far), SPEC)


def image(*levels, side=100):
    """Return (B, side, side) uint8 bands of constant levels."""
    return np.stack([np.full((side, side), level, dtype=np.uint8) for level in levels])


FINE = Affine(0.2, 0.0, 699998.0, 0.0, -0.2, 6600012.0)


def test_bands_are_averaged_onto_the_lattice(tmp_path):
    """A cell is the mean of the pixels in it (V20), and is valid only where the image covers it."""
    pixels = np.zeros((1, 50, 50), dtype=np.uint8)
    pixels[0, :, ::5] = 100
    bands = read_bands(write(tmp_path / "red.tif", pixels, transform=FINE), SPEC)
    assert bands.names == ("red",)
    assert bands.valid[:8, :8].all()
    assert not bands.valid[:, 8:].any()
    assert not bands.valid[8:].any()
    np.testing.assert_allclose(bands.values[0, :8, :8], 20.0, atol=1e-4)
    assert (bands.values[:, ~bands.valid] == 0).all()


def test_tiles_and_colours_are_put_together(tmp_path):
    """Two patches of RGB and of IRC give four bands; the file's name tells the false colours, not its tags."""
    right = FINE @ Affine.translation(50, 0)
    rgb = (ColorInterp.red, ColorInterp.green, ColorInterp.blue)
    paths = [
        write(tmp_path / "ortho_rgb_0.tif", image(10, 20, 30, side=50), transform=FINE, colours=rgb),
        write(tmp_path / "ortho_rgb_1.tif", image(11, 21, 31, side=50), transform=right, colours=rgb),
        write(tmp_path / "ortho_irc_0.tif", image(90, 10, 20, side=50), transform=FINE, colours=rgb),
        write(tmp_path / "ortho_irc_1.tif", image(91, 11, 21, side=50), transform=right, colours=rgb),
    ]
    bands = read_bands(paths, SPEC)
    assert bands.names == ("red", "green", "blue", "nir")
    np.testing.assert_allclose(bands.values[:, 4, 2], [10, 20, 30, 90])
    np.testing.assert_allclose(bands.values[:, 4, 11], [11, 21, 31, 91])
    again = read_bands(paths[::-1], SPEC)
    np.testing.assert_array_equal(again.values, bands.values)
    np.testing.assert_array_equal(again.valid, bands.valid)


@pytest.mark.parametrize(
    ("name", "count", "options", "expected"),
    [
        ("scene.tif", 3, {"descriptions": ["NIR", "Red", "Green"]}, ("red", "green", "nir")),
        ("city_cir_2020.tif", 3, {}, ("red", "green", "nir")),
        ("scene.tif", 4, {"photometric": "RGB", "alpha": "YES"}, ("red", "green", "blue")),
        ("scene.tif", 4, {"photometric": "RGB", "alpha": "NO"}, ("red", "green", "blue", "nir")),
        (
            "scene.tif",
            4,
            {"alpha": "YES", "descriptions": ["Red", "Green", "Blue", "NIR"]},
            ("red", "green", "blue", "nir"),
        ),
        ("rgbn.tif", 4, {}, ("red", "green", "blue", "nir")),
        ("B08.tif", 1, {}, ("B08",)),
        ("scene.tif", 2, {}, ("band_1", "band_2")),
    ],
)
def test_band_names_come_from_what_the_file_says(tmp_path, name, count, options, expected):
    """Descriptions, then words in the file's name, then colours, then the position; unnamed alpha is no band."""
    bands = read_bands(write(tmp_path / name, image(*range(1, count + 1)), transform=FINE, **options), SPEC)
    assert bands.names == expected


def test_stated_band_names_win(tmp_path):
    """They must fit the number of bands."""
    path = write(tmp_path / "rgb.tif", image(1, 2, 3), transform=FINE)
    bands = read_bands(path, SPEC, band_names=["nir", "red", "green"])
    np.testing.assert_allclose(bands.band("nir")[5, 5], 1)
    assert bands.band("blue") is None
    with pytest.raises(InputError, match="2 names"):
        read_bands(path, SPEC, band_names=["nir", "red"])


def test_an_infrared_band_called_alpha_is_no_mask(tmp_path):
    """GDAL's default for a fourth band hides nothing where the file's name says that it is infrared."""
    path = write(tmp_path / "ortho_rgbn.tif", image(1, 2, 3, 0), transform=FINE, photometric="RGB", alpha="YES")
    bands = read_bands(path, SPEC)
    assert bands.valid.all()
    np.testing.assert_allclose(bands.band("nir"), 0)


def test_a_pixel_is_missing_only_if_all_its_bands_are(tmp_path):
    """A value equal to nodata in one band of three stays; in all of them it goes."""
    pixels = image(255, 7, 7)
    pixels[:, :50, :] = 255
    bands = read_bands(write(tmp_path / "rgb.tif", pixels, transform=FINE, nodata=255), SPEC)
    assert not bands.valid[:7].any()
    assert bands.valid[9:].all()
    np.testing.assert_allclose(bands.band("red")[9:], 255)


def test_images_in_another_crs_are_reprojected(tmp_path):
    """A UTM image of a level lies where it belongs; one far away is refused with both extents."""
    from rasterio.warp import transform as project

    (east,), (north,) = project(LAMBERT.to_wkt(), "EPSG:32631", [700000.0], [6600010.0])
    utm = Affine(0.5, 0.0, east - 20, 0.0, -0.5, north + 20)
    bands = read_bands(write(tmp_path / "red.tif", image(77), transform=utm, crs=CRS.from_epsg(32631)), SPEC)
    assert bands.valid.all()
    np.testing.assert_allclose(bands.values, 77)
    far = write(tmp_path / "far.tif", image(77), transform=FINE @ Affine.translation(1000, 0))
    with pytest.raises(GridMismatchError, match=r"far\.tif"):
        read_bands(far, SPEC)


def test_an_image_coarser_than_the_lattice_is_interpolated(tmp_path):
    """A ramp of 4 m pixels stays a ramp on 1 m cells."""
    ramp = np.tile(np.arange(20, dtype=np.float32), (20, 1))
    coarse = Affine(4.0, 0.0, 699980.0, 0.0, -4.0, 6600040.0)
    bands = read_bands(write(tmp_path / "nir.tif", ramp, transform=coarse), SPEC)
    np.testing.assert_allclose(np.diff(bands.values[0], axis=1), 0.25, atol=1e-5)


def test_an_image_without_crs_needs_one(tmp_path):
    """It is not taken for the lattice's in silence."""
    path = write(tmp_path / "red.tif", image(5), transform=FINE, crs=None)
    with pytest.raises(CRSError, match="--crs"):
        read_bands(path, SPEC)
    assert read_bands(path, SPEC, crs=2154).valid.all()


@pytest.mark.data
@pytest.mark.skipif("MSBDB_DATA" not in os.environ, reason="MSBDB_DATA is not set")
@pytest.mark.parametrize(
    ("tile", "points", "patterns", "area_m2"),
    [("montpellier", "points.laz", "ortho_*.tif", 2500), ("beziers", "points_left.laz", "ortho_*.tif", 4900)],
)
def test_real_orthos_lie_on_their_points(tile, points, patterns, area_m2):
    """Four bands cover the part that the orthos show, whatever their datum is called; trees are greener than roofs."""
    folder = Path(os.environ["MSBDB_DATA"], tile)
    cloud, _ = with_notices(read_points, folder / points)
    spec = GridSpec((220, 320), Affine(0.5, 0, cloud.bounds[0], 0, -0.5, cloud.bounds[3]), cloud.crs)
    bands = read_bands(sorted(folder.glob(patterns)), spec)
    assert bands.names == ("red", "green", "blue", "nir")
    assert bands.valid.sum() * spec.cell_area_m2 >= area_m2
    row, col = spec.rowcol(cloud.x, cloud.y)
    inside = (row >= 0) & (row < 220) & (col >= 0) & (col < 320) & cloud.first_echo
    inside[inside] = bands.valid[row[inside], col[inside]]
    red, nir = bands.band("red"), bands.band("nir")
    index = ((nir - red) / np.maximum(nir + red, 1))[row[inside], col[inside]]
    roofs = index[cloud.classification[inside] == 6].mean()
    assert np.percentile(index, 95) > roofs + 0.1


@pytest.mark.data
@pytest.mark.skipif("MSBDB_DATA" not in os.environ, reason="MSBDB_DATA is not set")
@pytest.mark.parametrize("tile", ["alexandria", "goteborg"])
def test_real_height_rasters_read(tile):
    """The DTM lies on the DSM's lattice and below it."""
    folder = Path(os.environ["MSBDB_DATA"], tile)
    dsm, dtm = read_grid(folder / "dsm.tif"), read_grid(folder / "dtm.tif", role="DTM")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert align_grid(dtm, dsm.spec) is dtm
    both = dsm.valid & dtm.valid
    assert both.mean() > 0.99
    assert np.percentile((dsm.values - dtm.values)[both], 5) > -1.0


@pytest.mark.parametrize(("cell_m", "epsg"), [(0.2, 2154), (0.7, 2154), (3.0, 2154), (1.0, 32631)])
def test_the_part_around_a_lattice_is_enough(tmp_path, cell_m, epsg):
    """Moved onto the lattice, it gives what the whole raster gives, from much finer cells as from larger ones."""
    rows, cols = 400, 300
    values = np.random.default_rng(5).normal(50, 3, (rows, cols)).astype(np.float32)
    crs, onto = CRS.from_epsg(epsg), GridSpec((20, 24), NORTH_UP, LAMBERT)
    west, south, east, north = rasterio.warp.transform_bounds(LAMBERT.to_wkt(), crs.to_wkt(), *onto.bounds)
    left, top = (west + east - cols * cell_m) / 2, (south + north + rows * cell_m) / 2
    path = write(tmp_path / "dtm.tif", values, transform=Affine(cell_m, 0, left, 0, -cell_m, top), crs=crs)
    part = read_grid(path, over=onto)
    assert np.asarray(part.values).size < values.size / 3
    whole, some = (align_grid(grid, onto) for grid in (read_grid(path), part))
    np.testing.assert_array_equal(some.values, whole.values)
    np.testing.assert_array_equal(some.valid, whole.valid)
