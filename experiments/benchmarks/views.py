"""Docks that must stay in view: rate of certified plans among those of 200 starts that are feasible.

    python -m experiments.benchmarks views
    python -m experiments.benchmarks views --visible 2.0 --degrees 40 --count 60

The robot has a camera with a cone of 60 degrees in front; the marker must be in view over the last 1.5 m. The docks are
the forward docks of `real_maps` on the maps of this project, the starts 1 to 6 m around them with any bearing and any
heading, as in the manoeuvre benchmark. Every start is planned with and without the view, each within the default time.

A solution *exists* for this table if it sees the dock and its length is at most 1.2 times that of the plan without the
view. Candidates are the plan without the view, the plan with it, a plan with a long budget (10 s), and plans to a place
on the dock's axis with a straight from there. Visibility of a path is decided here by bearings at dense samples,
certification by `certify_path`.
"""

from __future__ import annotations

import argparse
import dataclasses
import math
import time
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from experiments.benchmarks.tables import Table, percentile
from experiments.manoeuvres.cases import SEED, free_starts, side_of
from experiments.real_maps import DRAWN_SCENARIOS, problem_of
from optdock.errors import OptdockError
from optdock.geometry.clothoid import ClothoidSpline
from optdock.geometry.pose import Pose2
from optdock.model.camera import Camera
from optdock.model.dock import Dock, DockDirection
from optdock.model.path import ClothoidSegment, Path, place_before_end
from optdock.planning.pipeline import DEFAULT_TIME_BUDGET, plan_dock, warm_up

if TYPE_CHECKING:
    from collections.abc import Iterator

    from optdock.model.problem import DockingProblem
    from optdock.planning.plan import DockPlan

LONGER = 1.2  # ratio to the plan without the view: limit of a solution that counts
PATIENT = 10.0  # [s]
STAGES = (0.6, 1.0, 1.5, 2.0)  # [m] before the dock, on its axis: start of the straight
SPACING = 0.002  # [m] between samples
MOUNT, MARKER = (
    Pose2(0.4, 0.0, 0.0),
    (0.55, 0.0),
)  # on the robot, 5 cm behind its bumper; in the charger, 10 cm before it
SAME_SIGHT = 1e-5  # [rad]: effect of rounding and of the certificate's tolerance on a bearing at these distances


class ViewResult(NamedTuple):
    """One start: dock, start in its frame, results, and the duration of planning with the view [s].

    `free`, `seeing`: lengths of the plans without and with the view [m]; None: no plan. `shortest`: length of the
    shortest known solution. `reason`: refusal of the plan with the view.
    """

    name: str
    side: str
    free: float | None
    seeing: float | None
    shortest: float | None
    seconds: float
    reason: str

    @property
    def exists(self) -> bool:
        """Whether a known path sees the dock and is not much longer than the plan without the view."""
        return self.free is not None and self.shortest is not None and self.shortest <= LONGER * self.free


def starts(count: int, seed: int) -> Iterator[tuple[str, DockingProblem]]:
    """Yield random starts around the docks that are entered forward, the same number around each, in turn."""
    docks = [scenario for scenario in DRAWN_SCENARIOS if not scenario.backward]
    each = -(-count // len(docks))
    found = []
    for number, scenario in enumerate(docks):
        problem = problem_of(scenario)
        poses = np.concatenate(list(free_starts(problem, each, np.random.default_rng((seed, number)))))[:each]
        found.append([(f"{scenario.name} {i}", problem.starting_at(Pose2(*pose))) for i, pose in enumerate(poses)])
    yield from [row[i] for i in range(each) for row in found][:count]


def seeing(problem: DockingProblem, degrees: float, visible: float) -> DockingProblem:
    """Return the problem with the camera and the marker."""
    robot = dataclasses.replace(problem.robot, camera=Camera(MOUNT, math.radians(degrees)))
    dock = dataclasses.replace(problem.dock, marker=MARKER, visible_distance=visible)
    return dataclasses.replace(problem, robot=robot, dock=dock)


def sees(path: Path, problem: DockingProblem, degrees: float, visible: float) -> bool:
    """Whether the marker is in the cone at dense samples of the last stretch, by bearings."""
    s = np.arange(max(0.0, place_before_end(path, visible)), path.length, SPACING)
    x, y, yaw = path.poses_at(np.append(s, path.length)).T
    goal = problem.goal
    mx, my = (
        goal.x + MARKER[0] * math.cos(goal.yaw) - MARKER[1] * math.sin(goal.yaw),
        goal.y + MARKER[0] * math.sin(goal.yaw) + MARKER[1] * math.cos(goal.yaw),
    )
    bearing = np.arctan2(my - y - MOUNT.x * np.sin(yaw), mx - x - MOUNT.x * np.cos(yaw)) - yaw
    folded = np.abs(np.remainder(bearing + np.pi, 2.0 * np.pi) - np.pi)
    return bool(folded.max() <= math.radians(0.5 * degrees) + SAME_SIGHT)


def planned(problem: DockingProblem, seconds: float) -> tuple[DockPlan | None, str]:
    """Return a plan, or the reason of its refusal."""
    try:
        return plan_dock(problem, time_budget=seconds), ""
    except OptdockError as error:
        return None, f"{type(error).__name__}: {error}"


def by_stages(problem: DockingProblem) -> Iterator[Path]:
    """Return plans to places on the dock's axis with a straight from there."""
    for distance in STAGES:
        stage = problem.goal @ Pose2(-distance, 0.0, 0.0)
        dock = Dock(stage, direction=DockDirection.FORWARD)
        there, _ = planned(dataclasses.replace(problem, dock=dock, obstacles=problem.all_obstacles), 1.0)
        if there is not None:
            line = ClothoidSpline(stage, np.array([0.0, distance]), np.zeros(2))
            yield Path((*there.path.segments, ClothoidSegment(line)), problem.frame)


def plan_start(name: str, problem: DockingProblem, degrees: float, visible: float) -> ViewResult:
    """Plan one start in all ways."""
    wanted = seeing(problem, degrees, visible)
    free, _ = planned(problem, DEFAULT_TIME_BUDGET)
    began = time.perf_counter()
    plan, reason = planned(wanted, DEFAULT_TIME_BUDGET)
    seconds = time.perf_counter() - began
    known = [one.path for one in (free, plan) if one is not None]
    if plan is None and free is not None:
        patient, _ = planned(wanted, PATIENT)
        known += [patient.path] if patient is not None else []
        known += by_stages(problem)
    lengths = [path.driven for path in known if sees(path, problem, degrees, visible)]
    if plan is not None and not sees(plan.path, problem, degrees, visible):
        raise AssertionError(f"{name}: certified, and the marker is out of view")
    return ViewResult(
        name,
        side_of(problem.dock, problem.start),
        None if free is None else free.path.driven,
        None if plan is None else plan.path.driven,
        min(lengths, default=None),
        seconds,
        reason,
    )


def row(side: str, some: list[ViewResult]) -> tuple[object, ...]:
    """Return one row: results of some of the starts."""
    existing = [one for one in some if one.exists]
    hit = sum(one.seeing is not None for one in existing)
    longer = [one.seeing / one.free for one in some if one.seeing is not None and one.free is not None]
    milliseconds = [1e3 * one.seconds for one in some if one.seeing is not None]
    return (
        side,
        len(some),
        sum(one.free is not None for one in some),
        len(milliseconds),
        len(existing),
        hit,
        100.0 * hit / len(existing) if existing else math.nan,
        percentile(longer, 50),
        percentile(longer, 90),
        percentile(milliseconds, 50),
        percentile(milliseconds, 90),
    )


def main(arguments: list[str]) -> None:
    """Print the table, and every start with a solution but without a plan."""
    parser = argparse.ArgumentParser(prog="views", description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=200, help="number of starts (default: %(default)s)")
    parser.add_argument(
        "--degrees", type=float, default=60.0, help="opening angle of the cone [deg] (default: %(default)s)"
    )
    parser.add_argument(
        "--visible", type=float, default=1.5, help="distance of the view before the dock [m] (default: %(default)s)"
    )
    parser.add_argument("--seed", type=int, default=SEED)
    options = parser.parse_args(arguments)
    warm_up()
    found = [
        plan_start(name, problem, options.degrees, options.visible)
        for name, problem in starts(options.count, options.seed)
    ]
    sides = ("before", "oblique", "beside or behind")
    table = tuple(row(side, [one for one in found if one.side == side]) for side in sides)
    header: tuple[str, ...] = (
        "start",
        "starts",
        "planned without",
        "certified with",
        "way exists",
        "of these certified",
        "%",
    )
    header = (*header, "longer p50", "p90", "ms p50", "p90")
    note = f"cone of {options.degrees:g} degrees over the last {options.visible:g} m, seed {options.seed}"
    print(Table("Docks that stay in view", header, (*table, row("all", found)), note))
    for one in found:
        if one.exists and one.seeing is None:
            print(f"{one.name} ({one.side}): a way of {one.shortest:.2f} m, {one.free:.2f} m without; {one.reason}")
