"""A docking problem from Nav2's own files: parameters, map and dock database."""

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
from optdock.nav2.docks import DockEntry, DockTypeParams, load_dock_database
from optdock.nav2.global_costmap import file_costmap
from optdock.nav2.params import Nav2Params, load_nav2_params
from optdock.plugins.parameters import closest

if TYPE_CHECKING:
    from optdock.nav2.costmap_params import CostmapParams

__all__ = ["Nav2Scenario", "nav2_limits", "nav2_scenario"]

# Our limit, the velocity smoother's vector, which component of it, and that component's sign.
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
# Units of components that are asked about where they are implausible.
_UNITS = {("max_velocity", "x"): "m/s", ("min_velocity", "x"): "m/s"}


@dataclass(frozen=True, eq=False)
class Nav2Scenario(Scenario):
    """A scenario from Nav2's files.

    Args:
        costmap_rows: What became of every part of the file's costmaps: name and outcome.
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
    """The problem of driving into a dock that Nav2's files describe.

    The footprint, padded, is the global costmap's; speeds and accelerations are the velocity smoother's; approach
    speed and gear are the docking server's and the dock type's. Nav2 knows no curvature limit, no outline of the dock
    and no clearance in metres: there are none, but for `ClearanceRule`'s default.

    The costmap is the file's global one, built over the map as `file_costmap` says.

    Args:
        params_source: Parameter file.
        map_source: Map (map_server YAML).
        start: Where the robot is, in the map's frame; or `x,y,yaw` as the command line gives it [m, m, rad].
        docks_source: Dock database; None: the docks in the parameter file.
        dock_name: Which dock; may be None where there is exactly one.

    Raises:
        InvalidFile: A file breaks its format or names no costmap.
        DockNotValid: The dock stands in another frame than the map, or it is of none of the parameter file's dock types
            (a file without any says nothing: forward, as Nav2's default).
        DockNotInDB: There is no dock of that name, or no name and several docks.
        InvalidValue: The start is not a pose.
    """
    params = load_nav2_params(params_source)
    docks = params.docks if docks_source is None else load_dock_database(docks_source)
    dock = _chosen(docks, dock_name, str(docks_source or params_source))
    costmap_params = _global_costmap(params)
    _check_frame(dock, costmap_params, str(docks_source or params_source))
    dock_type, pose = _type_of(dock, params), _start(start)
    zone = _approach(params, dock_type)
    station = Dock(
        dock_type.docked_pose(dock.pose),
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


def _chosen(docks: Mapping[str, DockEntry], name: str | None, source: str) -> DockEntry:
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
            f"{params.source}: has no dock type {dock.type!r}, which {dock.name} is of{closest(dock.type, known)}; its "
            f"dock types: {', '.join(known)}"
        )
    return known.get(dock.type, DockTypeParams(dock.type))


def _global_costmap(params: Nav2Params) -> CostmapParams:
    found = params.costmaps.get("global_costmap") or next(iter(params.costmaps.values()), None)
    if found is None:
        raise InvalidFile(f"{params.source}: names no costmap, so the robot has no footprint")
    return found


def _check_frame(dock: DockEntry, costmap: CostmapParams, source: str) -> None:
    if dock.frame != costmap.global_frame:
        raise DockNotValid(
            f"{source}: {dock.name}.frame: must be the frame of {costmap.name}, {costmap.global_frame!r}, "
            f"got {dock.frame!r}; transform the pose into it"
        )


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
    """Motion limits as the velocity smoother has them; those of `MotionLimits` where it is silent.

    Of two yaw limits, to the left and to the right, the smaller holds for both.

    Raises:
        InvalidFile: A limit is none, such as a largest velocity that is not > 0.
    """
    try:
        return MotionLimits(**_given_limits(params))
    except InvalidValue as error:
        raise InvalidFile(f"{params.source}: velocity_smoother.{error}") from error


def _given_limits(params: Nav2Params) -> dict[str, float]:
    """Those of the motion limits that the velocity smoother has, by name."""
    smoother, found = params.node("velocity_smoother"), dict[str, float]()
    for limit, name, axis, sign in _SMOOTHER_LIMITS:
        value = _entry(smoother, name, axis, sign)
        if value is not None:
            found[limit] = min(value, found.get(limit, value))
    return found


def _entry(values: Mapping[str, object], name: str, axis: str, sign: int) -> float | None:
    """The size of one component of a vector [x, y, yaw] (Nav2 also reads all six), or None without the vector."""
    vector = values.get(name)
    if vector is None:
        return None
    if not (isinstance(vector, list) and len(vector) in (3, 6) and all(map(is_number, vector))):
        raise InvalidValue(f"{name}: must be [x, y, yaw], three numbers, got {vector!r}")
    value = float(vector[0 if axis == "x" else -1])
    if not (math.isfinite(value) and sign * value > 0.0):
        no_reverse = "; a robot that cannot reverse is not known here" if name == "min_velocity" else ""
        raise InvalidValue(f"{name}: {axis} must be finite and {'>' if sign > 0 else '<'} 0, got {value}{no_reverse}")
    unit = _UNITS.get((name, axis))
    fault = unit_fault(value, unit) if unit else ""
    if fault:
        raise InvalidValue(f"{name}: {axis} {fault}")
    return sign * value


def _approach(params: Nav2Params, dock_type: DockTypeParams) -> SpeedZone:
    """The docking controller's speed, from the staging pose on."""
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
