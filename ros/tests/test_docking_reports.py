"""The published certificate names the obstacles that it does not count."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from optdock_ros.docking_reports import Reports

from optdock.executor.planning import DrivenMotion
from optdock.geometry.footprint import Footprint
from optdock.geometry.pose import Pose2
from optdock.model.costmap import Costmap
from optdock.model.dock import Dock
from optdock.model.limits import MotionLimits
from optdock.model.problem import DockingProblem
from optdock.model.robot import Robot
from optdock.planning.pipeline import plan_dock


class Ears:
    """A stand-in of a node that keeps published messages."""

    def __init__(self) -> None:
        self.said: list[Any] = []

    def create_publisher(self, *_: object) -> Ears:
        """Return this object."""
        return self

    def publish(self, message: Any) -> None:
        """Keep the message."""
        self.said.append(message)

    def get_fully_qualified_name(self) -> str:
        """Return the name of the node in its namespace."""
        return "/robot1/docking_server"


@pytest.mark.parametrize(
    ("costmap", "level"),
    [
        (Costmap(np.zeros((60, 60), dtype=np.uint8), 0.1, (-3.0, -3.0)), DiagnosticStatus.OK),
        (None, DiagnosticStatus.WARN),
    ],
)
def test_certificate_without_a_costmap_is_a_warning(costmap: Costmap | None, level: bytes) -> None:
    robot = Robot(Footprint.rectangle(0.3, 0.3, 0.5), MotionLimits())
    problem = DockingProblem(Pose2(-1.2, 0.1, 0.0), Dock(Pose2(0.0, 0.0, 0.0)), robot, costmap=costmap, frame="odom")
    ears = Ears()
    Reports(ears, "odom").motion(DrivenMotion.of(plan_dock(problem)), "what is not seen", 1.0)  # type: ignore[arg-type]
    (told,) = [one for message in ears.said if isinstance(message, DiagnosticArray) for one in message.status]
    assert told.name == "robot1/docking_server: certificate"
    assert told.level == level
    assert {item.value for item in told.values if item.key == "does not count"} == {"what is not seen"}
    assert ("what is not seen" in told.message) == (costmap is None)
