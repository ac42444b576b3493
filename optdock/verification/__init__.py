"""The independent certificate: proves a path or trajectory, or names what is broken and where.

Knows nothing of solvers: it reads the finished path and the problem, and nothing else.
"""

from optdock.verification.certificate import Certificate, TrajectoryCertificate, Violation
from optdock.verification.certify import certify_path
from optdock.verification.half_cells import pose_clearance, pose_clearances
from optdock.verification.sampled_motion import (
    SampledMotionVerdict,
    are_rounded_phases,
    check_sampled_motion,
    check_samples_of,
)
from optdock.verification.samples import SampledMotion
from optdock.verification.trajectory_rules import certify_trajectory

__all__ = [
    "Certificate",
    "SampledMotion",
    "SampledMotionVerdict",
    "TrajectoryCertificate",
    "Violation",
    "are_rounded_phases",
    "certify_path",
    "certify_trajectory",
    "check_sampled_motion",
    "check_samples_of",
    "pose_clearance",
    "pose_clearances",
]
