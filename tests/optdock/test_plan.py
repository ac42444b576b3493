"""Plans: saved, loaded and proven anew, drawn, shown in a line."""

import dataclasses
import sys
from pathlib import Path as FilePath

import numpy as np
import pytest

from optdock.errors import CertificationFailed, InvalidFile, InvalidPath, InvalidValue, MissingExtra, OptdockError
from optdock.geometry.footprint import Footprint
from optdock.geometry.pose import Pose2
from optdock.io.plan_file import PlanFile, load_plan, save_plan
from optdock.model.constant_jerk import TimeLaw
from optdock.model.dock import Dock
from optdock.model.limits import MotionLimits
from optdock.model.problem import DockingProblem
from optdock.model.robot import Robot
from optdock.planning.pipeline import plan_dock
from optdock.planning.plan import DockPlan, PartialPlan
from optdock.verification import proven_for

LIMITS = MotionLimits(max_curvature=2.0, max_curvature_rate=8.0)
PROBLEM = DockingProblem(
    Pose2(-2.0, 0.3, 0.1),
    Dock(Pose2(0.0, 0.0, 0.0), final_straight=0.2),
    Robot(Footprint.rectangle(0.3, 0.3, 0.5), LIMITS),
    obstacles=[[(-2.0, 0.8), (0.0, 0.8), (0.0, 1.0), (-2.0, 1.0)]],
)


@pytest.fixture(scope="module")
def plan():
    return plan_dock(PROBLEM, time_budget=20.0)


@pytest.mark.parametrize("kind", [str, FilePath])
def test_saved_plan_is_the_same_plan_when_it_is_loaded(plan, tmp_path, kind):
    target = kind(tmp_path / "plans" / "one.json")
    plan.save(target)
    loaded = DockPlan.load(target, PROBLEM)
    assert loaded.path.digest == plan.path.digest
    assert loaded.certificate == plan.certificate
    assert loaded.trajectory_certificate == plan.trajectory_certificate
    t = np.linspace(0.0, plan.trajectory.duration, 50)
    np.testing.assert_array_equal(loaded.trajectory.time_law.at(t), plan.trajectory.time_law.at(t))
    assert proven_for(loaded.trajectory) == PROBLEM.fingerprint
    assert loaded.timing_ms == plan.timing_ms


def test_loaded_plan_is_proven_for_the_problem_at_hand(plan, tmp_path):
    plan.save(tmp_path / "plan.json")
    blocked = dataclasses.replace(PROBLEM, obstacles=[[(-1.2, -0.1), (-1.0, -0.1), (-1.0, 0.1), (-1.2, 0.1)]])
    with pytest.raises(CertificationFailed, match="for this problem the path is not certified: .*obstacles") as caught:
        DockPlan.load(tmp_path / "plan.json", blocked)
    assert caught.value.where["kind"] == "clearance"
    slower = dataclasses.replace(LIMITS, max_speed=0.1)
    slow = dataclasses.replace(PROBLEM, robot=dataclasses.replace(PROBLEM.robot, limits=slower))
    with pytest.raises(CertificationFailed, match="for this problem the motion is not certified: speed"):
        DockPlan.load(tmp_path / "plan.json", slow)
    with pytest.raises(InvalidPath, match="is in frame 'map'"):
        DockPlan.load(tmp_path / "plan.json", dataclasses.replace(PROBLEM, frame="odom"))


def test_loaded_motion_begins_as_the_robot_does(plan, tmp_path):
    plan.save(tmp_path / "plan.json")
    rolling = dataclasses.replace(PROBLEM, start_speed=0.1)
    with pytest.raises(CertificationFailed, match="begins with speed 0, the robot has 0.1"):
        DockPlan.load(tmp_path / "plan.json", rolling)
    # From rest, but at once with half a metre per second squared: no jerk is that large.
    jerk, begins, top = 2.0, 0.25, 0.0625
    ends = np.sqrt(top / jerk)
    cruise = (plan.path.length - begins**3 * jerk / 3.0 - top * ends) / top
    law = TimeLaw([begins, cruise, ends, ends], [-jerk, 0.0, -jerk, jerk], 0.0, 0.0, 0.5)
    save_plan(tmp_path / "kicked.json", dataclasses.replace(plan.as_file(), time_law=law))
    with pytest.raises(CertificationFailed, match="begins with acceleration 0.5, the robot has 0"):
        DockPlan.load(tmp_path / "kicked.json", PROBLEM)
    with pytest.raises(InvalidValue, match="problem: must be a DockingProblem"):
        DockPlan.load(tmp_path / "plan.json", None)


@pytest.mark.parametrize("missing", ["raw_path", "path", "time_law"])
def test_file_without_a_complete_plan_is_refused(plan, tmp_path, missing):
    save_plan(tmp_path / "part.json", dataclasses.replace(plan.as_file(), **{missing: None}))
    with pytest.raises(InvalidFile, match=r"part.json: holds no .*, so there is no plan to prove"):
        DockPlan.load(tmp_path / "part.json", PROBLEM)
    assert isinstance(load_plan(str(tmp_path / "part.json")), PlanFile)


def test_spacing_and_period_are_those_asked_for(plan, tmp_path):
    plan.save(tmp_path / "plan.json", spacing=0.1, period=0.5)
    found = load_plan(tmp_path / "plan.json")
    assert np.diff(found.trajectory.t).max() == pytest.approx(0.5)
    for wrong in (0.0, -0.1, float("nan"), float("inf"), "0.1", None, True):
        with pytest.raises(InvalidValue, match="spacing"):
            plan.save(tmp_path / "none.json", spacing=wrong)
        with pytest.raises(InvalidValue, match="period"):
            plan.save(tmp_path / "none.json", period=wrong)
    assert [file.name for file in tmp_path.iterdir()] == ["plan.json"]


def test_its_motion_is_written_as_a_table_with_units(plan, tmp_path):
    plan.save_csv(tmp_path / "motion.csv", period=0.1)
    head, *rows = (tmp_path / "motion.csv").read_text(encoding="utf-8").splitlines()
    assert head.startswith("t [s],x [m],y [m],yaw [rad],speed [m/s]")
    table = np.array([[float(value) for value in row.split(",")] for row in rows])
    np.testing.assert_array_equal(table[:, 0], plan.trajectory.sample(0.1).t)
    np.testing.assert_allclose(table[-1, 1:4], plan.problem.goal.as_array(), atol=1e-6)
    with pytest.raises(InvalidFile, match="cannot be written"):
        plan.save_csv(tmp_path)


def test_notebook_picture_needs_matplotlib(plan, monkeypatch):
    assert plan._repr_png_().startswith(b"\x89PNG")
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    assert plan._repr_png_() is None
    with pytest.raises(MissingExtra, match="plot"):
        plan.show()


def test_window_is_opened(plan, monkeypatch):
    import matplotlib.pyplot as plt

    shown = []
    monkeypatch.setattr(plt, "show", lambda: shown.append(plt.gcf().get_suptitle()))
    plt.switch_backend("agg")
    plan.show()
    plt.close("all")
    assert shown == [str(plan)]


@pytest.mark.parametrize("kind", [str, FilePath])
def test_plan_draws_itself(plan, tmp_path, kind):
    plan.plot(kind(tmp_path / "plan.png"))
    assert (tmp_path / "plan.png").read_bytes().startswith(b"\x89PNG")
    with pytest.raises(InvalidValue, match="must end in one of"):
        plan.plot(kind(tmp_path / "plan.txt"))


def test_missing_matplotlib_is_named(plan, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    with pytest.raises(MissingExtra, match="optdock\\[plot\\]"):
        plan.plot(tmp_path / "plan.png")


def test_str_of_a_plan(plan):
    length, seconds = plan.path.length, plan.trajectory.duration
    closest, total = plan.certificate.min_clearance, plan.timing_ms["total"]
    where = f"closest {closest:.3f} m to obstacles[0]"
    assert str(plan) == f"certified: {length:.2f} m in {seconds:.2f} s, {where}, planned in {total:.1f} ms"
    assert repr(plan) == f"<DockPlan {plan}>"
    assert str(dataclasses.replace(plan, completed=False)).startswith("certified, stopped early by the time budget: ")
    alone = plan_dock(dataclasses.replace(PROBLEM, obstacles=()), time_budget=20.0)
    assert "closest" not in str(alone)


def test_repr_of_a_partial_plan(plan):
    assert repr(PartialPlan()) == "<PartialPlan with nothing>"
    assert repr(PartialPlan(plan.raw_path, timing_ms={"total": 3.25})) == "<PartialPlan with raw_path after 3.2 ms>"
    assert PartialPlan.left_by(OptdockError("never begun")).raw_path is None
