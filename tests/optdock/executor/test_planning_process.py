"""Planning in another process: equal plans, shared objects, replacement of a process that dies."""

import os
import signal

import numpy as np
import pytest

from optdock.executor import PlanningProcess, ThreadPlanning
from optdock.executor.planning import Job, Outcome, planned
from optdock.model.costmap import Costmap

from .conftest import problem_with


@pytest.fixture(scope="module")
def process():
    found = PlanningProcess()
    yield found
    found.close()
    assert found.pid is None
    assert "closed" in found.planned(job(1)).reason
    assert not found.wait_until_warm(0.0)


def job(number, obstacles=(), **kwargs):
    return Job(number, 0.0, problem_with(obstacles=obstacles), 5.0)._replace(**kwargs)


def test_plans_are_equal_in_both_processes_and_costmaps_are_shared(process):
    empty = Costmap(np.zeros((60, 60), dtype=np.uint8), 0.1, (-3.0, -3.0))
    problem = problem_with().among(empty)
    asked = job(7, problem=problem)
    there, here = process.planned(asked), planned(asked)
    assert (there.number, there.outcome) == (here.number, here.outcome) == (7, Outcome.NEW)
    assert there.motion.plan.certificate.min_clearance == pytest.approx(
        here.motion.plan.certificate.min_clearance, abs=1e-6
    )
    assert there.motion.trajectory.duration == pytest.approx(here.motion.trajectory.duration, abs=1e-6)
    assert there.motion.problem.costmap is empty
    moved = there.motion.trajectory.at(0.5).pose
    again = job(8, problem=problem, running=there.motion, time=0.5, pose=moved, lead=0.1, budget=0.5)
    assert process.planned(again).outcome in {Outcome.NEW, Outcome.KEPT}


def test_error_has_reason_and_code(process):
    in_the_dock = [[[-0.2, -0.1], [0.2, -0.1], [0.2, 0.1], [-0.2, 0.1]]]
    refused = process.planned(job(3, in_the_dock))
    assert refused.outcome is Outcome.FAILED
    assert refused.code == 206
    assert refused.reason.startswith("GoalOccupied")


def test_a_process_that_is_killed_fails_its_job_and_is_replaced(process):
    """The replacement is killed before it is warm, and is replaced as well."""
    before = process.pid
    os.kill(before, signal.SIGKILL)
    failed = process.planned(job(4))
    assert failed.outcome is Outcome.FAILED
    assert "exit code -9" in failed.reason
    second = process.pid
    assert second != before
    os.kill(second, signal.SIGKILL)
    assert not process.wait_until_warm()
    assert process.wait_until_warm()
    assert process.pid != second
    planning = ThreadPlanning(process.planned)
    planning.submit(job(5))
    assert planning._result.result(timeout=60.0).outcome is Outcome.NEW
    planning.close()
