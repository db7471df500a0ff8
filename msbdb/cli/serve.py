"""``msbdb serve``: a database for browsers and GIS clients."""

import click

from msbdb.cli.command import command, shared
from msbdb.cli.output import say


@command(
    "serve",
    examples=(
        "msbdb serve town.sqlite",
        "msbdb serve postgresql://reader@localhost/town --port 8081",
        "msbdb serve town.sqlite --host 0.0.0.0 --url https://town.example.org",
    ),
)
@shared("db")
@click.option(
    "--host",
    default="127.0.0.1",
    show_default=True,
    metavar="ADDRESS",
    help="The address to listen at; by default this machine alone reaches it. 0.0.0.0 opens it to the network.",
)
@click.option(
    "--port", type=click.IntRange(0, 65535), default=8080, show_default=True, help="The port; 0 takes a free one."
)
@click.option(
    "--url", metavar="URL", help="The address at which clients find the server, where it stands behind another one."
)
def serve(*, db: str, host: str, port: int, url: str | None) -> None:
    """Serve a database to browsers and GIS clients, by OGC API Features and with the page in 3-D.

    Nothing can be written through it. There are no users and no passwords: give --host only in a network that you
    trust, or put a web server with both before it. Ctrl-C ends it. It needs: pip install "msbdb[serve]"
    """
    from msbdb import api

    def started(address: str) -> None:
        say(f"Page:             {address}/page")
        say(f"OGC API Features: {address}/")

    api.serve(db, host=host, port=port, url=url, started=started)
