"""Conversion between plain case data and values of the library, through its public interface."""

from __future__ import annotations

from dataclasses import fields
from typing import TYPE_CHECKING

import numpy as np

from optdock.geometry.clothoid import ClothoidSpline
from optdock.geometry.footprint import Footprint
from optdock.geometry.obstacles import ObstacleSet
from optdock.geometry.pose import Pose2
from optdock.model.cell_obstacles import obstacles_from_costmap
from optdock.model.clearance_rule import ClearanceRule
from optdock.model.constant_jerk import TimeLaw
from optdock.model.costmap import Costmap
from optdock.model.dock import Dock, DockDirection
from optdock.model.limits import MotionLimits, SpeedZone
from optdock.model.path import ClothoidSegment, Direction, Path, PolylineSegment, TurnSegment
from optdock.model.problem import DockingProblem
from optdock.model.robot import Drive, Robot, TrackingTube

if TYPE_CHECKING:
    from experiments.fuzz.case import Case

__all__ = ["law_of", "path_of", "path_spec", "problem_of", "problem_spec", "zone_of"]


def path_of(gears: list[Case]) -> Path:
    """Return a path from its gears."""
    return Path(tuple(_segment(gear) for gear in gears))


def _segment(gear: Case) -> ClothoidSegment | PolylineSegment | TurnSegment:
    if gear["type"] == "turn":
        return TurnSegment(Pose2(*gear["start"]), gear["turn"])
    if gear["type"] == "polyline":
        return PolylineSegment(np.array(gear["poses"], dtype=float), Direction(gear["gear"]))
    spline = ClothoidSpline(
        Pose2(*gear["start"]),
        np.array(gear["knots"], dtype=float),
        np.array(gear["curvature"], dtype=float),
        gear["gear"],
    )
    return ClothoidSegment(spline)


def path_spec(path: Path) -> list[Case]:
    """Return the gears of a path of the library."""
    return [_gear_spec(segment) for segment in path.segments]


def _gear_spec(segment: object) -> Case:
    if isinstance(segment, PolylineSegment):
        return {"type": "polyline", "poses": segment.poses.tolist(), "gear": int(segment.direction)}
    if isinstance(segment, TurnSegment):
        return {"type": "turn", "start": segment.pose.as_array().tolist(), "turn": segment.turn, "gear": 0}
    assert isinstance(segment, ClothoidSegment)
    spline = segment.spline
    return {
        "type": "clothoid",
        "start": spline.start.as_array().tolist(),
        "knots": spline.knots.tolist(),
        "curvature": spline.curvature.tolist(),
        "gear": int(spline.sign),
    }


def zone_of(case: Case) -> SpeedZone:
    """Return the slow zone of a case; a speed of None is no limit."""
    speed, distance = case["zone"]
    return SpeedZone(np.inf if speed is None else speed, distance)


def law_of(spec: Case) -> TimeLaw:
    """Return a time law."""
    return TimeLaw(
        np.array(spec["durations"], dtype=float),
        np.array(spec["jerks"], dtype=float),
        start_speed=spec["start_speed"],
        start_acceleration=spec["start_acceleration"],
    )


def law_spec(law: TimeLaw) -> Case:
    """Return a time law in the form read by `law_of`."""
    return {
        "durations": law.durations.tolist(),
        "jerks": law.jerks.tolist(),
        "start_speed": float(law.start_speed),
        "start_acceleration": float(law.start_acceleration),
    }


def problem_of(case: Case) -> DockingProblem:
    """Return the docking problem of a case; with `grid_alone` the grid is passed as a costmap only."""
    shape, dock, grid = case["footprint"], case["dock"], case.get("grid")
    footprint = Footprint(np.array(shape["polygon"])) if "polygon" in shape else Footprint.from_radius(shape["radius"])
    obstacles, costmap = ObstacleSet.from_polygons(case["obstacles"]), None
    if grid is not None:
        costmap = Costmap(np.array(grid["cells"], dtype=np.uint8), grid["resolution"], tuple(grid["origin"]))
        if not case.get("grid_alone"):
            obstacles = obstacles + obstacles_from_costmap(costmap)
    return DockingProblem(
        start=Pose2(*case["start"]),
        dock=Dock(
            Pose2(*dock["pose"]),
            footprint=Footprint(np.array(dock["footprint"])) if dock.get("footprint") else None,
            direction=DockDirection(dock["direction"]),
            final_straight=dock["final_straight"],
            approach_speed=zone_of(case).speed,
            approach_distance=zone_of(case).distance,
        ),
        robot=Robot(
            footprint,
            MotionLimits(**case["limits"]),
            case.get("drive", Drive.DIFFERENTIAL),
            turns_in_place=case.get("turns_in_place", False),
            tracking=TrackingTube(*case.get("tracking", ())),
        ),
        obstacles=obstacles,
        clearance=ClearanceRule(*case["clearance"]),
        start_speed=case["start_speed"],
        start_curvature=case.get("start_curvature"),
        start_acceleration=case.get("start_acceleration", 0.0),
        costmap=costmap,
    )


def problem_spec(problem: DockingProblem) -> Case:
    """Return the case of a problem of the library; obstacles as convex pieces."""
    dock, limits = problem.dock, problem.robot.limits
    approach = dock.approach
    grid = problem.costmap
    return {
        "footprint": {"polygon": problem.robot.footprint.vertices.tolist()},
        "obstacles": [_ring(piece) for piece in problem.obstacles.vertices.tolist()],
        "grid": None
        if grid is None
        else {"cells": grid.data.tolist(), "resolution": grid.resolution, "origin": list(grid.origin)},
        "grid_alone": grid is not None,
        "dock": {
            "pose": dock.pose.as_array().tolist(),
            "footprint": None if dock.footprint is None else dock.footprint.vertices.tolist(),
            "direction": dock.direction.value,
            "final_straight": dock.final_straight,
        },
        "start": problem.start.as_array().tolist(),
        "start_speed": problem.start_speed,
        "start_curvature": problem.start_curvature,
        "start_acceleration": problem.start_acceleration,
        "clearance": list(problem.clearance.parts),
        "limits": {spec.name: getattr(limits, spec.name) for spec in fields(limits)},
        "drive": problem.robot.drive.value,
        "turns_in_place": problem.robot.turns_in_place,
        "tracking": [problem.robot.tracking.cross, problem.robot.tracking.yaw],
        "zone": [approach.speed if np.isfinite(approach.speed) else None, approach.distance],
    }


def _ring(points: list[list[float]]) -> list[list[float]]:
    """Return the corners without the repeated ones that pad a piece."""
    return [point for i, point in enumerate(points) if point != points[i - 1]]
