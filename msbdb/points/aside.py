"""Arrays that wait in temporary files while other steps need the memory."""

import mmap
import tempfile
from typing import TypeVar
from weakref import WeakSet

import numpy as np
from numpy.typing import NDArray

from msbdb.errors import FileError
from msbdb.threads import memory_is_bounded

T = TypeVar("T", bound=np.generic)

LEAST = 2**20
"""Bytes of the smallest arrays that go into files."""

_ASIDE = WeakSet[mmap.mmap]()
"""The files that are there."""


def set_aside(values: NDArray[T]) -> NDArray[T]:
    """Return an equal array that a temporary file holds, where memory is bounded; else the array itself.

    It takes memory from the first use to the next `let_go`. The file has no name, and goes with the array.

    Raises
    ------
    FileError
        When the folder of temporary files has no room.
    """
    if not memory_is_bounded() or values.nbytes < LEAST:
        return values
    try:
        with tempfile.TemporaryFile(prefix="msbdb.") as file:
            file.write(np.ascontiguousarray(values).data)
            file.flush()
            held = mmap.mmap(file.fileno(), values.nbytes)
    except OSError as error:
        msg = (
            f"{values.nbytes / 2**20:.0f} MiB could not be written into the folder of temporary files, "
            f"{tempfile.gettempdir()}: {error.strerror}. Make room there, or name another folder by TMPDIR."
        )
        raise FileError(msg) from error
    _ASIDE.add(held)
    return np.frombuffer(held, dtype=values.dtype).reshape(values.shape)


def let_go() -> None:
    """Take all that files hold out of the memory until it is used again."""
    if hasattr(mmap, "MADV_DONTNEED"):
        for held in list(_ASIDE):
            held.madvise(mmap.MADV_DONTNEED)
