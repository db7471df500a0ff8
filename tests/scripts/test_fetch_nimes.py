"""The script that fetches the real tile, without the network."""

import hashlib
import io
import os
import subprocess
import sys
import tarfile

import pytest
from support.processes import ROOT, load_script

SCRIPT = ROOT / "scripts" / "fetch_nimes"


@pytest.fixture
def script():
    """Return the script as a module."""
    return load_script(SCRIPT)


def run(cache):
    """Run the script with a cache folder and without any package index."""
    environment = {**os.environ, "XDG_CACHE_HOME": str(cache), "PIP_NO_INDEX": "1", "PIP_CONFIG_FILE": os.devnull}
    environment.pop("PIP_FIND_LINKS", None)
    command = [sys.executable, "-B", str(SCRIPT)]
    return subprocess.run(command, env=environment, capture_output=True, text=True, check=False)


def test_the_tile_is_taken_only_if_its_checksum_is_right(script, tmp_path, monkeypatch):
    """From an unpacked distribution or an archive; a wrong file is passed over."""
    monkeypatch.setattr(script, "SHA256", hashlib.sha256(b"right").hexdigest())
    wrong = tmp_path / "unpacked" / "data"
    wrong.mkdir(parents=True)
    (wrong / script.MEMBER).write_bytes(b"wrong")
    assert script.find_tile(tmp_path) is None
    with tarfile.open(tmp_path / "package.tar.gz", "w:gz") as archive:
        member = tarfile.TarInfo(f"package/data/{script.MEMBER}")
        member.size = 5
        archive.addfile(member, io.BytesIO(b"right"))
    found = script.find_tile(tmp_path)
    assert found.read_bytes() == b"right"


def test_a_sound_tile_in_the_cache_is_not_fetched_again(script, tmp_path, monkeypatch, capsys):
    """Its path is printed, and pip is not called."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(script, "SHA256", hashlib.sha256(b"right").hexdigest())
    monkeypatch.setattr(script, "download", lambda _: pytest.fail("pip was called"))
    tile = script.cached_tile()
    tile.parent.mkdir()
    tile.write_bytes(b"right")
    assert script.main() == 0
    assert capsys.readouterr().out.strip() == str(tile)


def test_a_failed_download_says_why_and_leaves_nothing(tmp_path):
    """With pip's own words, a next step, and exit status 1."""
    done = run(tmp_path)
    assert done.returncode == 1
    assert done.stdout == ""
    assert "could not be fetched" in done.stderr
    assert "Check the network" in done.stderr
    assert list((tmp_path / "msbdb").iterdir()) == []
