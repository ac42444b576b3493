"""Proofs in plan files: they are found where they exist, and given up at once where they do not."""

import json
import logging

import numpy as np
import pytest

from optdock.geometry.clothoid import ClothoidSpline
from optdock.geometry.footprint import Footprint
from optdock.geometry.pose import Pose2
from optdock.io import proof_cells
from optdock.io.path_columns import curves_of
from optdock.io.proof_cells import proof_of
from optdock.model.clearance_rule import ClearanceRule
from optdock.model.dock import Dock
from optdock.model.limits import MotionLimits
from optdock.model.path import ClothoidSegment, Path
from optdock.model.problem import DockingProblem
from optdock.model.robot import Robot
from optdock.verification import certify_path
from optdock.verification.judge import judge

U_SHAPE = Footprint(
    np.array([[0.4, 0.3], [-0.4, 0.3], [-0.4, -0.3], [0.4, -0.3], [0.4, -0.1], [0.1, -0.1], [0.1, 0.1], [0.4, 0.1]])
)
BOX = Footprint.rectangle(0.4, 0.4, 0.6)


def straight(footprint, obstacles, clearance=ClearanceRule(0.0, 0.0, 0.0)):
    """A straight path of 1 m and its problem, which is certified."""
    path = Path((ClothoidSegment(ClothoidSpline(Pose2(0.0, 0.0, 0.0), np.array([0.0, 1.0]), np.zeros(2))),))
    problem = DockingProblem(path.start, Dock(path.end), Robot(footprint, MotionLimits()), obstacles, clearance)
    assert certify_path(path, problem).certified
    return path, problem


def rectangle(low, high):
    return [[low[0], low[1]], [high[0], low[1]], [high[0], high[1]], [low[0], high[1]]]


@pytest.fixture
def evaluated(monkeypatch):
    """Numbers of cells of the rounds."""
    counts, original = [], proof_cells._Search._round

    def counted(self, cells):
        counts.append(cells.first.size)
        return original(self, cells)

    monkeypatch.setattr(proof_cells._Search, "_round", counted)
    return counts


@pytest.mark.parametrize("gap", [-4e-7, 0.0, 5e-10])
def test_a_fork_in_contact_along_a_rail_has_no_proof_and_is_given_up_at_once(evaluated, gap, caplog):
    """One prong slides in contact for 0.2 m; bisected to the last level, this path has millions of cells."""
    path, problem = straight(U_SHAPE, [rectangle((1.2, -0.1 + gap), (2.0, 0.05))])
    with caplog.at_level(logging.WARNING):
        assert proof_of(path, problem, 0.0) is None
    assert "not provable in cells" in caplog.text
    assert sum(evaluated) < 200


@pytest.mark.parametrize("gap", [-9e-7, 0.0, 5e-10, 1e-6])
def test_a_convex_robot_in_contact_has_a_proof(gap):
    path, problem = straight(BOX, [rectangle((-1.0, 0.3 + gap), (2.0, 0.5)), rectangle((1.4 + gap, -0.5), (2.0, 0.0))])
    found = proof_of(path, problem, 0.0)
    text = json.dumps({"path": {"segments": curves_of(path)}, "proof": found})
    assert judge(text).startswith("accepted: path among 2 obstacles")


@pytest.mark.parametrize("gap", [-9e-7, -1e-9, 0.0, 5e-10, 1e-6])
def test_a_robot_that_is_not_convex_has_a_proof_if_it_touches_with_its_hull(gap):
    path, problem = straight(
        U_SHAPE, [rectangle((-1.0, 0.3 + gap), (2.0, 0.5)), rectangle((1.4 + gap, -0.5), (2.0, 0.5))]
    )
    found = proof_of(path, problem, 0.0)
    text = json.dumps({"path": {"segments": curves_of(path)}, "proof": found})
    assert judge(text).startswith("accepted: path among 2 obstacles")


def test_a_robot_that_touches_a_post_between_its_prongs_has_no_proof(evaluated):
    post = rectangle((1.1 - 5e-7, -0.05), (1.15, 0.05))
    path, problem = straight(U_SHAPE, [post])
    assert proof_of(path, problem, 0.0) is None
    assert sum(evaluated) < 200
    path, problem = straight(U_SHAPE, [[[x + 1e-6, y] for x, y in post]])
    assert proof_of(path, problem, 0.0) is not None


def test_a_proof_of_too_many_cells_is_given_up(evaluated, monkeypatch):
    """In the first round, the last cell is not proven: the taper lets it require too much at its beginning."""
    path, problem = straight(BOX, [rectangle((1.4 + 1e-5, -0.5), (2.0, 0.5))], ClearanceRule(0.2, 0.0, 0.3))
    assert proof_of(path, problem, 0.0) is not None
    assert len(evaluated) > 1
    monkeypatch.setattr(proof_cells, "_MOST_OPEN", 0)
    assert proof_of(path, problem, 0.0) is None
