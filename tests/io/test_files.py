"""Files appear whole or not at all, and are recorded by their checksums."""

import hashlib
from pathlib import Path

import pytest

from msbdb.errors import FileError, InputError
from msbdb.io.files import describe_source, require_input, require_output, write_atomic
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


def test_a_file_that_can_be_written_is_accepted_and_nothing_is_made(tmp_path):
    """A new name in a folder, or an old one that may be replaced."""
    old = tmp_path / "old.png"
    old.write_bytes(b"old")
    require_output(tmp_path / "new.PNG", overwrite=False, endings=(".png",), sources=["postgresql://me@host/town"])
    require_output(old, overwrite=True, sources=[tmp_path / "other.png"])
    assert [path.name for path in tmp_path.iterdir()] == ["old.png"]


def test_a_file_that_cannot_be_written_is_refused_with_the_next_step(tmp_path):
    """A missing folder is not made; what is read is never replaced; sidecars of a Shapefile count."""
    for name in ("old.png", "photo.png", "town.dbf"):
        (tmp_path / name).write_bytes(b"old")
    (tmp_path / "folder.png").mkdir()
    (tmp_path / "same.png").symlink_to(tmp_path / "photo.png")
    cases = {
        ("x.pdf", False): (InputError, r"written as \.png, .* got 'x\.pdf'"),
        ("none/x.png", True): (FileError, "none does not exist"),
        ("folder.png", True): (FileError, "is a folder"),
        ("old.png", False): (FileError, "exists already.*--overwrite"),
        ("same.png", True): (InputError, "is the source itself"),
    }
    for (name, overwrite), (kind, says) in cases.items():
        with pytest.raises(kind, match=says):
            require_output(tmp_path / name, overwrite=overwrite, endings=(".png",), sources=[tmp_path / "photo.png"])
    with pytest.raises(FileError, match=r"town\.dbf exists already"):
        require_output(tmp_path / "town.shp", overwrite=False)
    with pytest.raises(FileError, match="is a URL"):
        require_output("s3://bucket/town.shp", overwrite=False)
    assert not (tmp_path / "none").exists()


def test_an_input_that_is_no_file_is_refused_with_the_next_step(tmp_path):
    """URLs also as a path of Python, which has one slash less; a name with a colon is a file."""
    (tmp_path / "a:b.laz").touch()
    require_input(tmp_path / "a:b.laz")
    for wrong, says in {
        "https://example.org/a.laz": "is a URL",
        Path("https://example.org/a.laz"): "is a URL",
        tmp_path: "is a folder",
        tmp_path / "none.laz": "does not exist",
    }.items():
        with pytest.raises(FileError, match=says):
            require_input(wrong)
