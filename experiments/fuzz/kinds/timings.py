"""Timing plugins on random paths, limits and start speeds: OK results must be provable, and calls must terminate."""

from __future__ import annotations

import math
import time
from typing import TYPE_CHECKING

from experiments.fuzz.case import Verdict
from experiments.fuzz.doors import law_spec, path_of, zone_of
from experiments.fuzz.generators.routes import clothoid_route
from experiments.fuzz.generators.shapes import log_uniform
from experiments.fuzz.kinds import trajectories
from experiments.fuzz.truth import says_yes
from optdock.errors import OptdockError
from optdock.model.limits import MotionLimits
from optdock.plugins.interfaces import TimeParameterizer
from optdock.plugins.registry import create_plugin
from optdock.verification import certify_trajectory

if TYPE_CHECKING:
    import numpy as np

    from experiments.fuzz.case import Case
    from optdock.model.trajectory import Trajectory

__all__ = ["draw", "judge"]

_SLOW = 2.0  # [s] of CPU time for one path


def draw(rng: np.random.Generator) -> Case:
    """Draw a path of clothoids with limits; the start may be faster than any of them allows."""
    limits: Case = {
        "max_speed": log_uniform(rng, 0.1, 2.0),
        "max_reverse_speed": log_uniform(rng, 0.1, 2.0),
        "max_acceleration": log_uniform(rng, 0.1, 2.0),
        "max_deceleration": log_uniform(rng, 0.1, 2.0),
        "max_jerk": log_uniform(rng, 0.1, 16.0),
    }
    for name in ("yaw_rate", "yaw_acceleration", "lateral_acceleration", "wheel_speed", "lateral_jerk"):
        if rng.uniform() < 0.35:
            limits[f"max_{name}"] = log_uniform(rng, 1e-2, 2.0)
    limits["track_width"] = float(rng.uniform(0.2, 0.9)) if "max_wheel_speed" in limits else 0.0
    path = clothoid_route(rng)
    top = limits["max_speed" if path[0]["gear"] > 0 else "max_reverse_speed"]
    return {
        "kind": "timings",
        "path": path,
        "limits": limits,
        "zone": [log_uniform(rng, 0.02, 0.4), float(rng.uniform(0.05, 1.5))] if rng.uniform() < 0.5 else [None, 0.0],
        **_start(rng, top, limits),
        "plugin": str(rng.choice(["NearOptimal", "Windowed"], p=[0.75, 0.25])),
    }


def _start(rng: np.random.Generator, top: float, limits: Case) -> Case:
    """Return a start at rest, at speed, or at speed with an acceleration that may exceed the limits."""
    if rng.uniform() < 0.5:
        return {"start_speed": 0.0}
    speed: Case = {"start_speed": float(top * rng.uniform(0.0, 1.0))}
    if rng.uniform() < 0.5:
        most = limits["max_acceleration"], limits["max_deceleration"]
        speed["start_acceleration"] = float(rng.uniform(-1.02 * most[1], 1.02 * most[0]))
    return speed


def _begins(case: Case) -> dict[str, float]:
    return {"start_speed": case["start_speed"], "start_acceleration": case.get("start_acceleration", 0.0)}


def judge(case: Case) -> Verdict:
    """Time the path, and certify an OK result."""
    limits = MotionLimits(**case["limits"])
    began = time.process_time()
    try:
        path = path_of(case["path"])
        plugin = create_plugin(TimeParameterizer, case["plugin"])
        result = plugin.parameterize(path, limits, zone_of(case), **_begins(case))
    except OptdockError as error:
        return Verdict(type(error).__name__, str(error))
    spent = time.process_time() - began
    found = None
    if says_yes(result) and result.trajectory is not None:
        found = _looked_at(case, limits, result.trajectory)
    if found is None and spent > _SLOW:
        return Verdict("late", f"{case['plugin']}: {result.status.name} after {spent:.1f} s of CPU")
    return found or Verdict(f"{case['plugin']} {result.status.name}")


def _looked_at(case: Case, limits: MotionLimits, trajectory: Trajectory) -> Verdict | None:
    proof = certify_trajectory(trajectory, limits, zone_of(case), **_begins(case))
    if not says_yes(proof):
        return Verdict("CertificationFailed", f"{case['plugin']} {proof.violations[0].kind}: {proof.reason}")
    timed = {**case, "kind": "trajectories", "law": law_spec(trajectory.time_law)}
    refuted = trajectories.refuted(timed, proof)
    if refuted is None and not math.isfinite(trajectory.duration):
        return Verdict("false certificate", "duration: not finite")
    return None if refuted is None else Verdict(refuted.outcome, refuted.detail, timed)
