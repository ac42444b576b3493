"""Motions of a case: true speed, acceleration and turning, phase by phase and place by place.

Times count from the start of each phase, so that a phase after a wait of 1e17 s is as accurate as any other. Every
piece of the path is evaluated at its entry, middle and exit, with its curvature. Motion under constant jerk is
implemented here again, so that errors of `optdock.model.trajectory` are detected.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    import numpy.typing as npt

    from experiments.fuzz.case import Case
    from experiments.fuzz.oracle.motion import Floats, Ints, Motion

__all__ = ["LIMITED", "Judgement", "State", "judge_timing", "state_at", "turn_limits"]

LIMITED = (
    *("speed", "acceleration", "deceleration", "jerk", "yaw_rate", "lateral_acceleration", "yaw_acceleration"),
    *("lateral_jerk", "wheel_speed", "steering_rate"),
)
"""Quantities with checked ratios."""
_PER_PHASE = 24  # samples
_BISECTIONS = 60
_REST = 1e-6  # [m], [m/s], [m/s^2]
_ZOOMS = 3  # refinement rounds around the largest values
_SPREAD = np.linspace(-1.0, 1.0, 21)
_EXCESS = 1e-6  # relative: tolerance of the certificate
_SAMPLED = 0.05  # relative, for turning limits on the steps of a polyline
_NOWHERE = 1e-9  # [m] of the path coordinate: a phase that moves less belongs to either side of a cusp
_ROUNDED = 4.0  # units in the last place, of sums of about ten terms


@dataclass(frozen=True)
class Judgement:
    """Largest ratio of each quantity to its limit at an instant, and ratios of rules of structure."""

    ratios: dict[str, float]
    structure: dict[str, float]

    @property
    def broken(self) -> list[str]:
        """Rules violated at an instant beyond twice their tolerance."""
        limits = [name for name, ratio in self.ratios.items() if not ratio <= 1.0 + 2.0 * _EXCESS]
        return limits + [name for name, ratio in self.structure.items() if not ratio <= 2.0]

    def is_clear(self, kind: str) -> bool:
        """Whether a refusal for `kind` would be wrong: 1 % below the limit, or half the tolerance of structure."""
        if kind in self.ratios:
            return self.ratios[kind] <= 0.99
        return self.structure.get(kind, 0.0) <= 0.5


class _Law(NamedTuple):
    """Phase borders: s, v, a, Shape (n + 1,); jerks and durations, Shape (n,)."""

    s: Floats
    v: Floats
    a: Floats
    jerk: Floats
    width: Floats

    def at(self, phase: Ints, dt: Floats) -> tuple[Floats, Floats, Floats]:
        """Return distance, speed, acceleration `dt` into `phase`."""
        s, v, a, j = self.s[phase], self.v[phase], self.a[phase], self.jerk[phase]
        return s + dt * (v + dt * (a / 2.0 + dt * j / 6.0)), v + dt * (a + dt * j / 2.0), a + dt * j


class State(NamedTuple):
    """Distance [m], speed [m/s] and acceleration [m/s^2] along the travel."""

    s: float
    v: float
    a: float


def state_at(spec: Case, t: float) -> State:
    """Return the state of a time law at a time [s], clipped."""
    law = _law(spec)
    borders = np.concatenate(([0.0], np.cumsum(law.width)))
    t = min(max(t, 0.0), float(borders[-1]))
    phase = int(np.clip(np.searchsorted(borders, t, side="right") - 1, 0, law.width.size - 1))
    s, v, a = law.at(np.array([phase]), np.array([t - borders[phase]]))
    return State(float(s[0]), float(v[0]), float(a[0]))


class _Instants(NamedTuple):
    """Phase, time within it [s], piece of the path and share of it, Shape (n,) each."""

    phase: Ints
    dt: Floats
    piece: Ints
    share: Floats


def judge_timing(case: Case, motion: Motion) -> Judgement:
    """Check the motion against the limits, the zone and the rules of `case`.

    Args:
        case: Contains `law`, `limits`, `zone`, `start_speed` or None, `start_acceleration` if known, and `wheels`
            "unknown" if steered wheels may have any angle at the start.
        motion: The path.
    """
    law = _law(case["law"])
    with np.errstate(all="ignore"):
        instants = _joined(_grid(law, motion), _places(law, motion))
        ratios = _ratios(case, motion, law, instants)
        top = {name: float(np.nanmax(values)) for name, values in ratios.items()}
        spread = law.width / _PER_PHASE
        for _ in range(_ZOOMS):
            instants = _zoomed(law, motion, instants, ratios, spread)
            ratios = _ratios(case, motion, law, instants)
            top = {name: max(value, float(np.nanmax(ratios[name]))) for name, value in top.items()}
            spread = spread / 10.0
        return Judgement(top, _structure(case, motion, law))


def _law(spec: Case) -> _Law:
    width, jerk = np.array(spec["durations"], dtype=float), np.array(spec["jerks"], dtype=float)
    rows = [(float(spec.get("start_s", 0.0)), float(spec["start_speed"]), float(spec["start_acceleration"]))]
    for h, j in zip(width.tolist(), jerk.tolist(), strict=True):
        s, v, a = rows[-1]
        rows.append((s + h * (v + h * (a / 2.0 + h * j / 6.0)), v + h * (a + h * j / 2.0), a + h * j))
    s, v, a = np.array(rows).T
    return _Law(s, v, a, jerk, width)


def _grid(law: _Law, motion: Motion) -> _Instants:
    """Return evenly spaced instants in every phase, and those of stationary speed."""
    n = law.width.size
    phase = np.repeat(np.arange(n), _PER_PHASE)
    dt = law.width[phase] * np.tile(np.linspace(0.0, 1.0, _PER_PHASE), n)
    flat = np.nan_to_num(np.clip(-law.a[:-1] / law.jerk, 0.0, law.width), nan=0.0)
    return _on_path(law, motion, np.concatenate((phase, np.arange(n))), np.concatenate((dt, flat)))


def _on_path(law: _Law, motion: Motion, phase: Ints, dt: Floats) -> _Instants:
    s = np.clip(law.at(phase, dt)[0], 0.0, motion.length)
    piece = np.clip(np.searchsorted(motion.s, s, side="right") - 1, 0, motion.s.size - 1)
    share = np.clip((s - motion.s[piece]) / np.maximum(motion.h[piece], 1e-300), 0.0, 1.0)
    return _Instants(phase, dt, piece, share)


def _places(law: _Law, motion: Motion) -> _Instants:
    """Return entry, middle and exit of every piece, and places of zero curvature, where wheels turn fastest.

    Distance counts from the start of each phase: near a spike of curvature one unit in the last place of a metre is a
    large part of the distance over which the speed can change.
    """
    n, half = motion.h.size, np.full(motion.h.size, 0.5)
    crosses = motion.k0 * motion.k1 < 0.0
    straight = np.divide(motion.k0, motion.k0 - motion.k1, out=half.copy(), where=crosses)
    piece, share = np.repeat(np.arange(n), 4), np.column_stack((0.0 * half, half, straight, 2.0 * half)).ravel()
    wanted = motion.s_at(piece, share)
    phase = np.clip(np.searchsorted(np.maximum.accumulate(law.s), wanted) - 1, 0, law.width.size - 1)
    low, high = np.zeros(wanted.size), law.width[phase]
    from_border = law._replace(s=np.zeros(law.s.size))
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        ahead = from_border.at(phase, middle)[0] >= wanted - law.s[phase]
        low, high = np.where(ahead, low, middle), np.where(ahead, middle, high)
    return _Instants(phase, 0.5 * (low + high), piece, share)


def _joined(first: _Instants, second: _Instants) -> _Instants:
    return _Instants(*(np.concatenate(columns) for columns in zip(first, second, strict=True)))


def _zoomed(law: _Law, motion: Motion, instants: _Instants, ratios: dict[str, Floats], spread: Floats) -> _Instants:
    """Return more instants around the largest three values of every quantity."""
    at = np.unique(np.concatenate([np.argsort(np.nan_to_num(v, nan=-1.0))[-3:] for v in ratios.values()]))
    phase = np.repeat(instants.phase[at], _SPREAD.size)
    dt = np.repeat(instants.dt[at], _SPREAD.size) + spread[phase] * np.tile(_SPREAD, at.size)
    return _on_path(law, motion, phase, np.clip(dt, 0.0, law.width[phase]))


def turn_limits(limits: Case) -> tuple[float, float, float]:
    """Return the largest rate, acceleration and jerk of a turn in place.

    The rims comply with the wheel speed limit, and with acceleration and jerk limits of straight motion.
    """
    lever = 0.5 * float(limits.get("track_width", 0.0))
    gains = (float(limits.get("max_acceleration", 0.5)), float(limits.get("max_deceleration", 0.6)))
    rate = float(limits.get("max_yaw_rate", math.inf))
    acceleration = float(limits.get("max_yaw_acceleration", math.inf))
    if lever > 0.0:
        rate = min(rate, float(limits.get("max_wheel_speed", math.inf)) / lever)
        acceleration = min(acceleration, min(gains) / lever)
    return rate, acceleration, acceleration * float(limits.get("max_jerk", 2.0)) / max(gains)


def _ratios(case: Case, motion: Motion, law: _Law, instants: _Instants) -> dict[str, Floats]:
    """Return every limited quantity over its limit, Shape (n,) each; driving and turns in place are separate."""
    driving = _driving_ratios(case, motion, law, instants)
    if not np.any(motion.gear == 0.0):
        return driving
    phase, dt = instants.phase, instants.dt
    s, v, a = law.at(phase, dt)
    v, a = _without_rounding(law, phase, s, v, a)
    values = np.abs(v), np.abs(a), np.abs(law.jerk[phase])
    turning = dict(zip(("turn_rate", "turn_acceleration", "turn_jerk"), values, strict=True))
    # A phase turns if its middle does; a phase without motion counts as the more tolerant of both.
    middle = law.at(np.arange(law.width.size), 0.5 * law.width)[0]
    piece = np.clip(np.searchsorted(motion.s, middle, side="right") - 1, 0, motion.s.size - 1)
    turns, tiny = motion.gear[piece] == 0.0, _tiny_turns(motion)
    short = (np.abs(np.diff(law.s)) <= _NOWHERE) | (turns & tiny[piece])
    is_turn, is_drive = (turns | short)[phase], (~turns | short)[phase]
    here = (motion.gear == 0.0)[instants.piece]
    found = {name: np.where(is_turn | here, 0.0, ratio) for name, ratio in driving.items()}
    limits = zip(turning.items(), turn_limits(case["limits"]), strict=True)
    return found | {name: np.where(is_drive | ~here, 0.0, value / limit) for (name, value), limit in limits}


def _tiny_turns(motion: Motion) -> npt.NDArray[np.bool_]:
    """Return pieces of turns so small that both their ends may be one rest, Shape (n,)."""
    sizes = [one.length if one.in_place else math.inf for one in motion.segments]
    tiny: npt.NDArray[np.bool_] = np.repeat(sizes, [one.stop - one.first for one in motion.segments]) <= 2.0 * _REST
    return tiny


def _driving_ratios(case: Case, motion: Motion, law: _Law, instants: _Instants) -> dict[str, Floats]:
    """Return the ratios of driving, as `_ratios`."""
    limits, (phase, dt, piece, share) = case["limits"], instants
    s, v, a = law.at(phase, dt)
    v, a = _without_rounding(law, phase, s, v, a)
    k0, k1, h = motion.k0[piece], motion.k1[piece], motion.h[piece]
    k, r = k0 + (k1 - k0) * share, np.where(k1 == k0, 0.0, (k1 - k0) / h)
    speed, track = np.abs(v), float(limits.get("track_width", 0.0))
    wheelbase = float(limits.get("wheelbase", 0.0))
    slack = np.where(motion.exact[piece], 1.0, 1.0 + _SAMPLED + 0.01)
    curved = {
        "yaw_rate": np.abs(v * k),
        "lateral_acceleration": v * v * np.abs(k),
        "yaw_acceleration": np.abs(a * k + v * v * r),
        "lateral_jerk": np.abs(2.0 * v * a * k + v**3 * r),
        "wheel_speed": speed * (1.0 + 0.5 * track * np.abs(k)),
        "steering_rate": wheelbase * np.abs(r) * speed / (1.0 + (wheelbase * k) ** 2),
    }
    found = {
        "speed": speed / _top_speed(case, motion, piece, share),
        "acceleration": a / limits.get("max_acceleration", 0.5),
        "deceleration": -a / limits.get("max_deceleration", 0.6),
        "jerk": np.abs(law.jerk[phase]) / limits.get("max_jerk", 2.0),
    }
    bounded = {name: limits.get(f"max_{name}", math.inf) for name in curved}
    return found | {name: curved[name] / slack / limit for name, limit in bounded.items() if math.isfinite(limit)}


def _without_rounding(law: _Law, phase: Ints, s: Floats, v: Floats, a: Floats) -> tuple[Floats, Floats]:
    """Return speed and acceleration reduced by the effect of `_ROUNDED` units in the last place of distance and speed.

    This is the accuracy of any instant. It matters near spikes of curvature that are picometres wide, which a robot
    passes at about 1e-10 m/s: there one unit of 1e-16 m takes microseconds.
    """
    jerk, place = np.abs(law.jerk[phase]), _ROUNDED * np.spacing(np.abs(s))
    with np.errstate(divide="ignore"):
        time = np.minimum(place / np.abs(v), np.cbrt(6.0 * place / jerk))
    time = np.where(np.isfinite(time), time, 0.0)
    rounded = _ROUNDED * np.spacing(np.abs(law.v).max())
    speed = np.maximum(np.abs(v) - rounded - np.abs(a) * time - 0.5 * jerk * time**2, 0.0)
    return np.copysign(speed, v), np.copysign(np.maximum(np.abs(a) - jerk * time, 0.0), a)


def _top_speed(case: Case, motion: Motion, piece: Ints, share: Floats) -> Floats:
    """Return the speed limit of the gear, and of the zone at the end if it is lower. Shape (n,) [m/s]."""
    limits, (zone_speed, zone_length) = case["limits"], case["zone"]
    top: Floats = np.where(motion.gear[piece] > 0, limits.get("max_speed", 0.5), limits.get("max_reverse_speed", 0.3))
    # A nanometre inside, where the side of the border is unambiguous.
    driven = motion.driven_before(piece, share)
    whole = float(np.sum(motion.h[motion.gear != 0.0]))
    inside = (driven > whole - zone_length + 1e-9) & (zone_length > 0.0)
    return np.where(inside, np.minimum(top, zone_speed if zone_speed is not None else math.inf), top)


def _structure(case: Case, motion: Motion, law: _Law) -> dict[str, float]:
    """Return rules of structure, as the error over its tolerance."""
    ends = max(abs(law.s[0]), abs(law.s[-1] - motion.length)) / _REST
    instants = _grid(law, motion)
    slowest = float(np.min(law.at(instants.phase, instants.dt)[1]))
    back = max(-slowest / _REST, float(np.max(np.maximum.accumulate(law.s) - law.s)) / _REST)
    still = motion.turn[~motion.exact & (motion.h <= 0.0)]
    begins = (("start_speed", law.v), ("start_acceleration", law.a))
    start = [abs(float(column[0]) - case[key]) / _REST for key, column in begins if case.get(key) is not None]
    return {
        "coverage": max(ends, back, math.inf if np.any(still > 1e-8) else 0.0),
        "steering_rest": max(_steered(case, motion, law), default=0.0),
        "rest": max(_unrest(law, motion.length, -1), *(_unrest(law, one.start_s) for one in motion.segments[1:]), 0.0)
        / _REST,
        "start_state": max(start, default=0.0),
    }


def _unrest(law: _Law, s: float, first: int = 0) -> float:
    """Return the error of rest of the phase border, from `first` on, that is nearest to resting at `s`."""
    state: npt.NDArray[np.float64] = np.column_stack((law.s - s, law.v, law.a))[first:]
    return float(np.min(np.max(np.abs(state), axis=1)))


def _steered(case: Case, motion: Motion, law: _Law) -> list[float]:
    """Return the missing rest for the wheels at the start and every cusp, over twice the rounding tolerance."""
    rate, wheelbase = case["limits"].get("max_steering_rate", math.inf), case["limits"].get("wheelbase", 0.0)
    if math.isinf(rate):
        return []
    dt = law.width / 2.0
    fastest = np.maximum(np.abs(law.at(np.arange(dt.size), dt)[1]), np.maximum(np.abs(law.v[:-1]), np.abs(law.v[1:])))
    turns = []
    if case.get("wheels") == "unknown":
        first, most = motion.segments[0], case["limits"].get("max_steering_angle", math.inf)
        if math.isinf(most):
            most = math.atan(wheelbase * case["limits"].get("max_curvature", math.inf))
        turns.append((first, most + abs(math.atan(wheelbase * float(motion.k0[first.first])))))
    for before, after in itertools.pairwise(motion.segments):
        angles = [
            math.atan(wheelbase * one.gear * float(k))
            for one, k in ((before, motion.k1[before.stop - 1]), (after, motion.k0[after.first]))
        ]
        turns.append((after, abs(angles[1] - angles[0])))
    found = []
    for after, turn in turns:
        needed = turn / rate
        near = (np.abs(law.s[:-1] - after.start_s) <= 2.0 * _REST) & (np.abs(law.s[1:] - after.start_s) <= 2.0 * _REST)
        given = float(np.sum(law.width[near & (fastest <= 2.0 * _REST)]))
        found.append(0.0 if needed <= _REST else (needed - given) / (_REST * needed))
    return found
