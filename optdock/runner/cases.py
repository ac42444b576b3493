"""`run_cases`: apply a function to many cases and yield the outcomes in the order of the cases.

An outcome is stored as soon as it is known, and yielded as soon as all earlier cases have been yielded. Cases are read
from their iterable only a few at a time.
"""

from __future__ import annotations

import queue
from collections import deque
from concurrent.futures import CancelledError
from concurrent.futures.process import BrokenProcessPool
from typing import TYPE_CHECKING, Any, NamedTuple

from optdock.errors import InvalidValue, OptdockError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator
    from concurrent.futures import Future

    from optdock.runner.outcome_store import OutcomeStore
    from optdock.runner.workers import Workers

__all__ = ["Case", "Outcome", "run_cases"]

_KILLED_TWICE = "BrokenProcessPool: the worker process ended abruptly, also when it computed this case alone"


class Case(NamedTuple):
    """One case of a run: a key that is unique within the run, and the picklable arguments of the function."""

    key: str
    arguments: tuple[Any, ...] = ()


class Outcome(NamedTuple):
    """Result of a case.

    Args:
        key: Key of the case.
        value: Value of the function, as read from JSON: tuples have become lists; None after an error.
        error: Name of the class and message of the exception on one line; empty if there was none.
        cpu_seconds: CPU time of the case [s]; 0 if its worker process died.
    """

    key: str
    value: Any = None
    error: str = ""
    cpu_seconds: float = 0.0


def run_cases(
    function: Callable[..., object],
    cases: Iterable[Case],
    *,
    workers: Workers,
    shared: tuple[Any, ...] = (),
    store: OutcomeStore | None = None,
    progress: Callable[[str], None] | None = None,
) -> Iterator[Outcome]:
    """Yield the outcome of every case, in the order of the cases.

    An exception of the function becomes an outcome with an error. If a local worker process dies, the cases that were
    in progress are computed once more, one at a time; a case that ends its process again becomes an outcome with an
    error. On a cluster the scheduler repeats such cases, `distributed.scheduler.allowed-failures` times.

    Args:
        function: Function of a module that the workers can import. Its value must consist of dicts with string keys,
            lists, tuples, strings, finite numbers, booleans and None.
        cases: The cases, possibly a generator.
        workers: The processes to use, as an open context.
        shared: First arguments of the function in every case, such as the map and the robot. Each process restores them
            once, so that data that is cached in them is computed once per process.
        store: File of outcomes. The cases that it already contains are not computed again.
        progress: Called with the key of each case that is finished.

    Raises:
        InvalidValue: If a key occurs twice.
        InvalidFile: If an outcome cannot be stored.
        OptdockError: If the connection to the scheduler of the cluster is lost.
    """
    run = _Run(workers.task(function, shared), iter(cases), workers, store, progress)
    try:
        while run.fill():
            yield from run.ready()
            run.wait()
    finally:
        for future in run.running:
            future.cancel()


class _Run:
    """State of a run: the cases in progress and the outcomes that have not been yielded."""

    def __init__(
        self,
        submit: Callable[[Case], Future[Outcome]],
        cases: Iterator[Case],
        workers: Workers,
        store: OutcomeStore | None,
        progress: Callable[[str], None] | None,
    ) -> None:
        self.submit, self.workers, self.store, self.progress = submit, workers, store, progress
        self.running: dict[Future[Outcome], Case] = {}
        self._cases = cases
        self._known: set[str] = set()
        self._order: deque[str] = deque()  # keys of the cases that have been read and not yielded
        self._done: dict[str, Outcome] = {}
        self._ended: queue.SimpleQueue[Future[Outcome]] = queue.SimpleQueue()

    def fill(self) -> bool:
        """Begin cases until the workers are busy or an outcome can be yielded; return whether any case is left."""
        while len(self.running) < self.workers.capacity and not self._is_ready():
            case = next(self._cases, None)
            if case is None:
                break
            if case.key in self._known:
                raise InvalidValue(f"cases: key {case.key!r} occurs twice")
            self._known.add(case.key)
            self._order.append(case.key)
            self._begin(case)
        return bool(self._order)

    def ready(self) -> Iterator[Outcome]:
        """Yield the outcomes whose turn it is."""
        while self._is_ready():
            yield self._done.pop(self._order.popleft())

    def wait(self) -> None:
        """Wait until one of the cases in progress, if any, has ended, and record its outcome."""
        if not self.running:
            return
        future = self._ended.get()
        if future not in self.running:  # ended before a broken pool was replaced
            return
        outcome = _outcome(future, self.running[future])
        if outcome is None:
            self._repeat_alone()
        else:
            del self.running[future]
            self._record(outcome)

    def _is_ready(self) -> bool:
        return bool(self._order) and self._order[0] in self._done

    def _begin(self, case: Case) -> None:
        """Submit a case, unless its outcome is in the store."""
        known = self.store.earlier.pop(case.key, None) if self.store is not None else None
        if known is not None:
            self._finish(known)
            return
        future = self.submit(case)
        self.running[future] = case
        future.add_done_callback(self._ended.put)

    def _repeat_alone(self) -> None:
        """Record the cases that had ended when the pool broke, and compute the others in progress one at a time."""
        suspects: list[Case] = []
        for future, case in self.running.items():
            outcome = _outcome(future, case)
            if outcome is None:
                suspects.append(case)
            else:
                self._record(outcome)
        self.running.clear()
        self.workers.restart()
        for case in suspects:
            outcome = _outcome(self.submit(case), case)
            if outcome is None:
                outcome = Outcome(case.key, error=_KILLED_TWICE)
                self.workers.restart()
            self._record(outcome)

    def _record(self, outcome: Outcome) -> None:
        if self.store is not None:
            self.store.append(outcome)
        self._finish(outcome)

    def _finish(self, outcome: Outcome) -> None:
        self._done[outcome.key] = outcome
        if self.progress is not None:
            self.progress(outcome.key)


def _outcome(future: Future[Outcome], case: Case) -> Outcome | None:
    """Return the outcome of a case when it is known; None if its local worker process died.

    An exception of the transfer or of the cluster becomes an outcome with an error.
    """
    try:
        return future.result()
    except BrokenProcessPool:
        return None
    except CancelledError:
        raise OptdockError("the connection to the scheduler was lost; the same command continues the run") from None
    except Exception as error:
        return Outcome(case.key, error=f"{type(error).__name__}: {' '.join(str(error).split())}")
