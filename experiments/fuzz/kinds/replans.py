"""`replan`, `still_holds` and the executor's planning on running plans in changed worlds.

Every result reported as proven must be true for the robot at its measured pose.
"""

from __future__ import annotations

import functools
import math
import time
from collections import Counter
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from experiments.fuzz.case import Verdict
from experiments.fuzz.doors import law_of, law_spec, path_of, path_spec, problem_of
from experiments.fuzz.generators.changes import running_plan
from experiments.fuzz.generators.problems import beside
from experiments.fuzz.kinds import paths, trajectories
from experiments.fuzz.lanes import compares_lanes, motion_differs
from experiments.fuzz.oracle.motion import cut, motion_of
from experiments.fuzz.oracle.rules import gap
from experiments.fuzz.oracle.sweep import jumps_at_goal, required_at, start_clearance, start_run, sweep
from experiments.fuzz.oracle.timing import judge_timing, state_at
from experiments.fuzz.oracle.world import World
from experiments.fuzz.truth import says_yes
from optdock.errors import CertificationFailed, OptdockError
from optdock.executor.planning import DrivenMotion, Job, planned
from optdock.geometry.pose import Pose2
from optdock.kernels import using_kernels
from optdock.model.trajectory import Trajectory
from optdock.planning.pipeline import plan_dock, warm_up
from optdock.planning.plan import DockPlan
from optdock.planning.replanning import DriveState, ReplanOutcome, replan, still_holds
from optdock.verification import prove_motion

if TYPE_CHECKING:
    from collections.abc import Mapping

    from experiments.fuzz.case import Case
    from experiments.fuzz.oracle.motion import DrivenMotion as OracleMotion
    from experiments.fuzz.oracle.motion import Floats
    from experiments.fuzz.oracle.sweep import Sweep
    from optdock.executor.planning import PlanResult
    from optdock.model.problem import DockingProblem
    from optdock.planning.replanning import Replanned, StillHolds
    from optdock.verification import TrajectoryCertificate

__all__ = ["draw", "draw_decision", "draw_measured", "judge"]

_FORGIVEN = 2e-6  # [m]: twice the tolerance of the certificate
_SPARE, _ROUND = 1e-3, 0.02  # [m], of the radius: a rest with more margin must hold
_SAME = 2e-6  # [m], [rad], [m/s], [m/s^2]: at the joint
_LATE_CPU = 0.2  # [s] of CPU time past the budget
_TOLERANCES = 0.02, 0.02, 0.05  # of docks: along, cross [m], yaw [rad]
_UNPROVEN = "stop, not proven"
_PROVEN = frozenset(outcome.value for outcome in ReplanOutcome)


def draw(rng: np.random.Generator) -> Case:
    """Draw a random running plan in a changed world."""
    return running_plan(rng)


def draw_measured(rng: np.random.Generator) -> Case:
    """Draw a running plan that is replanned while the robot is measured off its path."""
    return {**running_plan(rng, question="replan", is_beside=True), "kind": "measured"}


def draw_decision(rng: np.random.Generator) -> Case:
    """Draw a running plan for the decision of the executor's planning."""
    return {**running_plan(rng, question="decide", is_beside=True), "kind": "decisions"}


@functools.cache
def _warm() -> None:
    warm_up()


def judge(case: Case) -> Verdict:
    """Make the plan, change the world, call the library, and check the answer; then for the further questions."""
    try:
        plan = _plan(case)
    except OptdockError as error:
        return Verdict(f"no plan: {type(error).__name__}")
    if plan is None:
        return Verdict("no plan: not certified")
    scene = {**_known(case), "path": path_spec(plan.path), "law": law_spec(plan.trajectory.time_law)}
    checked: Counter[str] = Counter()
    first = ""
    for differences in ({}, *case.get("more", ())):
        found = _judged({**case, "more": [], **differences}, scene, plan)
        if found.is_fault:
            return found
        first = first or found.outcome
        checked.update(found.checked)
    return Verdict(first, checked=dict(checked))


def _judged(case: Case, scene: Case, plan: DockPlan) -> Verdict:
    """Return the verdict on one question about a plan."""
    time_now = case["share"] * plan.trajectory.duration
    world = _world(case, scene, time_now)
    full = {**case, "path": scene["path"], "law": scene["law"], "world": _difference(scene, world), "beside": [0, []]}
    try:
        later = problem_of(world)
    except OptdockError as error:
        return Verdict(f"input refused: {type(error).__name__}", str(error))
    known = {"costmap": later.costmap, "obstacles": later.obstacles}.get(case["asked"], later)
    word, wrong, proven = "", None, []
    if case["question"] != "decide":
        found = still_holds(plan, known, time_now)
        wrong = _about_the_rest(scene, world, time_now, found, plan.certificate.start_relief)
        word = "holds" if says_yes(found) else "holds no more"
        wrong = wrong or _rest_differs(plan, world, case, time_now, found)
        proven += ["holds"] if found else []
    if wrong is None and case["question"] != "holds":
        word, wrong = _about_the_answer(case, scene, world, plan, later, time_now)
        proven += [word] if word in _PROVEN else []
    if wrong is not None:
        return Verdict(wrong.outcome, wrong.detail, full)
    return Verdict(word, checked=dict(Counter(proven)))


def _known(case: Case) -> Case:
    """Return the world in which the plan is made."""
    return {key: value for key, value in case.items() if key not in ("world", "beside", "more")}


def _plan(case: Case) -> DockPlan | None:
    _warm()
    problem = problem_of(_known(case))
    if "path" not in case:
        return plan_dock(problem, time_budget=case["budget"])
    path = path_of(case["path"]).with_frame(problem.frame)
    try:
        return DockPlan(prove_motion(Trajectory(path, law_of(case["law"])), problem), path)
    except CertificationFailed:
        return None


def _world(case: Case, scene: Case, now: float) -> Case:
    """Return the present world, with the obstacles that appear next to the rest of the path."""
    passed = {"costmap": {"grid"}, "obstacles": {"obstacles"}, "pose": {"dock"}}.get(case["asked"], case["world"])
    world = {**scene, **{key: value for key, value in case["world"].items() if key in passed}}
    seed, gaps = case.get("beside", [0, []])
    if gaps:
        rest = motion_of(cut(scene["path"], state_at(scene["law"], now).s))
        more = beside(np.random.default_rng(seed), world, rest, gaps)
        world["obstacles"] = [*world["obstacles"], *more]
    return world


def _difference(scene: Case, world: Case) -> Case:
    return {key: value for key, value in world.items() if value is not scene.get(key)}


# still_holds


def _rest_differs(plan: DockPlan, world: Case, case: Case, now: float, found: StillHolds) -> Verdict | None:
    """Return the difference to the answer of the twin lane, if lanes are compared."""
    if not compares_lanes():
        return None
    with using_kernels("twin"):
        later = problem_of(world)
        known = {"costmap": later.costmap, "obstacles": later.obstacles}.get(case["asked"], later)
        other = still_holds(plan, known, now)
    if bool(other) == bool(found):
        return None
    return Verdict("kernel differs", f"still_holds: {found.reason or 'holds'} in C, {other.reason or 'holds'} by NumPy")


def _about_the_rest(scene: Case, world: Case, now: float, found: StillHolds, relief: float) -> Verdict | None:
    """Check whether the rest satisfies the plan's rule, including growth from its start, in the present world."""
    solid = World.of(world)
    if solid.is_empty:
        return None if found or "frame" in found.changed else Verdict("false refusal", "still_holds: in an empty world")
    begun = start_clearance(scene, World.of(scene))
    if relief > (1.0 + _ROUND) * start_run(scene):
        return Verdict("false certificate", f"start relief: {relief:.6g} m, the rule allows {start_run(scene):.6g} m")
    rest = motion_of(cut(scene["path"], state_at(scene["law"], now).s))
    seen = sweep(world, rest, solid, relief=relief, begun_with=begun)
    if found:
        return _short("still_holds", world, seen)
    spare = _SPARE + _ROUND * solid.radius
    if seen.margin.min() > spare and not jumps_at_goal(world):
        return Verdict(
            "false refusal", f"still_holds: {found.reason}; the smallest margin is {seen.margin.min():.4g} m"
        )
    return None


def _short(what: str, world: Case, seen: Sweep) -> Verdict | None:
    k = seen.worst
    if seen.margin[k] >= -_FORGIVEN:
        return None
    text = f"{-seen.margin[k]:.4g} m short at s = {seen.s[k]:.6g} m of the rest, clearance {seen.clearance[k]:.6g} m"
    grid = ", grid" if world.get("grid") is not None else ""
    return Verdict("false proof", f"{what}{grid}: {text}, pose {seen.poses[k].tolist()}")


# replan


class _Now(NamedTuple):
    """True state by the oracle.

    `driven`: the running path in which it is followed. `ahead`: that path moved to the measured robot, or the same path
    if the robot is on it. `pose`: of the robot; None: on its path.
    """

    time: float
    rate: float
    pose: Floats | None
    driven: list[Case]
    ahead: list[Case]
    case: Case
    scene: Case
    world: Case
    plan: DockPlan

    def s_at(self, t: float) -> float:
        return state_at(self.scene["law"], t).s

    def steers_at(self, t: float) -> bool:
        """Whether the robot rests at a cusp then, and for longer than a microsecond."""
        law = self.scene["law"]
        is_cusp = any(abs(one.start_s - self.s_at(t)) < 1e-6 for one in motion_of(self.scene["path"]).segments[1:])
        later = state_at(law, t + 1e-6), state_at(law, t + 1e-3)
        return is_cusp and all(max(abs(one.v), abs(one.a)) < 1e-6 for one in later)

    def pose_at(self, t: float) -> Floats:
        """Return the robot's pose at trajectory time `t`."""
        return motion_of(cut(self.ahead, self.s_at(t))).start


class _Answer(NamedTuple):
    """The motion to drive, and whether it is reported as proven; as in `Replanned`, or by the executor's planning."""

    outcome: ReplanOutcome
    trajectory: Trajectory
    starts_at: float
    plan: DockPlan | None
    proven: bool
    motion: TrajectoryCertificate | None

    @classmethod
    def of(cls, found: Replanned) -> _Answer:
        return cls(found.outcome, found.trajectory, found.starts_at, found.plan, says_yes(found), found.motion)

    @classmethod
    def decided(cls, found: PlanResult, running: DockPlan) -> _Answer | None:
        """Return the executor's answer; None if the planning has reported failure."""
        if not says_yes(found):
            return None
        outcome = ReplanOutcome(found.outcome.value)
        if found.motion is None:
            return cls(outcome, running.trajectory, 0.0, running, proven=True, motion=None)
        plan = found.motion.plan
        return cls(outcome, found.motion.trajectory, found.starts_at, plan, proven=plan is not None, motion=None)


def _moved(path: list[Case], by: Pose2) -> list[Case]:
    """Return a path after a rigid motion of the plane."""
    x, y, turn = by.x, by.y, by.yaw
    c, s = math.cos(turn), math.sin(turn)

    def moved(pose: list[float]) -> list[float]:
        return [x + c * pose[0] - s * pose[1], y + s * pose[0] + c * pose[1], pose[2] + turn]

    return [
        {**gear, "poses": [moved(pose) for pose in gear["poses"]]}
        if gear["type"] == "polyline"
        else {**gear, "start": moved(gear["start"])}
        for gear in path
    ]


def _about_the_answer(
    case: Case, scene: Case, world: Case, plan: DockPlan, later: DockingProblem, now: float
) -> tuple[str, Verdict | None]:
    by = None if case["moved"] is None else Pose2(*case["moved"])
    driven = scene["path"] if by is None else _moved(scene["path"], by)
    reference = Pose2(*motion_of(cut(driven, state_at(scene["law"], now).s)).start.tolist())
    pose = None if case["offset"] is None else reference @ Pose2(*case["offset"])
    ahead = driven if pose is None else _moved(driven, pose @ reference.inverse())
    target = Pose2(*world["dock"]["pose"]) if case["asked"] == "pose" else later
    budget = case["replan_budget"]
    began = time.process_time()
    try:
        if case["question"] == "decide":
            lead = budget if case["lead"] is None else case["lead"]
            job = Job(1, 0.0, later, budget, DrivenMotion.of(plan), now, case["rate"], pose, lead, by)
            found = _Answer.decided(planned(job), plan)
        else:
            state = DriveState(now, case["rate"], pose, by)
            found = _Answer.of(replan(plan, target, state, budget, drive_delay=case["delay"], lead=case["lead"]))
    except OptdockError as error:
        return "raised", Verdict("untyped exception", f"replan {type(error).__name__}: {error}")
    spent = time.process_time() - began - budget
    if found is None:
        return "failed", None
    measured = None if pose is None else pose.as_array()
    this = _Now(now, case["rate"], measured, driven, ahead, case, scene, world, plan)
    if pose is not None and case["question"] == "replan" and found.outcome is not ReplanOutcome.KEPT:
        on_the_path = this._replace(ahead=driven)
        begins = motion_of(path_spec(found.trajectory.path)).start
        if gap(begins, this.pose_at(found.starts_at)) > _SAME >= gap(begins, on_the_path.pose_at(found.starts_at)):
            this = on_the_path
            wrong = _in_tube(this, found)
            if wrong is not None:
                return found.outcome.value, wrong
    word = found.outcome.value if found.proven else _UNPROVEN
    checks = {ReplanOutcome.NEW: _new, ReplanOutcome.KEPT: _kept, ReplanOutcome.STOP: _stop}
    wrong = _instant(this, found) or checks[found.outcome](this, found)
    if wrong is None and spent > _LATE_CPU:
        wrong = Verdict("late", f"replan {word}: {1e3 * spent:.0f} ms of CPU past {1e3 * budget:.0f} ms")
    return word, wrong


def _instant(this: _Now, found: _Answer) -> Verdict | None:
    """Check the time at which the answer takes over: not before it is available."""
    if found.outcome is ReplanOutcome.KEPT:
        return None
    duration = sum(this.scene["law"]["durations"])
    earliest = min(max(this.time, 0.0), duration)
    if found.starts_at < earliest - 1e-9 or found.starts_at > duration + 1e-9:
        return Verdict("false certificate", f"starts_at: {found.starts_at:.6g} s, it is {earliest:.6g} s already")
    return None


def _standing_start(this: _Now) -> Case:
    """Return the world with the present robot pose as start."""
    return {**this.world, "start": this.pose_at(this.time).tolist(), "start_speed": 0.0, "start_curvature": None}


def _way(this: _Now, what: str, way: list[Case], world: Case | None = None) -> Verdict | None:
    """Check whether a path from the present pose keeps clear, at least by the weaker rule."""
    world = _standing_start(this) if world is None else world
    solid = World.of(world)
    if solid.is_empty:
        return None
    return _short(what, world, sweep(world, motion_of(way), solid, relief=start_run(world)))


def _until(this: _Now, joint: float) -> list[Case]:
    return cut(this.ahead, this.s_at(this.time), max(this.s_at(joint), this.s_at(this.time)))


def _joined(this: _Now, found: _Answer) -> tuple[Case, Verdict | None]:
    """Return the state at the joint as `start...`, and discontinuities of the answer."""
    path, law = path_spec(found.trajectory.path), found.trajectory.time_law
    state, pose = state_at(this.scene["law"], found.starts_at), this.pose_at(found.starts_at)
    speed, gained = this.rate * state.v, this.rate**2 * state.a
    wanted = {"start": pose.tolist(), "start_speed": speed, "start_acceleration": gained}
    off = gap(motion_of(path).start, pose)
    if off > _SAME:
        return wanted, Verdict(
            "false certificate", f"joint {found.outcome.value}: begins {off:.4g} away from the robot"
        )
    jumps = abs(float(law.start_speed) - speed), abs(float(law.start_acceleration) - gained)
    if max(jumps) > _SAME:
        text = f"speed jumps by {jumps[0]:.4g} m/s, acceleration by {jumps[1]:.4g} m/s^2"
        return wanted, Verdict("false certificate", f"joint {found.outcome.value}: {text}")
    jump = _wheels_jump(this, found, moving=max(speed, abs(gained)) > 1e-6)
    return wanted, Verdict("false certificate", f"joint {found.outcome.value}: {jump}") if jump else None


def _wheels_jump(this: _Now, found: _Answer, *, moving: bool) -> str:
    """Return discontinuities of gear and curvature at the joint; for polylines only of gears."""
    if found.trajectory.path.driven <= 1e-6:
        return ""
    before = motion_of(cut(this.scene["path"], state_at(this.scene["law"], found.starts_at).s))
    after = motion_of(path_spec(found.trajectory.path))
    bent, gears = (float(before.k0[0]), float(after.k0[0])), (float(before.gear[0]), float(after.gear[0]))
    if moving and gears[0] != gears[1]:
        return f"gear {gears[0]} to {gears[1]}"
    if any(gear["type"] == "polyline" for gear in this.scene["path"]):
        return ""
    if moving and abs(bent[0] - bent[1]) > 1e-6 * (1.0 + abs(bent[0])):
        return f"curvature jumps from {bent[0]:.6g} to {bent[1]:.6g} 1/m"
    wheels = gears[0] * bent[0], gears[1] * bent[1]
    is_steered = math.isfinite(this.world["limits"].get("max_steering_rate", math.inf))
    turning = abs(wheels[0] - wheels[1]) > 1e-6 * (1.0 + abs(wheels[0])) or this.steers_at(found.starts_at)
    if not is_steered or not turning or (not moving and _waits_for_any_angle(this.world["limits"], found, wheels[1])):
        return ""
    return f"wheels turned for {wheels[0]:.6g} 1/m or still turning, the path begins with {wheels[1]:.6g} 1/m"


def _waits_for_any_angle(limits: Mapping[str, float], found: _Answer, curvature: float) -> bool:
    """Whether the new motion begins with a rest in which the wheels reach a curvature [1/m] from any angle."""
    law, wheelbase = found.trajectory.time_law, limits["wheelbase"]
    resting = np.all(law.states == law.states[0], axis=1)
    rest = float(law.times[len(resting) if resting.all() else int(resting.argmin()) - 1] - law.times[0])
    widest = limits.get("max_steering_angle", math.inf)
    if not math.isfinite(widest):
        widest = math.atan(wheelbase * limits.get("max_curvature", math.inf))
    return rest * limits["max_steering_rate"] >= widest + math.atan(wheelbase * abs(curvature)) - 1e-6


def _timed(this: _Now, found: _Answer, start: Case, zone: list[object]) -> Case:
    return {
        "kind": "trajectories",
        "path": path_spec(found.trajectory.path),
        "law": law_spec(found.trajectory.time_law),
        "limits": this.world["limits"],
        "zone": zone,
        "start_speed": abs(start["start_speed"]),
        "start_acceleration": start["start_acceleration"],
    }


def _new(this: _Now, found: _Answer) -> Verdict | None:
    plan = found.plan
    assert plan is not None
    if not (says_yes(plan.certificate) and says_yes(plan.trajectory_certificate)):
        return Verdict("uncertified plan", plan.certificate.reason or plan.trajectory_certificate.reason)
    start, wrong = _joined(this, found)
    if wrong is not None:
        return wrong
    if max(start["start_speed"], abs(start["start_acceleration"])) <= 1e-6:  # at rest, except for rounding
        start = {**start, "start_speed": 0.0, "start_acceleration": 0.0}
    timed = _timed(this, found, start, this.world["zone"])
    is_moving = start["start_speed"] > 1e-6
    signed = start["start_speed"] * float(motion_of(timed["path"]).gear[0] or 1.0) if is_moving else 0.0
    scene = {**this.world, **start, "start_speed": signed, "start_curvature": None, "path": timed["path"]}
    wrong = _way(this, "way until NEW takes over", _until(this, found.starts_at))
    if wrong is None and compares_lanes():
        wrong = motion_differs(plan.trajectory, plan.motion.problem)
    return wrong or paths.refuted(scene, plan.certificate) or trajectories.refuted(timed, plan.trajectory_certificate)


def _kept(this: _Now, found: _Answer) -> Verdict | None:
    if found.trajectory is not this.plan.trajectory:
        return Verdict("false certificate", "KEPT: another trajectory")
    goal, end = np.array(this.world["dock"]["pose"]), motion_of(this.driven).end
    c, s = math.cos(goal[2]), math.sin(goal[2])
    dx, dy = end[0] - goal[0], end[1] - goal[1]
    errors = abs(c * dx + s * dy), abs(c * dy - s * dx), abs(math.remainder(end[2] - goal[2], 2.0 * math.pi))
    if any(error > most + 1e-9 for error, most in zip(errors, _TOLERANCES, strict=True)):
        return Verdict("false certificate", f"KEPT: ends {errors} from the dock")
    # The station stands at the end of the plan, which is as close as the tolerances allow.
    start = _standing_start(this)
    world = {**start, "dock": {**this.world["dock"], "pose": end.tolist()}}
    if this.pose is not None and gap(this.pose, motion_of(cut(this.driven, this.s_at(this.time))).start) > _SAME:
        begun, relief = start_clearance(this.scene, World.of(this.scene)), this.plan.certificate.start_relief
        world = {**world, "start": motion_of(this.driven).start.tolist()}
        return _beside(this, "KEPT", world, cut(this.driven, this.s_at(this.time)), begun, relief)
    rest = cut(this.driven, this.s_at(this.time))
    return _way(this, "KEPT", rest, world) or _limits(this, "KEPT", this.time)


def _in_tube(this: _Now, found: _Answer) -> Verdict | None:
    """Check whether a robot that stays off its path is within the tube around it, until the new motion begins."""
    if not found.proven:
        return None
    world = _standing_start(this)
    begun = start_clearance(world, World.of(world))
    return _beside(this, found.outcome.value, world, _until(this, found.starts_at), begun, start_run(world))


def _beside(
    this: _Now, what: str, world: Case, rest_of_path: list[Case], begun: float, relief: float
) -> Verdict | None:
    """Check whether a robot off its path, and every pose between it and the path, keeps the required clearance.

    That is the clearance without the tube, at the nearest place of the path. The station is ignored for poses that
    count as docked. Within the tube, poses farther off than the width of the tube are ignored.
    """
    assert this.pose is not None
    plain = {**world, "tracking": [0.0, 0.0]}
    solid = World.of(plain)
    now = this.s_at(this.time)
    poses = _poses_along(_leg(this.driven, now), 1500)
    off = _displacements(this.pose, poses, solid.reach)
    best = int(np.argmin(off))
    local = this.pose - poses[best]
    c, s = math.cos(poses[best, 2]), math.sin(poses[best, 2])
    local = np.array([c * local[0] + s * local[1], c * local[1] - s * local[0], math.remainder(local[2], 2 * math.pi)])
    widths = required_at({**plain, "tracking": world.get("tracking", [0.0, 0.0])}, poses, begun, relief)
    widths -= required_at(plain, poses, begun, relief)
    is_covered = bool(off[best] <= widths[best])
    if not is_covered and all(abs(one) <= most for one, most in zip(local, _TOLERANCES, strict=True)):
        solid = World.of({**plain, "dock": {**plain["dock"], "footprint": None}})
    if solid.is_empty:
        return None
    places = off <= off[best] + _NEAREST
    least = float(required_at(plain, poses[places], begun, relief).min())
    short = least - float(solid.clearances(this.pose[None])[0])
    if short > _FORGIVEN:
        return Verdict("false proof", f"{what} beside: {short:.4g} m short where the robot is, {this.pose.tolist()}")
    rest = _poses_along(motion_of(rest_of_path), 80)
    needed = required_at(plain, rest, begun, relief)
    most = np.full(len(rest), max(0.0, float(off[best]) - _NEAREST))
    if is_covered:
        tubed = required_at({**plain, "tracking": world.get("tracking", [0.0, 0.0])}, rest, begun, relief)
        most = np.minimum(most, tubed - needed)
    for share in (1.0, 0.5, 0.0):
        shift = local * (share * most / max(float(off[best]), 1e-12))[:, None]
        between = _shifted(rest, shift)
        margins = solid.clearances(between) - needed
        k = int(np.argmin(margins))
        if margins[k] < -_FORGIVEN:
            text = f"{-margins[k]:.4g} m short {share} of the way off, {between[k].tolist()}"
            return Verdict("false proof", f"{what} beside: {text}")
    return None


def _leg(path: list[Case], now: float) -> OracleMotion:
    """Return the part within half a metre of a place, in the same gear."""
    legs = motion_of(path).segments
    leg = next((one for one in legs if now < one.start_s + one.length), legs[-1])
    return motion_of(cut(path, max(leg.start_s, now - 0.5), min(leg.start_s + leg.length, now + 0.5)))


_NEAREST = 2e-3  # [m]: accuracy of the nearest place of the path


def _poses_along(motion: OracleMotion, count: int) -> Floats:
    """Return poses of a path, with the pieces sampled by their length and turn. Shape (about count, 3)."""
    weight = motion.way + motion.turn
    parts = np.maximum(1, np.ceil(count * weight / max(float(weight.sum()), 1e-12))).astype(np.int64)
    piece = np.repeat(np.arange(parts.size), parts + 1)
    rank = np.arange(piece.size) - np.repeat(np.cumsum(parts + 1) - (parts + 1), parts + 1)
    return motion.poses_at(piece, rank / parts[piece])


def _displacements(pose: Floats, poses: Floats, reach: float) -> Floats:
    """Return bounds of the displacement of any outline point from its place at each of the poses. Shape (n,) [m]."""
    turned = np.abs(np.remainder(pose[2] - poses[:, 2] + np.pi, 2.0 * np.pi) - np.pi)
    found: Floats = np.hypot(pose[0] - poses[:, 0], pose[1] - poses[:, 1]) + 2.0 * reach * np.sin(0.5 * turned)
    return found


def _shifted(poses: Floats, local: Floats) -> Floats:
    """Return every pose, moved in its local frame."""
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    x = poses[:, 0] + c * local[:, 0] - s * local[:, 1]
    y = poses[:, 1] + s * local[:, 0] + c * local[:, 1]
    return np.column_stack((x, y, poses[:, 2] + local[:, 2]))


def _limits(this: _Now, what: str, now: float) -> Verdict | None:
    """Check whether the rest of the running motion satisfies the limits of the present world."""
    if this.world["limits"] == this.scene["limits"] and this.world["zone"] == this.scene["zone"]:
        return None
    law, state = this.scene["law"], state_at(this.scene["law"], now)
    borders = np.concatenate(([0.0], np.cumsum(law["durations"])))
    left = np.clip(borders[1:] - max(now, 0.0), 0.0, np.diff(borders))
    keep = left > 0.0
    if not keep.any():
        return None
    rest = {
        "durations": left[keep].tolist(),
        "jerks": np.array(law["jerks"])[keep].tolist(),
        "start_speed": state.v,
        "start_acceleration": state.a,
    }
    path = cut(this.scene["path"], state.s)
    found = judge_timing(
        {**this.world, "path": path, "law": rest, "start_speed": None, "start_acceleration": None}, motion_of(path)
    ).ratios
    worst = max(found, key=lambda name: found[name])
    if found[worst] > 1.0 + 1e-4:
        return Verdict("false certificate", f"{what}: {worst} {found[worst]:.6g} times what is allowed now")
    return None


def _stop(this: _Now, found: _Answer) -> Verdict | None:
    start, wrong = _joined(this, found)
    standing = found.trajectory.path.driven <= 1e-6
    if wrong is not None and not (standing and not found.proven):
        return wrong
    end = found.trajectory.time_law.states[-1]
    if max(abs(end[1]), abs(end[2])) > 1e-6:
        return Verdict("false certificate", f"STOP: ends at {end[1]:.4g} m/s, {end[2]:.4g} m/s^2")
    if not found.proven:
        return None
    timed = _timed(this, found, start, [None, 0.0])
    assert found.motion is not None
    wrong = trajectories.refuted(timed, found.motion)
    if wrong is not None:
        return Verdict(wrong.outcome, f"STOP {wrong.detail}")
    return _way(this, "way until STOP takes over", _until(this, found.starts_at)) or _way(this, "STOP", timed["path"])
