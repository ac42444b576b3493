"""The topics of the docking server in addition to feedback: plan, dock poses, and diagnostics."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Path
from rclpy.qos import DurabilityPolicy, QoSProfile
from visualization_msgs.msg import MarkerArray

from optdock import ros

if TYPE_CHECKING:
    from collections.abc import Mapping

    from rclpy.node import Node

    from optdock.executor import Step
    from optdock.executor.planning import DrivenMotion
    from optdock.geometry.pose import Pose2
    from optdock.planning.plan import DockPlan
    from optdock_ros.control_loop import CycleTimes

__all__ = ["Reports"]

_SPACING = 0.05  # [m] between the poses of docking_trajectory, as in paths of Nav2's planners
_LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class Reports:
    """Publishers of the reports of a node; all poses are in `frame`."""

    def __init__(self, node: Node, frame: str) -> None:
        self._node, self._frame = node, frame
        self._trajectory = node.create_publisher(Path, "docking_trajectory", _LATCHED)
        self._markers = node.create_publisher(MarkerArray, "~/markers", _LATCHED)
        self._diagnostics = node.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self._poses = {
            name: node.create_publisher(PoseStamped, name, _LATCHED)
            for name in ("staging_pose", "dock_pose", "filtered_dock_pose")
        }
        self._published: DrivenMotion | None = None

    def close(self) -> None:
        """Destroy the publishers."""
        for publisher in (self._trajectory, self._markers, self._diagnostics, *self._poses.values()):
            self._node.destroy_publisher(publisher)

    def pose(self, name: str, pose: Pose2, now: float) -> None:
        """Publish `staging_pose`, `dock_pose` or `filtered_dock_pose`."""
        self._poses[name].publish(ros.pose_message(ros.imported, pose, self._frame, now))

    def motion(self, motion: DrivenMotion, exempt: str, now: float) -> None:
        """Publish trajectory, markers and certificate of a new motion once; `exempt` names the excluded obstacles."""
        if motion is self._published:
            return
        self._published = motion
        path = motion.trajectory.path
        count = max(2, math.ceil(path.length / _SPACING) + 1)
        places = [path.length * i / (count - 1) for i in range(count)]
        self._trajectory.publish(ros.path_message(ros.imported, path.poses_at(places), self._frame, now))
        if motion.plan is not None:
            self._markers.publish(ros.plan_markers(ros.imported, motion.plan, self._frame, now))
            self._certificate(motion.plan, exempt, now)

    def _certificate(self, plan: DockPlan, exempt: str, now: float) -> None:
        found = plan.certificate
        certified = found.certified and plan.trajectory_certificate.certified
        values: dict[str, object] = {
            "min_clearance [m]": found.min_clearance,
            "required_clearance [m]": found.required_clearance,
            "nearest": found.nearest,
            "at [m]": found.at_s,
            "tube [m]": found.tube,
            "max_curvature [1/m]": found.max_curvature,
            "length [m]": found.length,
            "duration [s]": plan.trajectory.duration,
            "poses checked": found.poses_checked,
            "does not count": exempt,
            **{f"{stage} [ms]": spent for stage, spent in plan.timing_ms.items()},
        }
        blind = certified and plan.problem.costmap is None
        text = f"{plan}{f'; does not count {exempt}' if blind else ''}" if certified else found.reason
        self._publish("certificate", "warn" if blind else "ok" if certified else "error", text, values, now)

    def state(self, step: Step, faults: Mapping[str, str], times: CycleTimes, now: float) -> None:
        """Publish the state of the task, missing measurements, and the statistics of the control loop."""
        values: dict[str, object] = {
            **{f"{name} missing": why for name, why in faults.items()},
            "retries": step.feedback.num_retries,
            "distance [m]": step.feedback.distance,
            "time [s]": step.feedback.docking_time,
            "speed [m/s]": step.command.linear,
            "yaw rate [rad/s]": step.command.angular,
        }
        if step.deviation is not None:
            values |= {"off the path [m]": step.deviation.y, "turned off it [rad]": step.deviation.yaw}
        self._publish("state", "warn" if faults else "ok", step.state.value, values, now)
        text = f"{times.cycles} cycles of {1e3 * times.period:.1f} ms, {times.missed} missed"
        values = {
            "missed": times.missed,
            "late p99 [ms]": 1e3 * times.late_p99,
            "late max [ms]": 1e3 * times.late_max,
            "busy p99 [ms]": 1e3 * times.busy_p99,
            "busy max [ms]": 1e3 * times.busy_max,
        }
        self._publish("deadlines", "ok" if times.missed == 0 else "warn", text, values, now)

    def idle(self, now: float, trouble: str = "") -> None:
        """Publish that no task runs, with the failure of the last one."""
        self._published = None
        self._publish("state", "warn" if trouble else "ok", f"idle{trouble and '; '}{trouble}", {}, now)

    def _publish(self, name: str, level: Any, text: str, values: Mapping[str, object], now: float) -> None:
        full = f"{self._node.get_fully_qualified_name().lstrip('/')}: {name}"
        self._diagnostics.publish(ros.diagnostics_message(ros.imported, full, level, text, values, now))
