"""Every limit in turn, tightened until it binds: the certificate must switch at the oracle's value, and timing comply.

A path is timed under limits with reserve. The oracle's value of each quantity is the limit at which the certificate
must switch: certified just above, refused by that name just below. If timed again under a binding limit, the motion is
certified and the oracle agrees, or the refusal names a limit.
"""

from __future__ import annotations

import functools
import math
from typing import TYPE_CHECKING

from experiments.fuzz.case import Verdict
from experiments.fuzz.doors import law_spec, path_of, path_spec, problem_of, zone_of
from experiments.fuzz.generators.docking import docking_problem
from experiments.fuzz.generators.routes import clothoid_route
from experiments.fuzz.generators.shapes import log_uniform
from experiments.fuzz.kinds import trajectories
from experiments.fuzz.oracle.motion import motion_of
from experiments.fuzz.oracle.timing import LIMITED, judge_timing
from optdock.errors import OptdockError
from optdock.model.limits import MotionLimits
from optdock.planning.pipeline import plan_dock, warm_up
from optdock.plugins.interfaces import TimeParameterizer, TimingStatus
from optdock.plugins.registry import create_plugin
from optdock.verification import certify_trajectory

if TYPE_CHECKING:
    import numpy as np

    from experiments.fuzz.case import Case
    from optdock.model.trajectory import Trajectory

__all__ = ["draw", "judge"]

_PLANNED = 0.5  # share of paths made by `plan_dock`
_ABOVE, _BELOW = 1.0 + 1e-5, 1.0 - 1e-5  # factors of the oracle's value; the certificate accepts 1e-6 beyond a limit
_NO_ZONE = [None, 0.0]
_LEAST, _MOST = 1e-6, 1e6  # smaller quantities are rounding, larger ones those of spikes of the curvature
_SEEN = 1e9  # no limit, in places where the oracle evaluates a quantity


def draw(rng: np.random.Generator) -> Case:
    """Draw a path to time, and a factor for each limit."""
    limits: Case = {
        "max_speed": log_uniform(rng, 0.2, 2.0),
        "max_reverse_speed": log_uniform(rng, 0.2, 2.0),
        "max_acceleration": log_uniform(rng, 0.2, 2.0),
        "max_deceleration": log_uniform(rng, 0.2, 2.0),
        "max_jerk": log_uniform(rng, 0.3, 16.0),
        "track_width": float(rng.uniform(0.2, 0.9)),
        "wheelbase": log_uniform(rng, 0.2, 3.0),
    }
    planned = rng.uniform() < _PLANNED
    return {
        "kind": "limits",
        "limits": limits,
        "shares": {name: float(rng.uniform(0.3, 0.97)) for name in LIMITED},
        "zone": [log_uniform(rng, 0.02, 0.4), float(rng.uniform(0.05, 1.5))] if rng.uniform() < 0.3 else _NO_ZONE,
        "start_speed": 0.0,
        "plugin": str(rng.choice(["NearOptimal", "Windowed"], p=[0.75, 0.25])),
        **({"problem": docking_problem(rng)} if planned else {"path": clothoid_route(rng)}),
    }


def judge(case: Case) -> Verdict:
    """Plan and time, then tighten."""
    try:
        gears = case["path"] if "path" in case else _planned(case["problem"])
        case = {**case, "path": gears}
        free = _timed(case, case["limits"])
    except OptdockError as error:
        return Verdict(f"no motion: {type(error).__name__}", str(error))
    words, motion = free
    if motion is None:
        return Verdict("no motion: timing", words)
    route = motion_of(gears)
    if not all(one.exact for one in route.segments):
        return Verdict("no motion: not of clothoids")
    law = law_spec(motion.time_law)
    wide = {f"max_{name}": _SEEN for name in (*LIMITED, "reverse_speed")}
    seen = judge_timing({**case, "zone": _NO_ZONE, "law": law, "limits": {**case["limits"], **wide}}, route).ratios
    outcome = Verdict("certified")
    for name in LIMITED:
        top = seen[name] * _SEEN
        if not _LEAST < top < _MOST or (
            name == "steering_rate" and len(gears) > 1
        ):  # between gears the wheels turn at rest
            continue
        found = _turns_at(case, motion, name, top) or _kept(case, name, top * case["shares"][name])
        if found is not None and found.is_fault:
            return found
        outcome = found or outcome
    return outcome


def _limited(case: Case, name: str, value: float) -> Case:
    """Return the limits of a case with one of them, for both gears, set to a value."""
    both = {"max_speed": value, "max_reverse_speed": value} if name == "speed" else {f"max_{name}": value}
    return {**case["limits"], **both}


def _turns_at(case: Case, motion: Trajectory, name: str, top: float) -> Verdict | None:
    """Return a fault if the certificate does not switch at the oracle's value."""
    for share, wanted in ((_ABOVE, []), (_BELOW, [name])):
        limits = MotionLimits(**_limited(case, name, top * share))
        proof = certify_trajectory(motion, limits, zone_of({"zone": _NO_ZONE}))
        found = [one.kind for one in proof.violations]
        if found != wanted:
            fault = "false certificate" if wanted and not found else "false refusal"
            return Verdict(fault, f"{name}: at {share:.6f} times {top:.6g} the certificate says {found or 'certified'}")
        if not wanted and proof.ratios[name] < (1.0 - 3e-6) / share:
            return Verdict("overclaimed bound", f"{name}: {proof.ratios[name]:.9g} of {share:.6f} times what is seen")
    return None


def _kept(case: Case, name: str, value: float) -> Verdict | None:
    """Return the fault of the motion timed under a binding limit, or of its refusal."""
    limits = _limited(case, name, value)
    words, motion = _timed(case, limits)
    if motion is None:
        unnamed = " limit=" not in words
        return Verdict("CertificationFailed" if unnamed else "refused by name", f"{case['plugin']} {name}: {words}")
    tight = {**case, "kind": "trajectories", "limits": limits, "law": law_spec(motion.time_law)}
    proof = certify_trajectory(motion, MotionLimits(**limits), zone_of(case), start_speed=0.0, start_acceleration=0.0)
    if not proof.certified:
        return Verdict("CertificationFailed", f"{case['plugin']} {name}: {proof.reason}")
    refuted = trajectories.refuted(tight, proof)
    return None if refuted is None else Verdict(refuted.outcome, refuted.detail, tight)


def _timed(case: Case, limits: Case) -> tuple[str, Trajectory | None]:
    """Return how timing ended, with ` limit=` if it names one, and the motion if it is OK."""
    plugin = create_plugin(TimeParameterizer, case["plugin"])
    result = plugin.parameterize(path_of(case["path"]), MotionLimits(**limits), zone_of(case))
    named = f" limit={result.limit}" if result.limit else ""
    if result.status is TimingStatus.OK and result.trajectory is not None and math.isfinite(result.trajectory.duration):
        return "OK", result.trajectory
    return f"{result.status.name}{named}: {result.reason}", None


@functools.cache
def _warm() -> None:
    warm_up()


def _planned(problem: Case) -> list[Case]:
    """Return the gears of the path found by `plan_dock`."""
    _warm()
    return path_spec(plan_dock(problem_of(problem), time_budget=problem["budget"]).path)
