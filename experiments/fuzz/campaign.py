"""Campaigns: run cases in one process per job with limits of memory and time; count, shrink and save failures.

All times are CPU time, also the budgets of the library, so that neither other processes nor a stop of this one
(SIGSTOP) changes a verdict. The outcome of every case is appended to a file, from which a campaign can be continued.
"""

from __future__ import annotations

import collections
import contextlib
import itertools
import json
import logging
import math
import multiprocessing
import queue
import resource
import signal
import time
import warnings
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, NoReturn, TextIO

from experiments.fuzz.case import Verdict, rng_of, save_case
from experiments.fuzz.kinds import KINDS
from experiments.fuzz.lanes import using_lanes
from experiments.fuzz.minimise import minimised
from experiments.fuzz.planted import planted
from optdock.deadline import set_clock

if TYPE_CHECKING:
    from collections.abc import Iterator
    from multiprocessing.synchronize import Event
    from types import FrameType

    from experiments.fuzz.case import Case
    from experiments.fuzz.lanes import Lanes

__all__ = ["Campaign", "Tally", "judge_once", "run"]

_MEMORY = 3 << 30  # [bytes] of address space per process
_HANG = 30  # [s] of CPU time for one case
_SAVED_PER_SIGNATURE = 3
_REPORT = 15.0  # [s] between progress lines
# Default shares of the time; a kind with expensive cases runs fewer of them.
_SHARE = {
    "paths": 0.19,
    "trajectories": 0.12,
    "timings": 0.1,
    "limits": 0.05,
    "plans": 0.11,
    "prices": 0.03,
    "replans": 0.1,
    "measured": 0.05,
    "decisions": 0.03,
    "impossibilities": 0.13,
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
        seconds: CPU time of each process; the campaign ends at the first limit reached, time, count or wanted verdicts.
        count: Number of cases of every kind; None: until the time is up.
        out: Directory of failing cases, and of the file of outcomes, `SEED.jsonl`.
        wanted: Number of checked verdicts at which a kind ends, by the name of the kind.
        lanes: Lanes of the kernels, see `lanes`.
        resume: Whether cases in the file of outcomes are counted and skipped; otherwise the file is written anew.
        stop_at_fault: End with the first false certificate.
        plant: A mistake to plant in every process, or None.
    """

    kinds: tuple[str, ...]
    seed: int
    seconds: float
    count: int | None
    out: Path
    wanted: dict[str, int] = field(default_factory=dict)
    lanes: Lanes = "own"
    resume: bool = False
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
    checked: dict[str, collections.Counter[str]] = field(default_factory=lambda: collections.defaultdict(
        collections.Counter))  # fmt: skip
    seconds: collections.Counter[str] = field(default_factory=collections.Counter)
    peak: int = 0
    faults: list[str] = field(default_factory=list)

    def add(self, report: _Report, elapsed: float) -> None:
        """Count a case; print failures immediately."""
        self.outcomes[report.kind][report.verdict.outcome] += 1
        self.checked[report.kind].update(report.verdict.checked)
        self.seconds[report.kind] += report.seconds  # type: ignore[assignment]
        self.peak = max(self.peak, report.peak)
        if report.saved:
            line = f"[{elapsed:7.1f} s] {report.verdict.outcome.upper()} {report.kind} {report.number}: "
            self.faults.append(line + f"{report.verdict.detail[:240]} -> {report.saved}")
            print(self.faults[-1], flush=True)

    @property
    def failed(self) -> int:
        """Number of failed cases."""
        return sum(map(self._faults_of, self.outcomes))

    def _faults_of(self, kind: str) -> int:
        return sum(n for name, n in self.outcomes[kind].items() if Verdict(name).is_fault)

    def lines(self) -> Iterator[str]:
        """Return one line per kind."""
        for kind, counts in self.outcomes.items():
            total, seconds, checked = sum(counts.values()), self.seconds[kind], self.checked[kind]
            words = ", ".join(f"{name} {n}" for name, n in counts.most_common())
            told = ""
            if checked:
                rate = 3600.0 * checked.total() / max(seconds, 1e-9)
                told = f" {checked.total()} verdicts checked ({rate:.0f} per CPU hour: "
                told += ", ".join(f"{name} {n}" for name, n in checked.most_common()) + "),"
            each = 1e3 * seconds / total
            yield f"{kind}: {total} cases, {each:.1f} ms of CPU each,{told} {self._faults_of(kind)} faults: {words}"
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
        signal.setitimer(signal.ITIMER_PROF, _HANG)
        return KINDS[case["kind"]].judge(case)
    except HangError:
        return Verdict("hang", f"more than {_HANG} s of CPU time")
    except Exception as error:  # any exception is a possible fault
        return Verdict("untyped exception", f"{type(error).__name__}: {error}")
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)


def prepare() -> None:
    """Set memory, signal handling and clock of budgets of this process."""
    resource.setrlimit(resource.RLIMIT_AS, (_MEMORY, resource.getrlimit(resource.RLIMIT_AS)[1]))
    signal.signal(signal.SIGPROF, _give_up)
    set_clock("cpu")
    warnings.simplefilter("ignore")
    logging.disable(logging.CRITICAL)


class _Part(NamedTuple):
    """The part of a campaign that one process runs.

    `begin`, `step`: first number of the cases, and the difference of the next one. `done`: numbers of finished cases of
    every kind. `wanted`: number of verdicts at which a kind ends.
    """

    begin: int
    step: int
    done: dict[str, set[int]]
    wanted: dict[str, float]


def _work(campaign: Campaign, part: _Part, out: multiprocessing.Queue[object], stop: Event) -> None:
    """Run the cases of a part; the kind with the least used share of time is next."""
    prepare()
    with using_lanes(campaign.lanes):
        _run_part(campaign, part, out, stop)
    out.put(None)


def _run_part(campaign: Campaign, part: _Part, out: multiprocessing.Queue[object], stop: Event) -> None:
    deadline = time.process_time() + campaign.seconds
    used = dict.fromkeys(campaign.kinds, 0.0)
    checked: collections.Counter[str] = collections.Counter()
    numbers = {kind: itertools.count(part.begin, part.step) for kind in campaign.kinds}
    saved: collections.Counter[str] = collections.Counter()
    owner = multiprocessing.parent_process()
    while used and time.process_time() < deadline and not stop.is_set():
        if owner is not None and not owner.is_alive():  # it was killed
            return
        kind = min(used, key=lambda name: used[name] / _SHARE[name])
        number = next(number for number in numbers[kind] if number not in part.done.get(kind, ()))
        is_over = campaign.count is not None and number >= campaign.count
        if is_over or checked[kind] >= part.wanted.get(kind, math.inf):
            del used[kind]
            continue
        out.put((kind, number))
        report = _one(campaign, kind, number, saved)
        used[kind] += report.seconds
        checked[kind] += sum(report.verdict.checked.values())
        out.put(report)


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
    note = f"python -m experiments.fuzz --lanes {campaign.lanes} --replay {target}"
    note += f" --plant {campaign.plant}" if campaign.plant else ""
    save_case(target, chosen, verdict, note)
    return str(target)


def run(campaign: Campaign, jobs: int) -> Tally:
    """Run a campaign on `jobs` processes and print its results."""
    context = multiprocessing.get_context("spawn")
    reports: multiprocessing.Queue[object] = context.Queue()
    stop = context.Event()
    tally, done = _earlier(campaign)
    left = {kind: (most - tally.checked[kind].total()) / jobs for kind, most in campaign.wanted.items()}
    workers = [
        context.Process(target=_work, args=(campaign, _Part(job, jobs, done, left), reports, stop), daemon=True)
        for job in range(jobs)
    ]
    for worker in workers:
        worker.start()
    listener = _Listener(campaign, tally, reports, stop)
    with _outcomes(campaign).open("a", encoding="utf-8", buffering=1) as listener.file:
        listener.listen(workers)
    for worker in workers:
        worker.join()
    dead = [worker.exitcode for worker in workers if worker.exitcode]
    if dead:
        unfinished = ", ".join(f"{kind} {number}" for kind, number in listener.begun)
        verdict = Verdict("crash", f"processes ended with {dead}; unfinished: {unfinished}")
        listener.tally.add(_Report("process", 0, verdict, 0.0, 0, "no file"), listener.elapsed)
    return listener.tally


def _outcomes(campaign: Campaign) -> Path:
    """Return the file of outcomes: one line of JSON per case."""
    return campaign.out / f"{campaign.seed}.jsonl"


def _earlier(campaign: Campaign) -> tuple[Tally, dict[str, set[int]]]:
    """Return the tally and the numbers of finished cases of every kind of the campaign that is resumed."""
    tally, done = Tally(), collections.defaultdict(set)
    source = _outcomes(campaign)
    source.parent.mkdir(parents=True, exist_ok=True)
    if not campaign.resume:
        source.unlink(missing_ok=True)
    text = source.read_text(encoding="utf-8") if source.exists() else ""
    if text and not text.endswith("\n"):
        source.write_text(text + "\n", encoding="utf-8")
    for line in text.splitlines():
        with contextlib.suppress(ValueError):  # the last line of a process that was killed
            kind, number, outcome, checked, seconds = json.loads(line)
            tally.add(_Report(kind, number, Verdict(outcome, checked=checked), seconds, 0, ""), 0.0)
            done[kind].add(number)
    return tally, dict(done)


class _Listener:
    """Receives the reports of all workers until each has finished or died."""

    file: TextIO

    def __init__(self, campaign: Campaign, tally: Tally, reports: multiprocessing.Queue[object], stop: Event) -> None:
        self.campaign, self.tally, self.reports, self.stop = campaign, tally, reports, stop
        self.began, self.reported = time.monotonic(), 0.0
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
            row = (message.kind, message.number, message.verdict.outcome, message.verdict.checked)
            print(json.dumps([*row, round(message.seconds, 4)]), file=self.file)
            if self.campaign.stop_at_fault and message.verdict.is_fault:
                self.stop.set()
        elif isinstance(message, tuple):
            self.begun.add(message)
        if self.elapsed - self.reported > _REPORT:
            self.reported = self.elapsed
            print(f"[{self.elapsed:7.1f} s] " + "; ".join(self.tally.lines()), flush=True)
