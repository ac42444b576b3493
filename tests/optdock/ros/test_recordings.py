"""Recordings: written ones are read by rosbags, and a recorded docking is checked by the certificate."""

import json
import math
import re
import sys
from pathlib import Path

import numpy as np
import pytest
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import StoragePlugin, Writer
from typer.testing import CliRunner

import optdock as od
from optdock import ros
from optdock.cli import app
from optdock.executor import Ending, EndingKind, Event, ExecutorSettings, State
from optdock.executor.log import LogWriter, Task
from optdock.executor.planning import DrivenMotion, Outcome, PlanResult
from optdock.executor.task_states import Feedback, FeedbackState, Step
from optdock.geometry.pose import transform_points
from optdock.io.plan_file import load_plan
from optdock.model.measurements import Detection, Measurements
from optdock.plugins.registry import PluginChoice
from optdock.ros.bag import BagMessage, bag_types, write_bag
from optdock.ros.field import kept_poses

FOOTPRINT = od.Footprint.rectangle(0.3, 0.3, 0.4)
BEGIN = 1_700_000_000.0  # [s]: a present time, with microseconds in a float


@pytest.fixture(autouse=True)
def in_empty_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def run(*arguments):
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


def recorded(source):
    """Everything in a recording: by topic the times of reception [s] and the messages."""
    found = {}
    with AnyReader([Path(source)]) as reader:
        for connection, time, data in reader.messages():
            message = reader.deserialize(data, connection.msgtype)
            found.setdefault(connection.topic, []).append((1e-9 * time, message))
    return found


@pytest.fixture(scope="module")
def planned(tmp_path_factory):
    """A plan with its scenario, a run of it, and the log of a docking by it."""
    folder = tmp_path_factory.mktemp("planned")
    (folder / "bay.yaml").write_text(
        "format: optdock-scenario/1\nobstacles:\n- [[-0.7, -0.2], [-0.65, -0.2], [-0.65, 0.2], [-0.7, 0.2]]\n"
        "- [[0.5, 0.6], [1.5, 0.6], [1.5, 0.8], [0.5, 0.8]]\n"
        "robot: {footprint: [[0.3, 0.2], [-0.3, 0.2], [-0.3, -0.2], [0.3, -0.2]], limits: {max_curvature: 2.0}}\n"
        "dock: {pose: [2.0, 0.2, 0.0]}\nstart: {pose: [0.0, 0.0, 0.0]}\n"
    )
    problem = od.load_scenario(folder / "bay.yaml").problem
    plan = od.plan_dock(problem, time_budget=2.0)
    plan.save(folder / "plan.json", period=0.1)
    motion = plan.trajectory.sampled(0.1)
    columns = {"t": motion.t}
    for of in ("", "measured_", "planned_"):
        columns |= {f"{of}{part}": motion.poses[:, k] for k, part in enumerate(("x", "y", "yaw"))}
    for of in ("", "command_"):
        columns |= {f"{of}{part}": motion.twists[:, k] for k, part in enumerate(("speed", "yaw_rate"))}
    run_file = {"format": "optdock-run/1", "docked": False, "reason": "timeout: of 1 s"}
    run_file["columns"] = {name: column.tolist() for name, column in columns.items()}
    (folder / "run.json").write_text(json.dumps(run_file))
    with LogWriter(folder / "dock.log") as log:
        choice = PluginChoice("TrackingController"), PluginChoice("DockGoalChecker")
        log.begin(Task(problem, ExecutorSettings(), "dock", *choice))
        log.planned(PlanResult(1, Outcome.NEW, DrivenMotion.of(plan)), "map")
        seen = (Detection(0.95, od.Pose2(2.0, 0.2, 0.0), 0.01, 0.01),)
        grid = od.Costmap(np.zeros((3, 4), dtype=np.uint8), 0.1)
        measured = Measurements(1.0, od.Pose2(0.0, 0.0, 0.0), od.Twist2(0.1), seen, costmap=grid)
        feedback = Feedback(FeedbackState.CONTROLLING, 0, 2.0, 0.0)
        log.cycle(measured, Step(od.Twist2(0.2, 0.1), State.APPROACHING, feedback, None, (Event(1.0, "planned"),)))
        ending = Ending(EndingKind.TIMEOUT, "too late", 2, 1.05)
        log.cycle(Measurements(1.05, None), Step(od.Twist2(), State.ENDED, feedback, ending, ()))
    return folder, plan


@pytest.mark.parametrize("out", ["plan.mcap", "a folder"])
def test_a_plan_is_recorded_with_its_true_times(planned, out):
    folder, plan = planned
    result = run("bag", folder / "plan.json", out, "--scenario", folder / "bay.yaml", "--start", BEGIN)
    assert (result.exit_code, result.stderr) == (0, "")
    found = recorded(out)
    assert set(found) == {"/plan", "/docking_trajectory", "/markers", "/diagnostics", "/odom", "/tf", "/cmd_vel"}
    motion = load_plan(folder / "plan.json").trajectory
    assert len(found["/odom"]) == len(found["/tf"]) == len(found["/cmd_vel"]) == motion.t.size
    for k in (0, motion.t.size // 2, -1):
        received, message = found["/odom"][k]
        one = ros.odometry(message)
        assert (received, one.stamp) == pytest.approx((BEGIN + motion.t[k],) * 2, abs=1e-6)
        assert (one.frame, one.child_frame) == ("map", "base_link")
        assert (one.pose.x, one.pose.y, one.pose.yaw) == pytest.approx((motion.x[k], motion.y[k], motion.yaw[k]))
        command = ros.twist(found["/cmd_vel"][k][1])
        assert (command.twist.linear, command.twist.angular) == pytest.approx((motion.speed[k], motion.yaw_rate[k]))
        (transform,) = found["/tf"][k][1].transforms
        assert (transform.header.frame_id, transform.child_frame_id) == ("map", "base_link")
        assert transform.transform.translation.x == motion.x[k]
    ((_, path),) = found["/docking_trajectory"]
    assert ros.path_poses(path).poses[-1] == pytest.approx(plan.path.end.as_array())
    ((_, status),) = found["/diagnostics"]
    assert (status.status[0].message, status.status[0].level) == ("certified", 0)
    ((_, markers),) = found["/markers"]
    drawn = {(marker.ns, marker.id): marker for marker in markers.markers if marker.action == 0}
    assert set(drawn) == {
        ("path", 0),
        ("swept footprint", 0),
        ("goal", 0),
        ("goal", 1),
        *(("closest", k) for k in range(3)),
    }
    clearance = plan.certificate.min_clearance
    begin, end = (np.array([point.x, point.y]) for point in drawn["closest", 1].points)
    assert np.hypot(*(end - begin)) == pytest.approx(clearance, abs=2e-3)
    assert drawn["closest", 2].text == f"{1e3 * clearance:.0f} mm to obstacles[1]"
    corners = np.array([(point.x, point.y) for point in drawn["goal", 1].points])[::2]
    assert corners == pytest.approx(transform_points(plan.path.end.as_array()[None], FOOTPRINT.vertices)[0])


def test_without_the_scenario_outlines_are_deleted_and_the_path_is_shown(planned):
    folder, _ = planned
    assert run("bag", folder / "plan.json", "plan.mcap", "--unstamped", "--frame", "hall").exit_code == 0
    found = recorded("plan.mcap")
    assert {found[topic][0][1].header.frame_id for topic in ("/plan", "/docking_trajectory", "/odom")} == {"hall"}
    actions = {(one.ns, one.id): one.action for one in found["/markers"][0][1].markers}
    assert {name for name, action in actions.items() if action == 0} == {("path", 0), ("goal", 0)}
    assert set(actions.values()) == {0, 2}
    assert found["/cmd_vel"][0][1].__msgtype__ == "geometry_msgs/msg/Twist"


def test_markers_keep_gears_apart_and_all_can_be_deleted():
    path = od.Path.from_poses([(0, 0, 0), (1, 0, 0), (0.5, 0, 0)])
    markers = ros.path_markers(bag_types, path, "map", 1.0).markers
    points, colours = markers[0].points, markers[0].colors
    forward = {(colour.r, colour.g) for point, colour in zip(points, colours, strict=True) if point.x < 0.49}
    assert len(forward) == 1
    assert len({(colour.r, colour.g) for colour in colours}) == 2
    (delete,) = ros.delete_markers(bag_types, "map", 1.0).markers
    assert delete.action == 3
    with pytest.raises(od.InvalidValue, match="is in 'odom', not in 'map'"):
        ros.path_markers(bag_types, path.with_frame("odom"), "map", 1.0)


def test_a_run_is_recorded_with_true_measured_and_planned_poses(planned):
    folder, _ = planned
    assert run("bag", folder / "run.json", "run.mcap").exit_code == 0
    found = recorded("run.mcap")
    assert set(found) >= {"/odom", "/measured_pose", "/reference_pose", "/cmd_vel", "/docking_trajectory", "/tf"}
    count = len(json.loads((folder / "run.json").read_text())["columns"]["t"])
    assert {len(found[topic]) for topic in ("/odom", "/measured_pose", "/reference_pose", "/cmd_vel")} == {count}
    (status,) = found["/diagnostics"][-1][1].status
    assert (status.message, status.level) == ("not docked: timeout: of 1 s", 2)


def test_a_log_is_recorded_on_its_own_clock(planned):
    folder, plan = planned
    result = run("bag", folder / "dock.log", "log.mcap", "--start", "100")
    assert (result.exit_code, result.stderr) == (0, "")
    found = recorded("log.mcap")
    assert [time for time, _ in found["/cmd_vel"]] == pytest.approx([101.0, 101.05])
    assert [ros.twist(message).twist for _, message in found["/cmd_vel"]] == [od.Twist2(0.2, 0.1), od.Twist2()]
    ((_, odometry),) = found["/odom"]  # in the second cycle there was no pose
    assert ros.odometry(odometry).twist == od.Twist2(0.1)
    ((_, path),) = found["/docking_trajectory"]
    assert ros.path_poses(path).poses[-1] == pytest.approx(plan.path.end.as_array())
    ((_, seen),) = found["/detected_dock_pose"]
    assert ros.pose(seen) == ("base_link", 100.95, od.Pose2(2.0, 0.2, 0.0))
    assert ros.costmap(found["/local_costmap/costmap"][0][1]).costmap.data.shape == (3, 4)
    last = found["/diagnostics"][-1][1].status[0]
    values = {pair.key: pair.value for pair in last.values}
    assert (last.message, values["error code"], values["retries"]) == ("timeout", "907", "2")
    assert found["/markers"][-1][1].markers[0].action == 3


def test_a_recording_is_replaced_whole_or_not_at_all(planned):
    folder, _ = planned
    first = run("bag", folder / "run.json", "run.mcap")
    assert re.fullmatch(r"written: run\.mcap, \d+ messages on 8 topics\n", first.stdout)
    again = run("bag", folder / "plan.json", "run.mcap")
    assert again.stdout.endswith("topics, replacing the previous recording\n")
    before = Path("run.mcap").read_bytes()
    Path("broken.json").write_text('{"format": "optdock-plan/1", "status": "GoalOccupied"}')
    refused = run("bag", "broken.json", "run.mcap")
    assert refused.stderr == (
        "broken.json: the plan contains no path and no motion to record, its status is GoalOccupied\n"
    )
    assert refused.exit_code == 2
    assert Path("run.mcap").read_bytes() == before
    assert sorted(path.name for path in Path().iterdir()) == ["broken.json", "run.mcap"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            ("plan.json", "folder"),
            "folder: is an existing folder, which a recording does not replace; choose another name",
        ),
        (("plan.json", "plan.db3"), "plan.db3: must end in .mcap, or name a folder without a suffix, got .db3"),
        (("plan.json", "plan.json"), "plan.json: is the input file and would be overwritten; choose another name"),
        (("none.json", "a.mcap"), "none.json: cannot be read: No such file or directory"),
        (("plan.json", "a.mcap", "--start", "nan"), "--start: must be finite and >= 0 s, got nan"),
        (("plan.json", "a.mcap", "--base-frame", ""), "--base-frame: must be the name of a coordinate frame, got ''"),
        (("run.json", "a.mcap"), "run.json: columns.yaw: must have as many values as columns.t = 2, got 1"),
        (
            ("dock.log", "a.mcap", "--scenario", "bay.yaml"),
            "--scenario: is only for plans and runs; the log of a docking",
        ),
        (
            ("plan.json", "a.mcap", "--scenario", "odom.yaml"),
            "plan.json: the plan is in frame 'map', the scenario in",
        ),
        (("plan.json", "file/a.mcap"), "file/a.mcap: cannot be written: Not a directory"),
    ],
)
def test_invalid_sources_targets_and_options_are_refused(planned, arguments, message):
    folder, _ = planned
    for name in ("plan.json", "dock.log", "bay.yaml"):
        Path(name).write_bytes((folder / name).read_bytes())
    Path("odom.yaml").write_text("frame: odom\n" + Path("bay.yaml").read_text())
    Path("folder").mkdir()
    Path("file").touch()
    columns = json.loads((folder / "run.json").read_text())["columns"]
    columns = {name: column[: 1 if name == "yaw" else 2] for name, column in columns.items()}
    Path("run.json").write_text(json.dumps({"format": "optdock-run/1", "docked": True, "columns": columns}))
    result = run("bag", *arguments)
    assert (result.exit_code, result.stdout) == (2, "")
    assert result.stderr.startswith(message)


def test_without_rosbags_the_extra_is_named(planned, monkeypatch):
    folder, _ = planned
    ros.bag._store.cache_clear()
    monkeypatch.setitem(sys.modules, "rosbags.typesys", None)
    for arguments in (("bag", folder / "plan.json", "a.mcap"), ("import", "bag", "a.mcap", "-o", "a")):
        result = run(*arguments)
        assert (result.exit_code, result.stderr) == (2, "recordings need rosbags: pip install 'optdock[bag]'\n")


# A recorded docking: the robot drives 2 m along x in the frame odom, which stands turned in the frame map.
MAP_TO_ODOM = od.Pose2(5.0, 1.0, 0.7)


def field_messages(*, blocked=False, frame="odom", static=True):
    """Recording of a robot: local costmap, plan, footprint, odometry and transforms."""
    there = od.Pose2(0.0, 0.0, 0.0) if frame == "odom" else MAP_TO_ODOM
    costs = np.zeros((120, 160), dtype=np.uint8)
    low = there.x - 3.0, there.y - 3.0
    if blocked:
        middle = there @ od.Pose2(1.4, 0.0, 0.0)
        column, row = int((middle.x - low[0]) / 0.05), int((middle.y - low[1]) / 0.05)
        costs[row, column] = 254
    grid = od.Costmap(costs, 0.05, low)
    found = []

    def add(topic, offset, make, *arguments, **options):
        stamp = BEGIN + offset
        found.append(BagMessage(topic, stamp, make(bag_types, *arguments, stamp, **options)))

    add("/local_costmap/costmap_raw", 0.0, ros.costmap_message, od.Costmap(costs * 0 + 254, 0.05, low), frame)
    add("/local_costmap/costmap_raw", 0.1, ros.costmap_message, grid, frame)
    line = np.linspace(0.0, 2.0, 21)
    add("/plan", 0.2, ros.path_message, np.column_stack((line, 0.0 * line, 0.0 * line)), "odom")
    if static:
        add("/tf_static", 0.0, ros.transforms_message, [("map", "odom", MAP_TO_ODOM)])
    for k in range(41):
        pose, time = od.Pose2(0.05 * k, 0.0, 0.0), 0.05 * k
        add("/odom", time, ros.odometry_message, pose, od.Twist2(1.0), "odom", "base_link")
        add("/tf", time, ros.transforms_message, [("odom", "base_link", pose)])
        if k % 10 == 0:
            corners = transform_points((there @ pose).as_array()[None], FOOTPRINT.vertices)[0]
            add("/local_costmap/published_footprint", time, ros.polygon_message, corners, frame)
    return found


@pytest.mark.parametrize(("frame", "blocked"), [("odom", False), ("map", True)])
def test_a_recorded_docking_is_checked_by_the_certificate(frame, blocked):
    write_bag("field.mcap", field_messages(blocked=blocked, frame=frame))
    result = run("import", "bag", "field.mcap", "-o", "field")
    assert (result.exit_code, result.stderr) == (0, "")
    assert f"/local_costmap/costmap_raw: 160 x 120 cells of 0.05 m in '{frame}', received at 0.100 s" in result.stdout
    assert "/local_costmap/published_footprint: 0.600 m x 0.400 m, of 5 messages" in result.stdout
    for name in ("path", "drive"):
        verdict = run("certify", f"field/{name}.json", f"field/{name}.yaml")
        if not blocked:
            assert (verdict.exit_code, verdict.stderr) == (0, "")
            assert "path certified" in verdict.stdout
            continue
        assert verdict.exit_code == 3
        said = re.fullmatch(
            r"not certified: the footprint overlaps map at s = (\S+) m: clearance (\S+) m, required 0\.0000 m, "
            r"at \((\S+), (\S+), (\S+)\)\n",
            verdict.stderr,
        )
        s, clearance, *pose = map(float, said.groups())
        assert 1.1 < s < 1.7
        assert clearance < -0.15
        there = od.Pose2(0.0, 0.0, 0.0) if frame == "odom" else MAP_TO_ODOM
        assert pose == pytest.approx((there @ od.Pose2(s, 0.0, 0.0)).as_array(), abs=2e-3)
        assert re.search(rf"{name} closest +0\.\d+ m into map, pose \d+ of \d+, \(\S+, \S+, \S+\)", result.stdout)


def test_an_interval_of_a_recording_is_read():
    write_bag("field.mcap", field_messages(blocked=True))
    result = run("import", "bag", "field.mcap", "-o", "field", "--since", "0.1", "--until", "1.0", "--radius", "0.2")
    assert (result.exit_code, result.stderr) == (0, "")
    assert "/odom: 19 poses of 'base_link', 0.100 s to 1.000 s\n" in result.stdout
    path = load_plan("field/drive.json").path
    assert (path.start.x, path.end.x) == pytest.approx((0.1, 1.0))


WHOLE = field_messages()


def without(*topics):
    return [message for message in WHOLE if message.topic not in topics] if topics else WHOLE


@pytest.fixture(scope="module")
def whole_bag(tmp_path_factory):
    """The bytes of the recording of `WHOLE`."""
    target = tmp_path_factory.mktemp("whole") / "field.mcap"
    write_bag(target, WHOLE)
    return target.read_bytes()


def instead(topic, message):
    return [*without(topic), BagMessage(topic, BEGIN + 0.15, message)]


EMPTY_PATH = ros.path_message(bag_types, np.zeros((0, 3)), "odom", BEGIN)
STRANGE = ros.pose_message(bag_types, od.Pose2(0.0, 0.0, 0.0), "odom", BEGIN)
NOT_FINITE = ros.path_message(bag_types, [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0)], "odom", BEGIN)
NOT_FINITE.poses[1].pose.position.y = math.nan
ELSEWHERE = ros.path_message(bag_types, [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0)], "moon", BEGIN)
LEANING = ros.transforms_message(bag_types, [("map", "odom", od.Pose2(0.0, 0.0, 0.0))], BEGIN)
LEANING.transforms[0].transform.rotation.x, LEANING.transforms[0].transform.rotation.w = math.sin(0.3), math.cos(0.3)


UNJOINED = field_messages(frame="map", static=False)
WRONG_RECORDINGS = [
    ([], "", "holds no message"),
    (without("/plan", "/odom"), "", "has none of the topics /docking_trajectory, /plan_smoothed, /plan, /odom"),
    (without("/local_costmap/costmap_raw"), "", "has none of the topics /global_costmap/costmap_raw, "),
    (without("/local_costmap/published_footprint"), "", "has none of the topics /local_costmap/published_footprint, "),
    (without(), "--path-topic /way", "has no topic /way (--path-topic); its topics of type nav_msgs/msg/Path: /plan"),
    (instead("/plan", STRANGE), "", "/plan: must be nav_msgs/msg/Path, is geometry_msgs/msg/PoseStamped; choose anoth"),
    (instead("/plan", EMPTY_PATH), "", "/plan: holds no path with poses from 0.000 s"),
    (instead("/plan", NOT_FINITE), "", "/plan: nav_msgs/msg/Path: poses[1].pose.position.y: must be finite, got nan"),
    (
        instead("/plan", ELSEWHERE),
        "",
        "/plan: odom <- moon: there is no transform of 'moon'; known: map <- odom (static), odom",
    ),
    (without(), "--since 0.01 --until 0.04", "/odom: holds no message from 0.010 s to 0.040 s of 2.000 s (--since, "),
    (without(), "--since 0.11 --until 0.3", "/local_costmap/costmap_raw: holds no message from 0.110 s to 0.300 s"),
    (UNJOINED, "", "/plan: map <- odom: there is no transform of 'map'; known: odom <- base_link (until"),
    (
        [*UNJOINED, BagMessage("/tf_static", BEGIN, LEANING)],
        "",
        "/plan: map <- odom: is tilted by 0.600 rad, more than",
    ),
]
WRONG_OPTIONS = [
    ("--since 2 --until 1", "--since: must be >= 0 s and before --until, got 2.0 and 1.0"),
    ("--radius 0.1 --footprint [[0,0],[1,0],[0,1]]", "--radius: cannot be given with --footprint"),
    ("--contact nan", "--contact: must be finite and >= 0 m, got nan"),
    ("--clearance -1", "--clearance: must be finite and >= 0 m, got -1.0"),
    ("--occupied-from 0", "--occupied-from: must be in 1..100, got 0"),
]


@pytest.mark.parametrize(
    ("messages", "options", "message"),
    [
        *((messages, options, f"field.mcap: {message}") for messages, options, message in WRONG_RECORDINGS),
        *((without(), options, message) for options, message in WRONG_OPTIONS),
    ],
)
def test_errors_of_a_recording_name_file_and_topic(whole_bag, messages, options, message):
    if messages is WHOLE:
        Path("field.mcap").write_bytes(whole_bag)
    else:
        write_bag("field.mcap", messages)
    result = run("import", "bag", "field.mcap", "-o", "out", *options.split())
    assert result.stderr.startswith(message)
    assert result.stderr.count("\n") == 1
    assert result.exit_code == 2
    assert not Path("out").exists()


def test_a_damaged_recording_is_named(whole_bag):
    Path("text.mcap").write_text("no recording\n" * 10)
    Path("cut.mcap").write_bytes(whole_bag[: len(whole_bag) // 3])
    Path("notes.txt").write_text("hello\n")
    Path("folder").mkdir()
    for name in ("text.mcap", "cut.mcap", "notes.txt", "folder", "none.mcap"):
        result = run("import", "bag", name, "-o", "out")
        assert result.exit_code == 2, name
        assert re.match(rf"{re.escape(name)}: (/\S+: )?(is damaged or no recording|cannot be read): \S", result.stderr)
        assert result.stderr.count("\n") == 1


def test_a_message_that_is_cut_off_is_named():
    with Writer("cut", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        store = ros.bag._store()
        connection = writer.add_connection("/odom", "nav_msgs/msg/Odometry", typestore=store)
        whole = next(message for message in WHOLE if message.topic == "/odom").message
        data = bytes(store.serialize_cdr(whole, "nav_msgs/msg/Odometry"))
        writer.write(connection, int(BEGIN * 1e9), data[:40])
        grid = writer.add_connection("/map", "nav_msgs/msg/OccupancyGrid", typestore=store)
        message = ros.occupancy_message(bag_types, od.Costmap(np.zeros((2, 2), dtype=np.uint8), 1.0), "odom", BEGIN)
        writer.write(grid, int(BEGIN * 1e9), store.serialize_cdr(message, "nav_msgs/msg/OccupancyGrid"))
    result = run("import", "bag", "cut", "-o", "out")
    assert result.stderr.startswith("cut: /odom: is damaged or no recording: ")


@pytest.mark.parametrize("storage", [StoragePlugin.SQLITE3, StoragePlugin.MCAP])
def test_other_topics_of_a_recording_are_ignored(storage):
    """An invalid message definition, in recordings of both storage formats."""
    store = ros.bag._store()
    with Writer("field", version=8, storage_plugin=storage) as writer:
        odd = writer.add_connection("/odd", "vendor_msgs/msg/Odd", msgdef="no definition !", rihs01="RIHS01_0")
        writer.write(odd, int(BEGIN * 1e9), b"")
        known = {}
        for topic, time, message in field_messages():
            kind = message.__msgtype__
            if topic not in known:
                known[topic] = writer.add_connection(topic, kind, typestore=store)
            writer.write(known[topic], round(time * 1e9), store.serialize_cdr(message, kind))
    result = run("import", "bag", "field", "-o", "out")
    assert (result.exit_code, result.stderr) == (0, "")


def test_a_collision_is_reported_before_other_violations():
    messages = field_messages(blocked=True)
    for message in messages:
        if message.topic == "/tf":
            message.message.transforms[0].transform.translation.y = 0.002 * math.sin(1e3 * message.time)
    write_bag("field.mcap", messages)
    assert run("import", "bag", "field.mcap", "-o", "field").exit_code == 0
    verdict = run("certify", "field/drive.json", "field/drive.yaml")
    assert verdict.stderr.startswith("not certified: the footprint overlaps map at s = ")
    assert re.search("violation +the path slips sideways", verdict.stdout)


def test_a_collision_between_kept_poses_is_reported():
    """The robot turns by 0.09 rad and back on the spot, and its corner collides."""
    messages = field_messages()
    grid = next(message.message for message in messages[1:] if message.topic == "/local_costmap/costmap_raw")
    turned = od.Pose2(1.0, 0.0, 0.09)
    x, y = transform_points(turned.as_array()[None], FOOTPRINT.vertices)[0].max(axis=0).tolist()
    grid.data[160 * int((y - 0.001 + 3.0) / 0.05) + int((x - 0.05 + 3.0) / 0.05)] = 254
    for time, pose in ((1.01, od.Pose2(1.0, 0.0, 0.0)), (1.02, turned), (1.03, od.Pose2(1.0, 0.0, 0.0))):
        at, tree = BEGIN + time, [("odom", "base_link", pose)]
        odometry = ros.odometry_message(bag_types, pose, od.Twist2(), "odom", "base_link", at)
        messages += [
            BagMessage("/tf", at, ros.transforms_message(bag_types, tree, at)),
            BagMessage("/odom", at, odometry),
        ]
    write_bag("field.mcap", messages)
    result = run("import", "bag", "field.mcap", "-o", "field")
    assert re.search(r"drive closest +0\.\d+ m into map, pose 22 of 44, \(1, 0, 0\.09\) at 1\.020 s", result.stdout)
    assert run("certify", "field/drive.json", "field/drive.yaml").stderr.startswith("not certified: the footprint over")


@pytest.mark.parametrize(
    ("depth", "options", "refused"), [(0.04, (), False), (0.04, ("--contact", "0"), True), (0.2, (), True)]
)
def test_occupied_cells_at_the_docked_outline_are_free(depth, options, refused):
    """At the end of the path, cells up to a cell's diagonal inside the outline are the dock."""
    messages = field_messages()
    grid = next(message.message for message in messages[1:] if message.topic == "/local_costmap/costmap_raw")
    column = int((2.3 - depth + 3.0) / 0.05 + 1e-9)
    for row in range(58, 62):
        grid.data[160 * row + column] = 254
    write_bag("field.mcap", messages)
    result = run("import", "bag", "field.mcap", "-o", "field", *options)
    assert ("path's end" in result.stdout) == (depth < 0.1 and not refused)
    assert (run("certify", "field/path.json", "field/path.yaml").exit_code != 0) == refused
    assert (run("certify", "field/drive.json", "field/drive.yaml").exit_code != 0) == refused


def test_updates_of_the_costmap_are_applied():
    messages = field_messages()
    head = ros.messages.header(bag_types, "odom", BEGIN + 0.5)
    data = np.full(4, 254, dtype=np.uint8)
    kind = bag_types("nav2_msgs/msg/CostmapUpdate")
    update = kind(header=head, x=90, y=60, size_x=2, size_y=2, data=data)
    write_bag("field.mcap", [*messages, BagMessage("/local_costmap/costmap_raw_updates", BEGIN + 0.5, update)])
    result = run("import", "bag", "field.mcap", "-o", "field")
    assert "received at 0.100 s and 1 updates" in result.stdout
    assert "overlaps map" in run("certify", "field/path.json", "field/path.yaml").stderr


def test_odometry_replaces_a_missing_transform():
    write_bag("field.mcap", without("/tf", "/tf_static"))
    result = run("import", "bag", "field.mcap", "-o", "field")
    assert "/odom: 41 poses of 'base_link'" in result.stdout


def test_a_drive_keeps_its_ends_and_reversals():
    rng = np.random.default_rng(3)
    way = np.concatenate((np.linspace(0.0, 0.987, 200), np.linspace(0.987, 0.5, 100), np.full(50, 0.5)))
    poses = np.column_stack((way, 0.0 * way, 0.0 * way)) + rng.normal(0.0, 2e-4, (350, 3))
    kept = list(kept_poses(poses))
    assert (kept[0], kept[-1]) == (0, 349)
    assert any(abs(poses[row, 0] - 0.987) < 1e-3 for row in kept)
    apart = np.hypot(*np.diff(poses[kept, :2], axis=0).T)
    assert np.count_nonzero(apart < 0.045) <= 2
    path = od.Path.from_poses(poses[kept])
    assert [segment.direction.name for segment in path.segments] == ["FORWARD", "REVERSE"]
