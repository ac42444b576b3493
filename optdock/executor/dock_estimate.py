"""Where the robot stands relative to the dock, and whether that is known well enough for what is to be done next."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from optdock.executor.approach import can_be_planned_away
from optdock.geometry.pose import normalize_angle
from optdock.model.dock import DockDirection

if TYPE_CHECKING:
    from optdock.executor.executor_settings import ExecutorSettings
    from optdock.executor.perception import Perception
    from optdock.model.problem import DockingProblem

__all__ = ["LAST_LOOK", "LONGEST_HIDDEN", "NO_ROOM", "DockEstimate"]

# Standard deviations that the accepted errors of the dock must hold: one docking in 400 is then off by one more, were
# the robot believed to stand at the edge of what is accepted; it is believed to stand in the middle.
_CERTAINTY = 2.0
_BLINK = 1.0  # [s] without a detection that nothing is made of
LONGEST_HIDDEN = 3.0  # [s] without one, after which a robot that is not sure looks for it before it drives on
_HIDDEN = 0.8  # [s] without one, where the dock was seen before: of ten a second, half of them lost, one gap in 250
_NEAR = 0.25  # [m]: from farther a camera that is blind before the dock sees it
NO_ROOM = 0.03  # [m] before the dock nothing can be corrected any more
LAST_LOOK = 0.2  # [m] before the dock: as near it drives without being sure, for a detection may come on the way


class DockEstimate:
    """The pose of the robot in the frame of the dock, compared with tolerances and standard deviations.

    Args:
        problem: Robot and dock as stored.
        settings: What is asked of detections.
        perception: Brought up to date before every cycle.

    Attributes:
        approach_gear: Of the last piece of the motion into the dock that was driven last; None before.
    """

    def __init__(self, problem: DockingProblem, settings: ExecutorSettings, perception: Perception) -> None:
        self.problem, self.settings, self.perception = problem, settings, perception
        self.approach_gear: float | None = None

    @property
    def gear(self) -> float:
        """Of the last motion into the dock."""
        direction = self.problem.dock.direction
        if direction is DockDirection.AUTO:
            if self.approach_gear is not None:
                return self.approach_gear  # also of a robot that stands a little beyond the docked pose
            return 1.0 if self.perception.robot_from_dock.x <= 0.0 else -1.0
        return 1.0 if direction is DockDirection.FORWARD else -1.0

    def errors(self) -> list[tuple[float, float, float]]:
        """Errors in the dock, their standard deviations and tolerances: along, across [m], yaw in (-pi, pi] [rad]."""
        accepted, found = self.problem.dock.tolerances, self.perception.robot_from_dock
        sigma = self.perception.sigma_after(0.0)
        tolerances = accepted.along, accepted.cross, accepted.yaw
        return list(zip((found.x, found.y, normalize_angle(found.yaw)), sigma, tolerances, strict=True))

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
        (x, *_), (y, *_), (yaw, *_) = self.errors()
        return f"{x:.4f} m along, {y:.4f} m across and {yaw:.4f} rad from the docked pose"

    @property
    def may_have_turned(self) -> bool:
        """Whether the localization says that the robot has turned out of its dock since that was seen."""
        return self.settings.use_detections and abs(self.perception.unseen_turn) > self.problem.dock.tolerances.yaw

    def will_know(self, left: float) -> bool:
        """Whether the tolerances of the dock will exceed the noise after so much more of the way [m]."""
        sigma, accepted = self.perception.sigma_after(self.gear * left), self.problem.dock.tolerances
        asked = zip(sigma, (accepted.along, accepted.cross, accepted.yaw), strict=True)
        return all(_CERTAINTY * found <= most for found, most in asked)

    def is_within_tolerances(self, certainty: float) -> bool:
        """Whether the robot stands within the tolerances of the dock, with a margin for the noise.

        Args:
            certainty: Standard deviations by which it is to stand within them, as far as that leaves half of them.
        """
        return all(abs(error) <= max(most - certainty * sigma, 0.5 * most) for error, sigma, most in self.errors())

    @property
    def is_in_doubt(self) -> bool:
        """Whether the robot may stand within the tolerances of the dock as well as beside them, by what is known."""
        if self.may_have_turned or self.perception.detections.is_contradicted or not self.will_know(0.0):
            return True
        return any(abs(abs(error) - most) < _CERTAINTY * sigma for error, sigma, most in self.errors())

    @property
    def sees_from_near(self) -> bool:
        """Whether the dock has been seen from as near as the last look before it is taken."""
        return self.perception.detections.seen_from <= _NEAR

    @property
    def is_confirmed(self) -> bool:
        """Whether the dock was seen as often as it must be, and nothing newer contradicts that."""
        perception = self.perception
        return (
            perception.detections.count >= self.settings.least_detections and not perception.detections.is_contradicted
        )

    @property
    def is_known(self) -> bool:
        """Whether the dock was seen on the way here, often and well enough to be driven to."""
        accepted = self.problem.dock.tolerances
        (place, turn), most = self.perception.sigma, min(accepted.along, accepted.cross)
        is_sure = _CERTAINTY * place <= most and _CERTAINTY * turn <= accepted.yaw
        return self.is_confirmed and is_sure and not self.detection_is_old

    @property
    def is_found(self) -> bool:
        """Whether the dock was seen on the way here, often and well enough to be approached.

        What is not known of it yet can still be corrected on the second half of the way in.
        """
        if self.is_known:
            return True
        place, turn = (_CERTAINTY * sigma for sigma in self.perception.sigma)
        way, limits = 0.5 * self.left - self.problem.dock.final_straight, self.problem.robot.limits
        is_recent = self.perception.detection_age <= LONGEST_HIDDEN and not self.detection_is_old
        return self.is_confirmed and is_recent and can_be_planned_away(place, turn, way, 1.0, limits)

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
        return (left <= LAST_LOOK or age > LONGEST_HIDDEN) and not self.will_know(left)

    @property
    def is_hidden(self) -> bool:
        """Whether the dock is not seen where it should be, with some way left on which an error could be corrected.

        A camera that is blind before the dock has never seen it from near; then there is nothing to wait for, if the
        robot will know without it where it stands. After `LONGEST_HIDDEN` it is not waited for any longer.
        """
        age, left = self.perception.detection_age, self.left
        if not (_HIDDEN < age <= LONGEST_HIDDEN and NO_ROOM < left <= LAST_LOOK):
            return False
        is_visible = self.distance > self.settings.detection_blind_distance
        return is_visible and (self.sees_from_near or not self.will_know(left))
