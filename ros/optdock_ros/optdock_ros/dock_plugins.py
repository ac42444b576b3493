"""Types of docks in a server: where to stage, how a detection becomes a docked pose, what the executor asks.

The parameters are those of opennav_docking's two classes, under their names and with their defaults; a dock type of
third parties take their own beside them. The server talks to ROS; the plugins receive messages and answer questions.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

from pydantic import Field, model_validator

from optdock.errors import DockNotValid, InvalidMessage, InvalidValue, PluginError
from optdock.executor import SimpleDock
from optdock.executor.checked_inputs import CheckedDockType
from optdock.geometry.pose import Pose2
from optdock.model.dock import DockDirection
from optdock.model.measurements import Detection, Measurements
from optdock.nav2.docks import docked_pose
from optdock.plugins.interfaces import DockType
from optdock.plugins.parameters import PluginParameters, closest, parse_parameters
from optdock.plugins.registry import create_plugin, load_plugin
from optdock.ros.transforms import Transform

if TYPE_CHECKING:
    from collections.abc import Mapping

__all__ = [
    "DOCK_PLUGINS",
    "DockPlugin",
    "OwnDock",
    "OwnDockParameters",
    "SimpleChargingDock",
    "SimpleChargingDockParameters",
    "SimpleNonChargingDock",
    "SimpleNonChargingDockParameters",
    "Told",
    "plugin_class",
]

_UNIT = 1e-3  # of a quaternion's length: rounded by hand, still meant as a rotation
_STEEP = 0.5  # [rad] of the docked robot's x axis against the floor: beyond, its yaw is made of noise
_STALL_AGE = 0.5  # [s]: joint states come at 10 Hz at least; older ones say nothing of now
_CHARGE_AGE = 10.0  # [s]: battery states may come once in some seconds


class SimpleNonChargingDockParameters(PluginParameters):
    """Parameters of a dock without a charger."""

    dock_direction: Literal["forward", "backward"] = Field(
        default="forward", description="gear of the last motion; the dock's pose points into it either way"
    )
    rotate_to_dock: bool = Field(
        default=False, description="see the dock ahead, turn round, and back in without seeing it"
    )
    staging_x_offset: float = Field(default=-0.7, description="of the staging pose along the dock's x [m]")
    staging_yaw_offset: float = Field(default=0.0, description="added to the dock's yaw there [rad]")
    docking_threshold: float = Field(default=0.05, gt=0.0, description="nearer than this, contact is believed [m]")

    use_external_detection_pose: bool = Field(default=False, description="the dock is where detected_dock_pose says")
    external_detection_timeout: float = Field(default=1.0, gt=0.0, description="older detections are not used [s]")
    external_detection_translation_x: float = Field(
        default=-0.2, description="docked robot, from what is detected, along the docked robot's x [m]"
    )
    external_detection_translation_y: float = Field(default=0.0, description="as above, along its y [m]")
    external_detection_rotation_roll: float = Field(
        default=-1.57, description="turns what is detected into the dock's frame: z up, x into the dock [rad]"
    )
    external_detection_rotation_pitch: float = Field(default=1.57, description="as above; after the roll [rad]")
    external_detection_rotation_yaw: float = Field(default=0.0, description="as above; after the pitch [rad]")
    filter_coef: float = Field(
        default=0.1, description="Nav2's filter of detections; not read, the estimate weighs them by their sigmas"
    )
    detection_position_sigma: float = Field(
        default=0.005, gt=0.0, description="standard deviation of a detection's x and y, each; ours [m]"
    )
    detection_yaw_sigma: float = Field(default=0.01, gt=0.0, description="as above, of its yaw; ours [rad]")

    contact: Literal["", "distance", "touch"] = Field(
        default="",
        description="docked by the estimate, or pressing on until it is felt; empty: felt with stall detection; ours",
    )
    use_stall_detection: bool = Field(default=False, description="contact is felt: joints that push and do not turn")
    stall_joint_names: list[str] = Field(default=[], description="which joints; the mean of them counts")
    stall_velocity_threshold: float = Field(default=1.0, ge=0.0, description="slower is a stall [rad/s]")
    stall_effort_threshold: float = Field(default=1.0, ge=0.0, description="and a larger effort [Nm]")

    detector_service_name: str = Field(default="", description="std_srvs/Trigger that switches the detector")
    detector_service_timeout: float = Field(default=5.0, gt=0.0, description="for its answer [s]")
    subscribe_toggle: bool = Field(default=False, description="subscribe to detections while docking only")

    @model_validator(mode="after")
    def _fits(self) -> SimpleNonChargingDockParameters:
        if self.rotate_to_dock and self.dock_direction != "backward":
            raise ValueError("rotate_to_dock needs dock_direction: backward")
        if self.use_stall_detection and not self.stall_joint_names:
            raise ValueError("use_stall_detection needs stall_joint_names")
        return self


class SimpleChargingDockParameters(SimpleNonChargingDockParameters):
    """Parameters of a dock that charges."""

    use_battery_status: bool = Field(default=True, description="battery_state tells whether it charges; else contact")
    charging_threshold: float = Field(default=0.5, description="a larger current charges [A]")


class Told(NamedTuple):
    """A message, and when it came [s]."""

    message: Any
    at: float


class DockPlugin:
    """A type of docks.

    Args:
        name: Of the instance; a dock's `type` refers to it.
        parameters: Names and values, as a file has them.

    Raises:
        InvalidValue: A parameter is unknown, of the wrong type or out of range; every fault on a line.
    """

    Parameters: type[SimpleNonChargingDockParameters] = SimpleNonChargingDockParameters

    def __init__(self, name: str, parameters: Mapping[str, object]) -> None:
        self.name = name
        self.parameters = p = parse_parameters(self.Parameters, parameters, name)
        self._rotation = _quaternion(
            p.external_detection_rotation_roll, p.external_detection_rotation_pitch, p.external_detection_rotation_yaw
        )

    def docked_pose(self, dock: Pose2) -> Pose2:
        """Where the robot stands when docked."""
        return docked_pose(dock, self.direction)

    def stored_pose(self, docked: Pose2) -> Pose2:
        """The dock's pose as Nav2 writes it, of a robot that stands docked."""
        return self.docked_pose(docked)  # half a turn is its own inverse

    def staging_pose(self, dock: Pose2) -> Pose2:
        """Where the approach to a dock begins."""
        p = self.parameters
        return dock @ Pose2(p.staging_x_offset, 0.0, p.staging_yaw_offset)

    @property
    def is_charger(self) -> bool:
        """Whether a robot that is docked may be charged."""
        return False

    @property
    def uses_battery(self) -> bool:
        """Whether the state of the battery counts."""
        return False

    @classmethod
    def known_names(cls) -> frozenset[str]:
        """The names of all parameters."""
        return frozenset(cls.Parameters.model_fields)

    def dock_type(self, settings: Mapping[str, object]) -> DockType:
        """What the executor asks: a new one for every task.

        Args:
            settings: Parameters of `SimpleDock` that the executor's settings give.
        """
        p = self.parameters
        contact = p.contact or ("touch" if p.use_stall_detection else "distance")
        return SimpleDock(contact=contact, **settings)

    @property
    def direction(self) -> DockDirection:
        """Gear of the last motion."""
        return DockDirection(self.parameters.dock_direction)

    def detection(self, message: Any, base: Transform) -> Detection:
        """What a detection says of the docked pose.

        Args:
            message: What is seen, in the frame of its header.
            base: That frame seen from the robot, at the time of the message.

        Raises:
            InvalidMessage: A number is not finite, the rotation is none, or what the parameters make of it points up or
                down instead of along the floor.
        """
        place, turn = message.pose.position, message.pose.orientation
        translation = float(place.x), float(place.y), float(place.z)
        rotation = float(turn.x), float(turn.y), float(turn.z), float(turn.w)
        if not all(map(math.isfinite, (*translation, *rotation))):
            raise InvalidMessage(f"PoseStamped: pose: must be finite, got {translation}, {rotation}")
        length = math.sqrt(sum(part * part for part in rotation))
        if abs(length - 1.0) > _UNIT:
            raise InvalidMessage(f"PoseStamped: pose.orientation: must have the length 1, got {length:.6g}")
        unit = tuple(part / length for part in rotation)
        seen = base @ Transform(base.source, "dock", base.stamp, translation, unit)  # type: ignore[arg-type]  # four
        turned = seen @ Transform("dock", "docked", base.stamp, (0.0, 0.0, 0.0), self._rotation)
        ahead = (turned @ Transform("docked", "ahead", base.stamp, (1.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))).translation
        x, y, z = (tip - foot for tip, foot in zip(ahead, turned.translation, strict=True))
        if abs(z) > math.sin(_STEEP):
            raise InvalidMessage(
                f"PoseStamped: pose.orientation: the dock's x axis must lie along the floor within {_STEEP} rad, it is "
                f"{math.asin(max(-1.0, min(1.0, z))):.3f} rad steep; look at {self.name}.external_detection_rotation_*"
            )
        p = self.parameters
        offset = Pose2(p.external_detection_translation_x, p.external_detection_translation_y, 0.0)
        dock = Pose2(turned.translation[0], turned.translation[1], math.atan2(y, x)) @ offset
        stamp = message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec
        return Detection(stamp, self.docked_pose(dock), p.detection_position_sigma, p.detection_yaw_sigma)

    def is_stalled(self, told: Told | None, now: float) -> bool:
        """Whether joints push and do not turn.

        Args:
            told: The newest sensor_msgs/JointState.
            now: [s].

        Raises:
            InvalidMessage: A joint of the list tells no velocity or no effort.
        """
        p = self.parameters
        if told is None or not p.use_stall_detection or now - told.at > _STALL_AGE:
            return False
        message = told.message
        rows = [i for i, name in enumerate(message.name) if name in p.stall_joint_names]
        if not rows:
            return False
        if max(rows) >= min(len(message.velocity), len(message.effort)):
            raise InvalidMessage(f"JointState: {message.name[max(rows)]}: needs velocity and effort")
        velocity = sum(abs(message.velocity[i]) for i in rows) / len(rows)
        effort = sum(abs(message.effort[i]) for i in rows) / len(rows)
        # NaN is not a stall: comparisons with it are false.
        return bool(velocity < p.stall_velocity_threshold and effort > p.stall_effort_threshold)

    @property
    def contact_topic(self) -> str:
        """The topic of a switch; empty where there is none."""
        return ""

    def is_switched(self, told: Told | None, now: float) -> bool | None:  # noqa: ARG002 - of those that have a switch
        """What a switch tells; None where nothing does.

        Args:
            told: The newest std_msgs/Bool of `contact_topic`.
            now: [s].
        """
        return None

    def current(self, told: Told | None, now: float) -> float | None:
        """Into the battery [A]; None without a recent message, or where the current is not a number.

        Args:
            told: The newest sensor_msgs/BatteryState.
            now: [s].
        """
        if not self.uses_battery or told is None or now - told.at > _CHARGE_AGE:
            return None
        current = float(told.message.current)
        return current if math.isfinite(current) else None

    def is_charging(self, told: Told | None, now: float) -> bool:
        """Whether the battery is being charged, as far as its state tells.

        Args:
            told: The newest sensor_msgs/BatteryState.
            now: [s].

        Raises:
            PluginError: A dock type gives an answer that is none.
        """
        return self._asked.is_charging(Measurements(now, None, current=self.current(told, now)))

    @property
    def waits_for_charge(self) -> bool:
        """Whether contact is not enough.

        Raises:
            PluginError: A dock type gives an answer that is none.
        """
        return self._asked.waits_for_charge

    @property
    def _asked(self) -> CheckedDockType:
        """A dock type for what is asked beside a task."""
        return CheckedDockType(self.dock_type({}))


class SimpleNonChargingDock(DockPlugin):
    """Nav2's dock without a charger, such as a conveyor or a shelf."""


class SimpleChargingDock(DockPlugin):
    """Nav2's charging dock."""

    Parameters = SimpleChargingDockParameters
    parameters: SimpleChargingDockParameters

    @property
    def is_charger(self) -> bool:
        """True, also where the battery is not asked."""
        return True

    @property
    def uses_battery(self) -> bool:
        """As the parameter says."""
        return self.parameters.use_battery_status

    def dock_type(self, settings: Mapping[str, object]) -> DockType:
        """With a current above the threshold as contact and charge, and waiting for it."""
        if not self.uses_battery:
            return super().dock_type(settings)
        threshold = self.parameters.charging_threshold
        return super().dock_type({**settings, "charging_current": threshold, "wait_for_charge": True})


class OwnDockParameters(SimpleNonChargingDockParameters):
    """Parameters of a server's dock whose `DockType` is a plugin's, beside the plugin's own."""

    use_battery_status: bool = Field(default=False, description="battery_state tells the dock type the current")

    contact_topic: str = Field(default="", description="std_msgs/Bool of a switch, such as a photocell; empty: none")
    contact_timeout: float = Field(default=0.5, gt=0.0, description="what it said before says nothing of now [s]")

    @model_validator(mode="after")
    def _says_nothing_twice(self) -> OwnDockParameters:
        if self.contact:
            raise ValueError("contact is for the dock type to say")
        return self


class OwnDock(DockPlugin):
    """A dock type of a third party, found by its entry point.

    Parameters that the dock type declares are its own; the others are of `OwnDockParameters`.

    Args:
        name: As of `DockPlugin`.
        parameters: Of both.

    Raises:
        InvalidValue: As `DockPlugin`.
        PluginError: The dock type cannot be built.

    Attributes:
        entry_point: Name of the dock type; of a subclass that `plugin_class` makes.
    """

    Parameters = OwnDockParameters
    parameters: OwnDockParameters
    entry_point = ""

    def __init__(self, name: str, parameters: Mapping[str, object]) -> None:
        kind = load_plugin(DockType, self.entry_point)
        names = _own_names(kind)
        self._own = {key: value for key, value in parameters.items() if key in names}
        parse_parameters(kind.Parameters, self._own, name)  # faults under the name of the block
        super().__init__(name, {key: value for key, value in parameters.items() if key not in names})
        self.dock_type({})  # what cannot be built is said before a robot waits for it

    @classmethod
    def known_names(cls) -> frozenset[str]:
        """Those of the dock type, and those of the server."""
        return super().known_names() | _own_names(load_plugin(DockType, cls.entry_point))

    def staging_pose(self, dock: Pose2) -> Pose2:
        """The first that the dock type prefers; where the dock is seen ahead before the robot turns, as of the others.

        Raises:
            PluginError: A dock type gives an answer that is none.
        """
        p = self.parameters
        if p.rotate_to_dock:
            return super().staging_pose(dock)
        gear = 1.0 if self.direction is DockDirection.FORWARD else -1.0
        return self.docked_pose(dock) @ self._asked.staging_poses(gear, abs(p.staging_x_offset))[0]

    def dock_type(self, settings: Mapping[str, object]) -> DockType:  # noqa: ARG002 - of SimpleDock alone
        """The plugin's."""
        return create_plugin(DockType, self.entry_point, self._own)

    @property
    def contact_topic(self) -> str:
        """As the parameter says."""
        return self.parameters.contact_topic

    def is_switched(self, told: Told | None, now: float) -> bool | None:
        """What the switch tells, as long as that is new enough."""
        if told is None or now - told.at > self.parameters.contact_timeout:
            return None
        return bool(told.message.data)

    @property
    def uses_battery(self) -> bool:
        """As the parameter says."""
        return self.parameters.use_battery_status

    @property
    def is_charger(self) -> bool:
        """Whether the dock type waits for charge."""
        return self.waits_for_charge


def _own_names(kind: type[DockType]) -> frozenset[str]:
    """The names of a dock type's parameters, as a file has them."""
    return frozenset(spec.alias or name for name, spec in kind.Parameters.model_fields.items())


DOCK_PLUGINS: Mapping[str, type[DockPlugin]] = {
    "opennav_docking::SimpleChargingDock": SimpleChargingDock,
    "opennav_docking::SimpleNonChargingDock": SimpleNonChargingDock,
}
"""By Nav2's class names."""


def plugin_class(name: str, nav2_class: object) -> type[DockPlugin]:
    """The plugin of one of Nav2's classes, or of a dock type.

    Args:
        name: Of the instance, for messages.
        nav2_class: Nav2's name, also in the form with a slash; or the name of a dock type's entry point.

    Raises:
        DockNotValid: There is none of this class or name.
        InvalidValue: None is named.
    """
    if not isinstance(nav2_class, str):
        raise InvalidValue(f"{name}.plugin: is required, the class of the dock plugin; got {nav2_class!r}")
    asked = nav2_class.replace("/", "::")
    found = DOCK_PLUGINS.get(asked)
    if found is not None:
        return found
    if "::" in asked:
        raise DockNotValid(
            f"{name}.plugin: optdock has no dock of the class {nav2_class}{closest(asked, DOCK_PLUGINS)}; it has "
            f"{', '.join(DOCK_PLUGINS)}, and the dock types that `optdock plugins` lists"
        )
    try:
        load_plugin(DockType, asked)
    except PluginError as error:
        raise DockNotValid(f"{name}.plugin: {error}") from error
    return type("OwnDock", (OwnDock,), {"entry_point": asked})


def _quaternion(roll: float, pitch: float, yaw: float) -> tuple[float, float, float, float]:
    """About the fixed axes x, y and z, in this order."""
    (cr, sr), (cp, sp), (cy, sy) = ((math.cos(0.5 * a), math.sin(0.5 * a)) for a in (roll, pitch, yaw))
    return (
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
        cr * cp * cy + sr * sp * sy,
    )
