"""The CRS policy: stated against found, feet to metres, degrees refused."""

import numpy as np
import pytest
from laspy.vlrs.known import GeoKeyDirectoryVlr
from pyproj import CRS, Transformer

from msbdb.errors import CRSError
from msbdb.io import crs as policy
from msbdb.io.lasheader import header_crs, vertical_unit

OREGON_BOUNDS = (636000.0, 849000.0, 639000.0, 853000.0)
UNKNOWN_DATUM = (
    'PROJCS["epsg:2154",GEOGCS["unknown",DATUM["unnamed",SPHEROID["unnamed",6378137,298.257222101004],'
    'TOWGS84[0,0,0,0,0,0,0]],PRIMEM["Greenwich",0],UNIT["degree",0.0174532925199433]],'
    'PROJECTION["Lambert_Conformal_Conic_2SP"],PARAMETER["latitude_of_origin",46.5],PARAMETER["central_meridian",{}],'
    'PARAMETER["standard_parallel_1",49],PARAMETER["standard_parallel_2",44],PARAMETER["false_easting",700000],'
    'PARAMETER["false_northing",6600000],UNIT["metre",1],AXIS["Easting",EAST],AXIS["Northing",NORTH]]'
)


@pytest.mark.parametrize(
    ("feet", "metres"), [(3089, 3088), (2994, 2993), (2263, 32118), (2232, 26954), (2256, 32100), (6880, 6516)]
)
def test_a_crs_in_feet_has_the_metric_twin_of_the_same_projection(feet, metres):
    """EPSG's twin is found, and scaling alone maps one onto the other to a millimetre."""
    twin = policy.metric_twin(CRS.from_epsg(feet))
    assert twin == CRS.from_epsg(metres)
    source = CRS.from_epsg(feet)
    area = source.area_of_use
    x, y = Transformer.from_crs(source.geodetic_crs, source, always_xy=True).transform(
        area.west + 0.5, area.south + 0.5
    )
    east, north = Transformer.from_crs(source, twin, always_xy=True).transform(x, y)
    factor = source.axis_info[0].unit_conversion_factor
    assert (x * factor, y * factor) == pytest.approx((east, north), abs=1e-3)


def test_a_crs_in_feet_without_a_twin_is_reprojected_to_its_utm_zone():
    """NAD27 / BLM 14N has no metric twin of its own name, so its UTM zone is taken, with a notice."""
    source = CRS.from_epsg(32064)
    how = policy.reference(source, bounds=(1.6e6, 1.0e7, 1.61e6, 1.01e7), where="tile.laz")
    assert how.transformer is not None
    assert "UTM zone 14N" in how.crs.name
    assert any("reprojected" in notice for notice in how.notices)
    east, north, height = how.to_metres(np.array([1.6e6]), np.array([1.0e7]), np.array([100.0]))
    assert how.transformer.transform(1.6e6, 1.0e7) == pytest.approx((east[0], north[0]))
    assert height[0] == pytest.approx(100 * 1200 / 3937)


def mercator_box(longitude, latitude, side_m=500.0):
    """Return a square of Pseudo-Mercator around a place."""
    x, y = Transformer.from_crs(4326, 3857, always_xy=True).transform(longitude, latitude)
    return (x - side_m, y - side_m, x + side_m, y + side_m)


def test_a_web_map_has_no_metres_and_is_reprojected():
    """Pseudo-Mercator stretches lengths by 62 % in Delft: it goes to the UTM zone, to a millimetre, and says so."""
    source = CRS.from_epsg(3857)
    how = policy.reference(source, bounds=mercator_box(4.36, 52.01), where="tile.laz")
    assert how.crs == CRS.from_epsg(32631)
    assert any("62 % off" in notice and "EPSG:32631" in notice for notice in how.notices)
    x, y = Transformer.from_crs(4326, source, always_xy=True).transform(4.36, 52.01)
    east, north, height = how.to_metres(np.array([x]), np.array([y]), np.array([7.0]))
    truth = Transformer.from_crs(4326, 32631, always_xy=True).transform(4.36, 52.01)
    assert (east[0], north[0], height[0]) == pytest.approx((*truth, 7.0), abs=1e-3)


@pytest.mark.parametrize(
    ("epsg", "longitude", "latitude"),
    [(3857, 36.8, -1.3), (2154, -4.5, 48.4), (3035, -9.1, 38.7), (5070, -81.0, 26.0), (3067, 20.0, 60.0)],
)
def test_metres_that_hold_within_a_hundredth_stay(epsg, longitude, latitude):
    """At the edges of countries, in equal-area CRSs of continents, and on a web map at the equator."""
    source = CRS.from_epsg(epsg)
    x, y = Transformer.from_crs(source.geodetic_crs, source, always_xy=True).transform(longitude, latitude)
    how = policy.reference(source, bounds=(x, y, x + 100, y + 100), where="tile.laz")
    assert (how.crs, how.transformer, how.notices) == (source, None, ())


def test_coordinates_beyond_the_area_of_use_are_left_alone():
    """Local coordinates under the name of a CRS are no reason to reproject: the CRS is rather wrong."""
    source = CRS.from_epsg(2154)
    assert policy.stretch(source, -1.36, -5.98) > policy.MOST_STRETCH
    assert policy.reference(source, bounds=(0, 0, 100, 100), where="tile.laz").transformer is None


def test_what_is_reprojected_goes_to_the_target_where_that_fits():
    """A second survey beyond the border of the UTM zone gets the first one's; one of another country does not."""
    zone = CRS.from_epsg(32632)
    beside = policy.reference(CRS.from_epsg(3857), bounds=mercator_box(12.01, 50.0), where="t", target=zone)
    assert beside.crs == zone
    far = policy.reference(CRS.from_epsg(3857), bounds=mercator_box(40.0, 50.0), where="t", target=zone)
    assert far.crs == CRS.from_epsg(32637)
    scaled = policy.reference(CRS.from_epsg(2994), bounds=OREGON_BOUNDS, where="t", target=zone)
    assert scaled.crs == CRS.from_epsg(2993)


@pytest.mark.parametrize(("epsg", "box"), [(2994, OREGON_BOUNDS), (3857, mercator_box(4.36, 52.01, 40_000.0))])
def test_the_box_of_a_file_holds_all_of_it(epsg, box):
    """Sides that become curves lie in it, too, to a metre over 80 km; and the way back."""
    how = policy.reference(CRS.from_epsg(epsg), bounds=box, where="tile.laz")
    share = np.linspace(0, 1, 999)
    x, y = box[0] + share * (box[2] - box[0]), box[1] + share * (box[3] - box[1])
    sides = [(x, np.full_like(x, box[1])), (x, np.full_like(x, box[3]))]
    sides += [(np.full_like(y, box[0]), y), (np.full_like(y, box[2]), y)]
    west, south, east, north = how.box_in_metres(box)
    for side in sides:
        xs, ys, _ = how.to_metres(*side, np.zeros(999))
        assert west - 1 <= xs.min() <= xs.max() <= east + 1
        assert south - 1 <= ys.min() <= ys.max() <= north + 1
    back = how.box_in_units((west, south, east, north))
    assert back[0] <= box[0] + 1
    assert back[1] <= box[1] + 1
    assert back[2] >= box[2] - 1
    assert back[3] >= box[3] - 1


def test_feet_are_scaled_exactly_and_announced():
    """International feet become 0.3048 m in x, y and z, and each conversion is a notice."""
    how = policy.reference(CRS.from_epsg(2994), bounds=OREGON_BOUNDS, where="tile.laz")
    east, north, height = how.to_metres(np.array([1000.0]), np.array([2000.0]), np.array([10.0]))
    assert (east[0], north[0], height[0]) == (1000.0 * 0.3048, 2000.0 * 0.3048, 10.0 * 0.3048)
    assert len(how.notices) == 2


@pytest.mark.parametrize(
    ("text", "z_unit", "hint", "factor"),
    [
        ("EPSG:2154", "auto", None, 1.0),
        ("EPSG:2154", "ft", None, 0.3048),
        ("EPSG:26910", "auto", "us-ft", 1200 / 3937),
        ("EPSG:26910+6360", "auto", "m", 1200 / 3937),
        ("EPSG:2994", "m", None, 1.0),
        ("EPSG:2994+5703", "auto", None, 1.0),
    ],
)
def test_the_unit_of_height_is_stated_then_vertical_then_hinted_then_horizontal(text, z_unit, hint, factor):
    """The first of these that says something decides."""
    crs = CRS.from_user_input(text)
    how = policy.reference(crs, bounds=OREGON_BOUNDS, where="tile.laz", z_unit=z_unit, z_hint=hint)
    assert how.z_factor == pytest.approx(factor, rel=1e-12)


def test_an_unknown_unit_of_height_is_refused():
    """The message lists the units."""
    with pytest.raises(CRSError, match="us-ft"):
        policy.reference(CRS.from_epsg(2154), bounds=OREGON_BOUNDS, where="t", z_unit="yard")


def test_a_compound_crs_is_split_and_its_heights_become_metric():
    """Horizontal and vertical parts are kept; feet of height turn into EPSG's metric vertical CRS."""
    how = policy.reference(CRS.from_user_input("EPSG:2263+6360"), bounds=(1e6, 2e5, 1e6, 2e5), where="tile.laz")
    assert how.crs == CRS.from_epsg(32118)
    assert how.vertical_crs == CRS.from_epsg(5703)


@pytest.mark.parametrize(
    ("epsg", "bounds", "zone"),
    [
        (4326, (3.8, 43.6, 3.9, 43.7), "EPSG:32631"),
        (4269, (-94.69, 31.03, -94.66, 31.04), "EPSG:26915"),
        (4326, (39.0, -83.42, 39.1, -83.41), "EPSG:32617"),
    ],
)
def test_degrees_are_refused_with_the_utm_zone_to_take(epsg, bounds, zone):
    """On the data's own datum where it has zones; swapped axes are seen through."""
    with pytest.raises(CRSError, match=zone):
        policy.reference(CRS.from_epsg(epsg), bounds=bounds, where="tile.laz")


def test_without_any_crs_the_message_names_the_option():
    """A missing CRS is never guessed."""
    with pytest.raises(CRSError, match="--crs"):
        policy.settle(None, None, "tile.laz")


def test_a_local_crs_counts_as_none():
    """Headers that hold a citation alone need the CRS to be stated, and then take it."""
    local = CRS.from_wkt('LOCAL_CS["Lambert-93",UNIT["metre",1],AXIS["E",EAST],AXIS["N",NORTH]]')
    with pytest.raises(CRSError, match="has only 'Lambert-93'"):
        policy.settle(local, None, "tile.laz")
    assert policy.settle(local, 2154, "tile.laz") == CRS.from_epsg(2154)


def test_a_stated_crs_must_not_contradict_the_file():
    """Both names are in the message; the same CRS in other words is no conflict."""
    found = CRS.from_epsg(2154)
    with pytest.raises(CRSError, match=r"EPSG:2154.*EPSG:28992"):
        policy.settle(found, 28992, "tile.laz")
    assert policy.settle(found, found.to_wkt("WKT1_ESRI"), "tile.laz") == found


def test_a_stated_vertical_crs_adds_to_the_files_horizontal_one():
    """What the user knows more is taken; a different vertical CRS is a conflict."""
    settled = policy.settle(CRS.from_epsg(2154), "EPSG:2154+5720", "tile.laz")
    assert policy.split_crs(settled)[1] == CRS.from_epsg(5720)
    with pytest.raises(CRSError, match="correct the file"):
        policy.settle(settled, "EPSG:2154+5773", "tile.laz")


def test_an_unknown_crs_is_an_error_of_ours():
    """The message says how to write one."""
    with pytest.raises(CRSError, match="EPSG code"):
        policy.parse_crs("no such thing")


def test_a_crs_of_unknown_datum_that_names_its_code_is_that_code():
    """Only if its projection is the code's as well."""
    assert policy.canonical(CRS.from_wkt(UNKNOWN_DATUM.format(3))) == CRS.from_epsg(2154)
    other = policy.canonical(CRS.from_wkt(UNKNOWN_DATUM.format(4)))
    assert other.to_epsg() is None


def test_data_far_from_the_area_of_use_are_noticed():
    """Coordinates of Oregon's feet in its metric CRS lie far outside of Oregon."""
    assert policy.misplaced(CRS.from_epsg(2993), OREGON_BOUNDS) is not None
    assert policy.misplaced(CRS.from_epsg(2993), tuple(0.3048 * b for b in OREGON_BOUNDS)) is None
    assert policy.misplaced(CRS.from_epsg(32760), (5e5, 5.5e6, 5.1e5, 5.6e6)) is None
    assert policy.misplaced(CRS.from_epsg(3857), mercator_box(4.36, 52.01)) is None
    assert policy.misplaced(CRS.from_epsg(3857), mercator_box(-179.0, -89.0)) is not None


def _directory(*keys):
    """Return the body of a GeoTIFF key directory."""
    return np.array([(1, 1, 0, len(keys)), *keys], dtype="<u2").tobytes()


def test_geotiff_keys_are_read():
    """A projected code, also among padding; user-defined parameters; and the vertical unit."""
    assert header_crs({34735: _directory((3072, 0, 1, 32617), (0, 0, 0, 0))}).to_epsg() == 32617
    assert vertical_unit({34735: _directory((3072, 0, 1, 32617), (4099, 0, 1, 9003))}) == "us-ft"
    keys = [(1024, 0, 1, 1), (2048, 0, 1, 4326), (3072, 0, 1, 32767), (3074, 0, 1, 32767), (3075, 0, 1, 1)]
    keys += [(3076, 0, 1, 9001)]
    keys += [(key, 34736, 1, i) for i, key in enumerate((3080, 3081, 3082, 3083, 3092))]
    doubles = np.array([9.0, 0.0, 500000.0, 0.0, 0.9996]).tobytes()
    found = header_crs({34735: _directory(*keys), 34736: doubles})
    assert policy.same_projection(found, CRS.from_epsg(32632))
    by_laspy = GeoKeyDirectoryVlr()
    by_laspy.parse_record_data(_directory(*keys))
    assert by_laspy.parse_crs() == CRS.from_epsg(4326)  # The base alone: the reason for asking GDAL.
    named = header_crs({34735: _directory((1026, 34737, 11, 0), (3076, 0, 1, 9001)), 34737: b"Lambert-93|\0"})
    assert (named.name, named.is_engineering) == ("Lambert-93", True)
    both = header_crs({34735: _directory((1024, 0, 1, 1), (3072, 0, 1, 2154), (4096, 0, 1, 5720))})
    assert policy.split_crs(both)[1] == CRS.from_epsg(5720)


def test_the_wkt_wins_over_the_keys_unless_it_is_broken():
    """LAS 1.4 puts the WKT first; an empty or torn one leaves the keys."""
    keys = _directory((3072, 0, 1, 2154))
    wkt = CRS.from_epsg(28992).to_wkt().encode()
    assert header_crs({34735: keys, 2112: wkt + b"\0"}).to_epsg() == 28992
    assert header_crs({34735: keys, 2112: b"\0"}).to_epsg() == 2154
    assert header_crs({34735: keys, 2112: wkt[:100]}).to_epsg() == 2154
    assert header_crs({}) is None


@pytest.mark.parametrize("body", [b"", b"\x01", b"\0" * 8, b"\xff" * 64, _directory((3072, 34736, 9, 60000))])
def test_broken_keys_are_no_crs(body):
    """Damage in the directory is neither an exception nor a CRS that can be used."""
    found = header_crs({34735: body})
    assert found is None or found.is_engineering
