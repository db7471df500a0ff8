"""The record of the sources."""

import hashlib

import pytest

from msbdb.errors import FileError
from msbdb.io.manifest import describe_source
from msbdb.tables import Source


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
