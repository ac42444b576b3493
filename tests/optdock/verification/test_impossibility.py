import ast
import dataclasses
import inspect
import json
import math

import numpy as np
import pytest

from experiments.families import FEASIBLE_FAMILIES, instance
from experiments.fuzz.case import rng_of
from experiments.fuzz.kinds import impossibilities
from optdock.errors import InvalidFile
from optdock.geometry.footprint import Footprint
from optdock.geometry.pose import Pose2
from optdock.impossibility import (
    ImpossibilityProof,
    ImpossibilitySearch,
    check_impossibility,
    prepare_footprint,
    prove_impossible,
)
from optdock.impossibility import proof as impossibility
from optdock.kernels import Kernel, kernels_lane
from optdock.model.clearance_rule import ClearanceRule
from optdock.model.dock import Dock
from optdock.model.limits import MotionLimits
from optdock.model.problem import DockingProblem
from optdock.model.robot import Robot
from optdock.planning.pipeline import warm_up
from optdock.verification import compiled_clearances
from optdock.verification.certificate import TOLERANCE

LIMITS = MotionLimits(max_curvature=2.0, max_curvature_rate=8.0)
BODY = Footprint.rectangle(0.45, 0.45, 0.6)
ENOUGH = 30.0  # [s]: the machine may be busy


def box(x0, y0, x1, y1):
    return np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]])


def room(width, height, thick=0.2):
    return [
        box(-thick, -thick, width + thick, 0.0),
        box(-thick, height, width + thick, height + thick),
        box(-thick, 0.0, 0.0, height),
        box(width, 0.0, width + thick, height),
    ]


def problem(start, goal, obstacles, clearance=0.05, body=BODY, **more):
    robot = Robot(body, LIMITS)
    return DockingProblem(Pose2(*start), Dock(Pose2(*goal)), robot, obstacles, clearance, **more)


def gap(width, clearance=0.05, thick=0.2, turn=0.0, at=(0.0, 0.0), body=BODY):
    """Two rooms with a gap of a width between them, turned about the origin and moved."""
    wall = [box(2.6 - thick / 2, 0.0, 2.6 + thick / 2, 1.4 - width / 2),
            box(2.6 - thick / 2, 1.4 + width / 2, 2.6 + thick / 2, 3.2)]  # fmt: skip
    c, s = math.cos(turn), math.sin(turn)
    matrix = np.array([[c, -s], [s, c]])
    ends = (np.append(matrix @ pose[:2] + at, pose[2] + turn) for pose in ((1.0, 1.4, 0.2), (4.2, 1.6, 0.1)))
    return problem(*ends, [p @ matrix.T + at for p in (*room(5.2, 3.2), *wall)], clearance, body)


def proven(asked):
    proof = prove_impossible(asked, time_budget=ENOUGH)
    assert proof is not None
    assert check_impossibility(proof, asked).proven
    return proof


@pytest.fixture(scope="module")
def narrow():
    asked = gap(0.65, turn=0.3)
    return asked, proven(asked)


def test_gap_too_narrow_by_centimetres_is_proven_and_measured(narrow):
    _, proof = narrow
    found = proof.bottleneck
    assert found.missing_width == pytest.approx(0.05, abs=0.03)
    assert found.body_fits
    assert found.missing_without_clearance == pytest.approx(-0.05, abs=0.03)
    middle = np.array([[math.cos(0.3), -math.sin(0.3)], [math.sin(0.3), math.cos(0.3)]]) @ (2.6, 1.4)
    assert math.hypot(found.x - middle[0], found.y - middle[1]) < 0.65  # the robot stands in the gap
    assert set(found.between) == {"obstacles[4]", "obstacles[5]"}
    assert "the robot with its clearance is 0.0" in proof.message


def test_too_wide_body_differs_from_too_much_clearance():
    found = proven(gap(0.4)).bottleneck
    assert not found.body_fits
    assert found.missing_width == pytest.approx(0.3, abs=0.05)
    assert found.missing_without_clearance == pytest.approx(0.2, abs=0.05)


@pytest.mark.parametrize(("thick", "at"), [(0.001, (0.0, 0.0)), (0.2, (-3e5, 7e6))])
def test_closed_door_is_proven_however_thin_and_far_off(thick, at):
    proven(gap(0.0, thick=thick, at=at))


@pytest.mark.parametrize(
    "asked",
    [
        gap(0.7),  # as wide as the robot with its clearance
        gap(0.6 - 0.9 * TOLERANCE, clearance=0.0, turn=0.7),  # accepted by the tolerance of a certificate
        gap(0.75),
    ],
)
def test_gap_that_is_wide_enough_is_never_proven_closed(asked):
    assert prove_impossible(asked, time_budget=0.2) is None  # the narrow gap takes 0.15 s


def test_without_a_wall_around_start_or_goal_there_is_no_proof():
    outside = problem((0.0, 0.0, 0.0), (3.0, 0.0, 0.0), [box(1.4, -2.0, 1.6, 2.0)])
    assert prove_impossible(outside, time_budget=ENOUGH) is None
    nothing = problem((0.0, 0.0, 0.0), (3.0, 0.0, 0.0), [])
    assert prove_impossible(nothing) is None


def ring(gap_width):
    """Posts around the goal, so far apart."""
    count, radius, half = 24, 1.5, 0.05
    angles = 2.0 * math.pi * np.arange(count) / count
    size = 2.0 * math.pi * radius / count - gap_width
    return [
        np.array([[x, y] for x, y in box(radius - half, -size / 2, radius + half, size / 2)])
        @ np.array([[math.cos(a), math.sin(a)], [-math.sin(a), math.cos(a)]])
        for a in angles
    ]


def test_dock_inside_a_ring_is_shut_in_and_so_is_a_start():
    posts = ring(0.3)
    proof = proven(problem((-4.0, 0.5, 1.0), (0.0, 0.0, 0.0), posts))
    assert proof.end == "goal"
    assert proven(problem((0.0, 0.0, 0.0), (-4.0, 0.5, 1.0), posts)).end == "start"


def test_bay_shorter_than_the_robot_is_proven_blocked():
    bay = [box(-3.0, -1.0, 3.0, -0.36), box(-3.0, -0.36, -0.42, 0.4), box(0.42, -0.36, 3.0, 0.4)]
    proven(problem((0.0, 2.0, 0.0), (0.0, 0.0, 0.0), bay, clearance=0.0))


def test_corner_that_a_long_robot_cannot_turn_is_proven_though_it_is_wide_enough_for_it():
    # a ladder of length l passes a corner of corridors of width w only if l <= 2 sqrt(2) w
    corridor = [box(-4.0, -0.2, 1.0, 0.0), box(1.0, -0.2, 1.2, 4.0), box(-4.0, 1.0, 0.0, 1.2), box(-0.2, 1.2, 0.0, 4.0),
                box(-4.2, -0.2, -4.0, 1.2), box(-0.2, 4.0, 1.2, 4.2)]  # fmt: skip
    ends = ((-2.0, 0.5, 0.0), (0.5, 2.4, math.pi / 2))
    long_, short = (Footprint.rectangle(length / 2, length / 2, 0.2) for length in (2.9, 1.9))
    assert prove_impossible(problem(*ends, corridor, 0.0, short), time_budget=ENOUGH) is None
    proven(problem(*ends, corridor, 0.0, long_))


def test_border_of_a_map_and_its_unknown_cells_are_walls():
    cells = np.zeros((40, 80), dtype=np.int64)
    cells[:, 38:42] = -1
    ends = {"start": Pose2(1.0, 1.0, 0.0), "dock": Dock(Pose2(3.0, 1.0, 0.0)), "robot": Robot(BODY, LIMITS)}
    walled = DockingProblem.from_grid(cells, 0.05, (0.0, 0.0), **ends)
    proven(walled)
    assert prove_impossible(dataclasses.replace(walled, unknown_is_obstacle=False), time_budget=ENOUGH) is None


def test_thick_wall_of_many_small_pieces_is_as_closed_as_one():
    cells = np.zeros((40, 80), dtype=bool)
    cells[:, 30:50] = np.indices((40, 20)).sum(axis=0) % 3 > 0
    ends = {"start": Pose2(0.75, 1.0, 0.0), "dock": Dock(Pose2(3.25, 1.0, 0.0)), "robot": Robot(BODY, LIMITS)}
    proven(DockingProblem.from_grid(cells, 0.05, (0.0, 0.0), **ends))


def test_start_and_goal_at_one_place_are_joined():
    shut = problem((0.0, 0.0, 0.3), (0.0, 0.0, 0.3 + 2.0 * math.pi), ring(0.0))
    assert prove_impossible(shut, time_budget=ENOUGH) is None


def test_taper_near_the_goal_and_the_relief_near_the_start_count():
    def bay(half):
        return [box(-0.6, -1.0, 0.5, -half), box(-0.6, half, 0.5, 1.0), box(0.5, -1.0, 0.7, 1.0)]

    away, docked = (-3.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    # on the way out of the bay the taper asks for less than the 5 cm that there are
    assert prove_impossible(problem(away, docked, bay(0.35), ClearanceRule(0.3, 0.0, 10.0)), time_budget=0.25) is None
    proven(problem(away, docked, bay(0.35), ClearanceRule(0.3, 0.0, 1.0)))
    # 2 cm on both sides are what the robot starts with, and what may be granted for its own length
    assert prove_impossible(problem(docked, away, bay(0.32), 0.2), time_budget=0.25) is None
    proven(problem(away, docked, bay(0.32), 0.2))


@pytest.mark.parametrize("number", range(4))
def test_scene_carved_around_a_motion_is_never_proven_impossible(number):
    case = impossibilities.draw(rng_of("impossibilities", 11, number))
    assert impossibilities.judge({**case, "budget": 0.1}).outcome == "not proven"


@pytest.mark.parametrize("family", FEASIBLE_FAMILIES)
def test_no_member_of_a_feasible_family_is_proven_impossible(family):
    assert prove_impossible(instance(family, 3).problem, time_budget=0.05) is None


def test_search_is_cancelled_and_has_a_budget():
    asked = 0

    def told():
        nonlocal asked
        asked += 1
        return asked > 3

    assert prove_impossible(gap(0.65), cancel_checker=told) is None
    assert asked == 4
    assert prove_impossible(gap(0.65), time_budget=0.0) is None


def looks(asked, stop_after=10**6):
    """How often a search asks whether to stop."""
    count = iter(range(10**6))
    prove_impossible(asked, time_budget=ENOUGH, cancel_checker=lambda: next(count) >= stop_after)
    return next(count)


def ellipse(corners, length, width):
    angles = np.linspace(0.0, 2.0 * np.pi, corners, endpoint=False)
    return Footprint(np.column_stack((length * np.cos(angles), width * np.sin(angles))))


def test_discs_of_a_footprint_are_made_under_the_clock_and_once():
    asked = gap(0.5, body=ellipse(64, 0.5, 0.3))
    assert looks(asked, 50) == 51, "interrupted while they are made"
    first = looks(asked)
    assert looks(asked) < first - 100


def test_warm_up_computes_the_discs():
    asked = gap(0.5, body=ellipse(48, 0.5, 0.29))
    warm_up(robot=asked.robot)
    first = looks(asked)
    assert looks(asked) == first


def test_what_no_disc_passes_is_proven_without_headings_and_the_rest_with_them():
    search = ImpossibilitySearch(gap(0.5))
    proof = search.proof(ENOUGH, only_disc=True)
    assert proof.headings == len(proof.discs) == 1
    assert proof.bottleneck.missing_width == pytest.approx(0.2, abs=0.01)
    # the bay is wide enough for the disc; that it is too short for the robot the disc cannot tell
    bay = problem((0.0, 2.5, 0.0), (0.0, 0.35, 0.0), [
        box(-2.6, -0.2, 2.6, 0.0), box(-2.6, 0.0, -0.45, 1.6), box(0.45, 0.0, 2.6, 1.6),
        box(-2.8, 3.6, 2.8, 3.8), box(-2.8, -0.2, -2.6, 3.8), box(2.6, -0.2, 2.8, 3.8),
    ])  # fmt: skip
    assert ImpossibilitySearch(bay).proof(ENOUGH, only_disc=True) is None
    assert proven(bay).headings > 1


def test_search_continues_after_an_interruption():
    asked, answers = gap(0.62), iter(range(10**6))
    prepare_footprint(asked.robot.footprint)  # is not resumed, but made once for all calls
    search = ImpossibilitySearch(asked)
    proof, calls = None, 0
    while proof is None and calls < 50:
        calls += 1
        until = next(answers) + 60
        proof = search.proof(ENOUGH, lambda until=until: next(answers) > until)
    assert calls > 1
    assert len(proof.tiles) == len(proven(asked).tiles)
    assert not search.ended
    open_one = ImpossibilitySearch(gap(0.9))
    assert open_one.proof(ENOUGH) is None
    assert open_one.ended


# the checker


def test_proof_with_whole_tiles_is_checked_too():
    outline = np.array([[0.5, -0.5], [0.5, 0.5], [0.3, 0.5], [0.3, -0.3], [-0.5, -0.3], [-0.5, -0.5]])
    assert len(proven(gap(0.15, 0.0, thick=0.05, body=Footprint(outline))).whole) > 0


def test_checker_does_not_import_the_search():
    imported = {
        node.module
        for node in ast.walk(ast.parse(inspect.getsource(impossibility)))
        if isinstance(node, ast.ImportFrom)
    }
    assert not any("cell_decomposition" in str(module) for module in imported)


def test_checker_calls_no_kernel(narrow, monkeypatch):
    def refuse(*_):
        raise AssertionError

    asked, proof = narrow
    monkeypatch.setattr(Kernel, "__call__", refuse)
    if kernels_lane() != "twin":
        with pytest.raises(AssertionError):
            compiled_clearances(np.zeros((1, 3)), asked.robot.footprint, asked.all_obstacles)
    assert check_impossibility(proof, dataclasses.replace(asked)).proven


def test_proof_is_the_same_after_a_file(narrow):
    asked, proof = narrow
    text = json.dumps(proof.as_dict())
    again = ImpossibilityProof.from_dict(json.loads(text))
    assert json.dumps(again.as_dict()) == text
    assert check_impossibility(again, asked) == check_impossibility(proof, asked)
    assert len(text) < 10_000


def flipped(proof, inside):
    """One cell of the set taken out, or one cell far from it put in."""
    k = int(np.argmax([cells.any() and not cells.all() for cells in proof.inside]))
    cells = proof.inside[k].copy()
    place = tuple(np.argwhere(cells == inside)[-1])
    cells[place] = not inside
    return dataclasses.replace(proof, inside=(*proof.inside[:k], cells, *proof.inside[k + 1 :]))


def without_a_tile(proof):
    kept = [k for k, cells in enumerate(proof.inside) if not cells.any() or cells.all()]
    return dataclasses.replace(proof, tiles=proof.tiles[kept], inside=tuple(proof.inside[k] for k in kept))


@pytest.mark.parametrize(
    ("forge", "reason"),
    [
        (lambda proof: flipped(proof, inside=True), "not blocked"),
        (lambda proof: dataclasses.replace(proof, end="start"), "set"),
        (without_a_tile, ""),
        (lambda proof: dataclasses.replace(proof, tiles=proof.tiles[:0], inside=()), "does not contain its end pose"),
        (lambda proof: dataclasses.replace(proof, discs=proof.discs * 1.05), "not within the footprint"),
        (
            lambda proof: dataclasses.replace(proof, discs=proof.discs + np.array([0.3, 0.0, 0.0])),
            "not within the footprint",
        ),
        (lambda proof: dataclasses.replace(proof, cell=0.5 * proof.cell), ""),
        (lambda proof: dataclasses.replace(proof, cell=-proof.cell), "tiles are invalid"),
        (lambda proof: dataclasses.replace(proof, cell=math.nan), "tiles are invalid"),
        (lambda proof: dataclasses.replace(proof, origin=(math.nan, 0.0)), "tiles are invalid"),
        (lambda proof: dataclasses.replace(proof, centre=(math.nan, 0.0)), "tiles are invalid"),
        (lambda proof: dataclasses.replace(proof, discs=np.full((1, 3), math.nan)), "tiles are invalid"),
        (lambda proof: dataclasses.replace(proof, discs=proof.discs[:0]), "not blocked"),
        (lambda proof: dataclasses.replace(proof, discs=np.zeros((10**6, 3))), "exceeds the size"),
        (lambda proof: dataclasses.replace(proof, headings=0), "tiles are invalid"),
        (lambda proof: dataclasses.replace(proof, tiles=proof.tiles - [1, 0, 0]), "tiles are invalid"),
        (lambda proof: dataclasses.replace(proof, tiles=proof.tiles.astype(float)), "tiles are invalid"),
        (lambda proof: dataclasses.replace(proof, whole=np.zeros((10**6, 3), dtype=int)), "exceeds the size"),
        (lambda proof: dataclasses.replace(proof, whole=np.array([[-12, 0, 0]])), "overlap"),
        (lambda proof: dataclasses.replace(proof, inside=tuple(cells * 2 for cells in proof.inside)), "do not fit"),
        (lambda proof: dataclasses.replace(proof, headings=2 * proof.headings), "do not fit"),
        (lambda proof: dataclasses.replace(proof, tiles=proof.tiles[[0, *range(len(proof.tiles) - 1)]]), ""),
        (lambda proof: dataclasses.replace(proof, inside=tuple(cells | True for cells in proof.inside)), "both ends"),
    ],
)
def test_forged_proof_is_refused(narrow, forge, reason):
    asked, proof = narrow
    verdict = check_impossibility(forge(proof), asked)
    assert not verdict.proven
    assert reason in verdict.reason


def test_proof_for_a_narrower_gap_proves_nothing_of_a_wider_one(narrow):
    _, proof = narrow
    verdict = check_impossibility(proof, gap(0.71, turn=0.3))
    assert not verdict.proven


@pytest.mark.parametrize(
    "change",
    [
        {"inside": "AAAA"},
        {"inside": "?"},
        {"inside": ""},
        {"headings": 0},
        {"headings": 10**9},
        {"tiles": [[12, 0, 0]] * 9_999},
        {"discs": [[0.0, 0.0, 0.1]] * 9_999},
        {"cell": -1.0},
        {"cell": float("nan")},
        {"tiles": [[99, 0, 0]]},
        {"tiles": [[0, 10**30, 0]]},
        {"discs": [[1.0, 2.0]]},
        {"end": "both"},
        {"bottleneck": {"x": 1.0}},
        {"problem": {}},
    ],
)
def test_file_that_holds_no_proof_is_refused_by_name(narrow, change):
    with pytest.raises(InvalidFile, match="impossibility"):
        ImpossibilityProof.from_dict({**narrow[1].as_dict(), **change})
