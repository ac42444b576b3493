"""The rotation of detections has the convention of the distribution, compared with rotation matrices."""

from __future__ import annotations

import math

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped
from optdock_ros.detection_rotation import detection_rotation, distribution_of
from optdock_ros.dock_plugins import DockPlugin
from scipy.spatial.transform import Rotation

from optdock.nav2.declared_parameters import DISTRIBUTIONS
from optdock.ros.transforms import Transform

ANGLES = np.random.default_rng(7).uniform(-math.pi, math.pi, (50, 3))
LEVEL = Transform("base_link", "camera", 5.0, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
OLD, NEW = DISTRIBUTIONS[:2], DISTRIBUTIONS[2:]


def wanted(angles: np.ndarray, distribution: str) -> Rotation:
    """Return the rotation as documented by Nav2: about the fixed axes z, x, y, or since Lyrical about x, y, z."""
    roll, pitch, yaw = angles
    if distribution in OLD:
        return Rotation.from_euler("zxy", [yaw, roll, pitch])
    return Rotation.from_euler("xyz", [roll, pitch, yaw])


@pytest.mark.parametrize("distribution", DISTRIBUTIONS)
def test_both_conventions(distribution: str) -> None:
    for angles in ANGLES:
        found = Rotation.from_quat(detection_rotation(*angles.tolist(), distribution))
        np.testing.assert_allclose(found.as_matrix(), wanted(angles, distribution).as_matrix(), atol=1e-12)


def test_the_conventions_differ_except_without_yaw_or_without_roll_and_pitch() -> None:
    apart = [(wanted(angles, "kilted").inv() * wanted(angles, "lyrical")).magnitude() for angles in ANGLES]
    assert max(apart) > 2.0
    for angles in ([-1.57, 1.57, 0.0], [-1.57, -1.57, 0.0], [0.0, 0.0, 0.8]):
        assert detection_rotation(*angles, "jazzy") == pytest.approx(detection_rotation(*angles, "main"))
        assert detection_rotation(*angles, "") == pytest.approx(detection_rotation(*angles, "main"))


@pytest.mark.parametrize("distribution", DISTRIBUTIONS)
def test_the_heading_of_a_detected_dock_has_the_convention(distribution: str) -> None:
    """Angles whose dock lies along the floor in both conventions, at different headings."""
    roll, pitch, yaw = 0.4, -0.2, 0.7
    names = ("roll", "pitch", "yaw")
    block = {f"external_detection_rotation_{n}": a for n, a in zip(names, (roll, pitch, yaw), strict=True)}
    seen = PoseStamped()
    seen.header.frame_id, seen.pose.orientation.w = "camera", 1.0
    found = DockPlugin("bay", block, distribution).detection(seen, LEVEL).pose
    ahead = wanted(np.array([roll, pitch, yaw]), distribution).apply([1.0, 0.0, 0.0])
    assert found.yaw == pytest.approx(math.atan2(ahead[1], ahead[0]))
    headings = {d: wanted(np.array([roll, pitch, yaw]), d).apply([1.0, 0.0, 0.0]) for d in ("jazzy", "main")}
    assert abs(headings["jazzy"][1] - headings["main"][1]) > 0.01


@pytest.mark.parametrize(
    ("named", "distribution"),
    [("jazzy", "jazzy"), ("Kilted", "kilted"), ("lyrical", "lyrical"), ("rolling", "main"), ("humble", ""), ("", "")],
)
def test_the_distribution_of_an_environment(named: str, distribution: str) -> None:
    assert distribution_of({"ROS_DISTRO": named} if named else {}) == distribution
