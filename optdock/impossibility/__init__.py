"""Proofs that no motion exists, searches for such proofs, and a checker that is independent of the searches.

- `blocked_straight`: every motion ends with a straight line into the dock, and that line is blocked.
- `proof`: the proof by blocked cells that separate the start from the goal, and its checker.
- `cell_decomposition`: the search for such cells, with `footprint_discs` and `connectivity_graph`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeAlias

from optdock.impossibility.blocked_straight import (
    BlockedPose,
    BlockedStraight,
    check_blocked_straight,
    prove_straight_blocked,
)
from optdock.impossibility.cell_decomposition import ImpossibilitySearch, prove_impossible
from optdock.impossibility.footprint_discs import prepare_footprint
from optdock.impossibility.proof import (
    Bottleneck,
    ImpossibilityProof,
    ImpossibilityVerdict,
    check_cells,
    separated_starts,
)

if TYPE_CHECKING:
    from collections.abc import Mapping

    from optdock.model.problem import DockingProblem

__all__ = [
    "BlockedPose",
    "BlockedStraight",
    "Bottleneck",
    "ImpossibilityProof",
    "ImpossibilitySearch",
    "ImpossibilityVerdict",
    "NoMotionProof",
    "check_impossibility",
    "impossibility_from_dict",
    "prepare_footprint",
    "prove_impossible",
    "prove_straight_blocked",
    "separated_starts",
]

NoMotionProof: TypeAlias = ImpossibilityProof | BlockedStraight


def check_impossibility(proof: NoMotionProof, problem: DockingProblem) -> ImpossibilityVerdict:
    """Check a proof from any source against `problem`; every claim of the proof is computed again.

    Args:
        proof: Proof to be checked.
        problem: The planning problem.
    """
    if type(proof) is BlockedStraight:
        return check_blocked_straight(proof, problem)
    if type(proof) is ImpossibilityProof:
        return check_cells(proof, problem)
    return ImpossibilityVerdict(proven=False, reason=f"it must be a proof, got a {type(proof).__name__}", cells=0)


def impossibility_from_dict(values: Mapping[str, object]) -> NoMotionProof:
    """Read a proof of either kind from the result of its `as_dict`.

    Raises:
        InvalidFile: If an entry is missing or has the wrong type.
    """
    return BlockedStraight.from_dict(values) if "straight" in values else ImpossibilityProof.from_dict(values)
