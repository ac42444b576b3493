"""Without a problem: the costmap is all that is known, and the input says how far to keep away from it."""

import logging
import threading

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from optdock.errors import FailedToSmoothPath
from optdock.geometry.footprint import Footprint
from optdock.geometry.pose import Pose2, transform_points
from optdock.model.costmap import Costmap
from optdock.model.dock import Dock
from optdock.model.limits import MotionLimits
from optdock.model.path import Path
from optdock.model.problem import DockingProblem
from optdock.model.robot import Robot
from optdock.plugins.interfaces import PluginContext
from smoothers import casadi_smoother
from smoothers.casadi_smoother import CasadiSmoother
from smoothers.scp.qp_step import pool_of_this_thread

FOOTPRINT = Footprint.rectangle(0.4, 0.4, 0.5)
# The start looks up to the left: the result bulges there, away from the straight input.
RAW = Path.from_poses([Pose2(1.0, 2.0, 0.9), *(Pose2(x, 2.0, 0.0) for x in np.linspace(1.1, 5.0, 40))])


def smoother(costmap):
    made = CasadiSmoother(max_curvature=1.0, max_curvature_rate=4.0, kept_clearance=0.0)
    made.configure(PluginContext(costmap=costmap, footprint=FOOTPRINT))
    return made


def hall(blocked_from):
    data = np.zeros((120, 140), dtype=np.uint8)
    data[int(blocked_from / 0.05) :, 20:60] = 254
    return Costmap(data, 0.05)


def test_an_obstacle_outside_the_region_read_is_avoided(monkeypatch):
    bulge = smoother(hall(5.9)).smooth(RAW, 10.0).path.sample(0.02).y.max()
    assert bulge > 2.0 + FOOTPRINT.circumscribed_radius - 0.2  # blocking 0.2 m above it lies outside what is read
    monkeypatch.setattr(casadi_smoother, "_READ_AROUND", 0.0)
    with pytest.raises(FailedToSmoothPath, match="map"):
        smoother(hall(bulge + 0.2)).smooth(RAW, 10.0)
    assert smoother(hall(bulge + 0.8)).smooth(RAW, 10.0).completed


def test_a_result_is_covered_within_the_margin_only():
    near = Path.from_poses([Pose2(1.0, 2.0, 0.0), Pose2(5.0, 3.0, 0.0)])
    far = Path.from_poses([Pose2(1.0, 2.0, 0.0), Pose2(5.0, 3.6, 0.0)])
    assert casadi_smoother.covers(RAW, near)
    assert not casadi_smoother.covers(RAW, far)


def test_threads_do_not_share_programs():
    seen = []
    thread = threading.Thread(target=lambda: seen.append(pool_of_this_thread()))
    thread.start()
    thread.join()
    assert seen[0] is not pool_of_this_thread()
    assert pool_of_this_thread() is pool_of_this_thread()


def test_threads_may_smooth_at_once():
    alone = smoother(hall(5.9)).smooth(RAW, 10.0).path.length
    shared, lengths = smoother(hall(5.9)), []
    threads = [threading.Thread(target=lambda: lengths.append(shared.smooth(RAW, 10.0).path.length)) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert lengths == pytest.approx([alone] * 4, abs=1e-9)


CELL = 0.05  # [m]


def zigzag(rng):
    """A polyline of straight legs, driven forward, of 2 to 6 m."""
    corner, heading, poses = np.zeros(2), rng.uniform(-0.5, 0.5), []
    for _ in range(int(rng.integers(3, 6))):
        along, length = np.array([np.cos(heading), np.sin(heading)]), rng.uniform(0.6, 1.4)
        poses += [(*(corner + step * along), heading) for step in np.arange(0.0, length, 0.05)]
        corner, heading = corner + length * along, heading + rng.uniform(-0.7, 0.7)
    return np.array(poses)


def outlines(poses):
    """The footprint at every pose, for an independent measure of distances."""
    return shapely.polygons(transform_points(poses, FOOTPRINT.vertices))


def random_scene(rng):
    """A raw path, a costmap with blocks beside it, and these blocks."""
    poses = zigzag(rng)
    lower = np.floor((poses[:, :2].min(axis=0) - 2.0) / CELL) * CELL
    columns, rows = np.ceil((poses[:, :2].max(axis=0) + 2.0 - lower) / CELL).astype(int)
    data, blocks, swept = np.zeros((rows, columns), dtype=np.uint8), [], shapely.union_all(outlines(poses))
    gap = rng.choice([0.01, 0.1, 0.3])
    for _ in range(int(rng.integers(2, 10))):
        x, y, yaw = poses[rng.integers(len(poses))]
        beside = rng.choice([-1.0, 1.0]) * rng.uniform(0.3, 1.0)
        middle, size = np.array([x - beside * np.sin(yaw), y + beside * np.cos(yaw)]), rng.uniform(0.1, 0.6, 2)
        first, stop = (np.round((middle + sign * size / 2.0 - lower) / CELL).astype(int) for sign in (-1, 1))
        block = shapely.box(*(lower + CELL * first), *(lower + CELL * stop))
        if np.all(stop > first) and block.distance(swept) >= gap:
            data[first[1] : stop[1], first[0] : stop[0]] = 254
            blocks.append(block)
    return Path.from_poses(poses), Costmap(data, CELL, tuple(lower)), shapely.union_all(blocks)


def least_clearance(path, blocks):
    return float(shapely.distance(outlines(path.sample(0.002).poses), blocks).min())


@settings(max_examples=12)
@given(st.integers(0, 10_000))
def test_a_result_keeps_the_clearance_of_its_input(seed):
    raw, costmap, blocks = random_scene(np.random.default_rng(seed))
    plugin = CasadiSmoother(max_curvature=2.0, max_curvature_rate=8.0)
    plugin.configure(PluginContext(costmap=costmap, footprint=FOOTPRINT))
    try:
        result = plugin.smooth(raw, 30.0)
    except FailedToSmoothPath:  # a few: where the input turns most sharply nothing drivable keeps as much
        return
    assert result.report.warning == ""
    if not blocks.is_empty:
        kept, found = least_clearance(raw, blocks), least_clearance(result.path, blocks)
        assert found >= min(kept, plugin.parameters.kept_clearance) - 2e-6


def bend(**parameters):
    """A corridor of 1.7 m round a corner, a path along its middle, and a smoother."""
    data = np.full((120, 120), 254, dtype=np.uint8)
    data[20:54, 0:84] = data[20:120, 50:84] = 0
    east = [(x, 1.85, 0.0) for x in np.arange(1.0, 3.35, 0.05)]
    north = [(3.35, y, 0.5 * np.pi) for y in np.arange(1.85, 5.0, 0.05)]
    plugin = CasadiSmoother(**{"max_curvature": 2.0, "max_curvature_rate": 8.0, **parameters})
    plugin.configure(PluginContext(costmap=Costmap(data, CELL), footprint=FOOTPRINT))
    walls = shapely.box(-9.0, -9.0, 9.0, 9.0) - shapely.box(0.0, 1.0, 4.2, 2.7) - shapely.box(2.5, 1.0, 4.2, 6.0)
    return plugin, Path.from_poses([*east, *north]), walls


@pytest.mark.parametrize(
    ("parameters", "least"),
    [
        ({"kept_clearance": 0.0}, 0.0),  # nothing is asked for: it grazes the corner
        ({"kept_clearance": 0.1}, 0.1),
        ({}, 0.3),  # at most so much
        ({"kept_clearance": 0.5}, 0.37),  # what the input keeps where it turns
        ({"kept_clearance": 0.0, "clearance": 0.2}, 0.2),
        ({"kept_clearance": 0.1, "clearance": 0.2}, 0.2),
    ],
)
def test_the_larger_of_required_and_kept_clearance_counts(parameters, least):
    plugin, raw, walls = bend(**parameters)
    assert least_clearance(raw, walls) == pytest.approx(0.378, abs=0.01)
    assert least - 2e-6 <= least_clearance(plugin.smooth(raw, 30.0).path, walls) <= least + 0.03


def test_a_refusal_names_the_parameter_that_requires_the_clearance():
    plugin, raw, _ = bend(max_curvature=0.35)
    with pytest.raises(
        FailedToSmoothPath, match=r"0.3000 m are required, as much as the input keeps, up to kept_clearance = 0.3 m$"
    ):
        plugin.smooth(raw, 30.0)


def test_the_rule_permits_the_clearance_of_the_input_at_its_end():
    """A path that docks: it ends a centimetre before the wall, and keeps half a metre on the way."""
    data = np.zeros((60, 120), dtype=np.uint8)
    data[:, 100:] = 254
    plugin = CasadiSmoother(max_curvature=2.0, max_curvature_rate=8.0)
    plugin.configure(PluginContext(costmap=Costmap(data, CELL), footprint=FOOTPRINT))
    end = Pose2(5.0 - 0.4 - 0.01, 1.5, 0.0)
    raw = Path.from_poses([Pose2(1.5, 1.2, 0.3), Pose2(3.0, 1.6, 0.0), end])
    assert plugin.smooth(raw, 30.0).path.end.gap_to(end) < 1e-6


def test_without_known_obstacles_the_report_has_a_warning(caplog):
    plugin = CasadiSmoother()
    plugin.configure(PluginContext(name="alone", footprint=FOOTPRINT))
    with caplog.at_level(logging.WARNING, "optdock"):
        result = plugin.smooth(RAW, 30.0)
    said = "no obstacle is known: configure a costmap, or pass a problem; no clearance is kept"
    assert result.report.warning == said
    assert said in repr(result)
    assert [record.getMessage() for record in caplog.records] == [f"alone: {said}"]
    task = DockingProblem(RAW.start, Dock(RAW.end), Robot(FOOTPRINT, MotionLimits(max_curvature=2.5)))
    assert CasadiSmoother().smooth(RAW, 30.0, problem=task).report.warning == ""
