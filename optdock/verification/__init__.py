"""Certificates of paths and trajectories, proven independently of the solvers (docs/theory/certificate.md).

For every point of the continuous path, `certify_path` proves the clearance of the footprint, the limits of curvature,
the ends, the gears, the final straight, and the camera's view of the dock. For every instant, `certify_trajectory`
proves the motion limits, the coverage of the path, and the required rests. Both allow deviations up to `TOLERANCE`. A
sampled motion is never certified: see `optdock.samples`. Proofs that no motion exists are in `optdock.impossibility`.
"""

from optdock.verification.certificate import (
    SHARPNESS,
    TOLERANCE,
    Certificate,
    TrajectoryCertificate,
    Violation,
    where_broken,
)
from optdock.verification.certify import certify_motion, certify_path, certify_trajectory
from optdock.verification.clearance_kernel import EndClearances, compiled_clearances, end_clearances
from optdock.verification.proven_motion import (
    ProvenMotion,
    ProvenWay,
    WayVerdict,
    prove_motion,
    prove_way,
    proven_for,
    proven_way,
    unchanged_way,
)
from optdock.verification.proximity import pose_clearance, pose_clearances

__all__ = [
    "SHARPNESS",
    "TOLERANCE",
    "Certificate",
    "EndClearances",
    "ProvenMotion",
    "ProvenWay",
    "TrajectoryCertificate",
    "Violation",
    "WayVerdict",
    "certify_motion",
    "certify_path",
    "certify_trajectory",
    "compiled_clearances",
    "end_clearances",
    "pose_clearance",
    "pose_clearances",
    "prove_motion",
    "prove_way",
    "proven_for",
    "proven_way",
    "unchanged_way",
    "where_broken",
]
