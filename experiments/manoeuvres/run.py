"""Run of single cases, their records, and the CSV of all records."""

from __future__ import annotations

import csv
import gc
import importlib.metadata
import io
import math
import platform
import re
import subprocess
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from experiments.benchmarks.tables import Timer
from experiments.manoeuvres.check import checked
from optdock.deadline import clock_name, set_clock
from optdock.errors import GoalOccupied, OptdockError, StartOccupied
from optdock.planning.pipeline import plan_dock, warm_up
from optdock.planning.plan import PartialPlan

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from experiments.manoeuvres.cases import Case, Truth
    from optdock.deadline import ClockName
    from optdock.planning.plan import DockPlan

__all__ = ["BUDGETS", "CERTIFIED", "IMPOSSIBLE", "NOT_FOUND", "Record", "csv_text", "run_case", "run_cases", "versions"]

# Budgets [s] of wall clock, fixed before any run: acceptable waiting times of each family. Nothing else is set: every
# case is `plan_dock(problem, time_budget=...)` with its defaults.
BUDGETS = {"tpcap": 5.0, "obca": 1.0, "dock starts": 1.0, "open hall": 0.3, "near dock": 1.0, "blocked": 1.0}
_HARD = ("rack halls", "maze", "wrong way", "along a wall", "contact", "bays", "buildings", "forklifts")
BUDGETS |= dict.fromkeys((*_HARD, "blocked straight", "open straight", "barely open"), 1.0)

CERTIFIED, IMPOSSIBLE, NOT_FOUND = "certified", "impossible (proven)", "not found"


class Record(NamedTuple):
    """Result of one case; lengths [m], times [s], missing numbers NaN.

    Args:
        outcome: `certified`, `impossible (proven)` (also an occupied start or goal) or `not found`.
        error: Name of the error and its reason; empty if certified.
        stage: Source of the guess that became the plan.
        tried: All guesses with their results.
        certificate: Summary of the certificate.
        min_clearance: Proven minimum clearance.
        margin: Proven minimum of clearance minus required clearance.
        start_relief: Start relief of the certificate; 0 is the strict rule.
        price: Cost of the plan: its duration plus a penalty per cusp.
        first: Wall clock until the first certified plan, or an upper bound of it.
        faults: Faults found by the independent check of a plan or proof, and contradictions to the known truth of the
            scene; empty: none.
        seen_clearance: Minimum clearance of the independent check.
        outside: Distance by which the robot's origin leaves `Case.bounds`.
        bottleneck_error: Distance between the location named by a proof and the true one, for blocked scenes.
        missing_error: Missing width named by a proof minus the true missing width.
        cause: Whether a proof names body or clearance correctly: `right`, `wrong`, or empty.
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
    outside: float = math.nan
    bottleneck_error: float = math.nan
    missing_error: float = math.nan
    cause: str = ""


def run_case(case: Case, budget: float | None = None, figure: Path | None = None) -> Record:
    """Plan a case with `budget` [s], by default that of its family; check the result and draw it."""
    budget = BUDGETS[case.family] if budget is None else budget
    return _compared_with_truth(_unchecked(case, budget, figure), case.truth)


def _compared_with_truth(record: Record, truth: Truth | None) -> Record:
    """Report a plan for a blocked scene, or an impossibility proof for an open scene, as a fault."""
    denied = IMPOSSIBLE if truth is not None and truth.missing < 0.0 else CERTIFIED
    if truth is None or record.outcome != denied:
        return record
    contradiction = f"{record.outcome}, but {1e3 * truth.missing:g} mm are missing"
    return record._replace(faults="; ".join(filter(None, (record.faults, contradiction))))


def _unchecked(case: Case, budget: float, figure: Path | None) -> Record:
    timer = Timer()
    try:
        plan = plan_dock(case.problem, time_budget=budget)
        wall, cpu = timer.wall, timer.cpu
    except Exception as error:  # an exception that is no `OptdockError` is a fault and must not end a long run
        wall, cpu = timer.wall, timer.cpu
        record = Record(case.name, case.family, case.tag, budget, _word(error), wall=wall, cpu=cpu)
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
        start_relief=proof.start_relief,
        duration=plan.trajectory.duration,
        price=float(getattr(plan, "price", plan.trajectory.duration)),
        length=plan.path.length,
        cusps=len(plan.path.cusps),
        first=_first(plan, record.wall),
        faults="; ".join(found.faults),
        seen_clearance=found.min_clearance,
        outside=_outside(case, plan),
    )


def _outside(case: Case, plan: DockPlan) -> float:
    if case.bounds is None:
        return math.nan
    samples, (low_x, high_x, low_y, high_y) = plan.path.sample(0.01), case.bounds
    beyond = (low_x - samples.x, samples.x - high_x, low_y - samples.y, samples.y - high_y)
    return max(0.0, *(float(one.max()) for one in beyond))


def _word(error: Exception) -> str:
    # A proof of impossibility is detected by its attributes, because older versions lack its class.
    proven = getattr(error, "proof", None) is not None or isinstance(error, StartOccupied | GoalOccupied)
    return IMPOSSIBLE if proven else NOT_FOUND


def _refused(record: Record, case: Case, error: Exception, figure: Path | None) -> Record:
    if not isinstance(error, OptdockError):
        return record._replace(error=repr(error), faults=f"untyped exception: {error!r}")
    left = PartialPlan.left_by(error)
    if figure is not None:
        _draw(figure, case, left, f"{record.outcome}: {error}", error)
    reason = f"{type(error).__name__}: {' '.join(str(error).split())}"
    record = record._replace(error=reason, tried=_tried(left))
    proof = getattr(error, "proof", None)
    return record if proof is None else _proof_checked(record, case, proof)


def _proof_checked(record: Record, case: Case, proof: Any) -> Record:  # noqa: ANN401 - as the error carries it
    """Compare a proof with the truth, and check it with the independent checker."""
    from optdock.impossibility import check_impossibility

    verdict, found, truth = check_impossibility(proof, case.problem), proof.bottleneck, case.truth
    record = record._replace(faults="" if verdict.proven else f"proof refused: {verdict.reason}")
    if found is None or truth is None or truth.place is None:
        return record
    # In a gap of some length the bottleneck can be anywhere along that length: such a distance is not an error.
    dx, dy = found.x - truth.place[0], found.y - truth.place[1]
    c, s = math.cos(truth.heading or 0.0), math.sin(truth.heading or 0.0)
    beyond = max(0.0, abs(c * dx + s * dy) - 0.5 * case.problem.robot.footprint.length)
    return record._replace(
        bottleneck_error=math.hypot(c * dy - s * dx, beyond),
        missing_error=found.missing_width - truth.missing,
        cause="" if truth.is_body is None else "right" if found.body_fits != truth.is_body else "wrong",
    )


# The report of the search is optional: the benchmark also runs planners with a single guess.
def _stage(plan: DockPlan) -> str:
    return str(getattr(plan, "stage", "")) or "DockPlanner"


def _tried(found: DockPlan | PartialPlan) -> str:
    return " | ".join(str(attempt) for attempt in getattr(found, "tried", ()))


def _first(plan: DockPlan, wall: float) -> float:
    """Return the wall clock until the first certified plan [s], or that of all attempts if unreported."""
    if "first" in plan.timing_ms:
        return 1e-3 * plan.timing_ms["first"]
    spent = 1e-3 * plan.timing_ms.get("plan", 0.0)
    for attempt in getattr(plan, "tried", ()):
        spent += attempt.seconds
        if not attempt.reason:
            return min(spent, wall)
    return wall


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


def run_cases(
    cases: Sequence[Case], budget: float | None = None, figures: Path | None = None, jobs: int = 1
) -> Iterator[Record]:
    """Yield every record, in order, from `jobs` single-thread processes (times are comparable only with one)."""
    targets = [None if figures is None else figures / f"{_file_name(case)}.png" for case in cases]
    tasks = [(case, budget, target) for case, target in zip(cases, targets, strict=True)]
    if jobs == 1:
        warm_up()
        for number, task in enumerate(tasks):
            if number % 20 == 0:
                gc.collect()
            yield run_case(*task)
        return
    with ProcessPoolExecutor(jobs, get_context("spawn"), initializer=_prepare, initargs=(clock_name(),)) as pool:
        yield from pool.map(_run_task, tasks, chunksize=4)


def _prepare(clock: ClockName) -> None:
    set_clock(clock)
    warm_up()


def _run_task(task: tuple[Case, float | None, Path | None]) -> Record:
    return run_case(*task)


def _file_name(case: Case) -> str:
    return re.sub(r"[^a-z0-9]+", "_", f"{case.family} {case.name}".lower()).strip("_")


def versions() -> dict[str, str]:
    """Return the versions of all software involved."""
    names = ("optdock", "numpy", "scipy", "casadi", "shapely", "ruckig")
    found = {name: importlib.metadata.version(name) for name in names}
    command = ["git", "-C", str(Path(__file__).parent), "describe", "--always", "--dirty"]
    try:
        commit = subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        commit = "unknown"
    return {"commit": commit, "python": platform.python_version(), "machine": platform.machine(), **found}


def csv_text(records: Iterable[Record]) -> str:
    """Return a CSV text with one row per case."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(Record._fields)
    for record in records:
        writer.writerow(f"{value:.6g}" if isinstance(value, float) else value for value in record)
    return out.getvalue()
