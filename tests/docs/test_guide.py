"""The guide is built without a warning, and its pages load nothing from the network."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.long
def test_the_guide_is_whole(tmp_path: Path) -> None:
    """Strict: each page has its place, and each link and anchor exists. The cookbook has every query."""
    command = [sys.executable, "-m", "mkdocs", "build", "--quiet", "--strict", "--site-dir", str(tmp_path)]
    quiet = os.environ | {"NO_MKDOCS_2_WARNING": "1"}
    done = subprocess.run(command, cwd=ROOT, env=quiet, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    pages = {
        page.relative_to(tmp_path).as_posix(): page.read_text(encoding="utf-8") for page in tmp_path.rglob("*.html")
    }
    assert {"index.html", "tutorial.html", "python.html", "cookbook.html", "schema/dictionary.html"} <= set(pages)
    loads = re.compile(r"<(?:script|img|link|iframe)\b[^>]*\b(?:src|href)=\"?(?:https?:)?//", re.IGNORECASE)
    assert not [name for name, page in pages.items() if loads.search(page)]
    queries = {path.stem for path in (ROOT / "schema" / "queries").glob("*.sql")}
    assert queries == set(re.findall(r'<h2 id="(\w+)"', pages["cookbook.html"]))
