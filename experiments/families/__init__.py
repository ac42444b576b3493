"""Docking problems drawn at random from named families, identical on every machine.

Every feasible instance has a `witness`: a motion that satisfies every bound, found by construction and not by search.
Every infeasible instance has a reason, which is proven in the docstring of its family.
"""

from __future__ import annotations

import math
import zlib
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from experiments.families import infeasible, open_floor, tight_places
from experiments.families.motion import motion_to, raw_beside
from experiments.families.scene import drawn_costmap
from optdock.errors import InvalidValue
from optdock.geometry.obstacles import ObstacleSet
from optdock.geometry.pose import Pose2, transform_points
from optdock.model.clearance_rule import ClearanceRule
from optdock.model.problem import DockingProblem
from optdock.plugins.parameters import closest

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from experiments.families.scene import Scene
    from optdock.model.costmap import Costmap
    from optdock.model.path import Path

__all__ = ["FAMILIES", "FEASIBLE_FAMILIES", "INFEASIBLE_FAMILIES", "Instance", "instance"]

CLEARANCE = ClearanceRule(required=0.05, at_dock=0.0, taper=0.5)

FEASIBLE_FAMILIES: Mapping[str, Callable[[np.random.Generator], Scene]] = {
    "open_s": open_floor.open_s,
    "alcove": tight_places.alcove,
    "u_dock": tight_places.u_dock,
    "reverse_cusp": open_floor.reverse_cusp,
    "pillar": open_floor.pillar,
    "corridor": tight_places.corridor,
    "clutter": open_floor.clutter,
    "parallel": tight_places.parallel,
    "long_approach": open_floor.long_approach,
    "car_bay": tight_places.car_bay,
    "collision": open_floor.collision,
    "angled_hexagon": open_floor.angled_hexagon,
    "many_obstacles": open_floor.many_obstacles,
    "narrow_gap": tight_places.narrow_gap,
    "reverse_alcove": tight_places.reverse_alcove,
}
INFEASIBLE_FAMILIES: Mapping[str, Callable[[np.random.Generator], Scene]] = {
    "too_close": infeasible.too_close,
    "gap_blocked": infeasible.gap_blocked,
    "approach_blocked": infeasible.approach_blocked,
    "start_collision": infeasible.start_collision,
}
FAMILIES: Mapping[str, Callable[[np.random.Generator], Scene]] = {**FEASIBLE_FAMILIES, **INFEASIBLE_FAMILIES}


@dataclass(frozen=True, eq=False)
class Instance:
    """One docking problem of a family.

    Args:
        family: Name of the family.
        seed: Number of the instance.
        problem: The problem.
        raw_path: Input path of a smoother, as from a planner: correct ends, violated bounds in between.
        feasible: Whether a path with the gears of `raw_path` satisfies every bound; None if unknown.
        expected_reason: `goal_unreachable`, `clearance`, `approach_blocked`, `start_in_collision`; None if feasible.
        witness: A path that satisfies every bound; None if infeasible.
    """

    family: str
    seed: int
    problem: DockingProblem
    raw_path: Path
    feasible: bool | None
    expected_reason: str | None
    witness: Path | None


def instance(family: str, seed: int) -> Instance:
    """Return instance `seed` of a family: always the same problem for the same arguments.

    Args:
        family: One of `FAMILIES`.
        seed: Number of the instance, >= 0.

    Raises:
        InvalidValue: If no family has this name, or the seed is negative.
    """
    if family not in FAMILIES:
        raise InvalidValue(f"family: unknown {family!r}{closest(family, FAMILIES)}; known: {', '.join(FAMILIES)}")
    if seed < 0:
        raise InvalidValue(f"seed: must be >= 0, got {seed}")
    rng = np.random.Generator(np.random.PCG64([zlib.crc32(family.encode()), seed]))
    scene = FAMILIES[family](rng)
    placed = scene.mirrored() if rng.uniform() < 0.5 else scene
    goal = Pose2(rng.uniform(-4.0, 4.0), rng.uniform(-4.0, 4.0), rng.uniform(-math.pi, math.pi))
    return _placed(family, seed, placed, goal)


def _placed(family: str, seed: int, scene: Scene, goal: Pose2) -> Instance:
    motion = motion_to(goal, scene.gears)
    obstacles, costmap = _obstacles(scene, motion, goal)
    problem = DockingProblem(
        start=motion.start,
        dock=scene.dock_at(goal),
        robot=scene.robot,
        obstacles=obstacles,
        clearance=CLEARANCE,
        costmap=costmap,
    )
    return Instance(
        family=family,
        seed=seed,
        problem=problem,
        raw_path=raw_beside(motion, scene.kinks, scene.spacing),
        feasible=scene.feasible,
        expected_reason=scene.reason,
        witness=motion if scene.feasible else None,
    )


def _obstacles(scene: Scene, motion: Path, goal: Pose2) -> tuple[ObstacleSet, Costmap | None]:
    polygons = [transform_points(goal.as_array()[None], polygon)[0] for polygon in scene.obstacles]
    if scene.cell is None:
        return ObstacleSet.from_polygons(polygons), None
    costmap = drawn_costmap(polygons, scene.robot, motion, scene.cell)
    return ObstacleSet.empty(), costmap
