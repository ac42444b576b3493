"""What the robot must not touch counts for everybody, however it is given."""

import dataclasses

import numpy as np
import pytest

from optdock.errors import ControllerInvalidPath, InvalidValue
from optdock.geometry.footprint import Footprint
from optdock.geometry.obstacles import ObstacleSet
from optdock.geometry.pose import Pose2, Twist2
from optdock.model.cell_obstacles import obstacles_from_costmap
from optdock.model.clearance_rule import ClearanceRule
from optdock.model.costmap import Costmap
from optdock.model.dock import Dock, DockDirection, DockTolerances
from optdock.model.limits import MotionLimits
from optdock.model.path import Path
from optdock.model.problem import DockingProblem
from optdock.model.robot import Drive, Robot
from optdock.planning.pipeline import plan_dock
from optdock.plugins.interfaces import Behavior, BehaviorStatus, Controller, CostmapInfoType, PluginContext, Smoother
from optdock.plugins.registry import create_plugin
from optdock.simulation import run_closed_loop
from optdock.simulation.closed_loop import SimulationSettings
from optdock.testing.contracts.contract_scene import bent_path, post_inside_the_bend, scene_problem
from optdock.verification import certify_path, pose_clearance, proven_for

LIMITS = MotionLimits(max_curvature=1.5, max_curvature_rate=6.0)
BOX = Footprint.rectangle(0.3, 0.3, 0.4)
START, GOAL = Pose2(0.0, 0.0, 0.0), Pose2(2.8, 0.0, 0.0)
STRAIGHT = Path.from_poses([START, Pose2(1.0, 0.0, 0.0), Pose2(2.0, 0.0, 0.0), GOAL])
POST = [[1.4, 0.1], [1.6, 0.1], [1.6, 0.5], [1.4, 0.5]]


def grid(blocked=(), value=254):
    """Free from -3 to 6 m, but for boxes x0, y0, x1, y1 [m]."""
    cells = np.zeros((120, 180), dtype=np.uint8)
    for x0, y0, x1, y1 in blocked:
        cells[
            round((y0 + 3.0) / 0.05) : round((y1 + 3.0) / 0.05), round((x0 + 3.0) / 0.05) : round((x1 + 3.0) / 0.05)
        ] = value
    return Costmap(cells, 0.05, (-3.0, -3.0))


def problem(**changes):
    return DockingProblem(**{"start": START, "dock": Dock(GOAL), "robot": Robot(BOX, LIMITS), **changes})


POLYGON = ObstacleSet.from_polygons([POST])
AS_CELLS = grid([(1.4, 0.1, 1.6, 0.5)])


@pytest.mark.parametrize("value", [254, 255])
def test_the_cells_of_a_problems_costmap_are_its_obstacles(value):
    blocked = problem(costmap=grid([(1.4, 0.1, 1.6, 0.5)], value))
    certificate = certify_path(STRAIGHT, blocked)
    assert not certificate.certified
    assert certificate.min_clearance == pytest.approx(-0.1, abs=1e-6)
    assert certify_path(STRAIGHT, problem(costmap=grid())).certified
    assert certify_path(STRAIGHT, dataclasses.replace(blocked, unknown_is_obstacle=False)).certified is (value == 255)


def test_beyond_the_costmap_is_an_obstacle():
    small = Costmap(np.zeros((20, 40), dtype=np.uint8), 0.05, (-0.5, -0.5))
    certificate = certify_path(STRAIGHT, problem(costmap=small))
    assert not certificate.certified
    assert certificate.nearest == "map border"


def test_cells_given_twice_count_once():
    cells = obstacles_from_costmap(AS_CELLS)
    both = problem(obstacles=POLYGON + cells, costmap=AS_CELLS)
    once = problem(obstacles=POLYGON, costmap=AS_CELLS)
    assert len(both.all_obstacles) == len(once.all_obstacles)
    assert both.fingerprint == once.fingerprint


def test_a_grid_that_is_written_later_is_not_the_problems():
    live = Costmap.writable((120, 180), 0.05, (-3.0, -3.0))
    asked = problem(costmap=live)
    live.data[:, 88:92] = 254
    assert certify_path(STRAIGHT, asked).certified
    assert not certify_path(STRAIGHT, problem(costmap=live)).certified


def worlds():
    """The same post, given in every way that a context takes."""
    free = problem()
    yield "polygon in the problem", PluginContext(problem=problem(obstacles=POLYGON))
    yield "costmap in the problem", PluginContext(problem=problem(costmap=AS_CELLS))
    yield "costmap beside the problem", PluginContext(problem=free, costmap=AS_CELLS)
    yield "costmap beside the problem's costmap", PluginContext(problem=problem(costmap=grid()), costmap=AS_CELLS)
    yield "local costmap beside the problem", PluginContext(problem=free, local_costmap=AS_CELLS)
    yield "local costmap beside the global one", PluginContext(costmap=grid(), local_costmap=AS_CELLS, footprint=BOX)
    yield "costmap and footprint", PluginContext(costmap=AS_CELLS, footprint=BOX)
    yield "a station", PluginContext(problem=problem(dock=Dock(GOAL, Footprint(np.array(POST) - [GOAL.x, 0.0]))))


WORLDS = dict(worlds())


BENT = bent_path()


def around_the_bend():
    """The post inside the bend, given in every way that a smoother may hear of it."""
    polygon, free = post_inside_the_bend(), scene_problem()
    fine = Costmap(np.zeros((500, 600), dtype=np.uint8), 0.01, (-1.0, -1.331))  # has a cell border at 0.669 m
    cells = fine.data.copy()
    cells[180:200, 220:240] = 254
    blocked = fine.with_data(cells)
    outline = free.robot.footprint
    yield "polygon, in the call", PluginContext(), scene_problem(obstacles=polygon)
    yield "cells, in the call", PluginContext(), dataclasses.replace(free, costmap=blocked)
    yield "polygon, configured", PluginContext(problem=scene_problem(obstacles=polygon)), None
    yield "cells, configured", PluginContext(problem=free, costmap=blocked), None
    yield "cells, configured beside the call", PluginContext(costmap=blocked), free
    yield "cells and an outline", PluginContext(costmap=blocked, footprint=outline), None


BENDS = {name: task for name, *task in around_the_bend()}


@pytest.mark.parametrize("name", ["SimpleSmoother", "SavitzkyGolaySmoother"])
@pytest.mark.parametrize("bend", BENDS)
def test_nav2s_smoothers_take_back_what_would_collide(name, bend):
    context, called_with = BENDS[bend]
    known = scene_problem(obstacles=post_inside_the_bend())

    def smoothed(**parameters):
        smoother = create_plugin(Smoother, name, parameters)
        smoother.configure(context)
        return smoother.smooth(BENT, 10.0, problem=called_with).path

    def deepest(path):
        return min(
            pose_clearance(Pose2.from_sequence(p), known.robot.footprint, known.all_obstacles)[0]
            for p in path.segments[0].poses
        )

    assert 0.0 < deepest(BENT) < 0.001
    assert deepest(smoothed(check_for_collisions=False)) < -0.001
    kept = smoothed()
    assert (kept.segments[0].poses == BENT.segments[0].poses).all()


@pytest.mark.parametrize("context", WORLDS.values(), ids=WORLDS)
def test_every_plugin_meets_the_same_obstacle(context):
    near = context.obstacles_near(np.array([-1.0, -2.0]), np.array([4.0, 2.0]))
    assert pose_clearance(Pose2(1.5, 0.0, 0.0), BOX, near)[0] == pytest.approx(-0.1, abs=1e-9)

    for name, command, pose in (
        ("DriveOnHeading", {"target": 1.5, "speed": 0.3}, START),
        ("BackUp", {"target": -1.5, "speed": -0.3}, GOAL),
    ):
        behavior = create_plugin(Behavior, name)
        behavior.configure(context)
        assert behavior.on_run(command).status is BehaviorStatus.SUCCEEDED
        results = [
            behavior.on_cycle_update(pose.moved(Twist2(command.get("speed", 0.0)), t), Twist2())[0] for t in range(4)
        ]
        assert [r.error_msg for r in results if "collision ahead" in r.error_msg], name


@pytest.mark.parametrize("context", WORLDS.values(), ids=WORLDS)
def test_the_certifying_smoother_never_reports_a_certificate_through_it(context):
    """However its problem reaches it: the certificate in its report is that of the path among the post."""
    smoother = create_plugin(Smoother, "CasadiSmoother", {"max_curvature": 1.5, "max_curvature_rate": 6.0})
    smoother.configure(context)
    found = smoother.smooth(STRAIGHT, 5.0)
    near = context.obstacles_near(np.array([-1.0, -2.0]), np.array([4.0, 2.0]))
    assert found.report.certificate.certified
    assert certify_path(found.path, problem(obstacles=near, clearance=ClearanceRule(0.0, 0.0, 0.0))).certified


def test_configured_and_called_with_a_problem_is_the_same():
    task = problem(obstacles=POLYGON)
    by_context, by_call = (create_plugin(Smoother, "CasadiSmoother") for _ in range(2))
    by_context.configure(PluginContext(problem=task, footprint=BOX))
    mine, theirs = by_context.smooth(STRAIGHT, 5.0), by_call.smooth(STRAIGHT, 5.0, problem=task)
    assert mine.path.digest == theirs.path.digest
    assert mine.report.certificate.problem == theirs.report.certificate.problem == task.fingerprint


def test_a_configured_costmap_counts_beside_the_problem_of_the_call():
    smoother = create_plugin(Smoother, "CasadiSmoother")
    smoother.configure(PluginContext(costmap=AS_CELLS, footprint=BOX))
    assert certify_path(smoother.smooth(STRAIGHT, 5.0, problem=problem()).path, problem(costmap=AS_CELLS)).certified
    newer = problem(costmap=grid())  # the call's own picture replaces the configured one
    assert np.abs(smoother.smooth(STRAIGHT, 5.0, problem=newer).path.sample(0.05).y).max() < 1e-6


def test_a_path_that_leads_elsewhere_keeps_its_ends_among_the_configured_obstacles():
    station = Footprint(np.array(POST) - [GOAL.x, 0.0])
    smoother = create_plugin(Smoother, "CasadiSmoother")
    smoother.configure(PluginContext(problem=problem(dock=Dock(GOAL, station, DockDirection.BACKWARD))))
    away = Path.from_poses([Pose2(0.2, 0.1, 0.0), Pose2(1.0, 0.0, 0.0), Pose2(2.5, 0.0, 0.0)])
    found = smoother.smooth(away, 5.0)
    assert (found.path.start.gap_to(away.start), found.path.end.gap_to(away.end)) == pytest.approx((0.0, 0.0), abs=1e-6)
    assert certify_path(found.path, problem(start=away.start, dock=Dock(away.end), obstacles=POLYGON)).certified


def test_local_and_global_costmaps_are_told_apart():
    here, there = grid([(1.4, 0.1, 1.6, 0.5)]), grid([(1.4, 1.4, 1.6, 1.6)])
    context = PluginContext(costmap=there, local_costmap=here, footprint=BOX)
    low, high = np.array([0.0, -1.0]), np.array([2.5, 2.0])

    def found(needs):
        return sorted(tuple(np.round(row, 2)) for row in context.obstacles_near(low, high, needs).lower)

    assert found(CostmapInfoType.NONE) == []
    assert found(CostmapInfoType.LOCAL) == [(1.4, 0.1)]
    assert found(CostmapInfoType.GLOBAL) == [(1.4, 1.4)]
    assert found(CostmapInfoType.BOTH) == [(1.4, 0.1), (1.4, 1.4)]


@pytest.mark.parametrize("name", ["SimpleSmoother", "SavitzkyGolaySmoother"])
def test_nav2s_smoothers_see_the_global_costmap_behind_a_local_one(name):
    outline = scene_problem().robot.footprint
    low, high = post_inside_the_bend().lower[0], post_inside_the_bend().upper[0]
    fine = Costmap(np.zeros((2400, 2400), dtype=np.uint8), 0.0025, (-1.5, -1.5))
    cells = fine.data.copy()
    i, j = np.floor((np.stack((low, high)) + 1.5) / 0.0025).astype(int).T
    cells[j[0] : j[1] + 1, i[0] : i[1] + 1] = 254
    behind = PluginContext(costmap=fine.with_data(cells), local_costmap=fine, footprint=outline)
    alone = PluginContext(local_costmap=fine.with_data(cells), footprint=outline)
    for context in (behind, alone):
        smoother = create_plugin(Smoother, name)
        smoother.configure(context)
        found = smoother.smooth(BENT, 10.0)
        assert (found.path.segments[0].poses == BENT.segments[0].poses).all()


def test_a_single_grid_serves_everybody_however_it_is_called():
    context = PluginContext(local_costmap=AS_CELLS, footprint=BOX)
    smoother = create_plugin(Smoother, "CasadiSmoother", {"max_curvature": 1.5, "max_curvature_rate": 6.0})
    smoother.configure(context)
    found = smoother.smooth(STRAIGHT, 5.0).path
    assert certify_path(found, problem(costmap=AS_CELLS, clearance=ClearanceRule(0.0, 0.0, 0.0))).certified


def test_two_footprints_in_one_context_are_refused():
    PluginContext(problem=problem(), footprint=Footprint(BOX.vertices))
    with pytest.raises(InvalidValue, match="footprint: differs"):
        PluginContext(problem=problem(), footprint=Footprint.rectangle(0.3, 0.3, 0.41))


@pytest.mark.parametrize("part", ["costmap", "footprint", "problem", "local_costmap"])
def test_a_context_of_other_things_is_refused_by_name(part):
    with pytest.raises(InvalidValue, match=f"context.{part}: must be a .*, got list"):
        PluginContext(**{"problem": problem(), part: [1, 2]})


def test_a_frame_that_nobody_named_is_no_other_frame():
    trajectory = plan_dock(problem(frame="odom"), time_budget=5.0).trajectory
    controller = create_plugin(Controller, "TrackingController")
    controller.configure(PluginContext(problem=problem(frame="")))
    controller.set_path(trajectory)
    assert controller.compute_velocity_commands(START, Twist2(), None).linear >= 0.0


CHANGES = {
    "footprint": {"robot": Robot(Footprint.rectangle(0.3, 0.3, 0.41), LIMITS)},
    "limits": {"robot": Robot(BOX, dataclasses.replace(LIMITS, max_jerk=3.0))},
    "obstacles": {"obstacles": POLYGON},
    "clearance": {"clearance": ClearanceRule(0.06)},
    "dock": {"dock": Dock(GOAL, final_straight=0.1)},
    "start": {"start_speed": 0.1},
    "frame": {"frame": "odom"},
}


@pytest.mark.parametrize("part", CHANGES)
def test_a_fingerprint_names_the_part_that_differs(part):
    assert problem().fingerprint.differences(problem(**CHANGES[part]).fingerprint) == (part,)


@pytest.mark.parametrize(
    "change",
    [
        {"direction": "forward"},
        {"approach_speed": 0.1},
        {"approach_distance": 0.2},
        {"tolerances": DockTolerances(along=0.01)},
        {"tolerances": DockTolerances(cross=0.01)},
        {"tolerances": DockTolerances(yaw=0.01)},
        {"footprint": BOX},
        {"pose": Pose2(GOAL.x, GOAL.y, GOAL.yaw + 0.1)},
    ],
)
def test_a_fingerprint_holds_every_part_of_the_dock(change):
    given, changed = problem().dock, dataclasses.replace(problem().dock, **change)
    assert "dock" in problem(dock=given).fingerprint.differences(problem(dock=changed).fingerprint)


def test_a_fingerprint_is_that_of_the_numbers():
    assert problem().fingerprint == problem(start=Pose2(-0.0, 0, 0)).fingerprint
    drive = Robot(BOX, LIMITS, Drive.ACKERMANN)
    assert problem().fingerprint.differences(problem(robot=drive).fingerprint) == ("limits",)
    assert problem(start_curvature=0.0).fingerprint.differences(problem().fingerprint) == ("start",)


def test_a_certificate_says_what_it_was_proven_against():
    plan = plan_dock(problem(), time_budget=2.0)
    assert plan.certificate.problem == problem().fingerprint
    assert proven_for(plan.trajectory) == problem().fingerprint
    assert plan.certificate.path == plan.trajectory_certificate.path == plan.path.digest
    assert plan.certificate.as_dict()["problem"] == problem().fingerprint._asdict()


@pytest.mark.parametrize("name", ["TrackingController", "MpcController"])
def test_a_controller_names_a_mismatch(name):
    plan = plan_dock(problem(), time_budget=2.0)
    controller = create_plugin(Controller, name)
    controller.configure(PluginContext(problem=problem(obstacles=POLYGON, clearance=ClearanceRule(0.1))))
    with pytest.raises(
        ControllerInvalidPath, match="another problem than the configured one: obstacles, clearance differ"
    ):
        controller.set_path(plan.trajectory)
    elsewhere = create_plugin(Controller, name)
    elsewhere.configure(PluginContext(problem=problem(start=Pose2(0.1, 0.0, 0.0))))
    elsewhere.set_path(plan.trajectory)  # a robot that moves is planned for anew from where it is


def test_a_simulation_names_a_mismatch(caplog):
    task = problem()
    plan = plan_dock(task, time_budget=2.0)

    def run(robot, obstacles=None):
        controller, checker = create_plugin(Controller, "TrackingController"), _Done()
        return run_closed_loop(
            plan.trajectory, robot, GOAL, controller, checker, SimulationSettings(obstacles=obstacles, timeout=0.1)
        )

    assert run(task.robot, task.all_obstacles).differs == ()
    assert run(Robot(Footprint.rectangle(0.5, 0.5, 0.4), LIMITS), POLYGON).differs == ("footprint", "obstacles")
    assert "another footprint and obstacles than the trajectory was certified for" in caplog.text


class _Done:
    name, tolerances = "done", None

    def reset(self):
        pass

    def is_goal_reached(self, *_):
        return True
