"""The errors of msbdb: one root, so that a caller can catch all of them or one kind; numbers in messages.

Every message says what is wrong, what was found, what was expected and what to do next. A notice goes to the run that
collects them, also from a thread: the filters of Python's warnings belong to all threads, and libraries change them.
"""

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar


class MsbdbError(Exception):
    """Root of every error that msbdb raises on purpose."""


class InputError(MsbdbError, ValueError):
    """The data given cannot be used as they are."""


class CRSError(InputError):
    """A coordinate reference system is missing, unsuitable or contradictory."""


class GridMismatchError(InputError):
    """Two grids that must share a lattice do not."""


class NodataError(InputError):
    """There is no valid value where one is needed."""


class ParameterError(InputError):
    """A parameter is unknown, of the wrong type or out of its bounds."""


class TableError(InputError):
    """A table breaks its declaration: a column, a dtype or an invariant."""


class FileError(MsbdbError, OSError):
    """A file cannot be read or written."""


class DatabaseError(MsbdbError):
    """The database cannot be opened, read or written."""


class SchemaVersionError(DatabaseError):
    """The database is foreign, or its schema is older or newer than this msbdb."""


class LoadError(DatabaseError):
    """The database refused rows; it is unchanged."""


class TilesError(MsbdbError):
    """Some tiles of a survey could not be built; the others are done, and wait."""


class MissingDependencyError(MsbdbError, ImportError):
    """An optional library or a system package is not installed."""


class MsbdbWarning(UserWarning):
    """A notice: an assumption, a conversion, or data that were left out; the result is still right."""


class PassingNotice(MsbdbWarning):
    """A notice of one call alone, which the run does not keep."""


_COLLECTED: ContextVar[list[MsbdbWarning] | None] = ContextVar("collected notices", default=None)


def give_notice(message: str, kind: type[MsbdbWarning] = MsbdbWarning, *, stacklevel: int = 2) -> None:
    """Give a notice: to the block that collects them, else as a warning of Python."""
    collected = _COLLECTED.get()
    if collected is None:
        warnings.warn(message, kind, stacklevel=stacklevel + 1)
    else:
        collected.append(kind(message))


@contextmanager
def collected_notices() -> Iterator[list[MsbdbWarning]]:
    """Collect the notices that are given inside, in their order; none becomes a warning.

    Examples
    --------
    >>> with collected_notices() as found:
    ...     give_notice("Colours are missing.")
    >>> found
    [MsbdbWarning('Colours are missing.')]
    """
    found: list[MsbdbWarning] = []
    before = _COLLECTED.set(found)
    try:
        yield found
    finally:
        _COLLECTED.reset(before)


def counted(number: int, noun: str) -> str:
    """Return a number of things, in the plural where it is not one.

    Examples
    --------
    >>> counted(1, "finding"), counted(2, "finding")
    ('1 finding', '2 findings')
    """
    return f"{number} {noun}{'' if number == 1 else 's'}"
