"""Certificates of paths and trajectories, proven independently of the solvers.

**Theorem (path).** Let `certify_path(path, problem)` be certified. Then at every point of the continuous path the
footprint keeps the clearance that the problem requires at that pose from every obstacle, up to `TOLERANCE`; where
contact is allowed, no overlap is deeper than two tolerances, regardless of the decomposition of the shapes into pieces.
The path begins at the start and ends at the goal in the gear that the dock requires, has no jump, satisfies the limits
of curvature and curvature rate, and its last part is straight. It turns in place only if the robot can. Where the dock
must be visible, its marker is in the camera's view, up to `TOLERANCE`.

*Idea of the proof.* The axis that attains the distance d of two convex shapes at one pose separates them by a lower
bound at every other pose, because bounds of the motion limit the speed and the acceleration of every footprint point
along it. A pose with distance d therefore clears a whole stretch of the path. Stretches that are not cleared are
bisected until they are, until a pose in them violates the rule, or until they are given up, which is a violation.

**Theorem (trajectory).** Let `certify_trajectory(trajectory, limits, zone)` be certified. Then at every instant speed,
acceleration, deceleration, jerk, yaw rate, yaw acceleration, lateral acceleration, wheel speeds and steering rate
satisfy their limits up to `TOLERANCE`, relative, and so do yaw rate, acceleration and jerk in turns in place; the
motion covers its path once, never backwards, and rests at every cusp, for the time that its wheels need, and at the
end.

A sampled motion is never certified: see `optdock.samples`. That no motion exists is proven in `optdock.impossibility`.
Lengths are in metres, angles in radians, times in seconds. The modules, in the order of the proof:

    certificate             certificates, and the one tolerance
    motion_bounds           the path as cells of smooth motion: bounds of velocity and acceleration
    contact_tolerance       deep overlaps of unions of pieces
    proximity               clearance of a pose: broad phase, narrow phase
    conservative_advancement  from poses to stretches: subdivision, branch and bound, the proof of clearance
    visibility              the same advance for the camera's view of the marker
    path_rules              frame, ends, joints, gears, slip, curvature, final straight
    trajectory_rules        coverage, rest, limits along the time law
    turning_rules           limits that depend on curvature
    certify                 the two verdicts
    proven_motion           path, time law, problem and pose in one value that only proofs create
    time_of_impact          the same advance at a constant body velocity: collision-free time of a command
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
from optdock.verification.proximity import EndClearances, end_clearances, pose_clearance, pose_clearances

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
