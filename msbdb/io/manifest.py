"""The record of what a build was made from: the input files with their checksums."""

import hashlib
import os
from pathlib import Path

from msbdb.errors import FileError
from msbdb.tables import Source


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
