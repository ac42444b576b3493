"""Docking scenarios on maps: at walls, racks, pallets, in niches, through a door and under a table.

Three maps are part of the project (`maps/`, see `draw_maps`). Two real maps (`depot`, `warehouse`) come with Nav2 and
are searched in `$OPTDOCK_DATA/nav2/maps`, by default in `../shared/data/nav2/maps` next to the project.
"""

from __future__ import annotations

import functools
import math
import os
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.geometry.footprint import Footprint
from optdock.geometry.pose import Pose2
from optdock.io.maps import load_map
from optdock.model.clearance_rule import ClearanceRule
from optdock.model.dock import Dock, DockDirection
from optdock.model.limits import MotionLimits
from optdock.model.problem import DockingProblem
from optdock.model.robot import Robot

if TYPE_CHECKING:
    from optdock.model.costmap import Costmap

__all__ = ["DRAWN_SCENARIOS", "HINT", "SCENARIOS", "MapScenario", "maps_folder", "problem_of"]

DRAWN_MAPS = Path(__file__).with_name("maps")
HINT = (
    "depot.yaml and warehouse.yaml with their pictures are in the folder nav2_bringup/maps of "
    "https://github.com/ros-navigation/navigation2; set OPTDOCK_DATA to a folder that holds them as nav2/maps"
)

ROBOT = Robot(
    Footprint.rectangle(0.45, 0.45, 0.6),
    MotionLimits(
        max_speed=0.5,
        max_reverse_speed=0.3,
        max_acceleration=0.5,
        max_deceleration=0.6,
        max_jerk=2.0,
        max_yaw_rate=1.0,
        max_yaw_acceleration=2.0,
        max_lateral_acceleration=0.5,
        max_curvature=1.5,
        max_curvature_rate=6.0,
    ),
)
# A charger 14 cm deep and 50 cm wide, 5 mm before the bumper of the docked robot.
FRONT_CHARGER = Footprint(np.array([[0.455, -0.25], [0.595, -0.25], [0.595, 0.25], [0.455, 0.25]]))
REAR_CHARGER = Footprint(FRONT_CHARGER.vertices * [-1.0, 1.0])


class MapScenario(NamedTuple):
    """Docking task. `start`: pose in the dock's frame [m, m, degrees]; the robot docks at the origin of the frame."""

    name: str
    map_name: str
    goal: tuple[float, float, float]  # [m, m, degrees]
    start: tuple[float, float, float]
    backward: bool = False
    charger: bool = True


# On the maps of this project. Forward: the start lies behind the dock pose (x < 0). Backward: it lies before the dock
# pose (x > 0), and the robot reverses in.
DRAWN_SCENARIOS = (
    MapScenario("hall east wall, aligned", "hall", (11.3, 2.0, 0), (-3.0, 0.0, 0)),
    MapScenario("hall south wall, 0.8 m aside", "hall", (2.5, 0.7, -90), (-3.5, 0.8, 0)),
    MapScenario("hall west wall under the partition", "hall", (0.7, 5.0, 180), (-3.5, 0.6, -30)),
    MapScenario("hall north wall past a pillar", "hall", (3.0, 8.3, 90), (-4.2, -0.9, 25)),
    MapScenario("hall shelf, 60 degrees the wrong way", "hall", (8.4, 6.9, 90), (-5.0, -0.3, -60)),
    MapScenario("hall east wall, backward", "hall", (11.3, 6.6, 180), (3.2, 0.5, 20), backward=True),
    MapScenario("corridor north niche", "corridor", (3.8, 4.85, 90), (-1.8, 0.1, -15)),
    MapScenario("corridor south niche", "corridor", (11.2, 1.3, -90), (-2.0, 0.1, 20)),
    MapScenario("corridor east end past the cabinet", "corridor", (15.3, 3.2, 0), (-4.5, 0.3, -10)),
    MapScenario("corridor through the door", "corridor", (7.4, 6.7, 90), (-3.6, 0.15, 15)),
    MapScenario("corridor west end, backward", "corridor", (0.7, 3.2, 0), (3.5, 0.3, 15), backward=True),
    MapScenario("storage conveyor out of the aisle", "storage", (6.0, 10.6, 90), (-3.5, 0.7, -10)),
    MapScenario("storage bay between pallets", "storage", (14.3, 0.7, -90), (-3.2, 0.4, 20), charger=False),
    MapScenario("storage east wall, 40 degrees off", "storage", (15.3, 8.5, 0), (-3.0, 0.8, -40)),
    MapScenario("storage rack's end", "storage", (7.0, 2.1, 90), (-1.4, -0.1, 20)),
    MapScenario("storage pallet, backward", "storage", (14.2, 9.7, -90), (3.0, -0.6, 15), backward=True),
)

# On Nav2's maps.
SCENARIOS = (
    MapScenario("depot south wall, aligned", "depot", (4.0, 0.98, -90), (-3.0, 0.0, 0)),
    MapScenario("depot south wall, 0.8 m aside", "depot", (5.5, 0.98, -90), (-3.5, 0.8, 0)),
    MapScenario("depot south wall, 60 degrees off to the left", "depot", (11.0, 0.98, -90), (-3.5, -1.0, 60)),
    MapScenario("depot south wall, 60 degrees off to the right", "depot", (12.5, 0.98, -90), (-3.5, 1.0, -60)),
    MapScenario("depot west wall, 45 degrees off", "depot", (1.0, 7.5, 180), (-3.0, 0.6, -45)),
    MapScenario("depot west wall, wrong way 30 degrees", "depot", (1.0, 3.0, 180), (-4.0, 0.8, 30)),
    MapScenario("depot south wall, 60 degrees the wrong way", "depot", (10.0, 0.98, -90), (-5.0, -0.6, -60)),
    MapScenario("depot north wall, beside the pillar", "depot", (8.6, 14.4, 90), (-3.5, -0.5, 20)),
    MapScenario("depot east wall, far", "depot", (29.3, 9.0, 0), (-6.0, 1.5, -30)),
    MapScenario("depot pallet face", "depot", (15.4, 6.92, -90), (-3.5, 0.6, -20), charger=False),
    MapScenario("depot aisle between pallets", "depot", (17.0, 3.4, 90), (-2.6, 0.25, 25), charger=False),
    MapScenario("depot under the table", "depot", (17.25, 11.6, -90), (-3.0, 0.4, 15), charger=False),
    MapScenario("depot under the middle table, kinked", "depot", (21.1, 9.2, -90), (-3.2, -0.35, -10), charger=False),
    MapScenario("depot south wall, backward", "depot", (9.0, 1.2, 90), (3.5, 0.6, 0), backward=True),
    MapScenario("depot west wall, backward, 40 degrees off", "depot", (1.2, 11.5, 0), (3.5, -0.9, -40), backward=True),
    MapScenario("depot north wall, backward", "depot", (20.0, 14.2, -90), (3.0, 0.3, 30), backward=True),
    MapScenario(
        "depot under the table, backward", "depot", (24.85, 11.6, 90), (2.9, -0.4, -10), backward=True, charger=False
    ),
    MapScenario("warehouse west rack, aisle", "warehouse", (-7.15, -12.0, 180), (-2.6, 0.4, -20)),
    MapScenario("warehouse west rack, from along the aisle", "warehouse", (-7.15, -18.0, 180), (-2.8, 1.0, -60)),
    MapScenario("warehouse middle rack, east side", "warehouse", (-0.15, -10.0, 180), (-4.0, -0.8, 35)),
    MapScenario("warehouse east rack, west side", "warehouse", (4.15, -16.0, 0), (-4.0, 0.9, -50)),
    MapScenario("warehouse north rack", "warehouse", (2.0, 10.95, -90), (-3.5, 0.7, 10)),
    MapScenario("warehouse north rack, 55 degrees off", "warehouse", (9.0, 10.95, -90), (-3.5, -0.6, 55)),
    MapScenario("warehouse rack from below", "warehouse", (-2.0, 7.2, 90), (-3.5, -1.0, 30)),
    MapScenario("warehouse conveyor end", "warehouse", (-3.85, 16.2, 90), (-2.5, 0.3, 15)),
    MapScenario("warehouse west wall, backward", "warehouse", (-13.9, -9.0, 0), (3.2, 0.5, 20), backward=True),
    MapScenario("warehouse east rack, backward", "warehouse", (7.95, -12.0, 0), (3.4, -0.6, -30), backward=True),
    MapScenario(
        "warehouse middle rack, backward, kinked", "warehouse", (-3.9, -11.0, 180), (2.8, 0.6, 0), backward=True
    ),
    MapScenario("warehouse between conveyors", "warehouse", (-8.4, 20.6, -90), (-3.5, 0.2, -10), charger=False),
)


def maps_folder() -> Path:
    """Return the directory of Nav2's maps."""
    default = Path(__file__).resolve().parents[2] / "shared" / "data"
    return Path(os.environ.get("OPTDOCK_DATA", default)) / "nav2" / "maps"


@functools.cache
def _costmap(source: Path) -> Costmap:
    return load_map(source).costmap


def problem_of(scenario: MapScenario, maps: Path | None = None) -> DockingProblem:
    """Return the docking problem of a scenario on its whole map.

    Args:
        scenario: The task.
        maps: Directory of Nav2's maps; None: `maps_folder()`.

    Raises:
        InvalidFile: If the map is missing or broken.
    """
    folder = DRAWN_MAPS if scenario in DRAWN_SCENARIOS else maps or maps_folder()
    costmap = _costmap(folder / f"{scenario.map_name}.yaml")
    x, y, degrees = scenario.goal
    goal = Pose2(x, y, math.radians(degrees))
    start = goal @ Pose2(scenario.start[0], scenario.start[1], math.radians(scenario.start[2]))
    outline = (REAR_CHARGER if scenario.backward else FRONT_CHARGER) if scenario.charger else None
    dock = Dock(
        goal,
        outline,
        DockDirection.BACKWARD if scenario.backward else DockDirection.FORWARD,
        final_straight=0.3,
        approach_speed=0.1,
        approach_distance=0.3,
    )
    return DockingProblem(
        start=start,
        dock=dock,
        robot=ROBOT,
        clearance=ClearanceRule(required=0.05, at_dock=0.0, taper=0.5),
        costmap=costmap,
    )
