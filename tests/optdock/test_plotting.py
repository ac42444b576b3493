import dataclasses
import sys

import numpy as np
import pytest
from PIL import Image

from optdock.config import demo_scenario, load_scenario
from optdock.errors import (
    FailedToSmoothPath,
    GoalOccupied,
    GoalOutsideMapBounds,
    InvalidFile,
    InvalidValue,
    MissingExtra,
    NoValidPathCouldBeFound,
    SmootherTimedOut,
    StartOccupied,
)
from optdock.geometry.clothoid import ClothoidSpline
from optdock.geometry.footprint import Footprint
from optdock.geometry.obstacles import ObstacleSet
from optdock.geometry.pose import Pose2, transform_points
from optdock.model.camera import Camera
from optdock.model.constant_jerk import TimeLaw
from optdock.model.costmap import Costmap
from optdock.model.dock import Dock
from optdock.model.limits import MotionLimits, SpeedZone
from optdock.model.path import ClothoidSegment, Path
from optdock.model.problem import DockingProblem
from optdock.model.robot import Robot
from optdock.model.trajectory import Trajectory
from optdock.plotting import plan_picture, save_animation, save_plan_picture, save_profile_picture, save_run_picture
from optdock.plotting.canvas import COLOURS, canvas_of, entitle, legend_below, new_figure, save_figure
from optdock.plotting.marker_picture import draw_marker_array
from optdock.plotting.plan_picture import _draw_closest, refused_pose
from optdock.plotting.profile_picture import motion_panels
from optdock.plotting.scene import camera_cone, draw_scene, view_of
from optdock.ros import path_markers
from optdock.ros.bag import bag_types
from optdock.simulation import Run
from optdock.verification import certify_path


@pytest.fixture(scope="module")
def path():
    """Forward, a cusp, and back."""
    first = ClothoidSpline(Pose2(0.0, 0.0, 0.0), np.array([0.0, 0.5, 1.5]), np.array([0.0, 0.8, 0.8]))
    second = ClothoidSpline(first.end, np.array([0.0, 1.2]), np.array([-0.4, 0.0]), -1)
    return Path((ClothoidSegment(first), ClothoidSegment(second)))


@pytest.fixture(scope="module")
def problem(path):
    robot = Robot(Footprint.rectangle(0.4, 0.3, 0.5), MotionLimits(max_curvature=2.0))
    obstacles = ObstacleSet.from_polygons([[[1.2, -0.6], [2.0, -0.6], [2.0, -0.3], [1.2, -0.3]]])
    dock = Dock(path.end, Footprint.rectangle(-0.32, 0.5, 0.6))
    return DockingProblem(path.start, dock, robot, obstacles)


@pytest.fixture(scope="module")
def trajectory(path):
    phases = np.tile([0.5, -0.5, -0.5, 0.5], 2)
    quarter = np.repeat([(segment.length / 2.0 / 0.5) ** (1.0 / 3.0) for segment in path.segments], 4)
    return Trajectory(path, TimeLaw(quarter, phases))


@pytest.fixture(scope="module")
def run(trajectory, path):
    samples = trajectory.sample(0.05)
    poses = np.column_stack((samples.x, samples.y, samples.yaw))
    speeds = np.column_stack((samples.speed, samples.yaw_rate))
    return Run(samples.t, poses + np.array([0.0, 0.01, 0.0]), poses, speeds, speeds, poses, path.end, docked=True)


def colours_in(picture):
    """Colours of a picture with the number of their pixels."""
    with Image.open(picture) as image:
        found = image.convert("RGB").getcolors(2**24)
    return {"#" + bytes(colour).hex().upper(): count for count, colour in found}


def test_a_plan_picture_shows_everything_there_is(tmp_path, problem, path):
    raw = Path.from_poses(path.sample(0.2).poses)
    certificate = certify_path(path, problem)
    save_plan_picture(tmp_path / "p.png", problem, raw_path=raw, path=path, certificate=certificate, title="t")
    colours = colours_in(tmp_path / "p.png")
    for name in ("raw", "path", "reverse", "start", "goal", "hot", "dock", "obstacle"):
        assert colours.get(COLOURS[name], 0) > 20, name


def test_a_plan_picture_shows_what_a_failure_left(tmp_path, problem):
    """A dollar in its title is no formula."""
    save_plan_picture(tmp_path / "p.png", problem, title=r"a$b_$x^{ $\frac$")
    colours = colours_in(tmp_path / "p.png")
    assert colours.get(COLOURS["start"], 0) > 20
    assert COLOURS["path"] not in colours
    assert COLOURS["raw"] not in colours


REFUSALS = {
    "its pose": (FailedToSmoothPath("no", where={"pose": [0.5, 0.1, 0.2], "s": 1.0}), (0.5, 0.1)),
    "its point": (NoValidPathCouldBeFound("no", where={"x": 0.7, "y": -0.2}), (0.7, -0.2)),
    "its arc length": (FailedToSmoothPath("no", where={"s": 0.5}), (0.498, 1.6 * 0.5**3 / 6.0)),
    "an end of the map": (GoalOutsideMapBounds("no", where={"pose": [9.0, 9.0]}), "goal"),
    "the goal": (GoalOccupied("no", where={"obstacle": "dock"}), "goal"),
    "the start": (StartOccupied("no", where={"obstacle": "obstacles[0]"}), "start"),
}


@pytest.mark.parametrize("speaks_of", REFUSALS)
def test_a_refusal_is_marked_where_it_says(tmp_path, problem, path, speaks_of):
    refusal, place = REFUSALS[speaks_of]
    end = getattr(problem, place) if isinstance(place, str) else None
    found = refused_pose(problem, type(refusal).__name__, refusal.where, path)
    expected = (end.x, end.y) if end is not None else place
    assert (found.x, found.y) == pytest.approx(expected, abs=2e-3)
    if speaks_of == "the start":
        save_plan_picture(tmp_path / "p.png", problem, raw_path=path, refusal=refusal)
        assert colours_in(tmp_path / "p.png").get(COLOURS["hot"], 0) > 50


@pytest.mark.parametrize("where", [{}, {"iterations": 7}, {"obstacle": "obstacles[0]"}])
def test_a_refusal_that_speaks_of_no_place_marks_none(problem, path, where):
    assert refused_pose(problem, "SmootherTimedOut", where, path) is None


def test_a_time_out_has_no_mark_in_its_picture(tmp_path, problem, path):
    save_plan_picture(tmp_path / "p.png", problem, raw_path=path, refusal=SmootherTimedOut("no"))
    assert COLOURS["hot"] not in colours_in(tmp_path / "p.png")


def test_a_refused_path_is_drawn_in_its_gears_and_called_what_it_is(tmp_path, problem, path, monkeypatch):
    legends = []
    monkeypatch.setattr(
        plan_picture, "legend_below", lambda _, axes: legends.append(axes.get_legend_handles_labels()[1])
    )
    monkeypatch.setattr(plan_picture, "save_figure", lambda *_: None)
    refusal, refused = FailedToSmoothPath("no", where={"s": 1.0}), certify_path(path, problem.starting_at(path.end))
    for proof in (None, refused, certify_path(path, problem)):
        save_plan_picture(tmp_path / "p.png", problem, path=path, certificate=proof, refusal=refusal)
    save_plan_picture(tmp_path / "p.png", problem, path=path)
    best = {"best path found, not certified, forward", "best path found, not certified, reverse"}
    assert [best <= set(labels) for labels in legends] == [True, True, False, False]
    assert [{"path, forward", "path, reverse"} <= set(labels) for labels in legends] == [False, False, True, True]


def test_a_refused_pose_far_from_every_path_is_in_the_picture(tmp_path, problem, path):
    refusal = FailedToSmoothPath("no", where={"pose": [-9.0, 7.0, 0.0]})
    save_plan_picture(tmp_path / "p.png", problem, raw_path=path, refusal=refusal)
    assert colours_in(tmp_path / "p.png").get(COLOURS["hot"], 0) > 20


def test_the_closest_pose_is_the_one_of_the_certificate(problem, path):
    certificate = certify_path(path, problem)
    axes = new_figure(5.0, 5.0).add_subplot()
    _draw_closest(axes, problem, path, certificate)
    (mark,) = axes.get_lines()
    pose = path.pose_at(certificate.at_s)
    assert mark.get_xydata()[0] == pytest.approx([pose.x, pose.y])
    said = f"closest: {1e3 * certificate.min_clearance:.0f} mm to {certificate.nearest}"
    assert axes.get_legend_handles_labels()[1] == [said]


def test_the_view_holds_the_whole_robot_and_axes_are_equal_in_metres(problem, path):
    view = view_of(problem, [path.sample(0.02).poses])
    assert view.left < -0.3
    assert view.right > path.sample(0.02).x.max() + 0.3
    figure = new_figure(*view.figure_size())
    axes = figure.add_subplot()
    draw_scene(axes, problem, view)
    canvas_of(figure).draw()
    to_pixels = axes.transData.transform
    origin, along, across = to_pixels([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    assert along[0] - origin[0] == pytest.approx(across[1] - origin[1], rel=1e-9)
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("x [m]", "y [m]")


def test_the_map_is_drawn_where_its_cells_are(tmp_path):
    problem = load_scenario(demo_scenario()).problem
    view = view_of(problem, [])
    figure = new_figure(*view.figure_size())
    axes = figure.add_subplot()
    draw_scene(axes, problem, view)
    (image,) = axes.get_images()
    assert image.get_extent() == [0.0, 8.0, 0.0, 5.0]
    grey = image.get_array()
    # The shelf of the built-in hall stands at x 2.7 to 4.1 m, y 2.7 to 4.9 m.
    assert grey[round(3.5 / 0.05), round(3.4 / 0.05)] < 100
    assert grey[round(2.0 / 0.05), round(3.4 / 0.05)] == 255


def test_every_panel_of_a_profile_holds_its_quantity_and_limit(trajectory):
    limits = MotionLimits(
        max_yaw_rate=0.4, max_yaw_acceleration=3.0, max_lateral_acceleration=0.2, max_wheel_speed=0.5, track_width=0.4,
        max_lateral_jerk=0.3,
    )  # fmt: skip
    times = np.linspace(0.0, trajectory.duration, 400)
    panels = {
        panel.label.split(" [")[0]: panel for panel in motion_panels(trajectory, limits, SpeedZone(0.1, 0.2), times)
    }
    always = ["speed", "acceleration", "jerk", "curvature", "yaw rate", "yaw acceleration"]
    assert list(panels) == [*always, "lateral acceleration", "wheel speed", "lateral jerk"]
    samples = trajectory.sample_at(times)
    fine = trajectory.sample_at(np.repeat(times, 2) + np.tile([-1e-6, 1e-6], times.size))
    sideways = (np.abs(fine.speed) * fine.yaw_rate).reshape(-1, 2)
    change = np.abs(np.diff(sideways, axis=1)[:, 0]) / np.diff(fine.t.reshape(-1, 2), axis=1)[:, 0]
    assert np.mean(np.abs(panels["lateral jerk"].values - change) < 1e-4) > 0.97  # all but jumps of the curvature rate
    np.testing.assert_allclose(panels["lateral acceleration"].values, np.abs(samples.speed * samples.yaw_rate))
    np.testing.assert_allclose(panels["wheel speed"].values, np.abs(samples.speed) + 0.2 * np.abs(samples.yaw_rate))
    np.testing.assert_array_equal(panels["speed"].values, samples.speed)
    bend = np.abs(trajectory.path.curvature_at(samples.s))
    forward = trajectory.path.direction_at(samples.s) > 0
    bound = np.where(forward, panels["speed"].upper, -panels["speed"].lower)
    # Whoever drives at the drawn bound keeps every limit, and meets one of them.
    ratios = np.array(
        [
            bound / np.where(forward, limits.max_speed, limits.max_reverse_speed),
            bound * bend / limits.max_yaw_rate,
            bound**2 * bend / limits.max_lateral_acceleration,
            bound * (1.0 + 0.2 * bend) / limits.max_wheel_speed,
            np.where(samples.s > trajectory.path.length - 0.2, bound / 0.1, 0.0),
        ]
    )
    np.testing.assert_allclose(ratios.max(axis=0), 1.0, rtol=1e-9)
    reverse = ~forward
    assert set(panels["acceleration"].upper[forward]) == {limits.max_acceleration}
    assert set(panels["acceleration"].upper[reverse]) == {limits.max_deceleration}


def test_a_profile_picture_is_drawn(tmp_path, trajectory):
    limits = MotionLimits(max_curvature=1.0, max_lateral_acceleration=0.2)
    save_profile_picture(tmp_path / "v.png", trajectory, limits, SpeedZone(), title="t")
    colours = colours_in(tmp_path / "v.png")
    assert colours.get(COLOURS["path"], 0) > 500
    assert colours.get(COLOURS["goal"], 0) > 200


def test_a_run_picture_is_drawn(tmp_path, problem, run):
    save_run_picture(tmp_path / "r.png", problem, run, title="t")
    colours = colours_in(tmp_path / "r.png")
    for name in ("path", "goal", "start", "dock"):
        assert colours.get(COLOURS[name], 0) > 20, name


def test_an_animation_moves_the_robot_from_start_to_end(tmp_path, problem, run):
    done = []
    save_animation(tmp_path / "a.gif", problem, 0.1 * run.times, run.poses, lambda i, n: done.append((i, n)))
    with Image.open(tmp_path / "a.gif") as animation:
        frames = animation.n_frames
        pictures = []
        for i in (0, frames // 2, frames - 1):
            animation.seek(i)
            pictures.append(np.asarray(animation.convert("RGB")).astype(int))
    assert done == [(i + 1, frames) for i in range(frames)]
    blue = [int(COLOURS["robot"][i : i + 2], 16) for i in (1, 3, 5)]
    centres = []
    for picture in pictures:
        rows, columns = np.nonzero(np.abs(picture - blue).sum(axis=2) < 60)
        assert rows.size > 500
        centres.append((columns.mean(), rows.mean()))
    assert centres[1][0] - centres[0][0] > 20
    assert abs(centres[2][0] - centres[1][0]) > 20


@pytest.mark.parametrize("suffix", ["png", "svg", "pdf"])
def test_the_suffix_chooses_the_format(tmp_path, suffix):
    figure = new_figure(2.0, 2.0)
    save_figure(figure, tmp_path / f"p.{suffix}")
    head = (tmp_path / f"p.{suffix}").read_bytes()[:5]
    assert head.startswith({"png": b"\x89PNG", "svg": b"<?xml", "pdf": b"%PDF-"}[suffix])
    assert [path.name for path in tmp_path.iterdir()] == [f"p.{suffix}"]


def test_a_suffix_that_names_no_picture_is_refused(tmp_path):
    with pytest.raises(InvalidValue, match=r"p\.xyz: must end in one of .*png.*, got \.xyz"):
        save_figure(new_figure(2.0, 2.0), tmp_path / "p.xyz")
    assert list(tmp_path.iterdir()) == []


def test_a_picture_that_cannot_be_written_is_a_named_error(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(InvalidFile, match="cannot be written"):
        save_figure(new_figure(2.0, 2.0), tmp_path / "file" / "p.png")


def test_without_matplotlib_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    with pytest.raises(MissingExtra, match=r"pictures need matplotlib: pip install 'optdock\[plot\]'"):
        new_figure(2.0, 2.0)


def texts_beyond(figure):
    """Labels of legends and titles that the figure's edge cuts."""
    canvas_of(figure).draw()
    written = [figure._suptitle, *(text for legend in figure.legends for text in legend.get_texts())]
    frame = figure.bbox
    return [
        text.get_text()
        for text in written
        if (box := text.get_window_extent()).x0 < frame.x0 or box.x1 > frame.x1 or box.y1 > frame.y1
    ]


@pytest.mark.parametrize("width", [3.0, 9.0])
@pytest.mark.parametrize(
    "title", ["short", "a_scenario_with_a_name_of_one_long_word_" * 4, "FailedToSmoothPath: clearance missing, " * 5]
)
def test_titles_and_legends_stay_inside_every_figure(width, title):
    figure = new_figure(width, 6.0)
    axes = figure.add_subplot()
    for i in range(8):
        axes.plot([0, 1], [0, i], label=f"closest on the way: {i} mm")
    legend_below(figure, axes)
    entitle(figure, title)
    assert texts_beyond(figure) == []


def test_the_view_holds_what_stands_close_by_but_no_more_of_a_long_wall(problem, path):
    drawn = [path.sample(0.02).poses]
    seen = view_of(problem, drawn)
    top = max(problem.robot.footprint.vertices[:, 1].max() + path.sample(0.02).y.max(), 0.0)
    pallet = [[0.0, top + 0.9], [1.0, top + 0.9], [1.0, top + 1.3], [0.0, top + 1.3]]
    wall = [[-50.0, top + 0.9], [50.0, top + 0.9], [50.0, top + 1.3], [-50.0, top + 1.3]]
    far = [[0.0, top + 9.0], [1.0, top + 9.0], [1.0, top + 9.4], [0.0, top + 9.4]]
    views = {
        name: view_of(dataclasses.replace(problem, obstacles=ObstacleSet.from_polygons([polygon])), drawn)
        for name, polygon in (("pallet", pallet), ("wall", wall), ("far", far))
    }
    assert views["pallet"].top > top + 1.3
    assert views["wall"].top > top + 1.3
    assert views["wall"].right - views["wall"].left < seen.right - seen.left + 3.0
    assert views["far"].top < top + 3.0


def test_a_raw_path_that_overlaps_an_obstacle_is_drawn_so(tmp_path, problem, path):
    save_plan_picture(tmp_path / "free.png", problem, raw_path=path)
    poses = path.poses_at(np.linspace(0.0, path.length, 3))
    x, y = poses[1, :2]
    wall = ObstacleSet.from_polygons([[(x, y), (x + 0.05, y), (x + 0.05, y + 0.05), (x, y + 0.05)]])
    save_plan_picture(tmp_path / "hit.png", dataclasses.replace(problem, obstacles=wall), raw_path=path)
    free, hit = (colours_in(tmp_path / name).get(COLOURS["hot"], 0) for name in ("free.png", "hit.png"))
    assert hit > free + 200


def test_raw_and_smoothed_path_are_both_seen_where_they_coincide(tmp_path, problem, path):
    save_plan_picture(tmp_path / "p.png", problem, raw_path=path, path=path)
    colours = colours_in(tmp_path / "p.png")
    legend = 200  # pixels of a line there, at most
    assert colours[COLOURS["raw"]] > legend
    assert colours[COLOURS["path"]] > legend


@pytest.mark.parametrize(
    ("unknown", "beyond", "label"),
    [
        (True, False, "map, unknown"),
        (False, True, "beyond the map"),
        (True, True, "unknown or beyond the map"),
        (False, False, None),
    ],
)
def test_the_legend_says_what_the_bright_grey_is(problem, unknown, beyond, label):
    view = view_of(problem, [])
    cells = np.zeros((400, 400), dtype=np.uint8)
    if unknown:
        row, column = round((view.bottom + 10.0) / 0.1), round((view.left + 10.0) / 0.1)
        cells[row + 3 : row + 5, column + 3 : column + 5] = 255
    known = Costmap(cells, 0.1, (-10.0, -10.0))
    axes = new_figure(5.0, 5.0).add_subplot()
    draw_scene(axes, dataclasses.replace(problem, costmap=known), view._replace(left=-11.0) if beyond else view)
    named = [said for said in axes.get_legend_handles_labels()[1] if "map" in said]
    assert named == ([] if label is None else [label])


def test_the_legend_names_the_greys_of_the_map_that_are_in_view():
    problem = load_scenario(demo_scenario()).problem
    labels = []
    for goal_side in (0.0, 1e3):
        axes = new_figure(5.0, 5.0).add_subplot()
        view = view_of(problem, [])
        draw_scene(axes, problem, view._replace(left=view.left - goal_side, right=view.right - goal_side))
        labels.append(axes.get_legend_handles_labels()[1])
    assert "map, occupied" in labels[0]
    assert not any(label.startswith("map") for label in labels[1])


def test_the_picture_shows_the_marker_and_what_the_camera_sees(tmp_path, problem, path):
    save_plan_picture(tmp_path / "plain.png", problem, path=path)
    for field in (0.6, 2.0 * np.pi):
        camera = Camera(Pose2(-0.3, 0.0, np.pi), field, 0.1, 2.0)
        robot = dataclasses.replace(problem.robot, camera=camera)
        dock = dataclasses.replace(problem.dock, marker=(-0.6, 0.0), visible_distance=0.8, blind_distance=0.1)
        seen = dataclasses.replace(problem, robot=robot, dock=dock)
        save_plan_picture(tmp_path / f"seen{field:.1f}.png", seen, path=path, certificate=certify_path(path, seen))
        if field < 1.0:
            refusal = FailedToSmoothPath("view: lost", where={"reason": "view", "s": 2.0, "pose": [0.5, 0.5, 0.0]})
            save_plan_picture(tmp_path / "lost.png", seen, path=path, refusal=refusal)
    files = list(tmp_path.iterdir())
    assert len({file.read_bytes() for file in files}) == len(files)


def test_a_cone_is_drawn_with_the_marker_inside_exactly_where_it_is_seen(path, problem):
    from shapely import Point, Polygon

    camera = Camera(Pose2(0.2, 0.1, 0.3), 1.2, 0.2, 1.5)
    robot = dataclasses.replace(problem.robot, camera=camera)
    dock = dataclasses.replace(problem.dock, marker=(0.3, 0.4), visible_distance=1.0)
    view = dataclasses.replace(problem, robot=robot, dock=dock).required_view
    rng, seen = np.random.default_rng(2), 0
    for _ in range(200):
        pose = np.array([*(view.marker + rng.uniform(-1.5, 1.5, 2)), rng.uniform(-3.0, 3.0)])
        margin = float(view.margins(pose[None]).smallest[0])
        if abs(margin) > 2e-3:  # arcs are drawn as polygons
            assert Polygon(camera_cone(view, pose)).contains(Point(view.marker)) == (margin > 0.0)
            seen += margin > 0.0
    assert seen > 10


def test_markers_are_drawn_in_the_frame_of_the_axes_with_a_label_for_each_namespace(problem, path):
    kept = {"footprint": problem.robot.footprint, "obstacles": problem.all_obstacles}
    drawn = path_markers(bag_types, path, "map", 0.0, certificate=certify_path(path, problem), **kept)
    frame, ends = Pose2(3.0, -1.0, 0.5 * np.pi), []
    for pose in (Pose2(0.0, 0.0, 0.0), frame):
        axes = new_figure(4.0, 4.0).add_subplot()
        draw_marker_array(axes, drawn, pose)
        assert set(axes.get_legend_handles_labels()[1]) == {"path", "swept footprint", "goal", "closest"}
        (line,) = (one for one in axes.collections if one.get_label() == "path")
        (arrow,) = (one for one in axes.texts if not one.get_text())
        ends.append(np.array([line.get_segments()[-1][1], arrow.xyann, arrow.xy]))
    assert ends[0][:2] == pytest.approx(np.tile(path.end.as_array()[:2], (2, 1)))
    assert ends[1] == pytest.approx(transform_points(frame.as_array()[None], ends[0])[0])
