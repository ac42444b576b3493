"""Plugins cannot modify frozen values: no array of a frozen value or of its copies can be made writable."""

import copy
import dataclasses
import functools
import importlib
import inspect
import pickle
import pkgutil
from enum import Enum
from pathlib import Path as FilePath
from types import MappingProxyType, ModuleType

import numpy as np
import pytest

import checkers
import optdock
import smoothers
from optdock.controllers.motion_table import motion_table
from optdock.geometry import nurbs
from optdock.geometry.arrays import FrozenArrays, readonly
from optdock.geometry.clothoid import ClothoidSpline
from optdock.geometry.footprint import Footprint
from optdock.geometry.nurbs import Nurbs
from optdock.geometry.obstacles import ObstacleSet
from optdock.geometry.pose import Pose2
from optdock.impossibility import connectivity_graph, footprint_discs, prove_impossible
from optdock.model.cell_obstacles import mapped_obstacles
from optdock.model.constant_jerk import TimeLaw
from optdock.model.costmap import Costmap, OccupancyGrid
from optdock.model.dock import Dock
from optdock.model.limits import MotionLimits
from optdock.model.path import ClothoidSegment, Path, PolylineSegment, TurnSegment
from optdock.model.problem import DockingProblem
from optdock.model.robot import Robot
from optdock.model.trajectory import Trajectory
from optdock.planners.manoeuvres import free_space
from optdock.planners.two_segment import DockGeometry, DockPlannerParameters, plan_two_segment
from optdock.samples.tube import Tube
from optdock.simulation.closed_loop import Run
from optdock.simulation.world import Record
from optdock.ui import drawn_plan, scene_files, scene_maps
from optdock.ui.edited_obstacle import EditedObstacle
from optdock.verification import proximity
from optdock.verification.clearance_kernel import packed_footprint
from smoothers.scp import basis as basis_module
from smoothers.scp import nlp, qp_step, term_rows
from smoothers.scp.basis import basis_for
from smoothers.scp.collision import collision_scene, narrow_phase
from smoothers.scp.settings import DEFAULT_SETTINGS

POSE = Pose2(0.0, 0.0, 0.0)
SQUARE = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]
POSES = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [2.0, 0.1, 0.1]]
DENTED = [*SQUARE, [0.2, 0.5]]  # not convex: several bodies


def motion():
    return Trajectory(Path.from_poses(POSES), TimeLaw([4.0, 4.0], [0.1, -0.1]))


def on_a_curve():
    curve = ClothoidSpline(POSE, [0.0, 1.6], [0.0, 0.2], 1)
    return Trajectory(Path((ClothoidSegment(curve),)), TimeLaw([4.0, 4.0], [0.1, -0.1]))


def problem():
    grid = Costmap(np.array([[0, 254, 0], [0, 0, 255]]), 0.5, (-3.0, -3.0))
    dock = Dock(Pose2(3.0, 0.0, 0.0), Footprint.rectangle(0.8, -0.6, 0.5))
    robot = Robot(Footprint(np.array(DENTED) - 0.5), MotionLimits())
    return DockingProblem(Pose2(-1.0, 0.0, 0.0), dock, robot, [[[0.0, 4.0], [1.0, 4.0], [0.5, 5.0]]], costmap=grid)


def shut_in():
    bars = [[(-3, -3), (3, -3), (3, -2)], [(-3, 3), (3, 3), (3, 2)], [(-3, -3), (-3, 3), (-2, 3)]]
    robot = Robot(Footprint.rectangle(0.3, 0.3, 0.4), MotionLimits())
    wall = [(1.0, -3.0), (1.2, -3.0), (1.2, 3.0), (1.0, 3.0)]
    return prove_impossible(DockingProblem(POSE, Dock(Pose2(2.0, 0.0, 0.0)), robot, [*bars, wall]), time_budget=5.0)


def two_segments():
    geometry = DockGeometry(0.5, 0.4, 0.5)
    return plan_two_segment(Pose2(-3.0, 0.5, 0.0), POSE, geometry, DockPlannerParameters())


def frozen_values():
    """Return one value of every class that holds arrays, with the arrays of the caller that it was made from."""
    square, poses = np.array(SQUARE), np.array(POSES)
    knots, curvature = np.array([0.0, 1.0]), np.array([0.0, 0.5])
    vertices, group = np.array([SQUARE, SQUARE]), np.array([0, 0])
    spline = ClothoidSpline(POSE, knots, curvature)
    durations, jerks = np.array([1.0, 1.0]), np.array([1.0, -1.0])
    costs, occupancy = np.zeros((2, 2), dtype=np.uint8), np.zeros((2, 2), dtype=np.int8)
    points = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]])
    whole = ObstacleSet(vertices, ("rock",), group)
    times, three, two = np.array([0.0, 0.1]), np.zeros((2, 3)), np.zeros((2, 2))
    heard = np.zeros(2, dtype=np.bool_)
    return [
        (Footprint(square), [square]),
        (Footprint(np.array(DENTED)), []),
        (Footprint.from_radius(0.3), []),
        (whole, [vertices, group]),
        (whole + ObstacleSet.from_polygons([[[0, 0], [1, 0], [0, 1]]]), []),
        (whole.subset(np.array([1])), []),
        (whole.subset(slice(0, 1)), []),
        (ObstacleSet.from_rectangles(np.zeros((1, 2)), np.ones((1, 2)), "box"), []),
        (ObstacleSet.from_footprint(Footprint(square), POSE, "dock"), []),
        (PolylineSegment(poses), [poses]),
        (TurnSegment(POSE, 1.0), []),
        (spline, [knots, curvature]),
        (ClothoidSegment(spline), []),
        (Path((ClothoidSegment(spline), TurnSegment(spline.end, 1.0))), []),
        (TimeLaw(durations, jerks), [durations, jerks]),
        (motion(), []),
        (problem(), []),
        (Costmap(costs, 0.1), [costs]),
        (OccupancyGrid(occupancy, 0.1), [occupancy]),
        (Nurbs(points), [points]),
        (two_segments().axis, []),
        (shut_in(), []),
        (Run(times, three, three, two, two, three, POSE, docked=True), [times, three, two]),
        (Record(times, three, three, two, three, two, three, heard, (), times), [times, three, two, heard]),
        (basis_for(((8, 2),)), []),
        (EditedObstacle(points), [points]),
    ]


VALUES = range(26)


all_frozen_values = functools.cache(frozen_values)


def made(which):
    return all_frozen_values()[which]


def arrays_of(value, seen=None):
    """Return every array that is reachable from a value by attributes and items, cached properties included."""
    seen = {} if seen is None else seen
    if id(value) in seen or isinstance(value, Enum | type | ModuleType):
        return []
    seen[id(value)] = value
    if isinstance(value, np.ndarray):
        return [value]
    if isinstance(value, tuple | list | set | frozenset):
        return [array for part in value for array in arrays_of(part, seen)]
    if isinstance(value, dict | MappingProxyType):
        return [array for part in value.values() for array in arrays_of(part, seen)]
    if not type(value).__module__.startswith(("optdock", "smoothers", "checkers")):
        return []
    for kind in type(value).__mro__:
        lazy = [name for name, one in vars(kind).items() if isinstance(one, functools.cached_property)]
        for name in lazy:
            getattr(value, name)
    slots = [name for kind in type(value).__mro__ for name in getattr(kind, "__slots__", ())]
    parts = [*getattr(value, "__dict__", {}).values(), *(getattr(value, name, None) for name in slots)]
    return [array for part in parts for array in arrays_of(part, seen)]


def thawed(array):
    """Return the ways in which this array, or a view of it, could be written to."""
    views = {
        "itself": lambda: array,
        "its base": lambda: array.base,
        "a view": array.view,
        "transposed": lambda: array.T,
        "a part": lambda: array[...],
        "strides": lambda: np.lib.stride_tricks.as_strided(array, writeable=True),
        "its buffer": lambda: np.asarray(memoryview(array)),
        "other class": lambda: array.view(np.matrix) if array.ndim == 2 else array.view(np.recarray),
    }
    found = []
    for name, view in views.items():
        try:
            one = view()
            if isinstance(one, bytes):
                continue
            one.setflags(write=True)
        except ValueError:
            continue
        found.append(name)
    return found


@pytest.mark.parametrize("which", VALUES)
def test_no_array_of_a_frozen_value_can_be_made_writable(which):
    value, given = made(which)
    arrays = arrays_of(value)
    assert arrays
    for array in arrays:
        assert thawed(array) == []
        assert not any(np.shares_memory(array, one) for one in given)


@pytest.mark.parametrize("again", [copy.copy, copy.deepcopy, lambda value: pickle.loads(pickle.dumps(value))])
@pytest.mark.parametrize("which", VALUES)
def test_copies_of_a_frozen_value_are_frozen(which, again):
    value, _ = made(which)
    wanted = arrays_of(value)  # with what is computed at first use
    found = arrays_of(again(value))
    assert len(found) == len(wanted) > 0
    for array, original in zip(found, wanted, strict=True):
        assert np.array_equal(array, original, equal_nan=array.dtype.kind == "f")
        assert thawed(array) == []


@functools.cache
def modules():
    roots = (optdock, smoothers, checkers)
    return [
        importlib.import_module(found.name)
        for root in roots
        for found in pkgutil.walk_packages(root.__path__, f"{root.__name__}.")
        if not found.name.endswith("__main__")
    ]


# Made and dropped within one call of a solver; nobody else is handed one.
OF_ONE_CALL = {
    "VariableBounds",
    "CostModel",
    "Ends",
    "ViewBound",
    "NonlinearProgram",
    "PathLimits",
    "ReferenceBounds",
    "Scene",
    "TermBound",
    "LeastSquares",
}


def test_every_frozen_class_with_arrays_is_listed():
    kinds = {
        kind
        for module in modules()
        for kind in vars(module).values()
        if dataclasses.is_dataclass(kind) and inspect.isclass(kind) and kind.__dataclass_params__.frozen
    }
    holding = {k for k in kinds if any("Array" in str(spec.type) for spec in dataclasses.fields(k))}
    holding = {k for k in holding if k.__name__ not in OF_ONE_CALL}
    frozen = {k for k in kinds if issubclass(k, FrozenArrays)}
    assert holding - frozen == {Costmap}  # of which there are some that layers write into
    assert (holding | frozen) - {type(made(which)[0]) for which in VALUES} == set()


def test_a_frozen_value_without_post_init_has_read_only_arrays():
    @dataclasses.dataclass(frozen=True)
    class Pair(FrozenArrays):
        one: np.ndarray
        others: tuple[np.ndarray, ...]

    given = np.zeros(2)
    pair = Pair(given, (given, given))
    assert [thawed(array) for array in (pair.one, *pair.others)] == [[], [], []]


@pytest.mark.parametrize("array", [np.zeros(3), np.zeros((2, 3), order="F"), np.zeros((0, 2)), np.arange(6)[::2]])
def test_readonly_copies_into_memory_that_cannot_be_written_to(array):
    found = readonly(array)
    assert np.array_equal(found, array)
    assert (found.dtype, found.shape) == (array.dtype, array.shape)
    assert found.flags.f_contiguous or not array.flags.f_contiguous  # what is computed of it rounds alike
    assert found.flags.c_contiguous or not array.flags.c_contiguous
    assert thawed(found) == []
    assert not np.shares_memory(found, array)


def test_readonly_copies_arrays_restored_from_a_pickle():
    """The memory of a restored array is a `bytes` object, but NumPy can write to it."""
    restored = pickle.loads(pickle.dumps(np.zeros(1000)))
    frozen = readonly(restored)
    restored[:] = 1.0
    assert not frozen.any()


@pytest.mark.parametrize("again", [lambda grid: grid, copy.deepcopy, lambda grid: pickle.loads(pickle.dumps(grid))])
def test_a_grid_that_is_only_flagged_read_only_is_copied_into_a_problem(again):
    grid = again(Costmap.writable((40, 40), 0.5, (-10.0, -10.0)))
    view = grid.data[:]
    grid.data.setflags(write=False)
    held = dataclasses.replace(problem(), costmap=grid)
    view[:] = 254
    assert not held.costmap.data.any()


def test_copies_of_a_writable_grid_are_writable():
    grid = Costmap.writable((3, 3), 0.5, (-3.0, -3.0))
    for again in (copy.deepcopy(grid), pickle.loads(pickle.dumps(grid))):
        again.data[:] = 254
    assert not grid.data.any()


def built_in_map():
    return scene_maps.linked_map("optdock:hall_map.yaml", ".")[0]


# What is computed once for everybody: two proofs would share it with whoever asked for it in between.
SHARED = {
    "mapped_obstacles": lambda: mapped_obstacles(problem().costmap),
    "_discs": lambda: free_space._discs(problem().robot.footprint, 4),
    "_bodies": lambda: footprint_discs.disc_cover(problem().robot.footprint, lambda: None),
    "_beside": lambda: connectivity_graph._beside(((0, 0, 0, 16, 8, 0), (0, 1, 0, 16, 8, -1)), 0),
    "bounded_footprint": lambda: proximity.bounded_footprint(problem().robot.footprint),
    "basis_for": lambda: basis_for(((8, 2),)),
    "_spaced_nodes": lambda: qp_step.trusted_nodes(basis_for(((8, 2),)), DEFAULT_SETTINGS.step),
    "_clamped_knots": lambda: nurbs._clamped_knots(3, 2),
    "_block": lambda: basis_module._block(8, 16),
    "_constant_elements": lambda: qp_step._constant_elements(basis_for(((8, 2),)), 8.0, DEFAULT_SETTINGS.step),
    "motion_table": lambda: motion_table(on_a_curve()),
    "_done": lambda: term_rows._done(basis_for(((8, 2),))),
    "_nodes_of_gears": lambda: nlp._nodes_of_gears(basis_for(((8, 2),))),
    "_even_shares": lambda: nlp._even_shares(13),
    "node_shares": lambda: term_rows.node_shares(basis_for(((8, 2),))),
    "packed_footprint": lambda: packed_footprint(problem().robot.footprint),
    "_all_pairs": lambda: narrow_phase._all_pairs(3),
    "_region": lambda: drawn_plan._region(shut_in()),
    "body_of": lambda: collision_scene.body_of(problem().robot.footprint, 32),
    "_read": built_in_map,
    "_placed_on": lambda: scene_files._placed_on(FilePath("hall.yaml"), built_in_map()).problem,
}
HOLD_NO_ARRAYS = {
    "_warm_once",
    "_found",
    "_installed",
    "_loaded",
    "_store",
    "_store_of",
    "_ruckig",
    "_environment",
    "_prepared",
    "_library",
    "map_digest",
    "peaks",
    "radius_of",
}


def test_every_cached_result_is_listed():
    kept = {
        name
        for module in modules()
        for name, function in vars(module).items()
        if hasattr(function, "cache_info") and function.__module__ == module.__name__
    }
    assert kept == {*SHARED, *HOLD_NO_ARRAYS}


@pytest.mark.parametrize("name", SHARED)
def test_no_cached_result_can_be_made_writable(name):
    arrays = arrays_of(SHARED[name]())
    assert arrays
    assert [thawed(array) for array in arrays] == [[]] * len(arrays)


def test_no_constant_can_be_made_writable():
    product = [module for module in modules() if not module.__name__.startswith("optdock.testing.")]
    constants = [
        (module.__name__, name, array)
        for module in product
        for name, value in vars(module).items()
        if isinstance(value, np.ndarray | tuple | dict | FrozenArrays) and name != "__builtins__"
        for array in arrays_of(value)
    ]
    assert constants
    assert [(module, name) for module, name, array in constants if thawed(array)] == []


def test_the_arrays_of_a_tube_are_read_only():
    at = problem()
    tube = Tube(Path.from_poses([at.start, at.goal]), at)
    held = [value for value in vars(tube).values() if isinstance(value, np.ndarray)]
    assert held
    assert [thawed(array) for array in held] == [[]] * len(held)
