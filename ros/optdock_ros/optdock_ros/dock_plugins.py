"""Dock types of the docking server: staging poses, docked poses from detections, contact and charge.

The parameters are those of opennav_docking's two dock plugins, with their names and defaults; dock types of third
parties have their own parameters in addition. The server receives the messages, the plugins interpret them.
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
from optdock.nav2.declared_parameters import NAV2_DOCKS
from optdock.nav2.docks import docked_pose
from optdock.plugins.interfaces import DockType
from optdock.plugins.parameters import PluginParameters, closest, parse_parameters
from optdock.plugins.registry import create_plugin, load_plugin
from optdock.ros.transforms import Transform
from optdock_ros.detection_rotation import detection_rotation

if TYPE_CHECKING:
    from collections.abc import Mapping

__all__ = [
    "DOCK_PLUGINS",
    "DockPlugin",
    "OwnDock",
    "OwnDockParameters",
    "Received",
    "SimpleChargingDock",
    "SimpleChargingDockParameters",
    "SimpleNonChargingDockParameters",
    "plugin_class",
]

_UNIT = 1e-3  # tolerance of a quaternion's length
_STEEP = 0.5  # [rad]: largest angle between the docked robot's x axis and the floor; its yaw is noise beyond
_STALL_AGE = 0.5  # [s]: largest age of joint states, which are published at 10 Hz or more
_CHARGE_AGE = 10.0  # [s]: largest age of battery states, which are published every few seconds
_LEVEL = (0.0, 0.0, 0.0, 1.0)  # quaternion of the identity


class SimpleNonChargingDockParameters(PluginParameters):
    """Parameters of a dock without a charger."""

    dock_direction: Literal["forward", "backward"] = Field(
        "forward", description="gear into the dock; the x axis of the dock's pose points into the dock for both"
    )
    rotate_to_dock: bool = Field(default=False, description="detect the dock in front, turn around, and dock backward")
    staging_x_offset: float = Field(-0.7, description="offset of the staging pose along the dock's x axis [m]")
    staging_yaw_offset: float = Field(0.0, description="offset of the staging pose's yaw from the dock's [rad]")
    docking_threshold: float = Field(
        0.05, gt=0, description="largest distance from the dock at which contact is accepted [m]"
    )

    use_external_detection_pose: bool = Field(
        default=False, description="use the detected pose of the dock; false: the stored pose"
    )
    external_detection_timeout: float = Field(1.0, gt=0, description="largest age of a detection [s]")
    external_detection_translation_x: float = Field(
        -0.2, description="offset from the detection to the docked robot, along the dock's x axis [m]"
    )
    external_detection_translation_y: float = Field(0.0, description="as above, along the y axis [m]")
    external_detection_rotation_roll: float = Field(
        -1.57,
        description="rotation from the detection to the dock (z up, x into the dock), in the order of "
        "nav2_distribution: roll [rad]",
    )
    external_detection_rotation_pitch: float = Field(1.57, description="as above: pitch [rad]")
    external_detection_rotation_yaw: float = Field(0.0, description="as above: yaw [rad]")
    detection_position_sigma: float = Field(
        0.005, gt=0, description="standard deviation of a detection's x and y, each; not in Nav2 [m]"
    )
    detection_yaw_sigma: float = Field(
        0.01, gt=0, description="standard deviation of a detection's yaw; not in Nav2 [rad]"
    )

    contact: Literal["", "distance", "touch"] = Field(
        "", description="docked by distance or by touch; empty: by touch if stall detection is used; not in Nav2"
    )
    use_stall_detection: bool = Field(default=False, description="detect contact by stalled joints")
    stall_joint_names: list[str] = Field([], description="names of the joints, whose mean is used")
    stall_velocity_threshold: float = Field(1.0, ge=0, description="velocity below which a joint stalls [rad/s]")
    stall_effort_threshold: float = Field(1.0, ge=0, description="effort above which a joint stalls [Nm]")

    detector_service_name: str = Field(
        "", description="service std_srvs/Trigger that switches the detector on and off; empty: none"
    )
    detector_service_timeout: float = Field(5.0, gt=0, description="timeout of the service [s]")
    subscribe_toggle: bool = Field(default=False, description="subscribe to detections only while docking")

    @model_validator(mode="after")
    def _fits(self) -> SimpleNonChargingDockParameters:
        if self.rotate_to_dock and self.dock_direction != "backward":
            raise ValueError("rotate_to_dock needs dock_direction: backward")
        if self.use_stall_detection and not self.stall_joint_names:
            raise ValueError("use_stall_detection needs stall_joint_names")
        return self


class SimpleChargingDockParameters(SimpleNonChargingDockParameters):
    """Parameters of a dock that charges."""

    use_battery_status: bool = Field(default=True, description="detect charging by battery_state; false: by contact")
    charging_threshold: float = Field(0.5, description="current above which the battery charges [A]")


class Received(NamedTuple):
    """A message and the time of its arrival [s]."""

    message: Any
    at: float


class DockPlugin:
    """A dock type, and Nav2's dock without a charger.

    Args:
        name: Name of the instance, to which the `type` of a dock refers.
        parameters: Names and values, as in a parameter file.
        distribution: Distribution of Nav2 for which they were written; empty if it is unknown.

    Raises:
        InvalidValue: If a parameter is unknown or invalid; one line per fault.

    Attributes:
        uses_battery: Whether the state of the battery is used.
        contact_topic: Topic of a contact switch; empty if there is none.
        is_charger: Whether a docked robot may be charged.
    """

    Parameters: type[SimpleNonChargingDockParameters] = SimpleNonChargingDockParameters
    is_charger = False

    def __init__(self, name: str, parameters: Mapping[str, object], distribution: str = "") -> None:
        self.name = name
        self.parameters = p = parse_parameters(self.Parameters, parameters, name)
        self.uses_battery = bool(getattr(p, "use_battery_status", False))
        self.contact_topic = str(getattr(p, "contact_topic", ""))
        angles = (
            p.external_detection_rotation_roll, p.external_detection_rotation_pitch, p.external_detection_rotation_yaw
        )  # fmt: skip
        try:
            self._rotation = detection_rotation(*angles, distribution)
        except InvalidValue as error:
            raise InvalidValue(f"{name}.{error}") from error

    @classmethod
    def known_names(cls) -> frozenset[str]:
        """Return the names of all parameters."""
        return frozenset(cls.Parameters.model_fields)

    @property
    def direction(self) -> DockDirection:
        """Gear of the last motion."""
        return DockDirection(self.parameters.dock_direction)

    def docked_pose(self, dock: Pose2) -> Pose2:
        """Return the pose of the docked robot."""
        return docked_pose(dock, self.direction)

    def stored_pose(self, docked: Pose2) -> Pose2:
        """Return Nav2's pose of the dock of a docked robot."""
        return self.docked_pose(docked)  # half a turn is its own inverse

    def staging_pose(self, dock: Pose2) -> Pose2:
        """Return the pose at which the approach to a dock begins."""
        p = self.parameters
        return dock @ Pose2(p.staging_x_offset, 0.0, p.staging_yaw_offset)

    def dock_type(self, settings: Mapping[str, object]) -> DockType:
        """Return a new dock type for the executor.

        Args:
            settings: Parameters of `SimpleDock` from the executor's settings.
        """
        p = self.parameters
        contact = p.contact or ("touch" if p.use_stall_detection else "distance")
        return SimpleDock(contact=contact, **settings)

    def detection(self, message: Any, base: Transform) -> Detection:
        """Return the docked pose of a detection.

        Args:
            message: Detected pose, in the frame of its header.
            base: Pose of that frame in the robot's frame, at the time of the message.

        Raises:
            InvalidMessage: If a number is not finite, the orientation is invalid, or the dock's x axis points up or
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
        ahead = (turned @ Transform("docked", "ahead", base.stamp, (1.0, 0.0, 0.0), _LEVEL)).translation
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

    def is_stalled(self, received: Received | None, now: float) -> bool:
        """Whether the joints push without turning, by the newest sensor_msgs/JointState.

        Raises:
            InvalidMessage: If velocity or effort of a joint is missing.
        """
        p = self.parameters
        if received is None or not p.use_stall_detection or now - received.at > _STALL_AGE:
            return False
        message = received.message
        rows = [i for i, name in enumerate(message.name) if name in p.stall_joint_names]
        if not rows:
            return False
        if max(rows) >= min(len(message.velocity), len(message.effort)):
            raise InvalidMessage(f"JointState: {message.name[max(rows)]}: needs velocity and effort")
        velocity = sum(abs(message.velocity[i]) for i in rows) / len(rows)
        effort = sum(abs(message.effort[i]) for i in rows) / len(rows)
        # NaN is not a stall: comparisons with it are false.
        return bool(velocity < p.stall_velocity_threshold and effort > p.stall_effort_threshold)

    def is_switched(self, received: Received | None, now: float) -> bool | None:
        """Return the state of the contact switch; None without a recent std_msgs/Bool of `contact_topic`."""
        if (
            received is None
            or not self.contact_topic
            or now - received.at > getattr(self.parameters, "contact_timeout", 0.0)
        ):
            return None
        return bool(received.message.data)

    def current(self, received: Received | None, now: float) -> float | None:
        """Return the current of the newest sensor_msgs/BatteryState [A]; None without a recent, finite value."""
        if not self.uses_battery or received is None or now - received.at > _CHARGE_AGE:
            return None
        current = float(received.message.current)
        return current if math.isfinite(current) else None

    def is_charging(self, received: Received | None, now: float) -> bool:
        """Whether the battery is being charged, by the newest sensor_msgs/BatteryState.

        Raises:
            PluginError: If the dock type returns an invalid value.
        """
        return self._checked_type.is_charging(Measurements(now, None, current=self.current(received, now)))

    @property
    def waits_for_charge(self) -> bool:
        """Whether docking ends with the charge instead of the contact.

        Raises:
            PluginError: If the dock type returns an invalid value.
        """
        return self._checked_type.waits_for_charge

    @property
    def _checked_type(self) -> CheckedDockType:
        """A new dock type, for queries outside a task."""
        return CheckedDockType(self.dock_type({}))


class SimpleChargingDock(DockPlugin):
    """Nav2's charging dock."""

    Parameters = SimpleChargingDockParameters
    parameters: SimpleChargingDockParameters
    is_charger = True

    def dock_type(self, settings: Mapping[str, object]) -> DockType:
        """Return the dock type, which waits for a charging current above the threshold if the battery is used."""
        if not self.uses_battery:
            return super().dock_type(settings)
        threshold = self.parameters.charging_threshold
        return super().dock_type({**settings, "charging_current": threshold, "wait_for_charge": True})


class OwnDockParameters(SimpleNonChargingDockParameters):
    """Parameters of a dock with a third party's `DockType`, in addition to those of the dock type."""

    use_battery_status: bool = Field(default=False, description="pass the current of battery_state to the dock type")

    contact_topic: str = Field("", description="topic std_msgs/Bool of a switch, such as a photocell; empty: none")
    contact_timeout: float = Field(0.5, gt=0, description="largest age of a message of that topic [s]")

    @model_validator(mode="after")
    def _has_no_contact(self) -> OwnDockParameters:
        if self.contact:
            raise ValueError("contact: is defined by the dock type and must not be set")
        return self


class OwnDock(DockPlugin):
    """A third party's dock type, found by its entry point.

    Parameters that the dock type declares are passed to it; the others are those of `OwnDockParameters`.

    Raises:
        InvalidValue: As `DockPlugin`.
        PluginError: If the dock type cannot be built.

    Attributes:
        entry_point: Name of the dock type; set by the subclass that `plugin_class` returns.
    """

    Parameters = OwnDockParameters
    entry_point = ""

    def __init__(self, name: str, parameters: Mapping[str, object], distribution: str = "") -> None:
        kind = load_plugin(DockType, self.entry_point)
        names = _own_names(kind)
        self._own = {key: value for key, value in parameters.items() if key in names}
        parse_parameters(kind.Parameters, self._own, name)  # name of the block in error messages
        super().__init__(name, {key: value for key, value in parameters.items() if key not in names}, distribution)
        self.is_charger = self.waits_for_charge

    @classmethod
    def known_names(cls) -> frozenset[str]:
        """Return the names of the parameters of the dock type and of the server."""
        return super().known_names() | _own_names(load_plugin(DockType, cls.entry_point))

    def staging_pose(self, dock: Pose2) -> Pose2:
        """Return the first staging pose of the dock type, or that of `DockPlugin` with `rotate_to_dock`.

        Raises:
            PluginError: If the dock type returns an invalid value.
        """
        p = self.parameters
        if p.rotate_to_dock:
            return super().staging_pose(dock)
        gear = 1.0 if self.direction is DockDirection.FORWARD else -1.0
        return self.docked_pose(dock) @ self._checked_type.staging_poses(gear, abs(p.staging_x_offset))[0]

    def dock_type(self, settings: Mapping[str, object]) -> DockType:  # noqa: ARG002 - for SimpleDock only
        """Return a new dock type of the third party."""
        return create_plugin(DockType, self.entry_point, self._own)


def _own_names(kind: type[DockType]) -> frozenset[str]:
    """Return the names of a dock type's parameters, as in a parameter file."""
    return frozenset(spec.alias or name for name, spec in kind.Parameters.model_fields.items())


DOCK_PLUGINS: Mapping[str, type[DockPlugin]] = dict(zip(NAV2_DOCKS, (SimpleChargingDock, DockPlugin), strict=True))
"""Dock plugins by Nav2's class names."""


def plugin_class(name: str, nav2_class: object) -> type[DockPlugin]:
    """Return the class of the dock plugin for the name of a Nav2 class or of a dock type.

    Args:
        name: Name of the instance, for messages.
        nav2_class: Nav2's class name, also written with a slash, or the name of a dock type's entry point.

    Raises:
        DockNotValid: If the class or the dock type is unknown.
        InvalidValue: If no class is given.
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
