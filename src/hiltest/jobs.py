"""Work in numbered pieces, shared by processes of this machine or by the workers of a dask.distributed scheduler.

What a piece gives must follow from what all have in common and from its number: a piece may then be done anywhere, in
any order, and again where a worker died over it. One result of each comes back.
"""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Executor, ProcessPoolExecutor, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from importlib.metadata import PackageNotFoundError, version
from itertools import islice
from queue import Empty, SimpleQueue
from time import monotonic
from typing import Any, TypeVar
from uuid import uuid4

from hiltest import __version__
from hiltest.errors import ConfigError, HiltestError, SchedulerError

Common = TypeVar("Common")
Result = TypeVar("Result")

ANSWER_S = 10.0
"""How long a scheduler may take to answer."""
NO_WORKER_S = 60.0
"""How long a scheduler may be without workers while there is work; to get them may take it a while."""
_ASK_AGAIN_S = 1.0
_LISTEN_S = 0.2
# Pieces at the scheduler for each thread of its workers: one that is done, and one to go on with meanwhile.
_PER_THREAD = 2
# Without workers: so many may be asked for by a scheduler that starts them as there is work.
_FEWEST = 4


def each_done(
    do: Callable[[Common, int], Result], common: Common, pieces: Iterable[int], jobs: int | str, *, kept: str,
    starts_process: bool = False, asked_to_end: Callable[[], bool] = lambda: False,
) -> Iterator[tuple[int, Result]]:
    """Yield the number and the result of each piece, as it gets done.

    Parameters
    ----------
    do
        Called with what all pieces have in common and a piece's number. With both, it can be pickled.
    pieces
        Each number once.
    jobs
        How many pieces at a time on this machine, or the address of a dask scheduler whose workers do them.
    kept
        What is left of the pieces that are done when the others cannot be, for the message.
    starts_process
        Whether `do` only waits for a process that it starts: then it needs none of its own beside.
    asked_to_end
        Whether to begin no more pieces. Those begun on this machine are waited for, those sent elsewhere dropped.

    Raises
    ------
    HiltestError
        If a process of this machine was ended from outside.
    SchedulerError
        If no scheduler answers at the address, no workers come, one after the other dies over a piece, or it is lost.
    ConfigError
        If the extra ``dask`` is not installed, or one there has no hiltest or another version.
    """
    if isinstance(jobs, str):
        return _by_scheduler(do, common, pieces, jobs, kept, asked_to_end)
    if jobs == 1 and not starts_process:
        return _here(do, common, pieces, asked_to_end)
    pool = (ThreadPoolExecutor(jobs) if starts_process
            else ProcessPoolExecutor(jobs, initializer=_leave_interruption_to_parent))  # fmt: skip
    return _by_pool(do, common, pieces, pool, jobs, kept, asked_to_end)


def _here(
    do: Callable[[Common, int], Result], common: Common, pieces: Iterable[int], asked_to_end: Callable[[], bool]
) -> Iterator[tuple[int, Result]]:
    for piece in pieces:
        if asked_to_end():
            return
        yield piece, do(common, piece)


def _by_pool(
    do: Callable[[Common, int], Result], common: Common, pieces: Iterable[int], pool: Executor, jobs: int, kept: str,
    asked_to_end: Callable[[], bool],
) -> Iterator[tuple[int, Result]]:
    def room() -> int:
        """One piece more than processes: what was asked to end has little to wait for."""
        return 0 if asked_to_end() else jobs + 1

    try:
        yield from _windowed(lambda piece: pool.submit(do, common, piece), room, pieces, {})
    except BrokenProcessPool as error:
        raise HiltestError(f"a worker's process was ended from outside, as for want of memory; {kept}") from error
    finally:
        pool.shutdown(cancel_futures=True)


def _leave_interruption_to_parent() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def _windowed(
    submit: Callable[[int], Any], room: Callable[[], int], pieces: Iterable[int], going: dict[Any, int]
) -> Iterator[tuple[int, Any]]:
    """Keep as many pieces going as there is room for, and yield each that is done; those `going` have their number."""
    waiting, done = iter(pieces), SimpleQueue[Any]()
    while True:
        for piece in islice(waiting, max(room() - len(going), 0)):
            future = submit(piece)
            going[future] = piece
            future.add_done_callback(done.put)
        if not going:
            return
        try:
            future = done.get(timeout=_LISTEN_S)
        except Empty:
            continue
        yield going.pop(future), future.result()


def _by_scheduler(
    do: Callable[[Common, int], Result], common: Common, pieces: Iterable[int], address: str, kept: str,
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
        raise SchedulerError(address, f"nobody answers there ({error}). Start it with dask scheduler, or name another "
                                      "with --jobs") from error  # fmt: skip
    going = dict[Any, int]()
    workers = _Workers(client, address, kept)
    # Keys of this command alone: nothing that another one asked for, with other files, is taken for its work.
    command, name = uuid4().hex, do.__name__.strip("_")

    def submit(piece: int) -> Any:
        return client.submit(_on_worker, do, __version__, shared, piece, key=f"{name}-{command}-{piece}")

    def room() -> int:
        if asked_to_end():
            going.clear()
            return 0
        return workers.room()

    try:
        _refuse_without_hiltest(client, address)
        # A task too: where all the workers that hold it died, the scheduler has it made again.
        shared = client.submit(_itself, common, key=f"common-{command}")
        yield from _windowed(submit, room, pieces, going)
    except KilledWorker as error:
        raise SchedulerError(address, f"workers died over one piece, one after the other ({error}); {kept}") from error
    except (CancelledError, CommClosedError) as error:
        raise workers.lost(error) from error
    finally:
        client.close()  # which drops whatever is not done


class _Workers:
    """The workers of a scheduler: how many pieces they can be given, and whether there are any."""

    def __init__(self, client: Any, address: str, kept: str) -> None:
        self._client, self._address, self._kept = client, address, kept
        self._asked_s, self._seen_s, self._threads = 0.0, monotonic(), 0

    def room(self) -> int:
        """Return how many pieces may be at the scheduler."""
        now_s = monotonic()
        if now_s - self._asked_s >= _ASK_AGAIN_S:
            self._asked_s, self._threads = now_s, self._ask()
        if self._threads:
            self._seen_s = now_s
        elif now_s - self._seen_s >= NO_WORKER_S:
            reason = f"it has had no worker for {NO_WORKER_S:g} s. Start some with dask worker {self._address}"
            raise SchedulerError(self._address, f"{reason}; {self._kept}")
        return max(_PER_THREAD * self._threads, _FEWEST)

    def _ask(self) -> int:
        try:
            if self._client.status != "running":
                raise ConnectionError(f"the connection is {self._client.status}")
            return sum(self._client.nthreads().values())
        except OSError as error:
            raise self.lost(error) from error

    def lost(self, error: Exception) -> SchedulerError:
        """Return the error of a scheduler that has answered and does no longer."""
        return SchedulerError(self._address, f"it is gone ({error}); {self._kept}")


def _refuse_without_hiltest(client: Any, address: str) -> None:
    """Ask for what each has installed with a function that all have: one that cannot load a piece dies of it."""
    lacking = [worker for worker, found in client.run(version, "hiltest", on_error="return").items()
               if isinstance(found, PackageNotFoundError)]  # fmt: skip
    try:
        client.run_on_scheduler(version, "hiltest")
    except PackageNotFoundError:
        lacking.insert(0, address)
    if lacking:
        raise ConfigError(f"hiltest is not installed at {', '.join(lacking)}: install hiltest {__version__} there, and "
                          "start it again")  # fmt: skip


def _itself(common: Common) -> Common:
    return common


def _on_worker(do: Callable[[Common, int], Result], asking: str, common: Common, piece: int) -> Result:
    """Do a piece, if this worker has the hiltest that asks for it."""
    if asking != __version__:
        from distributed import get_worker

        raise ConfigError(f"the worker {get_worker().address} has hiltest {__version__}, and this is {asking}: "
                          "install the same there and start it again")  # fmt: skip
    return do(common, piece)
