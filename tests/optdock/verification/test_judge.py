"""The second judge of plan files: its size, its arithmetic, and attacks that want a false file accepted."""

import ast
import copy
import itertools
import json
import math
import random
import subprocess
import sys
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
import shapely

from optdock.geometry.clothoid import ClothoidSpline
from optdock.geometry.footprint import Footprint
from optdock.geometry.pose import Pose2
from optdock.io.path_columns import curves_of
from optdock.io.proof_cells import proof_of
from optdock.model.clearance_rule import ClearanceRule
from optdock.model.constant_jerk import TimeLaw
from optdock.model.dock import Dock
from optdock.model.limits import MotionLimits
from optdock.model.path import ClothoidSegment, TurnSegment
from optdock.model.path import Path as Way
from optdock.model.problem import DockingProblem
from optdock.model.robot import Robot, TrackingTube
from optdock.model.trajectory import Trajectory
from optdock.verification import certify_motion, certify_path
from optdock.verification import judge as judge_file
from optdock.verification.judge import Refusal, judge, main

SOURCE = Path(judge_file.__file__)
span = judge_file._Span
LIMITS = MotionLimits(
    max_acceleration=0.8, max_deceleration=0.8, max_curvature=2.0, max_curvature_rate=8.0, max_yaw_rate=1.0
)
BOX = Footprint.rectangle(0.4, 0.4, 0.6)
U_SHAPE = Footprint(
    np.array([[0.4, 0.3], [-0.4, 0.3], [-0.4, -0.3], [0.4, -0.3], [0.4, -0.1], [0.1, -0.1], [0.1, 0.1], [0.4, 0.1]])
)
WALL = [[-1.0, 0.36], [3.0, 0.36], [3.0, 0.5], [-1.0, 0.5]]  # 6 cm beside the straight path
POST = [[1.0, -0.6], [1.1, -0.6], [1.1, -0.4], [1.0, -0.4]]


def spline(knots, curvature, yaw=0.0):
    return ClothoidSegment(ClothoidSpline(Pose2(0.0, 0.0, yaw), np.array(knots), np.array(curvature)))


def written(segments, footprint=BOX, obstacles=(WALL, POST), law=None, **others):
    """The document of a path, certified among obstacles, and of a law of phases (duration, jerk)."""
    path = Way(tuple(segments))
    turns = others.pop("turns", any(isinstance(one, TurnSegment) for one in segments))
    clearance = others.pop("clearance", ClearanceRule(0.05, 0.0, 0.0))
    tracking = others.pop("tracking", TrackingTube())
    limits = others.pop("limits", MotionLimits(max_yaw_rate=1.0, max_yaw_acceleration=2.0) if turns else LIMITS)
    robot = Robot(footprint, limits, turns_in_place=turns, tracking=tracking)
    problem = DockingProblem(path.start, Dock(path.end, **others), robot, obstacles, clearance)
    certificate = certify_path(path, problem)
    assert certificate.certified, certificate.reason
    proof = proof_of(path, problem, certificate.start_relief)
    assert proof is not None
    document = {"path": {"segments": curves_of(path)}, "proof": proof}
    if law is not None:
        durations, jerks = zip(*law, strict=True)
        document["trajectory"] = {"phases": {"start": [0.0, 0.0, 0.0], "durations": durations, "jerks": jerks}}
    return json.loads(json.dumps(document))


# 2 m from rest to rest at 0.4 m/s: ramps of 1 s with a jerk of 1.6 m/s^3.
RAMP = [(0.5, 1.6), (0.5, -1.6)]
LAW = [*RAMP, (4.0, 0.0), (0.5, -1.6), (0.5, 1.6)]
STRAIGHT = written([spline([0.0, 0.7, 2.0], [0.0, 0.0, 0.0])], law=LAW, final_straight=0.3)
CURVED = written([spline([0.0, 0.5, 1.0, 1.5, 2.0], [0.0, 0.4, 0.0, -0.4, 0.0])], obstacles=[POST], law=LAW)
TURNED = written([TurnSegment(Pose2(0.0, 0.0, 0.0), 1.0), spline([0.0, 0.5], [0.0, 0.0], 1.0)],
                 obstacles=[POST])  # fmt: skip
FORKED = written([spline([0.0, 2.0], [0.0, 0.0])], U_SHAPE)


@pytest.fixture
def plan():
    return copy.deepcopy(STRAIGHT)


def refused(document):
    with pytest.raises((Refusal, ValueError, LookupError, TypeError, AttributeError)) as caught:
        judge(document if isinstance(document, str) else json.dumps(document))
    return str(caught.value)


def test_the_judge_is_one_short_file_of_the_standard_library():
    text = SOURCE.read_text()
    assert len(text.splitlines()) <= 400
    imported = [node for node in ast.walk(ast.parse(text)) if isinstance(node, ast.Import | ast.ImportFrom)]
    names = {alias.name.split(".")[0] for node in imported if isinstance(node, ast.Import) for alias in node.names}
    names |= {node.module.split(".")[0] for node in imported if isinstance(node, ast.ImportFrom)}
    assert names <= set(sys.stdlib_module_names)


def test_it_runs_as_a_copied_file_and_its_exit_statuses_are_those_of_the_program(tmp_path, plan, capsys):
    copied = tmp_path / "copied.py"
    copied.write_text(SOURCE.read_text())
    (tmp_path / "plan.json").write_text(json.dumps(plan))
    command = [sys.executable, "-I", "-S", copied, tmp_path / "plan.json"]
    ran = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (ran.returncode, ran.stderr) == (0, "")
    assert ran.stdout.startswith("accepted: path among 2 obstacles, 6.000 s of motion; not judged: samples")
    plan["proof"]["obstacles"][1][0][1] = 0.0
    (tmp_path / "plan.json").write_text(json.dumps(plan))
    assert main([str(tmp_path / "plan.json")]) == 3
    assert capsys.readouterr().err.startswith("refused: clearance: no direction for obstacle 1 and piece 0 in cell")
    (tmp_path / "plan.json").write_text("{")
    assert main([str(tmp_path / "plan.json")]) == 2
    assert main([str(tmp_path / "missing.json")]) == 2


@pytest.mark.parametrize("document", [STRAIGHT, CURVED, TURNED, FORKED], ids=["straight", "curved", "turned", "forked"])
def test_certified_plans_are_accepted(document):
    assert judge(json.dumps(document)).startswith("accepted")


def test_intervals_contain_the_exact_results():
    rng = random.Random(1)
    for _ in range(2000):
        a, b = (rng.uniform(-1, 1) * 10.0 ** rng.uniform(-12, 12) for _ in range(2))
        exact = Fraction(a), Fraction(b)
        pairs = [(span(a) + b, exact[0] + exact[1]), (span(a) - b, exact[0] - exact[1]),
                 (span(a) * b, exact[0] * exact[1]), (span(a) / abs(b), exact[0] / abs(exact[1]))]  # fmt: skip
        for found, wanted in pairs:
            assert Fraction(found.lo) <= wanted <= Fraction(found.hi)
    tiny = span(5e-324) * 5e-324
    assert tiny.lo < 0.0 < tiny.hi
    wide = span(-1.0, 2.0) * span(-3.0, 1.0)
    assert wide.lo <= -6.0
    assert wide.hi >= 3.0
    for made in (lambda: span(math.nan), lambda: span(2.0, 1.0), lambda: span(1e308) * 10.0, lambda: span(True)):
        with pytest.raises(Refusal):
            made()


@pytest.mark.parametrize(("bend", "rate"), [(0.0, 0.0), (1.5, -6.0), (-20.0, 40.0), (1e-9, 3.0)])
def test_poses_contain_the_integral_of_the_heading(bend, rate):
    """An independent quadrature with 40 Gauss points lies within the interval, which is no wider than a nanometre."""
    node, weight = np.polynomial.legendre.leggauss(40)
    for step in (1e-6, 0.04, 0.2):
        u = 0.5 * step * (1.0 + node)
        yaw = 0.3 + u * (bend + 0.5 * u * rate)
        found = judge_file._Pose(span(1.0), span(-2.0), span(0.3)).after(span(step), span(bend), span(rate), -1.0)
        x, y = (start - 0.5 * step * float(f(yaw) @ weight) for start, f in ((1.0, np.cos), (-2.0, np.sin)))
        assert found.x.lo - 1e-14 <= x <= found.x.hi + 1e-14
        assert found.y.lo - 1e-14 <= y <= found.y.hi + 1e-14
        assert found.x.hi - found.x.lo < 1e-9


def test_ranges_of_polynomials_contain_their_values():
    rng = np.random.default_rng(2)
    for _ in range(50):
        terms, width = rng.normal(size=5), float(rng.uniform(0.01, 2.0))
        found = judge_file._Polynomial(*(span(float(term)) for term in terms)).over(width)
        values = np.polynomial.polynomial.polyval(np.linspace(0.0, width, 300), terms)
        assert found.lo <= values.min() + 1e-12
        assert found.hi >= values.max() - 1e-12


# Attacks: a colliding or undrivable path that looks proven.


def needle(x, half=5e-8):
    return [[x - half, -0.2], [x + half, -0.2], [x + half, 0.2], [x - half, 0.2]]


@pytest.mark.parametrize("shift", [0.0, 1e-9, -1e-9, 0.01])
def test_a_needle_between_two_cells_is_seen(plan, shift):
    border = plan["proof"]["cells"][0]["borders"][5]
    plan["proof"]["obstacles"].append(needle(border + shift))
    assert "no direction" in refused(plan)
    for angle in (0.0, 0.5 * math.pi, math.pi):
        forged = copy.deepcopy(plan)
        for planes in forged["proof"]["cells"][0]["planes"]:
            planes.append([2, 0, angle])
        assert "obstacle 2 is too close" in refused(forged)


def test_an_obstacle_that_only_touches_the_box_of_a_cell_needs_a_direction(plan):
    plan["proof"]["obstacles"].append([[0.5, -0.36], [0.6, -0.36], [0.55, -0.349]])
    assert "no direction for obstacle 2" in refused(plan)


def test_a_direction_that_separates_another_piece_is_no_proof():
    forged = copy.deepcopy(FORKED)
    forged["proof"]["obstacles"].append([[1.3, -0.05], [1.31, -0.05], [1.31, 0.05], [1.3, 0.05]])  # enters the U
    pieces = len(forged["proof"]["robot"]["pieces"])
    for planes in forged["proof"]["cells"][0]["planes"]:
        planes.extend([[2, 1, 0.5 * math.pi], [2, 0, 0.0]][:pieces])
    assert "obstacle 2" in refused(forged)


def test_pieces_must_cover_the_footprint():
    forged = copy.deepcopy(FORKED)
    del forged["proof"]["robot"]["pieces"][0]
    assert "do not cover" in refused(forged)
    forged["proof"]["robot"]["pieces"].append([[0.0, 0.0], [0.1, 0.0], [0.0, 0.1]])
    assert "do not cover" in refused(forged)
    small = copy.deepcopy(STRAIGHT)
    small["proof"]["robot"]["pieces"] = [[[0.01, 0.01], [-0.01, 0.01], [-0.01, -0.01], [0.01, -0.01]]]
    assert "do not cover" in refused(small)
    turned = copy.deepcopy(STRAIGHT)
    turned["proof"]["robot"]["pieces"] = [turned["proof"]["robot"]["footprint"][::-1]]
    assert "do not cover" in refused(turned)


def test_pieces_that_are_not_convex_count_as_their_hulls():
    forged = copy.deepcopy(FORKED)
    forged["proof"]["robot"].pop("pieces")  # the outline itself: its hull fills the U
    forged["proof"]["obstacles"].append([[2.35, -0.05], [2.4, -0.05], [2.4, 0.05]])  # inside the U of the docked robot
    cells = forged["proof"]["cells"][0]
    cells["planes"] = [[[o, 0, 0.0] for o in range(3)] for _ in cells["planes"]]
    assert "obstacle" in refused(forged)


def test_pieces_may_not_overlap_an_obstacle_even_by_the_tolerance():
    """An obstacle of a micrometre in the seam of two pieces overlaps each by half of it."""
    forged = copy.deepcopy(FORKED)
    forged["proof"]["clearance"].update(required=0.0, at_dock=0.0)
    forged["proof"]["obstacles"] = [[[3.0, 0.0], [3.1, 0.0], [3.1, 0.1]]]
    for part in forged["proof"]["cells"]:
        part["planes"] = [[] for _ in part["planes"]]
    assert judge(json.dumps(forged)).startswith("accepted")
    seam = next(x for piece in forged["proof"]["robot"]["pieces"] for x, _ in piece if 0.0 < x < 0.4)
    x = 2.0 + seam
    forged["proof"]["obstacles"] = [[[x - 4e-7, -0.05], [x + 4e-7, -0.05], [x + 4e-7, 0.05], [x - 4e-7, 0.05]]]
    for angle in np.linspace(-math.pi, math.pi, 9).tolist():
        forged["proof"]["cells"][0]["planes"] = [
            [[0, piece, angle] for piece in range(3)] for _ in forged["proof"]["cells"][0]["planes"]
        ]
        assert "obstacle 0 is too close" in refused(forged)


def wall_before(x):
    return [[x, -1.0], [x + 0.2, -1.0], [x + 0.2, 1.0], [x, 1.0]]


def test_a_robot_that_is_not_convex_may_touch_an_obstacle_with_the_edge_of_its_hull():
    """The tips of both prongs end at x = 2.4 m; they may overlap a wall by the tolerance, as a convex robot may."""
    document = written([spline([0.0, 2.0], [0.0, 0.0])], U_SHAPE, [wall_before(2.4 - 5e-7)],
                       clearance=ClearanceRule(0.0, 0.0, 0.0))  # fmt: skip
    assert judge(json.dumps(document)).startswith("accepted")
    for depth, accepted in ((-1e-7, True), (9.8e-7, True), (1.02e-6, False), (1e-3, False)):
        document["proof"]["obstacles"] = [wall_before(2.4 - depth)]
        if accepted:
            assert judge(json.dumps(document)).startswith("accepted")
        else:
            assert "obstacle 0 is too close" in refused(document)


@pytest.mark.parametrize("depth", [1e-9, 5e-7, 0.05])
def test_no_direction_allows_an_overlap_inside_the_hull(depth):
    """A post between the prongs overlaps the ground of the U, each piece of which it overlaps by less than 1 um."""
    document = written([spline([0.0, 0.1], [0.0, 0.0])], U_SHAPE, [wall_before(0.51)],
                       clearance=ClearanceRule(0.0, 0.0, 0.0))  # fmt: skip
    assert judge(json.dumps(document)).startswith("accepted")
    ground = 0.2 - depth
    document["proof"]["obstacles"] = [[[ground, -0.05], [0.3, -0.05], [0.3, 0.05], [ground, 0.05]]]
    proof = document["proof"]
    planes = proof["cells"][0]["planes"]
    for angles in itertools.product([0.0, 0.5 * math.pi, math.pi, -0.5 * math.pi], repeat=3):
        planes[:] = [[[0, piece, angle] for piece, angle in enumerate(angles)]] * len(planes)
        assert "obstacle 0 is too close" in refused(document)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda part: part["borders"].pop(), "do not cover"),
        (lambda part: part["borders"].pop(0), "do not cover"),
        (lambda part: part["borders"].reverse(), "do not cover"),
        (lambda part: part["borders"].insert(1, part["borders"][0]), "do not cover"),
        (lambda part: part["borders"].__setitem__(3, part["borders"][5]), "do not cover"),
        (lambda part: part["borders"].__setitem__(-1, part["borders"][-1] - 1e-15), "do not cover"),
        (lambda part: part["borders"].remove(0.7), "do not cover"),
        (lambda part: part["planes"].pop(), "zip"),
        (lambda part: part.update(borders=[]), "list index"),
    ],
)
def test_cells_must_cover_the_path_in_order(plan, change, said):
    change(plan["proof"]["cells"][0])
    assert said in refused(plan)


def test_a_cell_that_spans_a_swing_towards_an_obstacle_is_not_proven_from_its_middle():
    """At both ends and in the middle of the turn the corners are clear of a post that they pass in between."""
    document = written([TurnSegment(Pose2(0.0, 0.0, 0.0), math.pi)], Footprint.rectangle(0.5, 0.5, 0.2), [],
                       clearance=ClearanceRule(0.0, 0.0, 0.0))  # fmt: skip
    document["proof"].update(obstacles=[[[0.33, 0.33], [0.36, 0.33], [0.33, 0.36]]], region=[-9.0, -9.0, 9.0, 9.0])
    for angle in np.linspace(-math.pi, math.pi, 17).tolist():
        document["proof"]["cells"] = [{"borders": [0.0, math.pi], "planes": [[[0, 0, angle]]]}]
        assert "obstacle 0 is too close" in refused(document)


@pytest.mark.parametrize("value", ["NaN", "Infinity", "-Infinity", "1e999", "true", "null", '"0"', "[]", "-1e300"])
@pytest.mark.parametrize(
    "place",
    [
        ("path", "segments", 0, "start", 0),
        ("path", "segments", 0, "knots", 1),
        ("path", "segments", 0, "curvature", 1),
        ("path", "segments", 0, "direction"),
        ("trajectory", "phases", "durations", 2),
        ("trajectory", "phases", "start", 1),
        ("proof", "robot", "footprint", 0, 0),
        ("proof", "obstacles", 0, 0, 1),
        ("proof", "start", "pose", 2),
        ("proof", "dock", "pose", 0),
        ("proof", "cells", 0, "borders", 4),
    ],
)
def test_hostile_numbers_are_refused(plan, place, value):
    holder = plan
    for key in place[:-1]:
        holder = holder[key]
    holder[place[-1]] = "\u0001"
    assert refused(json.dumps(plan).replace(json.dumps("\u0001"), value))


@pytest.mark.parametrize("direction", ["forward", "backward"])
def test_many_segments_below_the_tolerance_add_up_to_a_motion_with_a_direction(direction):
    """0.2 mm in 200 segments into the dock; the certificate adds them as well."""
    there, step = (1.0, -1.0) if direction == "forward" else (-1.0, 1.0), 9e-7
    pose, segments = Pose2(0.0, 0.0, 0.0), []
    for length, sign in ((0.5, there[0]), *((step, there[1]) for _ in range(200))):
        segments.append(ClothoidSegment(ClothoidSpline(pose, np.array([0.0, length]), np.zeros(2), int(sign))))
        pose = segments[-1].spline.end
    plan = written(segments, obstacles=[POST])
    assert "accepted" in judge(json.dumps(plan))
    plan["proof"]["dock"]["direction"] = direction
    assert "direction:" in refused(plan)


def test_a_final_straight_shorter_than_a_nanometre_is_judged_as_by_the_certificate():
    """Its only curvature lies before the end, within the first nanometre of the straight."""
    first = spline([0.0, 0.5], [0.0, 0.0])
    last = ClothoidSegment(ClothoidSpline(first.spline.end, np.array([0.0, 4e-10]), np.array([900.0, 0.0])))
    assert "accepted" in judge(json.dumps(written([first, last], obstacles=[POST], limits=MotionLimits(),
                                                  final_straight=1e-9)))  # fmt: skip


@pytest.mark.parametrize("text", ["", "[]", "null", "{}", '{"proof": {}, "proof": {}}', "[" * 100_000, "1" * 5000])
def test_hostile_texts_are_refused(tmp_path, text):
    target = tmp_path / "plan.json"
    target.write_text(text)
    assert main([str(target)]) in (2, 3)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda p: p["proof"]["start"]["pose"].__setitem__(1, 2e-6), "start:"),
        (lambda p: p["proof"]["dock"]["pose"].__setitem__(2, 2e-6), "goal:"),
        (lambda p: p["proof"]["dock"].update(direction="backward"), "direction:"),
        (lambda p: p["proof"]["dock"].update(final_straight=2.1), "final_straight:"),
        (lambda p: p["proof"]["start"].update(speed=-0.1), "direction:"),
        (lambda p: p["proof"]["start"].update(speed=0.1), "start_state:"),
        (lambda p: p["proof"]["start"].update(curvature=0.1), "start_curvature:"),
        (lambda p: p["proof"]["robot"]["limits"].update(max_speed=0.39), "speed:"),
        (lambda p: p["proof"]["robot"]["limits"].update(max_acceleration=0.79), "acceleration:"),
        (lambda p: p["proof"]["robot"]["limits"].update(max_jerk=1.5), "max_jerk:"),
        (lambda p: p["proof"]["robot"]["limits"].update(max_wheel_speed=0.3), "max_wheel_speed:"),
        (lambda p: p["proof"]["robot"]["limits"].update(max_sway=0.3), "limits: no rule"),
        (lambda p: p["proof"]["robot"]["limits"].update(max_speed=-1.0), "limits: no rule"),
        (lambda p: p["proof"]["dock"].update(approach_speed=0.1, approach_distance=0.3), "speed:"),
        (lambda p: p["proof"]["clearance"].update(required=0.061), "clearance:"),
        (lambda p: p["proof"]["clearance"].update(start_relief=1.0), "start_relief"),
        (lambda p: p["proof"]["clearance"].update(taper=-1.0), "clearance: bad rule"),
        (lambda p: p["proof"]["robot"].update(tracking=[0.02, 0.0]), "clearance:"),
        (lambda p: p["proof"]["region"].__setitem__(3, 0.3), "leaves the region"),
        (lambda p: p["proof"].update(region=[-1.0, -1.0, -1.0, -1.0]), "leaves the region"),
        (lambda p: p["trajectory"]["phases"]["durations"].__setitem__(2, 4.001), "rest: none"),
        (lambda p: p["trajectory"]["phases"]["durations"].__setitem__(2, -4.0), "negative"),
        (lambda p: p["path"]["segments"][0].update(poses=[[0.0, 0.0, 0.0], [2.0, 0.0, 0.0]]), "no clothoids"),
        (lambda p: p["path"]["segments"][0].update(turn=1.0), "no clothoids"),
        (lambda p: p["path"]["segments"][0].update(direction=0), "direction must be"),
        (lambda p: p["path"].update(segments=[]), "cells: every segment"),
        (lambda p: p["path"]["segments"][0].update(knots=[0.0, 0.7, 0.7]), "knots must rise"),
        (lambda p: p["path"]["segments"][0].update(knots=[0.0, 5e-324, 2.0]), "arithmetic"),
    ],
)
def test_every_rule_is_judged(plan, change, said):
    change(plan)
    assert said in refused(plan)


def test_limits_on_turning_are_judged_on_a_curve():
    limits = CURVED["proof"]["robot"]["limits"]
    assert judge(json.dumps(CURVED)).startswith("accepted")
    for name, most in (
        ("max_yaw_rate", 0.159),
        ("max_yaw_acceleration", 0.12),
        ("max_lateral_acceleration", 0.063),
        ("max_lateral_jerk", 0.05),
        ("max_steering_rate", 0.2),
        ("max_curvature", 0.39),
        ("max_curvature_rate", 0.79),
    ):
        tight = copy.deepcopy(CURVED)
        tight["proof"]["robot"]["limits"] = {**limits, "wheelbase": 1.0, name: most}
        assert f"{name.removeprefix('max_')}:" in refused(tight)


def test_a_motion_may_not_overshoot_a_segment_and_creep_back(plan):
    """Beyond the end of the path nothing is proven; a return within the tolerance of speed does not undo it."""
    phases = plan["trajectory"]["phases"]
    phases["durations"] = [0.5, 0.5, 4.00025, 0.5, 0.5, 1e-3, 1e-3, 200.0, 1e-3, 1e-3]  # 0.1 mm too far
    phases["jerks"] = [1.6, -1.6, 0.0, -1.6, 1.6, -0.5, 0.5, 0.0, 0.5, -0.5]
    plan["proof"]["robot"]["limits"].pop("max_yaw_rate")
    assert "place: beyond its limit" in refused(plan)


# Attacks at joints: the two ends of a turn of some nanoradians lie within the tolerance of each other (C14).

STEEP = 12.0  # a jerk that is allowed in a turn, but not in a drive
DRIVE = [(1.0, 0.25), (1.0, -0.25), (1.0, -0.25), (1.0, 0.25)]  # 0.5 m from rest to rest


def twitch(distance, jerk=STEEP):
    """Phases from rest to rest over a distance."""
    t = (distance / (2.0 * jerk)) ** (1.0 / 3.0)
    return [(t, jerk), (t, -jerk), (t, -jerk), (t, jerk)]


def drive(missing):
    """`DRIVE` without the last `missing` metres."""
    return [(t, jerk * (1.0 - missing / 0.5)) for t, jerk in DRIVE]


def both_verdicts(middle, law):
    """Whether the certificate and the judge accept two drives of 0.5 m with a segment between them."""
    segments = [spline([0.0, 0.5], [0.0, 0.0]), middle]
    segments.append(ClothoidSegment(ClothoidSpline(Way(tuple(segments)).end, np.array([0.0, 0.5]), np.zeros(2))))
    limits = MotionLimits(max_acceleration=1.0, max_deceleration=1.0, max_jerk=1.0, max_yaw_rate=1.0,
                          max_yaw_acceleration=12.0, max_curvature=9.0)  # fmt: skip
    document = written(segments, obstacles=[POST], limits=limits, law=law, turns=True)
    path = Way(tuple(segments))
    problem = DockingProblem(path.start, Dock(path.end), Robot(BOX, limits, turns_in_place=True))
    durations, jerks = (np.array(column) for column in zip(*law, strict=True))
    certificate = certify_motion(Trajectory(path, TimeLaw(durations, jerks)), problem)
    try:
        return certificate.certified, judge(json.dumps(document)).startswith("accepted"), document
    except Refusal:
        return certificate.certified, False, document


def tiny_turn(angle):
    return TurnSegment(Pose2(0.5, 0.0, 0.0), angle)


@pytest.mark.parametrize("angle", [3e-9, -5e-8, 8e-7, 3e-6])
def test_a_turn_of_nanoradians_has_the_limits_of_a_turn(angle):
    *verdicts, document = both_verdicts(tiny_turn(angle), [*DRIVE, *twitch(abs(angle)), *DRIVE])
    assert verdicts == [True, True]
    (t, jerk), *_ = twitch(abs(angle))
    for limit, value in enumerate((jerk * t * t, jerk * t, jerk)):
        tight = copy.deepcopy(document)
        tight["proof"]["robot"]["turning"][limit] = 0.99 * value
        assert "beyond its limit" in refused(tight)


@pytest.mark.parametrize("angle", [3e-9, 8e-7, 0.1])
@pytest.mark.parametrize("distance", [1e-12, 3e-9, 4e-7, 9e-7, 3e-6])
def test_a_drive_next_to_a_turn_has_no_jerk_of_a_turn(angle, distance):
    """Not in the last micrometre before a turn, nor in the first one after it, nor without any way."""
    turn = twitch(angle) if angle < 1e-6 else twitch(angle, 0.2)
    assert both_verdicts(tiny_turn(angle), [*DRIVE, *turn, *DRIVE])[:2] == (True, True)
    for law in (
        [*drive(distance), *twitch(distance), *turn, *DRIVE],
        [*DRIVE, *turn, *twitch(distance), *drive(distance)],
        [*DRIVE, *turn, *drive(distance), *twitch(distance)],
    ):
        *verdicts, _ = both_verdicts(tiny_turn(angle), law)
        assert verdicts == [False, False]


@pytest.mark.parametrize("length", [3e-9, 8e-7, 3e-6])
def test_a_drive_of_nanometres_between_two_rests_has_the_limits_of_a_drive(length):
    middle = ClothoidSegment(ClothoidSpline(Pose2(0.5, 0.0, 0.0), np.array([0.0, length]), np.full(2, 3.0)))
    for jerk, holds in ((1.0, True), (1.01, False), (STEEP, False)):
        *verdicts, _ = both_verdicts(middle, [*DRIVE, *twitch(length, jerk), *DRIVE])
        assert verdicts == [holds, holds]


@pytest.mark.parametrize("early", [-2e-6, -1.1e-6, -9e-7, -1e-9, 1e-9, 9e-7, 1.1e-6, 2e-6])
@pytest.mark.parametrize("angle", [3e-9, 3e-6])
def test_a_turn_that_begins_beside_its_place_is_judged_as_by_the_certificate(angle, early):
    law = [*drive(early), *twitch(angle), *drive(-early)]
    certified, accepted, _ = both_verdicts(tiny_turn(angle), law)
    assert certified == accepted


def test_a_phase_without_duration_at_a_joint_has_limits_too():
    *_, document = both_verdicts(tiny_turn(3e-9), [*DRIVE, *twitch(3e-9), *DRIVE])
    phases = document["trajectory"]["phases"]
    for place in (0, 4, 8, 12):
        for jerk in (1e3, -1e3):
            forged = copy.deepcopy(document)
            for name, value in (("durations", 0.0), ("jerks", jerk)):
                forged["trajectory"]["phases"][name] = [*phases[name][:place], value, *phases[name][place:]]
            assert "max_jerk: beyond its limit" in refused(forged)


def test_small_jumps_add_up():
    pieces = [spline([0.0, 0.5], [0.0, 0.0]) for _ in range(4)]
    document = written([spline([0.0, 2.0], [0.0, 0.0])])
    curves = curves_of(Way(tuple(pieces)))
    for number, curve in enumerate(curves):
        curve["start"] = [0.5 * number, 4e-7 * (number % 2), 0.0]
    document["path"]["segments"] = curves
    planes = document["proof"]["cells"][0]["planes"][0]
    document["proof"]["cells"] = [{"borders": [0.0, 0.5], "planes": [[*planes, [1, 0, 0.5 * math.pi]]]}] * 4
    assert "joint: the path jumps" in refused(document)
    curves[1]["start"][1] = 0.0
    assert judge(json.dumps(document)).startswith("accepted")


def test_a_last_gear_of_a_tenth_of_a_micrometre_is_none():
    """A robot that must enter forwards cannot back in and then creep forwards."""
    document = written([spline([0.0, 2.0], [0.0, 0.0])], direction="forward")
    document["path"]["segments"][0]["direction"] = -1
    end = {"start": [-2.0, 0.0, 0.0], "knots": [0.0, 1e-7], "curvature": [0.0, 0.0], "direction": 1}
    document["path"]["segments"].append(end)
    document["proof"].update(obstacles=[], region=[-9.0, -9.0, 9.0, 9.0])
    document["proof"]["dock"]["pose"] = [-2.0, 0.0, 0.0]
    cells = [{**part, "planes": [[] for _ in part["planes"]]} for part in document["proof"]["cells"]]
    document["proof"]["cells"] = [*cells, {"borders": [0.0, 1e-7], "planes": [[]]}]
    assert "direction: the gear at the dock" in refused(document)
    document["proof"]["dock"]["direction"] = "backward"
    assert judge(json.dumps(document)).startswith("accepted")


@pytest.mark.parametrize(("gap", "accepted"), [(0.05 - 0.9e-6, True), (0.05 - 1.1e-6, False)])
def test_the_tolerance_is_a_micrometre(plan, gap, accepted):
    """Along a wall the bound is exact, so the verdict changes within a tenth of a micrometre."""
    plan["proof"]["obstacles"][0][0][1] = plan["proof"]["obstacles"][0][1][1] = 0.3 + gap
    if accepted:
        assert judge(json.dumps(plan)).startswith("accepted")
    else:
        assert "obstacle 0" in refused(plan)


def test_a_start_clearance_is_never_taken_too_small():
    """The requirement near a start grows from its clearance, so the judge uses an upper bound of it."""
    corner = [[0.55, 0.35], [0.9, 0.5], [0.8, 0.9]]
    for yaw in np.linspace(0.0, 3.0, 7).tolist():
        document = written([spline([0.0, 0.02], [0.0, 0.0], yaw)], obstacles=[corner], clearance=ClearanceRule(0.0))
        kept = judge_file._Clearance(document["proof"]).kept
        outline = np.array(document["proof"]["robot"]["footprint"])
        turn = np.array([[math.cos(yaw), -math.sin(yaw)], [math.sin(yaw), math.cos(yaw)]])
        true = shapely.distance(shapely.Polygon(outline @ turn.T), shapely.Polygon(corner))
        assert true <= kept <= true + 1e-12


def test_a_robot_that_cannot_turn_and_limits_of_turns():
    law = {"start": [0.0, 0.0, 0.0], "durations": [0.5, 0.5, 0.5, 0.5, 1.0, 1.0, 1.0, 1.0, 1.0], "jerks": []}
    law["durations"], law["jerks"] = [1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0], [0.5, -0.5, -0.5, 0.5, *[0.0] * 4]
    turned = copy.deepcopy(TURNED)
    a = 0.25  # the drive of 0.5 m
    law["jerks"][4:] = [a, -a, -a, a]
    turned["trajectory"] = {"phases": law}
    assert judge(json.dumps(turned)).startswith("accepted")
    for limit, most in enumerate((0.49, 0.49, 0.49)):
        tight = copy.deepcopy(turned)
        tight["proof"]["robot"]["turning"][limit] = most
        assert "beyond its limit" in refused(tight)
    turned["proof"]["robot"]["turning"] = None
    assert "cannot turn" in refused(turned)


def test_huge_coordinates_are_refused_rather_than_rounded():
    far = copy.deepcopy(STRAIGHT)
    for pose in (far["path"]["segments"][0]["start"], far["proof"]["start"]["pose"], far["proof"]["dock"]["pose"]):
        pose[0] += 1e12
    for ring in (*far["proof"]["obstacles"], [far["proof"]["region"][:2]]):
        for point in ring:
            point[0] += 1e12
    far["proof"]["region"][0] += 1e12
    far["proof"]["region"][2] += 1e12
    assert refused(far)
