"""Settings for all tests: their two sizes, the random examples, no network, and that Ctrl-C reaches what they start."""

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
settings.register_profile("long", max_examples=100, deadline=None, derandomize=True, print_blob=True)
settings.register_profile("random", max_examples=100, deadline=None, print_blob=True)

# A shell that runs the tests in the background has them ignore the signal, which their children would inherit.
if threading.current_thread() is threading.main_thread() and signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the switch between the two sizes."""
    parser.addoption("--long", action="store_true", help="run the tests marked long as well, with more random examples")


def pytest_configure(config: pytest.Config) -> None:
    """Choose the random examples, before any test module is read."""
    size = "long" if config.getoption("--long") else "default"
    settings.load_profile(os.environ.get("MSBDB_TEST_EXAMPLES", size))


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leave the tests marked long out, unless they are asked for by ``--long`` or named by ``-m``."""
    mark_twins(items)
    if config.getoption("--long") or "long" in config.getoption("-m"):
        return
    left_out = [item for item in items if item.get_closest_marker("long")]
    config.hook.pytest_deselected(items=left_out)
    items[:] = [item for item in items if not item.get_closest_marker("long")]


def mark_twins(items: list[pytest.Item]) -> None:
    """Mark as long one of two twins, of which one runs on SpatiaLite and the other on PostGIS.

    Of each file the first such test, and each sixth one after it, runs on PostGIS, where a test takes thrice as long;
    the others run on SpatiaLite, and all do without a server.
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
        if seen[item.path] % 6:
            item.add_marker(pytest.mark.long)
        elif has_server and twin is not None:
            twin.add_marker(pytest.mark.long)
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
