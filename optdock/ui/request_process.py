"""A process that answers the newest request of the page.

The owner sends one request at a time and keeps only the newest one that waits, so requests in between are dropped. The
process reads two numbers in shared memory while it plans: the newest request, and the newest one that is cancelled. It
ends a call that is cancelled, or that has run longer than a grace time although a newer request waits. The grace time
doubles after every call that ended in this way until one is completed, so that slow scenes are answered as well.

A costmap is sent only if it differs from the last one; problems are sent without the obstacles of the costmap, which
the process computes again.
"""

from __future__ import annotations

import atexit
import contextlib
import gc
import io
import logging
import multiprocessing
import pickle
import signal
import threading
import time
from collections import deque
from multiprocessing import resource_tracker
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

import numpy as np

from optdock.config.simulated_drive import WorldDeviations
from optdock.errors import InvalidValue, OptdockError
from optdock.model.costmap import Costmap
from optdock.model.problem import DockingProblem
from optdock.planning.pipeline import warm_up
from optdock.runner.workers import end_with_owner
from optdock.ui.drawn_plan import DrawnPlan, drawn_plan
from optdock.ui.driven_plan import DrivenPlan, driven_plan
from optdock.ui.hand_planning import HandPlanning, PlanRequest

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from ctypes import Array, c_int64
    from multiprocessing.connection import Connection
    from multiprocessing.context import SpawnProcess

    from optdock.config import Scenario

__all__ = ["RequestProcess", "UiAnswer"]

logger = logging.getLogger(__name__)

UiAnswer: TypeAlias = "DrawnPlan | DrivenPlan"

# [s] that a call may run although a newer request waits: most calls end earlier, and the picture follows the hand.
_GRACE = 0.15
_MOST_DOUBLED = 6  # times that the grace time doubles
_POLLED = 0.2  # [s] between the checks of a process that computes
_HANGS = 3.0  # [s] after a cancellation until a process that does not answer is replaced
_LONGEST = 60.0  # [s] beyond its time budget until a call counts as lost
_END_TIME = 2.0  # [s] for which the end of a process or thread is awaited
_MOST_KEPT = 100  # answers that are not fetched
_NEWEST, _CANCELLED = 0, 1  # places in the shared memory
_ARGUMENTS = (
    "start", "dock", "robot", "obstacles", "clearance", "start_speed", "start_curvature", "costmap", "frame",
    "unknown_is_obstacle", "start_acceleration",
)  # fmt: skip


class RequestProcess:
    """A process for the requests of one page; it starts at once and is replaced if it dies.

    The process ends with `close`, and also if its owner is killed. All methods return at once, except `warm_up`.

    Args:
        on_answer: Called in a thread of this object after every answer, which `answers` returns; None: nothing.
    """

    def __init__(self, on_answer: Callable[[], object] | None = None) -> None:
        self._on_answer = on_answer
        self._changed = threading.Condition()
        self._waiting: PlanRequest | None = None
        self._last, self._closed = 0, False
        self._answers: deque[UiAnswer] = deque(maxlen=_MOST_KEPT)
        self._numbers = multiprocessing.get_context("spawn").RawArray("q", 2)
        self._is_warm = threading.Event()
        self._worker = _Worker.start(self._numbers)
        self._thread = threading.Thread(target=self._serve, name="optdock-requests", daemon=True)
        self._thread.start()
        atexit.register(self.close)  # before multiprocessing ends the process, which would be reported

    @property
    def pid(self) -> int | None:
        """Process ID; None after `close`."""
        return None if self._closed else self._worker.process.pid

    def warm_up(self, timeout: float = 120.0) -> bool:
        """Wait until the libraries of the first process are loaded; return whether they are.

        Args:
            timeout: Longest time [s].
        """
        return self._is_warm.wait(timeout)

    def ask(
        self,
        scenario: Scenario,
        number: int,
        fingerprint: str,
        *,
        in_hand: bool = False,
        picture_only: bool = False,
    ) -> None:
        """Request a plan, instead of the request that waits.

        Args:
            scenario: The scenario.
            number: Number of the request, greater than all earlier ones.
            fingerprint: Text that the answer carries.
            in_hand: Whether the scene is being dragged; the last plan may then be deformed.
            picture_only: Whether words, tables and curves of the answer are left out.

        Raises:
            InvalidValue: If the number is not greater than all earlier ones, or the process is closed.
        """
        self._put(PlanRequest(number, fingerprint, scenario, in_hand, picture_only))

    def ask_drive(
        self,
        scenario: Scenario,
        number: int,
        fingerprint: str,
        world: WorldDeviations | None = None,
        seed: int = 0,
    ) -> None:
        """Request a simulated drive of the plan with this fingerprint, instead of the request that waits.

        Args:
            scenario: The scenario, which is planned first if the last plan has another fingerprint.
            number: Number of the request, greater than all earlier ones.
            fingerprint: Text that the answer carries.
            world: Noise, lag and latency; None: the usual ones.
            seed: Seed of the noise.

        Raises:
            InvalidValue: If the number is not greater than all earlier ones, or the process is closed.
        """
        self._put(PlanRequest(number, fingerprint, scenario, drive=(world or WorldDeviations(), seed)))

    def cancel(self) -> None:
        """End the running call and the request that waits; their answers have the outcome `cancelled`."""
        with self._changed:
            self._numbers[_CANCELLED] = self._last

    def answers(self) -> list[UiAnswer]:
        """Return the answers since the last call, at most 100, oldest first; their numbers increase."""
        found = []
        with contextlib.suppress(IndexError):
            while True:
                found.append(self._answers.popleft())
        return found

    def close(self) -> None:
        """End the process; requests are not answered any more."""
        with self._changed:
            if self._closed:
                return
            self._closed = True
            atexit.unregister(self.close)
            self._worker.alive.close()
            self._worker.process.kill()  # also while it still loads its libraries
            self._changed.notify_all()
        if threading.current_thread() is not self._thread:
            self._thread.join(_END_TIME)

    def _put(self, request: PlanRequest) -> None:
        with self._changed:
            if self._closed:
                raise InvalidValue("request: the process has been closed")
            if request.number <= self._last:
                raise InvalidValue(f"request.number: must be > {self._last}, got {request.number}")
            self._waiting, self._last = request, request.number
            self._numbers[_NEWEST] = request.number
            self._changed.notify_all()

    def _serve(self) -> None:
        """Send requests and receive answers until this object is closed."""
        with contextlib.suppress(EOFError, OSError):
            self._worker.wait_until_warm(self._is_given_up)
            self._is_warm.set()
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._closed or self._waiting is not None)
                request, self._waiting = self._waiting, None
                if self._closed or request is None:
                    break
            self._answers.append(self._answered(request))
            if self._on_answer is not None and not self._closed:
                try:
                    self._on_answer()
                except Exception:  # of the page; later answers may be shown
                    logger.exception("the page does not accept an answer")
        self._worker.end()

    def _answered(self, request: PlanRequest) -> UiAnswer:
        try:
            if not self._worker.process.is_alive():
                self._replace()
            return self._worker.answer(request, self._is_given_up)
        except Exception as error:  # it has ended or hangs, or the request cannot be pickled
            reason = _reason(error, self._worker)
            if not self._closed:
                logger.error("%s", reason)
            self._replace()
            return _lost(request, reason)

    def _is_given_up(self, number: int) -> bool:
        """Whether the answer to a request is not needed any more."""
        return self._closed or self._numbers[_CANCELLED] >= number

    def _replace(self) -> None:
        with self._changed:  # which `close` must not interrupt
            if not self._closed:
                self._worker.end()
                self._worker = _Worker.start(self._numbers)


class _Worker(NamedTuple):
    """A process, the line to it, the pipe with which it ends, and the state of the line."""

    process: SpawnProcess
    line: Connection
    alive: Connection
    sender: _Sender

    @classmethod
    def start(cls, numbers: Array[c_int64]) -> _Worker:
        context = multiprocessing.get_context("spawn")
        here, there = context.Pipe()
        watched, alive = context.Pipe(duplex=False)
        process = context.Process(target=_work, args=(there, watched, numbers), name="optdock-page", daemon=True)
        with _interrupts_blocked():
            process.start()
        there.close()
        watched.close()
        return cls(process, here, alive, _Sender())

    def wait_until_warm(self, is_given_up: Callable[[int], bool]) -> None:
        """Receive the first message of the process, unless it has been received."""
        if not self.sender.is_warm:
            self._received(0, _LONGEST, is_given_up)
            self.sender.is_warm = True

    def answer(self, request: PlanRequest, is_given_up: Callable[[int], bool]) -> UiAnswer:
        """Return the answer of the process.

        Raises:
            EOFError: If the process has ended; also as `OSError`.
            TimeoutError: If it does not answer.
        """
        self.wait_until_warm(is_given_up)
        self.line.send_bytes(self.sender.dumps(request))
        answer = pickle.loads(self._received(request.number, request.scenario.time_budget + _LONGEST, is_given_up))
        assert isinstance(answer, DrawnPlan | DrivenPlan)
        return answer

    def _received(self, number: int, most: float, is_given_up: Callable[[int], bool]) -> bytes:
        began = time.monotonic()
        ended = began + most
        while not self.line.poll(_POLLED):
            if number and is_given_up(number):
                ended = min(ended, time.monotonic() + _HANGS)
            if time.monotonic() > ended:
                raise TimeoutError(f"did not answer within {time.monotonic() - began:.1f} s")
        return self.line.recv_bytes()

    def end(self) -> None:
        """End the process at once."""
        self.alive.close()
        self.process.kill()
        self.process.join(_END_TIME)
        self.line.close()


@contextlib.contextmanager
def _interrupts_blocked() -> Iterator[None]:
    """Block SIGINT in processes that are started within the context; the owner ends them after Ctrl-C."""
    if not hasattr(signal, "pthread_sigmask"):  # Windows
        yield
        return
    resource_tracker.ensure_running()  # its start, at the first process, unblocks SIGINT
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _reason(error: Exception, worker: _Worker) -> str:
    """Return the reason why a process is replaced."""
    if isinstance(error, TimeoutError):
        return f"the planning process {error} and was started again"
    if isinstance(error, EOFError | OSError):
        worker.process.join(_POLLED)
        return f"the planning process has ended (exit code {worker.process.exitcode}) and was started again"
    return f"the request cannot be sent: {type(error).__name__}: {error}"


def _lost(request: PlanRequest, reason: str) -> UiAnswer:
    """Return the answer to a request during which the process ended."""
    asked, error = (request.number, request.fingerprint), OptdockError(reason)
    return driven_plan(asked, error) if request.drive else drawn_plan(asked, request.scenario.problem, error)


# Messages.


class _Sender:
    """Pickler of requests that sends every costmap once."""

    def __init__(self) -> None:
        self.is_warm = False
        self._sent: Costmap | None = None

    def dumps(self, request: PlanRequest) -> bytes:
        """Return the message of a request."""
        buffer = io.BytesIO()
        _RequestPickler(buffer, self._is_sent).dump(request)
        return buffer.getvalue()

    def _is_sent(self, costmap: Costmap) -> bool:
        """Whether a costmap equals the last one, and remember it."""
        last, self._sent = self._sent, costmap
        if last is None or (last.resolution, last.origin) != (costmap.resolution, costmap.origin):
            return False
        return last is costmap or np.array_equal(last.data, costmap.data)


class _RequestPickler(pickle.Pickler):
    def __init__(self, buffer: io.BytesIO, is_sent: Callable[[Costmap], bool]) -> None:
        super().__init__(buffer, pickle.HIGHEST_PROTOCOL)
        self._is_sent = is_sent

    def persistent_id(self, value: object) -> object:
        if not isinstance(value, Costmap):
            return None
        return () if self._is_sent(value) else (value.data, value.resolution, value.origin)

    def reducer_override(self, value: object) -> Any:  # noqa: ANN401 - as the base
        if not isinstance(value, DockingProblem):
            return NotImplemented
        return DockingProblem, tuple(getattr(value, name) for name in _ARGUMENTS)


class _Receiver:
    """Unpickler of requests that keeps the last costmap."""

    def __init__(self) -> None:
        self._costmap: Costmap | None = None

    def loads(self, message: bytes) -> PlanRequest:
        """Return the request of a message."""
        unpickler = pickle.Unpickler(io.BytesIO(message))
        unpickler.persistent_load = self._found  # type: ignore[method-assign]
        request = unpickler.load()
        assert isinstance(request, PlanRequest)
        return request

    def _found(self, parts: tuple[Any, ...]) -> Costmap:
        if parts:
            self._costmap = Costmap(*parts)
        assert self._costmap is not None
        return self._costmap


# The process.


def _work(line: Connection, alive: Connection, numbers: Array[c_int64]) -> None:
    """Answer requests until the owner closes `alive`."""
    end_with_owner(alive)
    planning, receiver, interrupted = HandPlanning(), _Receiver(), 0
    warm_up()
    gc.collect()
    gc.freeze()  # exclude all loaded objects from later collections
    with contextlib.suppress(EOFError, OSError):
        line.send_bytes(b"warm")
        while True:
            request = receiver.loads(line.recv_bytes())
            call = _Call(numbers, request.number, _grace(interrupted))
            answer = _computed(planning, request, call)
            interrupted = interrupted + 1 if call.is_superseded else 0
            line.send_bytes(pickle.dumps(answer, pickle.HIGHEST_PROTOCOL))
            # 1 ms; otherwise cycles with large arrays are kept for long, and the process grows to 500 MB.
            gc.collect()


def _grace(interrupted: int) -> float:
    """Return the grace time [s] after a number of successive calls that a newer request ended."""
    return _GRACE * 2.0 ** min(interrupted, _MOST_DOUBLED)


class _Call:
    """Cancel checker of one call.

    Args:
        numbers: Shared memory with the newest and the newest cancelled request.
        number: Number of the request.
        grace: Time for which the call may run although a newer request waits [s].
    """

    def __init__(self, numbers: Array[c_int64], number: int, grace: float) -> None:
        self._numbers, self._number = numbers, number
        self._ends = time.monotonic() + grace
        self.is_superseded = False

    def __call__(self) -> bool:
        """Whether to end the call."""
        self.is_superseded = self.is_superseded or (
            self._numbers[_NEWEST] > self._number and time.monotonic() > self._ends
        )
        return self.is_superseded or self._numbers[_CANCELLED] >= self._number


def _computed(planning: HandPlanning, request: PlanRequest, call: _Call) -> UiAnswer:
    try:
        return planning.answer(request, call)
    except Exception as error:  # the next request may succeed after any exception of a plugin
        logger.exception("a request fails")
        return _lost(request, f"the call failed: {type(error).__name__}: {error}")
