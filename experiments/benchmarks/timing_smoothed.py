"""Stored results of CasadiSmoother on random instances of all families, so that the suite stays constant."""

from __future__ import annotations

import json
from pathlib import Path as FilePath
from typing import TYPE_CHECKING

import numpy as np

from experiments.families import FEASIBLE_FAMILIES, instance
from optdock.errors import SmootherException
from optdock.geometry.clothoid import ClothoidSpline
from optdock.geometry.pose import Pose2
from optdock.model.path import ClothoidSegment, Path
from optdock.plugins.interfaces import Smoother
from optdock.plugins.registry import create_plugin

if TYPE_CHECKING:
    from optdock.model.path import Segment

__all__ = ["harvest", "smoothed_paths"]

_FILE = FilePath(__file__).with_name("timing_smoothed.json")
_SEEDS = 3
_BUDGET = 1.0  # [s]


def smoothed_paths() -> dict[str, Path]:
    """Return the stored paths by name."""
    kept = json.loads(_FILE.read_text())
    return {name: Path(tuple(_segment(gear) for gear in gears)) for name, gears in kept.items()}


def _segment(gear: dict[str, list[float]]) -> ClothoidSegment:
    start = Pose2.from_sequence(gear["start"])
    knots = np.concatenate(([0.0], np.cumsum(gear["steps"])))
    return ClothoidSegment(ClothoidSpline(start, knots, np.array(gear["curvature"]), int(gear["sign"][0])))


def harvest() -> None:
    """Smooth every family again and store the paths."""
    smoother, kept = create_plugin(Smoother, "CasadiSmoother"), {}
    for family in FEASIBLE_FAMILIES:
        for seed in range(_SEEDS):
            case = instance(family, seed)
            try:
                path = smoother.smooth(case.raw_path, _BUDGET, problem=case.problem).path
            except SmootherException as error:
                print(family, seed, error)
                continue
            kept[f"{family}-{seed}"] = [_plain(segment) for segment in path.segments]
    _FILE.write_text(json.dumps(kept, separators=(",", ":")) + "\n")


def _plain(segment: Segment) -> dict[str, list[float]]:
    knots = segment.knots
    return {
        "start": np.round(segment.poses_at(0.0)[0], 9).tolist(),
        "steps": np.round(np.diff(knots), 9).tolist(),
        "curvature": np.round(segment.curvature_at(knots), 9).tolist(),
        "sign": [float(segment.direction)],
    }
