"""The script that fetches MapLibre GL JS and pmtiles, without npm and without the network."""

import hashlib
import io
import subprocess
import sys
import tarfile

import pytest
from support.processes import ROOT, load_script

FIRST, SECOND = "maplibre-gl@5.24.1", "pmtiles@4.5.0"

SCRIPT = ROOT / "scripts" / "fetch_maplibre"


@pytest.fixture
def script(tmp_path, monkeypatch):
    """Return the script as a module that keeps its files in a folder of the test and knows their digests."""
    found = load_script(SCRIPT)
    monkeypatch.setattr(found, "FOLDER", tmp_path / "maplibre")
    monkeypatch.setattr(found, "SHA256", {name: hashlib.sha256(name.encode()).hexdigest() for name in found.SHA256})
    for variable, _ in found.PACKAGES.values():
        monkeypatch.delenv(variable, raising=False)
    return found


def package(script, path, **other):
    """Write all files as one package, each with its name in it, or other bytes."""
    with tarfile.open(path, "w:gz") as archive:
        for member, name in {**script.PACKAGES[FIRST][1], **script.PACKAGES[SECOND][1]}.items():
            body = other.get(name.partition(".")[0].replace("-", "_"), name.encode())
            info = tarfile.TarInfo(member)
            info.size = len(body)
            archive.addfile(info, io.BytesIO(body))
    return path


def test_a_package_given_as_a_file_needs_no_npm(script, tmp_path, monkeypatch, capsys):
    """Two variables name them; the script prints the folder, and keeps nothing else there."""
    given = str(package(script, tmp_path / "given.tgz"))
    monkeypatch.setenv("MSBDB_MAPLIBRE", given)
    monkeypatch.setenv("MSBDB_PMTILES", given)
    monkeypatch.setattr(script, "download", lambda _: pytest.fail("npm was called"))
    assert script.main() == 0
    assert capsys.readouterr().out.strip() == str(script.FOLDER)
    assert sorted(path.name for path in script.FOLDER.iterdir()) == sorted(script.SHA256)


def test_files_that_are_there_are_not_fetched_again(script, monkeypatch):
    """Neither npm nor the network is needed."""
    script.FOLDER.mkdir()
    for name in script.SHA256:
        (script.FOLDER / name).write_text(name, encoding="utf-8")
    monkeypatch.setattr(script, "download", lambda _: pytest.fail("npm was called"))
    assert script.main() == 0


def test_a_package_with_other_files_is_refused(script, tmp_path, monkeypatch, capsys):
    """One wrong byte is enough; nothing is kept of this package."""
    monkeypatch.setenv("MSBDB_MAPLIBRE", str(package(script, tmp_path / "given.tgz", maplibre_gl=b"wrong")))
    assert script.main() == 1
    assert "SHA-256" in capsys.readouterr().err
    assert list(script.FOLDER.iterdir()) == []


def test_no_package_says_what_is_wrong(script, tmp_path, monkeypatch, capsys):
    """A file that is none, and a machine without npm."""
    (tmp_path / "given.tgz").write_bytes(b"none")
    monkeypatch.setenv("MSBDB_MAPLIBRE", str(tmp_path / "given.tgz"))
    assert script.main() == 1
    assert "is not the package" in capsys.readouterr().err
    monkeypatch.delenv("MSBDB_MAPLIBRE")
    monkeypatch.setenv("PATH", str(tmp_path))
    assert script.main() == 1
    assert "Install npm" in capsys.readouterr().err


def test_npm_that_fails_is_quoted(script, tmp_path, monkeypatch, capsys):
    """Its words come with a next step."""
    npm = tmp_path / "npm"
    npm.write_text(f"#!{sys.executable}\nimport sys\nsys.exit('no such package')\n", encoding="utf-8")
    npm.chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path))
    assert script.main() == 1
    said = capsys.readouterr().err
    assert "no such package" in said
    assert "Check the network" in said


def test_the_files_are_kept_out_of_git_and_in_the_wheel():
    """Git ignores the folder, and the wheel's build names it."""
    done = subprocess.run(["git", "check-ignore", "msbdb/view/maplibre/x"], cwd=ROOT, capture_output=True, check=False)
    assert done.returncode == 0
    assert 'artifacts = ["msbdb/view/maplibre/*"]' in (ROOT / "pyproject.toml").read_text(encoding="utf-8")
