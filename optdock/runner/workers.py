"""Processes that compute cases: this process, processes of this machine, or the workers of a dask cluster."""

from __future__ import annotations

import functools
import hashlib
import json
import multiprocessing
import os
import pickle
import signal
import tempfile
import threading
import time
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from optdock import __version__
from optdock.deadline import ClockName, budget_clock
from optdock.errors import InvalidValue, MissingExtra
from optdock.io.guarded_file import MostBytes, read_bytes
from optdock.runner.cases import Outcome

if TYPE_CHECKING:
    from collections.abc import Callable
    from multiprocessing.connection import Connection

    from optdock.runner.cases import Case

__all__ = ["Workers", "end_with_owner"]

_AHEAD = 4  # cases in progress per worker, so that none waits for the next case
_ANSWER = 10.0  # [s] until a scheduler or the first worker of a cluster must have answered
_REFRESHED = 5.0  # [s] after which the workers of a cluster are counted again
_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
# Time budgets and the data of plugins belong to the process, and Python computes one case at a time anyway.
_ONE_AT_A_TIME = threading.Lock()


def prepare_planning() -> None:
    """Load the libraries of `plan_dock` and fill its caches, see `warm_up`."""
    from optdock.planning.pipeline import warm_up

    warm_up()


class Workers:
    """Processes for `run_cases`, which exist within a context.

    Each process computes one case at a time, also if it is a dask worker with several threads. For every case the clock
    of time budgets starts anew. Processes end with the context, and also if this process is killed.

    Args:
        count: Number of processes of this machine; 1: this process; None: one per available core.
        scheduler: Address of a dask scheduler, such as `tcp://10.0.0.1:8786`, instead of processes of this machine.
        clock: Clock of time budgets, see `optdock.deadline`.
        prepare: Function of a module that every process calls before its first case; None: nothing. It is not part of
            the CPU time of a case.

    Raises:
        InvalidValue: If `count` is less than 1 or given together with a scheduler. On entering the context, if the
            scheduler or a worker does not answer, a worker has another version of optdock, or no process starts.
        MissingExtra: On entering the context, if dask is not installed.
    """

    def __init__(
        self,
        count: int | None = None,
        scheduler: str | None = None,
        clock: ClockName = "cpu",
        prepare: Callable[[], object] | None = prepare_planning,
    ) -> None:
        if count is not None and (count < 1 or scheduler is not None):
            raise InvalidValue(f"workers: count must be at least 1, and not given with a scheduler, got {count}")
        self.count = 1 if scheduler is not None else count or _cores()
        self.scheduler, self.clock = scheduler, clock
        self._prepare = prepare
        self._executor: Executor | None = None
        self._client: Any = None
        self._alive: Connection | None = None
        self._folder: tempfile.TemporaryDirectory[str] | None = None  # of the shared arguments
        self._counted_at = 0.0
        self._environment: dict[str, str | None] = {}

    def __enter__(self) -> Workers:
        if self.scheduler is not None:
            self._client = _client(self.scheduler)
            self._executor = self._client.get_executor(pure=False)
        elif self.count == 1:
            self._executor = _ThisProcess()
        else:
            # Read when a process loads NumPy, which may be before any initializer runs.
            self._environment = {name: os.environ.get(name) for name in _THREADS}
            os.environ.update(dict.fromkeys(_THREADS, "1"))
            self._folder = tempfile.TemporaryDirectory(prefix="optdock-")
            self.restart()
        return self

    def __exit__(self, kind: object, *_: object) -> None:
        if self._client is not None:
            self._client.close()  # the scheduler discards the cases in progress
        else:
            self._end_processes(at_once=kind is not None)
        for name, value in self._environment.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
        if self._folder is not None:
            self._folder.cleanup()
        self._executor = self._client = self._folder = None
        self._environment = {}

    @property
    def capacity(self) -> int:
        """Number of cases that should be in progress: 1 in this process, otherwise four per worker."""
        if self._client is not None and time.monotonic() - self._counted_at > _REFRESHED:
            self.count, self._counted_at = max(1, len(self._client.nthreads())), time.monotonic()
        return 1 if isinstance(self._executor, _ThisProcess) else _AHEAD * self.count

    def task(self, function: Callable[..., object], shared: tuple[Any, ...]) -> Callable[[Case], Future[Outcome]]:
        """Return a function that submits a case and returns its future outcome.

        Args:
            function: Function to compute.
            shared: First arguments of the function in every case.

        Raises:
            InvalidValue: If the context has not been entered.
        """
        if self._executor is None:
            raise InvalidValue("workers: are not running; use them as a context: 'with Workers() as workers:'")
        given, digest = self._given(shared)
        how = _How(function, self.clock, self._prepare, digest)

        def submit(case: Case) -> Future[Outcome]:
            assert self._executor is not None
            try:
                return self._executor.submit(_computed, how, given, case)
            except (BrokenProcessPool, OSError) as error:  # OSError: the pool breaks while it starts a process
                lost: Future[Outcome] = Future()
                lost.set_exception(BrokenProcessPool(str(error)))
                return lost

        return submit

    def _given(self, shared: tuple[Any, ...]) -> tuple[Any, str]:
        """Return what is sent with every case instead of the shared arguments, and their digest."""
        if isinstance(self._executor, _ThisProcess):
            return shared, ""
        content = pickle.dumps(shared)
        digest = hashlib.sha256(content).hexdigest()
        if self._client is not None:  # unlike scattered data, computed again if lost
            return self._client.submit(_same, content, pure=False), digest
        assert self._folder is not None
        target = Path(self._folder.name) / digest
        if not target.exists():
            target.write_bytes(content)
        return target, digest

    def restart(self) -> None:
        """Replace the processes of this machine by new ones.

        Raises:
            InvalidValue: If no process starts.
        """
        self._end_processes(at_once=True)
        context = multiprocessing.get_context("spawn")
        watched, self._alive = context.Pipe(duplex=False)
        self._executor = ProcessPoolExecutor(self.count, context, initializer=end_with_owner, initargs=(watched,))
        try:
            self._executor.submit(_version).result()
        except BrokenProcessPool:
            raise InvalidValue(
                "workers: no process starts; in a script, call the run below \"if __name__ == '__main__':\""
            ) from None

    def _end_processes(self, *, at_once: bool) -> None:
        if at_once and self._alive is not None:
            self._alive.close()
        if self._executor is not None:
            self._executor.shutdown(cancel_futures=at_once)
        if self._alive is not None:
            self._alive.close()
            self._alive = None


class _ThisProcess(Executor):
    """Executor that computes each case when it is submitted."""

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:  # noqa: ANN401 - as the base
        future: Future[Any] = Future()
        future.set_result(fn(*args, **kwargs))
        return future


def end_with_owner(alive: Connection) -> None:
    """End this process at once when the other end of a connection is closed, also if its owner is killed.

    Args:
        alive: Receiving end of a pipe on which nothing is sent.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # ctrl-C reaches the whole group; the parent ends this process

    def watch() -> None:
        alive.poll(None)
        os._exit(1)

    threading.Thread(target=watch, name="optdock-end", daemon=True).start()


class _How(NamedTuple):
    """How the cases of a run are computed; `digest`: of the pickled shared arguments."""

    function: Callable[..., object]
    clock: ClockName
    prepare: Callable[[], object] | None
    digest: str


def _computed(how: _How, shared: tuple[Any, ...] | bytes | Path, case: Case) -> Outcome:
    """Compute a case in a worker; its value is converted to JSON and back, so that resumed outcomes are the same."""
    with _ONE_AT_A_TIME:
        if how.prepare is not None:
            _prepared(how.prepare)
        first = shared if isinstance(shared, tuple) else _restored(how.digest, shared)
        with budget_clock(how.clock):
            began, value, error = time.process_time(), None, ""
            try:
                value = json.loads(json.dumps(how.function(*first, *case.arguments), allow_nan=False))
            except (Exception, SystemExit) as raised:
                error = f"{type(raised).__name__}: {' '.join(str(raised).split())}"
            return Outcome(case.key, value, error, time.process_time() - began)


@functools.cache
def _prepared(prepare: Callable[[], object]) -> None:
    prepare()


_RESTORED: dict[str, tuple[Any, ...]] = {}  # latest shared arguments by their digest


def _restored(digest: str, shared: bytes | Path) -> tuple[Any, ...]:
    """Return shared arguments, which are restored once for all successive runs with equal ones.

    Args:
        digest: Digest of the pickled arguments.
        shared: The pickled arguments, or a file that contains them.
    """
    if digest not in _RESTORED:
        _RESTORED.clear()
        _RESTORED[digest] = pickle.loads(
            shared if isinstance(shared, bytes) else read_bytes(shared, MostBytes.OUTCOMES)
        )
    return _RESTORED[digest]


def _cores() -> int:
    """Return the number of cores that this process may use."""
    affinity = getattr(os, "sched_getaffinity", None)  # missing on some systems
    return len(affinity(0)) if affinity is not None else os.cpu_count() or 1


def _client(scheduler: str) -> Any:  # noqa: ANN401 - dask has no types
    """Return a connection to a scheduler whose workers have this version of optdock."""
    try:
        from distributed import Client
    except ImportError as error:
        raise MissingExtra("a cluster needs dask: pip install 'optdock[cluster]'") from error
    try:
        client = Client(scheduler, timeout=_ANSWER, set_as_default=False)
    except (OSError, ValueError, TypeError) as error:
        raise InvalidValue(f"{scheduler}: no dask scheduler answers within {_ANSWER:g} s: {error}") from None
    try:
        client.wait_for_workers(1, timeout=_ANSWER)
        found = client.run(_version, on_error="return")
    except TimeoutError:
        client.close()
        raise InvalidValue(f"{scheduler}: the scheduler has no worker; start 'dask worker {scheduler}'") from None
    except BaseException:
        client.close()
        raise
    other = {worker: version for worker, version in found.items() if version != __version__}
    if other:
        client.close()
        listed = ", ".join(f"{worker}: {version}" for worker, version in other.items())
        raise InvalidValue(f"{scheduler}: not all workers have optdock {__version__}: {listed}")
    return client


def _same(content: bytes) -> bytes:
    return content


def _version() -> str:
    return __version__
