"""Random motions: jerk-limited laws over random paths, and limits just above or just below the largest values."""

from __future__ import annotations

import itertools
import math
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from experiments.fuzz.generators.routes import clothoid_route, route, with_turns
from experiments.fuzz.generators.shapes import log_uniform
from experiments.fuzz.oracle.motion import motion_of
from experiments.fuzz.oracle.timing import judge_timing

if TYPE_CHECKING:
    from collections.abc import Callable

    from experiments.fuzz.case import Case

__all__ = ["motion_problem"]

Rng: TypeAlias = np.random.Generator
_TURNS, _STEERED = 0.25, 0.3  # shares of motions with turns in place, and with steered wheels
_HUGE = 1e9  # no limit, in places that require a finite one
_CURVED = ("yaw_rate", "lateral_acceleration", "yaw_acceleration", "wheel_speed", "lateral_jerk")
_PLAIN = ("speed", "acceleration", "deceleration", "jerk")


def motion_problem(rng: Rng) -> Case:
    """Return a path, a law over it, and limits near the largest values of the motion."""
    gears = clothoid_route(rng) if rng.uniform() < 0.85 else route(rng)
    style = rng.uniform()
    if style < _TURNS and all(gear["type"] != "turn" for gear in gears):
        gears = with_turns(rng, gears)
    motion = motion_of(gears)
    law = _law(rng, [one.length for one in motion.segments], rests=style > 1.0 - _STEERED)
    for change in _CHANGES:
        if rng.uniform() < 0.15:
            change(rng, law)
    speed = law["start_speed"] if rng.uniform() < 0.97 else law["start_speed"] + log_uniform(rng, 1e-7, 0.1)
    case: Case = {
        "kind": "trajectories",
        "path": gears,
        "law": law,
        "limits": {},
        "zone": [None, 0.0],
        "start_speed": speed,
    }
    _aim(rng, case)
    if style > 1.0 - _STEERED:
        _steer(rng, case)
    return case


def _law(rng: Rng, lengths: list[float], *, rests: bool = False) -> Case:
    """Return a law with every gear from rest to rest; sometimes the first begins at speed."""
    durations: list[float] = []
    jerks: list[float] = []
    begins_moving = rng.uniform() < 0.2
    start_speed = 0.0
    for i, length in enumerate(lengths):
        if length <= 0.0:
            continue
        phases, top = _double_s(length, *(log_uniform(rng, 0.05, high) for high in (2.0, 2.0, 20.0)))
        if i == 0 and begins_moving:
            phases, start_speed = _from_speed(phases, top, length)
        if rests and i:
            phases = [(log_uniform(rng, 1e-3, 5.0), 0.0)] * int(rng.integers(1, 3)) + phases
        durations += [h for h, _ in phases]
        jerks += [j for _, j in phases]
    if not durations:
        durations, jerks = [1.0], [0.0]
    return {"durations": durations, "jerks": jerks, "start_speed": start_speed, "start_acceleration": 0.0}


def _double_s(length: float, v: float, a: float, j: float) -> tuple[list[tuple[float, float]], float]:
    """Return phases (duration, jerk) from rest to rest over `length`, and the speed in the middle."""

    def ramp(top: float) -> tuple[float, float]:
        return (a / j, top / a - a / j) if top * j >= a * a else (math.sqrt(top / j), 0.0)

    low, high = 0.0, v
    for _ in range(200):
        t1, t2 = ramp(high)
        if high * (2.0 * t1 + t2) <= length:
            break
        middle = 0.5 * (low + high)
        t1, t2 = ramp(middle)
        low, high = (middle, high) if middle * (2.0 * t1 + t2) <= length else (low, middle)
        if high - low <= 1e-15 * high:
            high = low
    t1, t2 = ramp(high)
    cruise = (length - high * (2.0 * t1 + t2)) / high
    phases = [(t1, j), (t2, 0.0), (t1, -j), (cruise, 0.0), (t1, -j), (t2, 0.0), (t1, j)]
    return [phase for phase in phases if phase[0] > 0.0], high


def _from_speed(
    phases: list[tuple[float, float]], top: float, length: float
) -> tuple[list[tuple[float, float]], float]:
    """Return the second half of a motion, after a cruise over the rest of the distance."""
    braking = phases[-3:] if len(phases) >= 6 else phases[-2:]
    way = 0.5 * top * sum(h for h, _ in braking)
    return [((length - way) / top, 0.0), *braking], top


def _split(rng: Rng, law: Case) -> None:
    """Split one phase into several of the same jerk, some of them tiny."""
    i = int(rng.integers(len(law["durations"])))
    whole = law["durations"][i]
    share = rng.uniform() if rng.uniform() < 0.5 else log_uniform(rng, 1e-13, 1e-2)
    parts = [whole * share, whole - whole * share]
    law["durations"][i : i + 1] = parts
    law["jerks"][i : i + 1] = [law["jerks"][i]] * 2


def _wait(rng: Rng, law: Case) -> None:
    """Insert a rest of any duration before the motion."""
    if law["start_speed"] == 0.0:
        law["durations"].insert(0, log_uniform(rng, 1e-12, 1e18))
        law["jerks"].insert(0, 0.0)


def _stretched(rng: Rng, law: Case) -> None:
    """Change one duration slightly."""
    law["durations"][int(rng.integers(len(law["durations"])))] *= 1.0 + rng.choice([-1, 1]) * log_uniform(
        rng, 1e-9, 1e-2
    )


def _kicked(rng: Rng, law: Case) -> None:
    """Add a short jerk that is compensated at once, at or above the limit."""
    i, width, jerk = (
        int(rng.integers(len(law["durations"]) + 1)),
        log_uniform(rng, 1e-9, 1e-2),
        log_uniform(rng, 0.1, 1e4),
    )
    law["durations"][i:i] = [width, 2.0 * width, width]
    law["jerks"][i:i] = [jerk, -jerk, jerk]


_CHANGES: tuple[Callable[[Rng, Case], None], ...] = (_split, _split, _wait, _stretched, _kicked)


def _aim(rng: Rng, case: Case) -> None:
    """Set limits with 2 % of reserve, but one or two at the border, and a slow zone in the same way."""
    turns = any(one["type"] == "turn" for one in case["path"])
    track = 0.0 if turns and rng.uniform() < 0.6 else rng.uniform(0.1, 1.0)
    unit = dict.fromkeys((f"max_{name}" for name in (*_PLAIN, *_CURVED)), 1.0)
    case["limits"] = {**unit, "max_reverse_speed": 1.0, "track_width": track}
    motion = motion_of(case["path"])
    seen = judge_timing(case, motion).ratios
    if turns:  # limits of turns are scaled to 1
        seen |= {
            name: value
            for name, value in judge_timing({**case, "limits": unit}, motion).ratios.items()
            if "turn_" in name
        }
    sharp = set(rng.choice([*_PLAIN, *_CURVED], size=int(rng.integers(0, 3)), replace=False).tolist())
    limits: Case = {"track_width": track}
    for name in (*_PLAIN, *_CURVED):
        top = seen.get(name, 0.0)
        if not (math.isfinite(top) and top > 1e-12):
            limits.update({f"max_{name}": _HUGE} if name in _PLAIN else {})
        elif name in _PLAIN or name in sharp or rng.uniform() < 0.5:
            limits[f"max_{name}"] = top * (_border(rng) if name in sharp else rng.uniform(1.02, 2.0))
    limits["max_reverse_speed"] = limits["max_speed"]
    case["limits"] = limits
    if turns:
        _aim_turns(rng, case, seen)
    if rng.uniform() < 0.4:
        _add_zone(rng, case)


def _border(rng: Rng) -> float:
    """Return a factor near 1: within the tolerance, between once and five times the tolerance, or beyond."""
    style = rng.uniform()
    if style < 0.3:
        return 1.0 + log_uniform(rng, 1e-9, 1e-3)
    return 1.0 - (float(rng.uniform(2.2e-6, 4.8e-6)) if style < 0.6 else log_uniform(rng, 2.2e-6, 0.2))


def _add_zone(rng: Rng, case: Case) -> None:
    """Add a slow zone with a limit near the speed of the motion in it."""
    motion = motion_of(case["path"])
    distance = float(motion.length * rng.uniform(0.02, 1.1))
    free = {**case, "limits": {**case["limits"], "max_speed": 1e12, "max_reverse_speed": 1e12}, "zone": [1.0, distance]}
    top = judge_timing(free, motion).ratios["speed"]
    if math.isfinite(top) and top > 1e-9:
        case["zone"] = [top * (_border(rng) if rng.uniform() < 0.5 else 1.02), distance]


def _aim_turns(rng: Rng, case: Case, seen: dict[str, float]) -> None:
    """Set limits of turning near the largest values of the turns, or with a small reserve."""
    limits = case["limits"]
    gain = max(limits["max_acceleration"], limits["max_deceleration"]) / limits["max_jerk"]
    rate, acceleration, jerk = (seen.get(name, 0.0) for name in ("turn_rate", "turn_acceleration", "turn_jerk"))
    wanted = {"max_yaw_rate": rate, "max_yaw_acceleration": max(acceleration, jerk * gain)}
    for name, value in wanted.items():
        if value > 1e-9:
            border = value * (_border(rng) if rng.uniform() < 0.4 else 1.02)
            limits[name] = border if rng.uniform() < 0.5 else max(border, limits.get(name, 0.0))
    if limits["track_width"] > 0.0:
        limits["max_wheel_speed"] = max(limits.get("max_wheel_speed", 0.0), 0.5 * limits["track_width"] * rate) * (
            _border(rng) if rng.uniform() < 0.4 else 1.02
        )


def _steer(rng: Rng, case: Case) -> None:
    """Set a steering rate limit near the largest value of the motion and its rests."""
    limits = case["limits"]
    limits["wheelbase"] = log_uniform(rng, 0.05, 4.0)
    motion, law = motion_of(case["path"]), case["law"]
    rates = [judge_timing({**case, "limits": {**limits, "max_steering_rate": 1.0}}, motion).ratios["steering_rate"]]
    rests = [h for h, j in zip(law["durations"], law["jerks"], strict=True) if j == 0.0]
    for before, after in itertools.pairwise(motion.segments):
        ends = (before.gear * motion.k1[before.stop - 1], after.gear * motion.k0[after.first])
        angle = abs(math.atan(limits["wheelbase"] * ends[0]) - math.atan(limits["wheelbase"] * ends[1]))
        rates += [angle / h for h in rests if h > 1e-6]
    rates = [rate for rate in rates if 1e-9 < rate < _HUGE]
    if rates:
        limits["max_steering_rate"] = max(rates) if rng.uniform() < 0.5 else float(rng.choice(rates))
        limits["max_steering_rate"] *= _border(rng) if rng.uniform() < 0.5 else 1.02
