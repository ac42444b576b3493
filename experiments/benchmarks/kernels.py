"""CPU time of calls with kernels in C and with their NumPy twins: `python -m experiments.benchmarks kernels`.

Every problem is planned with both lanes in turn, several times, and the fastest run of each lane counts. The plans of
both lanes must be equal. Easy scenes: five instances each of the six families with at most five obstacles on an open
floor. Parking: slots of study 6 in which a plan is found within the budget.
"""

from __future__ import annotations

import argparse
import gc
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from experiments.benchmarks.tables import Table, Timer, percentile
from experiments.families import FEASIBLE_FAMILIES, instance
from experiments.manoeuvres.hard_cases import bays
from optdock.deadline import set_clock
from optdock.errors import OptdockError
from optdock.geometry import nurbs
from optdock.kernels import kernels_in_use, using_kernels
from optdock.model.path import Path
from optdock.planners.manoeuvres import connections, distance_field, manoeuvre_planner
from optdock.planning.pipeline import plan_dock, warm_up
from optdock.timing import interior_point, path_limits, reference_program, ruckig_moves
from optdock.verification import certify_path, clearance_kernel, clearance_rounds, stretch_bounds, trajectory_rules
from optdock.verification.conservative_advancement import prove_clearance
from smoothers.scp import initial_guess, loop
from smoothers.scp.collision import linearization

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from optdock.kernels import Lane
    from optdock.model.problem import DockingProblem

__all__ = ["main"]

EASY = ("open_s", "reverse_cusp", "pillar", "collision", "angled_hexagon", "long_approach")
_BUDGET = 3.0  # [s] of CPU time
# Modules and names by which each kernel is called. Those of the search that poll the caller's cancel checker cannot be
# replayed after the call; the rows of whole calls contain them.
_KERNELS = {
    "bounds of the proof": (stretch_bounds, "_body_bounds_chosen"),
    "round of the proof": (clearance_rounds, "_round_chosen"),
    "clearances of ends": (clearance_kernel, "_of_pieces_chosen"),
    "clearance along a roll-out": (loop, "clearance_along"),
    "rows of planes": (linearization, "separating_plane_rows"),
    "roll-out": (initial_guess, "roll_out"),
    "sensitivity": (loop, "sensitivity"),
    "goal projection": (loop, "project_and_roll_out"),
    "points of curves": (nurbs, "_poses_at"),
    "cheapest words": (connections, "words_between"),
    "prices of paths": (manoeuvre_planner, "least_prices"),
    "tiles of the field": (distance_field, "_tile_values"),
    "crossings": (trajectory_rules, "crossings"),
    "limits along a path": (path_limits, "_clothoid_chosen"),
    "interior point": (interior_point, "advanced"),
    "program of the time law": (reference_program, "prepared"),
    "excess of moves": (ruckig_moves, "_evaluate_chosen"),
}
_MOST_CALLS = 40  # of every kernel, replayed
_LANES: tuple[Lane, Lane] = ("twin", "native")


class _Pair(NamedTuple):
    """Fastest CPU times [s] of the lanes, and whether their results are equal."""

    twin: float
    native: float
    same: bool


def main(arguments: Sequence[str]) -> None:
    """Time plans and proofs of both lanes."""
    parser = argparse.ArgumentParser(prog="python -m experiments.benchmarks kernels", description=__doc__)
    parser.add_argument("--repeats", type=int, default=5, help="runs of every lane (default: %(default)s)")
    parser.add_argument("--seeds", type=int, default=5, help="instances per family (default: %(default)s)")
    parser.add_argument("--slots", type=int, default=12, help="parking slots (default: %(default)s)")
    options = parser.parse_args(list(arguments))
    with using_kernels("native"):
        print(kernels_in_use())
    set_clock("cpu")
    warm_up()
    gc.collect()
    gc.freeze()
    easy = [instance(family, seed).problem for family in EASY for seed in range(options.seeds)]
    slots = [case.problem for case in list(bays())[:: max(1, 36 // max(1, options.slots))]]
    rows = [_row("call, easy scenes", [_calls(one, options.repeats) for one in easy])]
    if options.slots:
        rows.append(_row("call, parking slots", [_calls(one, min(2, options.repeats)) for one in slots]))
    rows += [
        _row(f"{what}, {family}", [_proofs(family, seed, prove, 4 * options.repeats) for seed in range(options.seeds)])
        for what, prove in (("clearance proof", prove_clearance), ("certify_path", certify_path))
        for family in ("pillar", "many_obstacles", "clutter")
    ]
    rows += [
        _row(f"{what}, {len(calls)} calls", [_replayed(run, calls, 4 * options.repeats)])
        for what, (run, calls) in _recorded([instance("many_obstacles", 0).problem, next(iter(bays())).problem])
    ]
    header = ("what", "pairs", "equal", "twin ms p50", "p99", "C ms p50", "p99", "ratio p50")
    print(Table("Kernels in C against their NumPy twins", header, tuple(rows), "CPU time, lanes in turn, fastest run."))


def _row(what: str, pairs: list[_Pair]) -> tuple[object, ...]:
    twin, native = ([getattr(pair, lane) for pair in pairs] for lane in _LANES)
    times = [1e3 * percentile(values, share) for values in (twin, native) for share in (50.0, 99.0)]
    ratio = float(np.median([pair.native / pair.twin for pair in pairs]))
    return (what, len(pairs), sum(pair.same for pair in pairs), *times, ratio)


def _calls(problem: DockingProblem, repeats: int) -> _Pair:
    return _fastest(lambda: _planned(problem), repeats)


def _proofs(family: str, seed: int, prove: Callable[[Path, DockingProblem], object], repeats: int) -> _Pair:
    task = instance(family, seed)
    assert family in FEASIBLE_FAMILIES
    assert task.witness is not None
    segments = task.witness.segments
    # A new path object for every run, because complete proofs are cached per path.
    paths = iter([Path(segments) for _ in range(2 * repeats)])
    return _fastest(lambda: prove(next(paths), task.problem), repeats)


def _recorded(
    problems: list[DockingProblem],
) -> Iterator[tuple[str, tuple[Callable[..., object], list[tuple[object, ...]]]]]:
    """Yield each kernel with its calls in plans of `problems`."""
    for what, (module, name) in _KERNELS.items():
        run, calls = getattr(module, name), list[tuple[object, ...]]()

        def recording(*args: object, run: Callable[..., object] = run, calls: list[object] = calls) -> object:  # type: ignore[assignment]
            calls.append(args)
            return run(*args)

        setattr(module, name, recording)
        for problem in problems:
            _planned(problem)
        setattr(module, name, run)
        if calls:
            yield what, (run, calls[:_MOST_CALLS])


def _replayed(run: Callable[..., object], calls: list[tuple[object, ...]], repeats: int) -> _Pair:
    def all_of_them() -> str:
        for args in calls:
            run(*args)
        return ""

    found = _fastest(all_of_them, repeats)
    return _Pair(found.twin / len(calls), found.native / len(calls), found.same)


def _planned(problem: DockingProblem) -> str:
    try:
        plan = plan_dock(problem, time_budget=_BUDGET)
    except OptdockError as error:
        return type(error).__name__
    return f"{plan.path.digest} {plan.certificate.min_clearance!r}"


def _fastest(run: Callable[[], object], repeats: int) -> _Pair:
    """Run both lanes in turn; their results are compared by their representations."""
    times: dict[str, list[float]] = {lane: [] for lane in _LANES}
    found: dict[str, set[str]] = {lane: set() for lane in _LANES}
    for repeat in range(repeats):
        for lane in _LANES if repeat % 2 else _LANES[::-1]:
            with using_kernels(lane):
                timer = Timer()
                result = run()
                times[lane].append(timer.cpu)
            found[lane].add(repr(result))
    return _Pair(*(min(times[lane]) for lane in _LANES), found["twin"] == found["native"])
