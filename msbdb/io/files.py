"""Whole files: writing one that appears complete or not at all, and the record of one that was read."""

import hashlib
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from msbdb.errors import FileError
from msbdb.tables import Source


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


def describe_source(path: str | os.PathLike[str], role: str) -> Source:
    """Return name, role, SHA-256 and size of an input file, reading it in pieces.

    Parameters
    ----------
    path : path
        A file.
    role : str
        What the build uses it for, such as points, dsm, dtm or image.

    Raises
    ------
    FileError
        If the file cannot be read.
    """
    path = Path(path)
    try:
        with path.open("rb") as file:
            digest = hashlib.file_digest(file, "sha256").hexdigest()
            size = file.tell()
    except OSError as error:
        msg = f"{path} cannot be read: {error.strerror}. Check the path and its permissions."
        raise FileError(msg) from error
    return Source(path.name, role, digest, size)
