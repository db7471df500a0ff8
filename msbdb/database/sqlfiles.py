"""The SQL texts that the package keeps as files: views, functions and example queries, which a client can open too."""

import re
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from msbdb.errors import DatabaseError


@dataclass(frozen=True, slots=True)
class SqlFile:
    """An SQL text: ``title`` is the sentences of its comment, ``comment`` all lines of it, ``sql`` the statement."""

    title: str
    comment: str
    sql: str


def packaged(folder: str) -> Path:
    """Return ``migrations`` or ``schema``: beside this module in an installed msbdb, at the top of a source checkout.

    Raises
    ------
    DatabaseError
        When the installation lacks it.
    """
    here = Path(__file__).resolve().parent
    for place in (here / folder, here.parent.parent / folder):
        if place.is_dir():
            return place
    msg = f"This msbdb lacks its folder '{folder}' beside {here}. Install msbdb again."
    raise DatabaseError(msg)


@cache
def read_sql(kind: str, name: str) -> SqlFile:
    """Return ``schema/KIND/NAME.sql``, where kind is ``views``, ``functions`` or ``queries``."""
    return parse_sql(packaged("schema") / kind / f"{name}.sql")


def sql_names(kind: str) -> list[str]:
    """Return the names of the files of a kind."""
    return sorted(path.stem for path in (packaged("schema") / kind).glob("*.sql"))


def parse_sql(path: Path) -> SqlFile:
    """Return an SQL file: a comment, whose lines that begin with a colon are parameters, and one statement."""
    lines = path.read_text(encoding="utf-8").splitlines()
    comment = [line for line in lines if line.startswith("--")]
    words = [re.sub("^-- ?", "", line).strip() for line in comment]
    return SqlFile(
        title=" ".join(line for line in words if line and not line.startswith(":")),
        comment="\n".join(comment),
        sql="\n".join(line for line in lines if not line.startswith("--")).strip().rstrip(";"),
    )
