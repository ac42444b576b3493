"""Planning in a separate process, which avoids the pauses of milliseconds caused by planning in a thread.

`ThreadPlanning(process.planned)` sends jobs to the process. Every costmap and motion is sent only once, so the values
cached in these objects remain available in both processes.
"""

from __future__ import annotations

import contextlib
import gc
import io
import logging
import multiprocessing
import pickle
import signal
import threading
from collections import OrderedDict
from typing import TYPE_CHECKING, NamedTuple

from optdock.executor.planning import DrivenMotion, Job, Outcome, PlanResult, planned
from optdock.model.costmap import Costmap
from optdock.planning.pipeline import warm_up

if TYPE_CHECKING:
    from collections.abc import Callable
    from multiprocessing.connection import Connection
    from multiprocessing.context import SpawnProcess

__all__ = ["PlanningProcess"]

logger = logging.getLogger(__name__)

_SENT = 16  # sent objects that a side keeps for references from the other side
_RECEIVED = 8  # received objects that a side refers to: fewer, because the other side may have sent more meanwhile
_WARM_UP_TIME = 120.0  # [s]: loading libraries from a cold disk on a slow computer
_END_TIME = 2.0  # [s] until a process that does not terminate is killed
_MARGIN = 5.0  # [s] beyond its budget until a job counts as lost and the process is replaced


class PlanningProcess:
    """A planning process that starts immediately, is warmed up after some seconds, and is replaced if it dies.

    The process ends when `close` is called or the parent process ends.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._closed = False
        self._worker = _Worker.start()

    @property
    def pid(self) -> int | None:
        """Process ID; None after `close`."""
        return self._worker.process.pid if not self._closed else None

    def wait_until_warm(self, timeout: float = _WARM_UP_TIME) -> bool:
        """Wait at most `timeout` [s] for libraries and caches; return whether they are loaded.

        A process that has died is replaced; the new process is warmed up later.
        """
        with self._lock:
            if self._closed or self._worker.wait_until_warm(timeout):
                return not self._closed
            if not self._worker.process.is_alive():
                self._replace("it ended during warm-up")
            return False

    def planned(self, job: Job) -> PlanResult:
        """Run a job within about its budget; if the process dies or hangs, it is replaced and the job fails."""
        with self._lock:
            if self._closed:
                return PlanResult(job.number, Outcome.FAILED, reason="the planning process has been closed")
            result = self._worker.ask(job)
            if isinstance(result, PlanResult):
                return result
            self._replace(result)
            return PlanResult(job.number, Outcome.FAILED, reason=result)

    def close(self) -> None:
        """End the process; a running job fails."""
        self._closed = True
        with contextlib.suppress(ValueError):  # while it is being replaced
            self._worker.process.terminate()  # without acquiring the lock, which the waiting thread holds
        with self._lock:
            self._worker.end()

    def _replace(self, reason: str) -> None:
        if self._closed:
            return
        logger.error("the planning process is restarted: %s", reason)
        self._worker.end()
        self._worker = _Worker.start()


class _Worker(NamedTuple):
    """A process, the connection to it, and the shared objects."""

    process: SpawnProcess
    line: Connection
    shared: _Shared
    is_warm: threading.Event

    @classmethod
    def start(cls) -> _Worker:
        context = multiprocessing.get_context("spawn")
        here, there = context.Pipe()
        process = context.Process(target=_work, args=(there,), name="optdock-planning", daemon=True)
        process.start()
        there.close()
        return cls(process, here, _Shared("here"), threading.Event())

    def wait_until_warm(self, timeout: float) -> bool:
        if not self.is_warm.is_set():
            try:
                if self.line.poll(timeout):
                    self.line.recv_bytes()
                    self.is_warm.set()
            except (EOFError, OSError):  # the process is about to end
                self.process.join(_END_TIME)
        return self.is_warm.is_set()

    def ask(self, job: Job) -> PlanResult | str:
        """Return the result, or the reason why the process must be replaced."""
        try:
            if not self.wait_until_warm(_WARM_UP_TIME):
                return f"the planning process has not started: {self._exit}"
            self.line.send_bytes(self.shared.dumps(job))
            if not self.line.poll(job.budget + _MARGIN):
                return f"the planning process did not respond within {job.budget + _MARGIN:.1f} s"
            result = self.shared.loads(self.line.recv_bytes())
        except (EOFError, OSError):
            return f"the planning process has ended: {self._exit}"
        assert isinstance(result, PlanResult)
        return result

    @property
    def _exit(self) -> str:
        self.process.join(_END_TIME)
        code = self.process.exitcode
        return "it still runs" if code is None else f"exit code {code}"

    def end(self) -> None:
        self.process.terminate()
        self.process.join(_END_TIME)
        if self.process.is_alive():
            self.process.kill()
            self.process.join(_END_TIME)
        self.line.close()
        self.process.close()


def _work(line: Connection) -> None:
    """Run jobs until the connection closes."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # ctrl-C reaches the whole group; the parent ends this process
    signal.signal(signal.SIGTERM, signal.SIG_DFL)  # without handlers inherited from the parent
    shared = _Shared("there")
    warm_up()
    gc.collect()
    gc.freeze()  # exclude all loaded objects from later collections
    with contextlib.suppress(EOFError, OSError):
        line.send_bytes(b"warm")
        while True:
            job = shared.loads(line.recv_bytes())
            assert isinstance(job, Job)
            try:
                result = planned(job)
            except Exception as error:  # the next job may succeed after any exception of a plugin
                logger.exception("a job fails")
                result = PlanResult(job.number, Outcome.FAILED, reason=f"{type(error).__name__}: {error}")
            line.send_bytes(shared.dumps(result))


class _Shared:
    """Pickler that sends every costmap and motion once, and afterwards only a reference to it."""

    def __init__(self, side: str) -> None:
        self._side, self._count = side, 0
        self._sent: OrderedDict[tuple[str, int], object] = OrderedDict()
        self._received: OrderedDict[tuple[str, int], object] = OrderedDict()

    def dumps(self, value: object) -> bytes:
        """Serialize a message."""
        buffer = io.BytesIO()
        pickler = pickle.Pickler(buffer, protocol=pickle.HIGHEST_PROTOCOL)
        pickler.persistent_id = self._named  # type: ignore[method-assign]
        pickler.dump(value)
        return buffer.getvalue()

    def loads(self, message: bytes) -> object:
        """Deserialize a message."""
        unpickler = pickle.Unpickler(io.BytesIO(message))
        unpickler.persistent_load = self._found  # type: ignore[method-assign]
        return unpickler.load()

    def _named(self, value: object) -> object:
        """Return the name and parts of a shared object, or only a reference if it was sent or received before."""
        if not isinstance(value, Costmap | DrivenMotion):
            return None
        for table in (self._sent, self._received):
            for name, known in table.items():
                if known is value:
                    return name, None, ()
        self._count += 1
        name = self._side, self._count
        _keep(self._sent, name, value, _SENT)
        if isinstance(value, Costmap):
            return name, Costmap, (value.data, value.resolution, value.origin)
        return name, DrivenMotion, (value.trajectory, value.problem, value.plan, value.start_relief)

    def _found(self, named: tuple[tuple[str, int], Callable[..., object] | None, tuple[object, ...]]) -> object:
        name, kind, parts = named
        if kind is None:
            return self._sent[name] if name[0] == self._side else self._received[name]
        value = kind(*parts)
        _keep(self._received, name, value, _RECEIVED)
        return value


def _keep(table: OrderedDict[tuple[str, int], object], name: tuple[str, int], value: object, most: int) -> None:
    table[name] = value
    if len(table) > most:
        table.popitem(last=False)
