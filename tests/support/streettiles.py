"""Tiles of a street that a process brings into a database, one after another.

A process that is started anew imports this module. It could not import a test's own, as pygeoapi installs a package of
the name ``tests``.
"""

from multiprocessing.synchronize import Event

from msbdb.api import advance
from msbdb.database import store_build
from msbdb.kept import KeptRun
from support.towns import ROW, town_build


def tile(number: int, year: int = 2020, *, grown: float = 5.0) -> KeptRun:
    """Return a survey of one tile of a street, each of two houses; one grew in the later year, by so many metres."""
    houses = ROW[2 * number : 2 * number + 2]
    if year > 2020:
        west, south, east, north, height = houses[0]
        houses = [(west, south, east, north, height + grown), *houses[1:]]
    return town_build(f"t{number}_{year}", str(year), houses, bounds=(40 * number, 0, 40 * number + 40, 40))


def bring(target: str, numbers: tuple[int, ...]) -> None:
    """Build tiles and update the inventory by them, survey after survey, as one process does."""
    for year in (2020, 2021):
        for number in numbers:
            store_build(target, tile(number, year), timeout_s=60)
            advance(target, f"t{number}_{year}")


def bring_when(target: str, numbers: tuple[int, ...], begun: Event) -> None:
    """Tell that this process has its libraries loaded, and bring tiles."""
    begun.set()
    bring(target, numbers)
