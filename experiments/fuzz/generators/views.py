"""Motions past a marker, and cameras that just keep it in view or just lose it."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from experiments.fuzz.generators.routes import route
from experiments.fuzz.generators.shapes import log_uniform
from experiments.fuzz.oracle.motion import motion_of
from experiments.fuzz.oracle.views import views

if TYPE_CHECKING:
    from experiments.fuzz.case import Case
    from experiments.fuzz.oracle.motion import Motion

__all__ = ["view_problem"]

Rng: TypeAlias = np.random.Generator
_BORDER = 0.85  # share of cases with camera limits near the values of the motion


def view_problem(rng: Rng) -> Case:
    """Return a path and a camera that keeps the marker in view, nearly keeps it or nearly loses it."""
    gears = route(rng)
    motion = motion_of(gears)
    length = float(np.sum(np.where(motion.gear == 0.0, 0.0, motion.h)))
    visible = length * rng.uniform(0.05, 1.2) + 1e-3
    case: Case = {
        "kind": "views",
        "path": gears,
        "footprint": {"polygon": [[0.3, 0.2], [-0.3, 0.2], [-0.3, -0.2], [0.3, -0.2]]},
        "obstacles": [],
        "dock": {"pose": motion.end.tolist(), "footprint": None, "direction": "auto", "final_straight": 0.0},
        "start": motion.start.tolist(),
        "start_speed": 0.0,
        "clearance": [0.0, 0.0, 0.0 if rng.uniform() < 0.2 else log_uniform(rng, 0.05, 1.0)],
        "limits": {"max_yaw_rate": 1.0, "max_yaw_acceleration": 1.0},
        "turns_in_place": True,
        "zone": [None, 0.0],
        "marker": _marker(rng, motion),
        "visible_distance": float(visible),
        "blind_distance": float(visible * rng.uniform(0.0, 0.9)) if rng.uniform() < 0.4 else 0.0,
        "camera": {
            "mount": [float(rng.uniform(-0.5, 0.5)), float(rng.uniform(-0.5, 0.5)), float(rng.uniform(-math.pi, 3.2))],
            "field_of_view": 2.0 * math.pi,
            "min_range": 0.0,
            "max_range": None,
        },
    }
    _look_there(rng, case, motion)
    if rng.uniform() < 0.15:
        case["tracking"] = [log_uniform(rng, 1e-4, 0.1), float(rng.uniform(0.0, 0.2))]
    _aim(rng, case, motion)
    return case


def _marker(rng: Rng, motion: Motion) -> list[float]:
    """Return a marker near the end of the path, on the path, or far away, relative to the end."""
    style = rng.uniform()
    if style < 0.15:  # a place on the path: the camera may come to stand in it
        at = rng.integers(motion.s.size, size=1)
        x, y, _ = motion.poses_at(at, rng.uniform(size=1))[0]
        c, s = math.cos(motion.end[2]), math.sin(motion.end[2])
        dx, dy = float(x - motion.end[0]), float(y - motion.end[1])
        return [c * dx + s * dy, c * dy - s * dx]
    reach = log_uniform(rng, 3.0, 1e3) if style > 0.9 else float(rng.uniform(0.0, 2.5))
    angle = float(rng.uniform(-math.pi, math.pi))
    return [reach * math.cos(angle), reach * math.sin(angle)]


def _look_there(rng: Rng, case: Case, motion: Motion) -> None:
    """Return a mount, mostly towards the marker from the middle of the stretch, so that a narrow cone may suffice."""
    if rng.uniform() > 0.8:
        return
    piece = rng.integers(motion.s.size, size=1)
    x, y, yaw = motion.poses_at(piece, rng.uniform(size=1))[0]
    (gx, gy, turned), (forward, left) = case["dock"]["pose"], case["marker"]
    mx = gx + math.cos(turned) * forward - math.sin(turned) * left
    my = gy + math.sin(turned) * forward + math.cos(turned) * left
    aim = math.atan2(my - y, mx - x) - yaw + rng.normal(0.0, 0.3)
    case["camera"]["mount"][2] = float(math.remainder(aim, 2.0 * math.pi))


def _aim(rng: Rng, case: Case, motion: Motion) -> None:
    """Return cone and ranges at the values of the motion, slightly more or slightly less; or arbitrary."""
    seen, camera = views(case, motion), case["camera"]
    if not seen.s.size or rng.uniform() > _BORDER:
        camera["field_of_view"] = float(rng.uniform(0.05, 2.0 * math.pi))
        camera["max_range"] = None if rng.uniform() < 0.5 else log_uniform(rng, 0.5, 10.0)
        return
    most = 2.0 * float(seen.bearing.max())
    # One limit is at its border; the others have some reserve.
    borders = {str(name) for name in rng.choice(["cone", "near", "far"], size=int(rng.integers(1, 4)))}
    cone = most + (2.0 * _hair(rng) if "cone" in borders else float(rng.uniform(0.01, 0.5)))
    camera["field_of_view"] = min(max(cone, 1e-3), 2.0 * math.pi)
    near, far = float(seen.distance.min()), float(seen.distance.max())
    if "near" in borders or rng.uniform() < 0.3:
        camera["min_range"] = max(0.0, near - (_hair(rng) if "near" in borders else 0.3 * near))
    if "far" in borders or rng.uniform() < 0.3:
        camera["max_range"] = max(far + (_hair(rng) if "far" in borders else far), camera["min_range"] + 1e-3)


def _hair(rng: Rng) -> float:
    """Return a small value [m], [rad], of either sign."""
    return float(rng.choice([-1, 1])) * log_uniform(rng, 1e-9, 1e-2)
