"""The independent certificate: what is proven of a path and of a motion along it, by means that know no solver.

**Theorem (path).** Let `certify_path(path, problem)` be certified. Then at every point of the continuous path, not only
at samples, the footprint keeps the clearance that the problem requires at that pose from every obstacle, up to
`TOLERANCE`; where contact is allowed, nothing lies deeper than two tolerances inside anything, however the shapes are
made of pieces. The path begins at the start and ends at the goal in the gear that the dock asks for, has no jump, its
curvature and curvature rate stay within the robot's limits and its last stretch is straight. It turns in place only
where the robot does that. Where the dock must be seen its marker is in the camera's view, up to `TOLERANCE`.

*Idea of the proof.* The axis that attains the distance d of two convex shapes at one pose still separates them by a
lower bound at every other pose. Along it no point of the footprint moves faster, or is bent more, than bounds of the
motion say. So a pose that keeps d clears a whole stretch of the path around it. Stretches that are not cleared are
bisected until they are, until a pose in them breaks the rule, or until they are given up, which counts as broken.

**Theorem (trajectory).** Let `certify_trajectory(trajectory, limits, zone)` be certified. Then at every instant speed,
acceleration, deceleration, jerk, yaw rate, yaw acceleration, lateral acceleration, wheel speeds and steering rate keep
their limits up to `TOLERANCE`, relative, and in turns in place yaw rate, acceleration and jerk keep theirs; the motion
covers its path once, never backwards, and rests at every cusp, for as long as its wheels take to turn, and at the end.

A motion that is known by samples only is never certified: see `optdock.samples`. That no motion exists at all is proven
in `optdock.impossibility`.

It reads the finished path and the problem, and nothing else. Lengths are metres, angles radians, times seconds. The
chapters, in the order in which a proof uses them:

    certificate             what a proof says, and the one tolerance
    motion_bounds           the path as cells of smooth motion: how fast and how bent a point of the footprint moves
    contact_tolerance       why the tolerance hides no deep overlap where shapes are unions of pieces
    proximity               the clearance of a pose: broad phase, narrow phase
    conservative_advancement  from poses to stretches: subdivision, branch and bound, the proof of clearance
    visibility              the same advance for the view of the dock: cone and ranges of the camera
    path_rules              frame, ends, joints, gears, slip, curvature, final straight
    trajectory_rules        coverage, rest, limits along the time law
    turning_rules           limits that depend on curvature
    certify                 the two verdicts, each made once
    proven_motion           path, time law, problem and pose in one value that only proofs make
    memo                    what was proven of a frozen value is kept while it lives
    time_of_impact          the same advance at a constant body velocity: how long a command is safe
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
