"""Moves that may end a refusal: the stated reason does not hold after them, and does after less."""

import math

import numpy as np
import pytest

from optdock.errors import OptdockError
from optdock.ui.drawn_plan import drawn_plan
from optdock.ui.mends import Mend, mend_of
from optdock.ui.scene_files import open_scene, worked_scenes
from optdock.verification import end_clearances


def worked(stem):
    (path,) = (path for path in worked_scenes() if path.stem == stem)
    return open_scene(path.name, path.parent)


def answer(scene):
    try:
        result = scene.scenario.plan(2.0)
    except OptdockError as error:
        result = error
    return drawn_plan((1, ""), scene.problem, result)


def mended(scene, mend):
    return scene.nudged(scene.grip(mend.part), mend.dx, mend.dy)


@pytest.mark.parametrize(("part", "moved"), [("start", (0.1, 1.5)), ("start", (1.2, -1.3)), ("dock", (0.2, 0.0))])
def test_an_end_in_an_obstacle_is_moved_to_the_nearest_free_place(part, moved):
    scene = worked("reverse_bay")
    scene = scene.nudged(scene.grip(part), *moved)
    drawn = answer(scene)
    assert drawn.error == {"start": "StartOccupied", "dock": "GoalOccupied"}[part]
    mend = mend_of(drawn, scene.problem)
    assert mend is not None
    assert mend.part == part

    def clearance(dx, dy):
        ends = end_clearances(scene.nudged(scene.grip(part), dx, dy).problem)
        return ends.start if part == "start" else ends.goal

    required = scene.problem.clearance.required if part == "start" else scene.problem.clearance.at_dock
    assert clearance(mend.dx, mend.dy) >= required
    length = math.hypot(mend.dx, mend.dy) - 0.02  # rounding of diagonal moves, and the step
    angles = np.arange(8) * math.pi / 4
    assert all(clearance(length * math.cos(angle), length * math.sin(angle)) < required for angle in angles)


def test_a_gap_is_widened_by_what_is_missing():
    scene = worked("no_way")
    mend = mend_of(answer(scene), scene.problem)
    assert mend is not None
    assert mend.part in ("obstacles[4]", "obstacles[5]")
    assert mend.dx == 0.0
    assert mend.dy == {"obstacles[4]": -0.05, "obstacles[5]": 0.05}[mend.part]
    assert answer(mended(scene, mend)).outcome == "certified"
    back = answer(mended(scene, mend._replace(dy=-mend.dy)))
    assert back.outcome == "impossible"


def test_a_certified_motion_and_a_deep_overlap_have_no_mend():
    scene = worked("reverse_bay")
    assert mend_of(answer(scene), scene.problem) is None
    x, y = scene.problem.start.x, scene.problem.start.y
    walled = scene.added_wall(x - 3.0, y, x + 3.0, y)
    for side in (-0.5, 0.5, -1.0, 1.0):
        walled = walled.added_wall(x - 3.0, y + side, x + 3.0, y + side)
    drawn = answer(walled)
    assert drawn.error == "StartOccupied"
    assert mend_of(drawn, walled.problem) is None


def test_moves_are_stated_along_the_axes_of_the_figure():
    assert str(Mend("start", 0.0, 0.13)) == "Try: move start 0.13 m up."
    assert str(Mend("obstacles[3]", -0.04, -0.2)) == "Try: move obstacles[3] 0.04 m left and 0.20 m down."
