"""docs/inventory.md tells the truth: its commands run in order, and its SQL finds what they made."""

import re
import shlex
from dataclasses import replace
from pathlib import Path

import geopandas as gpd
import pytest
from click.testing import CliRunner
from shapely import Point, box
from simulated import scenes
from simulated.files import write_points
from sqlalchemy import text

from msbdb.cli.main import cli
from msbdb.database import footprint_at, open_database

PAGE = Path(__file__).resolve().parents[2] / "docs" / "inventory.md"


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a folder with the files that the page names."""
    cloud = replace(scenes.podium_tower().points, colours=None, colour_names=())
    for name in ("spring2020", "spring2024"):
        write_points(tmp_path / f"{name}.laz", cloud)
    east, north = float(cloud.x.mean()), float(cloud.y.mean())
    crs = cloud.crs
    house = box(cloud.x.min() + 1, cloud.y.min() + 1, cloud.x.min() + 3, cloud.y.min() + 3)
    gpd.GeoDataFrame({"number": [7], "HGT": [3.5]}, geometry=[house], crs=crs).to_file(tmp_path / "cadastre.gpkg")
    gpd.GeoDataFrame({"MATERIAL": ["metal"]}, geometry=[Point(east, north)], crs=crs).to_file(tmp_path / "roofs.gpkg")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_the_page_runs_from_top_to_bottom(folder: Path) -> None:
    """Every command ends well, and the SQL finds buildings."""
    page = PAGE.read_text(encoding="utf-8")
    lines = [line for block in re.findall(r"```sh\n(.*?)```", page, flags=re.DOTALL) for line in block.splitlines()]
    assert len(lines) >= 7
    for line in lines:
        words = shlex.split(line)[1:]
        if "UID" in words:
            uid = footprint_at(open_database("town.sqlite"), "2024-05-02")["uid"].min()
            words[words.index("UID")] = str(uid)
        if words[0] in ("update", "measure"):
            words += ["--extract", "multiscale"]
        done = CliRunner().invoke(cli, words)
        assert done.exit_code == 0, f"{line}: {done.output}"
    [statement] = re.findall(r"```sql\n(.*?);?\n```", page, flags=re.DOTALL)
    with open_database("town.sqlite").connect() as connection:
        assert connection.execute(text(statement.rstrip(";"))).all()
