"""The Python examples of the pages give what the pages show."""

import doctest
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
BLOCK = re.compile(r"```python\n(.*?)```", flags=re.DOTALL)


def examples() -> list[tuple[str, str]]:
    """Return the page and the text of each block with a prompt; a block imports all that it uses."""
    pages = sorted([*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md")])
    return [
        (f"{page.relative_to(ROOT)}:{number}", block)
        for page in pages
        for number, block in enumerate(BLOCK.findall(page.read_text(encoding="utf-8")), start=1)
        if ">>>" in block
    ]


@pytest.mark.parametrize(("name", "block"), examples(), ids=[name for name, _ in examples()])
def test_an_example_gives_what_the_page_shows(name, block):
    """Each line after a prompt gives the lines below it."""
    example = doctest.DocTestParser().get_doctest(block, {}, name, name, 0)
    report: list[str] = []
    done = doctest.DocTestRunner(optionflags=doctest.NORMALIZE_WHITESPACE).run(example, out=report.append)
    assert done.attempted > 0
    assert done.failed == 0, "".join(report)


@pytest.mark.parametrize("name", ["multiscale", "flatregions", "area3d", "adaptive"])
def test_every_detector_has_examples(name):
    """docs/methods.md shows steps of each detector."""
    page = (ROOT / "docs" / "methods.md").read_text(encoding="utf-8")
    section = page.split(f"\n## {name}", 1)[1].split("\n## ", 1)[0]
    assert section.count("```python\n>>>") >= 3
