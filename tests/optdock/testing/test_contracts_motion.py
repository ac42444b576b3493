"""The contracts of controllers, behaviors, layers and dock types catch whatever breaks a sentence of theirs."""

import math
from typing import NamedTuple

import numpy as np
from pydantic import Field

from optdock.controllers.tracking_controller import TrackingController
from optdock.errors import ControllerException, PluginError
from optdock.executor import SimpleDock
from optdock.geometry.pose import Pose2, Twist2
from optdock.model.costs import LETHAL
from optdock.model.path import Path
from optdock.nav2.behaviors.drive import DriveOnHeading
from optdock.plugins.interfaces import BehaviorResult, BehaviorStatus, Bounds, Contact, CostmapInfoType, Layer
from optdock.plugins.parameters import PluginParameters
from optdock.testing.contracts import (
    BehaviorContract,
    ControllerContract,
    DockTypeContract,
    LayerContract,
)

Tracking = TrackingController


class Idle(Tracking):
    def compute_velocity_commands(self, pose, velocity, goal_checker, **stamp):
        if self._reference is None:
            return Twist2()
        return super().compute_velocity_commands(pose, velocity, goal_checker, **stamp)


class Wild(Tracking):
    def compute_velocity_commands(self, pose, velocity, goal_checker, **stamp):
        command = super().compute_velocity_commands(pose, velocity, goal_checker, **stamp)
        return Twist2(2.0 * command.linear, command.angular)


class Presuming(Tracking):
    def compute_velocity_commands(self, pose, velocity, goal_checker, **stamp):
        if goal_checker is not None and goal_checker.tolerances.x is None:
            return Twist2()
        return super().compute_velocity_commands(pose, velocity, goal_checker, **stamp)


class ForwardOnly(Tracking):
    def compute_velocity_commands(self, pose, velocity, goal_checker, **stamp):
        command = super().compute_velocity_commands(pose, velocity, goal_checker, **stamp)
        return Twist2(abs(command.linear), command.angular)


class HalfOfPaths(Tracking):
    def set_path(self, path, **start):
        if isinstance(path, Path):
            path = Path.from_poses(path.sample(0.05).poses[:20])
        super().set_path(path)


class Unlimited(Tracking):
    def set_speed_limit(self, limit, percentage):
        pass


class Unchecked(Tracking):
    def set_speed_limit(self, limit, percentage):
        if math.isfinite(limit) and limit >= 0.0:
            super().set_speed_limit(limit, bool(percentage))


class Hasty(Tracking):
    """Reports a stop in the third call."""

    asked = 0

    def cancel(self):
        super().cancel()
        self.asked += 1
        return self.asked > 2


class Never(Tracking):
    def cancel(self):
        return False


class Faster(Hasty):
    def compute_velocity_commands(self, pose, velocity, goal_checker, **stamp):
        command = super().compute_velocity_commands(pose, velocity, goal_checker, **stamp)
        return Twist2(0.49, 0.0) if self.asked else command


class Sulking(Tracking):
    sulks = False

    def cancel(self):
        self.sulks = True
        return super().cancel()

    def compute_velocity_commands(self, pose, velocity, goal_checker, **stamp):
        command = super().compute_velocity_commands(pose, velocity, goal_checker, **stamp)
        return Twist2() if self.sulks else command


class Lost(Tracking):
    def compute_velocity_commands(self, pose, velocity, goal_checker, **stamp):
        try:
            return super().compute_velocity_commands(pose, velocity, goal_checker, **stamp)
        except ControllerException:
            if self._reference is None:
                raise
            return Twist2(5.0, 0.0)


def test_every_gate_of_controllers_can_fail(every_gate):
    broken = {
        "test_without_a_path_there_is_no_command": [Idle],
        "test_it_drives_to_the_end_within_the_limits": [Wild, Presuming, HalfOfPaths],
        "test_a_reverse_gear_is_driven_or_refused": [ForwardOnly],
        "test_a_speed_limit_holds_until_it_is_removed": [Unlimited, Unchecked],
        "test_cancelling_ends_in_a_stop": [Hasty, Never, Faster, Sulking],
        "test_a_robot_far_from_its_path_gets_an_error_or_a_command": [Lost],
    }
    every_gate(
        ControllerContract, Tracking, broken, errors=(ControllerException,), is_installed=True, unitless={"damping"}
    )


DRIVE = {"target": 1.0, "speed": 0.3}


class Restless(DriveOnHeading):
    def on_cycle_update(self, pose, velocity):
        result, _ = super().on_cycle_update(pose, velocity)
        return result, Twist2(0.1)


class Eager(DriveOnHeading):
    def on_cycle_update(self, pose, velocity):
        if self._motion is None:
            return BehaviorResult(BehaviorStatus.RUNNING), Twist2(0.1)
        return super().on_cycle_update(pose, velocity)


class OnceOnly(DriveOnHeading):
    def on_run(self, command):
        return BehaviorResult(BehaviorStatus.SUCCEEDED) if self._motion else super().on_run(command)


class WrongCode(DriveOnHeading):
    def on_run(self, command):
        result = super().on_run(command)
        return result if result.error_code == 0 else BehaviorResult(result.status, 720, result.error_msg)


class GoesOn(DriveOnHeading):
    def on_run(self, command):
        earlier = self._motion
        result = super().on_run(command)
        self._motion = self._motion or earlier
        return result


class TakesNan(DriveOnHeading):
    def on_run(self, command):
        return super().on_run({k: 1.0 if str(v) == "nan" else v for k, v in command.items()})


class Patient(DriveOnHeading):
    def on_run(self, command):
        return super().on_run({**command, "time_allowance": 0.0} if "target" in command else command)


class Blind(DriveOnHeading):
    def on_run(self, command):
        return super().on_run({**command, "disable_collision_checks": True})


class Shortsighted(DriveOnHeading):
    """Asks for the global costmap and checks the local one."""

    resource_info = CostmapInfoType.GLOBAL

    def _collision(self, *motion):
        return DriveOnHeading._collision(Local(self.context, self.parameters), *motion)


class Local(NamedTuple):
    context: object
    parameters: object
    resource_info: object = CostmapInfoType.LOCAL


def test_every_gate_of_behaviors_can_fail(every_gate):
    broken = {
        "test_it_names_its_costmaps_and_needs_on_run": [
            type("Broken", (DriveOnHeading,), {"resource_info": "local"}),
            Eager,
        ],
        "test_it_runs_and_ends_at_rest": [Restless, OnceOnly],
        "test_a_bad_command_is_refused_with_its_code": [WrongCode, GoesOn, TakesNan],
        "test_it_gives_up_after_its_time_allowance": [Patient],
        "test_it_does_not_drive_into_obstacles": [Blind],
        "test_it_reads_the_costmap_that_it_names": [Shortsighted],
    }
    sample = {
        "needs_context": True,
        "command": DRIVE,
        "timed_command": {**DRIVE, "time_allowance": 3.0},
        "bad_commands": ({}, {**DRIVE, "speed": -0.3}),
        "invalid_code": 724,
        "timeout_code": 721,
        "blocked_code": 723,
    }
    every_gate(BehaviorContract, DriveOnHeading, broken, **sample)


class SpotParameters(PluginParameters):
    enabled: bool = Field(default=True, description="whether it takes part")
    side: float = Field(0.1, gt=0.0, description="of a spot [m]")


class Spots(Layer):
    """Marks what it is shown."""

    Parameters = SpotParameters
    parameters: SpotParameters

    def __init__(self, **parameters):
        super().__init__(**parameters)
        self.points = []
        self.fresh = True

    def reset(self):
        self.points = []

    def update_bounds(self, robot, bounds):
        xs, ys = ([p[k] for p in self.points] for k in (0, 1))
        low = min([bounds.min_x, *xs]), min([bounds.min_y, *ys])
        return Bounds(*low, max([bounds.max_x, *xs]), max([bounds.max_y, *ys]))

    def update_costs(self, master, min_i, min_j, max_i, max_j):
        if not self.points:
            return
        cells = master.cell_of(self.points)
        inside = np.all((cells >= (min_i, min_j)) & (cells < (max_i, max_j)), axis=1)
        master.data[cells[inside, 1], cells[inside, 0]] = LETHAL

    def is_clearable(self):
        return True

    def is_enabled(self):
        return self.parameters.enabled


def spots(**methods):
    return type("Broken", (Spots,), methods)


def write_everywhere(self, master, min_i, min_j, max_i, max_j):
    Spots.update_costs(self, master, 0, 0, master.columns, master.rows)


def write_once(self, master, *window):
    Spots.update_costs(self, master, *window)
    self.points = []


def own_bounds_only(self, robot, bounds):
    return Spots.update_bounds(self, robot, Bounds(math.inf, math.inf, -math.inf, -math.inf))


def feed(suite, layer):
    layer.points = [[0.3, 0.4], [1.0, -0.7]]


def test_every_gate_of_layers_can_fail(every_gate):
    nan = Bounds(math.nan, math.nan, math.nan, math.nan)
    broken = {
        "test_costs_are_written_within_the_announced_bounds": [
            spots(update_costs=lambda *_: None),
            spots(update_bounds=lambda self, robot, bounds: bounds),
        ],
        "test_bounds_only_grow": [spots(update_bounds=own_bounds_only), spots(update_bounds=lambda *_: nan)],
        "test_costs_outside_the_window_stay": [spots(update_costs=write_everywhere)],
        "test_every_update_writes_the_costs_again": [
            spots(update_costs=write_once),
            spots(is_current=lambda self: self.fresh, match_size=lambda self: setattr(self, "fresh", False)),
        ],
        "test_reset_removes_observations": [spots(reset=lambda self: None)],
        "test_flags_are_booleans_and_follow_updates": [
            spots(is_current=lambda self: 1),
            spots(is_current=lambda self: False),
            spots(is_current=lambda self: True),
        ],
        "test_a_disabled_layer_writes_nothing": [spots(is_enabled=lambda self: True)],
    }
    every_gate(LayerContract, Spots, broken, feed=feed)


class Touched(SimpleDock):
    """Says that it is touched in words of its own."""

    def contact(self, now):
        return super().contact(now) and "touched"


class Believing(SimpleDock):
    def contact(self, now):
        return super().contact(now) or (None if now.measurements.contact is False else Contact.SIGNAL)


class Remembering(SimpleDock):
    """Once touched, touched for ever."""

    felt = None

    def contact(self, now):
        self.felt = super().contact(now) or self.felt
        return self.felt


class Dividing(SimpleDock):
    """Takes it that time goes on."""

    before = 0.0

    def contact(self, now):
        rate, self.before = 1.0 / (now.stamp - self.before), now.stamp
        return super().contact(now) if rate > 0.0 else None

    def reset(self):
        self.before = 0.0


class Inside(SimpleDock):
    def staging_poses(self, gear, distance):
        return [*super().staging_poses(gear, distance), Pose2(0.0, 0.0, 0.0)]


class Doubling(SimpleDock):
    def detections(self, measurements):
        return measurements.detections * 2


class Rooted(SimpleDock):
    back_out_distance = 0.0


def test_every_gate_of_dock_types_can_fail(every_gate):
    broken = {
        "test_results_have_the_right_types_in_every_cycle": [Touched, Dividing, Rooted],
        "test_a_robot_far_away_without_a_signal_has_no_contact": [Believing],
        "test_a_reset_clears_the_contact": [Remembering],
        "test_staging_poses_are_outside_the_dock": [Inside],
        "test_detections_come_from_detections": [Doubling],
    }
    every_gate(DockTypeContract, SimpleDock, broken, errors=(PluginError, ZeroDivisionError))
