"""What an office takes out of a database on a server: one committed state, and no password."""

import zipfile
from pathlib import Path

import geopandas as gpd
import pytest
from sqlalchemy import make_url
from support.offices import office, surveyed
from support.towns import EPSG

from msbdb import api
from msbdb.database import open_database, store_build
from msbdb.database.history import shownlayers
from msbdb.errors import PassingNotice


@pytest.mark.postgis
def test_an_export_is_one_committed_state(new_postgis, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A survey that is built again between the reading of buildings and of parts does not mix with them."""
    target = office(new_postgis(), tmp_path)
    read = shownlayers._layer

    def rebuilt_meanwhile(*words: object) -> object:
        if words[1] == "part":
            store_build(target, surveyed("later", version="2", dx=0.5))
        return read(*words)

    monkeypatch.setattr(shownlayers, "_layer", rebuilt_meanwhile)
    with pytest.warns(PassingNotice, match="current inventory"):
        api.export(target, tmp_path / "town.gpkg")
    footprint, part = (gpd.read_file(tmp_path / "town.gpkg", layer=name) for name in ("footprint", "part"))
    assert len(part) == 3
    assert set(part["building_id"]) == set(footprint["building_id"].dropna())
    monkeypatch.undo()
    with pytest.warns(PassingNotice, match="current inventory"):
        api.export(target, tmp_path / "town.gpkg", overwrite=True)
    later = gpd.read_file(tmp_path / "town.gpkg", layer="part")
    assert set(later["part_id"]) != set(part["part_id"])


@pytest.mark.postgis
def test_a_project_names_the_server_and_never_the_password(new_postgis, tmp_path: Path) -> None:
    """QGIS takes the password from pg_pass, or asks for it."""
    target = new_postgis()
    open_database(target, create=True, srid=EPSG).dispose()
    secret = make_url(target).set(password="geheim").render_as_string(hide_password=False)
    api.qgis(secret, tmp_path / "town.qgz")
    with zipfile.ZipFile(tmp_path / "town.qgz") as archive:
        words = archive.read("town.qgs").decode()
    assert "geheim" not in words
    assert f"dbname='{make_url(target).database}'" in words
    assert 'table="public"."footprint" (geometry)' in words
    assert '<provider encoding="UTF-8">postgres</provider>' in words
