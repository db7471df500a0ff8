"""Rules that the tests and scripts themselves keep."""

import re
import socket

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
    """The first and each third later one as they are, the others marked long."""
    cases = sample([("a", 1), ("b", 2), ("c", 3), ("d", 4)], 3)
    assert cases[0] == ("a", 1)
    assert cases[3] == ("d", 4)
    assert [(case.values, [mark.name for mark in case.marks]) for case in cases[1:3]] == [
        (("b", 2), ["long"]),
        (("c", 3), ["long"]),
    ]
