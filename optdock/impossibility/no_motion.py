"""Proofs that no motion exists, of either kind: which one it is, and whether it holds."""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeAlias

from optdock.impossibility.blocked_straight import BlockedStraight, check_blocked_straight
from optdock.impossibility.proof import ImpossibilityProof, ImpossibilityVerdict, check_cells

if TYPE_CHECKING:
    from collections.abc import Mapping

    from optdock.model.problem import DockingProblem

__all__ = ["NoMotionProof", "check_impossibility", "impossibility_from_dict"]

NoMotionProof: TypeAlias = ImpossibilityProof | BlockedStraight


def check_impossibility(proof: NoMotionProof, problem: DockingProblem) -> ImpossibilityVerdict:
    """Judge a proof from any source for `problem`; everything that counts is computed again.

    Args:
        proof: To be checked.
        problem: What the robot must do.
    """
    if type(proof) is BlockedStraight:
        return check_blocked_straight(proof, problem)
    if type(proof) is ImpossibilityProof:
        return check_cells(proof, problem)
    return ImpossibilityVerdict(proven=False, reason=f"it is not a proof but a {type(proof).__name__}", cells=0)


def impossibility_from_dict(values: Mapping[str, object]) -> NoMotionProof:
    """What `as_dict` of a proof of either kind gave.

    Raises:
        InvalidFile: Something is missing, or of another kind.
    """
    return BlockedStraight.from_dict(values) if "straight" in values else ImpossibilityProof.from_dict(values)
