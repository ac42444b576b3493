"""Scenes that are read from files and written to files of one folder.

Names of files may come from the page, so every file is checked by `inside`: the named file, the map of a scenario and
the image of a map.
"""

from __future__ import annotations

import dataclasses
import math
import os
import re
from collections.abc import Mapping
from contextlib import ExitStack, suppress
from functools import lru_cache
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np

from optdock.config import demo_scenario, load_scenario, save_scenario
from optdock.config.scenario import parse_scenario
from optdock.errors import InvalidFile, InvalidValue, OptdockError
from optdock.geometry.footprint import Footprint
from optdock.geometry.pose import Pose2
from optdock.io.atomic_file import replacing
from optdock.io.guarded_file import MostBytes, is_regular, read_text
from optdock.io.plan_file import load_plan
from optdock.io.quoting import shown
from optdock.io.yaml_lines import load_yaml
from optdock.model.costmap import LETHAL, Costmap
from optdock.model.dock import DockDirection
from optdock.planning.failures import check_ends
from optdock.survey.dock_places import along_walls
from optdock.survey.grid import Box
from optdock.ui.scene_edits import EditedScene, rounded_pose
from optdock.ui.scene_maps import inside, is_inside, known_costmap

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from optdock.config import Scenario
    from optdock.geometry.arrays import BoolArray, FloatArray
    from optdock.model.problem import DockingProblem
    from optdock.ui.drawn_plan import DrawnPlan

__all__ = ["answer_files", "open_scene", "saved", "worked_scenes"]

_FIRST_BOX = (2.7, 0.7)  # [m]: centre of the box in the built-in scenario, whose other obstacles are in its map
_NAME = re.compile(r"[^\W_][\w .+-]{0,99}", re.ASCII)
_MOST_SCENARIOS = 200  # that are compared with a plan
_SCALES = (1.0, 0.5, 0.25)  # of the built-in robot on a map
_WALL_SPACING = 0.5  # [m] between proposed docks
_WALL_REACH = 3.0  # [m] beyond the nearest wall, for proposed docks
_LEAST_APART = 3.0  # circumscribed radii between a proposed dock and start, at least
_MOST_CELLS = 1_000_000  # in which free places are searched first
_START_DISTANCE = 4.0  # [m] from the dock to a proposed start, at most


def worked_scenes() -> tuple[Path, ...]:
    """Return the scenario files of the worked scenes, sorted by name."""
    return tuple(sorted(Path(__file__).with_name("scenes").glob("*.yaml")))


def open_scene(source: str | Path | None, folder: str | Path) -> EditedScene:
    """Return the scene of a file.

    Args:
        source: Scenario file; map (map_server YAML), on which the robot of the built-in scenario is placed, smaller
            if it has no place there; plan file, whose scenario is the one in its folder for which its certificate or
            proof holds, or the one of its name if it has neither; None: the built-in scenario, with a box beside the
            way. A relative name is relative to the folder.
        folder: The folder; no file outside of it is read.

    Raises:
        InvalidFile: If a file cannot be read or does not match its format.
        InvalidValue: If a file is outside the folder, the map has no place for the robot, or no scenario belongs to the
            plan.
    """
    if source is None:
        return _scene_of_scenario(demo_scenario(), demo_scenario().parent).added_box(*_FIRST_BOX)
    file = inside(source, folder)
    if file.suffix.lower() == ".json":
        return _scene_of_plan(file, Path(folder))
    content = load_yaml(file).value
    if isinstance(content, Mapping) and "image" in content and "robot" not in content:
        return EditedScene(_placed_on(file, known_costmap(file, folder)), file)
    return _scene_of_scenario(file, folder)


def saved(
    scene: EditedScene,
    name: str,
    folder: str | Path,
    *,
    overwrite: bool = False,
    beside: Mapping[str, Callable[[Path], object]] = MappingProxyType({}),
) -> tuple[Path, ...]:
    """Write the scenario of a scene into a folder, and other files beside it: all of them or none.

    Args:
        scene: The scene.
        name: Name of the file; `.yaml` is appended if it is missing.
        folder: The folder.
        overwrite: Whether existing files are replaced.
        beside: Functions that write the other files into the path that they are given, by the suffixes of these files.

    Returns:
        The files written, the scenario first; if the scene has a map that is not a file of the folder, also the map;
        the other files last.

    Raises:
        InvalidFile: If a file cannot be written.
        InvalidValue: If the name has separators, begins with a dot or has other characters than letters, digits,
            spaces and `_.+-`; if a file exists and `overwrite` is False; or if a scenario file has no key for a value.
    """
    if not (isinstance(name, str) and _NAME.fullmatch(name) and name == name.strip()):
        raise InvalidValue(f"name: must be letters, digits, spaces and _.+-, without folders, got {shown(name)}")
    if not name.lower().endswith((".yaml", ".yml")):
        name = f"{name}.yaml"
    target = Path(folder) / name
    source = scene.map_source if scene.map_source is not None and is_inside(scene.map_source, folder) else None
    drawn = (
        []
        if scene.problem.costmap is None
        else [target.with_name(f"{target.stem}_map{end}") for end in (".yaml", ".pgm")]
    )
    others = [target.with_suffix(suffix) for suffix in beside]
    for file in (target, *drawn, *others):
        inside(file, folder)
        if os.path.lexists(file) and not overwrite:
            raise InvalidValue(f"name: {file.name} exists")
    with ExitStack() as files:  # replaces the other files after the scenario has been written
        for other, write in zip(others, beside.values(), strict=True):
            write(files.enter_context(replacing(other)))
        return (*save_scenario(target, scene.scenario, obstacles=scene.polygons, map_source=source), *others)


def answer_files(drawn: DrawnPlan, scene: EditedScene, name: str) -> dict[str, Callable[[Path], object]]:
    """Return functions that write the plan file and the report of an answer, by their suffixes, for `saved`.

    Args:
        drawn: The answer to the scene.
        scene: The scene.
        name: Name of the file of the scene.
    """
    from optdock.reports.html import plan_chapter, save_report

    file, stem = drawn.plan_file(scene.problem), name.removesuffix(".yaml").removesuffix(".yml")
    return {
        ".json": lambda path: path.write_text(file.as_json(), encoding="utf-8"),
        ".html": lambda path: save_report(path, stem, [plan_chapter(f"{stem}.json", file, scene.problem)]),
    }


def _scene_of_scenario(file: Path, folder: str | Path) -> EditedScene:
    source: Path | None = None

    def costmap_of(name: str) -> Costmap:
        nonlocal source
        source = inside(file.parent / name, folder)
        return known_costmap(source, folder)

    scenario = parse_scenario(read_text(file, MostBytes.YAML), str(file), costmap_of)
    return EditedScene(scenario, source)


def _scene_of_plan(file: Path, folder: Path) -> EditedScene:
    """Return the scene of the scenario beside a plan file for which its certificate or proof holds."""
    plan = load_plan(file)
    known = None if plan.certificate is None else plan.certificate.get("problem")
    if plan.impossibility is not None:
        known = plan.impossibility.problem._asdict()
    for scene in _scenes_beside(file, folder):
        same_name = scene.scenario.source.stem == file.stem
        if scene.problem.fingerprint._asdict() == known or (known is None and same_name):
            return scene
    asked = f"{file.stem}.yaml" if known is None else "a scenario for which its certificate or proof holds"
    raise InvalidValue(f"{file.name}: a plan file does not contain its scenario; its folder does not contain {asked}")


def _scenes_beside(file: Path, folder: Path) -> Iterator[EditedScene]:
    """Yield the scenes of the scenarios in the folder of a plan file, that of its name first."""
    files = [*file.parent.glob("*.yaml"), *file.parent.glob("*.yml")]
    readable = [one for one in sorted(files) if is_regular(one) and is_inside(one, folder)]
    for candidate in sorted(readable, key=lambda one: one.stem != file.stem)[:_MOST_SCENARIOS]:
        with suppress(InvalidFile, InvalidValue):  # other kinds of files
            yield _scene_of_scenario(candidate, folder)


@lru_cache(maxsize=4)
def _placed_on(source: Path, costmap: Costmap) -> Scenario:
    """Return the built-in scenario on a map, with dock and start in free places of the map.

    If the map has none for the robot, robot and station are smaller.
    """
    scenario = load_scenario(demo_scenario())
    problem = dataclasses.replace(scenario.problem, costmap=costmap)
    for scale in _SCALES:
        placed = _with_free_places(_scaled(problem, scale))
        if placed is not None:
            return dataclasses.replace(scenario, problem=placed, source=source)
    least = min(_SCALES) * problem.robot.footprint.length
    raise InvalidValue(f"{source.name}: has no free place for a robot of {least:.2g} m")


def _scaled(problem: DockingProblem, scale: float) -> DockingProblem:
    """Return the problem with the outlines of robot and station scaled."""
    robot, dock = problem.robot, problem.dock
    if dock.footprint is not None:
        dock = dataclasses.replace(dock, footprint=Footprint((scale * dock.footprint.vertices).round(6)))
    robot = dataclasses.replace(robot, footprint=Footprint((scale * robot.footprint.vertices).round(6)))
    return dataclasses.replace(problem, robot=robot, dock=dock)


def _with_free_places(problem: DockingProblem) -> DockingProblem | None:
    """Return the problem with dock and start in free places of its map; None if there are none."""
    costmap = problem.costmap
    if costmap is None:
        return None
    block = math.ceil(math.sqrt(costmap.data.size / _MOST_CELLS))
    for cells in dict.fromkeys((_blocks(costmap, block), costmap)):  # one if a block is a cell
        placed = _with_places_on(cells, problem)
        if placed is not None:
            return placed
    return None


def _blocks(costmap: Costmap, block: int) -> Costmap:
    """Return a costmap of square blocks of cells, in which blocks with a blocked cell are blocked."""
    if block <= 1:
        return costmap
    rows, columns = (-(-count // block) for count in costmap.data.shape)
    blocked = np.ones((rows * block, columns * block), dtype=np.bool_)  # also outside of the map
    blocked[: costmap.rows, : costmap.columns] = costmap.data >= LETHAL
    cells = np.where(blocked.reshape(rows, block, columns, block).any(axis=(1, 3)), LETHAL, 0)
    return Costmap(cells.astype(np.uint8), block * costmap.resolution, costmap.origin)


def _with_places_on(cells: Costmap, problem: DockingProblem) -> DockingProblem | None:
    """Return the problem with dock and start in places that are free in `cells`, which block no less than its map."""
    is_reachable, room = _free_places(problem, cells)
    if not is_reachable.any():
        return None
    for dock in _dock_poses(problem, cells, is_reachable, room):
        start = _start_pose(dock, cells, is_reachable, room)
        if start is None or start.distance_to(dock) < _LEAST_APART * problem.robot.footprint.circumscribed_radius:
            continue
        placed = dataclasses.replace(problem, dock=dataclasses.replace(problem.dock, pose=dock), start=start)
        with suppress(OptdockError):
            check_ends(placed)
            return placed
    return None


def _free_places(problem: DockingProblem, cells: Costmap) -> tuple[BoolArray, FloatArray]:
    """Return the largest connected set of cells on which the robot can turn, and the room of every cell [m].

    Shape (rows, columns) each.
    """
    from scipy import ndimage

    is_free = np.pad(cells.data < LETHAL, 1)
    room: FloatArray = ndimage.distance_transform_edt(is_free)[1:-1, 1:-1] * cells.resolution
    needed = problem.robot.footprint.circumscribed_radius + problem.clearance.required + cells.resolution
    labels, count = ndimage.label(room >= needed)
    largest = 1 + int(np.argmax(np.bincount(labels.ravel(), minlength=2)[1:])) if count else -1
    return labels == largest, room


def _dock_poses(problem: DockingProblem, cells: Costmap, is_reachable: BoolArray, room: FloatArray) -> Iterator[Pose2]:
    """Yield docks at walls near the roomiest reachable place, the nearest first, and then the place itself."""
    row, column = np.unravel_index(np.argmax(np.where(is_reachable, room, 0.0)), room.shape)
    x, y = cells.centre_of([[column, row]])[0].tolist()
    reach = float(room[row, column]) + _WALL_REACH
    near = dataclasses.replace(problem, costmap=_part(problem.costmap or cells, (x, y), reach + _WALL_REACH))
    walls = along_walls(near, _WALL_SPACING, Box(x - reach, y - reach, x + reach, y + reach))
    before = -2.0 * problem.robot.footprint.circumscribed_radius
    before = -before if problem.dock.direction is DockDirection.BACKWARD else before
    for place in sorted(walls, key=lambda one: math.hypot(one.pose.x - x, one.pose.y - y)):
        cell = cells.cell_of((place.pose @ Pose2(before, 0.0, 0.0)).as_array()[None, :2])
        if bool(cells.has_cell(cell)[0]) and is_reachable[cell[0, 1], cell[0, 0]]:
            yield rounded_pose(place.pose.x, place.pose.y, place.pose.yaw)
    yield rounded_pose(x, y, 0.0)


def _part(costmap: Costmap, centre: tuple[float, float], reach: float) -> Costmap:
    """Return the part of a costmap within a reach of a point along x and y [m]."""
    x, y = centre
    corners = costmap.cell_of([[x - reach, y - reach], [x + reach, y + reach]])
    (left, low), (right, high) = np.clip(corners, 0, [costmap.columns, costmap.rows]).tolist()
    origin = costmap.origin[0] + costmap.resolution * left, costmap.origin[1] + costmap.resolution * low
    return Costmap(costmap.data[low : high + 1, left : right + 1], costmap.resolution, origin)


def _start_pose(dock: Pose2, cells: Costmap, is_reachable: BoolArray, room: FloatArray) -> Pose2 | None:
    """Return the roomiest reachable pose that is about `_START_DISTANCE` from a dock and heads for it; None if none."""
    (column, row), reach = cells.cell_of([[dock.x, dock.y]])[0], math.ceil(_START_DISTANCE / cells.resolution)
    low, left = max(0, row - reach), max(0, column - reach)
    near = slice(low, row + reach + 1), slice(left, column + reach + 1)
    rows, columns = np.nonzero(is_reachable[near])
    if rows.size == 0:
        return None
    centres = cells.centre_of(np.column_stack((columns + left, rows + low)))
    distance = np.hypot(centres[:, 0] - dock.x, centres[:, 1] - dock.y)
    far = min(_START_DISTANCE, float(distance.max()))
    best = np.argmax(np.where((distance <= far) & (distance >= 0.7 * far), room[near][rows, columns], 0.0))
    x, y = centres[best].tolist()
    return rounded_pose(x, y, math.atan2(dock.y - y, dock.x - x))
