"""Hostile values through public constructors: a typed error, or an immutable value that works."""

from __future__ import annotations

import contextlib
import dataclasses
import math
from enum import Enum
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from experiments.fuzz.case import Verdict
from optdock.errors import OptdockError
from optdock.geometry.clothoid import ClothoidSpline
from optdock.geometry.footprint import Footprint
from optdock.geometry.obstacles import ObstacleSet
from optdock.geometry.pose import Pose2, Twist2
from optdock.model.cell_obstacles import obstacles_from_costmap
from optdock.model.clearance_rule import ClearanceRule
from optdock.model.constant_jerk import TimeLaw
from optdock.model.costmap import Costmap
from optdock.model.dock import Dock, DockDirection, DockTolerances
from optdock.model.limits import MotionLimits, SpeedZone
from optdock.model.path import ClothoidSegment, Direction, Path, PolylineSegment
from optdock.model.problem import DockingProblem
from optdock.model.robot import Drive, Robot
from optdock.model.trajectory import Trajectory
from optdock.planning.pipeline import plan_dock
from optdock.plugins.registry import INTERFACES, available_plugins, create_plugin, load_plugin
from optdock.verification import certify_path, certify_trajectory

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from experiments.fuzz.case import Case

__all__ = ["draw", "judge"]

_SQUARE = [[0.4, 0.3], [-0.4, 0.3], [-0.4, -0.3], [0.4, -0.3]]


class _ForeignSegment:
    """A curve that is no segment of the library."""

    direction, length = Direction.FORWARD, 1.0
    knots = np.array([0.0, 1.0])

    def poses_at(self, s: Any) -> Any:  # noqa: ANN401
        points = np.atleast_1d(s)
        return np.column_stack((points, 0.0 * points, 0.0 * points))

    def curvature_at(self, s: Any) -> Any:  # noqa: ANN401
        return 0.0 * np.atleast_1d(s)

    curvature_rate_at = curvature_at


def _hostile() -> tuple[Any, ...]:
    """Return new hostile values on every call, because some of them are mutable."""
    return (
        math.nan, math.inf, -math.inf, 1e308, -1e308, 1e200, 5e-324, -5e-324, -0.0, 0, -1, 10**400, True, None, "",
        "abc", "0.5", b"x", [], {}, object(), 1j, np.float32(0.1), np.array(0.5), np.array([]), np.array([[]]),
        np.zeros((3, 2)),
        np.full((4, 2), math.nan), np.full((4, 3), math.inf), np.array(_SQUARE) * 1e300, np.array(_SQUARE) * 1e-300,
        np.array(_SQUARE) * 1e-160, np.array([["a", "b"]] * 3), np.array(_SQUARE, dtype=object), np.zeros((2, 2, 2)),
        np.array([[0, 0], [1e-323, 5e-324], [1, 1], [-1, 1]]), np.array(_SQUARE), np.array([[0.0, 0, 0], [1, 0, 0]]),
        np.arange(5.0), np.array([0.0, 1e-320, 1.0]), np.array([0.0, 1.0]), np.array([1.0, 0.0]), np.array([254, 0]),
        np.array([[0, 254], [255, 0]]), np.array([[0, 300]]), np.array([[0.5, 1.0]]), [[0, 0], [1, 0], [1, 1], [0, 1]],
        "reverse", "BACKWARD", "backward", DockDirection.FORWARD, Direction.REVERSE, (0.0, 0.0), (math.nan, 0.0),
        (1, 2, 3),
        Pose2(0, 0, 0), [Pose2(0, 0, 0), Pose2(1, 0, 0)], Footprint(np.array(_SQUARE)), _ForeignSegment(),
        (_ForeignSegment(),), ObstacleSet.empty(), MotionLimits(), lambda: None, 2**63, np.int64(2), 90.0, 1e17, 1e14,
    )  # fmt: skip


class _Constructor(NamedTuple):
    """A public constructor with valid arguments, and the checks of its value."""

    call: Callable[..., Any]
    arguments: Callable[[], dict[str, Any]]
    use: Callable[[Any], object] = repr


def _problem(**changes: Any) -> DockingProblem:  # noqa: ANN401
    honest: dict[str, Any] = {
        "start": Pose2(0, 0, 0),
        "dock": Dock(Pose2(2, 0, 0)),
        "robot": Robot(Footprint(np.array(_SQUARE)), MotionLimits()),
        "obstacles": ObstacleSet.from_polygons([[[1, 1], [2, 1], [2, 2]]]),
        "clearance": ClearanceRule(),
        "start_speed": 0.0,
        "start_curvature": None,
        "costmap": None,
        "frame": "map",
    }
    return DockingProblem(**{**honest, **changes})


def _spline(**changes: Any) -> ClothoidSpline:  # noqa: ANN401
    honest = {
        "start": Pose2(0, 0, 0),
        "knots": np.array([0.0, 1.0, 2.0]),
        "curvature": np.array([0.0, 0.5, 0.0]),
        "sign": 1,
    }
    return ClothoidSpline(**{**honest, **changes})


def _straight() -> Path:
    return Path((ClothoidSegment(_spline(curvature=np.zeros(3))),))


def _certified(problem: DockingProblem) -> object:
    return certify_path(_straight(), problem)


def _drive(law: TimeLaw) -> object:
    return certify_trajectory(Trajectory(_straight(), law), MotionLimits(), SpeedZone())


def _walk(path: Path) -> object:
    certify_path(path, _problem())
    return path.sample(max(path.length / 50.0, 1e-3))


def _within(dock: Dock) -> object:
    return certify_path(_straight(), _problem(dock=dock))


def _stands(footprint: Footprint) -> object:
    return certify_path(_straight(), _problem(robot=Robot(footprint, MotionLimits())))


def _blocks(obstacles: ObstacleSet) -> object:
    return certify_path(_straight(), _problem(obstacles=obstacles))


def _maps(costmap: Costmap) -> object:
    return costmap.cost_at([[0.0, 0.0]])


_CONSTRUCTORS: dict[str, _Constructor] = {
    "Pose2": _Constructor(Pose2, lambda: {"x": 0.0, "y": 0.0, "yaw": 0.0}, lambda pose: pose @ pose.inverse()),
    "Twist2": _Constructor(Twist2, lambda: {"linear": 0.0, "angular": 0.0, "lateral": 0.0}),
    "Footprint": _Constructor(Footprint, lambda: {"vertices": np.array(_SQUARE)}, _stands),
    "Footprint.from_radius": _Constructor(Footprint.from_radius, lambda: {"radius": 0.3}, _stands),
    "Footprint.rectangle": _Constructor(
        Footprint.rectangle, lambda: {"front": 0.4, "rear": 0.4, "width": 0.5}, _stands
    ),
    "Dock": _Constructor(
        Dock,
        lambda: {
            "pose": Pose2(2, 0, 0),
            "footprint": Footprint(np.array(_SQUARE)),
            "direction": DockDirection.AUTO,
            "final_straight": 0.1,
            "approach_speed": 0.1,
            "approach_distance": 0.2,
            "tolerances": DockTolerances(),
        },
        _within,
    ),
    "DockTolerances": _Constructor(DockTolerances, lambda: {"along": 0.02, "cross": 0.02, "yaw": 0.05}),
    "SpeedZone": _Constructor(SpeedZone, lambda: {"speed": 0.1, "distance": 0.3}),
    "MotionLimits": _Constructor(
        MotionLimits,
        lambda: {spec.name: spec.default for spec in dataclasses.fields(MotionLimits)},
        lambda limits: _certified(_problem(robot=Robot(Footprint(np.array(_SQUARE)), limits))),
    ),
    "ClearanceRule": _Constructor(
        ClearanceRule,
        lambda: {"required": 0.05, "at_dock": 0.0, "taper": 0.5},
        lambda r: _certified(_problem(clearance=r)),
    ),
    "DockingProblem": _Constructor(
        _problem,
        lambda: {
            "start": Pose2(0, 0, 0),
            "start_speed": 0.0,
            "start_curvature": None,
            "frame": "map",
            "costmap": None,
            "clearance": ClearanceRule(),
            "obstacles": ObstacleSet.empty(),
            "dock": Dock(Pose2(2, 0, 0)),
        },
        _certified,
    ),
    "Robot": _Constructor(
        Robot,
        lambda: {"footprint": Footprint(np.array(_SQUARE)), "limits": MotionLimits(), "drive": Drive.DIFFERENTIAL},
        lambda robot: _certified(_problem(robot=robot)),
    ),
    "ObstacleSet": _Constructor(
        ObstacleSet, lambda: {"vertices": np.array([_SQUARE]), "names": ("a",), "group": np.array([0])}, _blocks
    ),
    "ObstacleSet.from_polygons": _Constructor(
        ObstacleSet.from_polygons, lambda: {"polygons": [np.array(_SQUARE)]}, _blocks
    ),
    "ObstacleSet.from_rectangles": _Constructor(
        ObstacleSet.from_rectangles,
        lambda: {"lower": np.array([[1.0, 1.0]]), "upper": np.array([[2.0, 2.0]]), "name": "a"},
        _blocks,
    ),
    "Costmap": _Constructor(
        Costmap, lambda: {"data": np.zeros((3, 4), dtype=np.uint8), "resolution": 0.1, "origin": (0.0, 0.0)}, _maps
    ),
    "obstacles_from_costmap": _Constructor(
        obstacles_from_costmap,
        lambda: {
            "costmap": Costmap(np.array([[0, 254]]), 0.5),
            "unknown_is_obstacle": True,
            "region": ([0.0, 0.0], [1.0, 1.0]),
            "border": True,
        },
        _blocks,
    ),
    "Path.from_poses": _Constructor(
        Path.from_poses, lambda: {"poses": np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0]])}, _walk
    ),
    "PolylineSegment": _Constructor(
        PolylineSegment,
        lambda: {"poses": np.array([[0.0, 0, 0], [1, 0, 0]]), "direction": Direction.FORWARD},
        lambda segment: _walk(Path((segment,))),
    ),
    "Path": _Constructor(Path, lambda: {"segments": (ClothoidSegment(_spline()),)}, _walk),
    "ClothoidSpline": _Constructor(
        _spline,
        lambda: {"start": Pose2(0, 0, 0), "knots": np.array([0.0, 1.0, 2.0]), "curvature": np.zeros(3), "sign": 1},
        lambda spline: _walk(Path((ClothoidSegment(spline),))),
    ),
    "TimeLaw": _Constructor(
        TimeLaw,
        lambda: {
            "durations": np.array([1.0, 1.0]),
            "jerks": np.array([0.0, 1.0]),
            "start_s": 0.0,
            "start_speed": 0.0,
            "start_acceleration": 0.0,
        },
        _drive,
    ),
    "plan_dock": _Constructor(
        lambda time_budget: plan_dock(_problem(), time_budget=time_budget), lambda: {"time_budget": 0.02}
    ),
}


def _plugin_parameters() -> Iterator[tuple[str, str]]:
    for plugin in available_plugins():
        for name in load_plugin(INTERFACES[plugin.kind], plugin.name).Parameters.model_fields:
            yield f"{plugin.kind}/{plugin.name}", name


def draw(rng: np.random.Generator) -> Case:
    """Draw a constructor, one of its arguments, and the value to insert."""
    hostile = int(rng.integers(len(_hostile())))
    if rng.uniform() < 0.25:
        slots = list(_plugin_parameters())
        door, argument = slots[int(rng.integers(len(slots)))]
    else:
        door = sorted(_CONSTRUCTORS)[int(rng.integers(len(_CONSTRUCTORS)))]
        argument = list(_CONSTRUCTORS[door].arguments())[int(rng.integers(len(_CONSTRUCTORS[door].arguments())))]
    return {
        "kind": "values",
        "door": door,
        "argument": argument,
        "hostile": hostile,
        "is": repr(_hostile()[hostile])[:60],
    }


def judge(case: Case) -> Verdict:
    """Call the constructor; then test whether the result can be changed.

    A value of the right type (a number, an array of numbers, a string) must be refused with a named error or accepted.
    A value of another type violates the declared types: any exception is allowed, and the result is not checked.
    """
    value = _hostile()[case["hostile"]]
    where = f"{case['door']}({case['argument']}={case['is']})"
    try:
        made = _called(case, value)
    except OptdockError as error:
        return Verdict(f"input refused: {type(error).__name__}")
    except Exception as error:
        if _is_right_type(case, value):
            raise type(error)(f"{where}: {error}") from error
        return Verdict("wrong type refused")
    if not _is_right_type(case, value):
        return Verdict("wrong type accepted")
    return _changeable(made, value, where) or Verdict("accepted")


def _is_right_type(case: Case, value: object) -> bool:
    """Whether a value is of the type of the argument."""
    if "/" in case["door"]:
        return True  # parameters come from files and are checked for any type
    honest = _CONSTRUCTORS[case["door"]].arguments()[case["argument"]]
    return _type_name(value) == ("number" if honest is None else _type_name(honest))


def _type_name(value: object) -> str:
    if isinstance(value, int | float | np.integer | np.floating) and not isinstance(value, Enum):
        return "number"
    if isinstance(value, np.ndarray):
        return "array" if value.dtype.kind in "iuf" else "other array"
    return "word" if isinstance(value, str | Enum) else type(value).__name__


def _called(case: Case, value: object) -> object:
    if "/" in case["door"]:
        kind, name = case["door"].split("/", 1)
        return create_plugin(INTERFACES[kind], name, {case["argument"]: value})
    constructor = _CONSTRUCTORS[case["door"]]
    made = constructor.call(**{**constructor.arguments(), case["argument"]: value})
    if case["door"] != "plan_dock":
        constructor.use(made)
    return made


def _changeable(made: object, given: object, where: str) -> Verdict | None:
    """Return arrays that are writable, or shared with the caller."""
    for name, array in _arrays(made, ""):
        if _can_be_written_to(array):
            return Verdict("mutable value", f"{where.split('(', maxsplit=1)[0]}{name}: can be written to")
        if isinstance(given, np.ndarray) and array.size and np.shares_memory(array, given):
            return Verdict("mutable value", f"{where.split('(', maxsplit=1)[0]}{name}: is the caller's own array")
    return None


def _can_be_written_to(array: np.ndarray) -> bool:
    """Whether an array, or a view of it, can be made writable."""
    for one in (array, array.view(), array.base):
        if isinstance(one, np.ndarray):
            with contextlib.suppress(ValueError):
                one.setflags(write=True)
                return True
    return False


def _arrays(value: object, name: str, depth: int = 0) -> Iterator[tuple[str, np.ndarray]]:
    """Yield every reachable array of a value, with its access path."""
    if isinstance(value, np.ndarray):
        yield name, value
    elif depth < 4 and dataclasses.is_dataclass(value) and not isinstance(value, type):
        for spec in dataclasses.fields(value):
            yield from _arrays(getattr(value, spec.name, None), f"{name}.{spec.name}", depth + 1)
    elif depth < 4 and isinstance(value, tuple):
        for i, item in enumerate(value):
            yield from _arrays(item, f"{name}[{i}]", depth + 1)
