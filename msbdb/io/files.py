"""Whole files: what may be read and written, a file that appears complete or not at all, and the record of one read.

A file may be remote, at an http or https URL, where its reader allows it. ``Path`` makes one slash of two; a path that
names a URL keeps its meaning here, so that paths may be used for both.
"""

import hashlib
import io
import os
import re
import shutil
import tempfile
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO, cast

from msbdb.errors import FileError, InputError
from msbdb.tables import Source

if TYPE_CHECKING:
    from _typeshed import WriteableBuffer

SIDECARS = (".shp", ".shx", ".dbf", ".prj", ".cpg", ".qix", ".sbn", ".sbx", ".shp.xml")
"""The files of a Shapefile, some of them left there by other programs."""

PICTURES = (".png", ".svg", ".pdf")
"""The endings of a map or figure."""

PAGE = ".html"
"""The ending of a page in 3-D."""

BLOCK_BYTES = 65_536
"""Read of a remote file at a time; those at its beginning are kept, as they hold its header."""

TIMEOUT_S, RETRIES = 60.0, 3
"""For an answer of a server; a request that fails for its own reasons is repeated."""

_URL = re.compile(r"([A-Za-z][A-Za-z0-9+.-]+):/+")
"""The beginning of a URL. A single letter is a drive, and ``Path`` makes one slash of two."""


def url_of(path: str | os.PathLike[str]) -> str | None:
    """Return the http or https URL that a path names; None for anything else.

    Examples
    --------
    >>> url_of(Path("https://example.org/tiles/a.copc.laz"))
    'https://example.org/tiles/a.copc.laz'
    """
    found = _URL.match(str(path))
    if found is None or found[1].lower() not in ("http", "https"):
        return None
    return f"{found[1]}://{str(path)[found.end() :]}"


def shown(path: str | os.PathLike[str]) -> str:
    """Return a path or a URL for messages; what follows the URL's question mark may be a key, and is left out."""
    url = url_of(path)
    return str(path) if url is None else url.partition("?")[0]


def file_name(path: str | os.PathLike[str]) -> str:
    """Return the name of a file, of a URL without what follows its question mark."""
    return Path(shown(path)).name


class RemoteFile(io.RawIOBase):
    """A file on a server that is read by ranges.

    Raises
    ------
    FileError
        When the server cannot be reached, refuses, gives no ranges, or the file changes while it is read.
    """

    def __init__(self, url: str) -> None:
        import requests
        from requests.adapters import HTTPAdapter
        from urllib3.util import Retry

        self.url, self.place, self.size, self.version = url, 0, -1, ""
        self._failed = requests.RequestException
        self._session = requests.Session()
        again = HTTPAdapter(max_retries=Retry(RETRIES, backoff_factor=0.3, status_forcelist=(500, 502, 503, 504)))
        for scheme in ("http://", "https://"):
            self._session.mount(scheme, again)
        try:
            self._head = self._fetch(0, BLOCK_BYTES)
        except FileError:
            self.close()
            raise

    def _fetch(self, begin: int, count: int) -> bytes:
        """Return a range of bytes."""
        headers = {"Range": f"bytes={begin}-{begin + count - 1}", "Accept-Encoding": "identity"}
        try:
            with self._session.get(self.url, headers=headers, timeout=TIMEOUT_S, stream=True) as answer:
                found = re.fullmatch(r"bytes \d+-\d+/(\d+)", answer.headers.get("Content-Range", ""))
                if answer.status_code >= 400 and answer.status_code != 416:
                    status = f"{answer.status_code} {answer.reason}"
                    msg = f"{shown(self.url)} cannot be read: the server answers {status}. Check the URL."
                    raise FileError(msg)
                if answer.status_code != 206 or found is None:
                    msg = (
                        f"{shown(self.url)} cannot be read in parts: its server gives no ranges, or it is empty. "
                        "Download it, and give the path of the file."
                    )
                    raise FileError(msg)
                size, data = int(found[1]), answer.content
                self.version = f"{size} {answer.headers.get('ETag')} {answer.headers.get('Last-Modified')}"
        except self._failed as error:
            why = type(error).__name__
            msg = f"{shown(self.url)} cannot be read: {why}. Check the URL and the network, or try again."
            raise FileError(msg) from error
        if self.size not in (-1, size) or len(data) != min(count, size - begin):
            msg = f"{shown(self.url)} changed while it was read, or its server sent too little. Run the command again."
            raise FileError(msg)
        self.size = size
        return data

    def readable(self) -> bool:
        """Return that it can be read."""
        return True

    def seekable(self) -> bool:
        """Return that it has places."""
        return True

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        """Go to a place."""
        self.place = offset + {os.SEEK_SET: 0, os.SEEK_CUR: self.place, os.SEEK_END: self.size}[whence]
        return self.place

    def readinto(self, buffer: "WriteableBuffer") -> int:
        """Fill a buffer from the present place; return the number of bytes."""
        target = memoryview(buffer).cast("B")
        count = max(0, min(len(target), self.size - self.place))
        if count:
            near = self.place + count <= len(self._head)
            target[:count] = self._head[self.place :][:count] if near else self._fetch(self.place, count)
        self.place += count
        return count

    def close(self) -> None:
        """End the connection."""
        if not self.closed:
            self._session.close()
        super().close()


def remote_version(path: str | os.PathLike[str]) -> str:
    """Return the version of a file by its server: size, tag and time; empty for a local file."""
    url = url_of(path)
    if url is None:
        return ""
    with RemoteFile(url) as file:
        return file.version


def open_input(path: str | os.PathLike[str]) -> BinaryIO:
    """Return a local or remote file, open for reading bytes."""
    url = url_of(path)
    if url is None:
        return Path(path).open("rb")
    return cast("BinaryIO", io.BufferedReader(RemoteFile(url), BLOCK_BYTES))


def require_input(path: str | os.PathLike[str]) -> None:
    """Refuse a URL, a folder, or a file that does not exist; readers of remote files do not ask for this.

    Raises
    ------
    FileError
        With the next step.
    """
    if _URL.match(str(path)):
        msg = f"{shown(path)} is a URL; a file is expected. Download it first, and give the path of the file."
        raise FileError(msg)
    if Path(path).is_dir():
        msg = f"{path} is a folder; a file is expected. Give the path of a file in it."
        raise FileError(msg)
    if not Path(path).exists():
        msg = f"The file '{path}' does not exist. Check the path; relative ones begin in {Path.cwd()}."
        raise FileError(msg)


def require_output(
    path: str | os.PathLike[str],
    *,
    overwrite: bool,
    endings: tuple[str, ...] = (),
    sources: Iterable[str | os.PathLike[str]] = (),
) -> None:
    """Refuse a file that could not be written at the end of the work; nothing is made or changed.

    Parameters
    ----------
    path : path
        The file to be written. Its folder must exist: a folder is never made, as its name may be mistyped.
    overwrite : bool
        Whether existing files may be replaced.
    endings : tuple of str
        Those that the file may have, in lower case with their dots; empty for any.
    sources : iterable of path
        What the work reads: files, or URLs of databases. They are never replaced.

    Raises
    ------
    InputError
        For another ending, or a file that is a source.
    FileError
        When the folder is missing or read-only, the path is a URL or a folder, or files exist and may not be replaced.
    """
    out = Path(path)
    if endings and out.suffix.lower() not in endings:
        msg = f"Results are written as {', '.join(endings)}, by the ending of the name; got '{out.name}'."
        raise InputError(msg)
    if _URL.match(str(path)) or out.is_dir():
        kind = "folder" if out.is_dir() else "URL"
        msg = f"{path} cannot be written: it is a {kind}. Give the path of a file."
        raise FileError(msg)
    if not out.parent.is_dir():
        msg = (
            f"{out} cannot be written: No such file or directory; {out.parent} does not exist. Make this folder first."
        )
        raise FileError(msg)
    if not os.access(out.parent, os.W_OK):
        msg = f"{out} cannot be written: the folder {out.parent} is read-only. Check its rights, or choose another."
        raise FileError(msg)
    if any(out.exists() and Path(source).exists() and out.samefile(source) for source in sources):
        msg = f"{out} is the source itself, which is never overwritten. Choose another name."
        raise InputError(msg)
    found = existing_files(out)
    if found and not overwrite:
        more = f" (with {', '.join(file.name for file in found[1:])})" if found[1:] else ""
        msg = f"{found[0]} exists already{more}. Choose another name, or replace it by --overwrite (overwrite=True)."
        raise FileError(msg)


def existing_files(path: Path) -> list[Path]:
    """Return the files that writing to the path would replace, sidecars of a Shapefile, CSV or exposure included."""
    candidates = [path]
    if path.suffix.lower() == ".csv":
        candidates.append(path.with_suffix(".csvt"))
    if path.suffix.lower() == ".xml":
        candidates.append(path.with_suffix(".csv"))
    if path.suffix.lower() == ".shp":
        candidates += [path.with_suffix(suffix) for suffix in SIDECARS if suffix != path.suffix]
    return [candidate for candidate in candidates if candidate.exists()]


@contextmanager
def write_atomic(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Yield a path to write to; on success all files written beside it take their places, on failure none does.

    The file is written under its own name in a hidden folder beside the target. So formats of several files work (a
    Shapefile's .shp, .shx and .dbf), and every move is a rename within one file system. The main file is moved last.

    Raises
    ------
    FileError
        If the folder is missing or not writable, the disk is full, or no file was written.
    """
    target = Path(path)
    try:
        folder = Path(tempfile.mkdtemp(prefix=f".{target.name}.", dir=target.parent))
    except OSError as error:
        msg = (
            f"{target} cannot be written: {error.strerror} ({target.parent}). "
            "Choose a folder that exists and that you may write to."
        )
        raise FileError(msg) from error
    try:
        yield folder / target.name
        _move(folder, target)
    except FileError:
        raise
    except OSError as error:
        msg = f"{target} cannot be written: {error.strerror or error}. Choose another file, or free some space."
        raise FileError(msg) from error
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _move(folder: Path, target: Path) -> None:
    """Move all files of a folder to their places, the main one last."""
    written = sorted(folder.iterdir(), key=lambda file: (file.name == target.name, file.name))
    if not written or written[-1].name != target.name:
        msg = f"{target} was not written: its writer left no file of this name. Report it as a bug in msbdb."
        raise FileError(msg)
    for file in written:
        _flush(file)
    for file in written:
        file.replace(target.parent / file.name)


def _flush(path: Path) -> None:
    """Have the system put a file's content on the disk before it is renamed."""
    with path.open("rb") as file:
        os.fsync(file.fileno())


def describe_source(path: str | os.PathLike[str], role: str, parts: Sequence[Path] = ()) -> Source:
    """Return name, role, SHA-256 and size of an input file, reading it in pieces.

    The SHA-256 of a remote file is that of its first 65,536 bytes and its size, since only parts of it are read. That
    of a file with parts is the SHA-256 of all of their checksums, and its size that of all.

    Parameters
    ----------
    path : path
        A file.
    role : str
        What the build uses it for, such as points, dsm, dtm or image.
    parts : sequence of Path
        Other files that hold its content, such as the pieces of a virtual raster.

    Raises
    ------
    FileError
        If a file cannot be read.
    """
    if parts:
        every = [describe_source(each, role) for each in (path, *parts)]
        digest = hashlib.sha256("".join(each.sha256 for each in every).encode()).hexdigest()
        return Source(every[0].name, role, digest, sum(each.bytes for each in every))
    if url_of(path) is not None:
        with open_input(path) as file:
            size = file.seek(0, os.SEEK_END)
            file.seek(0)
            head = file.read(BLOCK_BYTES)
        return Source(file_name(path), role, hashlib.sha256(head + str(size).encode()).hexdigest(), size)
    path = Path(path)
    try:
        with path.open("rb") as file:
            digest = hashlib.file_digest(file, "sha256").hexdigest()
            size = file.tell()
    except OSError as error:
        msg = f"{path} cannot be read: {error.strerror}. Check the path and its permissions."
        raise FileError(msg) from error
    return Source(path.name, role, digest, size)
