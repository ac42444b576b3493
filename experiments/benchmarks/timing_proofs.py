"""Time parameterization against its certificate: rate of refused results that a method reports OK, and worst CPU time.

    python -m experiments.benchmarks timing_proofs                               # a minute
    python -m experiments.benchmarks timing_proofs --plans 5000 --paths 20000    # an hour

Plans: random starts before docks on real maps (if available) and in random families, at rest and in motion, including
slow zones that begin at a knot of the path. Paths: random clothoid splines, limits, zones and start states; half of the
limits and lengths of the second table are orders of magnitude away from those of real robots.
"""

from __future__ import annotations

import argparse
import resource
import sys
from collections import Counter
from dataclasses import replace
from pathlib import Path as FilePath
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from experiments.benchmarks.tables import Table, Timer
from experiments.families import FEASIBLE_FAMILIES, instance
from optdock.errors import OptdockError
from optdock.geometry.clothoid import ClothoidSpline
from optdock.geometry.pose import Pose2
from optdock.model.limits import MotionLimits, SpeedZone
from optdock.model.path import ClothoidSegment, Path
from optdock.planning.pipeline import plan_dock
from optdock.plugins.interfaces import TimingStatus
from optdock.timing.near_optimal import NearOptimal
from optdock.timing.windowed import Windowed
from optdock.verification import certify_trajectory

sys.path.insert(0, str(FilePath(__file__).resolve().parents[1]))
from real_maps import SCENARIOS, maps_folder, problem_of

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from optdock.model.problem import DockingProblem
    from optdock.plugins.interfaces import TimeParameterizer

_SCENES = (0, 1, 4, 9, 17)  # indices into `SCENARIOS`: three walls, a pallet, a rack
_TURNING = ("max_yaw_rate", "max_yaw_acceleration", "max_lateral_acceleration", "max_wheel_speed")
_WILD = 4.0  # decades


class Case(NamedTuple):
    """One call of a time parameterizer."""

    path: Path
    limits: MotionLimits
    zone: SpeedZone
    start: tuple[float, float]


class Tally:
    """Statistics of calls: counts, refused results, and the CPU time of each [s]."""

    def __init__(self) -> None:
        self.counts: Counter[str] = Counter()
        self.repairs: Counter[str] = Counter()
        self.refused: list[str] = []
        self.seconds: list[float] = []

    def call(self, name: str, method: TimeParameterizer, case: Case) -> None:
        """Time one path, and certify a result that is reported OK."""
        timer = Timer()
        speed, acceleration = case.start
        result = method.parameterize(
            case.path, case.limits, case.zone, start_speed=speed, start_acceleration=acceleration
        )
        self.seconds.append(timer.cpu)
        self.counts[f"{name}: {result.status.name}"] += 1
        self.repairs.update(result.report.gears)
        if result.status is not TimingStatus.OK or result.trajectory is None:
            if "not certified" in result.reason:
                self.counts[f"{name}: FAIL, no plan passed its proof"] += 1
            return
        proof = certify_trajectory(
            result.trajectory, case.limits, case.zone, start_speed=speed, start_acceleration=acceleration
        )
        if not proof.certified:
            self.refused.append(f"{name}: {proof.reason}")

    def table(self, title: str) -> Table:
        """Return all statistics, refused results first."""
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
        rows: list[tuple[object, ...]] = [("OK or planned, but refused by the proof", len(self.refused))]
        rows += [(f"  {words}", 1) for words in self.refused[:5]]
        rows += [(f"ended {name}", number) for name, number in sorted(self.counts.items())]
        rows += [(f"gears by: {how}", number) for how, number in self.repairs.most_common()]
        if self.seconds:
            shown = (1e3 * value for value in np.percentile(self.seconds, (50, 99, 100)))
            rows += [("CPU ms, p50 / p99 / max", " / ".join(f"{value:.1f}" for value in shown))]
        return Table(title, ("what", "number"), (*rows, ("peak memory of the process, MB", f"{peak:.0f}")))


def methods() -> dict[str, TimeParameterizer]:
    """Return every method, in each of its modes."""
    return {"NearOptimal": NearOptimal(), "NearOptimal smooth": NearOptimal(smooth=True), "Windowed": Windowed()}


def random_problems(seed: int) -> Iterator[DockingProblem]:
    """Return random starts 1 to 2.5 m before docks with a zone as long as the final straight, every third in motion."""
    rng = np.random.default_rng((seed, 1))
    families = sorted(FEASIBLE_FAMILIES)
    while True:
        if maps_folder().is_dir() and rng.random() < 0.7:
            problem = problem_of(SCENARIOS[int(rng.choice(_SCENES))])
            length = float(rng.uniform(0.2, 0.5))
            speed = float(rng.uniform(0.05, 0.15))
            dock = replace(problem.dock, approach_speed=speed, approach_distance=length)
            dock = replace(dock, final_straight=length if rng.random() < 0.7 else 0.3)
            aside = Pose2(-float(rng.uniform(1.0, 2.5)), float(rng.uniform(-0.6, 0.6)), float(rng.uniform(-0.8, 0.8)))
            problem = replace(problem, dock=dock, start=dock.pose @ aside)
        else:
            problem = instance(str(rng.choice(families)), int(rng.integers(1_000_000))).problem
            straight = max(problem.dock.final_straight, 0.1)
            problem = replace(problem, dock=replace(problem.dock, approach_speed=0.1, approach_distance=straight))
        speed = float(rng.uniform(0.02, 0.25)) if rng.random() < 0.34 else 0.0
        yield replace(problem, start_speed=speed if problem.dock.direction != "backward" else -speed)


def plans_table(count: int, seed: int) -> Table:
    """Run whole plans, and every method over their paths."""
    tally = Tally()
    for i, problem in zip(range(count), random_problems(seed), strict=False):
        try:
            plan = plan_dock(problem, time_budget=2.0)
        except OptdockError as error:
            kind = type(error).__name__
            tally.counts[f"plan_dock: {kind}"] += 1
            if kind == "CertificationFailed":
                tally.refused.append(f"plan {i}: {error}")
            continue
        tally.counts["plan_dock: certified"] += 1
        case = Case(plan.path, problem.robot.limits, problem.dock.approach, (abs(problem.start_speed), 0.0))
        for name, method in methods().items():
            tally.call(name, method, case)
    return tally.table(f"{count} plans, seed {seed}")


def random_path_case(rng: np.random.Generator, decades: float) -> Case:
    """Return a random spline of 1 to 3 gears with random limits, zone and start; `decades` widens all ranges."""
    scale = 10.0 ** float(rng.uniform(-1.5 * decades, decades))
    segments, pose, sign = [], Pose2(0.0, 0.0, 0.0), int(rng.choice((1, -1)))
    for _ in range(int(rng.choice((1, 1, 1, 2, 3)))):
        count = int(rng.integers(2, 30))
        knots = scale * np.concatenate(([0.0], np.cumsum(10.0 ** rng.uniform(-2.0, -0.3, count - 1))))
        curvature = rng.uniform(-1.0, 1.0, count) * 10.0 ** float(rng.uniform(-1.5, 1.0)) / scale
        segments.append(ClothoidSegment(ClothoidSpline(pose, knots, curvature, sign)))
        pose, sign = segments[-1].spline.end, -sign

    def drawn(low: float, high: float) -> float:
        return 10.0 ** float(rng.uniform(low - decades, high + decades))

    bounds = {name: drawn(-1.0, 0.3) for name in ("max_speed", "max_reverse_speed", "max_acceleration")}
    bounds |= {"max_deceleration": drawn(-1.0, 0.3), "max_jerk": drawn(-1.0, 1.2), "track_width": 0.6}
    bounds |= {name: drawn(-2.0, 0.3) for name in _TURNING if rng.random() < 0.35}
    limits, path = MotionLimits(**bounds), Path(tuple(segments))
    top = limits.max_speed if path.segments[0].direction > 0 else limits.max_reverse_speed
    speed = float(rng.uniform(0.0, 1.0)) * top * float(rng.choice((1.0, 0.3, 0.1, 1e-3))) * (rng.random() < 0.7)
    moving = speed > 0.0 and rng.random() < 0.4
    acceleration = float(rng.uniform(-limits.max_deceleration, limits.max_acceleration)) if moving else 0.0
    knot = float(path.segment_starts[-2] + rng.choice(path.segments[-1].knots))
    distance = float(rng.choice((0.0, rng.uniform(0.1, 1.0) * scale, max(0.0, path.length - knot))))
    return Case(path, limits, SpeedZone(drawn(-1.7, -0.5), distance), (speed, acceleration))


def paths_table(count: int, seed: int, decades: float) -> Table:
    """Run one method per table on random paths under random limits."""
    rng, tally, known = np.random.default_rng((seed, 2)), Tally(), list(methods().items())
    for i in range(count):
        tally.call(*known[i % len(known)], random_path_case(rng, decades))
    return tally.table(
        f"{count} random paths, limits and lengths {decades:g} decades around those of robots, seed {seed}"
    )


def main(arguments: list[str]) -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--plans", type=int, default=200, help="number of whole plans")
    parser.add_argument("--paths", type=int, default=600, help="number of random paths per table")
    parser.add_argument("--seed", type=int, default=20261122)
    options = parser.parse_args(arguments)
    makers: tuple[Callable[[], Table], ...] = (
        lambda: plans_table(options.plans, options.seed),
        lambda: paths_table(options.paths, options.seed, 0.0),
        lambda: paths_table(options.paths, options.seed, _WILD),
    )
    for make in makers:
        print(make(), flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
