"""The work of writing parts grows with their number, also where the ids of sons are smaller than their fathers'."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from simulated.builds import EPSG, big_build
from sqlalchemy import Engine, event

from msbdb.database import copy_database, open_database, write_build
from msbdb.database.admin import copying
from msbdb.kept import KeptRun

STEPS = 1000
"""Instructions of SQLite after which it calls back."""


def sons_first(count: int) -> KeptRun:
    """Return a build of so many buildings, in whose keys each part comes before its father."""
    build = big_build(count)
    for table in ("part", "building"):
        frame = build.frames[table]
        for column in {"part_id", "supid", "root_id", "building_id"} & set(frame):
            ids = frame[column].to_numpy()
            frame[column] = np.where(ids == 0, 0, ids ^ 1)
    parts: pd.DataFrame = build.frames["part"]
    assert (parts["part_id"] < parts["supid"]).sum() == count
    return build


@pytest.fixture
def steps() -> Iterator[list[int]]:
    """Count the instructions of all connections that are opened."""
    counted = [0]

    def step() -> int:
        counted[0] += 1
        return 0

    def watch(connection: Any, _record: object) -> None:
        connection.set_progress_handler(step, STEPS)

    event.listen(Engine, "connect", watch)
    yield counted
    event.remove(Engine, "connect", watch)


def taken(counted: list[int], work: Any) -> int:
    """Return the thousands of instructions that some work takes."""
    before = counted[0]
    work()
    return counted[0] - before


def test_work_grows_with_the_parts(tmp_path: Path, steps: list[int], monkeypatch: pytest.MonkeyPatch) -> None:
    """Four times the parts take about four times the instructions, when written as when copied in batches."""
    monkeypatch.setattr(copying, "BATCH", 500)
    written, copied = [], []
    for count in (1000, 4000):
        build, file = sons_first(count), tmp_path / f"{count}.sqlite"
        engine = open_database(file, create=True, srid=EPSG)
        written.append(taken(steps, lambda e=engine, b=build: write_build(e, b)))
        copied.append(taken(steps, lambda f=file, c=count: copy_database(f, tmp_path / f"{c}_copy.sqlite")))
    assert written[1] < 5 * written[0]
    assert copied[1] < 5 * copied[0]
