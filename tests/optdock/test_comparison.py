import csv
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from optdock.geometry.clothoid import ClothoidSpline
from optdock.geometry.pose import Pose2
from optdock.model.path import ClothoidSegment, Path
from optdock.reports.comparison import PathFigures, comparison_csv, comparison_table, worst_joint_angle


@given(st.floats(-3.0, 3.0), st.floats(0.1, 2.0))
def test_a_corner_is_as_sharp_as_its_steps_say(angle, length):
    rows = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.5 * angle]]
    rows.append([1.0 + length * math.cos(angle), length * math.sin(angle), angle])
    if abs(angle) < 2.0:  # beyond that the middle pose drives the last step backward
        assert worst_joint_angle(Path.from_poses(np.array(rows))) == pytest.approx(abs(angle), abs=1e-9)


def test_a_heading_that_ignores_the_first_step_is_a_joint():
    path = Path.from_poses(np.array([[0.0, 0.0, 0.4], [1.0, 0.0, 0.0], [2.0, 0.0, 0.0]]))
    assert worst_joint_angle(path) == pytest.approx(0.4)


def test_clothoids_have_no_joint_and_a_cusp_is_none():
    first = ClothoidSpline(Pose2(0.0, 0.0, 0.0), np.array([0.0, 1.0]), np.array([0.0, 2.0]))
    second = ClothoidSpline(first.end, np.array([0.0, 1.0]), np.array([0.0, 1.0]), -1)
    assert worst_joint_angle(Path((ClothoidSegment(first), ClothoidSegment(second)))) == 0.0


def test_gears_that_meet_at_an_angle_have_a_joint():
    first = ClothoidSpline(Pose2(0.0, 0.0, 0.0), np.array([0.0, 1.0]), np.zeros(2))
    second = ClothoidSpline(Pose2(1.0, 0.0, 0.3), np.array([0.0, 1.0]), np.zeros(2), -1)
    assert worst_joint_angle(Path((ClothoidSegment(first), ClothoidSegment(second)))) == pytest.approx(0.3)


def test_a_straight_reverse_path_has_no_joint():
    path = Path.from_poses(np.array([[0.0, 0.0, 1.0], [-math.cos(1.0), -math.sin(1.0), 1.0]]))
    assert worst_joint_angle(path) == pytest.approx(0.0, abs=1e-12)


def test_figures_become_rows_and_missing_ones_stay_empty():
    figures = [
        PathFigures("bay", "raw", "not certified", 3.25, 16.5, 35.5, -0.125, None),
        PathFigures("bay", "smoothed", "SmootherTimedOut"),
    ]
    rows = list(csv.DictReader(comparison_csv(figures).splitlines()))
    assert rows[0]["min_clearance_m"] == "-0.125"
    assert rows[0]["duration_s"] == rows[1]["length_m"] == ""
    lines = comparison_table(figures).splitlines()
    assert lines[1].split() == ["bay", "raw", "not", "certified", "3.25", "16.5", "35.5", "-0.125", "-"]
    assert lines[2].split() == ["bay", "smoothed", "SmootherTimedOut", "-", "-", "-", "-", "-"]
