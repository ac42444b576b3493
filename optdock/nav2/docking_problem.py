"""Docking problem from Nav2's files: parameters, map and dock database."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from optdock.config.scenario import Scenario
from optdock.errors import DockNotInDB, DockNotValid, InvalidFile, InvalidValue
from optdock.geometry.pose import Pose2
from optdock.io.maps import load_map
from optdock.io.numbers import is_number, unit_fault
from optdock.model.dock import Dock
from optdock.model.limits import LIMIT_UNITS, MotionLimits, SpeedZone
from optdock.model.problem import DockingProblem
from optdock.model.robot import Robot
from optdock.nav2.docks import DockEntry, DockTypeParams, docked_pose, load_dock_database
from optdock.nav2.global_costmap import file_costmap
from optdock.nav2.params import load_nav2_params
from optdock.plugins.parameters import closest

if TYPE_CHECKING:
    from optdock.nav2.params import Nav2Params

__all__ = ["Nav2Scenario", "nav2_limits", "nav2_scenario"]

# Motion limit, vector of the velocity smoother, component of the vector, sign of the component.
_SMOOTHER_LIMITS = (
    ("max_speed", "max_velocity", "x", 1),
    ("max_reverse_speed", "min_velocity", "x", -1),
    ("max_acceleration", "max_accel", "x", 1),
    ("max_deceleration", "max_decel", "x", -1),
    ("max_yaw_rate", "max_velocity", "yaw", 1),
    ("max_yaw_rate", "min_velocity", "yaw", -1),
    ("max_yaw_acceleration", "max_accel", "yaw", 1),
    ("max_yaw_acceleration", "max_decel", "yaw", -1),
)
# Components that are checked for plausibility.
_UNITS = {("max_velocity", "x"): "m/s", ("min_velocity", "x"): "m/s"}


@dataclass(frozen=True, eq=False)
class Nav2Scenario(Scenario):
    """A scenario from Nav2's files.

    Args:
        costmap_rows: Pairs of name and result, one for every part of the file's costmaps.
    """

    costmap_rows: tuple[tuple[str, str], ...] = ()


def nav2_scenario(
    params_source: str | Path,
    map_source: str | Path,
    start: Pose2 | str,
    *,
    docks_source: str | Path | None = None,
    dock_name: str | None = None,
) -> Nav2Scenario:
    """Return the problem of driving into a dock that is described in Nav2's files.

    The footprint is the padded footprint of the global costmap. The speeds and accelerations are taken from the
    velocity smoother, and the approach speed and the gear from the docking server and the dock type. Nav2 has no
    curvature limit, no outline of the dock and no clearance in metres; the clearance is `ClearanceRule`'s default. The
    costmap is the global costmap of the file, built over the map by `file_costmap`.

    Args:
        params_source: Parameter file.
        map_source: Map (map_server YAML).
        start: Pose of the robot in the map's frame, or the text `x,y,yaw` [m, m, rad].
        docks_source: Dock database; None for the docks in the parameter file.
        dock_name: Name of the dock; optional if there is exactly one dock.

    Raises:
        InvalidFile: If a file violates its format or has no costmap.
        DockNotValid: If the frame of the dock is not the frame of the map, or its type is not among the parameter
            file's dock types. In a file without dock types every dock is entered forward, which is Nav2's default.
        DockNotInDB: If there is no dock of that name, or there are several docks and no name is given.
        InvalidValue: If the start is not a pose.
    """
    params = load_nav2_params(params_source)
    source = str(docks_source or params_source)
    dock = _selected(params.docks if docks_source is None else load_dock_database(docks_source), dock_name, source)
    costmap_params = params.costmaps.get("global_costmap") or next(iter(params.costmaps.values()), None)
    if costmap_params is None:
        raise InvalidFile(f"{params.source}: names no costmap, so the robot has no footprint")
    if dock.frame != costmap_params.global_frame:
        raise DockNotValid(
            f"{source}: {dock.name}.frame: must be the frame of {costmap_params.name}, "
            f"{costmap_params.global_frame!r}, got {dock.frame!r}; transform the pose into it"
        )
    dock_type, pose = _type_of(dock, params), _start(start)
    zone = _approach(params, dock_type)
    station = Dock(
        docked_pose(dock.pose, dock_type.dock_direction),
        direction=dock_type.dock_direction,
        approach_speed=zone.speed,
        approach_distance=zone.distance,
    )
    built = file_costmap(params, costmap_params, load_map(map_source), pose, station)
    problem = DockingProblem(
        start=pose,
        dock=station,
        robot=Robot(costmap_params.outline, nav2_limits(params)),
        costmap=built.costmap,
        frame=dock.frame,
    )
    return Nav2Scenario(
        problem,
        source=Path(params_source),
        default_limits=frozenset(LIMIT_UNITS) - _given_limits(params).keys(),
        costmap_rows=built.rows,
    )


def _selected(docks: Mapping[str, DockEntry], name: str | None, source: str) -> DockEntry:
    if name is None and len(docks) == 1:
        return next(iter(docks.values()))
    if name in docks:
        return docks[str(name)]
    listed = ", ".join(docks) or "none"
    wanted = "--dock: is required" if name is None else f"--dock: {source} has no dock {name!r}{closest(name, docks)}"
    raise DockNotInDB(f"{wanted}; its docks: {listed}")


def _type_of(dock: DockEntry, params: Nav2Params) -> DockTypeParams:
    known = params.dock_types
    if known and dock.type not in known:
        raise DockNotValid(
            f"{params.source}: has no dock type {dock.type!r}, the type of {dock.name}{closest(dock.type, known)}; its "
            f"dock types: {', '.join(known)}"
        )
    return known.get(dock.type, DockTypeParams(dock.type))


def _start(text: Pose2 | str) -> Pose2:
    if isinstance(text, Pose2):
        return text
    try:
        pose = Pose2.from_sequence([float(part) for part in text.split(",")])
    except ValueError as error:
        raise InvalidValue(f"--start: must be x,y,yaw in m, m, rad, got {text!r}") from error
    fault = unit_fault(pose.yaw, "rad")
    if fault:
        raise InvalidValue(f"--start: yaw {fault}")
    return pose


def nav2_limits(params: Nav2Params) -> MotionLimits:
    """Return the motion limits of the velocity smoother, with the defaults of `MotionLimits`.

    The yaw limit is the smaller of the limits to the left and to the right.

    Raises:
        InvalidFile: If a limit is invalid, such as a maximum velocity that is not > 0.
    """
    try:
        return MotionLimits(**_given_limits(params))
    except InvalidValue as error:
        raise InvalidFile(f"{params.source}: velocity_smoother.{error}") from error


def _given_limits(params: Nav2Params) -> dict[str, float]:
    """Return the motion limits of the velocity smoother, by name."""
    smoother, found = params.node("velocity_smoother"), dict[str, float]()
    for limit, name, axis, sign in _SMOOTHER_LIMITS:
        value = _entry(smoother, name, axis, sign)
        if value is not None:
            found[limit] = min(value, found.get(limit, value))
    return found


def _entry(values: Mapping[str, object], name: str, axis: str, sign: int) -> float | None:
    """Return the magnitude of a component of a vector with three or six numbers, or None if there is no such vector."""
    vector = values.get(name)
    if vector is None:
        return None
    if not (isinstance(vector, list) and len(vector) in (3, 6) and all(map(is_number, vector))):
        raise InvalidValue(f"{name}: must be [x, y, yaw], three numbers, got {vector!r}")
    value = float(vector[0 if axis == "x" else -1])
    if not (math.isfinite(value) and sign * value > 0.0):
        no_reverse = "; robots that cannot reverse are not supported" if name == "min_velocity" else ""
        raise InvalidValue(f"{name}: {axis} must be finite and {'>' if sign > 0 else '<'} 0, got {value}{no_reverse}")
    unit = _UNITS.get((name, axis))
    fault = unit_fault(value, unit) if unit else ""
    if fault:
        raise InvalidValue(f"{name}: {axis} {fault}")
    return sign * value


def _approach(params: Nav2Params, dock_type: DockTypeParams) -> SpeedZone:
    """Return the speed zone that begins at the staging pose, with the speed of the docking controller."""
    controller = params.node("docking_server").get("controller", {})
    place = f"{params.source}: docking_server.controller"
    if not isinstance(controller, Mapping):
        raise InvalidFile(f"{place}: must be a mapping, got {controller!r}")
    speed = controller.get("v_linear_max", 0.25)
    if not (is_number(speed) and 0.0 < speed < math.inf):
        raise InvalidFile(f"{place}.v_linear_max: must be finite and > 0 m/s, got {speed!r}")
    fault = unit_fault(speed, "m/s")
    if fault:
        raise InvalidFile(f"{place}.v_linear_max: {fault}")
    return SpeedZone(float(speed), abs(dock_type.staging_x_offset))
