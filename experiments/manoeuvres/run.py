"""One case asked once, what came of it, and tables of many."""

from __future__ import annotations

import csv
import gc
import importlib.metadata
import io
import math
import platform
import re
import subprocess
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from itertools import groupby
from multiprocessing import get_context
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from experiments.benchmarks.tables import Table, Timer, percentile
from experiments.manoeuvres.check import checked
from optdock.errors import GoalOccupied, OptdockError, StartOccupied
from optdock.pipeline import plan_dock, warm_up
from optdock.plan import PartialPlan

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from experiments.manoeuvres.cases import Case
    from optdock.plan import DockPlan

__all__ = ["BUDGETS", "Record", "ask", "ask_all", "csv_text", "reference_table", "refusal_table", "summary", "versions"]

# [s] of wall clock, fixed before any run: what a user of each family would wait for. Nothing else is set: every case is
# `plan_dock(problem, time_budget=...)` with its defaults.
BUDGETS = {"tpcap": 5.0, "obca": 1.0, "dock starts": 1.0, "open hall": 0.3, "near dock": 1.0, "blocked": 1.0}

# [s]: the durations of the solutions that AutomatedValetParking (wenqing, BSD-2) publishes for the cases it solves
# without a collision, by an independent evaluator; planned in 46 s to 207 s.
REFERENCE_DURATIONS = {"case 1": 10.82, "case 2": 14.37, "case 3": 14.22, "case 6": 14.34, "case 9": 37.73}

CERTIFIED, IMPOSSIBLE, NOT_FOUND = "certified", "impossible (proven)", "not found"
_NUMBERS = re.compile(r"-?\d[\d.e+-]*")


class Record(NamedTuple):
    """What came of one case; lengths [m], times [s], numbers that there are not: NaN.

    Args:
        outcome: `certified`, `impossible (proven)` (also an occupied start or goal) or `not found`.
        error: Name of the error and its reason; empty when certified.
        stage: What found the guess that became the plan.
        tried: Every guess, and what became of it.
        certificate: What is proven, in a line.
        min_clearance: Proven least clearance.
        margin: Proven least clearance less what is required.
        start_relief: The run near the start that the certificate needs; 0 is the strict rule.
        price: What plans are chosen by: the duration, and a price per cusp.
        first: Wall clock until the first certified plan, where the plan says so; else an upper bound of it.
        faults: What the independent check found; empty: nothing.
        seen_clearance: Least clearance that it saw.
        bottleneck_error: From the place that a proof names to the true one, of blocked scenes.
        missing_error: The width that a proof says is missing, less what truly is.
    """

    name: str
    family: str
    tag: str
    budget: float
    outcome: str
    error: str = ""
    stage: str = ""
    tried: str = ""
    certificate: str = ""
    min_clearance: float = math.nan
    margin: float = math.nan
    start_relief: float = math.nan
    duration: float = math.nan
    price: float = math.nan
    length: float = math.nan
    cusps: int = 0
    first: float = math.nan
    wall: float = math.nan
    cpu: float = math.nan
    faults: str = ""
    seen_clearance: float = math.nan
    bottleneck_error: float = math.nan
    missing_error: float = math.nan


def ask(case: Case, budget: float | None = None, figure: Path | None = None) -> Record:
    """Plan a case with `budget` [s], that of its family by default; check what comes back, and draw it."""
    budget = BUDGETS[case.family] if budget is None else budget
    timer = Timer()
    try:
        plan = plan_dock(case.problem, time_budget=budget)
        wall, cpu = timer.wall, timer.cpu
    except OptdockError as error:
        record = Record(case.name, case.family, case.tag, budget, _word(error), wall=timer.wall, cpu=timer.cpu)
        return _refused(record, case, error, figure)
    record = Record(case.name, case.family, case.tag, budget, CERTIFIED, wall=wall, cpu=cpu)
    if figure is not None:
        _draw(figure, case, plan, f"{plan}; {_stage(plan)}")
    return _planned(record, case, plan)


def _planned(record: Record, case: Case, plan: DockPlan) -> Record:
    found, proof = checked(plan, case.problem), plan.certificate
    return record._replace(
        stage=_stage(plan),
        tried=_tried(plan),
        certificate=repr(proof),
        min_clearance=proof.min_clearance,
        margin=proof.margin,
        start_relief=float(getattr(proof, "start_relief", 0.0)),
        duration=plan.trajectory.duration,
        price=float(getattr(plan, "price", plan.trajectory.duration)),
        length=plan.path.length,
        cusps=len(plan.path.cusps),
        first=_first(plan, record.wall),
        faults="; ".join(found.faults),
        seen_clearance=found.min_clearance,
    )


def _refused(record: Record, case: Case, error: OptdockError, figure: Path | None) -> Record:
    left = PartialPlan.left_by(error)
    if figure is not None:
        _draw(figure, case, left, f"{record.outcome}: {error}", error)
    off, missing = _bottleneck_errors(case, error)
    reason = f"{type(error).__name__}: {' '.join(str(error).split())}"
    return record._replace(error=reason, tried=_tried(left), bottleneck_error=off, missing_error=missing)


def _word(error: OptdockError) -> str:
    # A proof of impossibility is known by what it carries: the class is younger than this benchmark.
    proven = getattr(error, "proof", None) is not None or isinstance(error, StartOccupied | GoalOccupied)
    return IMPOSSIBLE if proven else NOT_FOUND


# What a plan says of its search is read where it says it: the benchmark also runs planners that have one guess only.
def _stage(plan: DockPlan) -> str:
    return str(getattr(plan, "stage", "")) or "DockPlanner"


def _tried(found: DockPlan | PartialPlan) -> str:
    return " | ".join(str(attempt) for attempt in getattr(found, "tried", ()))


def _first(plan: DockPlan, wall: float) -> float:
    """Wall clock until the first certified plan [s]: as told; else all planning and what was tried until then."""
    if "first" in plan.timing_ms:
        return 1e-3 * plan.timing_ms["first"]
    spent = 1e-3 * plan.timing_ms.get("plan", 0.0)
    for attempt in getattr(plan, "tried", ()):
        spent += attempt.seconds
        if not attempt.reason:
            return min(spent, wall)
    return wall


def _bottleneck_errors(case: Case, error: OptdockError) -> tuple[float, float]:
    """From the bottleneck of a proof to the true one, and between the missing widths [m]; NaN where there is none.

    The body is as tight in a gap wherever along its length the gap holds it, so that much is no error.
    """
    found, truth = getattr(getattr(error, "proof", None), "bottleneck", None), case.truth
    if found is None or truth is None or truth.place is None:
        return math.nan, math.nan
    dx, dy = found.x - truth.place[0], found.y - truth.place[1]
    c, s = math.cos(truth.heading or 0.0), math.sin(truth.heading or 0.0)
    along, across = abs(c * dx + s * dy), abs(c * dy - s * dx)
    beyond = max(0.0, along - 0.5 * case.problem.robot.footprint.length)
    return math.hypot(across, beyond), found.missing_width - truth.missing


def _draw(
    target: Path, case: Case, found: DockPlan | PartialPlan, title: str, refusal: OptdockError | None = None
) -> None:
    from optdock.plotting import save_plan_picture

    save_plan_picture(
        target,
        case.problem,
        raw_path=found.raw_path,
        path=found.path,
        certificate=found.certificate,
        refusal=refusal,
        title=f"{case.name}: {title}"[:160],
    )


def ask_all(
    cases: Sequence[Case], budget: float | None = None, figures: Path | None = None, jobs: int = 1
) -> Iterator[Record]:
    """Every case, in turn; in `jobs` processes of one thread each (times are comparable with one only)."""
    targets = [None if figures is None else figures / f"{_file_name(case)}.png" for case in cases]
    tasks = [(case, budget, target) for case, target in zip(cases, targets, strict=True)]
    if jobs == 1:
        _prepare()
        for number, task in enumerate(tasks):
            if number % 20 == 0:
                gc.collect()
            yield ask(*task)
        return
    with ProcessPoolExecutor(jobs, get_context("spawn"), initializer=_prepare) as pool:
        yield from pool.map(_ask_one, tasks, chunksize=4)


def _prepare() -> None:
    warm_up()


def _ask_one(task: tuple[Case, float | None, Path | None]) -> Record:
    return ask(*task)


def _file_name(case: Case) -> str:
    return re.sub(r"[^a-z0-9]+", "_", f"{case.family} {case.name}".lower()).strip("_")


def versions() -> dict[str, str]:
    """What ran."""
    names = ("optdock", "numpy", "scipy", "casadi", "shapely", "ruckig")
    found = {name: importlib.metadata.version(name) for name in names}
    command = ["git", "-C", str(Path(__file__).parent), "describe", "--always", "--dirty"]
    try:
        commit = subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        commit = "unknown"
    return {"commit": commit, "python": platform.python_version(), "machine": platform.machine(), **found}


def csv_text(records: Iterable[Record]) -> str:
    """One row per case."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(Record._fields)
    for record in records:
        writer.writerow(f"{value:.6g}" if isinstance(value, float) else value for value in record)
    return out.getvalue()


def summary(records: Sequence[Record]) -> Table:
    """A row per family and per tag in it."""
    header = ("cases", "n", "certified", "impossible", "not found", "certified %")
    header = (*header, "cpu ms p50", "p90", "p99", "first ms p50", "s p50", "m p50", "cusps mean", "max", "refuted")
    rows = []
    for family, of_family in groupby(records, key=lambda one: one.family):
        members = list(of_family)
        rows.append(_row(family, members))
        tags = list(dict.fromkeys(one.tag for one in members))
        if tags != [family]:
            rows += [_row(f"  {tag}", [one for one in members if one.tag == tag]) for tag in tags]
    note = (
        "CPU of whole calls, whatever their end; first: wall clock until the first certified plan; s, m: duration and "
        "length of the plans; refuted: certified plans in which the independent check saw a fault"
    )
    return Table("Manoeuvres", header, tuple(rows), note)


def _row(name: str, records: Sequence[Record]) -> tuple[object, ...]:
    counts = Counter(one.outcome for one in records)
    plans = [one for one in records if one.outcome == CERTIFIED]
    cpu = [1e3 * one.cpu for one in records]
    return (
        name,
        len(records),
        *(counts[word] for word in (CERTIFIED, IMPOSSIBLE, NOT_FOUND)),
        round(100.0 * len(plans) / len(records), 1),
        *(percentile(cpu, share) for share in (50, 90, 99)),
        percentile([1e3 * one.first for one in plans], 50),
        percentile([one.duration for one in plans], 50),
        percentile([one.length for one in plans], 50),
        sum(one.cusps for one in plans) / len(plans) if plans else math.nan,
        max((one.cusps for one in plans), default=0),
        sum(bool(one.faults) for one in plans),
    )


def refusal_table(records: Sequence[Record]) -> Table:
    """What the others were told, by family: errors with their numbers left out."""
    told = Counter((one.family, _NUMBERS.sub("#", one.error)[:110]) for one in records if one.error)
    stages = Counter((one.family, f"certified: {one.stage}") for one in records if one.outcome == CERTIFIED)
    rows = [
        (family, text, n) for (family, text), n in sorted((told + stages).items(), key=lambda kv: (kv[0][0], -kv[1]))
    ]
    return Table("How calls end", ("family", "what was said", "n"), tuple(rows))


def reference_table(records: Sequence[Record]) -> Table:
    """The competition's cases beside the durations of an independent planner that are free of collisions."""
    rows = []
    for one in records:
        if one.family == "tpcap":
            reference = REFERENCE_DURATIONS.get(one.name, math.nan)
            rows.append((one.name, one.outcome, one.duration, reference, one.length, one.cusps, 1e3 * one.cpu))
    header = ("case", "outcome", "duration s", "reference s", "length m", "cusps", "cpu ms")
    note = "reference: published solutions of AutomatedValetParking, those that an independent evaluator finds clean"
    return Table("TPCAP", header, tuple(rows), note)
