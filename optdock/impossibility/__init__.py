"""Proofs that no motion exists: what is proven, the check that a reader needs to trust, and the searches for proofs.

- `blocked_straight`: every motion ends with a straight line into the dock, and that line is blocked.
- `proof`: why blocked cells that separate start from goal prove that no motion exists, and their check.
- `cell_decomposition`: the search for such cells; `footprint_discs`: what they are blocked by; `connectivity_graph`:
  which of them hang together.
- `no_motion`: either proof, from a file too.
"""

from optdock.impossibility.blocked_straight import BlockedPose, BlockedStraight, prove_straight_blocked
from optdock.impossibility.cell_decomposition import ImpossibilitySearch, prove_impossible
from optdock.impossibility.footprint_discs import prepare_footprint
from optdock.impossibility.no_motion import NoMotionProof, check_impossibility, impossibility_from_dict
from optdock.impossibility.proof import Bottleneck, ImpossibilityProof, ImpossibilityVerdict

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
]
