"""The contract of dock types."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, ClassVar

from optdock.executor.checked_inputs import CheckedDockType
from optdock.geometry.pose import Pose2, Twist2
from optdock.model.measurements import AtDock, Detection, Measurements
from optdock.plugins.interfaces import DockType
from optdock.testing.contracts.contract_scene import GOAL
from optdock.testing.contracts.plugin import PluginContract
from optdock.testing.contracts.rules import require

if TYPE_CHECKING:
    from collections.abc import Iterator

__all__ = ["DockTypeContract"]

_PERIOD = 0.02  # [s]
_NEAR = 0.05  # [m], the executor's default
_REST = Twist2()
_DISTANCES = (0.7, 1.5)  # [m]: Nav2's staging distance, and one for a stiff robot
_FARTHEST = 20.0  # [m]: an approach that begins farther off is another task
_SEEN = Detection(0.0, Pose2(0.8, 0.05, 0.02), 0.003, 0.005)


class DockTypeContract(PluginContract[DockType]):
    """`optdock.plugins.interfaces.DockType`: a kind of dock."""

    interface: ClassVar[type[DockType]] = DockType

    def exercise(self, plugin: DockType) -> object:
        """Every answer over an approach that ends in contact, from a reset on."""
        plugin.reset()
        felt = tuple((plugin.contact(now), plugin.is_charging(now.measurements)) for now in self.approach())
        seen = tuple(tuple(plugin.detections(measurements)) for measurements in self.sightings())
        begins = tuple(tuple(plugin.staging_poses(gear, far)) for gear in (1.0, -1.0) for far in _DISTANCES)
        return felt, seen, begins, plugin.is_pressed_on, plugin.waits_for_charge, plugin.back_out_distance

    def approach(self) -> Iterator[AtDock]:
        """Cycles of an approach: half a metre towards the dock, against it for a second, then at rest with a signal.

        Override it where contact shows in other ways.
        """
        stamp = 0.0
        for cycle in range(350):
            stamp += _PERIOD
            x = min(-0.5 + 0.1 * stamp, 0.0)
            commanded = Twist2(0.1) if cycle < 300 else _REST
            twist = Twist2(0.1) if x < 0.0 else _REST
            touches = True if cycle >= 310 else None
            measurements = Measurements(
                stamp, GOAL @ Pose2(x, 0.0, 0.0), twist, (), touches, current=3.0 * bool(touches)
            )
            yield AtDock(stamp, measurements, commanded, Pose2(x, 0.0, 0.0), -x <= _NEAR)

    def sightings(self) -> Iterator[Measurements]:
        """Measurements with no detection, with one, and with two out of order."""
        for seen in ((), (_SEEN,), (_SEEN._replace(stamp=0.1), _SEEN)):
            yield Measurements(0.2, GOAL @ Pose2(-0.8, 0.0, 0.0), Twist2(0.1), seen)

    def test_contact_is_a_contact_or_none_in_every_cycle(self) -> None:
        """`contact`: what is felt now, whatever the sensors tell and leave out."""
        checked, far = CheckedDockType(self.ready_plugin()), Pose2(-3.0, 0.2, 0.1)
        for now in self.approach():
            checked.contact(now)
        for touches in (None, False, True):
            for current in (None, -1.0, 0.0, 30.0):
                for commanded in (_REST, Twist2(-0.3, 0.5)):
                    measurements = Measurements(9.0, None, contact=touches, current=current)
                    checked.contact(AtDock(9.0, measurements, commanded, far, is_near=False))
                    checked.is_charging(measurements)

    def test_a_robot_far_away_that_measures_nothing_feels_nothing(self) -> None:
        """`contact`: None where there is none."""
        plugin = self.ready_plugin()
        plugin.reset()
        for cycle in range(100):
            measurements = Measurements(cycle * _PERIOD, Pose2(0.0, 0.0, 0.0))
            now = AtDock(cycle * _PERIOD, measurements, _REST, Pose2(-3.0, 0.0, 0.0), is_near=False)
            found = plugin.contact(now)
            require(found is None, f"at rest, 3 m before the dock, without a signal there is no contact, got {found}")

    def test_a_reset_forgets_what_was_felt(self) -> None:
        """`reset`: another approach begins, wherever the last one was cut off."""
        plugin, whole = self.ready_plugin(), list(self.approach())
        plugin.reset()
        expected = [plugin.contact(now) for now in whole]
        for cut in (1, 290, len(whole)):
            plugin.reset()
            for now in whole[:cut]:
                plugin.contact(now)
            plugin.reset()
            found = [plugin.contact(now) for now in whole]
            require(found == expected, f"after {cut} cycles and a reset it answers as the first time")

    def test_a_repeated_stamp_is_answered(self) -> None:
        """`contact`: once in every control cycle, in order of the stamps; a clock may stand still."""
        checked = CheckedDockType(self.ready_plugin())
        for now in self.approach():
            checked.contact(now)
            checked.contact(now)

    def test_approaches_begin_at_poses_outside_the_dock(self) -> None:
        """`staging_poses`: at least one, in either gear; none is the docked pose, none is out of sight."""
        checked = CheckedDockType(self.ready_plugin())
        for gear in (1.0, -1.0):
            for distance in _DISTANCES:
                for pose in checked.staging_poses(gear, distance):
                    far = math.hypot(pose.x, pose.y)
                    require(0.0 < far <= _FARTHEST, f"it is outside the dock, at most {_FARTHEST} m off, got {pose}")

    def test_detections_are_made_of_detections(self) -> None:
        """`detections`: as poses of the docked robot; of none comes none, of one not more than one."""
        checked = CheckedDockType(self.ready_plugin())
        for measurements in self.sightings():
            given, found = measurements.detections, checked.detections(measurements)
            require(len(found) <= len(given), f"of {len(given)} detections come no more, got {len(found)}")
            stamps = {one.stamp for one in given}
            require(all(one.stamp in stamps for one in found), f"a detection keeps its stamp, got {found}")

    def test_what_it_says_of_itself_is_of_the_right_kind(self) -> None:
        """`is_pressed_on`, `waits_for_charge`, `is_charging`: bool; `back_out_distance`: finite, more than 0."""
        checked = CheckedDockType(self.ready_plugin())
        for now in self.approach():
            said = checked.is_pressed_on, checked.waits_for_charge, checked.is_charging(now.measurements)
            require(checked.back_out_distance > 0.0, f"it is answered: {said}")
