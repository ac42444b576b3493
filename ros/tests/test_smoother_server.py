"""`smoother_server` as a process: all results and error codes of Nav2's action."""

from __future__ import annotations

import math
import signal
import time
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from action_msgs.msg import GoalStatus
from geometry_msgs.msg import TransformStamped
from hall import CELLS, ORIGIN, OUTLINE, RESOLUTION, Surroundings, hall, message, raw_path
from harness import Lifecycle, flattened
from nav2_msgs.action import SmoothPath
from nav_msgs.msg import Path as PathMessage
from optdock_ros.smoother_server import SmootherServer, SmoothingTask
from rcl_interfaces.srv import GetParameters, ListParameters, SetParametersAtomically
from rclpy.lifecycle import TransitionCallbackReturn
from rclpy.parameter import Parameter
from tf2_msgs.msg import TFMessage

from optdock import ros
from optdock.errors import SmootherException
from optdock.geometry.pose import Pose2
from optdock.model.costmap import Costmap as Grid
from optdock.model.costs import LETHAL
from optdock.model.path import Path
from optdock.plugins.outcomes import SmoothingResult

if TYPE_CHECKING:
    from collections.abc import Callable

    from harness import Client, Goal, Process, Processes

SIMPLE = "nav2_smoother::SimpleSmoother"
# Sweeps so small that they come to nothing within hours.
SLOW = {
    "plugin": SIMPLE,
    "w_data": 0.0,
    "w_smooth": 1e-4,
    "tolerance": 1e-300,
    "max_its": 1_000_000_000,
    "do_refinement": False,
}
PLUGINS = {
    "smoother_plugins": ["simple", "casadi", "savitzky_golay", "slow"],
    "simple": {"plugin": SIMPLE},
    "casadi": {"plugin": "CasadiSmoother"},
    "savitzky_golay": {"plugin": "nav2_smoother::SavitzkyGolaySmoother"},
    "slow": SLOW,
    "costmap_timeout": 5.0,
    "transform_tolerance": 1.0,  # these tests share their cores with others
}
NODE = "/smoother_server"
MIDDLE = CELLS // 2


@pytest.fixture(scope="module")
def world(client_node: Client) -> Surroundings:
    return Surroundings(client_node)


@pytest.fixture(scope="module")
def server(
    module_process: Processes, lifecycle: Callable[[str], Lifecycle], client_node: Client, world: Surroundings
) -> Process:
    started = module_process("smoother_server", PLUGINS)
    lifecycle("smoother_server").up()
    publisher = world._costmap
    client_node.until(lambda: publisher.get_subscription_count() and world._footprint.get_subscription_count())
    return started


@pytest.fixture
def fresh(server: Process, world: Surroundings) -> Surroundings:  # noqa: ARG001 - who hears it
    """Publish a new costmap and outline."""
    world.costmap()
    world.footprint()
    time.sleep(0.1)
    return world


def goal_of(
    path: PathMessage | None = None, smoother: str = "simple", seconds: float = 3.0, *, check: bool = False
) -> SmoothPath.Goal:
    goal = SmoothPath.Goal(path=message(raw_path()) if path is None else path, smoother_id=smoother)
    goal.check_for_collisions = check
    goal.max_smoothing_duration.sec, goal.max_smoothing_duration.nanosec = int(seconds), int(seconds % 1.0 * 1e9)
    return goal


def send(client: Client, *args: Any, **kwargs: Any) -> Goal:
    return client.send(SmoothPath, "smooth_path", goal_of(*args, **kwargs))


def roughness(poses: np.ndarray) -> float:
    """Return the mean change of direction between steps [rad]."""
    travel = np.arctan2(*np.diff(poses[:, :2], axis=0).T[::-1])
    return float(np.abs(np.angle(np.exp(1j * np.diff(travel)))).mean())


@pytest.mark.parametrize("smoother", ["simple", "casadi", "savitzky_golay"])
@pytest.mark.usefixtures("fresh")
def test_smooths_a_path(client_node: Client, smoother: str) -> None:
    heard = client_node.heard(PathMessage, "plan_smoothed")
    client_node.until(lambda: client_node.count_publishers("plan_smoothed"))
    reply = send(client_node, smoother=smoother, check=True).reply()
    assert reply.result.error_code == SmoothPath.Result.NONE, reply.result.error_msg
    assert reply.status == GoalStatus.STATUS_SUCCEEDED
    assert reply.result.was_completed
    duration = reply.result.smoothing_duration
    assert 0.0 < duration.sec + 1e-9 * duration.nanosec < 5.0
    raw, smooth = raw_path(), ros.path_poses(reply.result.path)
    assert smooth.frame == "map"
    assert roughness(smooth.poses) < 0.5 * roughness(raw)
    assert np.abs(smooth.poses[[0, -1], :2] - raw[[0, -1], :2]).max() < 1e-6
    client_node.until(lambda: heard, what="plan_smoothed")
    assert len(heard[-1].poses) == len(reply.result.path.poses)


def test_path_in_another_frame_is_returned_in_it(fresh: Surroundings, client_node: Client) -> None:
    seen = Pose2(1.0, -2.0, 0.7)
    fresh.transform("map", "odom", seen)
    time.sleep(0.05)
    fresh.transform("map", "odom", seen)
    time.sleep(0.02)
    back = np.array([(seen.inverse() @ Pose2(*row)).as_array() for row in raw_path()])
    there = send(client_node, message(back, "odom"), "casadi", check=True).reply()
    assert there.result.error_code == 0, there.result.error_msg
    assert there.result.path.header.frame_id == "odom"
    here = send(client_node, smoother="casadi", check=True).reply()
    poses, other = ros.path_poses(here.result.path).poses, ros.path_poses(there.result.path).poses
    again = np.array([(seen @ Pose2(*row)).as_array() for row in other])
    assert again.shape == poses.shape
    assert np.abs(again[:, :2] - poses[:, :2]).max() < 1e-3


def test_tilted_frame_there_and_back(fresh: Surroundings, client_node: Client) -> None:
    """Its plane differs from that of its inverse by 50 mm at a height of 1 m and an angle of 0.05 rad."""
    seen = TransformStamped(child_frame_id="leaning")
    seen.header.frame_id, seen.transform.translation.z = "map", 1.0
    seen.transform.rotation.x, seen.transform.rotation.w = math.sin(0.025), math.cos(0.025)
    fresh._static.publish(TFMessage(transforms=[seen]))
    time.sleep(0.1)
    reply = send(client_node, message(raw_path(), "leaning")).reply()
    assert reply.result.error_code == 0, reply.result.error_msg
    poses = ros.path_poses(reply.result.path).poses
    assert np.abs(poses[[0, -1], :2] - raw_path()[[0, -1], :2]).max() < 1e-9


def refused(client: Client, code: int, words: str, *args: Any, **kwargs: Any) -> None:
    reply = send(client, *args, **kwargs).reply()
    assert (reply.result.error_code, reply.status) == (code, GoalStatus.STATUS_ABORTED), reply.result.error_msg
    assert words in reply.result.error_msg
    assert not reply.result.was_completed


@pytest.mark.usefixtures("fresh")
def test_unknown_frame(client_node: Client) -> None:
    elsewhere = message(raw_path(), "nowhere")
    refused(client_node, SmoothPath.Result.UNKNOWN, "there is no transform of 'nowhere'", elsewhere)


@pytest.mark.parametrize(("age", "words"), [(10.0, "s old"), (-30.0, "s into the future")])
def test_stale_costmap(fresh: Surroundings, client_node: Client, age: float, words: str) -> None:
    fresh.costmap(age=age)
    time.sleep(0.1)
    refused(client_node, SmoothPath.Result.UNKNOWN, f"{words}, more than costmap_timeout = 5 s")


@pytest.mark.parametrize("asked", ["nobody", ""])
@pytest.mark.usefixtures("fresh")
def test_wrong_smoother(client_node: Client, asked: str) -> None:
    refused(client_node, SmoothPath.Result.INVALID_SMOOTHER, "available: simple, casadi", smoother=asked)


@pytest.mark.parametrize("smoother", ["simple", "casadi"])
@pytest.mark.usefixtures("fresh")
def test_duration_of_zero(client_node: Client, smoother: str) -> None:
    refused(client_node, SmoothPath.Result.TIMEOUT, "", smoother=smoother, seconds=0.0)


@pytest.mark.usefixtures("fresh")
def test_intermediate_result_after_a_short_duration(client_node: Client) -> None:
    reply = send(client_node, smoother="slow", seconds=0.1).reply()
    assert reply.status == GoalStatus.STATUS_SUCCEEDED
    assert reply.result.error_code == 0
    assert not reply.result.was_completed
    assert len(reply.result.path.poses) == 200


def test_collision_with_an_update_of_the_costmap(fresh: Surroundings, client_node: Client) -> None:
    fresh.update(MIDDLE - 3, MIDDLE - 3, np.full((6, 6), LETHAL))
    time.sleep(0.1)
    refused(client_node, SmoothPath.Result.SMOOTHED_PATH_IN_COLLISION, "Smoothed Path collided at X", check=True)
    assert send(client_node, check=False).reply().result.error_code == 0


def boxed(low: int, high: int) -> Grid:
    """Return the hall with a box on the path, between two rows of cells relative to the middle."""
    data = np.array(hall().data)
    data[MIDDLE + low : MIDDLE + high, MIDDLE - 3 : MIDDLE + 3] = LETHAL
    return Grid(data, RESOLUTION, ORIGIN)


def test_a_certified_path_within_a_cell_of_something(fresh: Surroundings, client_node: Client) -> None:
    """Nav2's check uses whole cells, and may reject a certified path; the message says how to avoid that."""
    codes = []
    for low, high in ((-2, 3), (-2, 2), (-1, 2)):  # which cells the path touches depends on the box
        fresh.costmap(boxed(low, high))
        time.sleep(0.1)
        first = send(client_node, smoother="casadi", check=True).reply().result
        assert set_atomically(client_node, casadi__clearance=1.5 * RESOLUTION).successful
        found = send(client_node, smoother="casadi", check=True).reply().result
        assert set_atomically(client_node, casadi__clearance=0.0).successful
        codes.append((first.error_code, found.error_code))
        if first.error_code == SmoothPath.Result.SMOOTHED_PATH_IN_COLLISION:
            assert "its certified clearance is" in first.error_msg
    assert (SmoothPath.Result.SMOOTHED_PATH_IN_COLLISION, 0) in codes


def test_no_path_keeps_the_bounds(fresh: Surroundings, client_node: Client) -> None:
    """The certifying smoother has no result with a wall across the lane."""
    data = np.array(hall().data)
    data[:, MIDDLE : MIDDLE + 4] = LETHAL
    fresh.costmap(Grid(data, RESOLUTION, ORIGIN))
    time.sleep(0.1)
    refused(client_node, SmoothPath.Result.FAILED_TO_SMOOTH_PATH, "", smoother="casadi")


def broken(field: str, value: float) -> PathMessage:
    path = message(raw_path())
    parts = field.split(".")
    place = path.poses[7].pose
    for part in parts[:-1]:
        place = getattr(place, part)
    setattr(place, parts[-1], value)
    return path


@pytest.mark.parametrize(
    ("path", "words"),
    [
        (PathMessage(), "no poses"),
        (message(raw_path()[:1]), "at least 2 distinct poses"),
        (broken("position.x", math.nan), "poses[7].pose.position.x: must be finite"),
        (broken("orientation.w", 3.0), "poses[7].pose.orientation: must be of length 1"),
        (broken("orientation.x", 1.0), "poses[7].pose.orientation"),
    ],
)
@pytest.mark.usefixtures("fresh")
def test_invalid_path(client_node: Client, path: PathMessage, words: str) -> None:
    refused(client_node, SmoothPath.Result.INVALID_PATH, words, path)


@pytest.mark.usefixtures("fresh")
def test_path_without_headings(client_node: Client) -> None:
    """Nav2's grid planners leave the identity in all poses but the last one."""
    poses = raw_path()[::-1].copy()
    poses[:-1, 2], poses[-1, 2] = 0.0, math.pi + poses[-1, 2]
    reply = send(client_node, message(poses), "casadi", check=True).reply()
    assert reply.result.error_code == 0, reply.result.error_msg
    found = ros.path_poses(reply.result.path).poses
    assert np.cos(found[1:-1, 2]).max() < 0.0


@pytest.mark.usefixtures("fresh")
def test_preempt_and_cancel(client_node: Client) -> None:
    preempted = send(client_node, smoother="slow", seconds=30.0)
    running = send(client_node, smoother="slow", seconds=30.0)
    reply = preempted.reply(timeout=5.0)
    assert (reply.status, reply.result.error_code) == (GoalStatus.STATUS_ABORTED, 0)
    assert "newer goal" in reply.result.error_msg
    time.sleep(0.05)
    answer = running.cancel()
    assert len(answer.goals_canceling) == 1
    reply = running.reply(timeout=5.0)
    assert reply.status == GoalStatus.STATUS_CANCELED
    assert "cancelled" in reply.result.error_msg


def set_atomically(client: Client, **values: object) -> Any:
    parameters = [Parameter(name.replace("__", "."), value=value).to_parameter_msg() for name, value in values.items()]
    request = SetParametersAtomically.Request(parameters=parameters)
    return client.call(SetParametersAtomically, f"{NODE}/set_parameters_atomically", request).result


def value_of(client: Client, name: str) -> float:
    values = client.call(GetParameters, f"{NODE}/get_parameters", GetParameters.Request(names=[name])).values
    return float(values[0].double_value)


@pytest.mark.usefixtures("fresh")
def test_parameters_change_together_or_not_at_all_during_a_goal(client_node: Client) -> None:
    running = send(client_node, smoother="slow", seconds=30.0)
    refusals = {
        "must be < 2": {"simple__w_data": 0.5, "simple__w_smooth": 0.9},
        "must be a number": {"simple__w_data": 0.5, "simple__max_its": "many"},
        "unknown parameter; did you mean": {"simple__w_data": 0.5, "costmap_timeot": 2.0},
        "cannot be changed while configured": {"simple__w_data": 0.5, "costmap_topic": "other"},
        "unknown key; did you mean max_curvature": {"simple__w_data": 0.5, "robot__limits__max_curvatur": 2.0},
    }
    for words, values in refusals.items():
        result = set_atomically(client_node, **values)
        assert not result.successful
        assert words in result.reason
        assert value_of(client_node, "simple.w_data") == 0.2
    assert set_atomically(client_node, simple__w_data=0.9, simple__w_smooth=0.05).successful
    assert not running.is_done
    running.cancel()
    weak = ros.path_poses(send(client_node).reply().result.path).poses
    assert set_atomically(client_node, simple__w_data=0.2, simple__w_smooth=0.3).successful
    strong = ros.path_poses(send(client_node).reply().result.path).poses
    assert roughness(strong) < 0.7 * roughness(weak)


@pytest.mark.usefixtures("server")
def test_parameters_are_listed_with_their_defaults(client_node: Client) -> None:
    names = client_node.call(ListParameters, f"{NODE}/list_parameters").result.names
    wanted = {"transform_tolerance", "footprint_topic", "simple.refinement_num", "casadi.max_curvature"}
    assert wanted <= set(names)


def test_inactive_server_rejects_goals_and_deactivation_ends_them(
    fresh: Surroundings, client_node: Client, lifecycle: Callable[[str], Lifecycle]
) -> None:
    running, node = send(client_node, smoother="slow", seconds=30.0), lifecycle("smoother_server")
    assert node.deactivate()
    reply = running.reply()
    assert reply.status == GoalStatus.STATUS_ABORTED
    assert "deactivated" in reply.result.error_msg
    assert not send(client_node).is_accepted
    assert node.cleanup()
    assert node.state == "unconfigured"
    node.up()
    client_node.until(fresh._footprint.get_subscription_count)
    fresh.costmap()
    fresh.footprint()
    time.sleep(0.1)
    assert send(client_node, check=True).reply().result.error_code == 0


def test_limits_and_clearance_of_the_robot(process: Processes, client_node: Client, world: Surroundings) -> None:
    """Results keep the limits of `robot` and `clearance`; the only smoother needs no name."""
    outline = str(OUTLINE.vertices.tolist())
    parameters = {
        "autostart": True,
        "smoother_plugins": ["only"],
        "only": {"plugin": "nav2_constrained_smoother::ConstrainedSmoother", "w_curve": 30.0},
        "robot": {"footprint": outline, "limits": {"max_curvature": 1, "max_curvature_rate": 4.0}},
        "clearance": {"required": 0.1},
        "footprint_topic": "",
        "costmap_topic": "/global_costmap/costmap_raw",
    }
    # Jazzy cannot remap the name of an action.
    started = process("smoother_server", parameters, args=["-r", "__ns:=/second"])
    started.wait_for("[second.smoother_server]: active")
    world.costmap()

    def _reply() -> Any:
        found = client_node.send(SmoothPath, "second/smooth_path", goal_of(smoother="", check=True)).reply()
        return None if "no costmap yet" in found.result.error_msg else found

    reply = client_node.until(_reply, what="a costmap")
    assert reply.result.error_code == 0, reply.result.error_msg
    poses = ros.path_poses(reply.result.path).poses
    steps = np.hypot(*np.diff(poses[:, :2], axis=0).T)
    assert np.abs(np.diff(np.unwrap(poses[:, 2])) / steps).max() < 1.01
    assert "not read: w_curve" in started.log()
    running = client_node.send(SmoothPath, "second/smooth_path", goal_of(smoother=""))
    began = time.monotonic()
    assert started.stop(signal.SIGTERM) == 0
    assert time.monotonic() - began < 5.0
    del running


def test_interrupt_answers_the_active_goal(process: Processes, client_node: Client) -> None:
    parameters = {"smoother_plugins": ["slow"], "slow": SLOW, "autostart_node": True, "costmap_topic": ""}
    started = process("smoother_server", parameters, args=["-r", "__ns:=/third"])
    started.wait_for("[third.smoother_server]: active")
    running = client_node.send(SmoothPath, "third/smooth_path", goal_of(smoother="", seconds=60.0))
    time.sleep(0.2)  # until it is asked for its result
    assert started.stop(signal.SIGINT) == 0
    reply = running.reply()
    assert reply.status == GoalStatus.STATUS_ABORTED
    assert "Traceback" not in started.log()


@pytest.mark.parametrize(
    ("parameters", "words"),
    [
        (
            {"smoother_plugins": ["ceres"], "ceres": {"plugin": "foo::CeresSmoother"}},
            ["Failed to create smoother ceres of type foo::CeresSmoother: not provided: optdock has no"],
        ),
        ({"smoother_plugins": ["a"], "a": {"x": 1}}, ["a.plugin: is required: smoother_plugins lists a"]),
        ({"smoother_plugins": []}, ["smoother_plugins: must name at least one plugin"]),
        (
            {"smoother_plugins": ["a"], "a": {"plugin": "CasadiSmoother", "max_curvatur": 1.0, "spans": 1}},
            ["a.spans", "a.max_curvatur: unknown parameter; did you mean max_curvature?"],
        ),
        (
            {
                "transform_tolerance": -1.0,
                "robot": {"radius": -1.0},
                "clearance": {"required": "x"},
                "footprint_topik": "x",
            },
            ["transform_tolerance", "robot.radius", "clearance.required", "did you mean footprint_topic?"],
        ),
    ],
)
def test_configure_names_every_fault(context: None, parameters: dict[str, object], words: list[str]) -> None:  # noqa: ARG001
    overrides = [Parameter(name, value=value or None) for name, value in flattened(parameters).items()]
    node = SmootherServer("faulty", parameter_overrides=overrides)
    said: list[str] = []
    node.log_error = lambda error, what: said.append(f"{what}: {error}")  # type: ignore[method-assign]
    try:
        assert node.trigger_configure() == TransitionCallbackReturn.FAILURE
        for word in ["configure failed", *words]:
            assert word in said[0]
    finally:
        node.destroy_node()


def test_nav2_stock_parameters(context: None) -> None:  # noqa: ARG001
    """Two smoothers of Nav2's class with Nav2's parameters, and the parameters of every Nav2 node."""
    block = {"plugin": SIMPLE, "tolerance": 1.0e-10, "max_its": 1000, "do_refinement": True}
    parameters = {
        "smoother_plugins": ["simple_smoother", "route_smoother"],
        "simple_smoother": {**block, "refinement_num": 2, "enforce_path_inversion": True},
        "route_smoother": {**block, "refinement_num": 5, "enforce_path_inversion": False},
        "use_sim_time": False,
        "bond_heartbeat_period": 0.1,
        "introspection_mode": "disabled",
    }
    overrides = [Parameter(name, value=value) for name, value in flattened(parameters).items()]
    node = SmootherServer("stock", namespace="stock", parameter_overrides=overrides)
    try:
        assert node.trigger_configure() == TransitionCallbackReturn.SUCCESS
        assert node.trigger_activate() == TransitionCallbackReturn.SUCCESS
        assert {name: one.not_read for name, one in node.settings.plugins.items()} == {
            "simple_smoother": (),
            "route_smoother": (),
        }
        node.end()
    finally:
        node.destroy_node()


def test_class_of_a_plugin_can_change_after_cleanup(context: None) -> None:  # noqa: ARG001
    """Parameters of the previous class are not unknown parameters of the new one."""
    parameters = {"smoother_plugins": ["one"], "one.plugin": SIMPLE, "one.tolerance": 1e-6}
    overrides = [Parameter(name, value=value) for name, value in parameters.items()]
    node = SmootherServer("swapped", namespace="swapped", parameter_overrides=overrides)
    try:
        assert node.trigger_configure() == TransitionCallbackReturn.SUCCESS
        assert node.has_parameter("one.w_data")
        assert node.trigger_cleanup() == TransitionCallbackReturn.SUCCESS
        assert node.has_parameter("one.tolerance")
        change = [Parameter("one.plugin", value="CasadiSmoother"), Parameter("one.tolerance")]
        assert node.set_parameters_atomically(change).successful
        assert node.trigger_configure() == TransitionCallbackReturn.SUCCESS
        assert node.has_parameter("one.clearance")
        node.end()
    finally:
        node.destroy_node()


@pytest.mark.parametrize(
    ("answer", "words"),
    [
        (lambda _: None, "returned no smoothed path"),
        (lambda path: path, "returned no smoothed path"),
        (lambda path: SmoothingResult(Path(path.segments, "elsewhere")), "returned a path in 'elsewhere'"),
        (lambda path: SmoothingResult(Path.from_poses(path.poses[:-5], "map")), r"ends 0\.\d+ m off"),
    ],
)
def test_invalid_results_of_smoothers(answer: Callable[[Any], Any], words: str) -> None:
    path = Path.from_poses(raw_path(), "map")
    poses = SimpleNamespace(segments=path.segments, poses=raw_path())
    task = SmoothingTask(path, None, None, None, None, "map", Pose2(0.0, 0.0, 0.0), 0.05)
    with pytest.raises(SmootherException, match=words):
        task.check_answer(answer(poses), "odd")
    task.check_answer(SmoothingResult(path), "even")
