"""The deadline, and collection of garbage within it."""

import gc
import math
import time

import numpy as np
import pytest

from optdock.deadline import Deadline, OutOfTime, garbage_collection_paused
from optdock.errors import PlannerTimedOut
from optdock.geometry.footprint import Footprint
from optdock.geometry.pose import Pose2
from optdock.model.dock import Dock
from optdock.model.limits import MotionLimits
from optdock.model.path import Path
from optdock.model.problem import DockingProblem
from optdock.model.robot import Robot
from optdock.planning.pipeline import plan_dock
from optdock.plugins.interfaces import GlobalPlanner
from optdock.plugins.lifecycle import PluginContext

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
