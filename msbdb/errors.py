"""The errors of msbdb: one root, so that a caller can catch all of them or one kind; numbers in messages.

Every message says what is wrong, what was found, what was expected and what to do next.
"""


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


class MissingDependencyError(MsbdbError, ImportError):
    """An optional library or a system package is not installed."""


class MsbdbWarning(UserWarning):
    """A notice: an assumption, a conversion, or data that were left out; the result is still right."""


class PassingNotice(MsbdbWarning):
    """A notice of one call alone, which the run does not keep."""


def counted(number: int, noun: str) -> str:
    """Return a number of things, in the plural where it is not one.

    Examples
    --------
    >>> counted(1, "finding"), counted(2, "finding")
    ('1 finding', '2 findings')
    """
    return f"{number} {noun}{'' if number == 1 else 's'}"
