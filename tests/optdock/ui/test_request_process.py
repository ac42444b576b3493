"""The process of the page: the newest request is answered, a call can be cancelled, a process that dies is replaced.

The planner `Gated` of a small distribution in a temporary folder waits in the process until it is cancelled; a file
tells that it has begun.
"""

import dataclasses
import math
import os
import signal
import textwrap
import time

import numpy as np
import pytest

import optdock as od
from optdock.config import Scenario
from optdock.errors import InvalidValue
from optdock.io.plan_file import parse_plan
from optdock.model.costmap import Costmap
from optdock.plugins.registry import PluginChoice
from optdock.reports.plan_file_verdict import judge_plan_file
from optdock.ui.hand_planning import PlanRequest
from optdock.ui.request_process import RequestProcess, _Call, _grace, _Receiver, _Sender

GATED = '''
"""A planner that waits until it is cancelled."""
import pathlib, time
from optdock.errors import PlannerCancelled, PlannerException
from optdock.plugins.interfaces import GlobalPlanner
from optdock.plugins.parameters import PluginParameters

class GatedParameters(PluginParameters):
    """Parameters of `Gated`."""
    begun: str = ""

class Gated(GlobalPlanner):
    """Waits."""
    Parameters = GatedParameters
    def create_plan(self, start, goal, cancel_checker=lambda: False):
        if not self.parameters.begun:
            raise PlannerException("warm")
        pathlib.Path(self.parameters.begun).touch()
        while not cancel_checker():
            time.sleep(0.001)
        raise PlannerCancelled("cancelled")
'''


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Return a folder on Python's path with the planner; the process inherits the path."""
    folder = tmp_path_factory.mktemp("plugins")
    (folder / "gated_planner.py").write_text(textwrap.dedent(GATED))
    info = folder / "gated_planner-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: gated-planner\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[optdock.planners]\nGated = gated_planner:Gated\n")
    with pytest.MonkeyPatch.context() as patched:
        patched.syspath_prepend(folder)
        yield folder


@pytest.fixture(scope="module")
def process(folder):
    made = RequestProcess()
    assert made.warm_up()
    yield made
    made.close()


@pytest.fixture
def number(process):
    """Return a number greater than those of all earlier requests."""
    return process._last + 1


def scenario_at(x=0.0, y=0.0, **options):
    robot = od.Robot(od.Footprint.rectangle(0.2, 0.2, 0.2), od.MotionLimits(max_curvature=3.0, max_curvature_rate=12.0))
    dock = od.Dock(od.Pose2(3.0, 0.5, 0.0), od.Footprint.rectangle(0.5, -0.25, 0.3), final_straight=0.3)
    return Scenario(od.DockingProblem(od.Pose2(x, y, 0.2), dock, robot, clearance=0.02), time_budget=20.0, **options)


def gated(begun):
    return scenario_at(planner=(PluginChoice("Gated", {"begun": str(begun)}),))


def until(found):
    while not (result := found()):
        time.sleep(0.002)
    return result


def answers_up_to(process, number):
    """Return all answers up to that to a request."""
    found = []
    until(lambda: found.extend(process.answers()) or (found and found[-1].number >= number))
    return found


def test_answers_carry_number_and_fingerprint_and_hold_for_their_scene(process, number):
    told = []

    def tell():
        told.append(process.pid)
        raise ValueError("the page fails")

    process._on_answer = tell
    for k, in_hand in enumerate((False, True, True)):
        scenario = scenario_at(0.02 * k)
        process.ask(scenario, number + k, f"scene {k}", in_hand=in_hand)
        (drawn,) = answers_up_to(process, number + k)
        assert (drawn.number, drawn.fingerprint, drawn.outcome) == (number + k, f"scene {k}", "certified")
        assert drawn.method == ("deformed" if in_hand else "planned")
        assert judge_plan_file(parse_plan(drawn.plan_file(scenario.problem).as_json(), "text"), scenario.problem)
    until(lambda: len(told) == 3)
    process._on_answer = None


def test_the_newest_request_wins_over_a_long_call_and_those_in_between(process, number, tmp_path):
    process.ask(gated(tmp_path / "begun"), number, "long")
    until((tmp_path / "begun").exists)
    with process._changed:  # no request is taken in between
        for k in (1, 2, 3):
            process.ask(scenario_at(0.1 * k), number + k, str(k))
    ended, newest = answers_up_to(process, number + 3)
    assert (ended.number, ended.outcome, ended.fingerprint) == (number, "cancelled", "long")
    assert (newest.number, newest.outcome, newest.fingerprint) == (number + 3, "certified", "3")


def test_cancel_ends_the_running_call_and_no_later_one(process, number, tmp_path):
    process.ask(gated(tmp_path / "begun"), number, "long")
    until((tmp_path / "begun").exists)
    process.cancel()
    (ended,) = answers_up_to(process, number)
    assert (ended.number, ended.outcome) == (number, "cancelled")
    process.ask(scenario_at(), number + 1, "next")
    assert answers_up_to(process, number + 1)[-1].outcome == "certified"


def test_a_request_that_cannot_be_sent_is_answered_by_the_reason(process, number, monkeypatch):
    monkeypatch.setattr(process, "_replace", lambda: None)  # nothing was sent
    process.ask(scenario_at(smoother=PluginChoice("CasadiSmoother", {"spans": lambda: 1})), number, "wrong")
    (drawn,) = answers_up_to(process, number)
    assert (drawn.number, drawn.fingerprint, drawn.outcome) == (number, "wrong", "refused")
    assert drawn.headline.startswith("the request cannot be sent: ")


def test_a_process_that_dies_is_replaced_and_its_request_answered(process, number, tmp_path):
    before = process.pid
    process.ask(gated(tmp_path / "begun"), number, "killed")
    until((tmp_path / "begun").exists)
    os.kill(before, signal.SIGKILL)
    (lost,) = answers_up_to(process, number)
    assert (lost.number, lost.fingerprint, lost.outcome) == (number, "killed", "refused")
    assert "exit code -9" in lost.headline
    process.ask_drive(scenario_at(), number + 1, "driven")
    (drive,) = answers_up_to(process, number + 1)
    assert (drive.number, drive.fingerprint, drive.outcome) == (number + 1, "driven", "docked")
    assert process.pid != before


def test_a_call_ends_if_it_is_cancelled_or_a_newer_request_has_waited_for_the_grace_time():
    numbers = [5, 0]  # newest, newest cancelled
    assert not _Call(numbers, 5, -math.inf)()
    assert not _Call(numbers, 4, math.inf)()
    superseded = _Call(numbers, 4, -math.inf)
    assert superseded()
    assert superseded.is_superseded
    numbers[1] = 4
    cancelled = _Call(numbers, 4, math.inf)
    assert cancelled()
    assert not cancelled.is_superseded
    assert not _Call(numbers, 5, -math.inf)()
    assert [_grace(k) / _grace(0) for k in (1, 2, 50, 60)] == [2.0, 4.0, 64.0, 64.0]


def test_a_map_is_sent_once_and_again_if_it_changes():
    cells = np.zeros((100, 100), dtype=np.uint8)
    cells[40:45, 20:80] = 254
    sender, receiver, sizes = _Sender(), _Receiver(), []

    def sent(data, x):
        costmap = Costmap(data, 0.1, (-5.0, -5.0))
        scenario = scenario_at(x)
        scenario = dataclasses.replace(scenario, problem=dataclasses.replace(scenario.problem, costmap=costmap))
        message = sender.dumps(PlanRequest(1, "f", scenario))
        sizes.append(len(message))
        found = receiver.loads(message).scenario.problem
        assert found.fingerprint == scenario.problem.fingerprint
        return found.costmap

    first = sent(cells, 0.0)
    assert sent(cells, 0.1) is first
    changed = cells.copy()
    changed[0, 0] = 254
    assert sent(changed, 0.1) is not first
    assert sizes[0] == sizes[2]
    assert sizes[0] > cells.size
    assert sizes[1] < 5_000 < cells.size


def test_the_process_ends_with_its_owner_in_the_middle_of_a_call(process, number, tmp_path):
    """If the owner is killed, the operating system closes its end of the pipe."""
    process.ask(gated(tmp_path / "begun"), number, "")
    until((tmp_path / "begun").exists)
    with pytest.raises(InvalidValue, match=f"must be > {number}, got {number}"):
        process.ask(scenario_at(), number, "")
    worker = process._worker.process
    process._worker.alive.close()
    worker.join()
    assert worker.exitcode == 1
    process.close()
    assert process.pid is None
    with pytest.raises(InvalidValue, match="closed"):
        process.ask(scenario_at(), number + 1, "")
