"""Shapes that the player moves along a motion: the robot, the cone of its camera, and its tracking tube."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.geometry.polygon import edge_normals
from optdock.model.robot import TrackingTube
from optdock.plotting.scene import camera_outline
from optdock.verification import end_clearances

if TYPE_CHECKING:
    from optdock.geometry.arrays import FloatArray
    from optdock.model.problem import DockingProblem

__all__ = ["MovedShapes", "moved_shapes"]

_SHARPEST = 0.1  # 1 + cosine between the normals of two edges; a sharper corner of the tube is cut off


class MovedShapes(NamedTuple):
    """Shapes in the frame of the robot.

    Attributes:
        outline: Outline of the robot, Shape (n, 2) [m].
        cone: Outline of the cone of the camera, Shape (k, 2) [m]; empty without a camera.
        growth: Displacement of each corner of the outline per metre of the width of the tube, Shape (n, 2).
        widths: Width of the tube at each pose of the motion [m], Shape (m,); empty without a tube.
    """

    outline: FloatArray
    cone: FloatArray
    growth: FloatArray
    widths: FloatArray


def moved_shapes(problem: DockingProblem, poses: FloatArray | None = None, start_relief: float = 0.0) -> MovedShapes:
    """Return the shapes of a problem.

    Args:
        problem: The docking problem.
        poses: Poses of a certified motion, around which the tube lies, Shape (m, 3); None: no tube is shown.
        start_relief: Start relief of the certificate [m].
    """
    robot = problem.robot
    outline, camera, widths = robot.footprint.vertices, robot.camera, np.zeros(0)
    reach = float(np.hypot(problem.start.x - problem.goal.x, problem.start.y - problem.goal.y))
    cone = np.zeros((0, 2)) if camera is None else camera_outline(camera, reach)
    if poses is not None and robot.tracking != TrackingTube():
        widths = problem.tube_widths(poses, problem.start, end_clearances(problem).start, start_relief)
    return MovedShapes(outline, cone, _growth(outline), widths)


def _growth(outline: FloatArray) -> FloatArray:
    """Return the displacements of the corners if all edges are displaced outwards by 1 m. Shape (n, 2)."""
    after = edge_normals(outline)
    before = np.roll(after, 1, axis=0)
    cosine = np.sum(before * after, axis=1, keepdims=True)
    growth: FloatArray = (before + after) / np.maximum(1.0 + cosine, _SHARPEST)
    return growth
