"""Writing of scenario files and their maps."""

from __future__ import annotations

import dataclasses
import math
import os
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import yaml

from optdock.config.plugin_sections import PLUGIN_DEFAULTS
from optdock.errors import InvalidValue
from optdock.io.atomic_file import write_text
from optdock.io.maps import load_map, save_map
from optdock.model.cell_obstacles import mapped_obstacles
from optdock.model.robot import Robot, TrackingTube

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import ArrayLike

    from optdock.config.scenario import Scenario
    from optdock.geometry.footprint import Footprint
    from optdock.geometry.pose import Pose2
    from optdock.model.camera import Camera
    from optdock.model.costmap import Costmap
    from optdock.model.dock import Dock
    from optdock.model.problem import DockingProblem
    from optdock.plugins.registry import PluginChoice

__all__ = ["check_supported", "document_text", "problem_document", "save_scenario", "scenario_document"]


def save_scenario(
    target: str | Path,
    scenario: Scenario,
    *,
    obstacles: Sequence[ArrayLike] | None = None,
    map_source: str | Path | None = None,
    note: str = "",
) -> tuple[Path, ...]:
    """Write a scenario file, format `optdock-scenario/1`, atomically.

    When the file is read, the result is the same problem with identical numbers. The file refers to `map_source` if the
    same cells are occupied as in the costmap; otherwise the costmap is written next to the scenario, as NAME_map.yaml
    and NAME_map.pgm. Default motion limits of the scenario are not written.

    Args:
        target: The file.
        scenario: The scenario.
        obstacles: Obstacles of the problem as polygons, convex or not; None: the convex pieces of the problem are
            written.
        map_source: Map (map_server YAML) of the costmap.
        note: Comment at the top of the file.

    Returns:
        The files written, the scenario first.

    Raises:
        InvalidFile: If a file cannot be written.
        InvalidValue: If unknown cells are free in the problem or the dock has non-default tolerances, for which a
            scenario file has no key.
    """
    target, problem = Path(target), scenario.problem
    check_supported(problem)
    map_name, drawn = _map(target, problem.costmap, map_source)
    document = scenario_document(scenario, map_name=map_name, obstacles=obstacles)
    comment = "".join(f"# {line}\n" for line in note.splitlines())
    write_text(target, comment + document_text(document))
    return (target, *drawn)


def scenario_document(
    scenario: Scenario, *, map_name: str = "", obstacles: Sequence[ArrayLike] | None = None
) -> dict[str, object]:
    """Return the document of a scenario file, without its costmap.

    Args:
        scenario: The scenario.
        map_name: Name of the map; empty if there is no map.
        obstacles: As in `save_scenario`.
    """
    document = problem_document(
        scenario.problem, map_name=map_name, obstacles=obstacles, omitted=scenario.default_limits
    )
    document["time_budget"] = scenario.time_budget
    for kind in PLUGIN_DEFAULTS:
        if getattr(scenario, kind) != getattr(type(scenario), kind):
            document[kind] = _section(getattr(scenario, kind))
    return document


def problem_document(
    problem: DockingProblem,
    *,
    map_name: str = "",
    obstacles: Sequence[ArrayLike] | None = None,
    omitted: frozenset[str] = frozenset(),
) -> dict[str, object]:
    """Return the document of a scenario file for a problem, without its costmap.

    Args:
        problem: The problem.
        map_name: Name of the map; empty if there is no map.
        obstacles: As in `save_scenario`.
        omitted: Names of motion limits that are not written.
    """
    pieces = problem.obstacles.vertices if obstacles is None else obstacles
    document: dict[str, object] = {"format": "optdock-scenario/1", "frame": problem.frame}
    document |= {"map": map_name} if map_name else {}
    document |= {"obstacles": [_points(piece) for piece in pieces]} if len(pieces) else {}
    return document | {
        "robot": _robot(problem.robot, omitted),
        "dock": _dock(problem.dock),
        "start": _start(problem),
        "clearance": dataclasses.asdict(problem.clearance),
    }


def check_supported(problem: DockingProblem) -> None:
    """Check that a scenario file has keys for all values of a problem.

    Raises:
        InvalidValue: If unknown cells are free or the dock has non-default tolerances.
    """
    if problem.costmap is not None and not problem.unknown_is_obstacle:
        raise InvalidValue(
            "problem.unknown_is_obstacle: is always True in a scenario file; mark those cells free in the costmap"
        )
    if problem.dock.tolerances != type(problem.dock.tolerances)():
        raise InvalidValue("dock.tolerances: have no key in a scenario file; set them at the goal checker")


def _map(target: Path, costmap: Costmap | None, source: str | Path | None) -> tuple[str, tuple[Path, ...]]:
    """Return the name of the map in the scenario, and the files written for it."""
    if costmap is None:
        return "", ()
    if source is not None and _blocks_as(load_map(source).costmap, costmap):
        return _name_from(target.parent, Path(source)), ()
    drawn = target.with_name(f"{target.stem}_map.yaml")
    return drawn.name, save_map(drawn, costmap)


def _blocks_as(first: Costmap, second: Costmap) -> bool:
    return mapped_obstacles(first.frozen()).digest == mapped_obstacles(second.frozen()).digest


def _name_from(folder: Path, file: Path) -> str:
    """Return the path of a file relative to a folder, or its absolute path if there is no relative path."""
    try:
        return Path(os.path.relpath(file, folder)).as_posix()
    except ValueError:  # another drive
        return file.resolve().as_posix()


def _robot(robot: Robot, omitted: frozenset[str]) -> dict[str, object]:
    limits = {spec.name: getattr(robot.limits, spec.name) for spec in dataclasses.fields(robot.limits)}
    given = {
        name: value for name, value in limits.items() if name not in omitted and value not in (0.0, math.inf)
    }  # 0 and infinity are the values of missing keys
    others = {
        spec.name: getattr(robot, spec.name)
        for spec in dataclasses.fields(robot)
        if spec.name not in ("footprint", "limits", "drive", "tracking", "camera")
        and getattr(robot, spec.name) != spec.default
    }
    if robot.tracking != TrackingTube():
        others["tracking"] = dataclasses.asdict(robot.tracking)
    if robot.camera is not None:
        others["camera"] = _camera(robot.camera)
    return {"footprint": _outline(robot.footprint), "drive": robot.drive.value, **others, "limits": given}


def _camera(camera: Camera) -> dict[str, object]:
    document: dict[str, object] = {"mount": _pose(camera.mount), "field_of_view": camera.field_of_view}
    document |= {"min_range": camera.min_range} if camera.min_range > 0.0 else {}
    return document | ({"max_range": camera.max_range} if math.isfinite(camera.max_range) else {})


def _dock(dock: Dock) -> dict[str, object]:
    document: dict[str, object] = {"pose": _pose(dock.pose)}
    document |= {"footprint": _outline(dock.footprint)} if dock.footprint is not None else {}
    document |= {"direction": dock.direction.value, "final_straight": dock.final_straight}
    is_slow = dock.approach_distance > 0.0
    document |= {"approach_speed": dock.approach_speed} if is_slow and math.isfinite(dock.approach_speed) else {}
    document |= {"approach_distance": dock.approach_distance} if is_slow else {}
    document |= {"marker": list(dock.marker)} if dock.marker is not None else {}
    distances = {name: getattr(dock, name) for name in ("visible_distance", "blind_distance")}
    return document | {name: value for name, value in distances.items() if value > 0.0}


def _start(problem: DockingProblem) -> dict[str, object]:
    document: dict[str, object] = {"pose": _pose(problem.start)}
    document |= {"speed": problem.start_speed} if problem.start_speed != 0.0 else {}
    document |= {"acceleration": problem.start_acceleration} if problem.start_acceleration != 0.0 else {}
    return document | ({"curvature": problem.start_curvature} if problem.start_curvature is not None else {})


def _section(choice: PluginChoice | tuple[PluginChoice, ...]) -> dict[str, object]:
    """Return the section of a plugin; of several planners, the parameters of the first planner without its name."""
    if isinstance(choice, tuple):
        return dict(choice[0].parameters) if len(choice) > 1 else _section(choice[0])
    return {"plugin": choice.name, **choice.parameters}


def _pose(pose: Pose2) -> list[float]:
    return [float(value) for value in pose.as_array()]


def _outline(footprint: Footprint) -> _Points:
    return _points(footprint.vertices)


class _Points(list[list[float]]):
    """A polygon in flow style."""


def _points(polygon: ArrayLike) -> _Points:
    """Return the vertices of a polygon without the repetitions that pad obstacles to equal numbers of vertices."""
    points: list[list[float]] = np.asarray(polygon, dtype=np.float64).tolist()
    return _Points(point for i, point in enumerate(points) if point != points[i - 1])


class _Dumper(yaml.SafeDumper):
    """PyYAML's dumper, with polygons in flow style."""


_Dumper.add_representer(
    _Points, lambda dumper, points: dumper.represent_sequence("tag:yaml.org,2002:seq", points, flow_style=True)
)


def document_text(document: Mapping[str, object]) -> str:
    """Return the YAML text of a document, with polygons on one line each."""
    text: str = yaml.dump(
        dict(document), Dumper=_Dumper, sort_keys=False, default_flow_style=None, width=120, allow_unicode=True
    )
    return text
