"""Numbers and choices of a scene that are edited on the page of `optdock ui`.

`FIELDS` is the only table of them. Their units and descriptions are those of the keys of a scenario file. The ranges
are those of the sliders; a text may give any value that the scenario accepts.
"""

from __future__ import annotations

import dataclasses
import math
import re
from types import MappingProxyType
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.config import scenario_reference
from optdock.errors import InvalidValue
from optdock.geometry.footprint import Footprint
from optdock.io.numbers import check_outline, check_speed
from optdock.io.quoting import in_digits, shown
from optdock.model.dock import DockDirection
from optdock.model.limits import LIMITS, STEERING_UNITS
from optdock.model.robot import Drive
from optdock.planning.pipeline import DEFAULT_PLANNERS
from optdock.plugins.registry import PluginChoice, available_plugins

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence

    from optdock.model.limits import MotionLimits
    from optdock.model.problem import DockingProblem
    from optdock.ui.scene_edits import EditedScene

__all__ = ["FIELDS", "LONGEST_MESSAGE", "MOST_SECONDS", "UNLIMITED", "SceneField", "with_field"]

MOST_SECONDS = 60.0  # [s] of a time budget
LONGEST_MESSAGE = 200  # characters
UNLIMITED = "unlimited"
_LONGEST_NUMBER = 40  # characters
_NUMBER = re.compile(r"[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]{1,3})?")
_DEFAULT_PLANNERS = " and then ".join(DEFAULT_PLANNERS)


class SceneField(NamedTuple):
    """A number or a choice of a scene.

    Attributes:
        key: Key of the scenario file, with the part of its value, such as `robot.footprint.front`.
        label: Short name.
        unit: SI unit; empty for a choice.
        words: Description.
        slider: Lowest value, highest value and step of the slider; None for a choice.
        read: Function that returns the value of a scene; None if the scene has no such value.
        write: Function that returns the scene with another value; raises InvalidValue if it is out of range.
        choices: Function that returns the values of a choice; none for a number.
        can_be_unlimited: Whether infinity, written `unlimited`, is a value.
    """

    key: str
    label: str
    unit: str
    words: str
    slider: tuple[float, float, float] | None
    read: Callable[[EditedScene], float | str | None]
    write: Callable[[EditedScene, float | str], EditedScene]
    choices: Callable[[], tuple[str, ...]] = tuple
    can_be_unlimited: bool = False

    def text(self, scene: EditedScene) -> str:
        """Return the value of a scene as a text, for which `with_field` keeps all its digits.

        The text is empty if the scene has no such value.
        """
        value = self.read(scene)
        if value is None or isinstance(value, str):
            return value or ""
        return UNLIMITED if math.isinf(value) else in_digits(float(value))


def with_field(scene: EditedScene, key: str, text: str) -> EditedScene:
    """Return the scene with another value of a field; the scene itself if the value is the same.

    Args:
        scene: The scene.
        key: Key of the field in `FIELDS`.
        text: Value, any text.

    Raises:
        InvalidValue: If there is no such field in the scene, or the value violates a rule; the message names field,
            value and rule and has at most 200 characters.
    """
    field = FIELDS.get(key) if isinstance(key, str) else None
    if field is None:
        raise InvalidValue(f"field: the page has no field {shown(key)}")
    try:
        known = field.read(scene)
        if known is None:
            raise InvalidValue("this scene has no such value")
        value = _value(field, text)
        return scene if value == known or text == field.text(scene) else field.write(scene, value)
    except InvalidValue as error:
        message = f"{key}: {shown(text)}: {error}"
        raise InvalidValue(
            message if len(message) <= LONGEST_MESSAGE else f"{message[: LONGEST_MESSAGE - 3]}..."
        ) from None


def _value(field: SceneField, text: str) -> float | str:
    if not isinstance(text, str):
        raise InvalidValue(f"must be text, not {type(text).__name__}")
    given = text[: LONGEST_MESSAGE + 1].strip()
    if field.slider is None:
        known = field.choices()
        if given not in known:
            raise InvalidValue(f"must be one of {', '.join(known)}")
        return given
    if field.can_be_unlimited and given == UNLIMITED:
        return math.inf
    value = float(given) if len(given) <= _LONGEST_NUMBER and _NUMBER.fullmatch(given) else math.nan
    if not math.isfinite(value):
        more = f", or {UNLIMITED}" if field.can_be_unlimited else ""
        raise InvalidValue(f"must be a number such as 0.25{more}")
    return value + 0.0  # -0.0 + 0.0 is 0.0


def _at(owner: object, names: Sequence[str]) -> object:
    for name in names:
        owner = getattr(owner, name)
    return owner


def _replaced(owner: object, names: Sequence[str], value: object) -> object:
    """Return a dataclass with another value of a nested attribute, such as `robot`, `limits`, `max_speed`."""
    inner = value if len(names) == 1 else _replaced(getattr(owner, names[0]), names[1:], value)
    return dataclasses.replace(owner, **{names[0]: inner})  # type: ignore[type-var]  # all owners are dataclasses


def _changed(scene: EditedScene, **values: object) -> EditedScene:
    """Return the scene with other attributes of its problem, given as `robot__limits__max_speed`."""
    problem = scene.problem
    for name, value in values.items():
        problem = _replaced(problem, name.split("__"), value)  # type: ignore[assignment]  # of the class of its owner
    return scene.with_problem(problem)


def _number(
    key: str,
    slider: tuple[float, float, float],
    *,
    check: Callable[[float], None] = lambda _: None,
    is_given: Callable[[DockingProblem], bool] = lambda _: True,
    can_be_unlimited: bool = False,
    label: str = "",
) -> SceneField:
    """Return the field of a number that is an attribute of the problem with the name of the key."""
    names = key.split(".")

    def read(scene: EditedScene) -> float | None:
        value = _at(scene.problem, names) if is_given(scene.problem) else None
        return float(value) if isinstance(value, int | float) else None

    def write(scene: EditedScene, value: float | str) -> EditedScene:
        check(float(value))
        return _changed(scene, **{"__".join(names): value})

    known = _KEYS[key]
    shown_as = label or names[-1].replace("_", " ")
    return SceneField(
        key, shown_as, known.unit, known.description, slider, read, write, can_be_unlimited=can_be_unlimited
    )


def _limit(name: str, slider: tuple[float, float, float]) -> SceneField:
    limit = LIMITS[name]

    def is_given(problem: DockingProblem) -> bool:
        return not limit.steered or problem.robot.drive is Drive.ACKERMANN

    def check(value: float) -> None:
        if limit.unit == "m/s":
            check_speed(value)

    field = _number(f"robot.limits.{name}", slider, is_given=is_given, can_be_unlimited=not limit.finite)

    def write(scene: EditedScene, value: float | str) -> EditedScene:
        check(float(value))
        return _with_limits(scene, scene.problem.robot.drive, {name: float(value)})

    return field._replace(write=write)


def _with_limits(scene: EditedScene, drive: Drive, values: Mapping[str, float]) -> EditedScene:
    """Return the scene with other limits and a drive that suits them.

    `MotionLimits` reduces max_curvature to the curvature at max_steering_angle. A reduced value follows the angle, and
    a value that would be reduced is refused.
    """
    robot, scenario = scene.problem.robot, scene.scenario
    is_reduced = robot.limits.max_curvature == _curvature_of_steering(robot.limits)
    free = {"max_curvature": math.inf} if is_reduced else {}
    limits = dataclasses.replace(robot.limits, **{**free, **values})
    asked = values.get("max_curvature", math.inf)
    if limits.max_curvature < asked < math.inf and in_digits(asked) != in_digits(limits.max_curvature):
        raise InvalidValue(f"must be <= {limits.max_curvature:.4g} 1/m, the curvature at max_steering_angle")
    turns = robot.turns_in_place and drive is Drive.DIFFERENTIAL
    edited = _changed(scene, robot=dataclasses.replace(robot, limits=limits, drive=drive, turns_in_place=turns))
    # In a file, an unlimited value has no key.
    missing = {name for name, value in values.items() if math.isinf(value)}
    default = (scenario.default_limits - values.keys()) | missing
    return dataclasses.replace(edited, scenario=dataclasses.replace(edited.scenario, default_limits=default))


def _curvature_of_steering(limits: MotionLimits) -> float:
    return (
        math.tan(limits.max_steering_angle) / limits.wheelbase if math.isfinite(limits.max_steering_angle) else math.inf
    )


def _choice(
    key: str,
    read: Callable[[EditedScene], str],
    write: Callable[[EditedScene, str], EditedScene],
    choices: Callable[[], tuple[str, ...]],
) -> SceneField:
    label, words = key.rpartition(".")[2].replace("_", " "), _KEYS[key].description
    return SceneField(key, label, "", words, None, read, lambda scene, value: write(scene, str(value)), choices)


def _rectangle(footprint: Footprint) -> tuple[float, float, float] | None:
    """Return front, rear and width [m] of a rectangle as `Footprint.rectangle` takes them; None for other outlines."""
    x, y = footprint.vertices.T
    front, rear, half = float(x.max()), -float(x.min()), float(y.max())
    wanted = np.array([[front, half], [-rear, half], [-rear, -half], [front, -half]])
    if len(x) != 4 or {*map(tuple, wanted.tolist())} != {*map(tuple, footprint.vertices.tolist())}:
        return None
    return front, rear, 2.0 * half


def _side(name: str, words: str, place: int, slider: tuple[float, float, float]) -> SceneField:
    """Return the field of a side of a rectangular footprint, number `place` of front, rear and width."""

    def read(scene: EditedScene) -> float | None:
        sides = _rectangle(scene.problem.robot.footprint)
        return None if sides is None else sides[place]

    def write(scene: EditedScene, value: float | str) -> EditedScene:
        sides = list(_rectangle(scene.problem.robot.footprint) or (0.0, 0.0, 0.0))
        sides[place] = float(value)
        return _with_outline(scene, Footprint.rectangle(*sides))

    return SceneField(f"robot.footprint.{name}", name, "m", words, slider, read, write)


def _length(scene: EditedScene) -> float | None:
    footprint = scene.problem.robot.footprint
    return footprint.length if _rectangle(footprint) is None else None


def _with_length(scene: EditedScene, value: float | str) -> EditedScene:
    footprint, length = scene.problem.robot.footprint, float(value)
    if length <= 0.0:
        raise InvalidValue("must be > 0 m")
    return _with_outline(scene, Footprint(footprint.vertices * (length / footprint.length)))


def _with_outline(scene: EditedScene, footprint: Footprint) -> EditedScene:
    check_outline(footprint)
    return _changed(scene, robot__footprint=footprint)


def _with_drive(scene: EditedScene, value: str) -> EditedScene:
    """Return the scene with another drive, without the limits and turns that it cannot have."""
    drive = Drive(value)
    others = dict.fromkeys(STEERING_UNITS, math.inf) if drive is Drive.DIFFERENTIAL else {}
    return _with_limits(scene, drive, others)


def _approach_distance(scene: EditedScene) -> float:
    dock = scene.problem.dock
    return dock.approach_distance if math.isfinite(dock.approach_speed) else 0.0


def _with_approach_distance(scene: EditedScene, value: float | str) -> EditedScene:
    """Return the scene with another length of the slow part; a new one has the speed limit of the slower gear."""
    dock, limits = scene.problem.dock, scene.problem.robot.limits
    speed = dock.approach_speed
    if float(value) == 0.0:
        speed = math.inf
    elif not math.isfinite(speed):
        speed = min(limits.max_speed, limits.max_reverse_speed)
    return _changed(scene, dock=dataclasses.replace(dock, approach_speed=speed, approach_distance=float(value)))


def _marker(axis: int) -> SceneField:
    name, words = "xy"[axis], _KEYS["dock.marker"].description

    def read(scene: EditedScene) -> float | None:
        marker = scene.problem.dock.marker if _has_camera(scene.problem) else None
        return None if marker is None else marker[axis]

    def write(scene: EditedScene, value: float | str) -> EditedScene:
        marker = list(scene.problem.dock.marker or (0.0, 0.0))
        marker[axis] = float(value)
        return _changed(scene, dock__marker=tuple(marker))

    return SceneField(f"dock.marker.{name}", f"marker {name}", "m", words, (-2.0, 2.0, 0.01), read, write)


def _has_camera(problem: DockingProblem) -> bool:
    return problem.robot.camera is not None and problem.dock.marker is not None


def _with_budget(scene: EditedScene, value: float | str) -> EditedScene:
    if not 0.0 < float(value) <= MOST_SECONDS:
        raise InvalidValue(f"must be > 0 and <= {MOST_SECONDS:g} s")
    return dataclasses.replace(scene, scenario=dataclasses.replace(scene.scenario, time_budget=float(value)))


def _plugins(kind: str) -> tuple[str, ...]:
    return tuple(found.name for found in available_plugins() if found.kind == kind)


def _planner(scene: EditedScene) -> str:
    names = tuple(choice.name for choice in scene.scenario.planner)
    return _DEFAULT_PLANNERS if names == DEFAULT_PLANNERS else names[0]


def _with_planner(scene: EditedScene, value: str) -> EditedScene:
    names = DEFAULT_PLANNERS if value == _DEFAULT_PLANNERS else (value,)
    planner = tuple(PluginChoice(name) for name in names)
    return dataclasses.replace(scene, scenario=dataclasses.replace(scene.scenario, planner=planner))


def _with_smoother(scene: EditedScene, value: str) -> EditedScene:
    smoother = PluginChoice(value)
    return dataclasses.replace(scene, scenario=dataclasses.replace(scene.scenario, smoother=smoother))


def _footprint_fields() -> Iterator[SceneField]:
    yield _side("front", "distance of the front from the origin of the robot", 0, (0.05, 3.0, 0.01))
    yield _side("rear", "distance of the rear from the origin of the robot", 1, (0.05, 3.0, 0.01))
    yield _side("width", "width of the robot", 2, (0.1, 3.0, 0.01))
    words = "length of the robot; its outline is scaled"
    yield SceneField("robot.footprint.length", "length", "m", words, (0.1, 6.0, 0.01), _length, _with_length)


def _robot_fields() -> Iterator[SceneField]:
    yield _choice(
        "robot.drive", lambda scene: scene.problem.robot.drive.value, _with_drive, lambda: tuple(d.value for d in Drive)
    )
    wheelbase = _number(
        "robot.limits.wheelbase", (0.1, 4.0, 0.01), is_given=lambda problem: problem.robot.drive is Drive.ACKERMANN
    )
    yield wheelbase._replace(
        write=lambda scene, value: _with_limits(scene, scene.problem.robot.drive, {"wheelbase": float(value)})
    )
    sliders = {
        "m/s": (0.05, 2.0, 0.01),
        "m/s^2": (0.05, 2.0, 0.01),
        "m/s^3": (0.1, 10.0, 0.1),
        "rad/s": (0.05, 3.0, 0.01),
        "rad/s^2": (0.05, 6.0, 0.05),
        "1/m": (0.1, 5.0, 0.05),
        "1/m^2": (0.1, 20.0, 0.1),
        "rad": (0.05, 1.5, 0.01),
    }
    for name, limit in LIMITS.items():
        yield _limit(name, sliders[limit.unit])
    yield _number("robot.tracking.cross", (0.0, 0.2, 0.001), label="tube cross")
    yield _number("robot.tracking.yaw", (0.0, 0.3, 0.001), label="tube yaw")


def _clearance_fields() -> Iterator[SceneField]:
    yield _number("clearance.required", (0.0, 0.5, 0.005), label="clearance")
    yield _number("clearance.at_dock", (0.0, 0.5, 0.005), label="clearance at the dock")
    yield _number("clearance.taper", (0.0, 3.0, 0.05), label="clearance taper")
    yield _number("clearance.dock_run", (0.0, 3.0, 0.05))


def _dock_fields() -> Iterator[SceneField]:
    yield _choice(
        "dock.direction",
        lambda scene: scene.problem.dock.direction.value,
        lambda scene, value: _changed(scene, dock__direction=DockDirection(value)),
        lambda: tuple(direction.value for direction in DockDirection),
    )
    yield _number("dock.final_straight", (0.0, 3.0, 0.05))
    distance = _number("dock.approach_distance", (0.0, 3.0, 0.05))
    yield distance._replace(read=_approach_distance, write=_with_approach_distance)
    yield _number(
        "dock.approach_speed",
        (0.02, 1.0, 0.01),
        check=check_speed,
        is_given=lambda problem: problem.dock.approach_distance > 0.0 and math.isfinite(problem.dock.approach_speed),
    )
    yield from (_marker(0), _marker(1))
    for name in ("visible_distance", "blind_distance"):
        yield _number(f"dock.{name}", (0.0, 5.0, 0.05), is_given=_has_camera)
    view = {"field_of_view": (0.1, 6.28, 0.01), "min_range": (0.0, 2.0, 0.01), "max_range": (0.1, 10.0, 0.1)}
    for name, slider in view.items():
        yield _number(
            f"robot.camera.{name}",
            slider,
            is_given=_has_camera,
            can_be_unlimited=name == "max_range",
            label=f"camera {name.replace('_', ' ')}",
        )


def _planning_fields() -> Iterator[SceneField]:
    budget = _KEYS["time_budget"]
    yield SceneField(
        budget.key,
        "time budget",
        budget.unit,
        budget.description,
        (0.1, MOST_SECONDS, 0.1),
        lambda scene: scene.scenario.time_budget,
        _with_budget,
    )
    yield _choice("planner", _planner, _with_planner, lambda: (_DEFAULT_PLANNERS, *_plugins("planners")))
    yield _choice("smoother", lambda scene: scene.scenario.smoother.name, _with_smoother, lambda: _plugins("smoothers"))


_KEYS = {row.key: row for row in scenario_reference()}
_GROUPS = (_footprint_fields, _robot_fields, _clearance_fields, _dock_fields, _planning_fields)
FIELDS: Mapping[str, SceneField] = MappingProxyType({field.key: field for group in _GROUPS for field in group()})
