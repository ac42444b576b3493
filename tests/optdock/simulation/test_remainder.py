"""The remaining path shrinks monotonically and is not fooled by cusps."""

import itertools

import numpy as np

from optdock.geometry.pose import Pose2
from optdock.simulation import RemainingPath
from optdock.testing.drives import cusp_drive, straight_drive

START = Pose2(0.0, 0.0, 0.0)


def length(poses):
    return sum(a.distance_to(b) for a, b in itertools.pairwise(poses))


def test_it_begins_with_the_whole_path_and_ends_with_two_poses():
    path = straight_drive(START).path
    remaining = RemainingPath(path)
    assert np.isclose(length(remaining.from_pose(path.start)), path.length)
    for s in np.linspace(0.0, path.length, 60):
        rest = remaining.from_pose(path.pose_at(s))
        assert np.isclose(length(rest), max(0.05, path.length - s), atol=0.026)
    assert len(rest) == 2
    assert rest[-1] == path.end


def test_it_never_grows_again():
    path = straight_drive(START).path
    remaining = RemainingPath(path)
    assert length(remaining.from_pose(path.pose_at(0.8))) < 1.3
    assert length(remaining.from_pose(path.start)) < 1.3


def test_the_leg_behind_a_cusp_opens_only_at_the_cusp():
    path = cusp_drive(START).path
    remaining = RemainingPath(path)
    (cusp,) = path.cusps
    for s in np.arange(0.0, cusp - 0.03, 0.02):
        assert length(remaining.from_pose(path.pose_at(s))) > path.length - cusp - 1e-9
    for s in np.arange(cusp, path.length, 0.02):
        rest = remaining.from_pose(path.pose_at(s))
    assert length(rest) < 0.08
