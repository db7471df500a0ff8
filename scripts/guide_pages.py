"""Pages of the guide that are no files below ``docs/``: those beside it, and the cookbook made of the example queries.

MkDocs calls the functions while it builds (``mkdocs.yml``).
"""

from pathlib import Path
from typing import Any

from mkdocs.structure.files import File, Files

from msbdb.database import example_queries

ROOT = Path(__file__).resolve().parent.parent
BESIDE = ("ARCHITECTURE.md", "CHANGELOG.md", "CONTRIBUTING.md", "schema/dictionary.md")
"""Files of the project that pages link to."""


def on_files(files: Files, config: Any) -> Files:
    """Add the pages."""
    for name in BESIDE:
        files.append(File.generated(config, name, abs_src_path=str(ROOT / name)))
    files.append(File.generated(config, "cookbook.md", content=cookbook()))
    return files


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Turn links out of ``docs/`` into links between pages."""
    above = page.file.src_uri.count("/")
    if page.file.src_uri in BESIDE:
        markdown = markdown.replace("](docs/", f"]({'../' * above}")
        return markdown.replace("decisions/)", "decisions/README.md)")
    for name in BESIDE:
        markdown = markdown.replace(f"]({'../' * (above + 1)}{name}", f"]({'../' * above}{name}")
    return markdown.replace(f"]({'../' * (above + 1)}schema/queries/)", f"]({'../' * above}cookbook.md)")


def cookbook() -> str:
    """Return the page of all example queries."""
    entries = []
    for name, query in sorted(example_queries().items()):
        text = (ROOT / "schema" / "queries" / f"{name}.sql").read_text(encoding="utf-8")
        statement = "\n".join(line for line in text.splitlines() if not line.startswith("--"))
        entries.append(f"## {name}\n\n{query.title}\n\n```sql\n{statement.strip()}\n```\n")
    head = (
        "# SQL cookbook\n\nEach query runs as it is in `psql`, and in `sqlite3` with `mod_spatialite`. The values to "
        "edit are in the table `param` at its top. `msbdb query town.sqlite NAME --param survey=spring` runs it, too."
        "\n\n"
    )
    return head + "\n".join(entries)
