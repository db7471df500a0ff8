"""The evaluation of a database against files."""

import geopandas as gpd
import pytest
from simulated.files import write_points
from simulated.scenes import SCENES

import msbdb
from msbdb.errors import InputError


@pytest.fixture(scope="module")
def town(tmp_path_factory):
    """Build the scene of a podium with a tower, and return its database with the true outlines."""
    folder = tmp_path_factory.mktemp("town")
    scene = SCENES["podium_tower"]()
    source = folder / "town.laz"
    write_points(source, scene.points)
    msbdb.build([source], db=folder / "town.sqlite")
    with msbdb.open(folder / "town.sqlite") as opened:
        buildings = opened.buildings()
    return folder, buildings


def test_heights_are_compared_where_the_reference_states_them(town):
    """A column called height, in any case, is found; another one must be named; an RMSE of an offset is the offset."""
    folder, buildings = town
    truth = buildings[["geometry", "h_p90"]].assign(HEIGHT=lambda b: b["h_p90"] - 1.5, tall=lambda b: b["h_p90"] + 2.0)
    gpd.GeoDataFrame(truth, crs=buildings.crs).to_file(folder / "truth.gpkg")
    with msbdb.open(folder / "town.sqlite") as opened:
        found = opened.evaluate(folder / "truth.gpkg")
        named = opened.evaluate(folder / "truth.gpkg", height="tall")
    assert found.area.rates.quality > 0.99
    assert found.heights.rmse_m == pytest.approx(1.5, abs=1e-6)
    assert named.heights.rmse_m == pytest.approx(2.0, abs=1e-6)


def test_a_reference_without_heights_has_no_height_score(town):
    """No column of heights: no figure is made up."""
    folder, buildings = town
    buildings[["geometry"]].to_file(folder / "flat.gpkg")
    with msbdb.open(folder / "town.sqlite") as opened:
        assert opened.evaluate(folder / "flat.gpkg").heights is None


def test_a_reference_of_another_place_is_refused(town):
    """The message names the file and the survey, instead of scoring nothing."""
    folder, buildings = town
    buildings[["geometry"]].translate(50_000, 0).to_frame("geometry").to_file(folder / "away.gpkg")
    with msbdb.open(folder / "town.sqlite") as opened, pytest.raises(InputError, match=r"away.gpkg .* survey 'town'"):
        opened.evaluate(folder / "away.gpkg")
