"""Motions known only from samples, which can be refuted but not certified.

- `sampled_motion`: rounding, and the position of each sample along its path.
- `refutation`: the rules that samples can violate.
- `tube`: deviations of the samples of a drive from its path, and the allowed deviations.
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
