"""Files appear whole or not at all, and are recorded by their checksums."""

import hashlib

import pytest

from msbdb.errors import FileError
from msbdb.io.files import describe_source, write_atomic
from msbdb.tables import Source


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
    with pytest.raises(FileError, match="Choose a folder"), write_atomic(tmp_path / "none" / "out") as temporary:
        temporary.write_text("x")
    (tmp_path / "taken").mkdir()
    with pytest.raises(FileError, match="another file"), write_atomic(tmp_path / "taken") as temporary:
        temporary.write_text("x")
    with pytest.raises(FileError, match="was not written"), write_atomic(tmp_path / "out"):
        pass
    assert [file.name for file in tmp_path.iterdir()] == ["taken"]


def test_a_source_is_its_name_role_checksum_and_size(tmp_path):
    """The checksum is that of the whole file, however long."""
    body = bytes(range(256)) * 5000
    (tmp_path / "tile.laz").write_bytes(body)
    expected = Source("tile.laz", "points", hashlib.sha256(body).hexdigest(), len(body))
    assert describe_source(tmp_path / "tile.laz", "points") == expected
    (tmp_path / "empty").write_bytes(b"")
    assert describe_source(str(tmp_path / "empty"), "dsm").bytes == 0


def test_a_source_that_cannot_be_read_is_refused(tmp_path):
    """Missing files and folders."""
    for path in (tmp_path / "none", tmp_path):
        with pytest.raises(FileError, match="cannot be read"):
            describe_source(path, "points")
