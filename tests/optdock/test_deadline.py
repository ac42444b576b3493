"""The deadline, its exchangeable clock, and collection of garbage within it."""

import gc
import math
import time

import numpy as np
import pytest

from experiments import families
from optdock.deadline import (
    TICK,
    Deadline,
    OutOfTime,
    Stopwatch,
    budget_clock,
    clock_name,
    garbage_collection_paused,
    now,
    set_clock,
)
from optdock.errors import OptdockError, PlannerTimedOut
from optdock.geometry.footprint import Footprint
from optdock.geometry.pose import Pose2
from optdock.impossibility import footprint_discs
from optdock.model.dock import Dock
from optdock.model.limits import MotionLimits
from optdock.model.path import Path
from optdock.model.problem import DockingProblem
from optdock.model.robot import Robot
from optdock.planning import pipeline
from optdock.planning.pipeline import plan_dock, warm_up
from optdock.plugins.interfaces import GlobalPlanner
from optdock.plugins.lifecycle import PluginContext
from smoothers.scp.qp_step import pool_of_this_thread

PROBLEM = DockingProblem(
    Pose2(0.0, 0.0, 0.3),
    Dock(Pose2(3.0, 0.5, 0.0)),
    Robot(Footprint.rectangle(0.3, 0.3, 0.4), MotionLimits(max_curvature=1.5, max_curvature_rate=6.0)),
)


def test_time_is_counted_from_the_beginning():
    now = [5.0]
    deadline = Deadline(2.0, lambda: now[0])
    now[0] = 6.5
    assert (deadline.elapsed, deadline.left, deadline.passed()) == (1.5, 0.5, False)
    now[0] = 7.0
    assert deadline.passed()
    assert not Deadline().passed()


def test_budgets_of_these_tests_count_cpu_time():
    """Other load on the machine does not affect these tests."""
    deadline, context = Deadline(0.05), PluginContext()
    began = context.clock()
    time.sleep(0.1)
    assert not deadline.passed()
    assert context.clock() - began < 0.05
    while not deadline.passed():
        math.sqrt(2.0)
    assert context.clock() - began >= 0.04


def test_the_clock_is_exchanged_within_a_context_only():
    assert clock_name() == "cpu"  # of these tests
    with budget_clock("wall"):
        deadline, context = Deadline(0.02), PluginContext()
        assert deadline.clock is time.monotonic
        time.sleep(0.03)
        assert deadline.passed()
        with budget_clock("counted"):
            assert [now(), now(), context.clock()] == [0.0, TICK, 2.0 * TICK]
            assert Deadline(clock=context.clock).clock is not time.monotonic
        assert clock_name() == "wall"
        assert deadline.elapsed >= 0.03  # on the clock of its construction
    with pytest.raises(ZeroDivisionError), budget_clock("wall"):
        raise ZeroDivisionError
    assert clock_name() == "cpu"


def test_a_rate_slows_every_clock():
    with budget_clock("counted", rate=0.5):
        assert [now(), now()] == [0.0, 0.5 * TICK]
    with budget_clock("cpu", rate=0.25):
        began, slow = time.process_time(), now()
        while time.process_time() - began < 0.04:
            math.sqrt(2.0)
        assert now() - slow == pytest.approx(0.25 * (time.process_time() - began), abs=2e-3)


@pytest.mark.parametrize(("name", "rate"), [("sundial", 1.0), ("cpu", 0.0), ("cpu", math.nan)])
def test_unknown_clocks_and_rates_are_rejected(name, rate):
    with pytest.raises(ValueError, match="wall, cpu, counted with a rate > 0"):
        set_clock(name, rate)


def test_a_counted_deadline_passes_after_a_number_of_readings():
    with budget_clock("counted"):
        deadline = Deadline(10.0 * TICK)
        assert [deadline.passed() for _ in range(12)] == [False] * 9 + [True] * 3


@pytest.mark.parametrize(("clock", "waits"), [("wall", True), ("cpu", False), ("counted", False)])
def test_only_a_wall_clock_knows_suspensions(clock, waits, monkeypatch):
    """The margin for suspensions of earlier calls and the share of work of a stage."""
    monkeypatch.setattr(pipeline, "_WAITS", [0.005, 0.005])
    with budget_clock(clock):
        watch = Stopwatch(Deadline())
        time.sleep(0.01)
        took, worked = watch.read()
        assert (pipeline._margin(1.0) > 0.0) is waits
        assert (took - worked > 0.0) is waits
        assert took >= 0.01 or not waits


TWELVE = [(family, seed) for family in ("clutter", "car_bay", "reverse_cusp", "gap_blocked") for seed in range(3)]


def counted_results(cases):
    """Return the bits of every plan within a budget that some of the cases exceed, or the error."""
    found = {}
    for family, seed in cases:
        problem = families.instance(family, seed).problem
        with budget_clock("counted"):
            try:
                plan = plan_dock(problem, time_budget=0.03)
            except OptdockError as error:
                found[family, seed] = (str(error), dict(error.partial.timing_ms))
                continue
        tried = [(one.stage, one.seconds, one.price, one.reason) for one in plan.tried]
        found[family, seed] = (plan.path.digest, plan.trajectory.time_law.states.tobytes(), plan.timing_ms, tried)
    return found


def test_counted_plans_do_not_depend_on_earlier_calls(monkeypatch):
    """Bit for bit: not on their order, caches, the measured speed of the machine, or suspensions."""
    warm_up()
    footprint_discs._bodies.cache_clear()
    forward = counted_results(TWELVE)
    assert len({len(one) for one in forward.values()}) == 2  # plans and errors
    monkeypatch.setattr(pool_of_this_thread(), "pace", 3.0)
    monkeypatch.setattr(pipeline, "_WAITS", [0.005, 0.005])
    assert counted_results(reversed(TWELVE)) == forward


def test_no_collection_of_garbage_starts_within():
    started = []
    gc.callbacks.append(lambda phase, info: started.append(phase))
    try:
        with garbage_collection_paused():
            started.clear()
            for _ in range(10_000):
                loop = []
                loop.append(loop)
            assert not started
        for _ in range(10_000):
            loop = []
            loop.append(loop)
        assert started
    finally:
        gc.callbacks.pop()


def test_a_pause_ends_as_it_began():
    with pytest.raises(ZeroDivisionError), garbage_collection_paused():
        raise ZeroDivisionError
    assert gc.isenabled()
    gc.disable()
    try:
        with garbage_collection_paused():
            pass
        assert not gc.isenabled()
    finally:
        gc.enable()


def test_planning_is_not_stopped_by_a_collection():
    enabled = []
    plan = plan_dock(PROBLEM, time_budget=2.0, cancel_checker=lambda: bool(enabled.append(gc.isenabled())))
    assert plan.certificate.certified
    assert len(enabled) > 1
    assert not any(enabled)
    assert gc.isenabled()


def test_a_planner_is_asked_to_stop_at_the_deadline():
    calls, asked = [], []

    class Endless(GlobalPlanner):
        def create_plan(self, start, goal, cancel_checker):
            calls.append(start)
            while not cancel_checker():
                asked.append(np.sum(np.ones(10)))
            return Path.from_poses([start, goal])

    with pytest.raises(PlannerTimedOut, match="Endless ran out of time; raise time_budget, which is 0.02 s"):
        plan_dock(PROBLEM, time_budget=0.02, planner=Endless())
    assert asked
    assert len(calls) == 1  # `conftest` leaves plugins of tests out of the warm-up


def test_the_stop_predicate_is_not_evaluated_after_it_was_true():
    answers = iter([False, False, True])
    deadline = Deadline(stop=lambda: next(answers))  # asked a fourth time it would raise
    shorter = deadline.shortened(at_most=10.0)
    assert not deadline.passed()
    assert not shorter.passed()
    assert not deadline.stopped
    assert shorter.passed()
    assert deadline.passed()
    assert deadline.stopped
    assert shorter.stopped
    with pytest.raises(OutOfTime):
        shorter.look()


def test_a_passed_deadline_is_not_stopped():
    deadline = Deadline(0.0)
    assert deadline.passed()
    assert not deadline.stopped
