"""A recorded docking as scenarios and plan files: the certificate judges what was planned and what was driven."""

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
    """What was planned or driven, as a problem that ends where it ended.

    Attributes:
        name: `path` or `drive`.
        path: Through the poses.
        problem: From its first pose to its last, among the costmap's cells.
        closest: The smallest clearance of the poses, with its pose and obstacle, in words.
    """

    name: str
    path: DockPath
    problem: DockingProblem
    closest: str


def judged_poses(
    found: FieldDocking, rule: ClearanceRule, contact: float | None = None
) -> tuple[tuple[JudgedPoses, ...], tuple[tuple[str, str], ...]]:
    """What can be judged of a recorded docking, and what there is to say of it, in rows.

    Its limits are `MotionLimits`'s own: a recording knows none.

    Args:
        found: The docking.
        rule: What clearance path and drive must keep.
        contact: Where the path ends the robot is to touch its dock, which marks whole cells: those that come this near
            to the edge of the outline there, and reach no deeper into it, count as free [m]; None: the diagonal of a
            cell, by which a cell may reach beyond what marks it.
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
            # A swing that is too short to be kept, and touches something, is what there is to be judged.
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
    """The costmap without the cells that the robot touches where the path ends, and what to say of them."""
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
    said = (
        f"{np.count_nonzero(touched)} occupied cells at the edge of the outline, to within {near:.3f} m, taken as free"
    )
    return grid.with_data(data), [("path's end", said)]


def _closest(poses: FloatArray, problem: DockingProblem) -> tuple[float, int, str]:
    """The least clearance of poses [m], the row of its pose, and both in words; what lies between is not seen."""
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
    """Write `NAME.json`, a plan file, and `NAME.yaml`, a scenario, for each of them, and one map for all.

    Args:
        folder: Made where it is not there; files of these names are replaced.
        judged: What to write.
        found: Its source.
        note: A line of comment for the scenarios.

    Returns:
        The files written.

    Raises:
        InvalidFile: A file cannot be written.
        InvalidValue: There is nothing to write.
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
