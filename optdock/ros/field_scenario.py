"""A recorded docking as scenarios and plan files, for the certificate of the planned and the driven path."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import shapely

from optdock.config.scenario import Scenario
from optdock.config.writing import save_scenario
from optdock.errors import InvalidPath, InvalidValue
from optdock.geometry.obstacles import in_words
from optdock.geometry.pose import Pose2, transform_points
from optdock.io.maps import save_map
from optdock.io.plan_file import PlanFile, save_plan
from optdock.model.costs import FREE_SPACE, LETHAL
from optdock.model.dock import Dock
from optdock.model.limits import LIMIT_UNITS, MotionLimits
from optdock.model.path import Path as DockPath
from optdock.model.problem import ClearanceRule, DockingProblem
from optdock.model.robot import Robot
from optdock.verification.proximity import pose_clearances

if TYPE_CHECKING:
    from optdock.geometry.arrays import FloatArray
    from optdock.model.costmap import Costmap
    from optdock.ros.field import FieldDocking

__all__ = ["JudgedPoses", "judged_poses", "save_field_docking"]

_BLOCK = 512  # poses per round, bounds the memory


class JudgedPoses(NamedTuple):
    """A planned or driven path, and the problem that it solves.

    Attributes:
        name: `path` or `drive`.
        path: Path through the poses.
        problem: Problem from the first pose to the last, with the costmap.
        closest: Text with the smallest clearance of the poses, its pose and obstacle.
    """

    name: str
    path: DockPath
    problem: DockingProblem
    closest: str


def judged_poses(
    found: FieldDocking, rule: ClearanceRule, contact: float | None = None
) -> tuple[tuple[JudgedPoses, ...], tuple[tuple[str, str], ...]]:
    """Return the paths of a recorded docking with their problems, and rows of a report.

    The limits are the defaults of `MotionLimits`, as a recording has none.

    Args:
        found: The docking.
        rule: Required clearance of path and drive.
        contact: Tolerance for contact with the dock at the end of the path: occupied cells within this distance of the
            edge of the outline, inside and outside, are free [m]. None for the diagonal of a cell.
    """
    judged, drive = list[JudgedPoses](), found.drive
    known, rows = _without_contact(found, contact)
    for name, poses in (("path", found.path), ("drive", None if drive is None else drive.poses)):
        if poses is None:
            rows.append((f"{name} to judge", "none"))
            continue
        problem = DockingProblem(
            Pose2(*poses[0].tolist()),
            Dock(Pose2(*poses[-1].tolist())),
            Robot(found.footprint, MotionLimits()),
            clearance=rule,
            costmap=known,
            frame=found.frame,
        )
        distance, worst, closest = _closest(poses, problem)
        if drive is not None and name == "drive":
            closest += f" at {drive.times[worst]:.3f} s"
            # A colliding pose is judged even if it is not kept.
            poses = poses[sorted({*drive.kept, worst} if distance < rule.required else drive.kept)]  # noqa: PLW2901
        try:
            path = DockPath.from_poses(poses, found.frame)
        except InvalidPath as error:
            rows.append((f"{name} to judge", f"none: {error}"))
            continue
        judged.append(JudgedPoses(name, path, problem, closest))
        rows.append((f"{name} closest", closest))
    return tuple(judged), tuple(rows)


def _without_contact(found: FieldDocking, contact: float | None) -> tuple[Costmap, list[tuple[str, str]]]:
    """Costmap without the cells that the robot touches at the end of the path, and rows of a report."""
    grid, near = found.costmap, math.sqrt(2.0) * found.costmap.resolution if contact is None else contact
    if found.path is None or near == 0.0:
        return grid, []
    outline = shapely.Polygon(transform_points(found.path[-1:], found.footprint.vertices)[0])
    rows, columns = np.nonzero(grid.data >= LETHAL)
    centres, half = grid.centre_of(np.column_stack((columns, rows))), 0.5 * grid.resolution
    squares = shapely.box(*(centres - half).T, *(centres + half).T)
    touched = shapely.intersects(squares, outline.buffer(near)) & ~shapely.intersects(squares, outline.buffer(-near))
    if not touched.any():
        return grid, []
    data = grid.data.copy()
    data[rows[touched], columns[touched]] = FREE_SPACE
    count = np.count_nonzero(touched)
    text = f"{count} occupied cells at the edge of the outline, to within {near:.3f} m, taken as free"
    return grid.with_data(data), [("path's end", text)]


def _closest(poses: FloatArray, problem: DockingProblem) -> tuple[float, int, str]:
    """Smallest clearance of the poses themselves [m], its row, and both as text."""
    if not len(problem.all_obstacles):
        return math.inf, 0, "nothing is in the way"
    footprint, obstacles = problem.robot.footprint, problem.all_obstacles
    blocks = np.array_split(poses, -(-len(poses) // _BLOCK))
    found = [pose_clearances(block, footprint, obstacles) for block in blocks]
    distances, rows = (np.concatenate(columns) for columns in zip(*found, strict=True))
    worst = int(np.argmin(distances))
    least, what = float(distances[worst]), in_words(obstacles.name_of(int(rows[worst])))
    away = f"{least:.4f} m from {what}" if least >= 0.0 else f"{-least:.4f} m into {what}"
    return least, worst, f"{away}, pose {worst} of {len(poses)}, {Pose2(*poses[worst].tolist()).brief}"


def save_field_docking(
    folder: str | Path, judged: tuple[JudgedPoses, ...], found: FieldDocking, note: str
) -> tuple[Path, ...]:
    """Write a plan file `NAME.json` and a scenario `NAME.yaml` for each path, and one map for all.

    Args:
        folder: Folder, created if necessary; existing files are replaced.
        judged: Paths to write.
        found: The docking.
        note: Comment of one line for the scenarios.

    Returns:
        The files written.

    Raises:
        InvalidFile: If a file cannot be written.
        InvalidValue: If there is nothing to write.
    """
    if not judged:
        raise InvalidValue("neither path nor drive has two distinct poses; there is nothing to judge")
    folder = Path(folder)
    written = [*save_map(folder / "map.yaml", judged[0].problem.costmap or found.costmap)]
    for one in judged:
        plan = folder / f"{one.name}.json"
        save_plan(plan, PlanFile(status="recorded", completed=True, frame=found.frame, path=one.path))
        scenario = Scenario(one.problem, default_limits=frozenset(LIMIT_UNITS))
        files = save_scenario(
            plan.with_suffix(".yaml"), scenario, map_source=written[0], note=f"{note}, as {one.name} recorded"
        )
        written += [plan, *files]
    return tuple(written)
