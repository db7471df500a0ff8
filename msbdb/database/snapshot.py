"""Reading one state of a database by many queries, while others write."""

from collections.abc import Iterator
from contextlib import contextmanager

from sqlalchemy import Connection, Engine, text

from msbdb.database.engine import guarded


@contextmanager
def snapshot(engine: Engine) -> Iterator[Connection]:
    """Open a transaction that reads and sees one committed state, whatever is committed meanwhile.

    SQLite's transactions are so by themselves; PostgreSQL's have to ask for it.
    """
    with guarded(engine.url), engine.connect() as connection:
        if connection.dialect.name == "postgresql":
            connection.execute(text("SET TRANSACTION ISOLATION LEVEL REPEATABLE READ READ ONLY"))
        yield connection
