"""Where another program finds a database: a file, or a server without the password."""

from collections.abc import Mapping
from dataclasses import dataclass

from sqlalchemy import Engine, text

from msbdb.database.dialects.dialect import guarded


@dataclass(frozen=True, slots=True)
class ClientPlace:
    """Where another program finds a database.

    Parameters
    ----------
    file : str
        The path of a file; empty for a server.
    server : mapping of str to str
        In PostgreSQL's words: dbname, host, port, user, sslmode and service, where they are known.
    schema : str
        The schema of the tables; empty for a file.
    """

    file: str
    server: Mapping[str, str]
    schema: str


def client_place(engine: Engine) -> ClientPlace:
    """Return where another program finds a database; never with the password."""
    url = engine.url
    if engine.dialect.name == "sqlite":
        return ClientPlace(str(url.database), {}, "")
    query = {name: str(value) for name, value in url.query.items() if name in ("host", "port", "sslmode", "service")}
    found = {
        "dbname": url.database, "host": url.host or query.get("host"), "port": url.port or query.get("port"),
        "user": url.username, "sslmode": query.get("sslmode"), "service": query.get("service"),
    }  # fmt: skip
    with guarded(url), engine.connect() as connection:
        schema = str(connection.scalar(text("SELECT current_schema()")))
    return ClientPlace("", {name: str(value) for name, value in found.items() if value}, schema)
