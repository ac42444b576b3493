"""A verdict is its truth value: whatever says no counts as false, in every class of the product that says anything."""

import functools
import importlib
import inspect
import pkgutil
import typing
from enum import Enum

import numpy as np
import pytest

import checkers
import optdock
import smoothers
from experiments.dense_check import DenseReport, Fault, dense_check
from optdock.executor.log import Cycle
from optdock.executor.planning import Outcome, PlanResult, Verdict
from optdock.executor.replay import Replay
from optdock.executor.task_states import Ending, EndingKind
from optdock.geometry.footprint import Footprint
from optdock.geometry.pose import Pose2
from optdock.impossibility import ImpossibilityVerdict, check_impossibility, prove_impossible
from optdock.io.run_file import RunColumns
from optdock.model.constant_jerk import TimeLaw
from optdock.model.dock import Dock
from optdock.model.limits import MotionLimits, SpeedZone
from optdock.model.path import Path
from optdock.model.problem import DockingProblem
from optdock.model.robot import Robot
from optdock.model.trajectory import Trajectory
from optdock.planning.changed_world import StillHolds
from optdock.planning.pipeline import plan_dock
from optdock.planning.replanning import Replanned, ReplanOutcome
from optdock.plugins.outcomes import BehaviorResult, BehaviorStatus, SampledBound, TimingResult, TimingStatus
from optdock.reports.plan_file_verdict import PlanFileVerdict
from optdock.samples import SampledMotionVerdict
from optdock.simulation.closed_loop import Run
from optdock.timing.plan_checks import SegmentPlan
from optdock.timing.start_states import StartVerdict
from optdock.verification import Certificate, TrajectoryCertificate, Violation, certify_path, certify_trajectory
from optdock.verification.conservative_advancement import ClearanceProof
from optdock.verification.proven_motion import WayVerdict, prove_way
from smoothers.scp.search import PathVerdict

# What a class calls its verdict: an attribute or a property that is a bool. Where one of these is no verdict, the class
# stands in `NO_VERDICT`.
WORDS = {
    *(
        "accepted",
        "admissible",
        "agrees",
        "arrived",
        "arrives",
        "certified",
        "clear",
        "docked",
        "feasible",
        "holds",
        "ok",
    ),
    *("passed", "possible", "proven", "reached", "refuted", "safe", "sound", "still_holds", "succeeded", "success"),
    *("valid", "verified"),
}
DENIALS = {"refuted"}  # words that say no
NO_VERDICT = {
    "experiments.families.scene.Scene",  # what a scene was made to be
    "optdock.timing.near_optimal.ReferenceMotion",  # a step of a search, as the two below
    "optdock.timing.plan_checks.SegmentPlan",
    "smoothers.scp.loop.Iterate",
}


def classes():
    roots = (optdock, smoothers, checkers)
    modules = [
        importlib.import_module(found.name)
        for root in roots
        for found in pkgutil.walk_packages(root.__path__, f"{root.__name__}.")
        if not found.name.endswith("__main__")
    ]
    return {c for m in modules for c in vars(m).values() if inspect.isclass(c) and c.__module__ == m.__name__}


def words_of(kind):
    """Which of its attributes are verdicts by their names, or by the enumeration that they are a member of."""
    fields = {name: str(kind_of) for name, kind_of in getattr(kind, "__annotations__", {}).items()}
    for name, member in dict(vars(kind)).items():  # a copy: models of files are built when they are read
        getter = member.fget if isinstance(member, property) else getattr(member, "func", None)
        if isinstance(member, property | functools.cached_property):
            fields[name] = str(getter.__annotations__.get("return"))
    judging = {one.__name__ for one in (TimingStatus, BehaviorStatus, EndingKind)}
    return {
        name
        for name, kind_of in fields.items()
        if (name in WORDS and kind_of in ("bool", "<class 'bool'>", "ForwardRef('bool')"))
        or any(kind_of in (one, f"ForwardRef('{one}')") for one in judging)
    }


def is_verdict(kind):
    said = (inspect.getdoc(kind) or "").split("\n", maxsplit=1)[0]
    named = kind.__name__.endswith(("PathVerdict", "Certificate")) or "verdict" in said or said.startswith("Whether")
    if kind.__name__.startswith("_") or f"{kind.__module__}.{kind.__qualname__}" in NO_VERDICT:
        return False
    return named or bool(words_of(kind))


VERDICTS = [
    *(Certificate, TrajectoryCertificate, ImpossibilityVerdict, ClearanceProof, SampledMotionVerdict, StillHolds),
    *(
        Verdict,
        PlanResult,
        EndingKind,
        Ending,
        PlanFileVerdict,
        Replanned,
        WayVerdict,
        Replay,
        Run,
        RunColumns,
        DenseReport,
    ),
    *(TimingStatus, TimingResult, BehaviorStatus, BehaviorResult, StartVerdict, SampledBound, PathVerdict),
]


def world(*rocks):
    robot = Robot(Footprint.rectangle(0.3, 0.3, 0.4), MotionLimits(max_curvature=2.0, max_curvature_rate=8.0))
    return DockingProblem(Pose2(0.0, 0.0, 0.0), Dock(Pose2(2.0, 0.0, 0.0)), robot, rocks)


WALL = [(1.0, -3.0), (1.2, -3.0), (1.2, 3.0), (1.0, 3.0)]
BOX = [
    [(-2.0, -2.0), (4.0, -2.0), (4.0, -1.9), (-2.0, -1.9)],
    [(-2.0, 1.9), (4.0, 1.9), (4.0, 2.0), (-2.0, 2.0)],
    [(-2.0, -2.0), (-1.9, -2.0), (-1.9, 2.0), (-2.0, 2.0)],
]


@functools.cache
def judged():
    """Verdicts, one that says yes and one that says no of each kind."""
    free, walled = world(), world(WALL, *BOX)
    plan = plan_dock(free, time_budget=10.0)
    proof = prove_impossible(walled, time_budget=10.0)
    slow, zone = MotionLimits(max_speed=0.05), SpeedZone()
    rock = Violation("clearance", "too close", 1.0, 0.1)
    columns = {"poses": 3, "measured": 3, "commands": 2, "twists": 2, "references": 3}
    run = {name: np.zeros((2, count)) for name, count in columns.items()}
    ended = {kind: Ending(kind, "", 0, 0.0) for kind in EndingKind}
    law = TimeLaw([1.0], [0.0], start_speed=1.0)
    timed = Trajectory(Path.from_poses([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]), law)
    way = prove_way(plan.path, free)
    new = Replanned(ReplanOutcome.NEW, plan.trajectory, 0.0, plan, way=way.way)
    cleared = ClearanceProof(1.0, 0.0, 0.1, -1, 0.9, np.zeros((0, 7)), np.zeros((0, 2)), 3)
    other = Cycle(**dict.fromkeys(Cycle._fields))
    fault = Fault("clearance", 1.0, 0.0, 0.1)
    dense = dense_check(plan.path, free)
    kept, broken = (SampledBound("line", least, 1.0, 0.005) for least in (0.1, -0.1))
    return {
        Certificate: (plan.certificate, certify_path(plan.path, walled)),
        TrajectoryCertificate: (plan.trajectory_certificate, certify_trajectory(plan.trajectory, slow, zone)),
        ImpossibilityVerdict: (check_impossibility(proof, walled), check_impossibility(proof, free)),
        ClearanceProof: (cleared, cleared._replace(unproven=np.zeros((1, 2)))),
        SampledMotionVerdict: (SampledMotionVerdict((), 2, 0.1), SampledMotionVerdict((rock,), 2, 0.1)),
        StillHolds: (StillHolds(holds=True), StillHolds(holds=False)),
        Verdict: (Verdict(holds=True), Verdict(holds=False)),
        PlanResult: (PlanResult(1, Outcome.STOP), PlanResult(1, Outcome.FAILED)),
        EndingKind: (EndingKind.ALREADY_DOCKED, EndingKind.CANCELLED),
        Ending: (ended[EndingKind.UNDOCKED], ended[EndingKind.TIMEOUT]),
        Replanned: (new, Replanned(ReplanOutcome.STOP, timed, 0.0, None)),
        PlanFileVerdict: tuple(PlanFileVerdict(outcome, ()) for outcome in ("certified", "refuted")),
        WayVerdict: (way, prove_way(plan.path, walled)),
        Replay: (Replay(3, None, None, (0.0, 0.0), run["poses"]), Replay(3, other, None, (0.0, 0.0), run["poses"])),
        Run: tuple(Run(times=np.arange(2.0), **run, goal=Pose2(0, 0, 0), docked=docked) for docked in (True, False)),
        RunColumns: tuple(RunColumns(*[run["poses"]] * 6, docked=docked, reason="") for docked in (True, False)),
        DenseReport: (dense, DenseReport((fault,), 0.0, 0.0, 1.0, 0.0, 0.0, 2.0, 0.0)),
        TimingStatus: (TimingStatus.OK, TimingStatus.CANNOT_STOP),
        TimingResult: (TimingResult(TimingStatus.OK, timed), TimingResult(TimingStatus.TIMED_OUT, None)),
        BehaviorStatus: (BehaviorStatus.SUCCEEDED, BehaviorStatus.FAILED),
        BehaviorResult: (BehaviorResult(BehaviorStatus.SUCCEEDED), BehaviorResult(BehaviorStatus.RUNNING)),
        StartVerdict: (StartVerdict(None), StartVerdict(SegmentPlan(TimingStatus.BAD_START, how="none"))),
        SampledBound: (kept, broken),
        PathVerdict: (PathVerdict(plan.certificate, (kept,)), PathVerdict(plan.certificate, (broken,))),
    }


def test_every_verdict_of_the_product_is_among_these():
    found = {kind for kind in classes() if is_verdict(kind)}
    assert found - set(VERDICTS) == set()
    assert set(judged()) == set(VERDICTS)


@pytest.mark.parametrize("kind", VERDICTS, ids=lambda kind: kind.__name__)
def test_a_verdict_counts_as_true_where_it_says_yes_and_as_false_where_it_says_no(kind):
    yes, no = judged()[kind]
    assert {type(yes), type(no)} == {kind}
    assert yes
    assert not no
    for verdict in (yes, no):
        for word in words_of(kind):
            assert bool(verdict) == (bool(getattr(verdict, word)) != (word in DENIALS)), word


def test_every_member_of_an_enumeration_of_endings_says_yes_or_no():
    assert {kind for kind in TimingStatus if kind} == {TimingStatus.OK}
    assert {kind for kind in BehaviorStatus if kind} == {BehaviorStatus.SUCCEEDED}
    assert {kind for kind in EndingKind if kind} == {kind for kind in EndingKind if kind.succeeded}


def test_a_plan_in_a_world_where_it_is_refused_is_not_taken_for_one_that_is_proven():
    """The mistake that this is about: `if certify_path(...)`."""
    plan = plan_dock(world(), time_budget=10.0)
    driven = [rocks for rocks in ((), (WALL,)) if certify_path(plan.path, world(*rocks))]
    assert driven == [()]


class Judged(typing.NamedTuple):
    """What nobody has taught its truth value."""

    certified: bool


class Ended(Enum):
    """Likewise."""

    BADLY = 1

    @property
    def succeeded(self) -> bool:
        return False


def test_the_law_sees_a_verdict_that_is_not_its_truth_value():
    assert is_verdict(Judged)
    assert is_verdict(Ended)
    assert Judged(certified=False)
    assert Ended.BADLY
