"""A server of files that answers ranges, which that of the standard library does not, and counts what it sends."""

import functools
import os
import re
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from unittest import mock


@dataclass
class Sent:
    """What a server sent: its address, and the bytes of each answer; ``ranges`` is whether it answers ranges at all."""

    url: str = ""
    ranges: bool = True
    answers: list[int] = field(default_factory=list)


class Handler(BaseHTTPRequestHandler):
    """Answer GET with a range of a file in a folder."""

    protocol_version = "HTTP/1.1"

    def __init__(self, *args: object, folder: Path, sent: Sent) -> None:
        self.folder, self.sent = folder, sent
        super().__init__(*args)

    def do_GET(self) -> None:
        """Send a range, the whole file, or 404."""
        file = self.folder / self.path.partition("?")[0].lstrip("/")
        if not file.is_file():
            self.send_error(404)
            return
        data = file.read_bytes()
        wanted = re.fullmatch(r"bytes=(\d+)-(\d+)", self.headers.get("Range", ""))
        part = data[int(wanted[1]) : int(wanted[2]) + 1] if wanted and self.sent.ranges else data
        self.send_response(206 if wanted and self.sent.ranges else 200)
        if wanted and self.sent.ranges:
            self.send_header("Content-Range", f"bytes {wanted[1]}-{int(wanted[1]) + len(part) - 1}/{len(data)}")
        self.send_header("Content-Length", str(len(part)))
        self.send_header("ETag", f'"{file.stat().st_mtime_ns}"')
        self.end_headers()
        self.wfile.write(part)
        self.sent.answers.append(len(part))

    def log_message(self, *_: object) -> None:
        """Be silent."""


@contextmanager
def serving(folder: Path) -> Iterator[Sent]:
    """Serve a folder while the context lasts."""
    sent = Sent()
    server = ThreadingHTTPServer(("127.0.0.1", 0), functools.partial(Handler, folder=folder, sent=sent))
    sent.url = f"http://127.0.0.1:{server.server_port}"
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02})
    thread.start()
    try:
        with mock.patch.dict(os.environ, NO_PROXY="127.0.0.1", no_proxy="127.0.0.1"):
            yield sent
    finally:
        server.shutdown()
        thread.join()
        server.server_close()
