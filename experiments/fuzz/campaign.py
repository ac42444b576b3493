"""Campaigns: run cases in one process per job with limits of memory and time; count, shrink and save failures."""

from __future__ import annotations

import collections
import itertools
import logging
import multiprocessing
import queue
import resource
import signal
import time
import warnings
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, NoReturn

from experiments.fuzz.case import Verdict, rng_of, save_case
from experiments.fuzz.kinds import KINDS
from experiments.fuzz.minimise import minimised
from experiments.fuzz.planted import planted

if TYPE_CHECKING:
    from collections.abc import Iterator
    from multiprocessing.synchronize import Event
    from types import FrameType

    from experiments.fuzz.case import Case

__all__ = ["Campaign", "Tally", "judge_once", "run"]

_MEMORY = 3 << 30  # [bytes] of address space per process
_HANG = 30  # [s] for one case
_SAVED_PER_SIGNATURE = 3
_REPORT = 15.0  # [s] between progress lines
# Default shares of the time; a kind with expensive cases runs fewer of them.
_SHARE = {
    "paths": 0.21,
    "trajectories": 0.12,
    "timings": 0.1,
    "limits": 0.05,
    "plans": 0.09,
    "prices": 0.03,
    "replans": 0.06,
    "measured": 0.05,
    "decisions": 0.03,
    "impossibilities": 0.08,
    "kernels": 0.02,
    "timing_kernels": 0.01,
    "files": 0.05,
    "damaged_files": 0.02,
    "judged": 0.1,
    "values": 0.05,
    "views": 0.04,
}


@dataclass(frozen=True)
class Campaign:
    """Parameters of a campaign.

    Args:
        kinds: Names of kinds.
        seed: First number of every case's random state.
        seconds: Duration; the campaign ends at the first limit reached, time or count.
        count: Number of cases of every kind; None: until the time is up.
        out: Directory of failing cases.
        stop_at_fault: End with the first false certificate.
        plant: A mistake to plant in every process, or None.
    """

    kinds: tuple[str, ...]
    seed: int
    seconds: float
    count: int | None
    out: Path
    stop_at_fault: bool = False
    plant: str | None = None


class _Report(NamedTuple):
    """Result of one case, as sent by a worker."""

    kind: str
    number: int
    verdict: Verdict
    seconds: float
    peak: int
    saved: str


@dataclass
class Tally:
    """Counts of all cases."""

    outcomes: dict[str, collections.Counter[str]] = field(default_factory=lambda: collections.defaultdict(
        collections.Counter))  # fmt: skip
    seconds: collections.Counter[str] = field(default_factory=collections.Counter)
    peak: int = 0
    faults: list[str] = field(default_factory=list)

    def add(self, report: _Report, elapsed: float) -> None:
        """Count a case; print failures immediately."""
        self.outcomes[report.kind][report.verdict.outcome] += 1
        self.seconds[report.kind] += report.seconds  # type: ignore[assignment]
        self.peak = max(self.peak, report.peak)
        if report.saved:
            line = f"[{elapsed:7.1f} s] {report.verdict.outcome.upper()} {report.kind} {report.number}: "
            self.faults.append(line + f"{report.verdict.detail[:240]} -> {report.saved}")
            print(self.faults[-1], flush=True)

    @property
    def failed(self) -> int:
        """Number of failed cases."""
        return sum(n for kind in self.outcomes.values() for name, n in kind.items() if Verdict(name).is_fault)

    def lines(self) -> Iterator[str]:
        """Return one line per kind."""
        for kind, counts in self.outcomes.items():
            total = sum(counts.values())
            each = 1e3 * self.seconds[kind] / total
            words = ", ".join(f"{name} {n}" for name, n in counts.most_common())
            yield f"{kind}: {total} cases, {each:.1f} ms of CPU each: {words}"
        yield f"peak memory {self.peak / 2**20:.2f} GB, {self.failed} faults"


class HangError(BaseException):
    """A case exceeded the time limit of a case."""


def _give_up(_signal: int, _frame: FrameType | None) -> NoReturn:
    raise HangError


def judge_once(case: Case, plant: str | None = None) -> Verdict:
    """Return the verdict on a case, for any behaviour of the library; with a plant, only faults caused by it count."""
    with planted(plant):
        verdict = _verdict(case)
    if plant is not None and verdict.is_fault and _verdict(case).is_fault:
        return Verdict("fails without the plant too")
    return verdict


def _verdict(case: Case) -> Verdict:
    try:
        signal.alarm(_HANG)
        return KINDS[case["kind"]].judge(case)
    except HangError:
        return Verdict("hang", f"more than {_HANG} s")
    except Exception as error:  # any exception is a possible fault
        return Verdict("untyped exception", f"{type(error).__name__}: {error}")
    finally:
        signal.alarm(0)


def prepare() -> None:
    """Set memory and signal handling of this process."""
    resource.setrlimit(resource.RLIMIT_AS, (_MEMORY, resource.getrlimit(resource.RLIMIT_AS)[1]))
    signal.signal(signal.SIGALRM, _give_up)
    warnings.simplefilter("ignore")
    logging.disable(logging.CRITICAL)


def _work(campaign: Campaign, job: int, jobs: int, out: multiprocessing.Queue[object], stop: Event) -> None:
    """Run every `jobs`-th case; the kind with the least used share of time is next."""
    prepare()
    deadline = time.monotonic() + campaign.seconds
    used = dict.fromkeys(campaign.kinds, 0.0)
    numbers = {kind: itertools.count(job, jobs) for kind in campaign.kinds}
    saved: collections.Counter[str] = collections.Counter()
    owner = multiprocessing.parent_process()
    while used and time.monotonic() < deadline and not stop.is_set():
        if owner is not None and not owner.is_alive():  # it was killed
            return
        kind = min(used, key=lambda name: used[name] / _SHARE[name])
        number = next(numbers[kind])
        if campaign.count is not None and number >= campaign.count:
            del used[kind]
            continue
        out.put((kind, number))
        report = _one(campaign, kind, number, saved)
        used[kind] += report.seconds
        out.put(report)
    out.put(None)


def _one(campaign: Campaign, kind: str, number: int, saved: collections.Counter[str]) -> _Report:
    began = time.process_time()
    case: Case = {"kind": kind}
    try:
        case = KINDS[kind].draw(rng_of(kind, campaign.seed, number))
        verdict = judge_once(case, campaign.plant)
    except Exception as error:  # an exception of a generator is a bug of the fuzzer, and must not end the run
        verdict = Verdict("generator failed", f"{type(error).__name__}: {error}")
    seconds, place = time.process_time() - began, ""
    if verdict.is_fault or verdict.outcome == "generator failed":
        saved[verdict.signature] += 1
        if saved[verdict.signature] <= _SAVED_PER_SIGNATURE:
            place = _saved(campaign, case, verdict, number)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return _Report(kind, number, verdict, seconds, peak, place)


def _saved(campaign: Campaign, case: Case, verdict: Verdict, number: int) -> str:
    """Shrink the case and save it to a file."""
    chosen = case if verdict.evidence is None else verdict.evidence
    again = judge_once(chosen, campaign.plant)
    if again.signature == verdict.signature and verdict.outcome not in ("hang", "late"):
        chosen = minimised(chosen, again, lambda one: judge_once(one, campaign.plant))
    target = campaign.out / f"{case['kind']}-{campaign.seed}-{number}.json"
    note = f"python -m experiments.fuzz --replay {target}" + (f" --plant {campaign.plant}" if campaign.plant else "")
    save_case(target, chosen, verdict, note)
    return str(target)


def run(campaign: Campaign, jobs: int) -> Tally:
    """Run a campaign on `jobs` processes and print its results."""
    context = multiprocessing.get_context("spawn")
    reports: multiprocessing.Queue[object] = context.Queue()
    stop = context.Event()
    workers = [
        context.Process(target=_work, args=(campaign, job, jobs, reports, stop), daemon=True) for job in range(jobs)
    ]
    for worker in workers:
        worker.start()
    listener = _Listener(campaign, reports, stop)
    listener.listen(workers)
    for worker in workers:
        worker.join()
    dead = [worker.exitcode for worker in workers if worker.exitcode]
    if dead:
        unfinished = ", ".join(f"{kind} {number}" for kind, number in listener.begun)
        verdict = Verdict("crash", f"processes ended with {dead}; unfinished: {unfinished}")
        listener.tally.add(_Report("process", 0, verdict, 0.0, 0, "no file"), listener.elapsed)
    return listener.tally


class _Listener:
    """Receives the reports of all workers until each has finished or died."""

    def __init__(self, campaign: Campaign, reports: multiprocessing.Queue[object], stop: Event) -> None:
        self.campaign, self.reports, self.stop = campaign, reports, stop
        self.tally, self.began, self.reported = Tally(), time.monotonic(), 0.0
        self.begun: set[tuple[str, int]] = set()

    @property
    def elapsed(self) -> float:
        """Seconds since the start."""
        return time.monotonic() - self.began

    def listen(self, workers: list[multiprocessing.context.SpawnProcess]) -> None:
        """Receive reports until no worker is left."""
        running = len(workers)
        while running:
            try:
                message = self.reports.get(timeout=2.0)
            except queue.Empty:
                if not any(worker.is_alive() for worker in workers):
                    return
                continue
            running -= message is None
            self._take(message)

    def _take(self, message: object) -> None:
        if isinstance(message, _Report):
            self.begun.discard((message.kind, message.number))
            self.tally.add(message, self.elapsed)
            if self.campaign.stop_at_fault and message.verdict.is_fault:
                self.stop.set()
        elif isinstance(message, tuple):
            self.begun.add(message)
        if self.elapsed - self.reported > _REPORT:
            self.reported = self.elapsed
            print(f"[{self.elapsed:7.1f} s] " + "; ".join(self.tally.lines()), flush=True)
