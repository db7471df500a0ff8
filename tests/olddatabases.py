"""The databases of every earlier schema, with two surveys each, as ``tests/fixtures/databases`` keeps them."""

import shutil
from pathlib import Path

import psycopg
from sqlalchemy import make_url

FOLDER = Path(__file__).parent / "fixtures" / "databases"
REVISIONS = ("0001", "0002", "0003", "0004")
HOSTILE = "x'; DROP TABLE part; --"
"""Name of the second survey of each."""

ROWS = {"survey": 2, "run": 2, "source": 4, "part": 12, "building": 8, "rejection": 6, "run_state": 6, "scale": 6}
"""Rows of tables that every schema has."""


def place_old_database(target: str, revision: str) -> None:
    """Put the database of an old schema at a path, or into the empty PostGIS database of a URL."""
    if "://" not in target:
        shutil.copyfile(FOLDER / f"{revision}.sqlite", target)
        return
    conninfo = make_url(target).set(drivername="postgresql").render_as_string(hide_password=False)
    with psycopg.connect(conninfo) as connection:
        connection.execute((FOLDER / f"{revision}.sql").read_bytes())
