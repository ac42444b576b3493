"""Complete proofs are cached, incomplete ones are not, and no proof is used for another problem."""

import dataclasses
import gc
import weakref

import numpy as np
import pytest

from optdock.errors import InvalidValue
from optdock.geometry.clothoid import ClothoidSpline
from optdock.geometry.footprint import Footprint
from optdock.geometry.obstacles import ObstacleSet
from optdock.geometry.pose import Pose2
from optdock.model.clearance_rule import ClearanceRule
from optdock.model.constant_jerk import TimeLaw
from optdock.model.dock import Dock
from optdock.model.limits import MotionLimits, SpeedZone
from optdock.model.path import ClothoidSegment, Path
from optdock.model.problem import DockingProblem
from optdock.model.robot import Robot
from optdock.model.trajectory import Trajectory
from optdock.verification import certify, certify_path, certify_trajectory
from optdock.verification.certificate import Memo

BESIDE = ObstacleSet.from_polygons([[[1.0, 0.3001], [2.0, 0.3001], [2.0, 1.0], [1.0, 1.0]]])
ROBOT = Robot(Footprint.rectangle(0.4, 0.4, 0.6), MotionLimits())


def straight():
    return Path((ClothoidSegment(ClothoidSpline(Pose2(0.0, 0.0, 0.0), np.array([0.0, 3.0]), np.zeros(2))),))


def problem(path, required=0.0):
    return DockingProblem(path.start, Dock(path.end), ROBOT, BESIDE, ClearanceRule(required, required, 0.0))


@pytest.fixture
def proofs(monkeypatch):
    made = []
    real = certify.prove_clearance
    monkeypatch.setattr(certify, "prove_clearance", lambda *arguments: made.append(1) or real(*arguments))
    return made


def test_complete_proofs_are_cached(proofs):
    path = straight()
    task = problem(path)
    assert certify_path(path, task) is certify_path(path, task)
    assert len(proofs) == 1


def test_another_problem_gets_a_new_proof(proofs):
    path = straight()
    assert certify_path(path, problem(path)).certified
    assert not certify_path(path, problem(path, 0.01)).certified
    assert certify_path(path, dataclasses.replace(problem(path), obstacles=ObstacleSet.empty())).certified
    assert len(proofs) == 3


def test_incomplete_proofs_are_not_cached(proofs):
    curve = ClothoidSpline(Pose2(0.0, -0.8, 0.0), np.array([0.0, 3.0]), np.array([0.4, -0.4]))
    path = Path((ClothoidSegment(curve),))
    nearest = certify_path(path, problem(path)).min_clearance
    tight = problem(path, nearest - 1e-5)
    hurried = certify_path(path, tight, is_late=lambda: True)
    assert not hurried.certified
    assert certify_path(path, tight).certified
    assert certify_path(path, tight, is_late=lambda: True).certified  # nothing is left to do
    assert len(proofs) == 3


def test_cached_proofs_keep_no_path_alive():
    path = straight()
    task = problem(path)
    certify_path(path, task)
    gone = weakref.ref(path), weakref.ref(task)
    del path, task
    gc.collect()
    assert [one() for one in gone] == [None, None]


def test_an_incomplete_certified_proof_is_reused_with_a_deadline(proofs):
    curve = ClothoidSpline(Pose2(0.0, -1.2, 0.0), np.array([0.0, 3.0]), np.array([0.4, -0.4]))
    path = Path((ClothoidSegment(curve),))
    task = problem(path)
    hurried = certify_path(path, task, is_late=lambda: True)
    assert hurried.certified
    assert certify_path(path, task, is_late=lambda: True) is hurried
    whole = certify_path(path, task)
    assert whole.min_clearance > hurried.min_clearance + 0.001
    assert certify_path(path, task, is_late=lambda: True) is whole
    assert len(proofs) == 2


def from_rest_to_rest():
    """Over the three metres, with a quarter of a metre per second in the middle."""
    return TimeLaw(np.full(4, 6.0), 3.0 / 432.0 * np.array([1.0, -1.0, -1.0, 1.0]))


@pytest.fixture
def motions(monkeypatch):
    made, real = [], certify.trajectory_violations
    monkeypatch.setattr(certify, "trajectory_violations", lambda *arguments: made.append(1) or real(*arguments))
    return made


def test_a_motion_is_proven_once_per_path_time_law_and_limits(motions):
    path, law, limits = straight(), from_rest_to_rest(), MotionLimits()
    there = certify_trajectory(Trajectory(path, law), limits, SpeedZone())
    assert certify_trajectory(Trajectory(path, law), limits, SpeedZone()) is there
    assert len(motions) == 1
    elsewhere = certify_trajectory(Trajectory(Path(path.segments), law), limits, SpeedZone())
    slower = certify_trajectory(Trajectory(path, law), MotionLimits(max_speed=0.2), SpeedZone())
    started = certify_trajectory(Trajectory(path, law), limits, SpeedZone(), start_speed=0.1)
    found = [[violation.kind for violation in one.violations] for one in (there, elsewhere, slower, started)]
    assert found == [[], [], ["speed"], ["start_state"]]
    assert len(motions) == 4


def test_no_motion_is_kept_alive():
    motion = Trajectory(straight(), from_rest_to_rest())
    certify_trajectory(motion, MotionLimits(), SpeedZone())
    gone = weakref.ref(motion.path), weakref.ref(motion.time_law)
    del motion
    gc.collect()
    assert [one() for one in gone] == [None, None]


class Alike(DockingProblem):
    """A problem that is equal to every problem with the same goal."""

    def __eq__(self, other):
        return self.goal == other.goal

    __hash__ = DockingProblem.__hash__


def test_equality_of_problems_is_identity():
    path = straight()
    free, beside = (Alike(path.start, Dock(path.end), ROBOT, some, ClearanceRule(0.01, 0.01)) for some in ((), BESIDE))
    assert certify_path(path, free).certified
    assert not certify_path(path, beside).certified


class Lax(MotionLimits):
    """Limits that are equal to all limits."""

    def __eq__(self, other):
        return True

    __hash__ = None


def test_subclasses_of_limits_are_rejected():
    """Bounds that a subclass adds or overrides cannot be proven."""
    wider = dataclasses.make_dataclass("Wider", [("max_foo", float, 1.0)], bases=(MotionLimits,), frozen=True)
    motion = Trajectory(straight(), from_rest_to_rest())
    for limits in (Lax(), wider()):
        with pytest.raises(InvalidValue, match=r"limits: must be a MotionLimits, got (Lax|Wider)"):
            certify_trajectory(motion, limits, SpeedZone())
        with pytest.raises(InvalidValue, match=r"robot\.limits: must be a MotionLimits, got (Lax|Wider)"):
            Robot(ROBOT.footprint, limits)


def test_cached_proofs_depend_on_the_current_values_of_limits():
    motion = Trajectory(straight(), from_rest_to_rest())
    written = MotionLimits()
    assert certify_trajectory(motion, written, SpeedZone()).certified
    assert not certify_trajectory(motion, MotionLimits(max_speed=0.1), SpeedZone()).certified
    object.__setattr__(written, "max_speed", 0.1)  # nobody should; a proof must not hide it
    assert not certify_trajectory(motion, written, SpeedZone()).certified


def test_an_incomplete_proof_is_not_reused_without_a_deadline():
    curve = ClothoidSpline(Pose2(0.0, -0.8, 0.0), np.array([0.0, 3.0]), np.array([0.4, -0.4]))
    path = Path((ClothoidSegment(curve),))
    task = problem(path, certify_path(path, problem(path)).min_clearance - 1e-4)
    assert not certify_path(path, task, is_late=lambda: True).certified
    assert certify_path(path, task, is_late=lambda: False).certified


def test_a_memo_distinguishes_objects_at_the_same_address():
    kept, known, stranger = Memo(), straight(), straight()
    kept.keep(known, "proven")
    kept._kept[id(stranger)] = kept._kept[id(known)]  # as if an address had been given out twice
    assert kept.recall(known) == "proven"
    assert kept.recall(stranger) is None
