"""Files appear whole or not at all."""

import pytest

from msbdb.errors import FileError
from msbdb.io.atomic import write_atomic


def test_a_failure_leaves_the_old_file(tmp_path):
    """Whatever was written before the failure is gone."""
    path = tmp_path / "out.txt"
    path.write_text("old")

    def fail_halfway():
        with write_atomic(path) as temporary:
            temporary.write_text("half")
            raise RuntimeError

    with pytest.raises(RuntimeError):
        fail_halfway()
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_all_files_of_a_format_take_their_places(tmp_path):
    """Side files move with the main file."""
    with write_atomic(tmp_path / "out.shp") as temporary:
        temporary.write_text("main")
        temporary.with_suffix(".dbf").write_text("side")
    assert {file.name: file.read_text() for file in tmp_path.iterdir()} == {"out.shp": "main", "out.dbf": "side"}


def test_a_target_that_cannot_be_is_refused(tmp_path):
    """A missing folder, a folder in the way, or nothing written."""
    with pytest.raises(FileError, match="Name a folder"), write_atomic(tmp_path / "none" / "out") as temporary:
        temporary.write_text("x")
    (tmp_path / "taken").mkdir()
    with pytest.raises(FileError, match="another file"), write_atomic(tmp_path / "taken") as temporary:
        temporary.write_text("x")
    with pytest.raises(FileError, match="was not written"), write_atomic(tmp_path / "out"):
        pass
    assert [file.name for file in tmp_path.iterdir()] == ["taken"]
