"""Edits of a scene: what is grabbed, and where the parts are after a drag, a turn or a removal."""

import dataclasses
import math

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from optdock.config import demo_scenario, load_scenario
from optdock.errors import InvalidValue
from optdock.geometry.obstacles import ObstacleSet
from optdock.geometry.pose import Pose2
from optdock.model.limits import MotionLimits
from optdock.ui.edited_obstacle import EditedObstacle
from optdock.ui.scene_edits import BOX_SIDE, WALL_THICKNESS, EditedScene
from optdock.ui.scene_files import worked_scenes
from optdock.ui.scene_grips import Grip, part_named

SCENES = {file.stem: EditedScene(load_scenario(file)) for file in worked_scenes()}
BAY = SCENES["reverse_bay"]
DENTED = [[3.0, 0.0], [4.0, 0.0], [4.0, 1.0], [3.5, 0.5], [3.0, 1.0]]  # not convex
MIXED = BAY._with_obstacles((*BAY.obstacles, EditedObstacle.of(DENTED, 4)))
PARTS = [handle.name for handle in MIXED.handles]
BODIES = [name for name in PARTS if not name.endswith(".heading")]
places = st.integers(-4_000_000, 4_000_000).map(lambda micrometres: round(micrometres * 1e-6, 6))
points = st.tuples(places, places)


def shape_of(scene, name):
    """The part as it is drawn: the disc of a handle or a corner, or the outline of a body."""
    part, problem = part_named(name, scene.obstacles), scene.problem
    disc = next(handle for handle in scene.handles if handle.name == name)
    if part.is_heading or part.corner is not None:
        return shapely.Point(disc.x, disc.y).buffer(disc.radius)
    if part.owner == "obstacles":
        return shapely.Polygon(scene.polygons[part.row])
    pose = problem.start if name == "start" else problem.goal
    outlines = [problem.robot.footprint, *([problem.dock.footprint] if name == "dock" else [])]
    placed = [ObstacleSet.from_footprint(outline, pose, name).vertices for outline in outlines]
    return shapely.union_all(shapely.polygons(np.concatenate(placed)))


@settings(max_examples=20)
@given(st.lists(st.tuples(st.sampled_from(("move", "turn", "add", "remove")), st.integers(0, 5), points), max_size=5))
def test_edits_one_after_another_give_the_scene_of_the_polygons(edits):
    """Values that scenes share are those of a scene that is made anew from the polygons."""
    scene = MIXED
    for kind, row, (x, y) in edits:
        grip = scene.grip(f"obstacles[{row % len(scene.obstacles)}]")
        if kind == "move":
            scene = scene.nudged(grip, x, y)
        elif kind == "turn":
            scene = scene.turned(grip, x)
        elif kind == "add":
            scene = scene.added_box(x, y)
        elif len(scene.obstacles) > 1:
            scene = scene.removed(grip)
    anew = EditedScene(dataclasses.replace(scene.scenario, polygons=tuple(map(np.array, scene.polygons))))
    wanted = ObstacleSet.from_polygons(scene.polygons)
    assert scene.problem.obstacles.digest == wanted.digest
    assert scene.problem.obstacles.names == wanted.names
    for row, piece in enumerate(scene.problem.obstacles.vertices):
        whole = shapely.Polygon(scene.polygons[int(scene.problem.obstacles.group[row])])
        assert whole.buffer(1e-6).contains(shapely.Polygon(piece))
    assert anew.fingerprint == scene.fingerprint
    assert anew.handles == scene.handles


@settings(max_examples=20)
@given(st.sampled_from(PARTS), points)
def test_a_drag_that_ends_where_it_began_changes_nothing(name, place):
    grip = Grip(name, *place)
    assert MIXED.dragged(grip, place).fingerprint == MIXED.fingerprint
    assert MIXED.nudged(grip, 0.0, 0.0) is MIXED


@settings(max_examples=25)
@given(st.sampled_from(BODIES), points, points)
def test_a_drag_there_and_back_restores_the_scene(name, begin, end):
    try:
        there = MIXED.dragged(Grip(name, *begin), end)
    except InvalidValue:  # the corner would cross an edge
        return
    if name.split(".")[-1].startswith("corners"):
        # An obstacle that turned inside out has its corners in the other order.
        new = next(
            h.name
            for h in there.handles
            if ".corners" in h.name and math.dist((h.x, h.y), moved(name, begin, end)) < 1e-9
        )
        back = there.dragged(Grip(new, *end), begin)
        row = part_named(name, MIXED.obstacles).row
        assert {*map(tuple, back.polygons[row].tolist())} == {*map(tuple, MIXED.polygons[row].tolist())}
        return
    back = there.dragged(Grip(name, *end), begin)
    assert back.fingerprint == MIXED.fingerprint
    assert (there.fingerprint == MIXED.fingerprint) == (begin == end)


def moved(name, begin, end):
    part = part_named(name, MIXED.obstacles)
    x, y = MIXED.polygons[part.row][part.corner]
    return x + end[0] - begin[0], y + end[1] - begin[1]


@settings(max_examples=25)
@given(st.sampled_from(BODIES), points, st.lists(points, min_size=1, max_size=4))
def test_dragging_by_steps_equals_one_drag(name, begin, way):
    if ".corners" in name:
        return
    stepped = MIXED
    for first, then in zip([begin, *way], way, strict=False):
        stepped = stepped.dragged(Grip(name, *first), then)
    assert stepped.fingerprint == MIXED.dragged(Grip(name, *begin), way[-1]).fingerprint


def test_a_body_keeps_its_offset_from_the_pointer_and_a_station_moves_with_its_dock():
    grip = BAY.grip_at(0.2, -0.9, 0.0)
    assert grip == Grip("dock", 0.2, -0.9)
    dragged = BAY.dragged(grip, (1.2, 0.1))
    assert (dragged.problem.goal.x, dragged.problem.goal.y) == (1.0, 0.05)
    stations = [scene.problem.all_obstacles.vertices[-1] for scene in (BAY, dragged)]
    np.testing.assert_allclose(stations[1] - stations[0], np.full((4, 2), 1.0), atol=1e-12)
    assert dragged.problem.start == BAY.problem.start


@pytest.mark.parametrize("name", ["start", "start.heading", "dock", "dock.heading", "obstacles[1]", "obstacles[4]"])
@pytest.mark.parametrize("turns", [1.0, -1.0, 2.0])
def test_a_full_circle_restores_the_scene(name, turns):
    assert MIXED.turned(MIXED.grip(name), turns * 2.0 * math.pi).fingerprint == MIXED.fingerprint


@pytest.mark.parametrize("owner", ["start", "dock"])
@pytest.mark.parametrize("degrees", [5, 90, -30])
def test_a_full_circle_in_steps_restores_the_scene(owner, degrees):
    stepped = MIXED
    for _ in range(360 // abs(degrees)):
        stepped = stepped.turned(Grip(owner, 0.0, 0.0), math.radians(degrees))
    assert stepped.fingerprint == MIXED.fingerprint
    assert MIXED.turned(MIXED.grip(owner), math.radians(degrees)).fingerprint != MIXED.fingerprint


@pytest.mark.parametrize("owner", ["start", "dock"])
@settings(max_examples=20)
@given(st.floats(-math.pi, math.pi))
def test_a_turning_handle_follows_the_pointer(owner, angle):
    pose = MIXED.problem.start if owner == "start" else MIXED.problem.goal
    grip = MIXED.grip(f"{owner}.heading")
    turned = MIXED.dragged(grip, (pose.x + 3.0 * math.cos(angle), pose.y + 3.0 * math.sin(angle)))
    found = turned.problem.start if owner == "start" else turned.problem.goal
    assert (found.x, found.y) == (pose.x, pose.y)
    assert abs(math.remainder(found.yaw - angle, 2.0 * math.pi)) <= math.radians(1e-4)


def test_an_obstacle_turns_about_its_centroid():
    turned = MIXED.turned(MIXED.grip("obstacles[4]"), 0.5 * math.pi)
    first, then = (shapely.Polygon(scene.polygons[4]) for scene in (MIXED, turned))
    assert first.centroid.distance(then.centroid) < 2e-6
    assert then.area == pytest.approx(first.area, abs=1e-5)
    assert then.bounds[2] - then.bounds[0] == pytest.approx(first.bounds[3] - first.bounds[1], abs=4e-6)


@pytest.mark.parametrize("scene", [*SCENES.values(), MIXED], ids=[*SCENES, "mixed"])
def test_a_handle_is_grabbed_at_its_point_unless_a_smaller_part_covers_it(scene):
    order = [handle.name for handle in scene.handles]
    assert len(set(order)) == len(order) == 2 + sum(map(len, scene.polygons)) + 2 + len(scene.polygons)
    for handle in scene.handles:
        grip = scene.grip_at(handle.x, handle.y, 0.0)
        assert grip.name == handle.name or shape_of(scene, grip.name).distance(shapely.Point(handle.x, handle.y)) < 1e-9
        if grip.name != handle.name:
            assert order.index(grip.name) < order.index(handle.name)


@settings(max_examples=20)
@given(points, st.floats(0.0, 0.5))
def test_what_is_grabbed_is_drawn_there(place, reach):
    grip = MIXED.grip_at(*place, reach)
    distances = {name: shape_of(MIXED, name).distance(shapely.Point(place)) for name in PARTS}
    if grip is None:
        bodies = [name for name in BODIES if ".corners" not in name]
        assert min(distances[name] for name in bodies) > reach - 1e-9
    else:
        assert distances[grip.name] <= reach + 1e-3  # a disc is a polygon here


def test_a_coarse_pointer_still_grabs_bodies():
    finger = 0.4
    for name in ("start", "dock"):
        pose = BAY.problem.start if name == "start" else BAY.problem.goal
        assert BAY.grip_at(pose.x, pose.y, finger).name == name
    boxed = BAY.added_box(3.0, 1.0)
    assert boxed.grip_at(3.0, 1.0, finger).name == "obstacles[4]"
    assert boxed.grip_at(3.19, 1.19, finger).name.startswith("obstacles[4].corners")


def test_cells_of_a_costmap_cannot_be_grabbed():
    hall = EditedScene(load_scenario(demo_scenario()))
    grabbed = {hall.grip_at(x, y, 0.05) for x in np.arange(0.0, 8.0, 0.5) for y in np.arange(0.0, 5.0, 0.5)}
    assert {grip.name.partition(".")[0] for grip in grabbed if grip} <= {"start", "dock"}
    assert None in grabbed


def test_a_polygon_that_is_not_convex_is_edited_as_a_whole():
    assert len(MIXED.problem.obstacles) > len(MIXED.polygons) == 5
    dragged = MIXED.dragged(MIXED.grip("obstacles[4]"), MIXED.grip("obstacles[4]")[1:])
    assert dragged is MIXED
    nudged = MIXED.nudged(MIXED.grip("obstacles[4]"), 0.5, 0.0)
    np.testing.assert_allclose(nudged.polygons[4], np.add(DENTED, [0.5, 0.0]), atol=1e-12)
    # Without the polygons of the file only the pieces are known.
    pieces = EditedScene(dataclasses.replace(MIXED.scenario, polygons=None))
    assert len(pieces.polygons) == len(MIXED.problem.obstacles)
    # Polygons that do not belong to the problem are not used.
    other = EditedScene(dataclasses.replace(MIXED.scenario, polygons=BAY.polygons))
    assert len(other.polygons) == len(MIXED.problem.obstacles)


def test_an_invalid_edit_leaves_the_scene_as_it_was():
    before = MIXED.fingerprint
    grip = MIXED.grip("obstacles[0].corners[0]")
    with pytest.raises(InvalidValue, match=r"obstacles\[0\].*(cross|touch)"):
        MIXED.dragged(grip, (0.4, -0.8))
    with pytest.raises(InvalidValue, match="finite"):
        MIXED.dragged(MIXED.grip("start"), (math.nan, 0.0))
    with pytest.raises(InvalidValue, match="within"):
        MIXED.dragged(MIXED.grip("start"), (1e12, 0.0))
    with pytest.raises(InvalidValue, match="corner cannot be turned"):
        MIXED.turned(grip, 1.0)
    with pytest.raises(InvalidValue, match="cannot be removed"):
        MIXED.removed(MIXED.grip("dock.heading"))
    assert MIXED.fingerprint == before


@settings(max_examples=25)
@given(st.text() | st.sampled_from(["obstacles[9]", "obstacles[-1]", "obstacles[0].corners[7]", "dock.pose", "start "]))
def test_no_other_name_is_a_part(name):
    if name in PARTS:
        return
    for edit in (MIXED.removed, lambda grip: MIXED.dragged(grip, (1.0, 1.0)), lambda grip: MIXED.turned(grip, 1.0)):
        with pytest.raises(InvalidValue, match="has no part"):
            edit(Grip(name, 0.0, 0.0))


def test_boxes_and_walls_are_added_and_removed():
    boxed = BAY.added_box(1.0, 1.5)
    assert shapely.Polygon(boxed.polygons[-1]).equals(
        shapely.box(1.0 - BOX_SIDE / 2, 1.5 - BOX_SIDE / 2, 1.0 + BOX_SIDE / 2, 1.5 + BOX_SIDE / 2)
    )
    walled = boxed.added_wall(2.0, 0.0, 2.0, 1.5)
    assert shapely.Polygon(walled.polygons[-1]).area == pytest.approx(1.5 * WALL_THICKNESS)
    assert len({BAY.fingerprint, boxed.fingerprint, walled.fingerprint}) == 3
    assert walled.removed(walled.grip("obstacles[5]")).fingerprint == boxed.fingerprint
    assert (
        walled.removed(walled.grip("obstacles[4].corners[0]")).removed(Grip("obstacles[4]", 0, 0)).fingerprint
        == BAY.fingerprint
    )
    with pytest.raises(InvalidValue, match="wall: must be at least"):
        BAY.added_wall(1.0, 1.0, 1.0, 1.0)


def test_equal_scenes_have_equal_fingerprints():
    again = EditedScene(load_scenario(worked_scenes()[2]))
    assert again is not BAY
    assert again.fingerprint == BAY.fingerprint
    # A limit that is given with its default value is the same scene.
    assert BAY.problem.robot.limits.max_jerk == MotionLimits().max_jerk
    explicit = dataclasses.replace(BAY.scenario, default_limits=BAY.scenario.default_limits | {"max_jerk"})
    assert EditedScene(explicit).fingerprint == BAY.fingerprint
    zero = [BAY.with_problem(BAY.problem.starting_at(Pose2(z, 1.0, 0.0))).fingerprint for z in (0.0, -0.0)]
    assert zero[0] == zero[1] != BAY.fingerprint


def test_a_full_circle_restores_a_heading_that_is_not_rounded():
    start = BAY.problem.start
    scene = BAY.with_problem(BAY.problem.starting_at(Pose2(start.x, start.y, 0.123456789)))
    assert scene.turned(scene.grip("start"), 2.0 * math.pi).fingerprint == scene.fingerprint
    assert scene.turned(scene.grip("start"), 1e-3).turned(scene.grip("start"), -1e-3).fingerprint != scene.fingerprint


def test_of_overlapping_obstacles_the_last_one_is_grabbed():
    stacked = BAY.added_box(3.0, 1.0).added_box(3.1, 1.0)
    assert [stacked.grip_at(x, 1.0, 0.0).name for x in (2.85, 3.05, 3.2)] == [f"obstacles[{i}]" for i in (4, 5, 5)]


def test_the_reach_of_a_turning_handle_ends_outside_the_robot():
    front = BAY.problem.start @ Pose2(0.44, 0.0, 0.0)
    assert BAY.grip_at(front.x, front.y, 0.5).name == "start"
    ahead = BAY.problem.start @ Pose2(0.6, 0.0, 0.0)
    assert BAY.grip_at(ahead.x, ahead.y, 0.5).name == "start.heading"


def test_the_selected_part_comes_first():
    scene = BAY
    start = scene.problem.start
    scene = scene.added_box(start.x, start.y)
    box = f"obstacles[{len(scene.polygons) - 1}]"
    assert scene.grip_at(start.x, start.y, 0.01).name == "start"
    assert scene.grip_at(start.x, start.y, 0.01, box).name == box
    assert scene.grip_at(start.x, start.y, 0.01, "dock").name == "start"
