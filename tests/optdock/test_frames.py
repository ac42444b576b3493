"""Paths and motions have the frame of their poses, and two known frames are never mixed."""

import dataclasses

import pytest

from optdock.errors import ControllerInvalidPath, InvalidPath
from optdock.geometry.footprint import Footprint
from optdock.geometry.pose import Pose2
from optdock.io.plan_file import PlanFile, load_plan
from optdock.model.dock import Dock
from optdock.model.path import Path, may_be_one_frame
from optdock.planning.pipeline import plan_dock
from optdock.plugins.interfaces import Controller, GlobalPlanner, PluginContext, Smoother
from optdock.plugins.registry import create_plugin
from optdock.testing.contracts.contract_scene import GOAL, ORIGIN, raw_path, scene_problem
from optdock.verification import certify_path

DEPOT = dataclasses.replace(scene_problem(), frame="depot")
SMOOTHERS = ["CasadiSmoother", "SimpleSmoother", "SavitzkyGolaySmoother"]
CONTROLLERS = ["TrackingController", "MpcController"]


def smoother(name, context=None):
    plugin = create_plugin(Smoother, name)
    plugin.configure(context or PluginContext())
    return plugin


def test_a_frame_is_set_once():
    path = raw_path()
    assert path.frame == ""
    named = path.with_frame("depot")
    assert named.frame == "depot"
    assert named.segments is path.segments
    assert named.with_frame("depot") is named.with_frame("") is named
    with pytest.raises(InvalidPath, match="is in frame 'depot', not in 'odom'; transform it first"):
        named.with_frame("odom")
    assert Path.from_poses([ORIGIN, GOAL], "depot").frame == "depot"
    with pytest.raises(InvalidPath, match=r"path\.frame: must be a name, got 3"):
        Path(path.segments, 3)


@pytest.mark.parametrize(
    ("first", "second", "same"), [("a", "a", True), ("a", "", True), ("", "a", True), ("", "", True), ("a", "b", False)]
)
def test_an_unknown_frame_matches_every_frame(first, second, same):
    assert may_be_one_frame(first, second) is same


def test_a_planner_names_the_frame_of_its_problem_and_none_where_it_has_none():
    planner = create_plugin(GlobalPlanner, "DockPlanner")
    planner.configure(PluginContext(problem=DEPOT))
    assert planner.create_plan(ORIGIN, GOAL).frame == "depot"
    plain = create_plugin(GlobalPlanner, "DockPlanner")
    plain.configure(PluginContext(footprint=Footprint.rectangle(0.4, 0.3, 0.5)))
    assert plain.create_plan(ORIGIN, GOAL).frame == ""


@pytest.mark.parametrize("name", SMOOTHERS)
def test_a_smoothers_result_is_in_the_frame_of_problem_and_path(name):
    plain, named = raw_path(), raw_path().with_frame("depot")
    assert smoother(name).smooth(plain, 20.0, problem=DEPOT).path.frame == "depot"
    assert smoother(name).smooth(named, 20.0, problem=DEPOT).path.frame == "depot"
    context = PluginContext(footprint=DEPOT.robot.footprint)
    assert smoother(name, context).smooth(named, 20.0).path.frame == "depot"
    assert smoother(name, context).smooth(plain, 20.0).path.frame == ""


@pytest.mark.parametrize("name", SMOOTHERS)
def test_a_smoother_refuses_a_path_in_another_frame(name):
    odom = raw_path().with_frame("odom")
    for call in (
        lambda: smoother(name).smooth(odom, 20.0, problem=DEPOT),
        lambda: smoother(name, PluginContext(problem=DEPOT)).smooth(odom, 20.0),
    ):
        with pytest.raises(InvalidPath, match="is in frame 'odom', not in 'depot'"):
            call()


@pytest.mark.parametrize("name", CONTROLLERS)
def test_a_controller_refuses_a_path_in_another_frame(name):
    controller = create_plugin(Controller, name)
    controller.configure(PluginContext(problem=DEPOT))
    with pytest.raises(ControllerInvalidPath, match="path is in frame 'odom', the configured problem in 'depot'"):
        controller.set_path(Path.from_poses([ORIGIN, Pose2(1.0, 0.0, 0.0)], "odom"))
    for frame in ("", "depot"):
        controller.set_path(Path.from_poses([ORIGIN, Pose2(1.0, 0.0, 0.0)], frame))
    create_plugin(Controller, name).set_path(Path.from_poses([ORIGIN, Pose2(1.0, 0.0, 0.0)], "odom"))


def test_no_certificate_holds_across_frames():
    straight = dataclasses.replace(DEPOT, dock=Dock(Pose2(2.0, 0.0, 0.0)))
    path = Path.from_poses([ORIGIN, straight.goal])
    assert certify_path(path, straight).certified
    assert certify_path(path.with_frame("depot"), straight).certified
    (violation,) = certify_path(path.with_frame("odom"), straight).violations
    assert violation.kind == "frame"
    assert "is in frame 'odom', the problem in 'depot'" in violation.message


def test_results_of_the_pipeline_have_the_frame(tmp_path):
    plan = plan_dock(DEPOT, time_budget=5.0)
    assert {plan.frame, plan.raw_path.frame, plan.path.frame, plan.trajectory.frame} == {"depot"}
    plan.save(tmp_path / "plan.json", period=0.05)
    loaded = load_plan(tmp_path / "plan.json")
    assert (loaded.frame, loaded.path.frame, loaded.raw_path.frame) == ("depot", "depot", "depot")


def test_a_plan_file_cannot_name_another_frame_than_its_paths():
    with pytest.raises(InvalidPath, match="is in frame 'odom', not in 'depot'"):
        PlanFile(frame="depot", path=raw_path().with_frame("odom"))
