"""The portfolio of `plan_dock`: which guesses are tried, which plan is chosen, and how a search ends."""

import collections
import dataclasses
import functools
import itertools
import json
import math

import numpy as np
import pytest

from experiments.dense_check import dense_check
from optdock.deadline import Deadline, budget_clock
from optdock.errors import (
    Cancelled,
    CertificationFailed,
    FailedToSmoothPath,
    InvalidPath,
    InvalidValue,
    NoMotionExists,
    NoValidPathCouldBeFound,
    OptdockError,
    PlannerCancelled,
    PluginError,
    SmootherTimedOut,
    TimedOut,
)
from optdock.geometry.footprint import Footprint
from optdock.geometry.pose import Pose2
from optdock.impossibility import check_impossibility
from optdock.model.dock import Dock, DockDirection
from optdock.model.limits import MotionLimits
from optdock.model.path import Path
from optdock.model.problem import DockingProblem
from optdock.model.robot import Robot
from optdock.planners.dock_planner import DockPlanner
from optdock.planners.manoeuvres.price import CUSP_PRICE
from optdock.planning.pipeline import plan_dock, warm_up
from optdock.planning.plan import DockPlan, PartialPlan
from optdock.plugins.interfaces import GlobalPlanner, Smoother, SmoothingResult, never_cancelled
from optdock.plugins.outcomes import Guess
from optdock.verification import certify_motion, certify_path

BUDGET = 20.0  # [s]: these tests are about verdicts, not about time
LONG = 1000.0  # [s]: where shares of a clock that stands still bound what a proof really takes
LIMITS = MotionLimits(max_yaw_rate=1.0, max_yaw_acceleration=2.0, max_curvature=1.5, max_curvature_rate=6.0)
ROBOT = Robot(Footprint.rectangle(0.45, 0.45, 0.6), LIMITS)
STATION = Footprint(np.array([[0.455, -0.3], [0.6, -0.3], [0.6, 0.3], [0.455, 0.3]]))
GOAL = Pose2(4.0, 1.0, 0.0)
DOCK = Dock(GOAL, STATION, DockDirection.FORWARD, 0.3, 0.1, 0.3)


def problem(start=(0.5, 0.3, 0.3), **changes):
    return DockingProblem(**{"start": Pose2(*start), "dock": DOCK, "robot": ROBOT, **changes})


class Several(GlobalPlanner):
    """Offers what it is given, and pauses between two offers."""

    def __init__(self, *paths):
        super().__init__()
        self.paths, self.asked = paths, []

    def create_plan(self, start, goal, cancel_checker=never_cancelled):
        return self.paths[0]

    def create_plans(self, start, goal, cancel_checker=never_cancelled, better_than=lambda: math.inf):
        for i, path in enumerate(self.paths):
            self.asked.append(better_than())
            yield Guess(path, f"offer {i}")
            yield None


def raw(task, planner="DockPlanner"):
    return plan_dock(task, time_budget=BUDGET, planner=planner).raw_path


@pytest.mark.parametrize(
    "start",
    [(4.6, 3.5, 0.3), (6.5, 1.0, math.pi), (3.7, 1.05, 0.0), (2.0, 1.0, math.pi)],
    ids=["beside", "behind the station", "too near", "turned away"],
)
def test_plans_from_every_side_of_the_dock(start):
    task = problem(start)
    plan = plan_dock(task, time_budget=BUDGET)
    assert certify_path(plan.path, task).certified
    assert certify_motion(plan.trajectory, task).certified
    assert dense_check(plan.path, task).ok
    assert plan.path.segments[-1].direction == 1
    chosen = [attempt for attempt in plan.tried if attempt.guess is plan.raw_path]
    assert [attempt.price for attempt in chosen] == [plan.price]
    assert plan.stage == chosen[0].stage


def test_plan_of_the_lowest_price_is_chosen_in_any_order():
    task = problem((1.0, 1.0, 0.0))
    near, far = raw(task), Path.from_poses([task.start, Pose2(1.5, 1.8, 0.6), Pose2(3.0, 1.5, -0.5), GOAL])
    for order in itertools.permutations((near, far)):
        plan = plan_dock(task, time_budget=BUDGET, planner=Several(*order))
        prices = [attempt.price for attempt in plan.tried]
        assert len(prices) == 2
        assert plan.price == min(prices) < max(prices)
        assert plan.raw_path is order[prices.index(min(prices))]


def test_price_is_the_duration_and_what_cusps_cost():
    plan = plan_dock(problem((2.0, 1.0, math.pi)), time_budget=BUDGET)
    cusps = len(plan.path.cusps)
    assert cusps >= 1
    assert plan.price == pytest.approx(plan.trajectory.duration + CUSP_PRICE * cusps)


def test_planner_reads_the_price_to_beat():
    task = problem()
    planner = Several(raw(task), raw(task))
    plan = plan_dock(task, time_budget=BUDGET, planner=planner)
    assert math.isinf(planner.asked[0])
    assert 0.8 * plan.price < planner.asked[1] < plan.price


def test_price_to_beat_does_not_contain_the_time_for_steering_at_the_start():
    steered = dataclasses.replace(
        LIMITS, wheelbase=0.5, max_steering_angle=0.6, max_steering_rate=0.2, max_yaw_acceleration=math.inf
    )
    task = problem(robot=dataclasses.replace(ROBOT, limits=steered, drive="ackermann"))
    planner = Several(raw(task), raw(task))
    plan = plan_dock(task, time_budget=BUDGET, planner=planner)
    assert planner.asked[1] == pytest.approx(0.97 * plan.price - 0.6 / 0.2, abs=0.01)
    known = dataclasses.replace(task, start_curvature=float(plan.path.curvature_at(0.0)[0]))
    planner = Several(raw(known), raw(known))
    plan = plan_dock(known, time_budget=BUDGET, planner=planner)
    assert planner.asked[1] == pytest.approx(0.97 * plan.price, abs=0.01)


def test_given_guess_is_tried_first():
    task = problem((3.7, 1.05, 0.0))
    found = plan_dock(task, time_budget=BUDGET)
    again = plan_dock(task, time_budget=BUDGET, guesses=[found.raw_path], planner="DockPlanner")
    assert (again.stage, again.price) == ("given", pytest.approx(found.price, rel=1e-3))
    with pytest.raises(NoValidPathCouldBeFound):
        plan_dock(task, time_budget=BUDGET, planner="DockPlanner")


def test_given_guess_to_another_place_is_refused_and_the_search_continues():
    elsewhere = Path.from_poses([Pose2(0.5, 9.0, 0.0), Pose2(4.0, 9.0, 0.0)])
    plan = plan_dock(problem(), time_budget=BUDGET, guesses=[elsewhere])
    assert "m from the goal of the problem" in plan.tried[0].reason
    assert plan.stage != "given"
    with pytest.raises(FailedToSmoothPath, match="m from the goal of the problem"):
        plan_dock(problem(start=(3.7, 1.05, 0.0)), time_budget=BUDGET, guesses=[elsewhere], planner="DockPlanner")


@pytest.mark.parametrize(
    ("guesses", "error", "message"),
    [
        (3, InvalidValue, "guesses: must be a list of paths, got int"),
        ("path", InvalidValue, "guesses: must be a list of paths, got str"),
        ([None], InvalidValue, r"guesses\[0\]: must be a Path, got NoneType"),
        ([Path.from_poses([(0, 0, 0), (1, 0, 0)], "odom")], InvalidPath, "is in frame 'odom', not in 'map'"),
    ],
)
def test_invalid_guesses_are_refused_by_name(guesses, error, message):
    with pytest.raises(error, match=message):
        plan_dock(problem(), guesses=guesses)


def test_empty_list_of_planners_is_refused():
    with pytest.raises(InvalidValue, match="planner: must be one planner or several, got none"):
        plan_dock(problem(), planner=[])
    assert {attempt.stage for attempt in plan_dock(problem(), planner="DockPlanner").tried} == {"DockPlanner"}


def test_failure_of_a_later_planner_keeps_the_plan():
    class Broken(GlobalPlanner):
        def create_plan(self, start, goal, cancel_checker=never_cancelled):
            raise NoValidPathCouldBeFound("nothing today")

    class Faulty(Broken):
        def create_plan(self, start, goal, cancel_checker=never_cancelled):
            raise ZeroDivisionError

    for second, reason in (
        (Broken(), "NoValidPathCouldBeFound: nothing today"),
        (Faulty(), "PluginError: Faulty failed"),
    ):
        plan = plan_dock(problem(), time_budget=BUDGET, planner=(DockPlanner(), second))
        assert plan.stage == "DockPlanner"
        assert plan.tried[-1].reason.startswith(reason)
    with pytest.raises(PluginError):
        plan_dock(problem(), time_budget=BUDGET, planner=(Faulty(), DockPlanner()))


RING = [
    [[2.4, -1.0], [2.6, -1.0], [2.6, 3.0], [2.4, 3.0]],
    [[2.4, 2.8], [6.0, 2.8], [6.0, 3.0], [2.4, 3.0]],
    [[2.4, -1.0], [6.0, -1.0], [6.0, -0.8], [2.4, -0.8]],
    [[5.8, -1.0], [6.0, -1.0], [6.0, 3.0], [5.8, 3.0]],
]


@functools.cache
def refusal_behind_walls():
    """The problem with walls around the dock, and how `plan_dock` refuses it."""
    walled = problem(obstacles=RING)
    with pytest.raises(NoMotionExists, match="no motion joins start and goal") as caught:
        plan_dock(walled, time_budget=BUDGET)
    return walled, caught.value


class Prophet(GlobalPlanner, Smoother):
    """Says that there is no way, with whatever it has for a proof."""

    proof = None

    def create_plan(self, start, goal, cancel_checker=lambda: False):
        raise NoMotionExists("no way", proof=self.proof)

    def smooth(self, path, max_time, **what):
        raise NoMotionExists("no way", proof=self.proof)


def test_no_motion_exists_of_a_plugin_needs_a_valid_proof():
    walled, refusal = refusal_behind_walls()
    proof = refusal.proof
    everywhere = ("planner", "smoother", "first")
    for claimed, roles in ((None, everywhere[1:2]), ("believe me", everywhere[:1]), (proof, everywhere)):
        planner = Prophet()
        planner.proof = claimed
        choices = {"first": {"planner": (planner, "DockPlanner")}}
        for chosen in (choices.get(role, {role: planner}) for role in roles):
            with pytest.raises(PluginError, match="reports that no motion exists, without a valid proof"):
                plan_dock(problem(), time_budget=BUDGET, **chosen)
    holds = Prophet()
    holds.proof = proof
    with pytest.raises(NoMotionExists) as caught:
        plan_dock(walled, time_budget=BUDGET, planner=holds)
    assert caught.value.proof is proof


def test_dock_behind_walls_is_proven_out_of_reach():
    task, refusal = refusal_behind_walls()
    assert check_impossibility(refusal.proof, task).proven
    assert "prove" in refusal.partial.timing_ms
    opened = [*RING[:2], RING[3], [[2.4, -1.0], [4.0, -1.0], [4.0, -0.8], [2.4, -0.8]]]
    assert plan_dock(problem(obstacles=opened), time_budget=BUDGET).certificate.certified


def test_what_is_neither_found_nor_proven_claims_no_proof():
    stiff = Robot(ROBOT.footprint, dataclasses.replace(LIMITS, max_curvature=0.02))
    narrow = [
        [[-2.0, 2.0], [5.0, 2.0], [5.0, 2.2], [-2.0, 2.2]],
        [[-2.0, -1.2], [5.0, -1.2], [5.0, -1.0], [-2.0, -1.0]],
    ]
    with pytest.raises(OptdockError) as caught:
        plan_dock(problem((1.0, 0.4, 1.2), robot=stiff, obstacles=narrow), time_budget=0.25)
    assert not isinstance(caught.value, NoMotionExists)
    assert "not proven" in str(caught.value) or "no proof" in str(caught.value) or isinstance(caught.value, TimedOut)
    assert len(caught.value.partial.tried) >= 2


@pytest.mark.parametrize("budget", [1e-9, 2e-3])
def test_budget_too_short_for_a_search_is_a_time_out(budget):
    with pytest.raises(TimedOut):
        plan_dock(problem((6.5, 1.0, math.pi)), time_budget=budget)


class Clock:
    """A clock that stands still until somebody sets it on: how busy the machine is has no part in a test."""

    def __init__(self):
        self.now = 0.0

    def __call__(self):
        return self.now


@pytest.fixture
def clock(monkeypatch):
    """The clock of the deadlines of `plan_dock`."""
    warm_up(planner="DockPlanner")
    found = Clock()
    monkeypatch.setattr("optdock.planning.pipeline.Deadline", lambda seconds: Deadline(seconds, found))
    monkeypatch.setattr("optdock.planning.pipeline._WAITS", collections.deque(maxlen=9))
    return found


class Dawdling(Several):
    """Offers one path, and lets so many seconds pass before it looks for another one."""

    def __init__(self, path, clock, seconds):
        super().__init__(path)
        self.clock, self.seconds = clock, seconds

    def create_plans(self, start, goal, cancel_checker=never_cancelled, better_than=lambda: math.inf):
        yield Guess(self.paths[0], "offer")
        self.clock.now += self.seconds


@pytest.mark.parametrize(("seconds", "completed"), [(0.0, True), (0.9, True), (1.1, False)])
def test_plan_is_completed_where_every_guess_was_tried_before_the_deadline(clock, seconds, completed):
    """What was found in time is certified all the same; a search that was cut short may have missed a better one."""
    task = problem()
    planner = Dawdling(raw(task), clock, seconds * BUDGET)
    plan = plan_dock(task, time_budget=BUDGET, planner=planner)
    assert plan.certificate.certified
    assert plan.completed is completed


class Insatiable(GlobalPlanner):
    """Searches in vain for as long as it is let; `stopped_at` tells when that ended."""

    def __init__(self, clock, step=1e-3 * LONG):
        super().__init__()
        self.clock, self.step, self.stopped_at = clock, step, math.nan

    def create_plan(self, start, goal, cancel_checker=never_cancelled):
        while not cancel_checker():
            self.clock.now += self.step
        self.stopped_at = self.clock.now
        raise PlannerCancelled("asked to stop")


class Helpless(GlobalPlanner):
    """Has nothing to offer."""

    def create_plan(self, start, goal, cancel_checker=never_cancelled):
        raise NoValidPathCouldBeFound("nothing")


BAY = [
    [[-3.0, -0.4], [-0.46, -0.4], [-0.46, 1.2], [-3.0, 1.2]],
    [[0.46, -0.4], [3.0, -0.4], [3.0, 1.2], [0.46, 1.2]],
    [[-3.0, -0.5], [3.0, -0.5], [3.0, -0.4], [-3.0, -0.4]],
]
# 2 cm longer than the robot, which lies along its bottom and would have to leave it sideways: its largest disc leaves
# it easily, so that nothing is proven before a planner has had its time.
BAYED = DockingProblem(Pose2(0.0, 2.0, 0.0), Dock(Pose2(0.0, 0.0, 0.0)), ROBOT, BAY)


def test_last_planner_leaves_time_for_a_proof(clock):
    """A fifth of what is left, where it is the last of several."""
    last = Insatiable(clock)
    with pytest.raises(NoMotionExists):
        plan_dock(BAYED, time_budget=LONG, planner=(Helpless(), last))
    assert last.stopped_at == pytest.approx(0.8 * LONG, abs=2e-3 * LONG)
    alone = Insatiable(clock)
    began = clock.now
    with pytest.raises(TimedOut):
        plan_dock(BAYED, time_budget=LONG, planner=alone)
    assert alone.stopped_at - began == pytest.approx(LONG, abs=2e-3 * LONG)


class Pausing(Helpless):
    """Pauses nine times."""

    def create_plans(self, start, goal, cancel_checker=never_cancelled, better_than=lambda: math.inf):
        self.pauses = 0
        while not cancel_checker() and self.pauses < 9:
            self.pauses += 1
            yield None


def test_proof_is_searched_for_during_a_pause(clock):
    """The first pause is enough, and the search is over."""
    planner = Pausing()
    with pytest.raises(NoMotionExists) as caught:
        plan_dock(BAYED, time_budget=LONG, planner=(planner, Helpless()))
    assert planner.pauses == 1
    assert caught.value.partial.tried == ()


class Recording(Smoother):
    """Notes what it is given and for how long, and fails as it is told, guess by guess; None: hands its guess back."""

    def __init__(self, *errors):
        super().__init__()
        self.errors, self.given, self.times, self.begun = list(errors), [], [], []

    def smooth(self, path, max_time, *, problem=None, warm_start=None, cancel_checker=None):
        self.given.append(path)
        self.begun.append(warm_start)
        self.times.append(max_time)
        error = self.errors.pop(0)
        if error is not None:
            raise error
        return SmoothingResult(path)


def bent(aside):
    """A rough guess from the start to the goal, so far to the side half-way."""
    return Path.from_poses([problem().start, Pose2(2.2, 0.6 + aside, 0.2), GOAL])


def test_guess_that_may_be_followed_by_others_is_smoothed_for_a_share_of_the_time(clock):
    """Two fifths of what is left; the only guess of the last planner gets all but the reserve."""
    many = Recording(FailedToSmoothPath("no"), FailedToSmoothPath("no"))
    with pytest.raises(FailedToSmoothPath):
        plan_dock(problem(), time_budget=BUDGET, planner=Several(bent(0.0), bent(0.5)), smoother=many)
    assert many.times == pytest.approx([0.4 * BUDGET, 0.4 * BUDGET], rel=1e-3)
    only = Recording(FailedToSmoothPath("no"))
    with pytest.raises(FailedToSmoothPath):
        plan_dock(problem(), time_budget=BUDGET, planner="DockPlanner", smoother=only)
    assert only.times == pytest.approx([BUDGET - 0.03], rel=1e-3)


def test_guess_through_obstacles_is_put_off_and_tried_at_the_end(clock):
    block = [[[0.9, -1.5], [3.1, -1.5], [3.1, 2.5], [0.9, 2.5]]]
    task = problem((0.2, 0.3, 0.3), obstacles=block)
    through, round_ = (Path.from_poses([task.start, Pose2(2.0, middle, 0.2), GOAL]) for middle in (0.6, 4.5))
    smoother = Recording(FailedToSmoothPath("no"), FailedToSmoothPath("no"))
    with pytest.raises(FailedToSmoothPath) as caught:
        plan_dock(task, time_budget=BUDGET, planner=Several(through, round_), smoother=smoother)
    assert [path.segments for path in smoother.given] == [round_.segments, through.segments]
    reasons = [attempt.reason for attempt in caught.value.partial.tried]
    assert reasons[0].startswith("postponed: ")
    assert "% of its poses overlap obstacles" in reasons[0]


def test_guess_that_leaves_the_start_backwards_is_put_off_unless_there_are_no_others():
    task = problem((1.0, 1.0, math.pi))
    smoother = Recording(FailedToSmoothPath("no"), FailedToSmoothPath("no"))
    with pytest.raises(FailedToSmoothPath) as caught:
        plan_dock(task, time_budget=BUDGET, planner=["DockPlanner", Several(bent(0.5))], smoother=smoother)
    assert np.array_equal(smoother.given[0].segments[0].poses, bent(0.5).segments[0].poses)
    assert len(smoother.given) == 2
    assert caught.value.partial.tried[0].reason == "postponed: it leaves the start in the opposite direction"
    only = Recording(FailedToSmoothPath("no"))
    with pytest.raises(FailedToSmoothPath):
        plan_dock(task, time_budget=BUDGET, planner="DockPlanner", smoother=only)
    assert len(only.given) == 1


def test_guess_through_a_small_obstacle_is_smoothed_briefly_and_continued_at_the_end(clock):
    """Along less than 2.5 robot lengths: 45 ms first, and all that is left once there are no others."""
    task = problem((0.2, 0.3, 0.3), obstacles=[[[1.9, 0.2], [2.1, 0.2], [2.1, 1.0], [1.9, 1.0]]])
    through, round_ = (Path.from_poses([task.start, Pose2(2.0, middle, 0.2), GOAL]) for middle in (0.6, 4.5))
    smoother = Recording(late(bent(0.1)), FailedToSmoothPath("no"), FailedToSmoothPath("no"))
    with pytest.raises(FailedToSmoothPath):
        plan_dock(task, time_budget=BUDGET, planner=Several(through, round_), smoother=smoother)
    assert [path.segments for path in smoother.given] == [one.segments for one in (through, round_, through)]
    assert smoother.times == pytest.approx([0.045, 0.4 * BUDGET, BUDGET - 0.03], rel=1e-2)


def late(path):
    """A smoother ran out of time, and left a path."""
    error = SmootherTimedOut("no certified path in time")
    error.partial = PartialPlan(path=path)
    return error


def test_interrupted_guess_continues_from_its_path(clock, monkeypatch):
    """After the others; and those that lie in no obstacle come first."""
    monkeypatch.setattr("optdock.planning.pipeline._PUT_OFF", 1.0)
    block = [[[0.9, 0.9], [1.1, 0.9], [1.1, 2.5], [0.9, 2.5]]]
    task = problem((0.2, 0.3, 0.3), obstacles=block)
    grazing, free = (Path.from_poses([task.start, Pose2(1.0, y, 0.2), Pose2(2.0, 0.6, 0.2), GOAL]) for y in (0.7, 0.0))
    left = [bent(0.1), bent(0.2)]
    smoother = Recording(*map(late, left), FailedToSmoothPath("no"), FailedToSmoothPath("no"))
    with pytest.raises(FailedToSmoothPath):
        plan_dock(task, time_budget=BUDGET, planner=Several(grazing, free), smoother=smoother)
    assert [path.segments for path in smoother.given] == [one.segments for one in (grazing, free, free, grazing)]
    assert smoother.begun == [None, None, left[1], left[0]]


def test_late_in_the_budget_an_interrupted_free_guess_comes_before_new_ones(clock):
    class Slow(Recording):
        def smooth(self, path, max_time, **what):
            clock.now += 0.6 * BUDGET
            return super().smooth(path, max_time, **what)

    left = bent(0.1)
    smoother = Slow(late(left), FailedToSmoothPath("no"), FailedToSmoothPath("no"))
    with pytest.raises(FailedToSmoothPath):
        plan_dock(problem(), time_budget=4.0 * BUDGET, planner=Several(bent(0.0), bent(0.5)), smoother=smoother)
    assert smoother.begun == [None, None, left]
    smoother = Slow(late(left), FailedToSmoothPath("no"))
    with pytest.raises(TimedOut):
        plan_dock(problem(), time_budget=BUDGET, planner=Several(bent(0.0), bent(0.5)), smoother=smoother)
    assert smoother.begun == [None, left]


@pytest.mark.parametrize("errors", [(FailedToSmoothPath("no"), None), (None, FailedToSmoothPath("no"))])
def test_reason_is_that_of_the_guess_which_came_furthest(clock, errors):
    """A path that was smoothed and not proven tells more than one that was not, in whichever order."""
    with pytest.raises(CertificationFailed):
        plan_dock(problem(), time_budget=BUDGET, planner=Several(bent(0.0), bent(0.5)), smoother=Recording(*errors))


@pytest.mark.parametrize(
    ("waits", "margin"),
    [((), 0.0), ((0.002,), 0.0), ((0.002, 0.001), 0.001), ((0.002, 0.001, 9.0), 0.002), ((9.0, 9.0), 0.006)],
)
def test_call_stops_earlier_after_two_suspended_calls(clock, monkeypatch, waits, margin):
    """By the second longest of these waits, 6 ms at most."""
    monkeypatch.setattr("optdock.planning.pipeline._WAITS", collections.deque(waits, maxlen=9))
    budget, step = 0.1, 1e-4
    planner = Insatiable(clock, step)
    with budget_clock("wall"), pytest.raises(TimedOut):
        plan_dock(problem(), time_budget=budget, planner=planner)
    assert planner.stopped_at == pytest.approx(budget - margin, abs=1.5 * step)


def test_same_problem_has_the_same_plan():
    task = problem((4.6, 3.5, 0.3))
    first, second = (plan_dock(task, time_budget=BUDGET) for _ in range(2))
    assert first.path.digest == second.path.digest
    assert [a.stage for a in first.tried] == [a.stage for a in second.tried]


def test_call_can_be_cancelled_while_it_searches():
    answers = itertools.count()
    with pytest.raises(Cancelled):
        plan_dock(problem((4.6, 3.5, 0.3)), time_budget=BUDGET, cancel_checker=lambda: next(answers) > 10)


def test_plan_file_lists_the_attempts(tmp_path):
    task = problem((2.0, 1.0, math.pi))
    plan = plan_dock(task, time_budget=BUDGET)
    plan.save(tmp_path / "plan.json")
    rows = json.loads((tmp_path / "plan.json").read_text())["tried"]
    assert [row["stage"] for row in rows] == [attempt.stage for attempt in plan.tried]
    assert all(("price" in row) != ("reason" in row) for row in rows)
    assert DockPlan.load(tmp_path / "plan.json", task).path.digest == plan.path.digest


def test_robot_that_is_slow_in_reverse_drives_forward_as_far_as_it_can():
    """No bound for a guess may take the gear in which the dock is entered for that of the way there."""
    limits = MotionLimits(max_speed=1.5, max_reverse_speed=0.2, max_curvature=1.0, max_curvature_rate=4.0)
    robot = Robot(Footprint.rectangle(0.6, 0.6, 0.7), limits)
    problem = DockingProblem(Pose2(14.0, 1.0, 0.0), Dock(Pose2(0.0, 0.0, 0.0), direction="backward"), robot)
    alone = plan_dock(problem, planner="DockPlanner", time_budget=5.0)
    assert not alone.path.cusps
    assert plan_dock(problem, time_budget=5.0).price < 0.6 * alone.price
