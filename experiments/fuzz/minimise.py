"""Shrinking of a failing case: parts are removed as long as the same fault remains."""

from __future__ import annotations

import copy
import time
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from experiments.fuzz.case import Case, Verdict

__all__ = ["minimised"]

_MOST_TURNS = 400


_SECONDS = 5.0  # of CPU time


def minimised(case: Case, wanted: Verdict, judge: Callable[[Case], Verdict]) -> Case:
    """Return the smallest case found that fails in the same way.

    Args:
        case: A failing case.
        wanted: Verdict of the failure.
        judge: Judges a case; an exception counts as another failure.
    """
    deadline, best, progress = time.process_time() + _SECONDS, case, True
    for _ in range(_MOST_TURNS):
        if not progress:
            break
        progress = False
        for smaller in _smaller(best):
            if time.process_time() > deadline:
                return best
            if _fails_alike(smaller, wanted, judge):
                best, progress = smaller, True
                break
    return best


def _fails_alike(case: Case, wanted: Verdict, judge: Callable[[Case], Verdict]) -> bool:
    try:
        return judge(case).signature == wanted.signature
    except Exception as error:  # the fault may be any exception
        return wanted.outcome == "untyped exception" and wanted.detail.split(":")[0] == type(error).__name__


def _smaller(case: Case) -> Iterator[Case]:
    """Yield cases with a part removed, the largest parts first."""
    for edit in (_without_obstacles, _without_grid, _without_extras, _shorter_paths, _plainer_limits):
        yield from edit(case)


def _without_obstacles(case: Case) -> Iterator[Case]:
    for i in range(len(case.get("obstacles", []))):
        smaller = copy.deepcopy(case)
        del smaller["obstacles"][i]
        yield smaller


def _without_grid(case: Case) -> Iterator[Case]:
    grid = case.get("grid")
    if not grid:
        return
    yield {**copy.deepcopy(case), "grid": None}
    cells = grid["cells"]
    occupied = [(j, i) for j, row in enumerate(cells) for i, cost in enumerate(row) if cost]
    for share in (2, 8):
        block = max(1, len(occupied) // share)
        for first in range(0, len(occupied), block) if len(occupied) > 1 else ():
            smaller = copy.deepcopy(case)
            for j, i in occupied[first : first + block]:
                smaller["grid"]["cells"][j][i] = 0
            yield smaller


def _without_extras(case: Case) -> Iterator[Case]:
    dock = case.get("dock")
    if dock and dock.get("footprint"):
        yield {**case, "dock": {**dock, "footprint": None}}
    if dock and dock.get("final_straight"):
        yield {**case, "dock": {**dock, "final_straight": 0.0}}
    for key, plain in (
        ("start_speed", 0.0),
        ("start_acceleration", 0.0),
        ("start_curvature", None),
        ("zone", [None, 0.0]),
    ):
        if key in case and case[key] != plain and "law" not in case:
            yield {**case, key: plain}
    rule = case.get("clearance")
    if rule and rule[2] != 0.0:
        yield {**case, "clearance": [rule[0], rule[0], 0.0]}


def _plainer_limits(case: Case) -> Iterator[Case]:
    for name in case.get("limits", {}):
        yield {**case, "limits": {key: value for key, value in case["limits"].items() if key != name}}


def _shorter_paths(case: Case) -> Iterator[Case]:
    """Yield fewer gears at the end, fewer knots or poses; the goal moves with the end of the path."""
    from experiments.fuzz.oracle.motion import motion_of

    if not case.get("path") or "law" in case or case.get("kind") != "paths":
        return
    for path in _shorter(case["path"]):
        try:
            end = motion_of(path).end.tolist()
        except ValueError:  # a knot was left out between two others with curvatures that need it
            continue
        yield {**copy.deepcopy(case), "path": path, "dock": {**case["dock"], "pose": end}}


def _shorter(path: list[Case]) -> Iterator[list[Case]]:
    if len(path) > 1:
        yield path[:-1]
    last = path[-1]
    if last["type"] == "turn":
        return
    columns = ("poses",) if last["type"] == "polyline" else ("knots", "curvature")
    count = len(last[columns[0]])
    for keep in sorted({max(2, count // 2), max(2, count - 1)}):
        if keep < count:
            yield [*path[:-1], {**last, **{name: last[name][:keep] for name in columns}}]
    for i in range(1, count - 1) if count <= 12 else ():
        cut = {name: [*last[name][:i], *last[name][i + 1 :]] for name in columns}
        yield [*path[:-1], {**last, **cut}]
