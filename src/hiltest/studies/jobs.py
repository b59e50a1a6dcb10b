"""Distribution of numbered pieces of work to local processes, or to the workers of a dask.distributed scheduler.

The result of a piece must depend only on the common argument and the number of the piece. A piece can then be computed
anywhere, in any order, and repeated if its worker dies. The caller receives one result per piece.
"""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Executor, ProcessPoolExecutor, ThreadPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from importlib.metadata import PackageNotFoundError, version
from itertools import islice
from multiprocessing import parent_process
from queue import Empty, SimpleQueue
from time import monotonic
from typing import Any, TypeVar
from uuid import uuid4

from hiltest import __version__
from hiltest.errors import ConfigError, HiltestError, SchedulerError
from hiltest.processes import end_children
from hiltest.run_record.exit_codes import ExitCode

Common = TypeVar("Common")
Result = TypeVar("Result")

ANSWER_S = 10.0
"""Time limit for the first answer of a scheduler [s]."""
NO_WORKER_S = 60.0
"""Time limit for a scheduler to have workers while there is work [s]; some schedulers need time to start workers."""
_ASK_AGAIN_S = 1.0
_LISTEN_S = 0.2
# Submitted pieces per thread of the workers: one is computed, and one waits.
_PER_THREAD = 2
# Submitted pieces without workers, since some schedulers start workers only if pieces wait.
_FEWEST = 4


def compute_pieces(
    do: Callable[[Common, int], Result],
    common: Common,
    pieces: Iterable[int],
    jobs: int | str,
    *,
    remark: str,
    starts_process: bool = False,
    asked_to_end: Callable[[], bool] = lambda: False,
) -> Iterator[tuple[int, Result]]:
    """Compute pieces in parallel; yield number and result of each piece when it is finished.

    Parameters
    ----------
    do
        Function of the common argument and the number of a piece. Function and argument must be picklable.
    pieces
        Numbers of the pieces, which must be distinct.
    jobs
        Number of parallel pieces on this machine, or the address of a dask scheduler whose workers compute the pieces.
    remark
        Remark on saved pieces, for error messages.
    starts_process
        True if `do` only waits for a process that it starts; it then runs in a thread.
    asked_to_end
        Function that returns True to stop. Pieces that run on this machine are finished, and all others are dropped.

    Raises
    ------
    HiltestError
        If a process of this machine was killed.
    SchedulerError
        If no scheduler answers at the address, it has no workers, several workers die while computing one piece, or the
        connection is lost.
    ConfigError
        If the extra ``dask`` is not installed, or if scheduler or workers do not have this version of hiltest.
    """
    if isinstance(jobs, str):
        return _run_by_scheduler(do, common, pieces, jobs, remark, asked_to_end)
    if jobs == 1 and not starts_process:
        return _run_locally(do, common, pieces, asked_to_end)
    pool = (
        ThreadPoolExecutor(jobs)
        if starts_process
        else ProcessPoolExecutor(jobs, initializer=_leave_interruption_to_parent)
    )
    return _run_in_pool(do, common, pieces, pool, jobs, remark, asked_to_end)


def _run_locally(
    do: Callable[[Common, int], Result], common: Common, pieces: Iterable[int], asked_to_end: Callable[[], bool]
) -> Iterator[tuple[int, Result]]:
    for piece in pieces:
        if asked_to_end():
            return
        yield piece, do(common, piece)


def _run_in_pool(
    do: Callable[[Common, int], Result],
    common: Common,
    pieces: Iterable[int],
    pool: Executor,
    jobs: int,
    remark: str,
    asked_to_end: Callable[[], bool],
) -> Iterator[tuple[int, Result]]:
    def room() -> int:
        """Return one more than the number of processes, so that few pieces remain when an end is requested."""
        return 0 if asked_to_end() else jobs + 1

    running = dict[Any, int]()
    try:
        yield from _yield_results(lambda piece: pool.submit(do, common, piece), room, pieces, running)
    except BrokenProcessPool as error:
        raise HiltestError(f"a worker process was killed, possibly because memory ran out; {remark}") from error
    finally:
        pool.shutdown(wait=False, cancel_futures=True)
        while not all(future.done() for future in running):
            end_children()  # also of a thread that was just about to start one
            wait(running, timeout=_LISTEN_S)
        pool.shutdown()


def _leave_interruption_to_parent() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    for number in (signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_DFL)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    """End this process when its parent has ended: other workers keep the queue open, which would never end."""
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(ExitCode.INTERRUPTED)


def _yield_results(
    submit: Callable[[int], Any], room: Callable[[], int], pieces: Iterable[int], running: dict[Any, int]
) -> Iterator[tuple[int, Any]]:
    """Submit pieces up to `room()`, and yield each finished one; `running` maps futures to numbers."""
    waiting, done = iter(pieces), SimpleQueue[Any]()
    while True:
        for piece in islice(waiting, max(room() - len(running), 0)):
            future = submit(piece)
            running[future] = piece
            future.add_done_callback(done.put)
        if not running:
            return
        try:
            future = done.get(timeout=_LISTEN_S)
        except Empty:
            continue
        yield running.pop(future), future.result()


def _run_by_scheduler(
    do: Callable[[Common, int], Result],
    common: Common,
    pieces: Iterable[int],
    address: str,
    remark: str,
    asked_to_end: Callable[[], bool],
) -> Iterator[tuple[int, Result]]:
    try:
        from distributed import CancelledError, Client, KilledWorker
        from distributed.comm import CommClosedError
    except ImportError as error:
        raise ConfigError(f"--jobs {address} needs dask ({error}): pip install 'hiltest[dask]'") from error
    try:
        client = Client(address, timeout=ANSWER_S, set_as_default=False, name="hiltest")
    except OSError as error:
        raise SchedulerError(
            address, f"no scheduler answers ({error}). Start it with dask scheduler, or name another with --jobs"
        ) from error
    running = dict[Any, int]()
    workers = _Workers(client, address, remark)
    # The keys are unique to this command, so that dask does not reuse results of another command with other files.
    command, name = uuid4().hex, do.__name__.strip("_")

    def submit(piece: int) -> Any:
        return client.submit(_run_on_worker, do, __version__, shared, piece, key=f"{name}-{command}-{piece}")

    def room() -> int:
        if asked_to_end():
            running.clear()
            return 0
        return workers.room()

    try:
        _refuse_without_hiltest(client, address)
        # As a task, the common argument can be recomputed by the scheduler if all workers that have it die.
        shared = client.submit(_identity, common, key=f"common-{command}")
        yield from _yield_results(submit, room, pieces, running)
    except KilledWorker as error:
        raise SchedulerError(
            address, f"several workers died while computing the same piece ({error}); {remark}"
        ) from error
    except (CancelledError, CommClosedError) as error:
        raise workers.lost(error) from error
    finally:
        client.close()  # drops all unfinished pieces


class _Workers:
    """The workers of a scheduler: the number of pieces to submit, and a time limit for a scheduler without workers."""

    def __init__(self, client: Any, address: str, remark: str) -> None:
        self._client, self._address, self._remark = client, address, remark
        self._asked_s, self._present_s, self._threads = 0.0, monotonic(), 0

    def room(self) -> int:
        """Return the number of pieces that may be submitted at a time."""
        now_s = monotonic()
        if now_s - self._asked_s >= _ASK_AGAIN_S:
            self._asked_s, self._threads = now_s, self._ask()
        if self._threads:
            self._present_s = now_s
        elif now_s - self._present_s >= NO_WORKER_S:
            reason = f"no worker for {NO_WORKER_S:g} s. Start workers with dask worker {self._address}"
            raise SchedulerError(self._address, f"{reason}; {self._remark}")
        return max(_PER_THREAD * self._threads, _FEWEST)

    def _ask(self) -> int:
        try:
            if self._client.status != "running":
                raise ConnectionError(f"the connection is {self._client.status}")
            return sum(self._client.nthreads().values())
        except OSError as error:
            raise self.lost(error) from error

    def lost(self, error: Exception) -> SchedulerError:
        """Return the error for a lost connection."""
        return SchedulerError(self._address, f"the connection was lost ({error}); {self._remark}")


def _refuse_without_hiltest(client: Any, address: str) -> None:
    """Check that hiltest is installed everywhere, because a worker that cannot load a piece dies."""
    lacking = [
        worker
        for worker, answer in client.run(version, "hiltest", on_error="return").items()
        if isinstance(answer, PackageNotFoundError)
    ]
    try:
        client.run_on_scheduler(version, "hiltest")
    except PackageNotFoundError:
        lacking.insert(0, address)
    if lacking:
        raise ConfigError(
            f"hiltest is not installed at {', '.join(lacking)}: install hiltest {__version__} there, and restart dask"
        )


def _identity(common: Common) -> Common:
    return common


def _run_on_worker(do: Callable[[Common, int], Result], requested_version: str, common: Common, piece: int) -> Result:
    """Compute a piece if this worker has the same version of hiltest."""
    if requested_version != __version__:
        from distributed import get_worker

        raise ConfigError(
            f"the worker {get_worker().address} has hiltest {__version__}, but this machine has {requested_version}: "
            "install the same version there, and restart the worker"
        )
    return do(common, piece)
