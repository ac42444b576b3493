"""`planner_server` as a process: paths into a dock, and every refusal by Nav2's code."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from action_msgs.msg import GoalStatus
from hall import CELLS, ORIGIN, RESOLUTION, Surroundings
from nav2_msgs.action import ComputePathToPose
from nav_msgs.msg import Path as PathMessage
from nav_msgs.srv import GetPlan
from optdock_ros.nested_parameters import flattened
from optdock_ros.planner_server import PlannerServer
from rclpy.lifecycle import TransitionCallbackReturn
from rclpy.parameter import Parameter

from optdock import ros
from optdock.geometry.pose import Pose2
from optdock.model.costmap import Costmap as Grid
from optdock.model.costs import LETHAL

if TYPE_CHECKING:
    from collections.abc import Callable

    from harness import Client, Goal, Lifecycle, Process, Processes

PLUGINS = {
    "planner_plugins": ["dock", "manoeuvres"],
    "dock": {"plugin": "DockPlanner"},
    "manoeuvres": {"plugin": "ManoeuvrePlanner"},
    "robot": {"limits": {"max_curvature": 2.0}},
    "clearance": {"required": 0.05, "taper": 0.5},
    "costmap_timeout": 5.0,
    "transform_tolerance": 1.0,  # these tests share their cores with others
    "costmap_update_timeout": 0.3,
    "expected_planner_frequency": 20.0,
    "allow_partial_planning": False,
}
START, GOAL = Pose2(-2.0, 0.4, 0.0), Pose2(0.0, 0.0, 0.0)
CODES = ComputePathToPose.Result


def room() -> Grid:
    """Two boxes with the goal between them, and one in a corner."""
    data = np.zeros((CELLS, CELLS), dtype=np.uint8)
    for x, y in ((0.0, 1.0), (0.0, -1.0), (5.0, 5.0)):
        i, j = ((np.array((x, y)) - ORIGIN) / RESOLUTION).astype(int)
        data[j - 8 : j + 8, i - 8 : i + 8] = LETHAL
    return Grid(data, RESOLUTION, ORIGIN)


@pytest.fixture(scope="module")
def world(client_node: Client) -> Surroundings:
    return Surroundings(client_node)


@pytest.fixture(scope="module")
def server(
    module_process: Processes, module_lifecycle: Callable[[str], Lifecycle], client_node: Client, world: Surroundings
) -> Process:
    started = module_process("planner_server", PLUGINS)
    module_lifecycle("planner_server").up()
    client_node.until(lambda: world._costmap.get_subscription_count() and world._footprint.get_subscription_count())
    return started


@pytest.fixture
def fresh(server: Process, world: Surroundings) -> Surroundings:  # noqa: ARG001 - who hears it
    """A costmap, an outline and the robot's place, all new."""
    world.costmap(room())
    world.footprint()
    world.transform("map", "base_link", START)
    time.sleep(0.1)
    return world


def pose(at: Pose2, frame: str = "map") -> Any:
    return ros.pose_message(ros.imported, at, frame, 1.0)


def send(
    client: Client, goal: Pose2 = GOAL, start: Pose2 | None = START, planner: str = "manoeuvres", frame: str = "map"
) -> Goal:
    request = ComputePathToPose.Goal(goal=pose(goal, frame), planner_id=planner, use_start=start is not None)
    if start is not None:
        request.start = pose(start, frame)
    return client.send(ComputePathToPose, "compute_path_to_pose", request)


def planned(client: Client, *args: Any, **kwargs: Any) -> np.ndarray:
    reply = send(client, *args, **kwargs).reply()
    assert reply.result.error_code == 0, reply.result.error_msg
    assert reply.status == GoalStatus.STATUS_SUCCEEDED
    return ros.path_poses(reply.result.path).poses


def refused(client: Client, code: int, words: str, *args: Any, **kwargs: Any) -> None:
    reply = send(client, *args, **kwargs).reply()
    assert (reply.result.error_code, reply.status) == (code, GoalStatus.STATUS_ABORTED), reply.result.error_msg
    assert words in reply.result.error_msg
    assert not reply.result.path.poses


@pytest.mark.usefixtures("fresh")
@pytest.mark.parametrize("planner", ["dock", "manoeuvres"])
def test_plans_into_the_dock(client_node: Client, planner: str) -> None:
    heard = client_node.heard(PathMessage, "plan")
    client_node.until(lambda: client_node.count_publishers("plan"))
    poses = planned(client_node, planner=planner)
    assert np.abs(poses[0] - START.as_array()).max() < 1e-6
    assert np.abs(poses[-1] - GOAL.as_array()).max() < 1e-6
    client_node.until(lambda: heard, what="plan")


def test_starts_at_the_robot_and_the_goal_may_be_in_another_frame(fresh: Surroundings, client_node: Client) -> None:
    seen = Pose2(1.0, -1.0, 0.5)
    fresh.transform("map", "odom", seen)
    fresh.transform("map", "base_link", START)
    time.sleep(0.05)
    poses = planned(client_node, goal=seen.inverse() @ GOAL, start=None, frame="odom")
    assert np.abs(poses[[0, -1], :2] - [[START.x, START.y], [GOAL.x, GOAL.y]]).max() < 1e-6


@pytest.mark.usefixtures("fresh")
@pytest.mark.parametrize(
    ("code", "words", "asked"),
    [
        (CODES.INVALID_PLANNER, "available: dock, manoeuvres", {"planner": "GridBased"}),
        (CODES.INVALID_PLANNER, "available: dock, manoeuvres", {"planner": ""}),
        (CODES.TF_ERROR, "there is no transform of 'nowhere'", {"frame": "nowhere"}),
        (CODES.START_OUTSIDE_MAP, "Start (-30", {"start": Pose2(-30.0, 0.0, 0.0)}),
        (CODES.GOAL_OUTSIDE_MAP, "Goal (30", {"goal": Pose2(30.0, 0.0, 0.0)}),
        (CODES.START_OCCUPIED, "overlaps an obstacle", {"start": Pose2(5.0, 5.0, 0.0)}),
        (CODES.GOAL_OCCUPIED, "overlaps an obstacle", {"goal": Pose2(0.0, 0.9, 0.0)}),
        (CODES.NO_VALID_PATH, "dock planner", {"planner": "dock", "start": Pose2(-0.05, 0.0, 1.5)}),
    ],
)
def test_refusals(client_node: Client, code: int, words: str, asked: dict[str, Any]) -> None:
    refused(client_node, code, words, **asked)


def test_a_plan_through_a_wall_is_none(fresh: Surroundings, client_node: Client) -> None:
    """The dock planner's is raw: what lies between start and goal is a smoother's to go round."""
    data = np.array(room().data)
    column = CELLS // 2 - 20
    data[:, column : column + 2] = LETHAL
    fresh.costmap(Grid(data, RESOLUTION, ORIGIN))
    time.sleep(0.05)
    refused(client_node, CODES.NO_VALID_PATH, "dock: the footprint overlaps map at s = ", planner="dock")


def test_old_costmap(fresh: Surroundings, client_node: Client) -> None:
    fresh.costmap(room(), age=10.0)
    time.sleep(0.05)
    refused(client_node, CODES.TIMEOUT, "Costmap timed out waiting for update")


def test_robot_that_nobody_knows(fresh: Surroundings, client_node: Client) -> None:
    """Where the robot stood a while ago is not where it starts."""
    fresh.transform("map", "base_link", START)
    time.sleep(1.2)
    refused(client_node, CODES.TF_ERROR, "the newest of base_link is", start=None)


@pytest.mark.usefixtures("fresh")
def test_cancel_and_a_newer_goal(client_node: Client) -> None:
    """A search for a way that is not there takes its time."""
    far = {"start": Pose2(4.0, 4.9, 0.0), "goal": Pose2(-8.0, -8.0, 2.0)}
    goals = [send(client_node, **far) for _ in range(2)]
    goals[1].cancel()
    statuses = [goal.reply().status for goal in goals]
    ended = {GoalStatus.STATUS_ABORTED, GoalStatus.STATUS_SUCCEEDED}
    assert statuses[0] in ended
    assert statuses[1] in {GoalStatus.STATUS_CANCELED, GoalStatus.STATUS_SUCCEEDED}


def test_get_plan(process: Processes, client_node: Client, world: Surroundings) -> None:
    names = ["-r", "__node:=other", "-r", "get_plan:=other_plan", "-r", "compute_path_to_pose:=other_path"]
    only = {
        **PLUGINS,
        "planner_plugins": ["manoeuvres"],
        "robot": {"radius": 0.3},
        "autostart": True,
        "costmap_timeout": 0.0,
    }
    process("planner_server", only, args=names).wait_for("[other]: active")

    def _plan(start: Any) -> Any:
        world.costmap(room())
        world.transform("map", "base_link", START)
        request = GetPlan.Request(goal=pose(GOAL))
        if start is not None:
            request.start = start
        plan = client_node.call(GetPlan, "other_plan", request).plan
        return plan if plan.poses else None

    for start in (pose(START), None):
        plan = client_node.until(lambda start=start: _plan(start), what="a plan")
        assert plan.header.frame_id == "map"
        assert len(plan.poses) > 10
    nothing = client_node.call(GetPlan, "other_plan", GetPlan.Request(goal=pose(Pose2(30.0, 0.0, 0.0)))).plan
    assert not nothing.poses


def test_a_file_as_nav2_ships_it_is_refused_by_name(context: None) -> None:  # noqa: ARG001
    grid = {"plugin": "nav2_navfn_planner::NavfnPlanner", "tolerance": 0.5, "use_astar": False, "allow_unknown": True}
    parameters = {
        "planner_plugins": ["GridBased"],
        "GridBased": grid,
        "expected_planner_frequency": 20.0,
        "allow_partial_planning": False,
        "costmap_update_timeout": 1.0,
        "introspection_mode": "disabled",
    }
    overrides = [Parameter(name, value=value) for name, value in flattened(parameters).items()]
    node = PlannerServer("stock", namespace="stock", parameter_overrides=overrides)
    said: list[str] = []
    node.say = lambda error, what: said.append(f"{what}: {error}")  # type: ignore[method-assign]
    try:
        assert node.trigger_configure() == TransitionCallbackReturn.FAILURE
    finally:
        node.destroy_node()
    refused = "Failed to create planner GridBased of type nav2_navfn_planner::NavfnPlanner: not provided"
    assert said[0].startswith(f"configure failed: {refused}")
    assert len(said[0].splitlines()) == 1
