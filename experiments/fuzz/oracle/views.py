"""The view of the dock along a path, by bearings and distances: sampled densely, then refined around minima."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from experiments.fuzz.oracle.sweep import taper_share

if TYPE_CHECKING:
    from experiments.fuzz.case import Case
    from experiments.fuzz.oracle.motion import Floats, Ints, Motion

__all__ = ["Views", "looked_at", "views"]

_STEP = 0.01  # [m], [rad] between initial samples
_MOST = 3000  # initial samples, approximately
_KEPT, _PARTS, _ROUNDS = 10, 8, 7  # refined: neighbourhoods, samples in each, rounds; 0.01 m becomes a micrometre
_EDGE = 1e-9  # [m] per metre driven: rounding of the ends of the stretch


@dataclass(frozen=True)
class Views:
    """Samples of the part of a path with required view, Shape (n,) each, may be empty.

    `bearing` [rad] from the camera's axis, unsigned; `distance` [m] from it; `inside` [m]: displacement of the marker,
    in the camera frame, that leaves the view; `spare`: `inside` minus the requirement of the tracking tube.
    """

    s: Floats
    bearing: Floats
    distance: Floats
    inside: Floats
    spare: Floats


def views(case: Case, motion: Motion) -> Views:
    """Return the view of a case's camera along the stretch with required view."""
    piece, share = _first_places(case, motion)
    found = looked_at(case, motion, piece, share)
    for _ in range(_ROUNDS):
        if not piece.size:
            break
        more = _around_the_least(piece, share, np.minimum(found.spare, found.inside))
        piece, share = np.append(piece, more[0]), np.append(share, more[1])
        order = np.lexsort((share, piece))
        piece, share = piece[order], share[order]
        found = looked_at(case, motion, piece, share)
    return found


def looked_at(case: Case, motion: Motion, piece: Ints, share: Floats) -> Views:
    """Return the view of the camera from places of a motion."""
    poses, camera = motion.poses_at(piece, share), case["camera"]
    x, y, turned = camera["mount"]
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    marker = _marker(case)
    dx, dy = marker[0] - poses[:, 0] - c * x + s * y, marker[1] - poses[:, 1] - s * x - c * y
    distance = np.hypot(dx, dy)
    bearing = np.abs(np.remainder(np.arctan2(dy, dx) - poses[:, 2] - turned + math.pi, 2.0 * math.pi) - math.pi)
    bearing = np.where(distance > 0.0, bearing, 0.0)
    inside = np.full(distance.size, np.inf)
    if camera["field_of_view"] < 2.0 * math.pi:
        to_edge = 0.5 * camera["field_of_view"] - bearing
        inside = np.where(to_edge >= 0.5 * math.pi, distance, distance * np.sin(to_edge))
    if camera["min_range"] > 0.0:
        inside = np.minimum(inside, distance - camera["min_range"])
    if camera["max_range"] is not None:
        inside = np.minimum(inside, camera["max_range"] - distance)
    required = _required(case, motion, poses, marker, inside) if case.get("tracking") else 0.0
    return Views(motion.s_at(piece, share), bearing, distance, inside, inside - required)


def _marker(case: Case) -> tuple[float, float]:
    (x, y, yaw), (forward, left) = case["dock"]["pose"], case["marker"]
    return x + math.cos(yaw) * forward - math.sin(yaw) * left, y + math.sin(yaw) * forward + math.cos(yaw) * left


def _required(case: Case, motion: Motion, poses: Floats, marker: tuple[float, float], inside: Floats) -> Floats:
    """Return the loss of view by a pose error within the tube, tapered at the dock and limited by the start."""
    off, turn = case["tracking"]
    goal, start = case["dock"]["pose"], case["start"]
    to_goal, to_start, to_marker = (np.hypot(poses[:, 0] - at[0], poses[:, 1] - at[1]) for at in (goal, start, marker))
    untubed = {key: value for key, value in case.items() if key != "tracking"}
    begun = looked_at(untubed, motion, np.zeros(1, dtype=np.int64), np.zeros(1)).inside[0] if inside.size else 0.0
    lost: Floats = np.minimum(
        taper_share(case, to_goal) * (off + 2.0 * math.sin(0.5 * turn) * to_marker), max(begun, 0.0) + 0.5 * to_start
    )
    return lost


def _first_places(case: Case, motion: Motion) -> tuple[Ints, Floats]:
    """Return places, evenly over every piece of the stretch, including its ends."""
    driven = np.where(motion.gear == 0.0, 0.0, motion.h)
    left = np.sum(driven) - (np.cumsum(driven) - driven)  # distance to the end at the start of each piece
    far, near = case["visible_distance"], case["blind_distance"]
    edge = _EDGE * (1.0 + float(np.sum(driven)))
    with np.errstate(divide="ignore", invalid="ignore"):
        low = np.clip((left - far + edge) / driven, 0.0, 1.0)
        high = np.clip((left - near - (edge if near > 0.0 else 0.0)) / driven, 0.0, 1.0)
    still = driven <= 0.0
    inside = (left <= far - edge) & (left >= near + (edge if near > 0.0 else -edge))
    low, high = np.where(still, np.where(inside, 0.0, 1.0), low), np.where(still, np.where(inside, 1.0, 0.0), high)
    used = np.flatnonzero(high > low)
    size = np.maximum(motion.way, motion.turn)[used] * (high - low)[used]
    coarser = max(1.0, float(np.sum(size)) / (_STEP * _MOST))
    counts = np.clip(np.ceil(size / (_STEP * coarser)), 2, _MOST).astype(np.int64) + 1
    piece = np.repeat(used, counts)
    rank = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
    part = rank / np.repeat(counts - 1, counts)
    return piece, low[piece] + part * (high - low)[piece]


def _around_the_least(piece: Ints, share: Floats, value: Floats) -> tuple[Ints, Floats]:
    """Return places between the neighbours of local minima of the samples."""
    before, after = np.append(np.inf, value[:-1]), np.append(value[1:], np.inf)
    least = np.flatnonzero((value <= before) & (value <= after))
    least = least[np.argsort(value[least])][:_KEPT]
    found: list[tuple[Ints, Floats]] = []
    for k in least.tolist():
        low = share[k - 1] if k > 0 and piece[k - 1] == piece[k] else share[k]
        high = share[k + 1] if k + 1 < piece.size and piece[k + 1] == piece[k] else share[k]
        found.append((np.full(_PARTS, piece[k]), np.linspace(low, high, _PARTS + 2)[1:-1]))
    pieces, shares = zip(*found, strict=True)
    return np.concatenate(pieces), np.concatenate(shares)
