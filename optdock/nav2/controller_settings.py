"""Settings that follow from the parameters of Nav2's docking controller."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, NamedTuple

from optdock.io.numbers import is_number
from optdock.model.limits import LIMIT_UNITS

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = ["ControllerSetting", "controller_settings", "inner_block", "named_blocks"]

_PROJECTION = 0.25  # [m]: Nav2's target lies this far behind the dock's pose, and its threshold is measured from there
_USUAL_THRESHOLD = 0.3  # [m]: Nav2's default, which is the default of dock.contact_margin, 0.05 m
_FASTEST = 0.25  # [m/s]: Nav2's default of v_linear_max
_ROUNDING = 1e-9


class ControllerSetting(NamedTuple):
    """Effect of one parameter of Nav2's docking controller.

    Attributes:
        values: Settings that the parameter sets; empty if the value has no effect.
        words: The effect in one line.
        is_refused: Whether the value is refused; `words` is then the error message.
    """

    values: Mapping[str, float]
    words: str
    is_refused: bool = False


def controller_settings(server: Mapping[str, object]) -> dict[str, ControllerSetting]:
    """Return, by name, the effects of the parameters in the block `controller` that set other settings.

    Args:
        server: All parameters of a docking server. Values that are not finite numbers are ignored.
    """
    controller = inner_block(server, "controller")
    numbers = {name: float(value) for name, value in controller.items() if is_number(value) and math.isfinite(value)}
    is_needless = controller.get("use_collision_detection") is False or _sets_contact_margin(server)
    effects: Mapping[str, Callable[[float], ControllerSetting]] = {
        "v_linear_min": lambda value: _least_speed(value, numbers.get("v_linear_max", _FASTEST)),
        "deceleration_max": lambda value: _bound("max_deceleration", value),
        "rotate_to_heading_angular_vel": lambda value: _bound("max_yaw_rate", value),
        "rotate_to_heading_max_angular_accel": lambda value: _bound("max_yaw_acceleration", value),
        "dock_collision_threshold": lambda value: _contact_margin(value, is_needless=is_needless),
    }
    return {name: effect(numbers[name]) for name, effect in effects.items() if name in numbers}


def named_blocks(values: Mapping[str, object], key: str) -> dict[str, Mapping[str, object]]:
    """Return the blocks whose names are listed under `key`; a missing block is empty."""
    names = values.get(key)
    listed = names if isinstance(names, list | tuple) else ()
    return {name: inner_block(values, name) for name in listed if isinstance(name, str)}


def inner_block(values: Mapping[str, object], name: str) -> Mapping[str, object]:
    """Return the block `name`; empty if it is missing or not a block."""
    inner = values.get(name)
    return inner if isinstance(inner, Mapping) else {}


def _sets_contact_margin(server: Mapping[str, object]) -> bool:
    """Whether `dock.contact_margin` is set for all docks, or for every dock type."""
    types = named_blocks(server, "dock_plugins").values()
    own = [inner_block(of_type, "dock") for of_type in types] or [{}]
    return "contact_margin" in inner_block(server, "dock") or all("contact_margin" in block for block in own)


def _least_speed(speed: float, fastest: float) -> ControllerSetting:
    if speed > fastest + _ROUNDING:
        return ControllerSetting({}, f"must be at most v_linear_max = {fastest:g} m/s, got {speed:g}", is_refused=True)
    if speed <= 0.0:
        return ControllerSetting({}, "the drive has no dead band")
    if speed >= fastest - _ROUNDING:
        return ControllerSetting(
            {}, "equal to v_linear_max: a constant speed, no dead band; set tracker.min_speed for one"
        )
    settings = "tracker.min_speed", "dock.approach_speed", "executor.contact_speed", "executor.back_out_speed"
    words = f"{settings[0]} is {speed:g} m/s; {', '.join(settings[1:-1])} and {settings[-1]} are not less, unless set"
    return ControllerSetting(dict.fromkeys(settings, speed), words)


def _bound(limit: str, value: float) -> ControllerSetting:
    key = f"robot.limits.{limit}"
    return ControllerSetting({key: value}, f"{key} is at most {value:g} {LIMIT_UNITS[limit]}, unless it is set")


def _contact_margin(threshold: float, *, is_needless: bool) -> ControllerSetting:
    if is_needless:
        return ControllerSetting({}, "dock.contact_margin is set, or use_collision_detection is false")
    if threshold > _USUAL_THRESHOLD + _ROUNDING:
        margin = threshold - _PROJECTION
        return ControllerSetting(
            {},
            f"{threshold:g} m would free obstacles within {margin:.3g} m of the docked robot's front; set it to "
            f"{_USUAL_THRESHOLD:g} m or less, or set dock.contact_margin, by default 0.05 m",
            is_refused=True,
        )
    margin = max(0.0, round(threshold - _PROJECTION, 9))
    return ControllerSetting({"dock.contact_margin": margin}, f"dock.contact_margin is {margin:g} m")
