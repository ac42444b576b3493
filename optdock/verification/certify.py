"""`certify_path`: the independent verdict on a path."""

from __future__ import annotations

import weakref
from typing import TYPE_CHECKING

from optdock.deadline import never_late
from optdock.verification.certificate import Certificate, Violation
from optdock.verification.clearance import prove_clearance
from optdock.verification.kept_proofs import KeptProofs
from optdock.verification.path_rules import max_curvature, max_curvature_rate, path_violations

if TYPE_CHECKING:
    from collections.abc import Callable

    from optdock.geometry.arrays import FloatArray
    from optdock.path import Path
    from optdock.problem import DockingProblem
    from optdock.verification.clearance import ClearanceProof

__all__ = ["certify_path"]


def certify_path(path: Path, problem: DockingProblem, *, is_late: Callable[[], bool] = never_late) -> Certificate:
    """Prove that `path` solves `problem`, or name what is broken and where.

    Proven for every point of the continuous path: footprint clearance (second-order conservative advancement, see
    `clearance`). Checked exactly: start and goal pose (1e-6 m, rad), joints, gears, curvature, curvature rate, start
    curvature, final straight. A polyline is judged as linear motion between its poses, turning the short way, with the
    curvature of the arcs through them; a step whose arc is more than 5 mm from that motion is refused, and so are slips
    and jumps that are small one by one but add up.

    Where no clearance is required contact may overlap by a micrometre, and nothing lies deeper than two micrometres
    inside anything, however the shapes are made of pieces (see `contact`).

    Wherever two segments meet, also two of one gear, the curvature may jump: the robot must rest there.

    A proof is kept for as long as the path lives: paths and problems are frozen, so the same two have the same verdict.
    One that was cut short serves callers with a deadline, and only where it is certified all the same.

    It does NOT look at time: see `certify_trajectory`.

    Args:
        path: The path to judge, from any source.
        problem: What must hold.
        is_late: For callers with a deadline, asked after every round of the proof, each below a millisecond for a path
            of some metres among a hundred obstacles, and between the blocks of long rounds. Once it is True whatever is
            not proven yet is refused as `unproven`, and the reported clearance is a bound that may be far from sharp.

    Returns:
        The certificate; `certified` is True only if everything was proven.
    """
    return _PROOFS.verdict(path, weakref.ref(problem), is_late, lambda asked: _judged(path, problem, asked))


_PROOFS: KeptProofs[Path, Certificate] = KeptProofs()


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
