import json
import math
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import shapely
from scipy.special import fresnel

from experiments.families import instance
from experiments.fuzz import lanes
from experiments.fuzz.__main__ import main
from experiments.fuzz.campaign import judge_once
from experiments.fuzz.case import Verdict, load_case, rng_of, save_case
from experiments.fuzz.doors import path_of, problem_spec
from experiments.fuzz.generators.carved import required_between
from experiments.fuzz.kinds import KINDS, paths, plans
from experiments.fuzz.minimise import minimised
from experiments.fuzz.oracle.cells import Cells, leak
from experiments.fuzz.oracle.motion import cut, motion_of
from experiments.fuzz.oracle.rules import findings
from experiments.fuzz.oracle.sweep import required_at, sweep
from experiments.fuzz.oracle.timing import judge_timing
from experiments.fuzz.oracle.views import views
from experiments.fuzz.oracle.world import World
from experiments.fuzz.planted import PLANTS
from optdock.kernels import kernels_lane

ROOT = Path(__file__).resolve().parents[2]
SQUARE = [[0.4, 0.3], [-0.4, 0.3], [-0.4, -0.3], [0.4, -0.3]]


def clothoid(knots, curvature, start=(0.0, 0.0, 0.0), gear=1):
    return {"type": "clothoid", "start": list(start), "knots": list(knots), "curvature": list(curvature), "gear": gear}


def scene(path, **changes):
    motion = motion_of(path)
    return {
        "kind": "paths",
        "path": path,
        "footprint": {"polygon": SQUARE},
        "obstacles": [],
        "grid": None,
        "dock": {"pose": motion.end.tolist(), "footprint": None, "direction": "auto", "final_straight": 0.0},
        "start": motion.start.tolist(),
        "start_speed": 0.0,
        "clearance": [0.0, 0.0, 0.0],
        "limits": {},
        "zone": [None, 0.0],
        **changes,
    }


def clearance(case, pose):
    return float(World.of(case).clearances(np.array([pose]))[0])


# curves of the oracle


@pytest.mark.parametrize("gear", [1, -1])
def test_clothoid_ends_at_the_fresnel_integrals(gear):
    # curvature = pi s turns the heading by pi s^2 / 2: the normalised Fresnel integrals
    motion = motion_of([clothoid([0.0, 2.0], [0.0, 2.0 * math.pi], gear=gear)])
    sine, cosine = fresnel(2.0)
    assert motion.end == pytest.approx([gear * cosine, gear * sine, 2.0 * math.pi], abs=1e-13)


def test_piece_without_length_turns_the_robot():
    motion = motion_of([clothoid([0.0, 1.0, 1.0 + 2e-14, 1.0 + 4e-14, 2.0], [0.0, 0.0, 2e13, 0.0, 0.0])])
    assert 0.3 < motion.end[2] < 0.5
    assert motion.end[0] == pytest.approx(1.0 + math.cos(motion.end[2]), abs=1e-12)


def test_polyline_turns_the_short_way_along_arcs():
    motion = motion_of([{"type": "polyline", "poses": [[0, 0, 3.0], [-1.0, 0, -3.0]], "gear": 1}])
    turn = 2.0 * math.pi - 6.0
    assert motion.turn[0] == pytest.approx(turn)
    assert motion.length == pytest.approx((turn / 2.0) / math.sin(turn / 2.0))


# obstacles of the oracle


def test_clearances_against_closed_forms():
    wall = [[1.0, -1.0], [1.2, -1.0], [1.2, 1.0], [1.0, 1.0]]
    case = scene([clothoid([0.0, 0.1], [0.0, 0.0])], obstacles=[wall])
    assert clearance(case, [0.0, 0.0, 0.0]) == pytest.approx(0.6)
    assert clearance(case, [0.0, 0.0, math.pi / 2]) == pytest.approx(0.7)
    assert clearance(case, [0.6 + 3e-6, 0.0, 0.0]) == pytest.approx(-3e-6, rel=1e-6)
    disc = {**case, "footprint": {"radius": 0.5}}
    assert clearance(disc, [0.4, 0.0, 1.0]) == pytest.approx(0.1)
    assert clearance(disc, [0.6, 0.0, 1.0]) == pytest.approx(-0.1)


def test_seam_of_touching_squares_is_solid():
    halves = [[[0.5, -1.0], [1.0, -1.0], [1.0, 0.0], [0.5, 0.0]], [[0.5, 0.0], [1.0, 0.0], [1.0, 1.0], [0.5, 1.0]]]
    needle = {"polygon": [[0.5, 0.0], [0.0, 0.001], [-0.3, 0.1], [-0.3, -0.1], [0.0, -0.001]]}
    case = scene([clothoid([0.0, 0.1], [0.0, 0.0])], obstacles=halves, footprint=needle)
    assert clearance(case, [-1e-3, 0.0, 0.0]) == pytest.approx(1e-3)
    assert clearance(case, [0.1, 0.0, 0.0]) < -1e-4  # each square alone is entered by 2e-4 m only, the two by 0.1 m


def test_cells_unknown_cells_and_everything_off_the_grid_are_obstacles():
    cells = np.zeros((40, 40), dtype=int)
    cells[20, 30], cells[20, 5] = 254, 255
    case = scene(
        [clothoid([0.0, 0.1], [0.0, 0.0])], grid={"cells": cells.tolist(), "resolution": 0.1, "origin": [-2, -2]}
    )
    assert clearance(case, [0.0, 0.0, 0.0]) == pytest.approx(0.6)
    assert clearance(case, [-0.5, 0.0, 0.0]) == pytest.approx(0.5)
    assert clearance(case, [0.0, 1.5, 0.0]) == pytest.approx(0.2)
    assert clearance(case, [5000.0, 0.0, 0.0]) < -4000.0


def test_penetration_depth_is_a_lower_bound():
    rng = np.random.default_rng(7)
    for _ in range(40):
        box = shapely.box(0.2, -0.5, 0.2 + rng.uniform(0.01, 1.0), 0.5)
        pose = np.array([rng.uniform(-0.5, 0.3), rng.uniform(-0.3, 0.3), rng.uniform(-3, 3)])
        case = scene([clothoid([0.0, 0.1], [0.0, 0.0])], obstacles=[shapely.get_coordinates(box)[:-1].tolist()])
        depth = -clearance(case, pose)
        if depth <= 0.0:
            continue
        # sideways by the depth found cannot be enough in any direction
        for heading in np.linspace(-math.pi, math.pi, 60):
            way = 0.999 * depth * np.array([math.cos(heading), math.sin(heading), 0.0])
            assert clearance(case, pose + way) < 0.0


def test_dip_between_samples_is_found():
    # the front right corner of a robot that turns left around a circle passes a tiny post outside of it
    radius, outer = 1.0, math.hypot(0.4, 1.3)
    for heading in np.linspace(0.5, 1.4, 7):
        at = np.array([0.0, radius]) + (outer + 5e-3) * np.array([math.sin(heading), -math.cos(heading)])
        post = (at + 1e-9 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])).tolist()
        case = scene([clothoid([0.0, 1.5], [1.0 / radius, 1.0 / radius])], obstacles=[post])
        found = sweep(case, motion_of(case["path"]), World.of(case))
        assert found.margin.min() == pytest.approx(5e-3, abs=1e-6)


@pytest.mark.parametrize("length", [1.25, 2.5])
@pytest.mark.parametrize("gap", [2e-3, 4e-3])
def test_dip_behind_a_long_wall_is_found(gap, length):
    """A drive along a wall, where every interval looks promising, and a turn in place past a post."""
    wall = [[-2.0, 0.3 + gap], [length - 1.0, 0.3 + gap], [length - 1.0, 0.4], [-2.0, 0.4]]
    turn = {"type": "turn", "start": [length, 0.0, 0.0], "turn": 0.55, "gear": 0}
    for angle in np.linspace(0.02, 0.06, 5) - math.atan2(0.3, 0.4):
        at = np.array([length, 0.0]) + (0.5 + 1e-3) * np.array([math.cos(angle), math.sin(angle)])
        post = (at + 1e-9 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])).tolist()
        case = scene([clothoid([0.0, length], [0.0, 0.0]), turn], obstacles=[wall, post])
        found = sweep(case, motion_of(case["path"]), World.of(case))
        assert found.margin.min() == pytest.approx(1e-3, abs=1e-6)


@pytest.mark.parametrize("length", np.linspace(1.13, 1.16, 7).tolist())
def test_the_peak_of_the_requirement_between_samples_is_found(length):
    """Along a wall at 10 cm, the requirement of the weaker rule rises from the start and falls with the tube to 0."""
    wall = [[-2.0, 0.4], [4.0, 0.4], [4.0, 0.5], [-2.0, 0.5]]
    path = [clothoid([0.0, length], [0.0, 0.0])]
    case = scene(path, obstacles=[wall], clearance=[0.01, 0.0, 0.4], tracking=[0.3, 0.0])
    fall, least = 0.31 / 0.4, 0.1 - 0.005
    peak = least + 0.5 * ((fall * length + 0.5 - least) / (0.5 + fall) - 1.0)
    found = sweep(case, motion_of(path), World.of(case), relief=1.0)
    assert found.margin.min() == pytest.approx(0.1 - peak, abs=1e-6)


def test_the_oracle_shares_no_code_with_the_library():
    names = ", ".join(
        f"experiments.fuzz.oracle.{name}" for name in ("motion", "world", "sweep", "rules", "timing", "views", "cells")
    )
    code = f"import {names}, sys; sys.exit(any(name.split('.')[0] == 'optdock' for name in sys.modules))"
    assert subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=False).returncode == 0


# views of the oracle


def seen(gears, marker, camera, visible=1e3, blind=0.0):
    """Return the oracle's view of a path that ends at the origin."""
    whole = {"mount": [0.0, 0.0, 0.0], "field_of_view": 1.0, "min_range": 0.0, "max_range": None, **camera}
    case = {"path": gears, "camera": whole, "marker": marker, "visible_distance": visible, "blind_distance": blind}
    motion = motion_of(gears)
    return views({**case, "dock": {"pose": motion.end.tolist()}, "start": motion.start.tolist()}, motion)


def test_views_against_closed_forms():
    straight = [clothoid([0.0, 2.0], [0.0, 0.0])]
    found = seen(straight, [1.0, 0.5], {})
    assert found.bearing.max() == pytest.approx(math.atan2(0.5, 1.0))
    assert found.inside.min() == pytest.approx(math.hypot(1.0, 0.5) * math.sin(0.5 - math.atan2(0.5, 1.0)))
    # Past the marker, which is nearest where it is abeam: between two samples.
    past = seen(straight, [-0.7654321, 0.5], {"field_of_view": 2.0 * math.pi, "min_range": 0.1})
    assert past.distance.min() == pytest.approx(0.5, abs=1e-9)
    assert past.inside.min() == pytest.approx(0.4, abs=1e-9)
    turn = [{"type": "turn", "start": [0.0, 0.0, 0.0], "turn": -0.7, "gear": 0}]
    ahead = [math.cos(0.7), math.sin(0.7)]  # of the robot before it turned
    assert seen(turn, ahead, {}).bearing.max() == pytest.approx(0.7)


def test_views_are_limited_to_the_stretch():
    gears = [clothoid([0.0, 1.0, 3.0], [0.0, 0.0, 0.0])]
    found = seen(gears, [1.0, 0.0], {}, visible=1.25, blind=0.5)
    assert (found.s.min(), found.s.max()) == pytest.approx((1.75, 2.5), abs=1e-7)
    assert not seen(gears, [1.0, 0.0], {}, visible=4.0, blind=3.5).s.size


# rules of the oracle


def broken(case):
    return {finding.kind for finding in findings(case, motion_of(case["path"])) if finding.is_broken}


def test_rules_of_a_path():
    arc = scene([clothoid([0.0, 1.0], [0.5, 0.5])])
    assert broken(arc) == set()
    assert broken({**arc, "limits": {"max_curvature": 0.5 * (1.0 - 3e-6)}}) == {"curvature"}
    assert broken({**arc, "limits": {"max_curvature": 0.5 * (1.0 - 1e-6)}}) == set()
    assert broken({**arc, "dock": {**arc["dock"], "direction": "backward"}}) == {"direction"}
    assert broken({**arc, "dock": {**arc["dock"], "final_straight": 0.3}}) == {"final_straight"}
    assert broken({**arc, "start": [0.0, 3e-6, 0.0]}) == {"start"}
    crab = [[0.01 * i, 0.01 * i * math.tan(0.0099), 0.0] for i in range(300)]
    assert broken(scene([{"type": "polyline", "poses": crab, "gear": 1}])) == {"slip"}


def test_turns_in_place_are_no_length_that_allows_slip():
    crab = [[0.01 * i, 0.01 * i * 0.0013, 0.0] for i in range(109)]  # drifts by 1.4 mm; 1.2 mm are allowed
    turn = {"type": "turn", "start": crab[-1], "turn": -21.0, "gear": 0}
    case = scene([{"type": "polyline", "poses": crab, "gear": 1}, turn])
    found = max(finding.ratio for finding in findings(case, motion_of(case["path"])) if finding.kind == "slip")
    assert found == pytest.approx(1.4e-3 / 1.2e-3, rel=0.05)


def test_motion_ratios_against_closed_forms():
    # v = 0.4 m/s at constant speed over an arc of curvature 2, then over a clothoid of rate 1
    path = [clothoid([0.0, 1.0, 2.0], [2.0, 2.0, 3.0])]
    case = {
        "path": path,
        "law": {"durations": [5.0], "jerks": [0.0], "start_speed": 0.4, "start_acceleration": 0.0},
        "limits": {"max_speed": 0.5, "max_yaw_rate": 1.0, "max_lateral_acceleration": 1.0, "max_wheel_speed": 1.0,
                   "track_width": 0.5, "max_yaw_acceleration": 1.0, "max_lateral_jerk": 1.0},
        "zone": [0.2, 0.5],
        "start_speed": 0.4,
    }  # fmt: skip
    found = judge_timing(case, motion_of(path))
    assert found.ratios["speed"] == pytest.approx(2.0)
    assert found.ratios["yaw_rate"] == pytest.approx(1.2)
    assert found.ratios["lateral_acceleration"] == pytest.approx(0.48)
    assert found.ratios["wheel_speed"] == pytest.approx(0.7)
    assert found.ratios["yaw_acceleration"] == pytest.approx(0.16)
    assert found.ratios["lateral_jerk"] == pytest.approx(0.064)
    assert set(found.broken) == {"speed", "yaw_rate", "rest"}
    assert found.structure["start_state"] == 0.0


# cases and campaigns


@pytest.mark.parametrize("kind", sorted(KINDS))
def test_a_case_is_determined_by_seed_and_number_and_survives_a_file(kind, tmp_path):
    for number in range(1 if kind == "impossibilities" else 3):  # carved scenes are expensive
        case = KINDS[kind].draw(rng_of(kind, 3, number))
        again = KINDS[kind].draw(rng_of(kind, 3, number))
        assert json.dumps(case) == json.dumps(again)
        save_case(tmp_path / "case.json", case, Verdict("late"), "")
        assert json.dumps(load_case(tmp_path / "case.json")) == json.dumps(case)
    assert json.dumps(KINDS[kind].draw(rng_of(kind, 4, number))) != json.dumps(case)


@pytest.mark.parametrize("name", sorted(PLANTS))
def test_planted_mistakes_are_found(name):
    motions = ("dropped_time_cell", "rest_x5", "lateral_jerk_order", "lateral_jerk_at_ends_only")
    kinds = {**dict.fromkeys(motions, "trajectories"), "dropped_new_obstacle": "replans"}
    kind = (kinds | {"dropped_measured_pose": "measured"}).get(name, "views" if name.startswith("view_") else "paths")
    cases = (KINDS[kind].draw(rng_of(kind, SEEDS[name], number)) for number in range(12))
    quick = (case for case in cases if "path" in case or "question" not in case)  # the others plan first
    assert any(judge_once(case, name).is_fault for case in quick)


def test_steering_rate_is_evaluated_at_zero_curvature():
    """Away from knots and middles: the curvature changes its sign at a third of the distance."""
    case = {
        "path": [clothoid([0.0, 0.3], [-20.0, 40.0])],
        "law": {"durations": [3.0], "jerks": [0.0], "start_speed": 0.1, "start_acceleration": 0.0},
        "limits": {"wheelbase": 2.0, "max_steering_rate": 1.0},
        "zone": [None, 0.0],
        "start_speed": 0.1,
    }
    assert judge_timing(case, motion_of(case["path"])).ratios["steering_rate"] == pytest.approx(2.0 * 200.0 * 0.1)


def test_tightened_limits_bind_and_a_mistake_is_found():
    cases = [KINDS["limits"].draw(rng_of("limits", 6, number)) for number in range(20)]
    case = next(case for case in cases if "path" in case and len(case["path"]) == 1 and case["plugin"] == "NearOptimal")
    assert judge_once(case, None) == Verdict("certified")
    assert judge_once(case, "lateral_jerk_order").signature.endswith("lateral_jerk")
    assert judge_once(case, "lateral_jerk_order").is_fault


def test_cut_equals_the_piece_of_the_library():
    gears = [
        clothoid([0.0, 0.5, 1.0], [0.0, 1.0, -0.5]),
        {"type": "turn", "start": [0.0, 0.0, 0.0], "turn": -1.2, "gear": 0},
        {"type": "polyline", "poses": [[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.2, 0.0, 0.0]], "gear": 1},
    ]
    path = path_of(gears)
    for begin, end in ((0.0, 2.4), (0.3, 0.8), (0.7, 1.9), (1.0, 1.5), (2.25, 2.35)):
        rest, mine = path.piece(begin, end), path_of(cut(gears, begin, end))
        s = np.linspace(0.0, rest.length, 50)
        assert mine.length == pytest.approx(rest.length, abs=1e-9)
        assert mine.poses_at(s) == pytest.approx(rest.poses_at(s), abs=1e-8)


def test_a_path_that_cannot_be_cut_everywhere_is_minimised():
    """Without the knot at the end of a spike, the curvature of the spike holds along a metre."""
    spike = clothoid([0.0, 0.5, 0.5 + 1e-13, 0.5 + 2e-13, 1.5], [0.0, 0.0, 1e12, 0.0, 0.0])
    case = {**scene([spike]), "kind": "paths"}
    smaller = minimised(case, Verdict("false refusal"), lambda _: Verdict("false refusal"))
    assert len(smaller["path"][0]["knots"]) == 2


def test_shrinking_keeps_the_fault():
    posts = [[[x, 1.0], [x + 0.1, 1.0], [x, 1.1]] for x in range(6)]
    case = scene([clothoid([0.0, 0.5, 1.0, 1.5], [0.0, 0.1, 0.0, 0.0])], obstacles=posts, limits={"max_speed": 1.0})

    def judge(one):
        fails = any(post[0][0] == 3 for post in one["obstacles"]) and len(one["path"][0]["knots"]) > 2
        return Verdict("false certificate", "clearance: x") if fails else Verdict("certified")

    small = minimised(case, judge(case), judge)
    assert small["obstacles"] == [posts[3]]
    assert len(small["path"][0]["knots"]) == 3
    assert small["limits"] == {}
    assert len(case["obstacles"]) == 6


def test_a_saved_case_can_be_replayed(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("experiments.fuzz.campaign.prepare", lambda: None)  # no limits for the process of the tests
    plant = "dropped_obstacle"
    drawn = (KINDS["paths"].draw(rng_of("paths", SEEDS[plant], number)) for number in range(12))
    target = tmp_path / "found.json"
    save_case(
        target, next(case for case in drawn if judge_once(case, plant).is_fault), Verdict("false certificate"), ""
    )
    assert main(["--replay", str(target), "--plant", plant]) == 1
    assert capsys.readouterr().out.startswith(("false certificate", "overclaimed bound"))


@pytest.mark.parametrize(("lane", "status"), [("own", 0), ("both", 1)])
def test_a_case_is_replayed_in_the_given_lanes(tmp_path, monkeypatch, lane, status):
    monkeypatch.setattr("experiments.fuzz.campaign.prepare", lambda: None)
    honest = lanes.certify_path
    monkeypatch.setattr(lanes, "certify_path", lambda *asked: replace(honest(*asked), min_clearance=math.nan))
    target = tmp_path / "found.json"
    save_case(target, scene([clothoid([0.0, 1.0], [0.0, 0.0])]), Verdict("kernel differs"), "")
    assert main(["--replay", str(target), "--lanes", lane]) == status


@pytest.mark.parametrize("text", [None, "", "[]", "{}", '{"case": '])
def test_what_is_no_saved_case_is_not_replayed(tmp_path, capsys, text):
    target = tmp_path / "found.json"
    if text is not None:
        target.write_text(text, encoding="utf-8")
    assert main(["--replay", str(target)]) == 2
    assert f"--replay: {target} is no saved case" in capsys.readouterr().err


def test_a_campaign_counts_its_cases_and_ends_by_count(tmp_path, capsys):
    options = ["--kinds", "trajectories", "--count", "5", "--jobs", "1", "--seed", "0", "--out", str(tmp_path)]
    status = main(options)
    assert "trajectories: 5 cases" in capsys.readouterr().out
    assert status == (1 if list(tmp_path.glob("*.json")) else 0)


def test_unknown_kinds_are_refused(capsys):
    assert main(["--kinds", "paths,pathes"]) == 2
    assert "pathes" in capsys.readouterr().err


# Chosen so that a mistake is found within a dozen cases; `--plant NAME` finds it from any seed.
SEEDS = {
    "tolerance_x5": 0,
    "always_true": 0,
    "first_order_centimetre": 0,
    "dropped_obstacle": 0,
    "dropped_map_cell": 6,
    "dropped_new_obstacle": 9,
    "dropped_measured_pose": 0,
    "dropped_path_cell": 3,
    "dropped_time_cell": 24,
    "curvature_x5": 0,
    "rest_x5": 9,
    "lateral_jerk_order": 3,
    "lateral_jerk_at_ends_only": 6,
    "view_at_rest": 0,
    "view_of_one_edge": 1,
    "view_tolerance_x5": 9,
}


def test_path_that_ends_with_a_turn_is_shrunk():
    """Regression: its last gear has neither poses nor knots."""
    case = KINDS["paths"].draw(rng_of("paths", 991, 14515))
    assert case["path"][-1]["type"] == "turn"
    smaller = minimised(case, Verdict("false refusal"), lambda one: Verdict("false refusal"))
    assert len(smaller["path"]) == 1


@pytest.mark.parametrize("rule", [[0.2, 0.0, 0.0], [0.05, 0.0, 0.3], [0.2, 0.05, 0.3, 0.4, 0.1]])
def test_requirement_within_the_steps_of_a_witness(rule):
    # A step that begins with a low requirement near the start, and ends with a low requirement near the goal.
    poses = np.array([[0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [2.6, 0.0, 0.0], [2.8, 0.0, 0.0]])
    enough = required_between(rule, poses, 0.005, SQUARE)
    case = {"clearance": rule, "footprint": {"polygon": SQUARE}, "start": [0.0] * 3, "dock": {"pose": [2.8, 0.0, 0.0]}}
    for step in range(3):
        share = np.random.default_rng(step).uniform(size=(1000, 1))
        within = poses[step] + share * (poses[step + 1] - poses[step])
        asked = required_at(case, within, 0.005, 4.0 * math.hypot(0.4, 0.3))
        assert (asked <= enough[step]).all()
        assert enough[step] < asked.max() + 0.02


# lanes, and campaigns that are continued


@pytest.fixture
def both_lanes():
    with lanes.using_lanes("both"):
        yield


def test_lanes_are_compared_and_a_difference_is_found(both_lanes, monkeypatch):
    case = scene([clothoid([0.0, 1.0], [0.0, 0.0])], obstacles=[[[0.0, 0.5], [0.5, 0.5], [0.5, 0.6]]], margins=[1e-3])
    assert paths.judge(case) == Verdict("certified")
    assert paths.judge(case).checked == {"certificates": 2}
    honest = lanes.certify_path

    def mistaken(path, problem):
        found = honest(path, problem)
        return replace(found, min_clearance=found.min_clearance + 1e-8) if problem.clearance.required else found

    monkeypatch.setattr(lanes, "certify_path", mistaken)
    found = paths.judge(case)
    assert found.signature == "kernel differs: certify_path min_clearance"
    assert found.evidence["clearance"][0] == pytest.approx(0.2 - 1e-3)


@pytest.mark.parametrize("longest", plans._COUNTED)
def test_a_budget_that_ends_in_one_lane_alone_is_no_difference_of_the_lanes(both_lanes, monkeypatch, longest):
    honest, asked = plans.plan_dock, []

    def other(problem, time_budget):
        """Plan the motion of a slower robot by NumPy within budgets up to `longest`."""
        asked.append(time_budget)
        if kernels_lane() == "twin" and time_budget <= longest:
            limits = replace(problem.robot.limits, max_speed=0.9 * problem.robot.limits.max_speed)
            problem = replace(problem, robot=replace(problem.robot, limits=limits))
        return honest(problem, time_budget=time_budget)

    case = {**problem_spec(instance("open_s", 0).problem), "kind": "plans", "budget": 5.0, "repeated": True}
    monkeypatch.setattr(plans, "plan_dock", other)
    found = plans.judge(case)
    assert found.outcome == ("certified" if longest == plans._COUNTED[0] else "kernel differs")
    assert asked == [5.0, *np.repeat(plans._COUNTED, 2)]


def test_a_further_requirement_without_room_is_not_certified(monkeypatch):
    case = scene([clothoid([0.0, 1.0], [0.0, 0.0])], obstacles=[[[0.8, 0.5], [0.9, 0.5], [0.9, 0.6]]], margins=[-3e-6])
    assert paths.judge(case).checked == {"certificates": 1}
    monkeypatch.setattr(paths, "_FORGIVEN", 1e-9)  # an oracle with a smaller tolerance
    assert paths.judge({**case, "margins": [-5e-7]}).outcome == "false certificate"


def test_a_campaign_is_continued(tmp_path):
    rows = [["trajectories", 0, "certified", {}, 0.1], ["trajectories", 1, "certified", {}, 0.1]]
    text = "".join(json.dumps(row) + "\n" for row in rows)
    file = tmp_path / "0.jsonl"
    file.write_text(text + '["trajectories", 2, "cer', encoding="utf-8")  # a process that was killed
    options = ["--kinds", "trajectories", "--seed", "0", "--out", str(tmp_path), "--count", "4", "--resume"]
    command = [sys.executable, "-m", "experiments.fuzz", *options]
    told = subprocess.run(command, cwd=ROOT, check=False, capture_output=True, text=True, timeout=100).stdout
    assert "trajectories: 4 cases" in told
    after = file.read_text(encoding="utf-8")
    assert after.startswith(text)
    assert [json.loads(line)[1] for line in after.splitlines() if line.endswith("]")] == [0, 1, 2, 3]


@pytest.mark.parametrize(("rim", "is_closed"), [(0.5, True), (0.1, False)])
def test_leaks_of_cells_are_found(rim, is_closed):
    """A room of 1.5 m by 1.3 m: cells around its middle, whose rim is in the walls or in free space."""
    case = {"footprint": {"polygon": SQUARE}, "clearance": [0.0, 0.0, 0.0], "start": [3.0, 0.0, 0.0]}
    walls = [shapely.box(-1, -1, 1, -0.65), shapely.box(-1, 0.65, 1, 1), shapely.box(-1, -1, -0.75, 1),
             shapely.box(0.75, -1, 1, 1)]  # fmt: skip
    case |= {"obstacles": [shapely.get_coordinates(wall)[:-1].tolist() for wall in walls], "dock": {"pose": [0.0] * 3}}
    inside = np.ones((1, 4, 4), dtype=bool)
    cells = Cells((-rim, -rim), rim / 2.0, 1, (0.0, 0.0), np.array([[0, 0, 0]]), (inside,))
    found = leak(case, cells, ([0.0] * 3, [3.0, 0.0, 0.0]), np.random.default_rng(0))
    assert bool(found) != is_closed
