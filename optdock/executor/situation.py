"""What is known of the task at this moment: where the robot stands, what it sees and touches, what may be asked for."""

from __future__ import annotations

import dataclasses
import math
from typing import TYPE_CHECKING, Any

import numpy as np

from optdock.costmap.cell_obstacles import obstacles_from_costmap
from optdock.executor.approach import can_be_planned_away, staging_distance
from optdock.executor.contact_zone import with_contact_zone
from optdock.executor.interruptions import HELD, Interrupted
from optdock.executor.outcomes import EndingKind
from optdock.geometry.obstacles import ObstacleSet
from optdock.geometry.pose import Pose2, Twist2, normalize_angle
from optdock.model.dock import Dock, DockDirection
from optdock.model.measurements import AtDock
from optdock.model.problem import ClearanceRule
from optdock.model.robot import Drive
from optdock.plugins.outcomes import Contact

if TYPE_CHECKING:
    from collections.abc import Callable

    from optdock.costmap.costmap import Costmap
    from optdock.executor.checked_dock_type import CheckedDockType
    from optdock.executor.perception import Perception
    from optdock.executor.settings import ExecutorSettings
    from optdock.geometry.footprint import Footprint
    from optdock.model.problem import DockingProblem

__all__ = ["AT_A_STAND", "LONGEST_HIDDEN", "NO_ROOM", "Situation"]

_AT_REST = 0.01, 0.02  # [m/s], [rad/s] by odometry: a robot that stands, its encoders not quite
# [m], [s] for which odometry takes the robot among the obstacles of the map while the dock is in view: by wheels of 1 %
# it is then 1 cm off, a fifth of a usual clearance; the last metre before a dock takes less time.
_UNLOCATED = 1.0, 10.0
_LOCATED = 0.01  # [m], standard deviation: what the odometry of that way may add
_SAME_DOCK = 0.01  # [m], [rad]: a dock that is seen elsewhere by less stands in the same cells
# Standard deviations that the accepted errors of the dock must hold: one docking in 400 is then off by one more, were
# the robot believed to stand at the edge of what is accepted; it is believed to stand in the middle.
_CERTAINTY = 2.0
_BLINK = 1.0  # [s] without a detection that nothing is made of
LONGEST_HIDDEN = 3.0  # [s] without one, after which a robot that is not sure looks for it before it drives on
_HIDDEN = 0.8  # [s] without one, where the dock was seen before: of ten a second, half of them lost, one gap in 250
_ALIGNED, _NOISE = 0.3, 1.0  # of the tolerance, standard deviations: a heading that is less off stays as it is
_SHORT = 0.5  # of the tolerance: most robots that falsely called themselves docked believed to stand so far before it
_BESIDE = 0.4  # of the tolerance: with more a robot that is straight again is better off with another approach
_LARGEST_TURN = 0.1  # [rad] at a dock: the corners of a usual robot then move by 3 cm
_WHEELS_WITHIN = 0.9  # of the radius of the inscribed circle, if the robot has no track width
_NEAR = 0.25  # [m]: from farther a camera that is blind before the dock sees it
NO_ROOM = 0.03  # [m] before the dock nothing can be corrected any more
_LAST_LOOK = 0.2  # [m] before the dock: as near it drives without being sure, for a detection may come on the way
_ARRIVED = 0.05, 0.05  # [m], [rad] from the staging pose: Nav2's undock_linear_tolerance and undock_angular_tolerance
_DOCKED_BY = {Contact.SIGNAL: EndingKind.DOCKED_BY_SIGNAL, Contact.STALL: EndingKind.DOCKED_BY_STALL}
AT_A_STAND: dict[str, Any] = {"start_speed": 0.0, "start_acceleration": 0.0, "start_curvature": None}


class Situation:
    """Questions about robot, dock and surroundings, answered from the measurements so far.

    Args:
        problem: Robot, dock as stored, obstacles, clearance; its start plays no part.
        settings: How the task is to be done.
        perception: Brought up to date before every cycle.
        dock_type: Says where approaches begin, and what contact and charge are.
        report: Takes the name of an event and its detail.

    Attributes:
        interruption: Name and reason of what stops a motion from outside, such as a clock that jumped; empty: nothing.
        commanded: The last command; set before every cycle.
        approach_gear: Of the last piece of the motion into the dock that was driven last; None before.
        felt: The contact that the dock type feels in this cycle, wherever the robot is.
    """

    def __init__(
        self,
        problem: DockingProblem,
        settings: ExecutorSettings,
        perception: Perception,
        dock_type: CheckedDockType,
        report: Callable[[str, str], None],
    ) -> None:
        self.problem, self.settings, self.perception, self._report = problem, settings, perception, report
        self.dock_type = dock_type
        self.interruption = ("", "")
        self.commanded = Twist2()
        self.approach_gear: float | None = None
        self.felt: Contact | None = None
        self._is_far_contact_said = False
        self._cleared: tuple[Costmap | None, Costmap | None, Pose2] = (None, None, problem.goal)

    @property
    def dock(self) -> Dock:
        """The dock where it is seen."""
        return dataclasses.replace(self.problem.dock, pose=self.perception.dock)

    @property
    def footprint(self) -> Footprint:
        """The robot's outline."""
        return self.problem.robot.footprint

    @property
    def is_commanded_to_rest(self) -> bool:
        """Whether the commands have come to rest."""
        return self.commanded == Twist2()

    @property
    def now(self) -> float:
        """Stamp of the last measurements, on the clock that never goes back [s]."""
        return self.perception.stamp

    @property
    def twist(self) -> Twist2:
        """The robot's body velocity by odometry."""
        measurements = self.perception.measurements
        return Twist2() if measurements is None else measurements.twist

    @property
    def stands(self) -> bool:
        """Whether the robot stands, by its commands and its odometry."""
        return (
            self.is_commanded_to_rest
            and abs(self.twist.linear) <= _AT_REST[0]
            and abs(self.twist.angular) <= _AT_REST[1]
        )

    @property
    def braking_time(self) -> float:
        """From the largest speed to rest [s], see `braking_time_from`."""
        return self.braking_time_from(self.problem.robot.limits.max_speed)

    def braking_time_from(self, speed: float) -> float:
        """From a speed [m/s] to rest, at most: exact where the deceleration reaches its limit on the way [s]."""
        limits = self.problem.robot.limits
        return speed / limits.max_deceleration + limits.max_deceleration / limits.max_jerk

    @property
    def has_signal(self) -> bool:
        """Whether a signal says that the robot is docked."""
        return self.felt is Contact.SIGNAL

    @property
    def is_charging(self) -> bool:
        """Whether the battery is being charged."""
        measurements = self.perception.measurements
        return measurements is not None and self.dock_type.is_charging(measurements)

    @property
    def distance(self) -> float:
        """Of the robot from the docked pose [m]."""
        relative = self.perception.robot_from_dock
        return math.hypot(relative.x, relative.y)

    @property
    def left(self) -> float:
        """Along the dock's axis to the docked pose, or back to it [m]."""
        return abs(self.perception.robot_from_dock.x)

    @property
    def reach_of_contact(self) -> float:
        """As far from the estimated dock contact may be made: what the estimate may be wrong comes on top [m]."""
        return self.settings.contact_range + 3.0 * self.perception.sigma[0]

    @property
    def is_near(self) -> bool:
        """Whether the robot is as near to the docked pose as contact is possible."""
        return self.distance <= self.reach_of_contact

    @property
    def where(self) -> str:
        """The robot seen from the docked pose, for a message."""
        (x, *_), (y, *_), (yaw, *_) = self.errors_in_dock()
        return f"{x:.4f} m along, {y:.4f} m across and {yaw:.4f} rad from the docked pose"

    @property
    def detection_is_old(self) -> bool:
        """Whether the dock has not been seen for so long that the robot would not know at the dock where it stands."""
        age, settings = self.perception.detection_age, self.settings
        left = self.left
        if age <= _BLINK or self.distance <= settings.detection_blind_distance:
            return False
        patience = settings.detection_patience
        if patience is not None and age > patience:
            return True
        return (left <= _LAST_LOOK or age > LONGEST_HIDDEN) and not self.will_know(left)

    @property
    def is_dock_hidden(self) -> bool:
        """Whether the dock is not seen where it should be, with some way left on which an error could be corrected.

        A camera that is blind before the dock has never seen it from near; then there is nothing to wait for, if the
        robot will know without it where it stands. After `LONGEST_HIDDEN` it is not waited for any longer.
        """
        age, left = self.perception.detection_age, self.left
        if not (_HIDDEN < age <= LONGEST_HIDDEN and NO_ROOM < left <= _LAST_LOOK):
            return False
        is_visible = self.distance > self.settings.detection_blind_distance
        return is_visible and (self.sees_from_near or not self.will_know(left))

    @property
    def sees_from_near(self) -> bool:
        """Whether the dock has been seen from as near as the last look before it is taken."""
        return self.perception.seen_from <= _NEAR

    @property
    def _is_dock_confirmed(self) -> bool:
        """Whether the dock was seen as often as it must be, and nothing newer contradicts that."""
        perception = self.perception
        return perception.detections >= self.settings.least_detections and not perception.is_contradicted

    @property
    def is_dock_known(self) -> bool:
        """Whether the dock was seen on the way here, often and well enough to be driven to."""
        accepted = self.problem.dock.tolerances
        (place, turn), most = self.perception.sigma, min(accepted.along, accepted.cross)
        is_sure = _CERTAINTY * place <= most and _CERTAINTY * turn <= accepted.yaw
        return self._is_dock_confirmed and is_sure and not self.detection_is_old

    @property
    def is_dock_found(self) -> bool:
        """Whether the dock was seen on the way here, often and well enough to be approached.

        What is not known of it yet can still be corrected on the second half of the way in.
        """
        if self.is_dock_known:
            return True
        place, turn = (_CERTAINTY * sigma for sigma in self.perception.sigma)
        way, limits = 0.5 * self.left - self.problem.dock.final_straight, self.problem.robot.limits
        is_recent = self.perception.detection_age <= LONGEST_HIDDEN and not self.detection_is_old
        return self._is_dock_confirmed and is_recent and can_be_planned_away(place, turn, way, 1.0, limits)

    @property
    def is_in_doubt(self) -> bool:
        """Whether the robot may stand within the tolerances of the dock as well as beside them, by what is known."""
        if self.may_have_turned or self.perception.is_contradicted or not self.will_know(0.0):
            return True
        return any(abs(abs(error) - most) < _CERTAINTY * sigma for error, sigma, most in self.errors_in_dock())

    def stands_in_dock(self, certainty: float) -> bool:
        """Whether the robot stands within the tolerances of the dock, and is not only believed to at their edge.

        Args:
            certainty: Standard deviations by which it is to stand within them, as far as that leaves half of them.
        """
        return all(
            abs(error) <= max(most - certainty * sigma, 0.5 * most) for error, sigma, most in self.errors_in_dock()
        )

    @property
    def nudge_to_dock(self) -> Twist2:
        """The way [m] and the turn [rad] after which the robot stands in its dock, where no more than these is missing.

        An error across neither of them takes back.
        """
        if self.problem.robot.drive is not Drive.DIFFERENTIAL or self.dock_type.is_pressed_on:
            return Twist2()
        (along, _, most_along), (across, _, most_across), (yaw, sigma, most) = self.errors_in_dock()
        is_beside = abs(across) > _BESIDE * most_across and not self.stands_in_dock(0.0)
        if is_beside or self.left > _LAST_LOOK or abs(yaw) > _LARGEST_TURN:
            return Twist2()
        is_short = _SHORT * most_along < self.gear * -along <= NO_ROOM
        is_turned = abs(yaw) > max(_ALIGNED * most, _NOISE * sigma)
        return Twist2(-along if is_short else 0.0, -yaw if is_turned else 0.0)

    @property
    def _lever(self) -> float:
        """Half of the distance between the wheels, as far as it is known [m]."""
        width = self.problem.robot.limits.track_width
        return 0.5 * width if width > 0.0 else _WHEELS_WITHIN * self.footprint.inscribed_radius

    def rims(self, linear: float, angular: float) -> tuple[float, float]:
        """Ways or speeds of the left and the right wheel [m], [m/s] in a motion of the robot [m, rad], [m/s, rad/s]."""
        return linear - self._lever * angular, linear + self._lever * angular

    def body_motion(self, left: float, right: float) -> Twist2:
        """The motion of the robot whose wheels roll so far, or so fast; see `rims`."""
        return Twist2(0.5 * (left + right), 0.5 * (right - left) / self._lever)

    def errors_in_dock(self) -> list[tuple[float, float, float]]:
        """Errors in the dock, their standard deviations and tolerances: along, across [m], yaw in (-pi, pi] [rad]."""
        accepted, found = self.problem.dock.tolerances, self.perception.robot_from_dock
        sigma = self.perception.sigma_after(0.0)
        tolerances = accepted.along, accepted.cross, accepted.yaw
        return list(zip((found.x, found.y, normalize_angle(found.yaw)), sigma, tolerances, strict=True))

    @property
    def may_have_turned(self) -> bool:
        """Whether the localization says that the robot has turned out of its dock since that was seen."""
        return self.settings.use_detections and abs(self.perception.unseen_turn) > self.problem.dock.tolerances.yaw

    def will_know(self, left: float) -> bool:
        """Whether the tolerances of the dock can be told from the noise after so much more of the way [m]."""
        sigma, accepted = self.perception.sigma_after(self.gear * left), self.problem.dock.tolerances
        asked = zip(sigma, (accepted.along, accepted.cross, accepted.yaw), strict=True)
        return all(_CERTAINTY * found <= most for found, most in asked)

    @property
    def gear(self) -> float:
        """Of the last motion into the dock."""
        direction = self.problem.dock.direction
        if direction is DockDirection.AUTO:
            if self.approach_gear is not None:
                return self.approach_gear  # also of a robot that stands a little beyond the docked pose
            return 1.0 if self.perception.robot_from_dock.x <= 0.0 else -1.0
        return 1.0 if direction is DockDirection.FORWARD else -1.0

    def staging_poses(self) -> tuple[Pose2, ...]:
        """Where an approach may begin, in the fixed frame, the preferred one first."""
        distance = self.settings.staging_distance or staging_distance(self.problem)
        return tuple(self.perception.dock @ pose for pose in self.dock_type.staging_poses(self.gear, distance))

    def from_staging(self) -> float:
        """Nav2's norm of the way to the nearest staging pose, metres and radians mixed."""
        gaps = [self.perception.robot.in_frame_of(place) for place in self.staging_poses()]
        return min(math.sqrt(gap.x**2 + gap.y**2 + gap.yaw**2) for gap in gaps)

    def facing_poses(self) -> tuple[Pose2, ...]:
        """The staging poses turned round: from where a camera sees a dock that is entered the other way."""
        return tuple(place @ Pose2(0.0, 0.0, math.pi) for place in self.staging_poses())

    def may_see_dock_from(self, places: tuple[Pose2, ...]) -> bool:
        """Whether the marker may be in the camera's view from one of some poses; True where either is not known."""
        camera, marker = self.problem.robot.camera, self.dock.marker_in_world
        if camera is None or marker is None:
            return True
        seen = camera.points_seen(np.array([place.as_array() for place in places]), marker)
        return bool(np.any(camera.margins(seen).smallest > -3.0 * self.perception.sigma[0]))

    def has_arrived_at(self, places: tuple[Pose2, ...]) -> bool:
        """Whether the robot is at one of some poses in the fixed frame."""
        gaps = [self.perception.robot.in_frame_of(place) for place in places]
        return any(math.hypot(gap.x, gap.y) <= _ARRIVED[0] and abs(gap.yaw) <= _ARRIVED[1] for gap in gaps)

    @property
    def costmap(self) -> Costmap | None:
        """The newest picture of the surroundings, without what it shows of the station where the docked robot touches.

        A station that scanners see stands a cell or two too fat in it.
        """
        seen, dock = self.perception.costmap or self.problem.costmap, self.perception.dock
        if seen is None:
            return None
        known, cleared, place = self._cleared
        if seen is not known or dock.gap_to(place) > _SAME_DOCK:
            cleared = with_contact_zone(
                seen,
                self.dock,
                self.footprint,
                self.settings.contact_margin,
            )
            self._cleared = seen, cleared, dock
        return cleared

    @property
    def station(self) -> ObstacleSet:
        """The station where the dock is seen."""
        station = self.problem.dock.footprint
        return (
            ObstacleSet.empty()
            if station is None
            else ObstacleSet.from_footprint(station, self.perception.dock, "dock")
        )

    def to_dock(self) -> DockingProblem:
        """From where the robot is to where the dock is seen."""
        return dataclasses.replace(
            self.problem,
            start=self.perception.robot,
            dock=self.dock,
            costmap=self.costmap,
            **AT_A_STAND,
        )

    def to(self, place: Pose2) -> DockingProblem:
        """From where the robot is to a place before the dock, among everything and the station.

        There is nothing to be touched at that place: the whole clearance is kept up to it.
        """
        kept = self.problem.clearance.required
        return dataclasses.replace(
            self.problem,
            start=self.perception.robot,
            dock=Dock(place),
            obstacles=self.problem.obstacles + self.station,
            clearance=ClearanceRule(kept, kept, 0.0),
            costmap=self.costmap,
            **AT_A_STAND,
        )

    def near(self, robot: Pose2, reach: float, *, with_station: bool = True) -> ObstacleSet:
        """Whatever stands within reach of a pose, the station included or not."""
        centre = np.array([robot.x, robot.y])
        found = self.problem.obstacles.in_box(centre - reach, centre + reach)
        if with_station:
            found += self.station
        costmap = self.costmap
        if costmap is None:
            return found
        return found + obstacles_from_costmap(costmap, region=(centre - reach, centre + reach))

    @property
    def is_located(self) -> bool:
        """Whether it is known where the robot is: by localization, or for a short way by odometry, the dock in view."""
        perception, patience = self.perception, self.settings.pose_patience
        if not perception.started or perception.twist_age > patience:
            return False
        if perception.pose_age <= patience:
            return True
        is_near = perception.way_unlocated <= _UNLOCATED[0] and perception.pose_age <= _UNLOCATED[1]
        is_seen = self._is_dock_confirmed and perception.detection_age <= patience
        return is_near and is_seen and perception.sigma[0] <= _LOCATED

    @property
    def is_held(self) -> bool:
        """Whether the robot must stand until it is released."""
        measurements = self.perception.measurements
        return measurements is not None and measurements.held

    @property
    def is_blind(self) -> bool:
        """Whether the picture of the surroundings is too old to be moved in."""
        patience = self.settings.costmap_patience
        return patience is not None and self.perception.costmap_age > patience

    def require_no_interruption(self) -> None:
        """See that a motion may go on.

        Raises:
            Interrupted: The robot is held, or does not know where it is or what is around it.
        """
        if self.is_held:
            raise Interrupted(HELD, "it goes on from here when it is released")
        name, reason = self.interruption
        if name:
            raise Interrupted(name, reason)
        if self.perception.twist_age > self.settings.pose_patience:
            raise Interrupted("no odometry", f"the last one is {self.perception.twist_age:.2f} s old")
        if not self.is_located:
            raise Interrupted("no pose", f"the last one is {self.perception.pose_age:.2f} s old")
        if self.is_blind:
            raise Interrupted("no costmap", f"the last one is {self.perception.costmap_age:.2f} s old")

    def feel(self) -> None:
        """Ask the dock type what is felt in this cycle, once it is known where the robot is."""
        perception = self.perception
        if perception.measurements is not None and perception.started:
            self.felt = self.dock_type.contact(
                AtDock(self.now, perception.measurements, self.commanded, perception.robot_from_dock, self.is_near)
            )

    def contact(self) -> EndingKind | None:
        """How the robot is docked by what is felt; far from the dock it is by nothing."""
        if self.felt is None:
            self._is_far_contact_said = False
            return None
        if self.is_near:
            return _DOCKED_BY[self.felt]
        if not self._is_far_contact_said:
            is_stall = self.felt is Contact.STALL
            self._report("stall far from the dock" if is_stall else "external signal far from the dock", self.where)
        self._is_far_contact_said = True
        return None
