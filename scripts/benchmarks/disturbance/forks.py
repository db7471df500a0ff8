"""Builds in forked processes, and what stops them.

A fork of a process that has everything imported starts in no time, so that many builds can be killed. Run as a
program, it takes one request a line, as JSON, and answers each with the exit code (negative for a signal) and what
was written to the standard error.
"""

import contextlib
import importlib
import json
import os
import pkgutil
import signal
import sys
import tempfile
import traceback
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any


def fork(action: Callable[[], int]) -> int:
    """Run an action in a forked process, with the signals as in a fresh one; return the process's number."""
    process = os.fork()
    if process:
        return process
    code = 99
    try:
        signal.signal(signal.SIGINT, signal.default_int_handler)
        code = action()
    except SystemExit as error:
        code = error.code if isinstance(error.code, int) else 1
    except BaseException:
        traceback.print_exc()
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)


def warm() -> None:
    """Load what a build loads, before any fork, and start no thread, which a fork would lack."""
    import alembic.command  # noqa: F401  (what msbdb loads in its functions)
    import numpy as np

    import msbdb
    from msbdb.morphology import area_opening

    for module in pkgutil.walk_packages(msbdb.__path__, "msbdb."):
        importlib.import_module(module.name)
    area_opening(np.ones((2, 2), dtype=np.int32), 1)


def end(process: int) -> None:
    """Kill a process that may have ended already, and forget it."""
    with contextlib.suppress(ProcessLookupError, ChildProcessError):
        os.kill(process, signal.SIGKILL)
        os.waitpid(process, 0)


def wait(process: int) -> int:
    """Wait for a process; return its exit code, or a signal's number below zero."""
    return os.waitstatus_to_exitcode(os.waitpid(process, 0)[1])


def stop_at(stage: str, done: int, number: int) -> None:
    """Have this process send itself a signal when a stage of the next build begins (done 0) or ends (done 1)."""
    from msbdb.cli import build

    def progress(name: str, steps: int, _total: int) -> None:
        if (name, bool(steps)) == (stage, bool(done)):
            signal.raise_signal(number)

    @contextlib.contextmanager
    def bars(*_: object) -> Iterator[Callable[[str, int, int], None]]:
        yield progress

    build.progress_bar = bars


def stop_in(place: str, nth: int, number: int, *, after: bool = False) -> None:
    """Have this process send itself a signal at the nth call of a function, written module:name."""
    where, _, name = place.partition(":")
    module = importlib.import_module(where)
    function, calls = getattr(module, name), 0

    def stopped(*args: Any, **values: Any) -> Any:
        nonlocal calls
        calls += 1
        if calls == nth and not after:
            signal.raise_signal(number)
        result = function(*args, **values)
        if calls == nth and after:
            signal.raise_signal(number)
        return result

    setattr(module, name, stopped)


def serve() -> None:
    """Answer requests: ``argv`` of the program, and ``stage``, ``place`` or neither for what stops it."""
    from msbdb.cli.main import cli

    warm()
    for line in sys.stdin:
        request = json.loads(line)

        def action(request: dict[str, Any] = request) -> int:
            os.dup2(messages.fileno(), 2)
            if "stage" in request:
                stop_at(request["stage"], request["done"], request["signal"])
            elif "place" in request:
                stop_in(request["place"], request["nth"], request["signal"], after=request.get("after", False))
            cli([*request["argv"]], prog_name="msbdb")
            return 0

        with tempfile.TemporaryFile() as messages, Path(os.devnull).open("w") as nothing:
            out = os.dup(1)
            os.dup2(nothing.fileno(), 1)
            code = wait(fork(action))
            os.dup2(out, 1)
            os.close(out)
            messages.seek(0)
            answer = {"code": code, "stderr": messages.read().decode()}
        sys.stdout.write(json.dumps(answer) + "\n")
        sys.stdout.flush()


if __name__ == "__main__":
    serve()
