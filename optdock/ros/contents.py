"""Messages for recordings of plans, simulated runs and docking logs."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.errors import InvalidFile, InvalidValue
from optdock.geometry.obstacles import in_words
from optdock.geometry.pose import Pose2, Twist2
from optdock.model.path import Path, may_be_one_frame
from optdock.ros.bag import BagMessage, bag_types
from optdock.ros.grids import occupancy_message
from optdock.ros.markers import delete_markers, path_markers
from optdock.ros.motion import (
    diagnostics_message,
    odometry_message,
    path_message,
    pose_message,
    transforms_message,
    twist_message,
)
from optdock.verification import certify_path

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from optdock.executor.log import Cycle, DockingLog
    from optdock.geometry.arrays import FloatArray
    from optdock.io.plan_file import PlanFile
    from optdock.io.run_file import RunColumns
    from optdock.model.problem import DockingProblem

__all__ = ["LATCHED", "Names", "log_messages", "plan_messages", "run_messages"]

_PLAN, _TRAJECTORY, _REFERENCE = "/plan", "/docking_trajectory", "/reference_pose"
_ODOM, _COMMAND, _TF, _MEASURED = "/odom", "/cmd_vel", "/tf", "/measured_pose"
_MARKERS, _DIAGNOSTICS, _MAP, _COSTMAP = "/markers", "/diagnostics", "/map", "/local_costmap/costmap"
_DETECTED = "/detected_dock_pose"
LATCHED = (_PLAN, _TRAJECTORY, _MARKERS, _MAP)

_SPACING = 0.02  # [m] between poses of a path, as in plan files


class Names(NamedTuple):
    """Frames and start time of a recording.

    Attributes:
        frame: Name of the coordinate frame; empty for the frame of the file or the problem.
        base: Frame of the robot.
        start: Offset of all times [s]: the start time of a plan or a simulated run.
        stamped: Whether commands are `TwistStamped`.
    """

    frame: str = ""
    base: str = "base_link"
    start: float = 0.0
    stamped: bool = True


def plan_messages(plan: PlanFile, names: Names, problem: DockingProblem | None = None) -> Iterator[BagMessage]:
    """Yield the messages of a plan file: the paths, then the messages of the motion driven without errors.

    If a problem is given, its map and markers of the swept outlines and of the closest point are also included.

    Raises:
        InvalidFile: If the plan has no path and no motion.
        InvalidValue: If the plan and the problem are in different frames.
    """
    if plan.path is None and plan.raw_path is None and plan.trajectory is None:
        raise InvalidFile(f"the plan contains no path and no motion to record, its status is {plan.status}")
    if problem is not None and not may_be_one_frame(plan.frame, problem.frame):
        raise InvalidValue(f"the plan is in frame {plan.frame!r}, the scenario in {problem.frame!r}")
    frame, start = names.frame or plan.frame, names.start
    yield from _world(problem, frame, start)
    for topic, path in ((_PLAN, plan.raw_path), (_TRAJECTORY, plan.path)):
        if path is not None:
            yield BagMessage(topic, start, _path(path, frame, start))
    if plan.path is not None:
        yield BagMessage(_MARKERS, start, _markers(plan.path, problem, frame, start))
    yield _diagnostics("plan", plan.status, _claims(plan), start, good=plan.status == "certified")
    if plan.trajectory is not None:
        motion = plan.trajectory
        poses = np.column_stack((motion.x, motion.y, motion.yaw))
        twists = np.column_stack((motion.speed, motion.yaw_rate))
        yield from _driven(start + motion.t, poses, twists, names._replace(frame=frame))
        yield from _commanded(start + motion.t, twists, names)


def run_messages(run: RunColumns, names: Names, problem: DockingProblem | None = None) -> Iterator[BagMessage]:
    """Yield the messages of a simulated run: true, measured and planned poses, and commands."""
    frame = names.frame or ("map" if problem is None else problem.frame)
    named, times = names._replace(frame=frame), names.start + run.times
    yield from _world(problem, frame, names.start)
    planned = Path.from_poses(run.planned)
    yield BagMessage(_TRAJECTORY, names.start, path_message(bag_types, run.planned, frame, names.start))
    yield BagMessage(_MARKERS, names.start, _markers(planned, problem, frame, names.start))
    yield from _driven(times, run.poses, run.twists, named)
    yield from _commanded(times, run.commands, named)
    for topic, poses in ((_MEASURED, run.measured), (_REFERENCE, run.planned)):
        for time, pose in zip(times.tolist(), poses.tolist(), strict=True):
            yield BagMessage(topic, time, pose_message(bag_types, Pose2(*pose), frame, time))
    text = "docked" if run.docked else f"not docked: {run.reason}"
    yield _diagnostics("run", text, {"duration [s]": run.times[-1]}, float(times[-1]), good=run.docked)


def log_messages(log: DockingLog, names: Names) -> Iterator[BagMessage]:
    """Yield the messages of a docking log on the log's clock: measurements, plans, commands, events of all cycles."""
    problem = log.task.problem
    named = names._replace(frame=names.frame or problem.frame)
    yield from _world(problem, named.frame, names.start + log.cycles[0].measurements.stamp)
    for cycle in log.cycles:
        yield from _cycle_messages(cycle, problem, named)


def _cycle_messages(cycle: Cycle, problem: DockingProblem, names: Names) -> Iterator[BagMessage]:
    measured, frame = cycle.measurements, names.frame
    time = names.start + measured.stamp
    for planned in cycle.planned:
        if planned.trajectory is not None:
            path = planned.trajectory.path
            yield BagMessage(_TRAJECTORY, time, _path(path, frame, time))
            yield BagMessage(_MARKERS, time, _markers(path, problem, frame, time, certified=False))
    if measured.pose is not None:
        row = np.array([[measured.pose.x, measured.pose.y, measured.pose.yaw]])
        twist = measured.twist
        yield from _driven(np.array([time]), row, np.array([[twist.linear, twist.angular, twist.lateral]]), names)
    for seen in measured.detections:
        at = names.start + seen.stamp
        yield BagMessage(_DETECTED, time, pose_message(bag_types, seen.pose, names.base, at))
    if measured.costmap is not None:
        yield BagMessage(_COSTMAP, time, occupancy_message(bag_types, measured.costmap, frame, time))
    command = np.array([[cycle.command.linear, cycle.command.angular]])
    yield from _commanded(np.array([time]), command, names)
    for event in cycle.events:
        details = {"state": cycle.state.value, "detail": event.detail}
        yield _diagnostics("docking", event.name, details, time)
    if cycle.ending is not None:
        ending = cycle.ending
        values = {"error code": ending.kind.code, "retries": ending.num_retries, "reason": ending.reason}
        yield _diagnostics("docking", ending.kind.value, values, time, good=ending.kind.code == 0)
        yield BagMessage(_MARKERS, time, delete_markers(bag_types, frame, time))


def _world(problem: DockingProblem | None, frame: str, time: float) -> Iterator[BagMessage]:
    if problem is not None and problem.costmap is not None:
        yield BagMessage(_MAP, time, occupancy_message(bag_types, problem.costmap, frame, time))


def _path(path: Path, frame: str, time: float) -> object:
    samples = path.sample(_SPACING)
    poses = np.column_stack((samples.x, samples.y, samples.yaw))
    distinct = np.append(True, np.any(np.diff(poses, axis=0) != 0.0, axis=1))
    return path_message(bag_types, poses[distinct], frame, time)


def _markers(path: Path, problem: DockingProblem | None, frame: str, time: float, *, certified: bool = True) -> object:
    nameless = Path(path.segments)  # without the name of its frame, because the recording may rename it
    if problem is None:
        return path_markers(bag_types, nameless, frame, time)
    return path_markers(
        bag_types,
        nameless,
        frame,
        time,
        footprint=problem.robot.footprint,
        obstacles=problem.all_obstacles,
        certificate=certify_path(nameless, problem) if certified else None,
    )


def _driven(times: FloatArray, poses: FloatArray, twists: FloatArray, names: Names) -> Iterator[BagMessage]:
    frame, base = names.frame, names.base
    for time, pose, twist in zip(times.tolist(), poses.tolist(), twists.tolist(), strict=True):
        at = Pose2(*pose)
        yield BagMessage(_ODOM, time, odometry_message(bag_types, at, Twist2(*twist), frame, base, time))
        yield BagMessage(_TF, time, transforms_message(bag_types, [(frame, base, at)], time))


def _commanded(times: FloatArray, commands: FloatArray, names: Names) -> Iterator[BagMessage]:
    for time, command in zip(times.tolist(), commands.tolist(), strict=True):
        message = twist_message(bag_types, Twist2(*command), names.base, time, stamped=names.stamped)
        yield BagMessage(_COMMAND, time, message)


def _claims(plan: PlanFile) -> Mapping[str, object]:
    """Return the values of the certificate in the file, the error, and the computation times."""
    claimed = plan.certificate or {}
    values: dict[str, object] = {
        name: claimed[name]
        for name in ("min_clearance", "required_clearance", "at_s", "max_curvature", "length")
        if isinstance(claimed.get(name), float | int)
    }
    nearest = claimed.get("nearest")
    if isinstance(nearest, str) and nearest:
        values["nearest"] = in_words(nearest)
    if plan.error is not None:
        values |= {"error code": plan.error.code, "reason": plan.error.message}
    return values | {f"{stage} [ms]": float(spent) for stage, spent in plan.timing_ms.items()}


def _diagnostics(name: str, text: str, values: Mapping[str, object], time: float, *, good: bool = True) -> BagMessage:
    message = diagnostics_message(bag_types, f"optdock: {name}", "ok" if good else "error", text, values, time)
    return BagMessage(_DIAGNOSTICS, time, message)
