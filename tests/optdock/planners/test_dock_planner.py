import dataclasses
import math

import numpy as np
import pytest

from optdock.errors import (
    InvalidValue,
    LifecycleError,
    NoValidPathCouldBeFound,
    PlannerCancelled,
    PlannerException,
    StartOutsideMapBounds,
)
from optdock.geometry.footprint import Footprint
from optdock.geometry.obstacles import ObstacleSet
from optdock.geometry.pose import Pose2
from optdock.model.costmap import Costmap
from optdock.model.dock import Dock, DockDirection
from optdock.model.limits import MotionLimits
from optdock.model.path import Direction
from optdock.model.problem import DockingProblem
from optdock.model.robot import Robot
from optdock.planners.dock_planner import DockPlanner, DockPlannerParameters
from optdock.plugins.interfaces import GlobalPlanner, LifecycleState, PluginContext
from optdock.plugins.registry import create_plugin

ROBOT = Footprint.rectangle(front=0.4, rear=0.4, width=0.6)
DOCK = "[[0.5, -0.4], [0.7, -0.4], [0.7, 0.4], [0.5, 0.4]]"
START, GOAL = Pose2(-4.0, 0.6, 0.2), Pose2(0.0, 0.0, 0.0)


def configured(context=None, **parameters):
    planner = DockPlanner(**parameters)
    planner.configure(context or PluginContext(name="dock", footprint=ROBOT))
    return planner


def problem(direction=DockDirection.AUTO, footprint=None):
    dock = Dock(GOAL, footprint=footprint, direction=direction)
    return DockingProblem(start=START, dock=dock, robot=Robot(ROBOT, MotionLimits()))


def test_defaults_are_those_of_the_source():
    assert DockPlannerParameters().model_dump() == {
        "cost_threshold": 200,
        "calib_safety_distance": 0.0,
        "check_free_space": False,
        "degree": 2,
        "step": 0.02,
        "footprint_dock": None,
        "alpha": 1.0,
        "beta": 0.5,
        "gamma": 0.667,
        "direction": DockDirection.AUTO,
        "resolution": 0.05,
    }


def test_entry_point_gives_this_planner():
    assert type(create_plugin(GlobalPlanner, "DockPlanner", {"footprint_dock": DOCK})).__name__ == "DockPlanner"


def test_configured_planner_plans():
    path = configured(footprint_dock=DOCK).create_plan(START, GOAL)
    assert path.start == START
    assert path.end == GOAL
    assert path.cusps == ()


def test_planning_before_configuring_raises_a_lifecycle_error():
    with pytest.raises(LifecycleError, match=r"cannot plan when unconfigured; call configure\(") as caught:
        DockPlanner(footprint_dock=DOCK).create_plan(START, GOAL)
    assert not isinstance(caught.value, PlannerException)


def test_planning_after_cleanup_or_shutdown_is_refused():
    planner = configured()
    planner.cleanup()
    with pytest.raises(LifecycleError, match="when unconfigured"):
        planner.create_plan(START, GOAL)
    planner.configure(PluginContext(footprint=ROBOT))
    planner.shutdown()
    with pytest.raises(LifecycleError, match="when finalized"):
        planner.create_plan(START, GOAL)
    with pytest.raises(LifecycleError, match="cannot configure when finalized"):
        planner.configure(PluginContext(footprint=ROBOT))


def test_configuring_again_is_refused():
    planner = configured()
    other = PluginContext(footprint=ROBOT, costmap=Costmap(np.zeros((4, 4), dtype=np.uint8), 0.1))
    with pytest.raises(LifecycleError, match="cannot configure when inactive"):
        planner.configure(other)
    planner.cleanup()
    planner.configure(other)
    assert planner.context is other


def test_context_without_a_robot_is_refused():
    planner = DockPlanner()
    with pytest.raises(InvalidValue, match="needs the robot's footprint"):
        planner.configure(PluginContext())
    assert planner.state is LifecycleState.UNCONFIGURED


@pytest.mark.parametrize(
    "outline", [DOCK, [[0.5, -0.4], [0.7, -0.4], [0.7, 0.4], [0.5, 0.4]], ((0.5, -0.4), (0.7, -0.4), (0.5, 0.4))]
)
def test_dock_outline_is_taken_as_string_or_points(outline):
    plan = configured(footprint_dock=outline).plan(START, GOAL)
    assert plan.axis.distance_min_c == pytest.approx(0.5 * (0.8 + 0.2))


def test_dock_without_outline_has_no_length():
    assert configured(footprint_dock=None).plan(START, GOAL).axis.distance_min_c == pytest.approx(0.4)


def test_problem_supplies_parameters_that_are_not_set():
    context = PluginContext(problem=problem(DockDirection.FORWARD, Footprint.from_string(DOCK)))
    planner = configured(context)
    assert planner.plan(START, GOAL).axis.distance_min_c == pytest.approx(0.5)
    with pytest.raises(NoValidPathCouldBeFound, match="direction is forward"):
        planner.create_plan(Pose2(4.0, 0.6, 0.0), GOAL)
    told = configured(context, direction="backward", footprint_dock="[[0, 0], [0.4, 0], [0.4, 1]]")
    backward = told.plan(Pose2(4.0, 0.6, 0.0), GOAL)
    assert backward.axis.direction is Direction.REVERSE
    assert backward.axis.distance_min_c == pytest.approx(0.6)


def test_context_with_two_footprints_is_refused():
    with pytest.raises(InvalidValue, match=r"context\.footprint: differs from context\.problem\.robot\.footprint"):
        PluginContext(footprint=Footprint.from_radius(1.0), problem=problem())


def test_costmap_of_the_context_is_checked_where_asked():
    blocked = Costmap(np.full((10, 10), 254, dtype=np.uint8), 0.1, (-0.5, -0.5))
    context = PluginContext(footprint=ROBOT, costmap=blocked)
    assert configured(context).create_plan(START, GOAL).end == GOAL
    with pytest.raises(StartOutsideMapBounds, match="the start .* is outside the map"):
        configured(context, check_free_space=True).create_plan(START, GOAL)


def test_check_of_free_space_without_a_map_is_refused():
    for context in (PluginContext(footprint=ROBOT), PluginContext(problem=problem())):
        with pytest.raises(PlannerException, match="check_free_space is true, but there is no costmap"):
            configured(context, check_free_space=True).create_plan(START, GOAL)


def test_problems_obstacles_are_checked_with_its_costmap():
    free = Costmap(np.zeros((200, 200), dtype=np.uint8), 0.1, (-10.0, -10.0))
    middle = configured(PluginContext(problem=problem(), costmap=free)).create_plan(START, GOAL).pose_at(0.5)
    rock = [[middle.x + dx, middle.y + dy] for dx, dy in ((-0.2, -0.2), (0.2, -0.2), (0.2, 0.2), (-0.2, 0.2))]
    blocked = dataclasses.replace(problem(), obstacles=ObstacleSet.from_polygons([rock]))
    context = PluginContext(problem=blocked, costmap=free)
    assert configured(context).create_plan(START, GOAL).end == GOAL  # by default nothing is checked
    with pytest.raises(NoValidPathCouldBeFound, match=r"blocked at .* by obstacles\[0\]"):
        configured(context, check_free_space=True).create_plan(START, GOAL)
    assert configured(PluginContext(problem=problem(), costmap=free), check_free_space=True).create_plan(START, GOAL)


def test_changed_parameters_hold_from_the_next_plan_on():
    planner = configured()
    planner.set_parameters(direction="backward")
    with pytest.raises(NoValidPathCouldBeFound, match="direction is backward"):
        planner.create_plan(START, GOAL)
    planner.set_parameters(direction="auto", footprint_dock=DOCK)
    planner.set_parameters(resolution=0.01)
    assert planner.plan(START, GOAL).axis.distance_min_c == pytest.approx(0.5)


def test_cancelled_plan_raises_planner_cancelled():
    with pytest.raises(PlannerCancelled):
        configured().create_plan(START, GOAL, lambda: True)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"footprint_dok": DOCK}, "footprint_dok: unknown parameter; did you mean footprint_dock"),
        ({"cost_threshold": 256}, "cost_threshold: .* less than or equal to 255"),
        ({"cost_threshold": -1}, "cost_threshold"),
        ({"degree": 3}, "degree: .* less than or equal to 2"),
        ({"degree": 0}, "degree"),
        ({"step": 0.0}, "step: .* greater than 0"),
        ({"resolution": 0.0}, "resolution: .* greater than 0"),
        ({"resolution": math.nan}, "resolution"),
        ({"gamma": 1.0}, "gamma: .* less than 1"),
        ({"direction": "sideways"}, "direction: .*'auto'"),
        ({"footprint_dock": "[[0, 0], [1, 1]]"}, "footprint_dock: .* at least 3 distinct vertices, got 2"),
        ({"footprint_dock": "0, 0, 1, 1"}, "footprint_dock: .* must look like"),
        ({"footprint_dock": [[0, 0], [1, 1], [2, 2]]}, "footprint_dock: .* no area"),
        ({"footprint_dock": []}, "footprint_dock"),
        ({"footprint_dock": 3.0}, "footprint_dock"),
    ],
)
def test_bad_parameters_are_named(values, message):
    with pytest.raises(InvalidValue, match=message):
        DockPlanner(**values)
