"""Damages of plan files with a proof, after each of which the file is no true statement, or its proof is incomplete.

A damage returns False if it cannot be applied, or if an evaluation that is independent of the judge (poses of the
oracle, areas and distances by shapely, sums of polynomials) does not show that the file has become false.
"""

from __future__ import annotations

import itertools
import json
import math
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
import shapely

from experiments.fuzz.oracle.motion import motion_of
from experiments.fuzz.oracle.world import placed

if TYPE_CHECKING:
    from collections.abc import Callable

    from experiments.fuzz.case import Case

    Floats = np.ndarray

__all__ = ["DAMAGES", "HOSTILE", "damaged"]

Rng: TypeAlias = np.random.Generator
_MOST_TURN = 1e4  # [rad] of a clothoid, which the oracle divides into small turns
_SEEN = 1e-4  # [m], [m^2]: what an evaluation must find, far above all tolerances


def _gears(document: Case) -> list[Case]:
    """Return the path of a plan file in the form of the oracle."""
    kinds = {True: "turn", False: "clothoid"}
    return [
        {**curve, "type": kinds["turn" in curve], "gear": curve.get("direction", 0)}
        for curve in document["path"]["segments"]
    ]


def _poses(document: Case, count: int = 60) -> Floats:
    motion = motion_of(_gears(document))
    piece = np.linspace(0, motion.s.size - 1, count).astype(np.int64)
    return motion.poses_at(piece, np.linspace(0.0, 1.0, count))


def _outlines(document: Case, poses: Floats) -> Any:  # noqa: ANN401 - shapely has no types
    return shapely.polygons(placed(np.array(document["proof"]["robot"]["footprint"]), poses))


def _misses_the_dock(document: Case) -> bool:
    """Whether the path ends away from the dock, or jumps between its segments."""
    motion = motion_of(_gears(document))
    ends = [motion.ends_of(segment) for segment in motion.segments]
    gaps = [after[0] - before[1] for before, after in itertools.pairwise(ends)]
    gaps += [ends[0][0] - document["proof"]["start"]["pose"], ends[-1][1] - document["proof"]["dock"]["pose"]]
    wrapped = np.array(gaps)
    wrapped[:, 2] = np.remainder(wrapped[:, 2] + math.pi, 2.0 * math.pi) - math.pi
    return bool(np.abs(wrapped).max() > _SEEN)


def _obstacle_moved_in(rng: Rng, document: Case) -> bool:
    rocks = document["proof"]["obstacles"]
    if not rocks:
        return False
    index, poses = int(rng.integers(len(rocks))), _poses(document)
    outline = _outlines(document, poses[[int(rng.integers(len(poses)))]])[0]
    rock, inside = np.array(rocks[index]), np.array(outline.representative_point().coords[0])
    moved = rock - rock.mean(axis=0) + inside
    rocks[index] = moved.tolist()
    return bool(shapely.area(shapely.intersection(outline, shapely.convex_hull(shapely.multipoints(moved)))) > _SEEN)


def _thin_obstacle_added(rng: Rng, document: Case) -> bool:
    """Add a needle of a tenth of a millimetre across the swept area, between two cells or anywhere."""
    poses = _poses(document, 200)
    outline = _outlines(document, poses[[int(rng.integers(len(poses)))]])[0]
    x, y = outline.representative_point().coords[0]
    angle, long = rng.uniform(0.0, math.pi), rng.uniform(0.001, 0.3)
    along, across = np.array([math.cos(angle), math.sin(angle)]), np.array([-math.sin(angle), math.cos(angle)])
    ring = [along * a * long + across * b * 1e-4 + [x, y] for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    document["proof"]["obstacles"].append(np.array(ring).tolist())
    return bool(shapely.area(shapely.intersection(outline, shapely.Polygon(ring))) > 1e-9)


def _footprint_grown(rng: Rng, document: Case) -> bool:
    robot, factor = document["proof"]["robot"], float(rng.uniform(1.2, 3.0))
    robot["footprint"] = (factor * np.array(robot["footprint"])).tolist()
    if "pieces" in robot:
        robot["pieces"] = [(factor * np.array(piece)).tolist() for piece in robot["pieces"]]
    outlines = _outlines(document, _poses(document))
    hulls = [shapely.convex_hull(shapely.multipoints(rock)) for rock in document["proof"]["obstacles"]]
    return bool(hulls) and float(shapely.area(shapely.intersection(outlines[:, None], np.array(hulls))).max()) > _SEEN


def _clearance_raised(rng: Rng, document: Case) -> bool:
    """Require more at the dock than the goal has, where no start reduces the requirement."""
    proof = document["proof"]
    rule, goal = proof["clearance"], np.array([proof["dock"]["pose"]])
    rocks = [shapely.convex_hull(shapely.multipoints(rock)) for rock in proof["obstacles"]]
    if not rocks:
        return False
    found = float(shapely.distance(_outlines(document, goal)[0], np.array(rocks)).min())
    apart = math.dist(proof["dock"]["pose"][:2], proof["start"]["pose"][:2])
    wanted = found + float(rng.choice([1e-3, 0.01, 0.1]))
    rule["at_dock"], rule["required"] = wanted, max(rule["required"], wanted)
    return wanted < 0.5 * (apart - rule["start_relief"])


def _limit_tightened(rng: Rng, document: Case) -> bool:
    """Set a limit below a value that the phases or the curvatures attain."""
    limits, gears = document["proof"]["robot"]["limits"], _gears(document)
    driven = [gear for gear in gears if gear["gear"]]
    attained: dict[str, float] = {}
    if driven:
        attained["max_curvature"] = max(abs(k) for gear in driven for k in gear["curvature"])
    phases = document.get("trajectory", {}).get("phases")
    if phases is not None and len(driven) == len(gears):
        _, v, a = phases["start"]
        for duration, jerk in zip(phases["durations"], phases["jerks"], strict=True):
            v, a = v + duration * (a + 0.5 * duration * jerk), a + duration * jerk
            attained["max_jerk"] = max(attained.get("max_jerk", 0.0), abs(jerk) if duration > 1e-3 else 0.0)
            attained["max_acceleration"] = max(attained.get("max_acceleration", 0.0), a)
            attained["max_deceleration"] = max(attained.get("max_deceleration", 0.0), -a)
            name = "max_speed" if driven[0]["gear"] > 0 else "max_reverse_speed"
            if len(driven) == 1:
                attained[name] = max(attained.get(name, 0.0), v)
    names = [name for name, value in attained.items() if value > 0.01]
    if not names:
        return False
    name = str(rng.choice(names))
    limits[name] = attained[name] * float(rng.choice([0.999, 0.9, 0.1]))
    return True


def _start_moved(rng: Rng, document: Case) -> bool:
    holder, key = [(document["proof"]["start"], "pose"), (document["proof"]["dock"], "pose"),
                   (document["path"]["segments"][0], "start")][int(rng.integers(3))]  # fmt: skip
    holder[key][int(rng.integers(3))] += float(rng.choice([-1.0, 1.0])) * 10.0 ** float(rng.uniform(-3.5, 0.0))
    return _misses_the_dock(document)


def _curvature_changed(rng: Rng, document: Case) -> bool:
    curves = [curve for curve in document["path"]["segments"] if "knots" in curve]
    if not curves:
        return False
    curve = curves[int(rng.integers(len(curves)))]
    values = curve[str(rng.choice(["curvature", "knots"]))]
    values[int(rng.integers(len(values)))] += float(rng.normal(0.0, 0.1))
    if np.abs(np.diff(curve["knots"])).max() * np.abs(curve["curvature"]).max() > _MOST_TURN:
        return False
    try:
        return _misses_the_dock(document)
    except (ValueError, ZeroDivisionError, IndexError):
        return False


def _gear_flipped(rng: Rng, document: Case) -> bool:
    curves = [curve for curve in document["path"]["segments"] if "direction" in curve]
    if not curves:
        return False
    curve = curves[int(rng.integers(len(curves)))]
    curve["direction"] = -curve["direction"]
    return _misses_the_dock(document)


def _phase_changed(rng: Rng, document: Case) -> bool:
    """Change a duration or a jerk such that the motion ends elsewhere."""
    phases = document.get("trajectory", {}).get("phases")
    if phases is None:
        return False
    values = phases[str(rng.choice(["durations", "jerks"]))]
    values[int(rng.integers(len(values)))] *= float(rng.choice([0.0, 0.5, 0.99, 1.01, 2.0]))
    s, v, a = phases["start"]
    for t, j in zip(phases["durations"], phases["jerks"], strict=True):
        s, v, a = s + t * (v + t * (0.5 * a + t * j / 6.0)), v + t * (a + 0.5 * t * j), a + t * j
    return max(abs(s - motion_of(_gears(document)).length), abs(v), abs(a)) > _SEEN


def _start_state_changed(rng: Rng, document: Case) -> bool:
    if "trajectory" not in document:
        return False
    document["proof"]["start"][str(rng.choice(["speed", "acceleration"]))] += float(rng.choice([-1.0, 1.0])) * 0.05
    return document["proof"]["start"]["speed"] != 0.0 or document["proof"]["start"]["acceleration"] != 0.0


def _plane_turned(rng: Rng, document: Case) -> bool:
    """Turn all directions of an obstacle by half a turn: they then point to the obstacle, and separate nothing."""
    proof = document["proof"]
    if not proof["obstacles"] or proof["clearance"]["required"] < _SEEN:
        return False
    index = int(rng.integers(len(proof["obstacles"])))
    for plane in (plane for part in proof["cells"] for cell in part["planes"] for plane in cell):
        plane[2] += math.pi if plane[0] == index else 0.0
    return _boxes_meet(document, index)


def _planes_removed(rng: Rng, document: Case) -> bool:
    """Remove all directions of an obstacle whose bounding box overlaps that of a piece of the robot somewhere."""
    proof = document["proof"]
    if not proof["obstacles"]:
        return False
    index = int(rng.integers(len(proof["obstacles"])))
    for part in proof["cells"]:
        part["planes"] = [[plane for plane in cell if plane[0] != index] for cell in part["planes"]]
    return _boxes_meet(document, index)


def _boxes_meet(document: Case, index: int) -> bool:
    """Whether the bounding box of an obstacle overlaps that of a piece of the robot, so that a direction is needed."""
    proof = document["proof"]
    pieces = proof["robot"].get("pieces", [proof["robot"]["footprint"]])
    poses = _poses(document)
    boxes = np.concatenate([shapely.bounds(shapely.polygons(placed(np.array(piece), poses))) for piece in pieces])
    low, high = np.min(proof["obstacles"][index], axis=0) + _SEEN, np.max(proof["obstacles"][index], axis=0) - _SEEN
    return bool(np.any(np.all((boxes[:, :2] <= high) & (boxes[:, 2:] >= low), axis=1)))


def _cell_removed(rng: Rng, document: Case) -> bool:
    """Remove the first or the last cell, or the planes of one cell."""
    part = document["proof"]["cells"][int(rng.integers(len(document["proof"]["cells"])))]
    at = int(rng.choice([0, -1]))
    part["planes"].pop(at)
    if rng.uniform() < 0.7:
        part["borders"].pop(at)
    return True


def _cells_stretched(rng: Rng, document: Case) -> bool:
    part = document["proof"]["cells"][int(rng.integers(len(document["proof"]["cells"])))]
    borders = part["borders"]
    change = int(rng.integers(4))
    if change == 0:
        borders[:] = [float(rng.choice([0.999, 1.001])) * one for one in borders]
    elif change == 1:
        borders[:] = [one + float(rng.choice([-1e-6, 1e-6])) for one in borders]
    elif change == 2:
        borders.reverse()
    else:
        index = int(rng.integers(1, len(borders)))
        borders[index] = borders[index - 1]
    return True


def _region_shrunk(rng: Rng, document: Case) -> bool:
    """Shrink the region below the swept area, so that nothing is stated about a part of it."""
    region, poses = document["proof"]["region"], _poses(document)
    side = int(rng.integers(4))
    region[side] = float(poses[:, side % 2].mean())
    boxes = shapely.bounds(_outlines(document, poses))
    outside = (boxes[:, side] < region[side] - _SEEN) if side < 2 else (boxes[:, side] > region[side] + _SEEN)
    return bool(outside.any())


def _key_removed(rng: Rng, document: Case) -> bool:
    proof = document["proof"]
    optional = {"pieces", "approach_speed", "visible_distance"}
    if "trajectory" not in document:
        optional |= {"speed", "acceleration", "curvature", "approach_distance"}
    if "turn" in document["path"]["segments"][0]:
        optional.add("curvature")  # a turn in place has no curvature
    places = [(proof, key) for key in proof] + [(document, "proof"), (document, "path")]
    places += [(proof[part], key) for part in ("robot", "start", "dock", "clearance") for key in proof[part]]
    places = [(holder, key) for holder, key in places if key not in optional]
    holder, key = places[int(rng.integers(len(places)))]
    del holder[key]
    return True


def _turn_forbidden(_: Rng, document: Case) -> bool:
    document["proof"]["robot"]["turning"] = None
    return any("turn" in curve for curve in document["path"]["segments"])


DAMAGES: dict[str, Callable[[Rng, Case], bool]] = {
    damage.__name__.strip("_"): damage
    for damage in (
        _obstacle_moved_in, _thin_obstacle_added, _footprint_grown, _clearance_raised, _limit_tightened, _start_moved,
        _curvature_changed, _gear_flipped, _phase_changed, _start_state_changed, _plane_turned, _planes_removed,
        _cell_removed, _cells_stretched, _region_shrunk, _key_removed, _turn_forbidden,
    )
}  # fmt: skip

HOSTILE = ("NaN", "Infinity", "-Infinity", "1e999", "true", "null", '"1"', "[]", "{}", "1" + "0" * 400, "1e308")


def damaged(text: str, name: str, rng: Rng, other: str) -> str | None:
    """Return the text of a plan file with a damage, or None if the damage does not apply.

    Args:
        text: The undamaged file.
        name: A key of `DAMAGES`, `hostile` (a number is replaced), `swapped` (a part of another file), `repeated`.
        rng: Random generator.
        other: Another plan file.
    """
    document = json.loads(text)
    if name == "hostile":
        numbers = [
            (holder, key)
            for holder in (document["proof"]["start"]["pose"], document["path"]["segments"][0]["start"])
            for key in range(3)
        ]
        holder, key = numbers[int(rng.integers(len(numbers)))]
        holder[key] = "\u0000"
        return json.dumps(document).replace(json.dumps("\u0000"), str(rng.choice(HOSTILE)))
    if name == "repeated":
        key = str(rng.choice(["proof", "path"]))
        return f"{text[:-1]}, {json.dumps(key)}: {json.dumps(document[key])}}}"
    if name == "swapped":
        return _swapped(document, json.loads(other), str(rng.choice(["path", "proof", "cells", "trajectory"])))
    return json.dumps(document) if DAMAGES[name](rng, document) else None


def _swapped(document: Case, foreign: Case, key: str) -> str | None:
    """Return the text with a part of a file of another path, or None if the parts may fit together."""
    apart = abs(motion_of(_gears(document)).length - motion_of(_gears(foreign)).length) > _SEEN
    if key == "cells":
        document["proof"]["cells"] = foreign["proof"]["cells"]
        return json.dumps(document) if apart else None
    if key == "trajectory" and key not in document:
        return None
    document[key] = foreign[key]
    return json.dumps(document) if (apart if key == "trajectory" else _misses_the_dock(document)) else None
