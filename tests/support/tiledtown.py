"""A small town that four tiles cut: a block of houses over their corner, and workers that fail in ways of their own."""

import os
import signal
from pathlib import Path

from simulated.files import write_points
from simulated.scenes import DATUM_M, Block, Scene, Tree, World, scan

from msbdb.scale.tilework import TileSummary, TileTask, work

TILE_M = 60.0

KILLED = "MSBDB_TEST_KILLED"
"""Names the file that remembers that a worker was killed."""


def town(without: str = "") -> Scene:
    """Return a town of 120 by 120 m with a courtyard over the corner of the tiles, and houses and trees around it.

    The house ``without`` is pulled down.
    """
    blocks = (
        Block("ring", 44, 44, 34, 34, DATUM_M + 12.5, 1, hole=(54, 54, 14, 14)),
        Block("hall", 52, 95, 20, 14, DATUM_M + 9.5, 2, material="gravel"),
        Block("west", 15, 20, 14, 12, DATUM_M + 6.5, 3),
        Block("south", 90, 12, 12, 14, DATUM_M + 6.5, 4, ridge_m=2.5),
        Block("east", 95, 85, 13, 10, DATUM_M + 7.5, 5, turn_deg=20.0),
    )
    trees = tuple(Tree(8.0 + 10 * n, 36.0, 3.5, 9.0 + n % 3, 2.5) for n in range(11))
    blocks = tuple(block for block in blocks if block.name != without)
    return scan(World("town", (120, 120), blocks, trees, origin=(389_040.0, 5_821_020.0)), density=1.0)


def write_town(folder: Path, without: str = "") -> list[Path]:
    """Write the town as two files, a western and an eastern one."""
    folder.mkdir(exist_ok=True)
    points = town(without).points
    west = points.x < 389_090.0
    return [write_points(folder / f"{name}.laz", points.take(own)) for name, own in (("w", west), ("e", ~west))]


def work_once_killed(task: TileTask) -> TileSummary:
    """Build a tile; the first process that begins one is killed on the way, as by a machine without memory."""
    marker = Path(os.environ[KILLED])
    if not marker.exists():
        marker.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return work(task)


def end_at_third(task: TileTask) -> TileSummary:
    """Build two tiles, and end the whole process at the third, as a power cut does."""
    marker = Path(os.environ[KILLED])
    done = int(marker.read_text()) if marker.exists() else 0
    if done == 2:
        os._exit(9)
    marker.write_text(str(done + 1))
    return work(task)
