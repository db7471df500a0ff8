"""Work in threads."""

import ctypes
import resource
import subprocess
import sys
import threading
import time
import warnings
from pathlib import Path

import numpy as np
import pytest

from msbdb import threads
from msbdb.errors import MsbdbWarning, PassingNotice, collected_notices, give_notice
from msbdb.run.reports import Stages
from msbdb.threads import FETCHING, alone_on, in_threads, memory_reused


@pytest.mark.parametrize("cores", [1, 3])
def test_results_come_in_the_order_of_the_items(monkeypatch, cores):
    """Also when the first item takes longest."""
    monkeypatch.setattr(threads, "cores", lambda: cores)

    def work(item):
        time.sleep(0.02 if item == 0 else 0)
        return item * 10

    assert in_threads(work, iter(range(7))) == [0, 10, 20, 30, 40, 50, 60]


def test_who_works_for_others_does_one_thing_at_a_time(monkeypatch):
    """However many threads ask for it, on its share of the cores, also in threads of its own."""
    monkeypatch.setattr(threads.os, "sched_getaffinity", lambda _: set(range(3)), raising=False)
    running, seen = [], []

    def look(_):
        time.sleep(0.01)
        return threads.cores()

    def work(share):
        with alone_on(share):
            running.append(share)
            seen.append((len(running), in_threads(look, range(2))))
            running.pop()

    both = [threading.Thread(target=work, args=(2,)) for _ in range(4)]
    for one in both:
        one.start()
    for one in both:
        one.join()
    assert seen == [(1, [2, 2])] * 4
    with alone_on(None):
        assert threads.cores() == 3
    with alone_on(0):
        assert threads.cores() == 1
    assert threads.cores() == 3


def test_work_is_shared_by_the_cores_and_no_more(monkeypatch):
    """Two tasks that wait for each other end only if both run; one core needs no further thread."""
    monkeypatch.setattr(threads, "cores", lambda: 2)
    together = threading.Barrier(2, timeout=10)
    in_threads(lambda _: together.wait(), range(2))
    monkeypatch.setattr(threads, "cores", lambda: 1)
    assert set(in_threads(lambda _: threading.get_ident(), range(3))) == {threading.get_ident()}


def test_the_first_error_is_told(monkeypatch):
    """As it would be without threads."""
    monkeypatch.setattr(threads, "cores", lambda: 2)

    def work(item):
        if item:
            raise ValueError(str(item))

    with pytest.raises(ValueError, match="1"):
        in_threads(work, range(4))


ENDLESS = """
import signal, threading
from msbdb import threads
from msbdb.errors import MsbdbWarning, PassingNotice, collected_notices, give_notice
threads.cores = lambda: 2
at_work = threading.Barrier(3)
def interrupt():
    at_work.wait()
    signal.pthread_kill(threading.main_thread().ident, signal.SIGINT)
def work(_):
    at_work.wait()
    threading.Event().wait()
threading.Thread(target=interrupt, daemon=True).start()
try:
    threads.in_threads(work, range(2))
except KeyboardInterrupt:
    print("interrupted")
    threads.end_now(130)
"""


def test_an_interruption_does_not_wait_for_threads():
    """The program ends while two threads work without end, and what it printed is there."""
    done = subprocess.run([sys.executable, "-c", ENDLESS], capture_output=True, text=True, timeout=60, check=False)
    assert (done.returncode, done.stdout.strip(), done.stderr) == (130, "interrupted", "")


def test_at_least_one_core_is_known():
    """On every system."""
    assert threads.cores() >= 1


def test_pools_within_pools_hide_what_rasterio_hides_and_put_the_filters_back(monkeypatch):
    """Its warnings never come through, another does, and all filters are as before."""
    monkeypatch.setattr(threads, "cores", lambda: 2)

    def warn(words):
        time.sleep(0.001)
        warnings.warn(words, UserWarning, stacklevel=1)

    def inner(words):
        in_threads(warn, [words] * 3)

    before = list(warnings.filters)
    in_threads(
        inner, ["Dataset has no geotransform, gcps, or rpcs.", "The given matrix is equal to Affine.identity"] * 2
    )
    with pytest.raises(UserWarning, match="something else"):
        in_threads(inner, ["something else"] * 2)
    assert warnings.filters == before


def test_stages_side_by_side_share_the_time_that_they_took_together():
    """So that the seconds of all stages add up to those of the whole."""
    stages = Stages(None)
    begin = time.perf_counter()
    with stages.stage("read"):
        time.sleep(0.01)
    with stages.side_by_side():
        both = threading.Barrier(2, timeout=10)

        def work(name):
            with stages.stage(name):
                both.wait()
                time.sleep(0.05)

        pair = [threading.Thread(target=work, args=(name,)) for name in ("adaptive", "area3d")]
        for thread in pair:
            thread.start()
        for thread in pair:
            thread.join()
    assert sum(stages.timings.values()) <= time.perf_counter() - begin
    assert stages.timings["adaptive"] >= 0.02
    assert stages.timings["area3d"] == pytest.approx(stages.timings["adaptive"], rel=0.5)


@pytest.mark.skipif(not hasattr(ctypes.CDLL(None), "mallopt"), reason="the allocator is not glibc's")
def test_freed_memory_serves_the_next_array():
    """The second array of a size touches few new pages, and after the block the process is as small as before."""
    size, page = 1 << 26, resource.getpagesize()

    def faults_of_an_array() -> int:
        before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
        np.empty(size, dtype=np.uint8)[::page] = 1
        return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before

    with memory_reused():
        first, second = faults_of_an_array(), faults_of_an_array()
        held = Path("/proc/self/statm").read_text().split()[1]
    assert second < first / 10
    assert int(Path("/proc/self/statm").read_text().split()[1]) < int(held) - size / page / 2


@pytest.mark.skipif(not hasattr(ctypes.CDLL(None), "mallopt"), reason="the allocator is not glibc's")
def test_memory_is_fetched_ahead_and_kept_until_the_outer_block_ends():
    """An array touches few new pages then; a block within the block gives nothing back."""
    size, page = 1 << 27, resource.getpagesize()

    def held() -> int:
        return int(Path("/proc/self/statm").read_text().split()[1]) * page

    before = held()
    with memory_reused(ahead=size):
        for thread in threading.enumerate():
            if thread.name == FETCHING:
                thread.join()
        assert held() > before + size / 2
        faults = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
        with memory_reused():
            np.empty(size // 2, dtype=np.uint8)[::page] = 1
        assert resource.getrusage(resource.RUSAGE_SELF).ru_minflt < faults + size / page / 20
        assert held() > before + size / 2
    assert held() < before + size / 2


@pytest.mark.skipif(not hasattr(ctypes.CDLL(None), "mallopt"), reason="the allocator is not glibc's")
def test_fetching_memory_ends_with_the_block():
    """An error in the block does not wait for a header's promise of points to be fetched."""
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(KeyError), memory_reused(ahead=1 << 31):
        raise KeyError
    assert all(thread.name != FETCHING for thread in threading.enumerate())
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss < before + 2**19, "in KiB: a quarter was not fetched yet"


@pytest.mark.skipif(not hasattr(ctypes.CDLL(None), "mallopt"), reason="the allocator is not glibc's")
def test_large_arrays_go_back_where_memory_is_bounded():
    """As soon as one is freed, also from between others."""
    size, page = 1 << 26, resource.getpagesize()

    def held() -> int:
        return int(Path("/proc/self/statm").read_text().split()[1]) * page

    with memory_reused(bounded=True):
        arrays = [np.ones(size, dtype=np.uint8) for _ in range(3)]
        before = held()
        del arrays[1]
        assert held() < before - size / 2


def test_notices_of_threads_come_in_the_order_of_the_items(monkeypatch):
    """Also while another thread records all warnings, as compilers do: each notice is collected once."""
    monkeypatch.setattr(threads, "cores", lambda: 2)
    others_record, told = threading.Event(), threading.Event()

    def work(item):
        if item == 0:
            with warnings.catch_warnings(record=True):
                others_record.set()
                told.wait(10)
            give_notice("first")
        else:
            others_record.wait(10)
            give_notice("second", PassingNotice)
            told.set()
        return item

    with collected_notices() as found:
        assert in_threads(work, range(2)) == [0, 1]
    assert [(type(notice), str(notice)) for notice in found] == [(MsbdbWarning, "first"), (PassingNotice, "second")]


def test_a_program_ends_without_a_search_for_garbage():
    """What is there at the end is left out of the last search; while it runs, the program searches seldom."""
    code = (
        "import atexit, gc\n"
        "from msbdb.threads import RARELY, own_process\n"
        "before = gc.get_freeze_count()\n"
        "atexit.register(lambda: print(gc.get_freeze_count() > before + 1000))\n"
        "own_process()\n"
        "print(gc.get_threshold() == RARELY, gc.get_freeze_count() == before)\n"
    )
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert ended.stdout.split() == ["True"] * 3
