"""Motions that are known by samples only: they are never certified, but can be refuted.

- `sampled_motion`: rounding, and the place of each sample on its path.
- `refutation`: the rules that samples can break.
- `tube`: how far samples of a drive are off its path, and how far they may be.
"""

from optdock.samples.refutation import (
    SampledMotionVerdict,
    are_rounded_phases,
    check_sampled_motion,
    check_samples_of,
)
from optdock.samples.sampled_motion import SampledMotion

__all__ = [
    "SampledMotion",
    "SampledMotionVerdict",
    "are_rounded_phases",
    "check_sampled_motion",
    "check_samples_of",
]
