"""The database of an office: an imported cadastre, two surveys side by side, and a later one of the first place."""

from pathlib import Path

from click.testing import CliRunner

from msbdb import api
from msbdb.cli.main import cli
from msbdb.database import open_database, store_build
from msbdb.kept import KeptRun
from support.towns import EPSG, House, footprints, town_build

HERE: list[House] = [(8, 8, 20, 20, 6), (24, 8, 36, 20, 12)]
THERE: list[House] = [(68, 8, 80, 20, 7)]
LATER: list[House] = [(8, 8, 20, 20, 6), (8, 24, 20, 36, 9)]
OLD: list[House] = [(100, 8, 112, 20, 5)]
"""The second house is demolished and another is new in the later survey; the last is in the cadastre alone."""

PLACES = {
    "here": ("2020-04-01", HERE, (0, 0, 40, 40)),
    "there": ("2021-05-01", THERE, (60, 0, 100, 40)),
    "later": ("2022-06-01", LATER, (0, 0, 40, 40)),
}
"""The date, houses and extent of each survey."""


def surveyed(name: str, version: str = "1", dx: float = 0.0) -> KeptRun:
    """Return the build of a survey, its houses moved to the east by some metres."""
    date, houses, bounds = PLACES[name]
    return town_build(name, date, houses, bounds=bounds, version=version, shift=dx)


def office(target: str, folder: Path) -> str:
    """Make the database of an office, and return where it is."""
    open_database(target, create=True, srid=EPSG).dispose()
    footprints([*HERE, *OLD]).to_file(folder / "cadastre.gpkg")
    api.import_inventory(target, folder / "cadastre.gpkg", date="2015-01-01")
    for name in PLACES:
        store_build(target, surveyed(name))
        api.advance(target, name)
    return target


def run(*words: object, code: int = 0) -> str:
    """Run a command and return all that it printed, as one line."""
    done = CliRunner().invoke(cli, [str(word) for word in words])
    assert done.exit_code == code, done.output
    return " ".join(done.output.split())
