"""Rules that the tests and scripts themselves keep."""

import re
import shutil
import socket
import subprocess
import sys

import pytest
from support.processes import ROOT
from support.sizes import sample

SCRIPTS = [path for path in sorted((ROOT / "scripts").rglob("*")) if path.is_file() and path.suffix in ("", ".py")]


def test_no_script_needs_the_tests():
    """What both use lives beside the scripts, so that these work without the tests."""
    needs = re.compile(r"^\s*(from|import) (tests|support|conftest)\b|ROOT / \"tests\"", flags=re.MULTILINE)
    assert len(SCRIPTS) > 20
    assert [path.name for path in SCRIPTS if needs.search(path.read_text(encoding="utf-8"))] == []


def test_the_network_is_closed():
    """A test that would fetch something fails at once, with the address."""
    with socket.socket() as own, pytest.raises(RuntimeError, match=r"192\.0\.2\.1.*no network"):
        own.connect(("192.0.2.1", 80))


def test_a_sample_keeps_all_cases():
    """The first and each third later one have no mark; the others are marked long, or some of them campaign."""
    cases = sample([("a", 1), ("b", 2), ("c", 3), ("d", 4)], 3)
    assert cases[0] == ("a", 1)
    assert cases[3] == ("d", 4)
    assert [(case.values, [mark.name for mark in case.marks]) for case in cases[1:3]] == [
        (("b", 2), ["long"]),
        (("c", 3), ["long"]),
    ]
    assert [case.marks[0].name for case in sample(range(8), 8, 3)[1:]] == ["campaign", "campaign", "long"] * 2 + [
        "campaign"
    ]


@pytest.mark.parametrize(
    ("size", "left"),
    [
        ([], ["short", "later"]),
        (["--first"], ["short"]),
        (["--ci"], ["hour", "short", "later"]),
        (["--ci", "--first"], ["hour"]),
        (["--long"], ["day", "hour", "short", "later"]),
        (["-m", "campaign"], ["day"]),
    ],
)
def test_each_size_has_its_tests(tmp_path, size, left):
    """Long tests from --ci on, campaigns with --long alone; the first of what is left is the first of the size."""
    shutil.copy(ROOT / "tests" / "conftest.py", tmp_path)
    names = [("day", "@pytest.mark.campaign\n"), ("hour", "@pytest.mark.long\n"), ("short", ""), ("later", "")]
    code = "\n\n".join(f"{mark}def test_{name}():\n    pass" for name, mark in names)
    (tmp_path / "test_some.py").write_text(f"import pytest\n\n{code}\n")
    words = ["-q", "--collect-only", "-p", "no:cacheprovider", "-W", "ignore", *size, "test_some.py"]
    done = subprocess.run(
        [sys.executable, "-m", "pytest", *words], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert re.findall(r"::test_(\w+)", done.stdout) == left, done.stdout + done.stderr
