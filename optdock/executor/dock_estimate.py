"""Robot relative to the dock: errors, their uncertainty, and the errors that a path or the feedback can correct."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from optdock.controllers.tracking_law import left_after
from optdock.geometry.pose import normalize_angle
from optdock.model.dock import DockDirection

if TYPE_CHECKING:
    from optdock.executor.executor_settings import ExecutorSettings
    from optdock.executor.perception import Perception
    from optdock.model.limits import MotionLimits
    from optdock.model.problem import DockingProblem

__all__ = [
    "DECAY",
    "LAST_LOOK",
    "LONGEST_HIDDEN",
    "NO_ROOM",
    "SHORTEST_DECAY",
    "DockEstimate",
    "can_be_planned_away",
    "left_at_dock",
    "reachable_offset",
    "staging_distance",
]

# [m]: distance over which lateral errors decay: the convergence_distance of the TrackingController, and its shortest
# value in front of the dock, at 0.1 m/s with a drive delay of 0.25 s.
DECAY, SHORTEST_DECAY = 0.25, 0.08
_LEAST_STAGING, _MOST_STAGING = 0.7, 3.0  # [m]: Nav2's staging_x_offset; more than 3 m of space is rarely free
_STORED_OFFSET = 0.15  # [m]: lateral offset that an approach must be able to correct: 10 cm, and 5 degrees over 0.6 m

# Number of standard deviations that the tolerances of the dock must exceed: at the edge of a tolerance, one docking in
# 400 is off by more than one further standard deviation.
_CERTAINTY = 2.0
_BLINK = 1.0  # [s]: shorter times without a detection have no effect
_HIDDEN = 0.8  # [s] without a detection after which the dock counts as hidden: 1 gap in 250 at 10 Hz with half lost
LONGEST_HIDDEN = 3.0  # [s] without a detection after which an uncertain robot stops
_NEAR = 0.25  # [m]: distance of a detection from close by
NO_ROOM = 0.03  # [m] in front of the dock in which no error can be corrected
LAST_LOOK = 0.2  # [m] in front of the dock within which an uncertain robot continues, because a detection may follow


def reachable_offset(distance: float, limits: MotionLimits) -> float:
    """Return the largest lateral offset [m] of a forward path that begins and ends in the same direction.

    Four equal pieces with the curvature rising and falling at its largest rate c give an offset of c d^3 / 32. Two arcs
    of the largest curvature k, one to the left and one to the right, give k d^2 / 4. No path within the limits exceeds
    either value.

    Args:
        distance: Length d of the path [m].
        limits: Limits of the robot.
    """
    free = max(0.0, distance)
    if free == 0.0:
        return 0.0
    arcs = 0.25 * limits.max_curvature * free**2
    ramps = limits.max_curvature_rate * free**3 / 32.0
    return min(arcs, ramps)


def can_be_planned_away(offset: float, turn: float, distance: float, gear: float, limits: MotionLimits) -> bool:
    """Whether a path with half the largest curvature and curvature rate can correct an error within a distance.

    The other half is reserved for the curvature at the start of the path.

    Args:
        offset: Offset to the left of the path [m].
        turn: Heading error to the left [rad].
        distance: Distance to drive before the final straight [m].
        gear: 1 forward, -1 in reverse.
        limits: Limits of the robot.
    """
    if distance <= 0.0:
        return False
    # A single arc corrects the heading and causes half of the lateral drift of the uncorrected heading.
    across = abs(offset + 0.5 * gear * math.sin(turn) * distance)
    turned = min(limits.max_curvature * distance, 0.25 * limits.max_curvature_rate * distance**2)
    return across <= 0.5 * reachable_offset(distance, limits) and abs(turn) <= 0.5 * turned


def left_at_dock(offset: float, turn: float, distance: float, gear: float, decay: float) -> tuple[float, float]:
    """Return the offset [m] and heading error [rad] that remain at the dock under feedback, see `left_after`.

    Args:
        offset: Present offset to the left of the path [m].
        turn: Present heading error to the left [rad].
        distance: Distance left to drive [m].
        gear: 1 forward, -1 in reverse.
        decay: Distance over which errors decay under feedback [m].
    """
    across, slope = left_after(max(0.0, distance), offset, gear * turn, decay)
    return across, gear * slope


def staging_distance(problem: DockingProblem) -> float:
    """Return the distance [m] from the docked pose at which an approach can still correct an error of the stored dock.

    The distance allows a lateral correction of 15 cm before the final straight, and is at least Nav2's 0.7 m.
    """
    needed = _LEAST_STAGING
    limits = problem.robot.limits
    while reachable_offset(needed - problem.dock.final_straight, limits) < _STORED_OFFSET and needed < _MOST_STAGING:
        needed += 0.05
    return needed


class DockEstimate:
    """Estimated pose of the robot in the frame of the dock, compared with tolerances and standard deviations.

    Attributes:
        approach_gear: Gear of the last segment of the last motion into the dock; None before the first motion.
    """

    def __init__(self, problem: DockingProblem, settings: ExecutorSettings, perception: Perception) -> None:
        self.problem, self.settings, self.perception = problem, settings, perception
        self.approach_gear: float | None = None

    @property
    def gear(self) -> float:
        """Gear of the last motion into the dock: 1 forward, -1 in reverse."""
        direction = self.problem.dock.direction
        if direction is DockDirection.AUTO:
            if self.approach_gear is not None:
                return self.approach_gear  # also valid for a robot slightly beyond the docked pose
            return 1.0 if self.perception.robot_from_dock.x <= 0.0 else -1.0
        return 1.0 if direction is DockDirection.FORWARD else -1.0

    def errors(self) -> list[tuple[float, float, float]]:
        """Return (error, standard deviation, tolerance) along [m], across [m] and in yaw [rad], in (-pi, pi]."""
        accepted, found = self.problem.dock.tolerances, self.perception.robot_from_dock
        sigma = self.perception.sigma_after(0.0)
        tolerances = accepted.along, accepted.cross, accepted.yaw
        return list(zip((found.x, found.y, normalize_angle(found.yaw)), sigma, tolerances, strict=True))

    @property
    def distance(self) -> float:
        """Distance of the robot from the docked pose [m]."""
        relative = self.perception.robot_from_dock
        return math.hypot(relative.x, relative.y)

    @property
    def left(self) -> float:
        """Distance from the docked pose along the axis of the dock [m]."""
        return abs(self.perception.robot_from_dock.x)

    @property
    def reach_of_contact(self) -> float:
        """Distance [m] from the estimated dock within which contact is possible, including the uncertainty."""
        return self.settings.contact_range + 3.0 * self.perception.sigma[0]

    @property
    def is_near(self) -> bool:
        """Whether contact is possible at the present distance from the docked pose."""
        return self.distance <= self.reach_of_contact

    @property
    def where(self) -> str:
        """The pose of the robot relative to the docked pose, for messages."""
        (x, *_), (y, *_), (yaw, *_) = self.errors()
        return f"{x:.4f} m along, {y:.4f} m across and {yaw:.4f} rad from the docked pose"

    @property
    def may_have_turned(self) -> bool:
        """Whether localization and odometry have diverged by more than the yaw tolerance since the last detection."""
        return self.settings.use_detections and abs(self.perception.unseen_turn) > self.problem.dock.tolerances.yaw

    def will_know(self, left: float) -> bool:
        """Whether the uncertainty after a further distance `left` [m] is smaller than the tolerances of the dock."""
        sigma, accepted = self.perception.sigma_after(self.gear * left), self.problem.dock.tolerances
        pairs = zip(sigma, (accepted.along, accepted.cross, accepted.yaw), strict=True)
        return all(_CERTAINTY * found <= most for found, most in pairs)

    def is_within_tolerances(self, certainty: float) -> bool:
        """Whether the errors are within the tolerances, each reduced by `certainty` sigmas, but at most by half."""
        return all(abs(error) <= max(most - certainty * sigma, 0.5 * most) for error, sigma, most in self.errors())

    @property
    def is_in_doubt(self) -> bool:
        """Whether the estimates are too uncertain to decide if the robot is within the tolerances of the dock."""
        if self.may_have_turned or self.perception.detections.is_contradicted or not self.will_know(0.0):
            return True
        return any(abs(abs(error) - most) < _CERTAINTY * sigma for error, sigma, most in self.errors())

    @property
    def sees_from_near(self) -> bool:
        """Whether the dock has been detected at close range."""
        return self.perception.detections.seen_from <= _NEAR

    @property
    def is_confirmed(self) -> bool:
        """Whether the required number of detections was accepted and no newer detections contradict them."""
        detections = self.perception.detections
        return detections.count >= self.settings.least_detections and not detections.is_contradicted

    @property
    def is_known(self) -> bool:
        """Whether the pose of the dock is accurate enough to drive to it."""
        accepted = self.problem.dock.tolerances
        (place, turn), most = self.perception.sigma, min(accepted.along, accepted.cross)
        is_sure = _CERTAINTY * place <= most and _CERTAINTY * turn <= accepted.yaw
        return self.is_confirmed and is_sure and not self.detection_is_old

    @property
    def is_found(self) -> bool:
        """Whether the pose of the dock is accurate enough for an approach that corrects errors in its second half."""
        if self.is_known:
            return True
        place, turn = (_CERTAINTY * sigma for sigma in self.perception.sigma)
        way, limits = 0.5 * self.left - self.problem.dock.final_straight, self.problem.robot.limits
        is_recent = self.perception.detection_age <= LONGEST_HIDDEN and not self.detection_is_old
        return self.is_confirmed and is_recent and can_be_planned_away(place, turn, way, 1.0, limits)

    @property
    def detection_is_old(self) -> bool:
        """Whether the pose at the dock would be too uncertain because the last detection is old."""
        age, settings = self.perception.detection_age, self.settings
        left = self.left
        if age <= _BLINK or self.distance <= settings.detection_blind_distance:
            return False
        patience = settings.detection_patience
        if patience is not None and age > patience:
            return True
        return (left <= LAST_LOOK or age > LONGEST_HIDDEN) and not self.will_know(left)

    @property
    def is_hidden(self) -> bool:
        """Whether the dock should be visible but is not detected, although an error could still be corrected.

        If the camera has never detected the dock at close range, no detection is expected at such ranges, provided that
        odometry is accurate enough for the remaining distance. After `LONGEST_HIDDEN` without a detection the result is
        False.
        """
        age, left = self.perception.detection_age, self.left
        if not (_HIDDEN < age <= LONGEST_HIDDEN and NO_ROOM < left <= LAST_LOOK):
            return False
        is_visible = self.distance > self.settings.detection_blind_distance
        return is_visible and (self.sees_from_near or not self.will_know(left))
