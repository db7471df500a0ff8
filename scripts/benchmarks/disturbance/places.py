"""Where databases live that are disturbed on purpose: files in a folder, or a PostGIS server that is ours alone."""

import contextlib
import os
import resource
import select
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from itertools import count
from pathlib import Path

import psycopg

from disturbance.forks import end, fork

SCRIPT = Path(__file__).resolve().parents[2] / "postgis_server"
PATIENCE_S = 30.0


class Files:
    """SpatiaLite files, each in a folder of its own."""

    kind = "spatialite"

    def __init__(self, folder: Path, kept: "Files | None" = None) -> None:
        self.folder = folder
        self.folder.mkdir()
        self.kept = folder if kept is None else kept.folder

    def has(self, name: str) -> bool:
        """Tell whether a database is kept."""
        return (self.kept / f"{name}.sqlite").exists()

    def new(self, start: str | None = None) -> str:
        """Return a path for a database, with a copy of a kept one."""
        # The same paths again and again, so that what was compiled for one database serves the next.
        place = next(p for n in count(1) if not (p := self.folder / f"run_{n}").exists())
        place.mkdir()
        if start is not None:
            shutil.copy(self.kept / f"{start}.sqlite", place / "town.sqlite")
        return str(place / "town.sqlite")

    def keep(self, target: str, name: str) -> None:
        """Keep a copy of a database to start from."""
        shutil.copy(target, self.kept / f"{name}.sqlite")

    def drop(self, target: str) -> None:
        """Remove a database."""
        shutil.rmtree(Path(target).parent)

    def settle(self, target: str) -> None:
        """Do nothing: what a process held goes with it."""

    def strays(self, target: str) -> list[str]:
        """Return the files beside a database that nobody writes."""
        path = Path(target)
        return sorted({file.name for file in path.parent.iterdir()} - {path.name})

    def close(self) -> None:
        """Do nothing: the folder is the caller's."""


class Server:
    """A PostGIS server with a database for each run, and the ways to disturb it."""

    kind = "postgis"

    def __init__(self, folder: Path, *options: str) -> None:
        self.folder = folder
        self.free: list[str] = []
        self.made = 0
        started = subprocess.run(
            [str(SCRIPT), "start", str(folder), *options], check=False, capture_output=True, text=True
        )
        if started.returncode:
            raise SystemExit(started.stderr.strip())

    def run(self, statement: str, database: str = "postgres") -> list[tuple[object, ...]]:
        """Run one statement outside of any transaction."""
        conninfo = f"host={self.folder} user=msbdb dbname={database}"
        with psycopg.connect(conninfo, autocommit=True) as connection:
            cursor = connection.execute(statement.encode())
            return cursor.fetchall() if cursor.description else []

    def url(self, name: str, host: Path | None = None) -> str:
        """Return the URL of a database, through another folder's socket where one is given."""
        return f"postgresql+psycopg://msbdb@/{name}?host={host or self.folder}"

    def name(self, target: str) -> str:
        """Return the name of a URL's database."""
        return target.partition("@/")[2].partition("?")[0]

    def has(self, name: str) -> bool:
        """Tell whether a database is kept."""
        return bool(self.run(f"SELECT 1 FROM pg_database WHERE datname = 'kept_{name}'"))

    def new(self, start: str | None = None) -> str:
        """Return the URL of a database, a copy of a kept one, or empty."""
        if not self.free:
            self.made += 1
            self.free.append(f"run_{self.made}")
        name = self.free.pop()
        self.run(f"CREATE DATABASE {name} TEMPLATE {f'kept_{start}' if start else 'msbdb'} STRATEGY file_copy")
        return self.url(name)

    def keep(self, target: str, name: str) -> None:
        """Keep a copy of a database to start from."""
        self.settle(target)
        self.run(f"CREATE DATABASE kept_{name} TEMPLATE {self.name(target)} STRATEGY file_copy")

    def drop(self, target: str) -> None:
        """Remove a database."""
        self.run(f"DROP DATABASE {self.name(target)} WITH (FORCE)")
        self.free.append(self.name(target))

    def settle(self, target: str) -> None:
        """Wait until the server has noticed that clients are gone, and start it where it is not."""
        query = f"SELECT count(*) FROM pg_stat_activity WHERE datname = '{self.name(target)}'"
        until = time.monotonic() + PATIENCE_S
        while True:
            try:
                if self.run(query) == [(0,)]:
                    return
            except psycopg.OperationalError:
                # After a full disk it may be at its recovery, or have given up.
                if not (self.folder / "data" / "postmaster.pid").exists():
                    self.restart()
            if time.monotonic() > until:
                msg = f"The server still works at {target} after {PATIENCE_S:.0f} s."
                raise TimeoutError(msg)
            time.sleep(0.02)

    def strays(self, target: str) -> list[str]:
        """Return the locks that outlive their writer."""
        query = (
            "SELECT locktype FROM pg_locks JOIN pg_database AS d ON d.oid = database "
            f"WHERE locktype = 'advisory' AND datname = '{self.name(target)}'"
        )
        return [f"{kind} lock" for (kind,) in self.run(query)]

    def restart(self) -> None:
        """Start again, after stopping at once as in a crash where it runs."""
        subprocess.run([str(SCRIPT), "restart", str(self.folder)], check=True)

    def struck_by(self, fault: str, target: str) -> contextlib.AbstractContextManager[tuple[str, Callable[[], None]]]:
        """Return the way to a database, and what strikes it by a restart, a close by the server, or a cut wire."""
        return {"restart": self._crashing, "cut": self._closing, "wire": self._cutting}[fault](target)

    @contextlib.contextmanager
    def _crashing(self, target: str) -> Iterator[tuple[str, Callable[[], None]]]:
        """Return the database, and what stops the server at once and starts it again."""
        number = int((self.folder / "data" / "postmaster.pid").read_text().split()[0])

        def strike() -> None:
            os.kill(number, signal.SIGQUIT)
            self.restart()

        yield target, strike

    @contextlib.contextmanager
    def _closing(self, target: str) -> Iterator[tuple[str, Callable[[], None]]]:
        """Return the database, and what closes all connections to it from the server's side."""
        statement = "SELECT pg_terminate_backend(pid) FROM pg_stat_activity WHERE datname = %s"
        conninfo = f"host={self.folder} user=msbdb dbname=postgres"
        # Connected beforehand, so that no time goes by at the moment itself.
        with psycopg.connect(conninfo, autocommit=True) as connection:

            def strike() -> None:
                connection.execute(statement, [self.name(target)])

            yield target, strike

    @contextlib.contextmanager
    def _cutting(self, target: str) -> Iterator[tuple[str, Callable[[], None]]]:
        """Return the same database by another way, and what cuts this way while both ends live on."""
        with tempfile.TemporaryDirectory(prefix="wire.") as name:
            ready, reported = os.pipe()
            process = fork(lambda: _forward(Path(name), self.folder, reported))
            os.close(reported)
            os.read(ready, 1)
            os.close(ready)
            try:
                yield self.url(self.name(target), Path(name)), lambda: end(process)
            finally:
                end(process)

    def close(self) -> None:
        """Stop, and leave nothing."""
        subprocess.run([str(SCRIPT), "stop", str(self.folder)], check=True)


SOCKET = ".s.PGSQL.5432"


def _forward(here: Path, there: Path, reported: int) -> int:
    """Hand on what comes through a socket of ours to the server's, and back, until the process is killed."""
    listener = socket.socket(socket.AF_UNIX)
    listener.bind(str(here / SOCKET))
    listener.listen()
    os.write(reported, b"r")
    other: dict[socket.socket, socket.socket] = {}
    while True:
        for ready in select.select([listener, *other], [], [])[0]:
            if ready is listener:
                one, two = listener.accept()[0], socket.socket(socket.AF_UNIX)
                two.connect(str(there / SOCKET))
                other |= {one: two, two: one}
            elif ready in other:
                try:
                    sent = ready.recv(65536)
                    other[ready].sendall(sent)
                except OSError:
                    sent = b""
                if not sent:
                    for side in (other.pop(ready), ready):
                        other.pop(side, None)
                        side.close()


def may_mount() -> bool:
    """Tell whether small file systems can be made here."""
    return os.geteuid() == 0 and shutil.which("mount") is not None


@contextlib.contextmanager
def small_disk(folder: Path, size: str) -> Iterator[Path]:
    """Mount a small file system in memory."""
    folder.mkdir()
    subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={size},mode=755", "tmpfs", str(folder)], check=True)
    try:
        yield folder
    finally:
        subprocess.run(["umount", str(folder)], check=True)


@contextlib.contextmanager
def filled(disk: Path, room: int) -> Iterator[None]:
    """Leave so many bytes of a disk free."""
    block = disk / "block"
    with block.open("wb") as file:
        size = shutil.disk_usage(disk).free - room
        if size > 0:
            os.posix_fallocate(file.fileno(), 0, size)
    try:
        yield
    finally:
        block.unlink()


def limit_files(size: int) -> None:
    """Let no file of this process grow beyond a size: Python ignores the signal, writing fails."""
    sys.dont_write_bytecode = True  # half a module's bytecode would stay
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, resource.RLIM_INFINITY))
