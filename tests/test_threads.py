"""Work in threads."""

import threading
import time

import pytest

from msbdb import threads
from msbdb.threads import in_threads


@pytest.mark.parametrize("cores", [1, 3])
def test_results_come_in_the_order_of_the_items(monkeypatch, cores):
    """Also when the first item takes longest."""
    monkeypatch.setattr(threads, "cores", lambda: cores)

    def work(item):
        time.sleep(0.02 if item == 0 else 0)
        return item * 10

    assert in_threads(work, iter(range(7))) == [0, 10, 20, 30, 40, 50, 60]


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


def test_at_least_one_core_is_known():
    """On every system."""
    assert threads.cores() >= 1
