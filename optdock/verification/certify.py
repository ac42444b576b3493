"""`certify_path`: the independent verdict on a path."""

from __future__ import annotations

import weakref
from typing import TYPE_CHECKING, NamedTuple

from optdock.verification.certificate import Certificate, Violation
from optdock.verification.clearance import never, prove_clearance
from optdock.verification.path_rules import max_curvature, max_curvature_rate, path_violations

if TYPE_CHECKING:
    from collections.abc import Callable

    from optdock.geometry.arrays import FloatArray
    from optdock.path import Path
    from optdock.problem import DockingProblem
    from optdock.verification.clearance import ClearanceProof

__all__ = ["certify_path"]


def certify_path(path: Path, problem: DockingProblem, *, is_late: Callable[[], bool] = never) -> Certificate:
    """Prove that `path` solves `problem`, or name what is broken and where.

    Proven for every point of the continuous path: footprint clearance (second-order conservative advancement, see
    `clearance`). Checked exactly: start and goal pose (1e-6 m, rad), joints, gears, curvature, curvature rate, start
    curvature, final straight. A polyline is judged as linear motion between its poses, turning the short way, with the
    curvature of the arcs through them; a step whose arc is more than 5 mm from that motion is refused.

    Wherever two segments meet, also two of one gear, the curvature may jump: the robot must rest there.

    A proof is kept for as long as the path lives: paths and problems are frozen, so the same two have the same verdict.
    One that was cut short serves callers with a deadline, and only where it is certified all the same.

    It does NOT look at time: see `certify_trajectory`.

    Args:
        path: The path to judge, from any source.
        problem: What must hold.
        is_late: For callers with a deadline, asked after every round of the proof, each below a millisecond for a path
            of some metres among a hundred obstacles. Once it is True whatever is not proven yet is refused as
            `unproven`, and the reported clearance is a bound that may be far from sharp.

    Returns:
        The certificate; `certified` is True only if everything was proven.
    """
    known = _PROVEN.get(path)
    if known is not None and known.problem() is problem and (known.is_whole or is_late is not never):
        return known.certificate
    watch = _Watch(is_late)
    certificate = _judged(path, problem, watch)
    if certificate.certified or not watch.was_late:
        _PROVEN[path] = _Proven(weakref.ref(problem), certificate, is_whole=not watch.was_late)
    return certificate


class _Proven(NamedTuple):
    """A proof, its problem, and whether it was made to its end: one that was cut short may be certified, not sharp."""

    problem: weakref.ref[DockingProblem]
    certificate: Certificate
    is_whole: bool


# The last proof of every path. Held here, so that nobody can hand in a verdict of their own.
_PROVEN: weakref.WeakKeyDictionary[Path, _Proven] = weakref.WeakKeyDictionary()


class _Watch:
    """Asks whether it is late, and remembers that it was: a proof that was cut short is not kept."""

    def __init__(self, is_late: Callable[[], bool]) -> None:
        self._is_late, self.was_late = is_late, False

    def __call__(self) -> bool:
        self.was_late = self.was_late or self._is_late()
        return self.was_late


def _judged(path: Path, problem: DockingProblem, is_late: Callable[[], bool]) -> Certificate:
    proof = prove_clearance(path, problem, is_late)
    violations = (*path_violations(path, problem), *_clearance_violations(proof, problem))
    return Certificate(
        violations=violations,
        min_clearance=proof.proven,
        required_clearance=proof.required,
        at_s=proof.at_s,
        margin=proof.margin,
        nearest=problem.all_obstacles.name_of(proof.row) if proof.row >= 0 else "",
        max_curvature=max_curvature(path),
        max_curvature_rate=max_curvature_rate(path),
        length=path.length,
        poses_checked=proof.poses,
        problem=problem.fingerprint,
        path=path.digest,
    )


def _clearance_violations(proof: ClearanceProof, problem: DockingProblem) -> tuple[Violation, ...]:
    """The worst violating pose, and the worst cell given up."""
    found = []
    if len(proof.violations):
        found.append(_too_close(proof.violations[(proof.violations[:, 1] - proof.violations[:, 2]).argmin()], problem))
    elif len(proof.unproven):
        s, short = proof.unproven[proof.unproven[:, 1].argmin()]
        message = f"clearance near s = {s:.4f} m cannot be proven; the bound is {-short:.3g} m short"
        found.append(Violation("unproven", message, float(s), float(-short)))
    return tuple(found)


def _too_close(row: FloatArray, problem: DockingProblem) -> Violation:
    s, clearance, required = (float(value) for value in row[:3])
    obstacle = problem.all_obstacles.name_of(int(row[3]))
    what = "overlaps" if clearance < 0.0 else "comes too close to"
    message = (
        f"the footprint {what} {obstacle} at s = {s:.3f} m: clearance {clearance:.4f} m, required {required:.4f} m"
    )
    where = {"pose": row[4:].tolist(), "obstacle": obstacle, "clearance": clearance, "required": required}
    return Violation("clearance", message, s, required - clearance, where)
