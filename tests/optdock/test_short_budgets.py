"""Plans by short deadlines: time reserved after smoothing, timings without hope, proofs that most calls do not need.

Budgets are counted, or the plug-ins say themselves that their time is up, so that no test depends on the machine.
"""

import dataclasses
import math
import subprocess
import sys

import pytest

from experiments.families import instance
from optdock.deadline import TICK, Deadline, budget_clock
from optdock.errors import FailedToSmoothPath, NoMotionExists, SmootherTimedOut, TimingTimedOut
from optdock.geometry.obstacles import ObstacleSet
from optdock.geometry.pose import Pose2
from optdock.planning import pipeline, refinement
from optdock.planning.pipeline import plan_dock, warm_up
from optdock.planning.refinement import Cancellation, Refinement
from optdock.plugins.interfaces import never_cancelled
from optdock.plugins.outcomes import TimingResult, TimingStatus
from optdock.timing.near_optimal import NearOptimal
from optdock.timing.windowed import Windowed
from smoothers.casadi_smoother import CasadiSmoother

EASY = instance("open_s", 1).problem
NEEDED = 0.013  # [s]


@pytest.fixture(autouse=True, scope="module")
def _loaded():
    warm_up()


@pytest.fixture
def paces(monkeypatch):
    """The remembered durations of timings: none yet."""
    made = {}
    monkeypatch.setattr(refinement, "_PACES", made)
    return made


class TakesLong(CasadiSmoother):
    """Needs more than half of a budget of 20 ms."""

    def smooth(self, path, max_time, **given):
        if max_time < NEEDED:
            raise SmootherTimedOut(f"{max_time:.4f} s are too short")
        return super().smooth(path, 1.0, **given)


class Recorder(Windowed):
    """Records the time limits that it is given."""

    def __init__(self):
        super().__init__()
        self.allowed = []

    def parameterize(self, *arguments, max_time=math.inf, **given):
        self.allowed.append(max_time)
        return super().parameterize(*arguments, **given)


def work(budget, timing=None):
    deadline, never = Deadline(budget), Cancellation(never_cancelled)
    return Refinement(EASY, CasadiSmoother(), timing or NearOptimal(), None, never, budget, deadline, {})


def planned():
    with budget_clock("counted"):
        return plan_dock(EASY, time_budget=0.02, planner="DockPlanner", smoother=TakesLong())


def test_only_the_time_that_timing_needs_is_kept_from_smoothing(monkeypatch):
    assert planned().certificate.certified
    monkeypatch.setattr(Refinement, "reserved", lambda work, gears, length: 0.3 * work.budget)  # of every path
    with pytest.raises(SmootherTimedOut):
        planned()


def test_reserve_grows_with_the_path_between_its_bounds():
    with budget_clock("counted"):
        short = work(0.02)
        assert short.reserve == short.reserved(1, 0.0) < short.reserved(1, 20.0) < short.reserved(2, 20.0) <= 0.006
        assert work(0.002).reserved(9, 90.0) == pytest.approx(0.004)  # at most
        assert work(0.1).reserved(1, 1.0) == pytest.approx(0.015)  # at least
        assert work(3.0).reserved(1, 1.0) == work(3.0).reserved(9, 90.0) == pytest.approx(0.03)


def test_counted_reserve_does_not_depend_on_earlier_timings_and_a_measured_one_does(paces):
    unknown = {clock: reserve_on(clock) for clock in ("counted", "cpu")}
    paces[NearOptimal] = [0.5, 1.3, 1.4]
    assert reserve_on("counted") == unknown["counted"]
    assert reserve_on("cpu") == pytest.approx(1.3 * unknown["cpu"])
    paces[NearOptimal] = [50.0] * 9
    assert reserve_on("cpu") == pytest.approx(0.004)  # one that could never be measured again would be worse


def reserve_on(clock):
    with budget_clock(clock):
        return work(0.01).reserved(1, 2.0)


def test_third_longest_of_the_last_nine_timings_is_expected(paces):
    usual = reserve_on("cpu")
    paces[NearOptimal] = [0.9, 1.0, 1.5, 1.1, 1.6, 1.2, 0.8, 1.3, 1.0]
    assert reserve_on("cpu") == pytest.approx(1.3 * usual)


def test_every_timing_is_remembered_and_an_unfinished_one_counts_as_a_longer_one(paces):
    with budget_clock("counted"):
        plan = plan_dock(EASY, planner="DockPlanner")
        finished = paces[NearOptimal][-1]
        timing = OutOfTime()
        with pytest.raises(TimingTimedOut):
            work(1.0, timing).proven(plan.raw_path, plan.path, refinement.PartialPlan())
    assert finished > 0.0
    assert len(paces[OutOfTime]) == 1
    taken = paces[OutOfTime][0] * refinement._predicted(1, plan.path.length)
    assert 1.5 * timing.took <= taken <= 1.5 * (timing.took + 3.0 * TICK)  # with the readings before and after it


class OutOfTime(Windowed):
    """Ends without a result after ten readings of the clock."""

    def parameterize(self, *arguments, **given):
        deadline = Deadline()
        for _ in range(10):
            self.took = deadline.elapsed
        return TimingResult(TimingStatus.TIMED_OUT, None, reason="late")


def test_timing_without_hope_is_not_begun():
    plan = plan_dock(EASY, planner="DockPlanner")
    for budget, begins in ((0.001, False), (0.01, True)):
        timing = Recorder()
        with budget_clock("counted"):
            one = work(budget, timing)
            if begins:
                assert one.proven(plan.raw_path, plan.path, refinement.PartialPlan()).certificate.certified
            else:
                with pytest.raises(TimingTimedOut):
                    one.proven(plan.raw_path, plan.path, refinement.PartialPlan())
        assert bool(timing.allowed) is begins


def test_straight_is_only_proven_blocked_after_a_difficulty(monkeypatch):
    asked = []
    monkeypatch.setattr(pipeline, "prove_straight_blocked", asked.append)
    plan_dock(EASY, planner="DockPlanner")
    assert asked == []
    blocked = blocked_straight()
    with pytest.raises(FailedToSmoothPath, match="on the final straight"):
        plan_dock(blocked, planner="DockPlanner", time_budget=0.3)
    assert asked == [blocked]


def test_blocked_straight_is_proven_within_a_short_budget():
    with budget_clock("counted"), pytest.raises(NoMotionExists, match="straight"):
        plan_dock(blocked_straight(), time_budget=0.008)


def blocked_straight():
    rear = EASY.robot.footprint.vertices[:, 0].min()
    x, y = (EASY.goal @ Pose2(rear - 0.15, 0.0, 0.0)).as_array()[:2]
    beside = [[x - 0.05, y - 0.05], [x + 0.05, y - 0.05], [x + 0.05, y + 0.05], [x - 0.05, y + 0.05]]
    return dataclasses.replace(EASY, obstacles=EASY.obstacles + ObstacleSet.from_polygons([beside], "post"))


PREPARED = """
from optdock.planning.pipeline import warm_up
from optdock.timing.windowed import WindowedParameters
warm_up()
print(WindowedParameters.__pydantic_complete__)
"""


def test_the_parameters_of_the_last_resort_of_timing_are_prepared_by_warm_up():
    done = subprocess.run([sys.executable, "-c", PREPARED], capture_output=True, text=True, check=True)
    assert done.stdout == "True\n"  # otherwise they take 4 ms of the first call that needs them
