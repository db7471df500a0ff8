"""Compiled kernels, work on several cores with the same results as on one, and the memory of a run."""

import atexit
import ctypes
import gc
import mmap
import os
import sys
import warnings
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_EXCEPTION, ThreadPoolExecutor, wait
from contextlib import contextmanager, nullcontext, suppress
from threading import Lock, Thread, local
from typing import TYPE_CHECKING, Any, NoReturn, ParamSpec, TypeVar, cast

from msbdb.errors import MsbdbWarning, collected_notices, give_notice

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

P = ParamSpec("P")
T = TypeVar("T")
R = TypeVar("R")

MOST = 4
"""Most threads at a time: each holds temporary arrays of the whole lattice, and the memory's speed is shared."""

PATIENCE_S = 0.2
"""Seconds after which a thread that waits for others looks for an interruption: a signal may reach another thread."""

HIDDEN = "Dataset has no geotransform|The given matrix is equal to Affine.identity"
"""rasterio hides these warnings of its own by filters that all threads share, so another thread may bring them back."""

MMAP_MAX, TRIM_THRESHOLD, MMAP_THRESHOLD, ARENA_MAX = -4, -1, -3, -8
"""Numbers of the settings of glibc's allocator (``mallopt``)."""

REUSING = ((MMAP_MAX, 0), (TRIM_THRESHOLD, 2**31 - 1), (ARENA_MAX, 1))
"""All arrays come from one heap, which keeps what is freed."""

BOUNDED = ((MMAP_MAX, 65_536), (MMAP_THRESHOLD, 2**24), (TRIM_THRESHOLD, 2**26), (ARENA_MAX, 1))
"""Arrays of 16 MiB or more are the system's again when they are freed: a heap would keep holes between them."""

RETURNING = ((MMAP_MAX, 65_536), (MMAP_THRESHOLD, 2**25), (TRIM_THRESHOLD, 2**26))
"""The allocator's own values, once a large array has been freed."""

AT_ONCE = 2**25
"""Bytes that are taken from the system ahead, and freed, in one step."""

FETCHING = "msbdb fetches memory"
"""Name of the thread that takes memory ahead."""

RARELY = (100_000, 50, 50)
"""Python looks for garbage after so many new objects: of outlines there are millions, and no cycles among them."""

_OF_THREAD = local()

_IS_BOUNDED = list[bool]()
"""Whether `memory_reused` bounds the memory; empty outside of it."""

_ALONE, _SHARE = Lock(), list[int]()
"""Whose turn it is, and on how many cores, in a process that works for others."""


def in_threads(work: Callable[[T], R], items: Iterable[T]) -> list[R]:
    """Return ``[work(item) for item in items]``, worked on by as many threads as there are cores, up to `MOST`.

    Use it for pure functions of whole arrays, whose kernels run without the interpreter's lock. The results come in
    the order of the items, and an exception is that of the first item that has one; so threads change nothing but
    the time. An interruption by the keyboard does not wait for them (`end_now`).

    Examples
    --------
    >>> in_threads(abs, [-1, 2, -3])
    [1, 2, 3]
    """
    tasks = list(items)
    threads = min(len(tasks), cores(), MOST)
    if threads < 2:
        return [work(item) for item in tasks]
    # A pool within a pool leaves the filters alone: threads that end in another order would put back old ones.
    inside = getattr(_OF_THREAD, "in_pool", False)
    with nullcontext() if inside else _hiding():
        pool, waits = ThreadPoolExecutor(threads, initializer=_enter_pool), True
        try:
            results = [pool.submit(_with_notices, work, item) for item in tasks]
            while wait(results, timeout=PATIENCE_S, return_when=FIRST_EXCEPTION).not_done:
                if any(one.done() and one.exception() for one in results):
                    break
            found = [one.result() for one in results]
        except KeyboardInterrupt:
            waits = False
            raise
        finally:
            pool.shutdown(wait=waits, cancel_futures=True)
    for _, notices in found:
        for notice in notices:
            give_notice(str(notice), type(notice), stacklevel=3)
    return [result for result, _ in found]


def together(one: Callable[[], T], other: Callable[[], R]) -> tuple[T, R]:
    """Return what two functions return, worked on side by side as by `in_threads`.

    Examples
    --------
    >>> together(lambda: 1, lambda: "one")
    (1, 'one')
    """
    first, second = in_threads(lambda work: work(), (one, other))
    return cast("T", first), cast("R", second)


def _with_notices(work: Callable[[T], R], item: T) -> tuple[R, list[MsbdbWarning]]:
    """Return a result, and the notices that were given on the way: they are given again in the order of the items."""
    with collected_notices() as notices:
        return work(item), notices


def _enter_pool() -> None:
    """Mark a thread as one of a pool."""
    _OF_THREAD.in_pool = True


@contextmanager
def _hiding() -> Iterator[None]:
    """Hide `HIDDEN` while the block runs."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=HIDDEN)
        yield


def end_now(code: int) -> NoReturn:
    """End the program without waiting for threads that work on; what they make is not used, and they write nothing."""
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError, ValueError):  # closed, or nobody reads
            stream.flush()
    os._exit(code)


@contextmanager
def memory_reused(*, bounded: bool = False, ahead: int = 0) -> Iterator[None]:
    """Let freed memory serve the next array while the block runs; then give it back to the system.

    With ``bounded``, large arrays go back at once, and what is not needed for a while waits in files
    (`msbdb.points.aside`). A block within another one changes nothing.

    A thread takes ``ahead`` bytes from the system at the beginning, at most half of what is free. The system clears
    them on one core while Python loads libraries on another. Else it does so later, while arrays are filled.

    By default glibc takes each large array from the system, page by page, and gives it back when it is freed. In a
    build of ten million points a quarter of the processor's time went there. Other allocators are left as they are.
    It saves more after `own_process`. Python's own search for garbage leaves out what was there before the block.
    """
    if _IS_BOUNDED:
        yield
        return
    try:
        _set_allocator(BOUNDED if bounded else REUSING)
        _IS_BOUNDED[:] = [bounded]
        gc.freeze()
        with _fetching(ahead):
            yield
    finally:
        gc.unfreeze()
        _IS_BOUNDED.clear()
        _set_allocator(RETURNING)
        library = _glibc()
        if library is not None:
            library.malloc_trim(0)


@contextmanager
def _fetching(size: int) -> Iterator[None]:
    """Let a thread touch each page of so many bytes, and free them, until it is done or the block ends."""
    import numpy as np

    if not size or _glibc() is None:
        yield
        return
    size = min(size, os.sysconf("SC_AVPHYS_PAGES") * mmap.PAGESIZE // 2)
    pieces = list["NDArray[np.uint8]"]()
    with suppress(MemoryError):
        # Not by the thread itself: glibc may give it a heap of its own, from which other threads take nothing.
        pieces = [np.empty(AT_ONCE, dtype=np.uint8) for _ in range(size // AT_ONCE)]
    pieces.reverse()

    def fetch() -> None:
        with suppress(IndexError):  # none is left
            while True:
                pieces.pop()[:: mmap.PAGESIZE] = 0  # numpy does this without the interpreter's lock

    fetching = Thread(target=fetch, name=FETCHING, daemon=True)
    fetching.start()
    try:
        yield
    finally:
        pieces.clear()
        fetching.join()


def memory_is_bounded() -> bool:
    """Return whether a block runs in which memory is bounded."""
    return any(_IS_BOUNDED)


def own_process() -> None:
    """Let a program take its memory from one heap, and search for garbage seldom; before it starts any thread.

    At its end it does not search again through all that it loaded, which took a third of a second.
    """
    _set_allocator(((ARENA_MAX, 1),))
    gc.set_threshold(*RARELY)
    atexit.register(gc.freeze)


def _set_allocator(settings: Iterable[tuple[int, int]]) -> None:
    """Set glibc's allocator; another one is left as it is."""
    library = _glibc()
    if library is not None:
        for setting, value in settings:
            library.mallopt(setting, value)


def _glibc() -> ctypes.CDLL | None:
    """Return the process's own C library, if it is glibc."""
    library = ctypes.CDLL(None) if os.name == "posix" else None
    return library if hasattr(library, "mallopt") and hasattr(library, "malloc_trim") else None


def cores() -> int:
    """Return the number of cores that this process may use, or that `alone_on` leaves it."""
    found = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return min([found, *_SHARE])


@contextmanager
def alone_on(share: int | None) -> Iterator[None]:
    """Let one thread at a time run the block, on so many cores at most; None for all.

    Examples
    --------
    >>> with alone_on(1):
    ...     cores()
    1
    """
    with _ALONE:
        _SHARE[:] = [] if share is None else [max(share, 1)]
        try:
            yield
        finally:
            _SHARE.clear()


def kernel(function: Callable[P, R]) -> Callable[P, R]:
    """Compile a function for arrays: cached on disk, without the interpreter's lock.

    Neither numba's threads nor relaxed floating-point rules are used, so that the same input gives the same output on
    every machine. A division by zero gives infinity or NaN, as numpy's: a check of each would keep the processor from
    dividing several values at once.
    """
    import numba

    return cast("Callable[P, R]", numba.njit(function, cache=True, nogil=True, error_model="numpy"))


@contextmanager
def when_compiling(tell: Callable[[bool], None]) -> Iterator[None]:
    """Report each compilation of a kernel while the block runs; a kernel from the cache on disk is none.

    Parameters
    ----------
    tell : callable
        Called with True when a compilation begins and with False when it ends, from any thread.
    """
    from numba.core import event

    class Listener(event.Listener):
        def on_start(self, event: Any) -> None:  # noqa: ANN401, ARG002  (numba's)
            tell(True)

        def on_end(self, event: Any) -> None:  # noqa: ANN401, ARG002  (numba's)
            tell(False)

    with event.install_listener("numba:compile", Listener()):
        yield
