"""Scenario files out: a scenario as `load_scenario` reads it, with its map beside it where no file says the same."""

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

__all__ = ["problem_document", "save_scenario"]


def save_scenario(
    target: str | Path,
    scenario: Scenario,
    *,
    obstacles: Sequence[ArrayLike] | None = None,
    map_source: str | Path | None = None,
    note: str = "",
) -> tuple[Path, ...]:
    """Write a scenario file, format `optdock-scenario/1`, whole or not at all.

    What is written reads back as the same problem, number by number. A costmap is a file of its own: `map_source` is
    named where its cells block the same; else the cells are drawn beside the scenario, as NAME_map.yaml and
    NAME_map.pgm. Motion limits that the scenario's own source did not give stay unsaid.

    Args:
        target: The file.
        scenario: What to write.
        obstacles: The problem's obstacles as polygons, convex or not, where they are known so; None: its convex pieces.
        map_source: A map (map_server YAML) that the costmap may have been made from.
        note: A line of comment at the top.

    Returns:
        The files written, the scenario first.

    Raises:
        InvalidFile: A file cannot be written.
        InvalidValue: A scenario file cannot say it: unknown cells that are free, or tolerances of the dock.
    """
    target, problem = Path(target), scenario.problem
    _refuse_unsayable(problem)
    map_name, drawn = _map(target, problem.costmap, map_source)
    document = problem_document(problem, map_name=map_name, obstacles=obstacles, unsaid=scenario.default_limits)
    document["time_budget"] = scenario.time_budget
    for kind in PLUGIN_DEFAULTS:
        if getattr(scenario, kind) != getattr(type(scenario), kind):
            document[kind] = _section(getattr(scenario, kind))
    comment = "".join(f"# {line}\n" for line in note.splitlines())
    write_text(target, comment + _yaml(document))
    return (target, *drawn)


def problem_document(
    problem: DockingProblem,
    *,
    map_name: str = "",
    obstacles: Sequence[ArrayLike] | None = None,
    unsaid: frozenset[str] = frozenset(),
) -> dict[str, object]:
    """A problem in the words of a scenario file, without its costmap and what no such file can say.

    Args:
        problem: What to say.
        map_name: What its costmap is called; empty: nothing is said of one.
        obstacles: As in `save_scenario`.
        unsaid: Motion limits to leave out.
    """
    pieces = problem.obstacles.vertices if obstacles is None else obstacles
    document: dict[str, object] = {"format": "optdock-scenario/1", "frame": problem.frame}
    document |= {"map": map_name} if map_name else {}
    document |= {"obstacles": [_points(piece) for piece in pieces]} if len(pieces) else {}
    return document | {
        "robot": _robot(problem.robot, unsaid),
        "dock": _dock(problem.dock),
        "start": _start(problem),
        "clearance": dataclasses.asdict(problem.clearance),
    }


def _refuse_unsayable(problem: DockingProblem) -> None:
    if problem.costmap is not None and not problem.unknown_is_obstacle:
        raise InvalidValue(
            "problem.unknown_is_obstacle: a scenario file says True; mark those cells free in the costmap"
        )
    if problem.dock.tolerances != type(problem.dock.tolerances)():
        raise InvalidValue("dock.tolerances: a scenario file has none; give them to the goal checker")


def _map(target: Path, costmap: Costmap | None, source: str | Path | None) -> tuple[str, tuple[Path, ...]]:
    """What the scenario calls its map, and the files drawn for it."""
    if costmap is None:
        return "", ()
    if source is not None and _blocks_as(load_map(source).costmap, costmap):
        return _name_from(target.parent, Path(source)), ()
    drawn = target.with_name(f"{target.stem}_map.yaml")
    return drawn.name, save_map(drawn, costmap)


def _blocks_as(first: Costmap, second: Costmap) -> bool:
    return mapped_obstacles(first.frozen()).digest == mapped_obstacles(second.frozen()).digest


def _name_from(folder: Path, file: Path) -> str:
    """The file as seen from a folder; absolute where no relative path leads there."""
    try:
        return Path(os.path.relpath(file, folder)).as_posix()
    except ValueError:  # another drive
        return file.resolve().as_posix()


def _robot(robot: Robot, unsaid: frozenset[str]) -> dict[str, object]:
    limits = {spec.name: getattr(robot.limits, spec.name) for spec in dataclasses.fields(robot.limits)}
    said = {
        name: value for name, value in limits.items() if name not in unsaid and value not in (0.0, math.inf)
    }  # zero and infinity are what a key that is not there stands for
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
    return {"footprint": _outline(robot.footprint), "drive": robot.drive.value, **others, "limits": said}


def _camera(camera: Camera) -> dict[str, object]:
    said: dict[str, object] = {"mount": _pose(camera.mount), "field_of_view": camera.field_of_view}
    said |= {"min_range": camera.min_range} if camera.min_range > 0.0 else {}
    return said | ({"max_range": camera.max_range} if math.isfinite(camera.max_range) else {})


def _dock(dock: Dock) -> dict[str, object]:
    said: dict[str, object] = {"pose": _pose(dock.pose)}
    said |= {"footprint": _outline(dock.footprint)} if dock.footprint is not None else {}
    said |= {"direction": dock.direction.value, "final_straight": dock.final_straight}
    zone = {"approach_speed": dock.approach_speed, "approach_distance": dock.approach_distance}
    said |= zone if math.isfinite(dock.approach_speed) and dock.approach_distance > 0.0 else {}
    said |= {"marker": list(dock.marker)} if dock.marker is not None else {}
    distances = {name: getattr(dock, name) for name in ("visible_distance", "blind_distance")}
    return said | {name: value for name, value in distances.items() if value > 0.0}


def _start(problem: DockingProblem) -> dict[str, object]:
    said: dict[str, object] = {"pose": _pose(problem.start)}
    said |= {"speed": problem.start_speed} if problem.start_speed != 0.0 else {}
    said |= {"acceleration": problem.start_acceleration} if problem.start_acceleration != 0.0 else {}
    return said | ({"curvature": problem.start_curvature} if problem.start_curvature is not None else {})


def _section(choice: PluginChoice | tuple[PluginChoice, ...]) -> dict[str, object]:
    """A plugin with its parameters; of several planners the parameters of the first, which needs no name."""
    if isinstance(choice, tuple):
        return dict(choice[0].parameters) if len(choice) > 1 else _section(choice[0])
    return {"plugin": choice.name, **choice.parameters}


def _pose(pose: Pose2) -> list[float]:
    return [float(value) for value in pose.as_array()]


def _outline(footprint: Footprint) -> _Points:
    return _points(footprint.vertices)


class _Points(list[list[float]]):
    """A polygon, on as few lines as it needs."""


def _points(polygon: ArrayLike) -> _Points:
    """Corners, without the repeated ones that pad a piece."""
    points: list[list[float]] = np.asarray(polygon, dtype=np.float64).tolist()
    return _Points(point for i, point in enumerate(points) if point != points[i - 1])


class _Dumper(yaml.SafeDumper):
    """PyYAML's, with polygons in brackets and mappings of numbers in braces."""


_Dumper.add_representer(
    _Points, lambda dumper, points: dumper.represent_sequence("tag:yaml.org,2002:seq", points, flow_style=True)
)


def _yaml(document: Mapping[str, object]) -> str:
    text: str = yaml.dump(
        dict(document), Dumper=_Dumper, sort_keys=False, default_flow_style=None, width=120, allow_unicode=True
    )
    return text
