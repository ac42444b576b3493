"""The structure of a scenario file, `optdock-scenario/1`: keys, types, defaults, and the values they stand for.

Rules about values live in the constructors of the values; here they are called key by key, so that one reading
reports every fault.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Literal

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    ValidationInfo,
    field_validator,
    model_validator,
)
from pydantic_core import core_schema

from optdock.dock import Dock, DockDirection
from optdock.errors import InvalidValue
from optdock.geometry.footprint import Footprint
from optdock.geometry.polygon import simple_polygon
from optdock.geometry.pose import Pose2
from optdock.io.numbers import check_outline, check_speed, check_yaw, is_number
from optdock.limits import MotionLimits, SpeedZone
from optdock.pipeline import DEFAULT_TIME_BUDGET
from optdock.problem import ClearanceRule
from optdock.robot import Drive, Robot

__all__ = ["SECTIONS", "ScenarioDocument", "known_keys"]

_FARTHEST = 1e8  # [m]; as for polygons
SECTIONS = ("planner", "smoother", "timing", "controller", "goal_checker")


def _pose(value: object) -> Pose2:
    if not (isinstance(value, list) and len(value) == 3 and all(map(is_number, value))):
        raise InvalidValue(f"must be [x, y, yaw] in m, m, rad, got {value!r}")
    if any(math.isfinite(part) and abs(part) > _FARTHEST for part in value):
        raise InvalidValue(f"must be within +-{_FARTHEST:g} m, got {value!r}")
    pose = Pose2.from_sequence(value)
    check_yaw(pose.yaw)
    return pose


def _outline(value: object) -> Footprint:
    footprint = _footprint(value)
    check_outline(footprint)
    return footprint


def _speed(value: float) -> float:
    check_speed(value)
    return value


def _footprint(value: object) -> Footprint:
    if isinstance(value, str):
        return Footprint.from_string(value)
    if isinstance(value, dict) and set(value) == {"radius"} and is_number(value["radius"]):
        return Footprint.from_radius(float(value["radius"]))
    if not isinstance(value, list):
        raise InvalidValue(f"must be a list of points [x, y], a text like it, or {{radius: r}}, got {value!r}")
    return Footprint(value)  # type: ignore[arg-type]  # Footprint checks and converts what it is given


def _polygon(value: object) -> list[list[float]]:
    polygon: list[list[float]] = simple_polygon(value, "polygon").tolist()  # type: ignore[arg-type]  # checks it itself
    return polygon


def _distance(value: float) -> float:
    if not (math.isfinite(value) and value >= 0.0):
        raise InvalidValue(f"must be finite and >= 0 m, got {value}")
    return value


@dataclass(frozen=True)
class _Parsed:
    """Annotation: the field is what `parse` makes of the value; pydantic does not look into its type."""

    parse: Callable[[object], object]

    def __get_pydantic_core_schema__(self, source: object, handler: object) -> core_schema.CoreSchema:
        """Pydantic's hook."""
        return core_schema.no_info_plain_validator_function(self.parse)


Number = Annotated[float, Field(strict=True)]
Distance = Annotated[Number, AfterValidator(_distance)]
PoseValue = Annotated[Pose2, _Parsed(_pose)]
FootprintValue = Annotated[Footprint, _Parsed(_outline)]
Speed = Annotated[Number, AfterValidator(_speed)]
PolygonValue = Annotated[list[list[float]], _Parsed(_polygon)]
Section = dict[str, object]


class _Part(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", arbitrary_types_allowed=True)


_LIMITS = MotionLimits()


class LimitsDocument(_Part):
    """`robot.limits`; what is not given keeps the default of `MotionLimits`."""

    max_speed: Speed = _LIMITS.max_speed
    max_reverse_speed: Speed = _LIMITS.max_reverse_speed
    max_acceleration: Number = _LIMITS.max_acceleration
    max_deceleration: Number = _LIMITS.max_deceleration
    max_jerk: Number = _LIMITS.max_jerk
    max_yaw_rate: Number = _LIMITS.max_yaw_rate
    max_yaw_acceleration: Number = _LIMITS.max_yaw_acceleration
    max_lateral_acceleration: Number = _LIMITS.max_lateral_acceleration
    max_wheel_speed: Speed = _LIMITS.max_wheel_speed
    track_width: Number = _LIMITS.track_width
    max_curvature: Number = _LIMITS.max_curvature
    max_curvature_rate: Number = _LIMITS.max_curvature_rate

    @field_validator("*")
    @classmethod
    def _in_range(cls, value: float, info: ValidationInfo) -> float:
        MotionLimits(**{str(info.field_name): value})
        return value

    def value(self) -> MotionLimits:
        """The limits."""
        return MotionLimits(**self.model_dump())


class RobotDocument(_Part):
    """`robot`."""

    footprint: FootprintValue | None = None
    radius: Number | None = None
    drive: Drive = Drive.DIFFERENTIAL
    limits: LimitsDocument = LimitsDocument()

    @field_validator("radius")
    @classmethod
    def _positive(cls, value: float | None) -> float | None:
        if value is not None:
            check_outline(Footprint.from_radius(value))
        return value

    @model_validator(mode="after")
    def _one_outline(self) -> RobotDocument:
        if (self.footprint is None) == (self.radius is None):
            raise InvalidValue(f"needs either footprint or radius, got {'neither' if self.radius is None else 'both'}")
        return self

    def value(self) -> Robot:
        """The robot."""
        outline = self.footprint if self.footprint is not None else Footprint.from_radius(self.radius or math.nan)
        return Robot(outline, self.limits.value(), self.drive)


class DockDocument(_Part):
    """`dock`."""

    pose: PoseValue
    footprint: FootprintValue | None = None
    direction: DockDirection = DockDirection.AUTO
    final_straight: Number = 0.0
    approach_speed: Speed = math.inf
    approach_distance: Distance = 0.0

    @field_validator("final_straight")
    @classmethod
    def _straight(cls, value: float) -> float:
        Dock(Pose2(0.0, 0.0, 0.0), final_straight=value)
        return value

    @field_validator("approach_speed")
    @classmethod
    def _speed(cls, value: float) -> float:
        if not value > 0.0:
            raise InvalidValue(f"must be > 0 m/s, got {value}")
        return value

    @model_validator(mode="after")
    def _zone_is_whole(self) -> DockDocument:
        if math.isfinite(self.approach_speed) and self.approach_distance == 0.0:
            raise InvalidValue("approach_speed has no effect without approach_distance > 0 m")
        return self

    def value(self) -> Dock:
        """The dock."""
        zone = SpeedZone(self.approach_speed, self.approach_distance)
        return Dock(self.pose, self.footprint, self.direction, self.final_straight, zone)


class StartDocument(_Part):
    """`start`."""

    pose: PoseValue
    speed: Annotated[Speed, Field(allow_inf_nan=False)] = 0.0
    curvature: Annotated[Number, Field(allow_inf_nan=False)] | None = None

    @property
    def known_curvature(self) -> float | None:
        """The curvature the path must start with: as given; else free at rest and straight in motion [1/m]."""
        return 0.0 if self.curvature is None and self.speed != 0.0 else self.curvature


_CLEARANCE = ClearanceRule()


class ClearanceDocument(_Part):
    """`clearance`; one number holds everywhere, also at the dock."""

    required: Distance = _CLEARANCE.required
    at_dock: Distance = _CLEARANCE.at_dock
    taper: Distance = _CLEARANCE.taper

    @model_validator(mode="after")
    def _grows(self) -> ClearanceDocument:
        self.value()
        return self

    def value(self) -> ClearanceRule:
        """The rule."""
        return ClearanceRule(self.required, self.at_dock, self.taper)


def _clearance(value: object) -> object:
    return {"required": value, "at_dock": value} if is_number(value) else value


class ScenarioDocument(_Part):
    """A whole scenario file."""

    format: Literal["optdock-scenario/1"]
    frame: str = "map"
    map: str | None = None
    obstacles: list[PolygonValue] = []
    robot: RobotDocument
    dock: DockDocument
    start: StartDocument
    clearance: Annotated[ClearanceDocument, BeforeValidator(_clearance)] = ClearanceDocument()
    time_budget: Number = DEFAULT_TIME_BUDGET
    planner: Section = {}
    smoother: Section = {}
    timing: Section = {}
    controller: Section = {}
    goal_checker: Section = {}

    @field_validator("time_budget")
    @classmethod
    def _some_time(cls, value: float) -> float:
        if not (math.isfinite(value) and value > 0.0):
            raise InvalidValue(f"must be finite and > 0 s, got {value}")
        return value


_MAPPINGS: dict[tuple[str, ...], type[_Part]] = {
    (): ScenarioDocument,
    ("robot",): RobotDocument,
    ("robot", "limits"): LimitsDocument,
    ("dock",): DockDocument,
    ("start",): StartDocument,
    ("clearance",): ClearanceDocument,
}


def known_keys(key: tuple[str | int, ...]) -> tuple[str, ...]:
    """The keys that the mapping at `key` accepts."""
    model = _MAPPINGS.get(tuple(str(part) for part in key))
    return tuple(model.model_fields) if model else ()
