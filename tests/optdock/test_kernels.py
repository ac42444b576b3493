"""Kernels in C: equal to their twins, checked at the door, and rejected if they do not belong to the sources."""

import functools
import logging
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path as FilePath

import numpy as np
import pytest

from experiments.families import instance
from experiments.fuzz.case import rng_of
from experiments.fuzz.generators.shapes import obstacle
from experiments.fuzz.kinds.kernels import DEGENERATE, draw, drawn_shapes, drawn_stretches, is_equal, judge
from optdock import kernels
from optdock.build_kernels import ABOUT, FLAGS, LIBRARY, BuildFailed, build, digest_of, kernel_sources
from optdock.deadline import TICK, budget_clock, now
from optdock.errors import InvalidValue
from optdock.geometry.clothoid import ClothoidSpline
from optdock.geometry.footprint import Footprint
from optdock.geometry.obstacles import ObstacleSet
from optdock.geometry.pose import Pose2
from optdock.kernels import Kernel, KernelMismatch, kernels_in_use, kernels_lane, load_library, twin_of, using_kernels
from optdock.model.clearance_rule import ClearanceRule
from optdock.model.dock import Dock
from optdock.model.limits import MotionLimits
from optdock.model.path import ClothoidSegment, Path, TurnSegment
from optdock.model.problem import DockingProblem
from optdock.model.robot import Robot
from optdock.planning.pipeline import plan_dock
from optdock.verification import (
    clearance_rounds,
    compiled_clearances,
    conservative_advancement,
    motion_bounds,
    pose_clearances,
    stretch_bounds,
)
from optdock.verification.clearance_rounds import Near, Rule, World
from optdock.verification.conservative_advancement import prove_clearance
from optdock.verification.motion_bounds import PathMotion

ROOT = FilePath(__file__).resolve().parents[2]
HAS_COMPILER = shutil.which(os.environ.get("CC", "cc").split()[0]) is not None
needs_compiler = pytest.mark.skipif(not HAS_COMPILER, reason="no C compiler")


@needs_compiler
def test_the_library_of_this_tree_is_up_to_date():
    """Otherwise all tests would run the twins alone: `make kernels` compiles it."""
    assert kernels._library().handle is not None, kernels._library().reason


# Equality with the twins


@needs_compiler
@pytest.mark.parametrize("number", range(80))
def test_random_proofs_are_equal_to_the_last_bit(number):
    verdict = judge(draw(rng_of("kernels", 3, number)))
    assert verdict.outcome in ("equal", "equal proofs", "equal roll-outs", "input refused: InvalidValue"), verdict


@pytest.mark.parametrize("degenerate", DEGENERATE)
def test_random_stretches_are_as_degenerate_as_they_claim(degenerate):
    bounds, touches = [], []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        (body, obstacles), (advances, within) = drawn_shapes(rng, degenerate), drawn_stretches(rng, degenerate)
        with np.errstate(all="ignore"):
            found = stretch_bounds._body_bounds_numpy(body, advances, obstacles, within)
        bounds.append(found.bound)
        touches.append(np.any(np.abs(found.distance) < 1e-9))
    bounds = np.concatenate(bounds)
    assert not np.isnan(bounds).any()
    assert np.isneginf(bounds).any() == (degenerate in ("nan", "inf"))
    assert np.any(bounds < 0.0)
    assert np.any(touches) == (degenerate == "touching")


SCENES = ("pillar 0", "u_dock 1", "reverse_cusp 2", "clutter 1", "car_bay 0", "reverse_alcove 1")


@needs_compiler
@pytest.mark.parametrize("name", SCENES)
def test_plans_of_both_lanes_are_equal_to_the_last_bit(name):
    """Prices, paths and certificates; the counted clock ends budgets at the same place."""
    found, (family, seed) = [], name.split()
    for lane in ("twin", "native"):
        with using_kernels(lane), budget_clock("counted"):
            plan = plan_dock(instance(family, int(seed)).problem, time_budget=1.0)
            poses = plan.path.poses_at(np.linspace(0.0, plan.path.length, 50))
            found.append((plan.price, plan.path.digest, plan.certificate.min_clearance, poses.tobytes()))
    assert found[0] == found[1]


# The parts of a proof: cells, rounds, clearances


def driven(*gears):
    """A path of gears (knots, curvature) and of turns (angle), beginning forward at the origin."""
    segments, at, sign = [], Pose2(0.0, 0.0, 0.2), 1
    for gear in gears:
        if isinstance(gear, float):
            segments.append(TurnSegment(at, gear))
        else:
            segments.append(ClothoidSegment(ClothoidSpline(at, *gear, sign)))
            sign = -sign
        at = Path(tuple(segments)).end
    return Path(tuple(segments))


PATHS = {
    "one gear": driven(([0.0, 0.5, 1.3], [0.2, 1.0, -0.4])),
    "cusps": driven(([0.0, 0.9], [0.0, 1.5]), ([0.0, 0.02, 0.7], [0.0, -1.0, 0.5]), ([0.0, 1.1], [-2.0, 0.0])),
    "turns in place": driven(1.2, ([0.0, 0.6], [0.0, 0.0]), -2.5),
    "one cell": driven(([0.0, 0.01], [0.0, 3.0])),
    "tiny": driven(([0.0, 1e-12, 1e-9], [0.0, 0.0, 1.0])),
}
BODIES = {
    "convex": Footprint.rectangle(0.45, 0.25, 0.6),
    "two pieces": Footprint([[0.5, 0.3], [-0.2, 0.3], [-0.2, 0.1], [0.3, 0.1], [0.3, -0.3], [0.5, -0.3]]),
    "thin triangle": Footprint([[0.5, 0.0], [-0.1, 1e-4], [-0.1, -1e-4]]),
}


@functools.cache
def some_rocks(name, of_body):
    rng, body = np.random.default_rng(3), BODIES[of_body]
    if name == "touching":  # the outline of the robot at the start, beside it
        return ObstacleSet.from_polygons(
            [body.vertices + np.array(side) for side in ([body.length, 0.0], [0.0, body.width])]
        )
    if name == "needles":
        return ObstacleSet.from_polygons([[[x, -2.0], [x + 1e-5, -2.0], [x, 2.0]] for x in (-0.6, 0.7, 1.4)])
    if name == "a map":
        low = rng.integers(-100, 100, (3000, 2)) * 0.05
        low = low[np.hypot(*low.T) > 1.0]
        return ObstacleSet.from_rectangles(low, low + 0.05, "map")
    return ObstacleSet.from_polygons([rng.uniform(-3.0, 3.0, 2) + np.array(obstacle(rng)) for _ in range(40)])


def both_lanes(run):
    found = []
    for lane in ("twin", "native"):
        with using_kernels(lane), np.errstate(all="ignore"):
            found.append(run())
    assert not kernels._OfProcess.replaced  # a kernel that differs in its first call is replaced by its twin
    return found


@needs_compiler
@pytest.mark.parametrize("path", PATHS.values(), ids=PATHS)
def test_cells_of_both_lanes_are_equal_however_often_they_are_divided(path):
    motion, rng = PathMotion(path), np.random.default_rng(1)
    twin, native = both_lanes(lambda: motion_bounds.first_cells(motion, 0.08))
    assert is_equal((*twin[0], *twin[1]), (*native[0], *native[1]))
    for parts in (2, 8, 3):
        chosen = np.sort(rng.permutation(twin[0].first.size)[: max(1, twin[0].first.size // 2)])
        twin, native = both_lanes(lambda c=twin[0], r=chosen, n=parts: motion_bounds.divided(c, r, n))
        assert is_equal((*twin[0], *twin[1]), (*native[0], *native[1]))


@needs_compiler
@pytest.mark.parametrize("relief", [0.0, 0.6])
@pytest.mark.parametrize("rocks", ["touching", "needles", "a map", "scattered"])
@pytest.mark.parametrize("body", BODIES)
@pytest.mark.parametrize("name", PATHS)
def test_proofs_of_both_lanes_are_equal(name, body, rocks, relief):
    """Poses with overlaps and with contact, and for a map only some of the obstacles near the path."""
    path, robot = PATHS[name], Robot(BODIES[body], MotionLimits())
    rule = ClearanceRule(0.1, 0.0, 0.3, 0.05, at_start=0.02 if relief else None)
    problem = DockingProblem(path.start, Dock(path.end), robot, some_rocks(rocks, body), rule)
    for sharp in (True, False):
        proofs = both_lanes(lambda s=sharp: prove_clearance(Path(path.segments), problem, start_relief=relief, sharp=s))
        assert is_equal(*proofs)


@functools.cache
def rocks_beside(name, aside):
    rng, path = np.random.default_rng(8), PATHS[name]
    at = path.poses_at(np.linspace(0.0, path.length, 40))[:, :2]
    places = at + (aside + 0.75) * np.array([[0.0, 1.0]]) + rng.uniform(0.0, 0.2, at.shape)
    return ObstacleSet.from_polygons([place + np.array(obstacle(rng)) * 0.1 for place in places])


@needs_compiler
@pytest.mark.parametrize("aside", [0.0, 0.9, 2.5, 40.0])
@pytest.mark.parametrize("body", BODIES)
@pytest.mark.parametrize("name", PATHS)
def test_quick_proofs_of_both_lanes_are_equal(name, body, aside):
    """Among obstacles that are near, farther than those evaluated first, and out of reach; without a proof in some."""
    motion, rocks = PathMotion(PATHS[name]), rocks_beside(name, aside)
    rule = Rule(ClearanceRule(0.1, 0.0, 0.3), 0.5, 0.0)
    world = World(BODIES[body], rocks, motion.path.end, motion.path.start, rule)
    for sharp, crop in ((True, 1.0), (False, 1.0), (True, 50.0)):
        twin, native = both_lanes(
            lambda s=sharp, c=crop: conservative_advancement._quick_chosen(motion, world, 400, 0.6, c, sharp=s)
        )
        assert (twin is None) == (native is None)
        assert (twin is None) == (aside > crop + 1.0) or aside == 0.0
        if twin is not None:
            assert is_equal((*twin[0], *twin[1:]), (*native[0], *native[1:]))


@needs_compiler
@pytest.mark.parametrize("spoiled", ["none", "attained", "pose", "yaw", "start", "relief"])
def test_a_round_with_numbers_that_are_none_proves_as_little_in_both_lanes(spoiled):
    path, body, rocks = PATHS["cusps"], BODIES["two pieces"], some_rocks("scattered", "two pieces")
    start, relief = (np.nan if spoiled == part else usual for part, usual in (("start", 0.2), ("relief", 0.0)))
    rule = Rule(ClearanceRule(0.1, 0.0, 0.3), start, relief)
    world, motion = World(body, rocks, path.end, path.start, rule), PathMotion(path)
    cells, ends = motion_bounds.first_cells(motion, 0.08)
    nodes = motion.nodes(ends.segment, ends.u)
    nodes.poses[3, {"pose": 0, "yaw": 2}.get(spoiled, 0)] += np.nan if spoiled in ("pose", "yaw") else 0.0
    near, attained = Near(rocks, np.arange(0, len(rocks), 2)), np.nan if spoiled == "attained" else 0.3
    block = cells, ends, nodes
    twin, native = both_lanes(lambda: clearance_rounds._round_chosen(motion, world, near, block, attained))
    assert is_equal(twin, native)
    met = (ends.first == 3) | (ends.last == 3)
    if spoiled in ("pose", "yaw"):
        assert np.isneginf(native.bound[met]).all()
    if spoiled not in ("none", "start"):  # a start without clearance is one in contact
        assert (native.fates[met] > 0).all()


@needs_compiler
@pytest.mark.parametrize("within", [np.inf, 0.3])
@pytest.mark.parametrize("rocks", ["touching", "needles", "a map", "scattered"])
@pytest.mark.parametrize("body", BODIES)
def test_clearances_of_both_lanes_are_equal(body, rocks, within):
    rng, obstacles = np.random.default_rng(5), some_rocks(rocks, body)
    poses = np.vstack((np.zeros((1, 3)), rng.uniform(-3.0, 3.0, (60, 3))))
    twin, native = both_lanes(lambda: compiled_clearances(poses, BODIES[body], obstacles, within))
    assert is_equal(twin, native)
    assert is_equal(twin, pose_clearances(poses, BODIES[body], obstacles, within))


@needs_compiler
def test_cells_that_are_none_are_an_error():
    motion = PathMotion(PATHS["cusps"])
    with using_kernels("native"):
        cells, ends = motion_bounds.first_cells(motion, 0.08)
        with pytest.raises(IndexError):
            motion_bounds._divided_native(cells, np.array([0, cells.first.size]), 2)
        rocks = some_rocks("scattered", "convex")
        world = World(BODIES["convex"], rocks, Pose2(0, 0, 0), Pose2(0, 0, 0), Rule(ClearanceRule(), 0.1, 0.0))
        block = cells._replace(segment=cells.segment + 9), ends, motion.nodes(ends.segment, ends.u)
        with pytest.raises(IndexError):
            clearance_rounds._round_native(motion, world, Near(rocks, np.arange(2)), block, 0.1)


def test_without_obstacles_everything_is_proven():
    path = PATHS["cusps"]
    problem = DockingProblem(path.start, Dock(path.end), Robot(BODIES["convex"], MotionLimits()), ObstacleSet.empty())
    without_dock = prove_clearance(path, problem, obstacles=ObstacleSet.empty())
    assert without_dock.holds
    assert without_dock.proven == np.inf


# Lanes


@pytest.fixture
def fresh(monkeypatch):
    """A process that has not chosen its lane."""
    monkeypatch.setattr(kernels._OfProcess, "lane", None)
    monkeypatch.setattr(kernels._OfProcess, "tested", set())
    monkeypatch.setattr(kernels._OfProcess, "replaced", set())
    monkeypatch.delenv("OPTDOCK_KERNELS", raising=False)
    return monkeypatch


def test_the_environment_selects_the_lane(fresh):
    fresh.setenv("OPTDOCK_KERNELS", "twin")
    assert kernels_lane() == "twin"
    with pytest.raises(InvalidValue, match="fast"), using_kernels("fast"):
        pass
    assert kernels_lane() == "twin"


def test_an_unknown_lane_in_the_environment_is_an_error(fresh):
    fresh.setenv("OPTDOCK_KERNELS", "quick")
    with pytest.raises(InvalidValue, match="OPTDOCK_KERNELS: must be one of native, twin, audit, got 'quick'"):
        kernels_lane()


@pytest.mark.parametrize(("wanted", "lane"), [(None, "twin"), ("twin", "twin"), ("native", None), ("audit", None)])
def test_without_a_library_the_twins_run_and_kernels_cannot_be_required(fresh, tmp_path, wanted, lane):
    fresh.setattr(kernels, "_library", lambda: load_library(tmp_path / "none.so", ROOT))
    if wanted is not None:
        fresh.setenv("OPTDOCK_KERNELS", wanted)
    if lane is None:
        with pytest.raises(InvalidValue, match=r"none\.so was not compiled"):
            kernels_lane()
    else:
        assert kernels_lane() == lane
        assert "was not compiled" in kernels_in_use()


def pair_of(twin_result, native_result, calls):
    def native(x):
        calls.append("native")
        return native_result

    @twin_of(native)
    def function(x):
        calls.append("twin")
        return twin_result

    return function


@needs_compiler
def test_the_first_call_of_a_kernel_also_runs_its_twin(fresh):
    calls = []
    function = pair_of((1.0, np.array([1.0, np.nan])), (1.0, np.array([1.0 + 1e-13, np.nan])), calls)
    with using_kernels("native"):
        function(0)
        function(0)
    assert calls == ["native", "twin", "native"]


@needs_compiler
def test_every_call_of_a_kernel_has_the_same_result_and_counts_the_same(fresh):
    """The first call returns the result of C too, and the readings of the clock by the twin are not counted.

    Both look at the clock for every value that is not in the cache; the kernel changes its list of values.
    """

    def native(look, values, cache):
        [look() for _ in range(2) if not cache]
        cache.add(True)
        values[0] += 1.0
        return np.array(values)

    @twin_of(native, lambda look, values, cache: (look, [*values], cache))
    def function(look, values, cache):
        [look() for _ in range(5) if not cache]
        return np.array([values[0] + 1.0 + 1e-13])

    with using_kernels("native"), budget_clock("counted"):
        found = [(float(function(now, [1.0], set())[0]), round(now() / TICK)) for _ in range(3)]
    assert found == [(2.0, 2), (2.0, 5), (2.0, 8)]


WRONG = [1.0 + 1e-11, np.nan, np.array([1.0]), -np.inf]


@needs_compiler
@pytest.mark.parametrize("wrong", WRONG, ids=str)
def test_a_kernel_that_differs_is_replaced_by_its_twin(fresh, caplog, wrong):
    calls = []
    function = pair_of(1.0, wrong, calls)
    with using_kernels("native"), caplog.at_level(logging.WARNING):
        assert [function(0), function(0)] == [1.0, 1.0]
        assert "NumPy for" in kernels_in_use()
    assert calls == ["native", "twin", "twin"]
    assert "differs from NumPy" in caplog.text


@needs_compiler
@pytest.mark.parametrize("wrong", WRONG, ids=str)
def test_an_audit_raises_where_a_kernel_differs(fresh, wrong):
    with using_kernels("audit"):
        assert pair_of(1.0, 1.0 + 1e-13, [])(0) == 1.0
        with pytest.raises(KernelMismatch, match="pair_of"):
            pair_of(1.0, wrong, [])(0)


def test_an_audit_compares_every_part_of_a_result():
    first = (np.arange(3), (2.0, np.inf))
    assert kernels._difference(first, (np.arange(3), (2.0, np.inf))) == ""
    assert "part 0" in kernels._difference(first, (np.array([0, 1, 3]), (2.0, np.inf)))
    assert "part 1: part 1" in kernels._difference(first, (np.arange(3), (2.0, 1.0)))
    assert "2 and 1 parts" in kernels._difference(first, (np.arange(3),))
    assert "tuple and NoneType" in kernels._difference(first, None)
    assert "NoneType and tuple" in kernels._difference(None, first)
    assert kernels._difference(None, None) == ""


# The door


SIZES = (1, 1, 1, 4, 3, 1)


@needs_compiler
@pytest.mark.parametrize(
    "array",
    [np.zeros(3), np.zeros(4, dtype=np.float32), np.zeros((4, 2))[:, 0], np.zeros(4, dtype=np.int32)],
    ids=["size", "float32", "strided", "int32"],
)
def test_a_kernel_takes_contiguous_arrays_of_its_sizes_alone(array):
    with pytest.raises(ValueError, match="array 0 must be contiguous with 4 elements"):
        Kernel("optdock_advance_bounds", sizes=6, numbers=2)(SIZES, (1.0, 1.0), ((array, 4),))


@needs_compiler
@pytest.mark.parametrize("row", [-1, 99])
def test_a_stretch_of_no_pose_is_an_error(row):
    rng = np.random.default_rng(1)
    (body, obstacles), (advances, within) = drawn_shapes(rng, "none"), drawn_stretches(rng, "none")
    pose = advances.pose.copy()
    pose[-1] = row
    with pytest.raises(IndexError), using_kernels("native"):
        stretch_bounds._body_bounds_native(body, advances._replace(pose=pose), obstacles, within)


# The library


def built(tmp_path, *flags, define=()):
    """Compile the file with digest and self-test alone, which is quick."""
    library = tmp_path / "about.so"
    values = {"DIGEST": digest_of(ROOT, [ABOUT]), "SOURCES": ABOUT.as_posix(), **dict(define)}
    macros = [f'-DOPTDOCK_{name}="{value}"' for name, value in values.items()]
    command = [*os.environ.get("CC", "cc").split(), *FLAGS, *flags, *macros, "-o", library, ROOT / ABOUT, "-lm"]
    subprocess.run(command, check=True)
    return load_library(library, ROOT)


@needs_compiler
def test_a_library_of_these_sources_is_used(tmp_path):
    found = built(tmp_path)
    assert found.handle is not None, found.reason


@needs_compiler
@pytest.mark.parametrize(
    ("flags", "define", "why"),
    [
        (("-ffinite-math-only",), {}, "fails its self-test"),
        ((), {"DIGEST": "0"}, "was compiled from other sources"),
        ((), {"SOURCES": "optdock/none.c"}, "its sources cannot be read"),
        (("-Doptdock_kernels_self_test=hidden",), {}, "cannot be loaded"),
    ],
    ids=["finite math", "digest", "no source", "no self-test"],
)
def test_a_library_that_does_not_belong_here_is_rejected(tmp_path, flags, define, why):
    found = built(tmp_path, *flags, define=define)
    assert found.handle is None
    assert why in found.reason
    assert "python -m optdock.build_kernels" in found.reason
    assert not found.is_expected


@needs_compiler
def test_a_library_with_another_interface_is_rejected(tmp_path, monkeypatch):
    monkeypatch.setattr(kernels, "ABI", 2)
    assert "has interface 1 instead of 2" in built(tmp_path).reason


def test_a_file_that_is_no_library_is_rejected(tmp_path):
    (tmp_path / "text.so").write_text("no library")
    assert "cannot be loaded" in load_library(tmp_path / "text.so", ROOT).reason


@needs_compiler
def test_a_changed_source_needs_a_new_library(tmp_path):
    for source in kernel_sources(ROOT):
        (tmp_path / source).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / source, tmp_path / source)
    library = ROOT / LIBRARY
    assert load_library(library, tmp_path).handle is not None
    changed = tmp_path / kernel_sources(ROOT)[1]
    changed.write_text(changed.read_text() + "\n")
    assert "was compiled from other sources" in load_library(library, tmp_path).reason


def test_a_missing_compiler_is_told(tmp_path, monkeypatch):
    monkeypatch.setenv("CC", "no-such-compiler -m64")
    with pytest.raises(BuildFailed, match="no C compiler: no-such-compiler -m64"):
        build(ROOT, tmp_path / "none.so")
    assert list(tmp_path.iterdir()) == []


@needs_compiler
def test_a_source_that_does_not_compile_leaves_the_library_alone(tmp_path):
    (tmp_path / "optdock").mkdir()
    (tmp_path / ABOUT).write_text("int x = ;")
    (tmp_path / "kept.so").write_text("kept")
    with pytest.raises(BuildFailed, match="error"):
        build(tmp_path, tmp_path / "kept.so")
    assert (tmp_path / "kept.so").read_text() == "kept"


@pytest.mark.parametrize("lane", ["twin", "native"])
def test_the_version_names_the_kernels(lane):
    if lane == "native" and not HAS_COMPILER:
        pytest.skip("no C compiler")
    command = [sys.executable, "-c", "from optdock.cli import main; main()", "--version"]
    environment = {**os.environ, "OPTDOCK_KERNELS": lane, "PYTHONPATH": str(ROOT)}
    told = subprocess.run(command, env=environment, capture_output=True, text=True, check=True).stdout.splitlines()
    assert told == [
        "0.1.0",
        "kernels: C (interface 1)" if lane == "native" else "kernels: NumPy (OPTDOCK_KERNELS=twin)",
    ]


@functools.cache
def c_code(source):
    return (ROOT / source).read_text(encoding="utf-8")


@pytest.mark.parametrize("source", kernel_sources(ROOT)[1:], ids=lambda source: source.stem)
def test_every_kernel_stands_alone_beside_its_twin(source):
    """No file includes another, and all but the kernels is static."""
    code = c_code(source)
    assert (ROOT / source.with_name(source.name.replace("_kernel.c", ".py"))).is_file()
    assert {line.strip() for line in code.splitlines() if line.startswith("#include")} == {
        "#include <math.h>",
        "#include <stdint.h>",
    }
    assert "malloc" not in code
    starts = [line for line in code.splitlines() if line[:1].isalpha() and "(" in line]
    assert all(line.startswith(("static ", "int64_t optdock_")) for line in starts)


def test_only_smoother_timing_proof_and_search_call_other_kernels():
    """Search and proof share no native code, and the functions that are called are declared as they are defined."""
    declared, defined = {}, {}
    for source in kernel_sources(ROOT)[1:]:
        for head, end in re.findall(r"^(int64_t optdock_[^;{]*?)\s*([;{])", c_code(source), re.MULTILINE):
            (declared if end == ";" else defined).setdefault(source.as_posix(), set()).add(" ".join(head.split()))
    homes = {
        caller: {source for source, heads in defined.items() if heads & called} for caller, called in declared.items()
    }
    assert set.union(*declared.values()) <= set.union(*defined.values())
    assert homes.pop("optdock/verification/conservative_advancement_kernel.c") == {"optdock/geometry/clothoid_kernel.c"}
    search = "optdock/planners/manoeuvres/"
    for caller in ("disc_routes", "free_space"):
        assert homes.pop(f"{search}{caller}_kernel.c") == {f"{search}distance_field_kernel.c"}
    assert homes.pop("optdock/timing/reference_program_kernel.c") == {"optdock/timing/interior_point_kernel.c"}
    assert set(homes) == {f"smoothers/scp/{caller}_kernel.c" for caller in ("loop", "initial_guess", "term_rows")}
    called = set.union(*homes.values()) - {"optdock/quadratic_program_kernel.c"}
    assert all(home.startswith("smoothers/scp/") for home in called)
