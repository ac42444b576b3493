"""Dock types: the default by settings, other dock types, and invalid answers."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from optdock.calibration import recording
from optdock.calibration.recording import recording_of_log
from optdock.errors import InvalidValue, PluginError
from optdock.executor import DockingExecutor, EndingKind, ExecutorSettings, InlinePlanning, SimpleDock, State
from optdock.executor.checked_inputs import CheckedDockType
from optdock.executor.log import DockingLog, LogWriter, read_log
from optdock.executor.replay import replay
from optdock.geometry.pose import Pose2, Twist2
from optdock.model.measurements import AtDock, Detection, Measurements
from optdock.plugins.interfaces import Contact, DockType
from optdock.plugins.registry import PluginChoice
from optdock.simulation import Actuation, Station
from tests.optdock.executor.conftest import PERFECT, TRUE_DOCK, problem_with, run, simulated
from tests.optdock.executor.test_endings import AFAR, QUICK, Recording, StraightPlanning, perfect

ORIGIN = Pose2(0.0, 0.0, 0.0)
STANDS = Measurements(0.0, TRUE_DOCK)
NEAR = Pose2(-0.8, 0.0, 0.0)


def docked(dock_type=None, *, start=None, before=None, planning=None, rate=12.5, **chosen):
    """A straight docking without errors."""
    world = perfect(NEAR if start is None else start)
    settings_ = ExecutorSettings(**(QUICK | chosen))
    planning = planning or StraightPlanning()
    return run(world, problem_with(), settings_, rate=rate, dock_type=dock_type, before=before, planning=planning)


def commands(docking):
    return [(step.command.linear.hex(), step.command.angular.hex(), step.state) for step in docking.steps]


@pytest.mark.parametrize(
    "chosen",
    [{"contact": "touch", "stall_time": 0.2, "max_retries": 0}, {"wait_for_charge": True, "max_retries": 0}],
    ids=["touch", "charge"],
)
def test_simple_dock_by_settings_equals_simple_dock_by_parameters(chosen):
    of_dock = {name: value for name, value in chosen.items() if name in SimpleDock.Parameters.model_fields}
    rest = {name: value for name, value in chosen.items() if name not in of_dock}
    by_settings = docked(None, **chosen)
    found = docked(PluginChoice("SimpleDock", of_dock), **rest)
    assert commands(found) == commands(by_settings)
    assert found.ending == by_settings.ending


def test_settings_of_a_given_dock_type_are_errors():
    for name, value in (("contact", "touch"), ("back_out_distance", 0.2), ("wait_for_charge", True)):
        chosen = ExecutorSettings(**{name: value})
        with pytest.raises(InvalidValue, match=rf"settings\.{name}: must be a parameter of the given dock type"):
            DockingExecutor(problem_with(), chosen, dock_type="SimpleDock")
    DockingExecutor(problem_with(), ExecutorSettings(staging_distance=0.9), dock_type="SimpleDock")
    with pytest.raises(PluginError, match="unknown plugin 'SimpleDoc'; did you mean SimpleDock"):
        DockingExecutor(problem_with(), dock_type="SimpleDoc")
    with pytest.raises(InvalidValue, match=r"write SimpleDock\(\)"):
        DockingExecutor(problem_with(), dock_type=SimpleDock)


# Staging poses.


@pytest.mark.parametrize("gear", [1.0, -1.0])
def test_staging_poses_are_on_the_axis_or_from_the_parameters(gear):
    assert SimpleDock().staging_poses(gear, 0.8) == (Pose2(-gear * 0.8, 0.0, 0.0),)
    assert SimpleDock(staging_distance=1.1).staging_poses(gear, 0.8) == (Pose2(-gear * 1.1, 0.0, 0.0),)
    poses = [[-0.9, 0.0, 0.0], [-0.7, 0.2, -0.3]]
    assert SimpleDock(staging_poses=poses).staging_poses(gear, 0.8) == tuple(Pose2(*pose) for pose in poses)


@pytest.mark.parametrize("wrong", [[[0.0, 1.0]], [["1", 0.0, 0.0]], [[True, 0.0, 0.0]], [[math.nan, 0.0, 0.0]], 3.0])
def test_staging_poses_are_three_numbers_each(wrong):
    with pytest.raises(InvalidValue, match=r"SimpleDock\.staging_poses"):
        SimpleDock(staging_poses=wrong)
    with pytest.raises(InvalidValue, match="exclude each other"):
        SimpleDock(staging_poses=[[-1.0, 0.0, 0.0]], staging_distance=1.0)


TWO = PluginChoice("SimpleDock", {"staging_poses": [[-0.9, 0.0, 0.0], [-0.6, 0.0, 0.0]]})
BOX = [[-1.3, -0.2], [-1.1, -0.2], [-1.1, 0.2], [-1.3, 0.2]]  # where a robot at the first pose would stand


def test_occupied_staging_pose_is_replaced_by_the_next(lawful):
    """Undocking fails with one pose and succeeds with a second one."""
    found = {}
    for name, obstacles, kind in (("two", (BOX,), TWO), ("one", (BOX,), "SimpleDock")):
        world = simulated(ORIGIN, sensors=PERFECT, actuation=Actuation())
        chosen = ExecutorSettings(
            staging_distance=0.9, obstacle_patience=0.1, use_detections=False, replanning=False, time_budget=0.1
        )
        docking = run(world, problem_with(TRUE_DOCK, obstacles), chosen, task="undock", dock_type=kind)
        lawful(docking)
        found[name] = docking
    assert [docking.ending.kind.name for docking in found.values()] == ["UNDOCKED", "FAILED_TO_STAGE"]
    assert found["two"].world.error.gap_to(Pose2(-0.6, 0.0, 0.0)) < 0.05
    assert [event.detail[:6] for event in found["two"].said("no way to a staging pose")] == ["number"]


def test_task_ends_after_the_last_staging_pose():
    planning = Recording(reason="a wall")
    docking = docked(TWO, start=AFAR, planning=planning, rate=25.0)
    asked = [job.problem.goal.in_frame_of(TRUE_DOCK).as_array() for job in planning.jobs]
    np.testing.assert_allclose(asked[:4], TWO.parameters["staging_poses"] * 2, atol=1e-9)
    assert docking.ending.kind is EndingKind.FAILED_TO_STAGE
    assert docking.ending.reason.endswith("no way to the staging pose: a wall")
    assert docking.said("no way to a staging pose")


def test_robot_at_one_of_the_staging_poses_has_arrived():
    for pose in (Pose2(-0.9, 0.0, 0.0), Pose2(-0.6, 0.0, 0.0)):
        docking = docked(TWO, start=pose, prestaging_tolerance=0.05, planning=StraightPlanning(reason="a wall"))
        assert State.STAGING not in docking.states


# Contact and charge.


class Recorder(DockType):
    """Keeps its calls; the staging pose is in the dock, and it never charges."""

    waits_for_charge = True

    def __init__(self):
        super().__init__()
        self.told = []

    def contact(self, now):
        self.told.append(now)

    def reset(self):
        self.told.append(None)

    def staging_poses(self, gear, distance):
        return [Pose2(-0.02, 0.0, 0.0)]


def test_contact_is_called_once_a_cycle_and_reset_before_every_approach():
    dock_type = Recorder()
    start = Pose2(-0.4, 0.0, 0.0)
    docking = docked(dock_type, start=start, planning=InlinePlanning(), navigate_to_staging_pose=False, max_retries=1)
    assert docking.ending.kind is EndingKind.FAILED_TO_CHARGE
    assert docking.ending.num_retries == 1
    told = [one for one in dock_type.told if one is not None]
    assert told == sorted(told, key=lambda now: now.stamp)
    assert len({now.stamp for now in told}) == len(told)
    assert len(told) == len(docking.steps), "until the task has ended"
    assert len(dock_type.told) - len(told) == 1 + 2, "once for the task, once for every approach"
    assert [now.commanded for now in told[1:]] == [step.command for step in docking.steps[:-1]]
    assert {now.is_near for now in told if abs(now.robot.x) < 0.04} == {True}
    assert {now.is_near for now in told if abs(now.robot.x) > 0.1 and now.stamp > 0.5} == {False}


class Latched(DockType):
    """Contact as soon as the robot is nearer than 4 cm."""

    def __init__(self, kind):
        super().__init__()
        self.kind = kind

    def contact(self, now):
        return self.kind if now.robot.x > -0.04 else None


@pytest.mark.parametrize(
    ("kind", "ending"), [(Contact.SIGNAL, EndingKind.DOCKED_BY_SIGNAL), (Contact.STALL, EndingKind.DOCKED_BY_STALL)]
)
def test_contact_ends_the_approach(kind, ending):
    docking = docked(Latched(kind), rate=25.0)
    assert docking.ending.kind is ending
    (plan,) = docking.said("plan new")
    assert plan.detail == "0.800 m in 3.62 s"
    assert docking.ending.stamp < plan.stamp + 3.62, "before the motion was over"
    assert -0.04 < docking.world.error.x < -0.001


def test_contact_far_from_the_dock_is_reported_and_ignored():
    stuck = type("Stuck", (DockType,), {"contact": lambda self, now: Contact.SIGNAL, "is_pressed_on": True})
    docking = docked(stuck(), use_detections=False, stored_position_sigma=0.01)
    (said,) = docking.said("external signal far from the dock")
    assert said.stamp < 2.0
    assert docking.ending.kind is EndingKind.DOCKED_BY_SIGNAL
    assert docking.world.error.x > -0.09


def charger(at=2.0, amperes=4.0):
    """A current from this time on, once the robot is docked."""

    def before(executor, world, measurements):
        flows = world.time > at and world.error.x > -0.01
        return measurements._replace(contact=None, current=amperes if flows else -0.3)

    return before


@pytest.mark.parametrize(("threshold", "is_enough"), [(2.0, True), (5.0, False)])
def test_wait_for_charge_by_current(threshold, is_enough):
    dock_type = SimpleDock(wait_for_charge=True, charging_current=threshold)
    docking = docked(dock_type, before=charger(), max_retries=0)
    assert docking.ending.kind.succeeded is is_enough
    assert is_enough or docking.ending.kind is EndingKind.FAILED_TO_CHARGE
    if not is_enough:
        by_signal = docked(SimpleDock(wait_for_charge=True), before=charger(), max_retries=0)
        assert by_signal.ending.kind is EndingKind.FAILED_TO_CHARGE, "without the parameter, the current has no effect"


numbers, switches = st.floats(-2.0, 2.0), st.sampled_from([None, False, True])
cycles = st.lists(
    st.tuples(st.floats(0.0, 0.3), numbers, numbers, switches, st.none() | numbers, st.booleans()), max_size=30
)


@settings(max_examples=20)
@given(cycles, st.sampled_from(["distance", "touch"]), st.none() | st.floats(0.0, 1.0))
def test_contact_of_the_simple_dock(told, contact, charging_current):
    """Signals by switch or current; stalls, compared with an independent count of their duration."""
    dock_type = SimpleDock(contact=contact, stall_time=0.4, charging_current=charging_current)
    stamp, lasts_since = 0.0, None
    for period, commanded, speed, switch, current, is_near in told:
        stamp += period
        measurements = Measurements(stamp, None, Twist2(speed), contact=switch, current=current)
        found = dock_type.contact(AtDock(stamp, measurements, Twist2(commanded), ORIGIN, is_near))
        lasts_since = (
            (stamp if lasts_since is None else lasts_since) if abs(commanded) > 0.01 > 2 * abs(speed) else None
        )
        charges = charging_current is not None and current is not None and current > charging_current
        assert dock_type.is_charging(measurements) is (charges if charging_current is not None else switch is True)
        stalls = contact == "touch" and is_near and lasts_since is not None and stamp - lasts_since >= 0.4
        signal = Contact.SIGNAL if switch or charges else None
        assert found is (signal or (Contact.STALL if stalls else None))


# Detections.


class Shifted(DockType):
    """A dock whose marker is displaced."""

    def __init__(self, offset):
        super().__init__()
        self.offset = offset

    def contact(self, now):
        return None

    def detections(self, measurements):
        return [one._replace(pose=one.pose @ self.offset) for one in measurements.detections]


def test_dock_type_corrects_a_displaced_marker():
    marker = Pose2(0.0, 0.06, 0.1)

    def seen(executor, world, measurements):
        moved = tuple(one._replace(pose=one.pose @ marker) for one in measurements.detections)
        return measurements._replace(detections=moved)

    off = {}
    for name, dock_type in (("told", Shifted(marker.inverse())), ("not told", "SimpleDock")):
        world = simulated(Pose2(-0.5, 0.0, 0.0), sensors=PERFECT, actuation=Actuation())
        docking = run(world, problem_with(TRUE_DOCK), before=seen, dock_type=dock_type, rate=12.5)
        off[name] = abs(world.error.y)
        assert name != "told" or docking.ending.kind is EndingKind.DOCKED_BY_DISTANCE
    assert off["told"] < 0.003
    assert off["not told"] > 0.04


def test_calibration_uses_the_detections_of_the_dock_type(tmp_path, monkeypatch):
    """A log contains the raw detections."""
    offset, created = Pose2(0.0, -0.06, -0.1), []
    monkeypatch.setattr(recording, "create_plugin", lambda *asked: created.append(asked) or Shifted(offset))
    with LogWriter(tmp_path / "docking.log") as log:
        run(perfect(), problem_with(), ExecutorSettings(timeout=0.5), log=log, dock_type="SimpleDock")
    found = read_log(tmp_path / "docking.log")
    (seen, *_) = (one for cycle in found.cycles for one in cycle.measurements.detections)
    np.testing.assert_array_equal(recording_of_log(found).detections[0, 1:4], (seen.pose @ offset).as_array())
    assert [asked[1:] for asked in created] == [("SimpleDock", found.task.dock_type.parameters)]
    plain = DockingLog(found.source, found.task._replace(dock_type=None), found.cycles, cut_off=False)
    np.testing.assert_array_equal(recording_of_log(plain).detections[0, 1:4], seen.pose.as_array())


# Invalid answers.


def raising(*_):
    raise ZeroDivisionError("of an author")


POSE = Detection(0.0, Pose2(0.8, 0.0, 0.0), 0.003, 0.005)
NONSENSE = {
    "contact": ["touched", True, raising],
    "is_pressed_on": ["yes", None, raising],
    "waits_for_charge": [1, raising],
    "is_charging": [None, "no", raising],
    "staging_poses": [(), None, [(1.0, 0.0, 0.0)], Pose2(-1.0, 0.0, 0.0), raising],
    "back_out_distance": [math.nan, math.inf, -1.0, 0.0, True, "far", None, raising],
    "detections": [None, 3, "x", [None], POSE, [POSE._replace(stamp=math.nan)], [POSE._replace(pose=None)], raising],
    "reset": [raising],
}
ARGUMENTS = {
    "contact": (AtDock(0.0, STANDS, Twist2(), ORIGIN, is_near=True),),
    "staging_poses": (1.0, 0.7),
    "reset": (),
}
PROPERTIES = {"is_pressed_on", "waits_for_charge", "back_out_distance"}


def foreign(name, answer):
    """A dock type with one member that returns this answer, or raises."""
    given_ = answer if callable(answer) else lambda *_: answer
    return type(
        "Foreign", (DockType,), {"contact": lambda *_: None, name: property(given_) if name in PROPERTIES else given_}
    )()


@pytest.mark.parametrize(("name", "answer"), [(name, one) for name, answers in NONSENSE.items() for one in answers])
def test_invalid_answer_is_an_error_with_its_name(name, answer):
    def asked():
        member = getattr(CheckedDockType(foreign(name, answer)), name)
        return member if name in PROPERTIES else member(*ARGUMENTS.get(name, (STANDS,)))

    refusal = rf"^Foreign\.{name}: must be " if answer is not raising else "of an author"
    with pytest.raises((PluginError, ZeroDivisionError), match=refusal):
        asked()


ENDS = [("contact", "touched"), ("waits_for_charge", 1), ("staging_poses", ()), ("back_out_distance", math.nan)]


@pytest.mark.parametrize(("name", "answer"), [*ENDS, *((name, raising) for name in NONSENSE if name != "detections")])
def test_invalid_answer_ends_the_task_at_rest(name, answer, lawful):
    kind = foreign(name, answer)
    if name == "is_charging":
        type(kind).waits_for_charge = True
    start = {"staging_poses": AFAR, "back_out_distance": ORIGIN}.get(name)
    task = "undock" if name == "back_out_distance" else "dock"
    chosen = ExecutorSettings(**QUICK)
    world, planning = perfect(NEAR if start is None else start), StraightPlanning()
    docking = run(world, problem_with(), chosen, rate=12.5, dock_type=kind, planning=planning, task=task)
    assert lawful(docking).kind is EndingKind.UNKNOWN
    if answer is raising:
        assert docking.ending.reason == "ZeroDivisionError: of an author"
    else:
        assert docking.ending.reason.startswith(f"PluginError: Foreign.{name}: must be ")


@pytest.mark.parametrize("answer", [np.zeros((1, 3)), raising])
def test_invalid_detections_are_reported_and_ignored(answer):
    docking = docked(foreign("detections", answer))
    assert docking.ending.kind is EndingKind.FAILED_TO_DETECT_DOCK
    assert len(docking.said("detections not used")) == 1, "said once, while it lasts"


# Logs.


def test_log_contains_the_dock_type_for_the_replay(tmp_path):
    dock_type = SimpleDock(contact="touch", charging_current=1.0, staging_poses=[[-0.8, 0.1, 0.0]])
    world = simulated(Pose2(-0.5, 0.0, 0.0), sensors=PERFECT, actuation=Actuation(), station=Station(depth=0.004))
    with LogWriter(tmp_path / "docking.log") as log:
        docking = run(world, problem_with(), log=log, dock_type=dock_type, before=charger())
    found = read_log(tmp_path / "docking.log")
    assert docking.ending.kind is EndingKind.DOCKED_BY_SIGNAL
    assert found.task.dock_type == PluginChoice("SimpleDock", dock_type.parameters.model_dump(mode="json"))
    assert {cycle.measurements.current for cycle in found.cycles} >= {-0.3}
    assert replay(found).differs_at is None
    assert replay(DockingLog(found.source, found.task._replace(dock_type=None), found.cycles, cut_off=False)).differs_at


def test_log_without_a_dock_type_uses_the_settings(tmp_path):
    with LogWriter(tmp_path / "docking.log") as log:
        docked(None, planning=StraightPlanning(reason="a wall"))
        world = perfect()
        run(world, problem_with(), ExecutorSettings(**QUICK, timeout=0.2), log=log, planning=StraightPlanning())
    first = (tmp_path / "docking.log").read_text().splitlines()[0]
    assert '"dock_type"' not in first
    assert read_log(tmp_path / "docking.log").task.dock_type is None
