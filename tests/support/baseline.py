"""A database of the first schema, filled with the rows of a database of today's."""

import shutil
from pathlib import Path
from typing import Any

import pytest
import sqlalchemy as sa

from msbdb.database import open_database
from msbdb.database.dialects import migration as upgrade
from msbdb.database.schema.sqltables import METADATA

ROOT = Path(__file__).resolve().parents[2]


def first_migration(folder: Path) -> Path:
    """Write a copy of the migrations with the first one alone."""
    shutil.copytree(ROOT / "migrations", folder, ignore=shutil.ignore_patterns("__pycache__", "000[2-9]*", "001*"))
    return folder


def as_baseline(source: sa.Engine, target: str, srid: int, folder: Path) -> sa.Engine:
    """Make a database of an older schema with the rows of another, whose buildings have one root each.

    Columns that the older schema has not are left out; in the first one the root of a building has the building's id.
    The migrations in the folder end with the older schema.
    """
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(upgrade, "packaged", lambda _name: folder)
        # The comments are of today's columns.
        patch.setattr(upgrade, "comment_ddl", list)
        engine = open_database(target, create=True, srid=srid)
    with source.connect() as today, engine.begin() as old:
        known = set(sa.inspect(old).get_table_names())
        for table in (own for own in METADATA.sorted_tables if own.name in known):
            there = {str(column["name"]) for column in sa.inspect(old).get_columns(table.name)}
            columns = [own for own in table.columns if own.name in there and own.computed is None]
            chosen: list[Any] = [
                sa.func.ST_AsBinary(own, type_=sa.LargeBinary()).label("geometry") if own.name == "geometry" else own
                for own in columns
            ]
            kinds = [sa.column(own.name, own.type) for own in columns]
            values: dict[str, Any] = {own.name: sa.bindparam(own.name, type_=own.type) for own in columns}
            if "geometry" in values:
                values["geometry"] = sa.func.ST_GeomFromWKB(sa.bindparam("geometry", type_=sa.LargeBinary()), srid)
            if table.name == "building" and "root_id" in there:
                chosen.append(table.c.building_id.label("root_id"))
                kinds.append(sa.column("root_id", sa.BigInteger()))
                values["root_id"] = sa.bindparam("root_id", type_=sa.BigInteger())
            rows = [dict(row._mapping) for row in today.execute(sa.select(*chosen))]
            if rows:
                old.execute(sa.insert(sa.table(table.name, *kinds)).values(values), rows)
    return engine
