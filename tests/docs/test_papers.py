"""docs/papers.md explains each code of the papers that msbdb uses, and explains it once."""

import re
from collections import Counter
from pathlib import Path

from msbdb.params import declared

ROOT = Path(__file__).resolve().parents[2]
LAST = {"V": 60, "M": 28, "C": 22, "S": 12, "X": 4, "A": 21}
"""The last code of each group; the first is 1."""

CODE = re.compile(rf"\b([{''.join(LAST)}])(\d{{1,2}})\b")
RANGE = re.compile(rf"\b([{''.join(LAST)}])(\d{{1,2}})(?: to |-|–)\1?(\d{{1,2}})\b")


def codes_of(text: str) -> set[str]:
    """Return the codes of a text; "V37 to V39" and "V37-V39" are three."""
    found = {f"{group}{int(number)}" for group, number in CODE.findall(text)}
    for group, first, last in RANGE.findall(text):
        found |= {f"{group}{number}" for number in range(int(first), int(last) + 1)}
    return found


def explained() -> Counter[str]:
    """Count the rows of the page by their code."""
    page = (ROOT / "docs" / "papers.md").read_text(encoding="utf-8")
    return Counter(re.findall(r"^\| ([A-Z]\d+) \|", page, flags=re.MULTILINE))


def test_ranges_count_all_that_lies_between():
    """A range of codes stands for each code in it."""
    assert codes_of("(V37-V39, M4; C1 to C3)") == {"V37", "V38", "V39", "M4", "C1", "C2", "C3"}


def test_every_code_has_one_row():
    """The page has one row for each code from the first to the last of each group, and none for others."""
    wanted = {f"{group}{number}" for group, last in LAST.items() for number in range(1, last + 1)}
    assert explained() == Counter(wanted)


def test_every_code_of_the_package_is_explained():
    """A reader finds each code that a docstring, a comment or a parameter names on the page."""
    known = set(explained())
    unknown = {
        str(path.relative_to(ROOT)): missing
        for path in sorted(ROOT.glob("msbdb/**/*.py"))
        if (missing := codes_of(path.read_text(encoding="utf-8")) - known)
    }
    assert not unknown


def is_room(name: str) -> bool:
    """Whether a dotted name is a module or a folder of msbdb."""
    place = ROOT / "msbdb" / Path(*name.split("."))
    return place.is_dir() or place.with_suffix(".py").is_file()


def test_every_room_of_the_page_exists():
    """Each row ends in the rooms of its code, and each dotted name is a room or a parameter."""
    page = (ROOT / "docs" / "papers.md").read_text(encoding="utf-8")
    parameters = {f"{section}.{item.name}" for section, item, _ in declared()}
    ends = re.findall(r"((?:`[a-z0-9_.]+`(?:, | and )?)+) \|$", page, flags=re.MULTILINE)
    named = {name for end in ends for name in re.findall(r"`([^`]+)`", end)} - parameters
    dotted = set(re.findall(r"`([a-z0-9_]+(?:\.[a-z0-9_]+)+)`", page)) - parameters
    assert len(named) > 10
    assert sorted(name for name in named | dotted if not is_room(name)) == []


def test_every_room_of_the_contributors_page_exists():
    """The second column of its table names rooms, and folders and files of the project."""
    page = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    cells = re.findall(r"^\| [^|]+ \| ([^|]*`[^|]+) \|$", page, flags=re.MULTILINE)
    named = {name.rstrip("/") for cell in cells for name in re.findall(r"`([^`]+)`", cell)}
    assert len(named) > 20
    assert sorted(name for name in named if not is_room(name) and not (ROOT / name).exists()) == []
