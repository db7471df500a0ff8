"""The server as a program: which address it listens at, under which names it may be called, and its end."""

import ipaddress
import logging
import socket
from collections.abc import Callable
from contextlib import suppress
from urllib.parse import urlsplit

from waitress import create_server

from msbdb.database import open_to_read
from msbdb.errors import InputError
from msbdb.serve.webapp import ServedTown, make_app

THREADS = 4
"""Requests at a time (ours); most of their time is the database's."""

LOOPBACK = ["localhost", "127.0.0.1", "[::1]"]
"""The names of this machine for itself."""


def run_server(db: str, *, host: str, port: int, url: str | None, started: Callable[[str], None]) -> None:
    """Serve a database until an interrupt; see `msbdb.api.serve`."""
    engine = open_to_read(db)
    # pygeoapi would send its log to the standard output of the whole program; errors reach clients and our own log.
    logging.getLogger().addHandler(logging.NullHandler())
    place = listening_socket(host, port)
    address = url.rstrip("/") if url else address_of(place)
    app = make_app(ServedTown(db, engine, address), trusted_names(place, address))
    server = create_server(app, sockets=[place], threads=THREADS, ident="msbdb")
    try:
        # waitress takes an interrupt for its end only once it serves; it may come as soon as the address is told.
        with suppress(KeyboardInterrupt):
            started(address)
            server.run()
    finally:
        server.close()
        engine.dispose()


def listening_socket(host: str, port: int) -> socket.socket:
    """Return a socket that listens at an address; port 0 takes a free one.

    Raises
    ------
    InputError
        When the address is not this machine's, or the port is taken.
    """
    try:
        family = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0][0]
        return socket.create_server((host, port), family=family)
    except (OSError, OverflowError, UnicodeError) as error:
        msg = f"The server cannot listen at {host}, port {port}: {error}. Choose another --host or --port."
        raise InputError(msg) from error


def address_of(place: socket.socket) -> str:
    """Return the address of a socket for clients; one that listens at all addresses has the machine's name."""
    host, port = place.getsockname()[:2]
    if ipaddress.ip_address(host).is_unspecified:
        host = socket.gethostname()
    return f"http://[{host}]:{port}" if ":" in host else f"http://{host}:{port}"


def trusted_names(place: socket.socket, address: str) -> list[str] | None:
    """Return the names by which a server on the loopback may be called; None for all names where it is not.

    A page of a foreign site could otherwise reach it by a name of its own that leads to 127.0.0.1.
    """
    if not ipaddress.ip_address(place.getsockname()[0]).is_loopback:
        return None
    return [*LOOPBACK, urlsplit(address).hostname or ""]
