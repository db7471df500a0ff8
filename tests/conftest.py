"""Settings for all tests: their sizes, the random examples, no network, and that Ctrl-C reaches what they start."""

import os
import signal
import socket
import threading
from collections import defaultdict
from collections.abc import Iterable, Iterator
from pathlib import Path

import pytest
from hypothesis import settings

# The examples are the same each time, so that a failure is the change's; MSBDB_TEST_EXAMPLES=random looks for new ones.
settings.register_profile("default", max_examples=15, deadline=None, derandomize=True, print_blob=True)
settings.register_profile("ci", max_examples=40, deadline=None, derandomize=True, print_blob=True)
settings.register_profile("long", max_examples=100, deadline=None, derandomize=True, print_blob=True)
settings.register_profile("random", max_examples=100, deadline=None, print_blob=True)

# A shell that runs the tests in the background has them ignore the signal, which their children would inherit.
if threading.current_thread() is threading.main_thread() and signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the switches between the sizes."""
    sizes = parser.getgroup("sizes")
    sizes.addoption("--ci", action="store_true", help="run the tests marked long as well, with more random examples")
    sizes.addoption("--long", action="store_true", help="the same, with campaigns and on both kinds of database")
    sizes.addoption("--first", action="store_true", help="run the first test of each file alone")


def pytest_configure(config: pytest.Config) -> None:
    """Choose the random examples, before any test module is read."""
    size = next((name for name in ("long", "ci") if config.getoption(f"--{name}")), "default")
    settings.load_profile(os.environ.get("MSBDB_TEST_EXAMPLES", size))


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leave out what is beyond the size asked for; ``-m`` names tests of any size."""
    ci, every = config.getoption("--ci"), config.getoption("--long")
    beyond = {"campaign"} if ci else {"campaign", "long"}
    mark_twins(items, 2 if ci else 6)
    named = every or any(mark in config.getoption("-m") for mark in beyond)
    kept: list[pytest.Item] = []
    left_out: list[pytest.Item] = []
    seen: set[Path] = set()
    for item in items:
        is_beyond = not named and any(item.get_closest_marker(mark) for mark in beyond)
        is_later = config.getoption("--first") and item.path in seen
        (left_out if is_beyond or is_later else kept).append(item)
        if not is_beyond:
            seen.add(item.path)
    config.hook.pytest_deselected(items=left_out)
    items[:] = kept


def mark_twins(items: list[pytest.Item], every: int) -> None:
    """Mark as campaign one of two twins, of which one runs on SpatiaLite and the other on PostGIS.

    Of each file the first such test, and each so-many-th one after it, runs on PostGIS, where a test takes longer; the
    others run on SpatiaLite, and all do without a server.
    """
    has_server = bool(os.environ.get("MSBDB_TEST_POSTGIS"))
    by_id = {item.nodeid: item for item in items}
    seen: dict[Path, int] = defaultdict(int)
    for item in items:
        dialects = [value for value in _values(item) if isinstance(value, str) and value in ("spatialite", "postgis")]
        if "postgis" not in dialects or not item.get_closest_marker("postgis"):
            continue
        function, _, values = item.nodeid.partition("[")
        twin = by_id.get(f"{function}[{values.replace('postgis', 'spatialite')}")
        if seen[item.path] % every:
            item.add_marker(pytest.mark.campaign)
        elif has_server and twin is not None:
            twin.add_marker(pytest.mark.campaign)
        seen[item.path] += 1


def _values(item: pytest.Item) -> Iterable[object]:
    return item.callspec.params.values() if hasattr(item, "callspec") else ()


@pytest.fixture(scope="session", autouse=True)
def no_network() -> Iterator[None]:
    """Let no test of this process reach another machine; PostGIS is reached by libpq, which opens its own sockets."""

    def connect(own: socket.socket, address: object) -> None:
        if own.family != socket.AF_UNIX and not (isinstance(address, tuple) and address[0] == "127.0.0.1"):
            msg = f"A test connects to {address}; tests use no network."
            raise RuntimeError(msg)
        original(own, address)

    original = socket.socket.connect
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(socket.socket, "connect", connect)
        yield
