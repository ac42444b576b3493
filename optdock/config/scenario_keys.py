"""Models of a scenario file, `optdock-scenario/1`: keys, types, defaults and values.

The rules are checked by the constructors of the values. The models call these constructors key by key, so that every
fault is reported. The scenario reference and the JSON schema in `optdock.config.reference` are generated from the
descriptions of the keys (`_key`), which end with the unit in brackets.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING, Annotated, Any, Literal, get_args

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    GetJsonSchemaHandler,
    StrictBool,
    ValidationInfo,
    WithJsonSchema,
    create_model,
    field_validator,
    model_validator,
)
from pydantic_core import core_schema

from optdock.config.plugin_sections import PLUGIN_DEFAULTS
from optdock.errors import InvalidValue
from optdock.geometry.footprint import Footprint
from optdock.geometry.polygon import simple_polygon
from optdock.geometry.pose import Pose2
from optdock.io.numbers import MOST_POLYGONS, check_outline, check_speed, check_vertices, check_yaw, is_number
from optdock.io.quoting import shown
from optdock.model.camera import Camera
from optdock.model.clearance_rule import ClearanceRule
from optdock.model.dock import Dock, DockDirection
from optdock.model.limits import DIMENSIONS, LIMITS, MotionLimits
from optdock.model.robot import Drive, Robot, TrackingTube, check_drive, check_price
from optdock.planning.pipeline import DEFAULT_PLANNERS, DEFAULT_TIME_BUDGET

__all__ = ["SECTIONS", "ScenarioDocument", "known_keys", "synonym"]

_FARTHEST = 1e8  # [m]: the same limit as for polygons
# Names of the same quantities in Nav2's planners and controllers.
_SYNONYMS = {
    "min_turning_radius": "max_curvature",
    "minimum_turning_radius": "max_curvature",
    "max_velocity": "max_speed",
    "max_vel_x": "max_speed",
    "min_vel_x": "max_reverse_speed",
    "max_vel_theta": "max_yaw_rate",
    "acc_lim_x": "max_acceleration",
    "decel_lim_x": "max_deceleration",
    "wheel_separation": "track_width",
    "wheel_base": "wheelbase",
    "robot_radius": "radius",
}
SECTIONS = ("planner", "smoother", "timing", "controller", "goal_checker")


def _pose(value: object) -> Pose2:
    if not (isinstance(value, list) and len(value) == 3 and all(map(is_number, value))):
        raise InvalidValue(f"must be [x, y, yaw] in m, m, rad, got {shown(value)}")
    if any(math.isfinite(part) and abs(part) > _FARTHEST for part in value):
        raise InvalidValue(f"must be within +-{_FARTHEST:g} m, got {shown(value)}")
    pose = Pose2.from_sequence(value)
    check_yaw(pose.yaw)
    return pose


def _point(value: object) -> tuple[float, float]:
    if not (isinstance(value, list) and len(value) == 2 and all(map(is_number, value))):
        raise InvalidValue(f"must be [x, y] in m, got {shown(value)}")
    if any(math.isfinite(part) and abs(part) > _FARTHEST for part in value):
        raise InvalidValue(f"must be within +-{_FARTHEST:g} m, got {shown(value)}")
    place = Pose2(value[0], value[1], 0.0)
    return place.x, place.y


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
        raise InvalidValue(f"must be a list of points [x, y], the same as text, or {{radius: r}}, got {shown(value)}")
    check_vertices(value)
    return Footprint(value)  # type: ignore[arg-type]  # Footprint checks and converts the value


def _polygon(value: object) -> list[list[float]]:
    check_vertices(value)
    polygon: list[list[float]] = simple_polygon(value, "polygon").tolist()  # type: ignore[arg-type]  # checks the value
    return polygon


def _not_too_many(polygons: object) -> object:
    if isinstance(polygons, list) and len(polygons) > MOST_POLYGONS:
        raise InvalidValue(f"must be at most {MOST_POLYGONS} polygons, got {len(polygons)}; draw them into the map")
    return polygons


def _distance(value: float) -> float:
    if not (math.isfinite(value) and value >= 0.0):
        raise InvalidValue(f"must be finite and >= 0 m, got {value}")
    return value


@dataclass(frozen=True)
class _Parsed:
    """Annotation of a field whose value is the result of `parse`.

    `schema`: JSON schema of the value; `form`: notation of the value in the documentation.
    """

    parse: Callable[[object], object]
    form: str
    schema: Mapping[str, object] = field(hash=False)

    def __get_pydantic_core_schema__(self, source: object, handler: object) -> core_schema.CoreSchema:
        """Pydantic's hook."""
        return core_schema.no_info_plain_validator_function(self.parse)

    def __get_pydantic_json_schema__(self, core: object, handler: object) -> dict[str, object]:
        """Pydantic's hook."""
        return {**self.schema, "x-form": self.form}


_POINTS = {
    "type": "array",
    "minItems": 3,
    "items": {"type": "array", "items": {"type": "number"}, "minItems": 2, "maxItems": 2},
}
_RADIUS = {
    "type": "object",
    "properties": {"radius": {"type": "number", "exclusiveMinimum": 0}},
    "required": ["radius"],
    "additionalProperties": False,
}
_POINT = {"type": "array", "items": {"type": "number"}, "minItems": 2, "maxItems": 2}
_POSE = {"type": "array", "items": {"type": "number"}, "minItems": 3, "maxItems": 3}

Number = Annotated[float, Field(strict=True)]
Distance = Annotated[Number, AfterValidator(_distance)]
PointValue = Annotated[tuple[float, float], _Parsed(_point, "[x, y]", _POINT)]
PoseValue = Annotated[Pose2, _Parsed(_pose, "[x, y, yaw]", _POSE)]
FootprintValue = Annotated[
    Footprint,
    _Parsed(
        _outline,
        "[[x, y], ...], the same as text, or {radius: r}",
        {"anyOf": [_POINTS, {"type": "string"}, _RADIUS]},
    ),
]
Speed = Annotated[Number, AfterValidator(_speed)]
PolygonValue = Annotated[list[list[float]], _Parsed(_polygon, "[[x, y], ...]", _POINTS)]
Section = Annotated[
    dict[str, object], WithJsonSchema({"type": "object", "x-form": "{plugin: NAME, parameter: value, ...}"})
]


def _key(
    description: str,
    default: object = ...,
    *,
    absent: str = "",
    above: float | None = None,
    least: float | None = None,
    finite: bool = False,
) -> Any:  # noqa: ANN401 - as pydantic's Field
    """Return the field of one key of the file.

    Args:
        description: Description with the unit in brackets.
        default: Default value; if it is omitted, the key is required.
        absent: Meaning of a missing key, if not the default.
        above: Exclusive lower bound of the constructor.
        least: Inclusive lower bound of the constructor.
        finite: Whether infinity, `.inf` in YAML, is rejected.
    """
    values = {"exclusiveMinimum": above, "minimum": least, "x-absent": absent or None, "x-finite": finite or None}
    extra: Any = {name: value for name, value in values.items() if value is not None}
    return Field(default, description=description, json_schema_extra=extra)


class _Part(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", arbitrary_types_allowed=True, defer_build=True)


_TUBE, _ORIGIN = TrackingTube(), Pose2(0.0, 0.0, 0.0)


def _limit_key(name: str, default: float) -> tuple[object, object]:
    """Return type and key of a field of `MotionLimits`, as described in `LIMITS` and `DIMENSIONS`."""
    if name in DIMENSIONS:
        return Number, _key(f"{DIMENSIONS[name]} [m]", default, least=0, finite=True)
    limit = LIMITS[name]
    kind, absent = Speed if limit.unit == "m/s" else Number, "" if limit.finite else "unlimited"
    return kind, _key(f"{limit.words} [{limit.unit}]", default, absent=absent, above=0, finite=limit.finite)


if TYPE_CHECKING:

    class _LimitKeys(_Part):
        """Keys for the fields of `MotionLimits`."""

else:
    _LimitKeys = create_model(
        "_LimitKeys",
        __base__=_Part,
        **{
            field.name: _limit_key(field.name, field.default)
            for field in fields(MotionLimits)
            if field.name in LIMITS or field.name in DIMENSIONS
        },
    )


class LimitsDocument(_LimitKeys):
    """`robot.limits`; missing keys have the defaults of `MotionLimits`."""

    @field_validator("*")
    @classmethod
    def _in_range(cls, value: float, info: ValidationInfo) -> float:
        MotionLimits(**{"wheelbase": 1.0, str(info.field_name): value})
        return value

    @model_validator(mode="after")
    def _steers(self) -> LimitsDocument:
        self.value()
        return self

    def value(self) -> MotionLimits:
        """Motion limits that the keys define."""
        return MotionLimits(**self.model_dump())


class TrackingDocument(_Part):
    """`robot.tracking`."""

    cross: Number = _key("largest distance from the path [m]", _TUBE.cross, least=0, finite=True)
    yaw: Number = _key("largest heading error [rad]", _TUBE.yaw, least=0, finite=True)

    @field_validator("*")
    @classmethod
    def _in_range(cls, value: float, info: ValidationInfo) -> float:
        TrackingTube(**{str(info.field_name): value})
        return value

    def value(self) -> TrackingTube:
        """Tracking tube that the keys define."""
        return TrackingTube(self.cross, self.yaw)


class CameraDocument(_Part):
    """`robot.camera`."""

    mount: PoseValue = _key(
        "pose of the camera in the robot's frame; the optical axis is the x axis of this pose [m, m, rad]"
    )
    field_of_view: Number = _key("full angle of the cone, at most 2 pi [rad]", above=0, finite=True)
    min_range: Number = _key("smallest distance of the marker [m]", 0.0, least=0, finite=True)
    max_range: Number = _key("largest distance of the marker [m]", math.inf, above=0, absent="unlimited")

    @field_validator("field_of_view", "min_range", "max_range")
    @classmethod
    def _in_range(cls, value: float, info: ValidationInfo) -> float:
        Camera(_ORIGIN, **{"field_of_view": 1.0, str(info.field_name): value})
        return value

    @model_validator(mode="after")
    def _sees_something(self) -> CameraDocument:
        if not self.max_range > self.min_range:
            raise InvalidValue(f"max_range must be > min_range = {self.min_range} m, got {self.max_range}")
        return self

    def value(self) -> Camera:
        """Camera that the keys define."""
        return Camera(**dict(self))


class RobotDocument(_Part):
    """`robot`."""

    footprint: FootprintValue | None = _key(
        "polygon in the robot's frame, whose origin follows the path [m]", None, absent="radius must be given"
    )
    radius: Number | None = _key("radius of a round robot [m]", None, above=0, absent="footprint must be given")
    drive: Drive = _key("kind of drive", Drive.DIFFERENTIAL)
    turns_in_place: StrictBool = _key(
        "whether paths may turn in place; for a differential drive with limits of yaw rate and yaw acceleration",
        False,  # noqa: FBT003 - as pydantic's Field
    )
    tracking: TrackingDocument = _key(
        "tracking tube: the certificate is valid for every pose within it",
        TrackingDocument(),
        absent="no tube",
    )
    camera: CameraDocument | None = _key(
        "camera that detects the dock's marker; see dock.visible_distance", None, absent="none"
    )
    reverse_price: Number = _key(
        "price of a metre in reverse in addition to its duration, to compare plans [s/m]", 0.0, least=0, finite=True
    )
    limits: LimitsDocument = _key("limits of the motion", LimitsDocument(), absent="each limit's own default")

    @field_validator("radius")
    @classmethod
    def _positive(cls, value: float | None) -> float | None:
        if value is not None:
            check_outline(Footprint.from_radius(value))
        return value

    @field_validator("reverse_price")
    @classmethod
    def _no_reward(cls, value: float) -> float:
        return check_price(value)

    @model_validator(mode="after")
    def _one_outline(self) -> RobotDocument:
        if (self.footprint is None) == (self.radius is None):
            raise InvalidValue(f"needs either footprint or radius, got {'neither' if self.radius is None else 'both'}")
        return self

    @model_validator(mode="after")
    def _steers(self) -> RobotDocument:
        check_drive(self.drive, self.limits.value(), turns_in_place=self.turns_in_place)
        return self

    def value(self) -> Robot:
        """Robot that the keys define."""
        outline = self.footprint if self.footprint is not None else Footprint.from_radius(self.radius or math.nan)
        camera = None if self.camera is None else self.camera.value()
        drive, tracking = self.drive, self.tracking.value()
        return Robot(outline, self.limits.value(), drive, self.turns_in_place, tracking, camera, self.reverse_price)


class DockDocument(_Part):
    """`dock`."""

    pose: PoseValue = _key("the robot's pose when docked [m, m, rad]")
    footprint: FootprintValue | None = _key(
        "polygon of the station in the docked robot's frame, an obstacle [m]", None, absent="no obstacle"
    )
    direction: DockDirection = _key(
        "gear of the last motion; auto: chosen by the side of the start", DockDirection.AUTO
    )
    final_straight: Number = _key("length of the straight end of the path [m]", 0.0, least=0, finite=True)
    approach_speed: Speed = _key(
        "largest speed over the last approach_distance [m/s]", math.inf, above=0, absent="no slow part"
    )
    approach_distance: Distance = _key(
        "length of the slow part at the end of the path; required by approach_speed [m]", 0.0, least=0, finite=True
    )
    marker: PointValue | None = _key(
        "point that the robot's camera detects, in the docked robot's frame, as footprint [m]", None, absent="none"
    )
    visible_distance: Distance = _key(
        "distance before the end of the path from which the marker must be in view; needs marker [m]",
        0.0,
        least=0,
        finite=True,
        absent="nowhere",
    )
    blind_distance: Distance = _key(
        "last distance without required view, less than visible_distance [m]", 0.0, least=0, finite=True
    )

    @field_validator("final_straight")
    @classmethod
    def _straight(cls, value: float) -> float:
        Dock(_ORIGIN, final_straight=value)
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

    @model_validator(mode="after")
    def _view_is_whole(self) -> DockDocument:
        Dock(
            _ORIGIN,
            marker=self.marker,
            visible_distance=self.visible_distance,
            blind_distance=self.blind_distance,
        )
        return self

    def value(self) -> Dock:
        """Dock that the keys define."""
        return Dock(**dict(self))


class StartDocument(_Part):
    """`start`."""

    pose: PoseValue = _key("pose of the robot [m, m, rad]")
    speed: Annotated[Speed, Field(allow_inf_nan=False)] = _key(
        "signed speed, negative in reverse [m/s]", 0.0, finite=True, absent="at rest"
    )
    curvature: Annotated[Number, Field(allow_inf_nan=False)] | None = _key(
        "curvature of the path at its start in the direction of travel, left positive [1/m]",
        None,
        finite=True,
        absent="free at rest, 0 in motion",
    )
    acceleration: Annotated[Number, Field(allow_inf_nan=False)] = _key(
        "derivative of the signed speed [m/s^2]", 0.0, finite=True, absent="none"
    )

    @property
    def known_curvature(self) -> float | None:
        """Start curvature of the path [1/m].

        If the key is missing, the value is None (free) at rest and 0 in motion.
        """
        return 0.0 if self.curvature is None and self.speed != 0.0 else self.curvature


_CLEARANCE = ClearanceRule()


class ClearanceDocument(_Part):
    """`clearance`; a single number applies everywhere, also at the dock."""

    required: Distance = _key("clearance away from the dock [m]", _CLEARANCE.required, least=0, finite=True)
    at_dock: Distance = _key("clearance at the dock, at most `required` [m]", _CLEARANCE.at_dock, least=0, finite=True)
    taper: Distance = _key(
        "distance over which the clearance grows from at_dock to required [m]",
        _CLEARANCE.taper,
        least=0,
        finite=True,
    )
    dock_run: Distance = _key(
        "distance from the dock within which at_dock is required [m]",
        _CLEARANCE.dock_run,
        least=0,
        finite=True,
    )
    at_start: Distance | None = _key(
        "replaces at_dock at a start with less clearance than required, such as in a dock [m]",
        None,
        least=0,
        finite=True,
        absent="5 mm less than the clearance at the start, but at least half of it",
    )

    @model_validator(mode="after")
    def _grows(self) -> ClearanceDocument:
        self.value()
        return self

    def value(self) -> ClearanceRule:
        """Clearance rule that the keys define."""
        return ClearanceRule(self.required, self.at_dock, self.taper, self.dock_run, self.at_start)


def _clearance(value: object) -> object:
    return {"required": value, "at_dock": value} if is_number(value) else value


class _OrNumber:
    """Annotation: the JSON schema also accepts a number."""

    def __get_pydantic_json_schema__(
        self, core: core_schema.CoreSchema, handler: GetJsonSchemaHandler
    ) -> dict[str, object]:
        """Pydantic's hook."""
        return {"anyOf": [handler(core), {"type": "number", "minimum": 0}]}


class ScenarioDocument(_Part):
    """A whole scenario file."""

    format: Literal["optdock-scenario/1"] = _key("format of the file")
    frame: str = _key("name of the coordinate frame", "map")
    map: str | None = _key(
        "map (map_server YAML), relative to this file; unknown cells and the area outside are obstacles",
        None,
        absent="only the obstacles below",
    )
    obstacles: Annotated[list[PolygonValue], BeforeValidator(_not_too_many)] = _key(
        "polygons, convex or not, in either orientation [m]", [], absent="none"
    )
    robot: RobotDocument = _key("outline, drive and limits")
    dock: DockDocument = _key("goal of the robot")
    start: StartDocument = _key("start of the robot")
    clearance: Annotated[ClearanceDocument, BeforeValidator(_clearance), _OrNumber()] = _key(
        "required distance of the footprint from obstacles; a single number applies everywhere, also at the dock [m]",
        ClearanceDocument(),
        absent="each key's own default",
    )
    time_budget: Number = _key("wall-clock time for planning [s]", DEFAULT_TIME_BUDGET, above=0, finite=True)
    planner: Section = _key(
        "planner of the raw path, and its parameters",
        {},
        absent=" and then ".join(DEFAULT_PLANNERS),
    )
    smoother: Section = _key("smoother, and its parameters", {}, absent=PLUGIN_DEFAULTS["smoother"])
    timing: Section = _key("time parameterizer, and its parameters", {}, absent=PLUGIN_DEFAULTS["timing"])
    controller: Section = _key(
        "controller of `optdock simulate`, and its parameters", {}, absent=PLUGIN_DEFAULTS["controller"]
    )
    goal_checker: Section = _key(
        "goal checker of `optdock simulate`, and its parameters",
        {},
        absent=PLUGIN_DEFAULTS["goal_checker"],
    )

    @field_validator("time_budget")
    @classmethod
    def _some_time(cls, value: float) -> float:
        if not (math.isfinite(value) and value > 0.0):
            raise InvalidValue(f"must be finite and > 0 s, got {value}")
        return value


def known_keys(key: tuple[str | int, ...]) -> tuple[str, ...]:
    """Return the keys of the mapping at `key`."""
    model: type[BaseModel] | None = ScenarioDocument
    for part in key:
        field = model.model_fields.get(str(part)) if model else None
        kinds = (field.annotation, *get_args(field.annotation)) if field else ()  # for an optional mapping
        model = next((kind for kind in kinds if isinstance(kind, type) and issubclass(kind, BaseModel)), None)
    return tuple(model.model_fields) if model else ()


def synonym(key: tuple[str | int, ...], value: object) -> str:
    """Return `; write ...` with the converted value for a key of another program, otherwise "".

    >>> synonym(("robot", "limits", "min_turning_radius"), 0.5)
    '; write max_curvature: 2, that is 1 / radius'
    """
    ours = _SYNONYMS.get(str(key[-1]), "")
    if ours not in known_keys(key[:-1]):
        return ""
    if not is_number(value) or not math.isfinite(value) or value == 0.0:
        return f"; write {ours}"
    is_radius = ours == "max_curvature"
    size = abs(1.0 / value if is_radius else value)
    return f"; write {ours}: {size:.5g}{', that is 1 / radius' if is_radius else ''}"
