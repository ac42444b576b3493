"""`certify_trajectory` on random motions: a certified motion satisfies every limit at every sampled instant."""

from __future__ import annotations

from typing import TYPE_CHECKING

from experiments.fuzz.case import Verdict
from experiments.fuzz.doors import law_of, path_of, zone_of
from experiments.fuzz.generators.motions import motion_problem
from experiments.fuzz.oracle.motion import motion_of
from experiments.fuzz.oracle.timing import judge_timing
from experiments.fuzz.truth import says_yes
from optdock.errors import OptdockError
from optdock.model.limits import MotionLimits
from optdock.model.trajectory import Trajectory
from optdock.verification import certify_trajectory

if TYPE_CHECKING:
    import numpy as np

    from experiments.fuzz.case import Case
    from optdock.verification import TrajectoryCertificate

__all__ = ["draw", "judge", "refuted"]

_PLAIN = frozenset({"speed", "acceleration", "deceleration", "jerk", "rest", "start_state"})
_OF_PHASES = frozenset({"acceleration", "deceleration", "jerk", "yaw_acceleration", "yaw_jerk"})
_ALIASES = {
    "rest": ("rest", "steering_rest"),
    "yaw_rate": ("yaw_rate", "turn_rate"),
    "yaw_acceleration": ("yaw_acceleration", "turn_acceleration"),
    "yaw_jerk": ("turn_jerk",),
}
_LONG = 1e6  # [s]: after a longer wait the resolution of times is too coarse to blame a refusal
_CLAIM = 3e-6  # relative: a proven ratio may be below the true one by rounding and tolerance


def draw(rng: np.random.Generator) -> Case:
    """Draw a random motion with limits."""
    return motion_problem(rng)


def judge(case: Case) -> Verdict:
    """Compare the verdicts of the library and the oracle."""
    try:
        trajectory = Trajectory(path_of(case["path"]), law_of(case["law"]))
        limits = MotionLimits(**case["limits"])
        certificate = certify_trajectory(trajectory, limits, zone_of(case), start_speed=case["start_speed"])
    except OptdockError as error:
        return Verdict(f"input refused: {type(error).__name__}", str(error))
    if says_yes(certificate):
        return refuted(case, certificate) or Verdict("certified")
    return _wrongly_refused(case, certificate) or Verdict(f"refused: {certificate.violations[0].kind}")


def refuted(case: Case, certificate: TrajectoryCertificate) -> Verdict | None:
    """Return evidence that a certificate is false, or claims too small ratios."""
    motion = motion_of(case["path"])
    found = judge_timing(case, motion)
    if found.broken:
        worst = found.broken[0]
        ratio = found.ratios.get(worst, found.structure.get(worst, 0.0))
        return Verdict("false certificate", f"{worst}: {ratio:.9g} times what is allowed")
    if not all(one.exact or one.in_place for one in motion.segments):
        return None
    for name, ratio in found.ratios.items():
        claimed = certificate.ratios.get(name.replace("turn_", "yaw_"), 1.0)
        if claimed < ratio * (1.0 - _CLAIM) - 1e-12:
            return Verdict("overclaimed bound", f"{name}: ratio {claimed:.9g} claimed, an instant has {ratio:.9g}")
    return None


def _wrongly_refused(case: Case, certificate: TrajectoryCertificate) -> Verdict | None:
    """Return evidence that a reason of a refusal is clearly unfounded."""
    if sum(case["law"]["durations"]) > _LONG:
        return None
    motion = motion_of(case["path"])
    found = judge_timing(case, motion)
    exact = all(one.exact or one.in_place for one in motion.segments)
    drives_only = not any(one.in_place for one in motion.segments)
    for violation in certificate.violations:
        judgeable = violation.kind in _PLAIN or exact
        if not drives_only and violation.kind in _OF_PHASES:
            continue  # the piece of phases of a nanometre at a cusp is ambiguous
        if judgeable and all(found.is_clear(kind) for kind in _ALIASES.get(violation.kind, (violation.kind,))):
            return Verdict("false refusal", f"{violation.kind}: {violation.message}")
    return None
