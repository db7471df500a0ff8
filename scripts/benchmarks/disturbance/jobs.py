"""The commands that are disturbed, on two surveys of a small town."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from simulated.files import write_points
from simulated.scenes import SCENES, scan

from msbdb import api
from msbdb.database import copy_database, open_database
from msbdb.database.history.entries import write_state
from msbdb.database.history.periods import footprint_at
from msbdb.params import Params, with_values

Progress = Callable[[str, int, int], None]
Step = Callable[[str, Progress], object]

EXTRACT = ("multiscale", "flatregions", "adaptive")


@dataclass(frozen=True)
class Job:
    """A command, the kept database that it starts from, and its steps, each of which commits by itself."""

    name: str
    start: str | None
    whole: Step
    steps: tuple[Step, ...]
    once: bool = False
    """Whether a repeat after its end is refused, and changes nothing."""


class Town:
    """Two surveys of a small town, between which a hall grew and a house moved, and the commands on them."""

    def __init__(self, folder: Path, density: float) -> None:
        first = SCENES["city"](density=density)
        blocks = {block.name: block for block in first.world.blocks}
        blocks["hall"] = replace(blocks["hall"], level_m=blocks["hall"].level_m + 6)
        blocks["villa 1"] = replace(blocks["villa 1"], west=30, south=110)
        later = scan(replace(first.world, blocks=tuple(blocks.values())), seed=2, density=density)
        self.tiles = [write_points(folder / f"epoch_{n}.las", scene.points) for n, scene in enumerate((first, later))]

    def build(self, survey: str, epoch: int, storey_m: float = 3.0) -> Step:
        """Return a build of an epoch."""
        return lambda target, progress: api.build(
            [self.tiles[epoch]], db=target, progress=progress, **self._options(survey, epoch, storey_m)
        )

    def update(self, survey: str, epoch: int, storey_m: float = 3.0) -> Step:
        """Return an update by an epoch."""
        return lambda target, progress: api.update(
            [self.tiles[epoch]], db=target, progress=progress, **self._options(survey, epoch, storey_m)
        )

    def _options(self, survey: str, epoch: int, storey_m: float) -> dict:
        params = with_values(Params(), {"surface": {"storey_m": storey_m}})
        return {"survey": survey, "date": f"{2015 + 5 * epoch}", "params": params, "extract": EXTRACT}


def _advance(survey: str) -> Step:
    def step(target: str, progress: Progress) -> None:
        api.advance(target, survey)

    return step


def _copy(source: str) -> Step:
    def step(target: str, progress: Progress) -> None:
        progress("copy", 0, 1)
        copy_database(source, target)
        progress("copy", 1, 1)

    return step


def _applied(target: str, progress: Progress) -> None:
    """Begin the inventory, and have an operator decide on a building."""
    api.advance(target, "older")
    engine = open_database(target)
    uid = int(footprint_at(engine, "2016")["uid"].min())
    write_state(engine, uid, "refuted", operator="ann", note="a tent", decided_at="2016-01-01T00:00:00Z")


def starts_of(town: Town) -> dict[str, tuple[str | None, Step]]:
    """Return the databases that jobs start from, each with the one that it is made from, and how."""
    return {
        "older": (None, town.build("older", 0)),
        "same": (None, town.build("city", 0, 2.7)),
        "applied": ("older", _applied),
        "updated": ("applied", town.update("newer", 1, 2.7)),
    }


def jobs_of(town: Town, source: str) -> tuple[Job, ...]:
    """Return the jobs; ``source`` is the database that is copied."""
    build, copy = town.build("city", 0), _copy(source)
    update, steps = town.update("newer", 1), (town.build("newer", 1), _advance("newer"))
    return (
        Job("build on nothing", None, build, (build,)),
        Job("update", "applied", update, steps),
        Job("copy", None, copy, (copy,), once=True),
        Job("build beside another survey", "older", build, (build,)),
        Job("update again", "updated", update, steps),
        Job("copy into empty", "empty", copy, (copy,), once=True),
        Job("build in place of another", "same", build, (build,)),
    )
