"""Replanning in motion: calls of `replan` among 20 obstacles, and of `still_holds` in changed worlds.

For comparison, `plan_dock` plans from the same joint.

    python -m experiments.benchmarks replanning
"""

from __future__ import annotations

import argparse
import collections
import dataclasses
import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from experiments.benchmarks.tables import Table, Timer, percentile
from experiments.families import instance
from optdock.deadline import garbage_collection_paused
from optdock.errors import OptdockError
from optdock.geometry.obstacles import ObstacleSet
from optdock.geometry.pose import Pose2, transform_points
from optdock.model.costmap import Costmap
from optdock.model.problem import DockingProblem
from optdock.model.robot import Robot
from optdock.planning.pipeline import plan_dock, warm_up
from optdock.planning.replanning import DriveState, ReplanOutcome, replan, still_holds
from optdock.verification import prove_motion

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from optdock.planning.plan import DockPlan
    from optdock.planning.replanning import Replanned

__all__ = ["main"]

_FAMILIES = ("open_s", "reverse_cusp", "pillar", "collision", "angled_hexagon", "many_obstacles")
_OBSTACLES = 20
_BUDGET = 0.02  # [s]: intended budget of the calls
_AMPLE = 0.2  # [s]: budget of the calls whose work is measured, on any machine
_ENDLESS = 5.0  # [s]: budget of the initial plans and of those for comparison
_LEAD = 0.05  # [s]
_MORE_CLEAR = 0.05  # [m]: possible growth of the posts of such scenes


class Kind(NamedTuple):
    """Kind of change: when, as shares of the drive; displacement of the dock [m], [deg]; or a new obstacle."""

    name: str
    when: tuple[float, float]
    shift: float = 0.0
    turn: float = 0.0
    post: bool = False


_KINDS = (
    Kind("dock moved 3 cm, 1.5 deg, mid-drive", (0.3, 0.6), 0.03, 1.5),
    Kind("dock moved 10 cm, 5 deg, early", (0.02, 0.2), 0.10, 5.0),
    Kind("an obstacle 2 cm beside the way", (0.05, 0.3), post=True),
    Kind("dock moved 3 cm, 1.5 deg, late", (0.6, 1.0), 0.03, 1.5),
)


class Task(NamedTuple):
    """A running plan, and the change."""

    plan: DockPlan
    target: DockingProblem
    time: float


def main(arguments: Sequence[str]) -> None:
    """Print two tables."""
    parser = argparse.ArgumentParser(
        prog="python -m experiments.benchmarks replanning",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--seeds", type=int, default=10, help="number of plans per family")
    parser.add_argument("--repeats", type=int, default=1, help="repetitions of each call; the fastest counts")
    options = parser.parse_args(list(arguments))
    warm_up()
    plans = [plan for family in _FAMILIES for seed in range(options.seeds) for plan in _plans(family, seed)]
    print(_replan_table(plans, options.repeats))
    print(_holds_table(plans, options.repeats))


def _plans(family: str, seed: int) -> Iterator[DockPlan]:
    """Return a plan among 20 obstacles, for a robot with limits of every kind."""
    found = instance(family, seed).problem
    limits = dataclasses.replace(
        found.robot.limits, max_yaw_rate=1.2, max_yaw_acceleration=2.0, max_wheel_speed=0.6, track_width=0.4
    )
    robot = Robot(found.robot.footprint, limits, found.robot.drive)
    rng = np.random.default_rng(seed)
    problem = dataclasses.replace(found, robot=robot)
    try:
        first = plan_dock(problem, time_budget=_ENDLESS)
        posts = _posts(first, _OBSTACLES - len(set(found.obstacles.group.tolist())), rng)
        known = list(found.obstacles.vertices)
        yield plan_dock(dataclasses.replace(problem, obstacles=[*known, *posts][:_OBSTACLES]), time_budget=_ENDLESS)
    except OptdockError:
        return


def _posts(plan: DockPlan, count: int, rng: np.random.Generator) -> list[np.ndarray]:
    """Return posts around a plan that keep clear of it."""
    posts: list[np.ndarray] = []
    while len(posts) < count:
        at = plan.path.pose_at(float(rng.uniform(0.0, plan.path.length)))
        side = math.copysign(rng.uniform(0.45, 1.5), rng.uniform(-1.0, 1.0))
        radius, corners = float(rng.uniform(0.05, 0.2)), int(rng.integers(3, 8))
        post = _post(at @ Pose2(0.0, side, 0.0), radius, corners)
        # The post is grown by the difference of the required clearances: the rule stays that of the plan.
        grown = _post(at @ Pose2(0.0, side, 0.0), radius + _MORE_CLEAR, corners)
        if still_holds(plan, ObstacleSet.from_polygons([grown])):
            posts.append(post)
    return posts


def _post(at: Pose2, radius: float, corners: int) -> np.ndarray:
    angle = 2.0 * math.pi * np.arange(corners) / corners
    outline = radius * np.column_stack((np.cos(angle), np.sin(angle)))
    return transform_points(at.as_array()[None], outline)[0]


def _tasks(plans: Sequence[DockPlan], kind: Kind) -> Iterator[Task]:
    for seed, plan in enumerate(plans):
        rng = np.random.default_rng(seed)
        time = float(rng.uniform(*kind.when)) * plan.trajectory.duration
        if kind.post:
            yield Task(plan, _with_a_post(plan, time, rng), time)
            continue
        angle, turn = rng.uniform(-math.pi, math.pi), math.radians(kind.turn) * rng.uniform(-1.0, 1.0)
        shift = kind.shift * rng.uniform(0.3, 1.0)
        moved = plan.problem.goal @ Pose2(shift * math.cos(angle), shift * math.sin(angle), turn)
        dock = dataclasses.replace(plan.problem.dock, pose=moved)
        yield Task(plan, dataclasses.replace(plan.problem, dock=dock), time)


def _with_a_post(plan: DockPlan, time: float, rng: np.random.Generator) -> DockingProblem:
    """Return the plan's problem with an additional post, 2 cm from the swept area of the rest of the plan."""
    s = float(plan.trajectory.sample_at(time).s[0])
    # At least a robot's length from both ends: closer to the start nothing can be done, and at the end stands the dock.
    length = plan.problem.robot.footprint.length
    low, high = s + length, plan.path.length - plan.problem.dock.final_straight - length
    at = plan.path.pose_at(float(rng.uniform(low, max(low, high))))
    side = math.copysign(1.0, rng.uniform(-1.0, 1.0))
    half = float(np.abs(plan.problem.robot.footprint.vertices[:, 1]).max())
    post = _post(at @ Pose2(0.0, side * (half + 0.1 + 0.02), 0.0), 0.1, 8)
    obstacles = plan.problem.obstacles + ObstacleSet.from_polygons([post], "new")
    return dataclasses.replace(plan.problem, obstacles=obstacles)


def _replan_table(plans: Sequence[DockPlan], repeats: int) -> Table:
    header: tuple[str, ...] = ("change", "calls", "new", "kept", "stop", "how")
    header += (
        "CPU ms p50",
        "CPU ms p99",
        "in time, CPU ms p50",
        "in time, CPU ms p99",
        "in time, ms p50",
        "in time, ms p99",
    )
    header += ("in time: new", "in time: kept", "in time: stop", "plan_dock, CPU ms p50", "ratio p50", "longer % p50")
    rows = tuple(_replan_row(kind.name, list(_tasks(plans, kind)), repeats) for kind in _KINDS)
    note = (
        f"{len(plans)} plans among {_OBSTACLES} obstacles. First with {1e3 * _AMPLE:.0f} ms, of which the quickest of "
        f"{repeats} calls counts; in budget: one call with {1e3 * _BUDGET:.0f} ms. how: of the first. longer: duration "
        "of the new motion beyond that of plan_dock's from the same joint."
    )
    return Table("Replanning in motion", header, rows, note)


def _replan_row(name: str, tasks: Sequence[Task], repeats: int) -> tuple[object, ...]:
    cpu, outcomes, how, fresh, longer = [], [], [], [], []
    hurried: list[tuple[float, float, ReplanOutcome]] = []
    for task in tasks:
        state = DriveState(task.time)
        found, took = _best(
            lambda task=task, state=state: replan(task.plan, task.target, state, _AMPLE, lead=_LEAD), repeats
        )
        cpu.append(took[0])
        outcomes.append(found.outcome)
        with garbage_collection_paused():  # as timeit does: otherwise replan collects the garbage of plan_dock
            timer = Timer()
            outcome = replan(task.plan, task.target, state, _BUDGET, lead=_LEAD).outcome
            hurried.append((timer.cpu, timer.wall, outcome))
        if found.outcome is not ReplanOutcome.NEW or found.plan is None:
            continue
        how.append(found.tried[-1].stage if found.tried else "plan_dock")
        timer = Timer()
        try:
            other = plan_dock(found.plan.problem, time_budget=_ENDLESS)
        except OptdockError:
            continue
        fresh.append(timer.cpu)
        longer.append(found.trajectory.duration / other.trajectory.duration - 1.0)
    counted = collections.Counter(outcomes)
    ways = ", ".join(f"{count} {way}" for way, count in collections.Counter(how).most_common())
    return (
        name,
        len(tasks),
        *(counted[outcome] for outcome in ReplanOutcome),
        ways,
        *(1e3 * percentile(cpu, share) for share in (50, 99)),
        *(1e3 * percentile([one[column] for one in hurried], share) for column in (0, 1) for share in (50, 99)),
        *(sum(one[2] is outcome for one in hurried) for outcome in ReplanOutcome),
        1e3 * percentile(fresh, 50),
        percentile(cpu, 50) / percentile(fresh, 50),
        100.0 * percentile(longer, 50),
    )


def _best(call: Callable[[], Replanned], repeats: int) -> tuple[Replanned, tuple[float, float]]:
    """Return the result of a call, and the CPU and wall seconds of the fastest of several calls."""
    took = []
    for _ in range(repeats):
        timer = Timer()
        found = call()
        took.append((timer.cpu, timer.wall))
    return found, min(took)


def _holds_table(plans: Sequence[DockPlan], repeats: int) -> Table:
    rows = tuple(_holds_row(name, list(cases), repeats) for name, cases in _worlds(plans).items())
    header = ("world", "calls", "holds", "cpu ms p50", "p99", "wall ms p50", "p99")
    return Table("still_holds", header, rows, "From the middle of the drive; costmaps of 200 x 200 cells of 5 cm.")


def _worlds(plans: Sequence[DockPlan]) -> dict[str, list[tuple[DockPlan, object, float]]]:
    found: dict[str, list[tuple[DockPlan, object, float]]] = collections.defaultdict(list)
    for seed, plan in enumerate(plans):
        rng = np.random.default_rng(seed)
        time = 0.3 * float(rng.uniform()) * plan.trajectory.duration
        mapped, later, other = _mapped(plan, rng)
        found["nothing changed"].append((mapped, mapped.problem, time))
        found["costmap of noise"].append((mapped, later, time))
        found["costmap of another origin"].append((mapped, other, time))
        found["20 polygons"].append((plan, _other_polygons(plan, rng), time))
        moved = plan.problem.goal @ Pose2(0.02, -0.01, 0.02)
        dock = dataclasses.replace(plan.problem.dock, pose=moved)
        found["dock moved"].append((plan, dataclasses.replace(plan.problem, dock=dock), time))
        both = dataclasses.replace(mapped.problem, costmap=later, obstacles=_other_polygons(plan, rng))
        found["costmap and polygons"].append((mapped, both, time))
    return found


def _mapped(plan: DockPlan, rng: np.random.Generator) -> tuple[DockPlan, Costmap, Costmap]:
    """Return the plan on a costmap, and two later costmaps."""
    middle = plan.path.pose_at(0.5 * plan.path.length)
    origin = (middle.x - 5.0, middle.y - 5.0)
    x, y = np.meshgrid(origin[0] + 0.05 * np.arange(200), origin[1] + 0.05 * np.arange(200))
    places = plan.path.poses_at(np.linspace(0.0, plan.path.length, 80))
    away = np.min(np.hypot(x[..., None] - places[:, 0], y[..., None] - places[:, 1]), axis=-1)
    reach = plan.problem.robot.footprint.circumscribed_radius + 0.1
    grids = [np.where((rng.uniform(size=x.shape) < share) & (away > reach), 254, 0) for share in (0.02, 0.02)]
    walls = Costmap(grids[0].astype(np.uint8), 0.05, origin)
    later = Costmap(grids[1].astype(np.uint8), 0.05, origin)
    other = Costmap(grids[1].astype(np.uint8), 0.05, (origin[0] + 0.02, origin[1] - 0.03))
    problem = dataclasses.replace(plan.problem, costmap=walls)
    return dataclasses.replace(plan, motion=prove_motion(plan.trajectory, problem)), later, other


def _other_polygons(plan: DockPlan, rng: np.random.Generator) -> ObstacleSet:
    return ObstacleSet.from_polygons(_posts(plan, _OBSTACLES, rng))


def _holds_row(name: str, cases: Sequence[tuple[DockPlan, object, float]], repeats: int) -> tuple[object, ...]:
    cpu, wall, holds = [], [], 0
    for plan, world, time in cases:
        took = []
        for _ in range(repeats):
            fresh = Costmap(world.data, world.resolution, world.origin) if isinstance(world, Costmap) else world
            with garbage_collection_paused():
                timer = Timer()
                found = still_holds(plan, fresh, time)
                took.append((timer.cpu, timer.wall))
        holds += found.holds
        best = min(took)
        cpu.append(best[0])
        wall.append(best[1])
    shares = (50, 99)
    return name, len(cases), holds, *(1e3 * percentile(t, share) for t in (cpu, wall) for share in shares)
