"""Workers for tiles: a cluster of dask.distributed on this machine, or one that is there; the only home of dask."""

import json
import logging
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

from msbdb.errors import FileError, MissingDependencyError, ParameterError, TilesError
from msbdb.scale.tilework import Outcome, TileTask, work
from msbdb.threads import own_process

if TYPE_CHECKING:
    from distributed import Client

logger = logging.getLogger(__name__)

RETRIES = 1
"""Ours: a tile is tried so often again: a network drive or a server may fail once."""

AHEAD = 2
"""Tiles that are given to the cluster for each worker, so that none waits for the next."""

TIMEOUT_S = 20.0
"""Seconds to wait for a scheduler."""

LOST = (
    "The scheduler of the cluster is lost. The tiles that are done wait. Start a cluster again, and repeat the command "
    "with --resume."
)

MISSING = 'A build by workers needs dask.distributed, which is not installed. Install it: pip install "msbdb[cluster]".'


def cluster_of(
    workers: int | None, scheduler: str | None, *, processes: bool = True
) -> AbstractContextManager["Client"]:
    """Return what starts workers on this machine, or connects to a scheduler that is there, while its block runs.

    Parameters
    ----------
    workers : int or None
        Number of workers on this machine, each a process. They listen on the loopback interface alone.
    scheduler : str or None
        Address of a scheduler, such as ``tcp://10.0.0.5:8786``, or its file.
    processes : bool
        False has the workers be threads of this process, which is for tests.

    Raises
    ------
    MissingDependencyError
        When dask.distributed is not installed.
    ParameterError
        For no worker.
    FileError
        When the block begins, and the scheduler cannot be reached.
    """
    if find_spec("distributed") is None:
        raise MissingDependencyError(MISSING)
    if scheduler is None and (workers is None or workers < 1):
        msg = f"A build needs one worker or more; got {workers}. Give --workers 2 for instance."
        raise ParameterError(msg)
    return _cluster(workers, scheduler, processes)


def dask_setup(_worker: object) -> None:
    """Prepare the process of a worker: dask calls this in each one that it starts, when it has loaded this module."""
    own_process()


@contextmanager
def _cluster(workers: int | None, scheduler: str | None, processes: bool) -> Iterator["Client"]:
    """Start or connect, see `cluster_of`."""
    from distributed import Client, LocalCluster

    if scheduler is not None:
        try:
            # A client would wait for ever for a file that does not come.
            address = json.loads(Path(scheduler).read_text())["address"] if scheduler.endswith(".json") else scheduler
            client = Client(address, timeout=TIMEOUT_S, set_as_default=False)
        except (OSError, ValueError, KeyError) as error:
            msg = f"The scheduler {scheduler} cannot be reached: {error}. Check its address, and that it runs."
            raise FileError(msg) from error
        with client:
            logger.info("Dashboard of the cluster: %s", client.dashboard_link)
            yield client
        return
    with (
        LocalCluster(
            n_workers=workers,
            threads_per_worker=1,
            processes=processes,
            host="127.0.0.1" if processes else None,
            # Any free port: without an address dask takes 8787, which another cluster may have.
            dashboard_address="127.0.0.1:0",
            memory_limit=0,
            # All that tiles need, which takes seconds.
            preload=[__name__],
            silence_logs=logging.CRITICAL,
        ) as cluster,
        Client(cluster, set_as_default=False) as client,
    ):
        logger.info("Dashboard of the cluster: %s", client.dashboard_link)
        yield client


@dataclass(frozen=True, slots=True)
class Workers:
    """A cluster that begins and ends beside other work of this process.

    Parameters
    ----------
    client : callable
        Waits until the cluster has begun, and returns its client; its errors are those of `cluster_of`.
    dismiss : callable
        Begins to end the cluster, and does not wait for it.
    """

    client: Callable[[], "Client"]
    dismiss: Callable[[], None]


@contextmanager
def beginning(cluster: AbstractContextManager["Client"], *, aside: bool) -> Iterator[Workers]:
    """Begin a cluster, in a thread of its own if ``aside``, and yield it; it ends with the block, or when dismissed.

    Workers of this machine start on its other cores while the block makes a plan, and end while it merges tiles.

    Raises
    ------
    MsbdbError
        As `cluster_of`: at once, or where the block asks for the cluster.
    """
    with ExitStack() as ending, ThreadPoolExecutor(1) as pool:
        begun = pool.submit(ending.enter_context, cluster)
        if not aside:
            begun.result()
        ended: list[Future[None]] = []
        yield Workers(begun.result, lambda: ended.append(pool.submit(ending.close)))
        for end in ended:
            end.result()


@contextmanager
def _losing(client: "Client") -> Iterator[None]:
    """Name the loss of the scheduler, which shows in many ways: tiles are cancelled, or its answers lack something.

    Raises
    ------
    TilesError
        When the scheduler is lost while the block runs.
    """
    from distributed import CancelledError

    try:
        yield
    except CancelledError as lost:
        raise TilesError(LOST) from lost
    except Exception as lost:
        if client.status == "running":
            raise
        raise TilesError(LOST) from lost


def work_on(
    client: "Client", tasks: Sequence[TileTask], begin: Callable[[TileTask], None], share: int | None = None
) -> Iterator[Outcome]:
    """Have a cluster build tiles, and yield what became of each as it ends.

    Parameters
    ----------
    client : Client
        From `cluster_of`.
    tasks : sequence of TileTask
        The tiles in order.
    begin : callable
        Called when a tile is given to the cluster.
    share : int, optional
        Cores of each worker; by default as many as it has threads.

    Raises
    ------
    TilesError
        When the scheduler is lost.
    """
    from distributed import as_completed

    waiting = list(reversed(tasks))
    running = {}
    with _losing(client):
        workers = client.scheduler_info(n_workers=-1)["workers"]
    room = AHEAD * max(len(workers), 1)
    if share is None:
        share = min((worker["nthreads"] for worker in workers.values()), default=None)
    completed = as_completed(loop=client.loop)

    def give() -> None:
        task = waiting.pop()
        begin(task)
        key = f"msbdb-{task.status.survey}-{task.tile}-{os.getpid()}"
        with _losing(client):
            future = client.submit(work, replace(task, cores=share), key=key, pure=False, retries=RETRIES)
        running[future.key] = task
        completed.add(future)

    for _ in range(min(room, len(waiting))):
        give()
    for future in completed:
        task = running.pop(future.key)
        with _losing(client):
            error = future.exception()
            status = None if error is not None else future.result()
        yield task, status, "" if error is None else f"{type(error).__name__}: {error}"
        future.release()
        if waiting:
            give()
