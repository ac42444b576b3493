"""Mistakes planted in the certificate: the fuzzer must find each of them.

A plant temporarily replaces one attribute of `optdock.verification` by a version with one mistake.
"""

from __future__ import annotations

import contextlib
import importlib
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from optdock.geometry.footprint import Footprint
from optdock.kernels import using_kernels
from optdock.verification import (
    certificate,
    certify,
    clearance_rounds,
    motion_bounds,
    path_rules,
    stretch_bounds,
    trajectory_rules,
    turning_rules,
    visibility,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

__all__ = ["PLANTS", "planted"]


class Plant(NamedTuple):
    """A mistake: the owner and the name of the replaced attribute, and the replacement."""

    owner: Any
    attribute: str
    mistaken: Callable[[Any], Any]


@contextlib.contextmanager
def planted(name: str | None) -> Iterator[None]:
    """Plant one mistake in the certificate for the duration of the context; None: no mistake."""
    if name is None:
        yield
        return
    owner, attribute, mistaken = PLANTS[name]
    honest = getattr(owner, attribute)
    setattr(owner, attribute, mistaken(honest))
    try:
        with using_kernels("twin"):  # the kernels in C do not contain the mistake
            yield
    finally:
        setattr(owner, attribute, honest)


def _true(_honest: Callable[..., bool]) -> Callable[..., bool]:
    return lambda _verdict: True


def _five_times(honest: float) -> float:
    return 5.0 * honest


def _centimetre_more(honest: Callable[..., Any]) -> Callable[..., Any]:
    return lambda *arguments: honest(*arguments) + 0.01


def _nowhere_off(honest: Callable[..., Any]) -> Callable[..., Any]:
    return lambda *arguments: 0.0 * honest(*arguments)


def _one_obstacle_less(honest: Callable[..., Any]) -> Callable[..., Any]:
    def mistaken(path: Any, problem: Any, *rest: Any) -> Any:  # noqa: ANN401
        return honest(path, _without(problem, range(len(problem.all_obstacles))), *rest)

    return mistaken


def _one_map_cell_less(honest: Callable[..., Any]) -> Callable[..., Any]:
    def mistaken(path: Any, problem: Any, *rest: Any) -> Any:  # noqa: ANN401
        obstacles = problem.all_obstacles
        cells = [row for row in range(len(obstacles)) if obstacles.name_of(row) in ("map", "unknown")]
        return honest(path, _without(problem, cells), *rest)

    return mistaken


def _middle_cell_less(honest: Callable[..., Any]) -> Callable[..., Any]:
    def mistaken(*arguments: Any) -> Any:  # noqa: ANN401
        cells = honest(*arguments)
        rows = np.arange(cells[0].size)
        return cells.rows(np.delete(rows, rows.size // 2) if rows.size > 1 else rows)

    return mistaken


def _without(problem: Any, rows: Any) -> Any:  # noqa: ANN401
    """Return the problem without the piece in the middle of `rows`."""
    if not len(rows):
        return problem
    kept = np.delete(np.arange(len(problem.all_obstacles)), rows[len(rows) // 2])
    return _View(problem, problem.all_obstacles.subset(kept))


class _View:
    """A problem with other obstacles, as read by the proof."""

    def __init__(self, problem: Any, all_obstacles: Any) -> None:  # noqa: ANN401
        self._problem, self.all_obstacles = problem, all_obstacles

    def __getattr__(self, name: str) -> Any:  # noqa: ANN401
        return getattr(self._problem, name)


def _one_new_obstacle_less(honest: Callable[..., Any]) -> Callable[..., Any]:
    def mistaken(*arguments: Any, obstacles: Any, **rest: Any) -> Any:  # noqa: ANN401
        kept = np.delete(np.arange(len(obstacles)), len(obstacles) // 2)
        return honest(*arguments, obstacles=obstacles.subset(kept), **rest)

    return mistaken


def _lateral_jerk_of_another_order(honest: Any) -> dict[str, Any]:  # noqa: ANN401
    row = honest["max_lateral_jerk"]
    return {**honest, row.name: row._replace(size=lambda at, _: np.abs(at.v * (at.a * at.k + at.v * at.v * at.r)))}


def _no_bend_of_lateral_jerk(honest: dict[str, Any]) -> dict[str, Any]:
    return {**honest, "max_lateral_jerk": lambda most, _: 0.0 * most.v}


def _at_rest(honest: Callable[..., Any]) -> Callable[..., Any]:
    """Return the marker as if it moved in the camera's frame only to second order."""

    def mistaken(*arguments: Any) -> Any:  # noqa: ANN401
        advance = honest(*arguments)
        return advance._replace(velocity=0.0 * advance.velocity)

    return mistaken


def _one_edge(honest: Callable[..., Any]) -> Callable[..., Any]:
    """Check only one edge of a narrow cone."""

    def mistaken(camera: Any, advance: Any) -> Any:  # noqa: ANN401
        if camera.field_of_view > np.pi:
            return honest(camera, advance)
        half = 0.5 * camera.field_of_view
        return advance.linear(np.array([np.sin(half), np.cos(half)]))

    return mistaken


PLANTS: dict[str, Plant] = {
    "tolerance_x5": Plant(clearance_rounds, "TOLERANCE", _five_times),
    "first_order_centimetre": Plant(stretch_bounds, "_directional", _centimetre_more),
    "dropped_obstacle": Plant(certify, "prove_clearance", _one_obstacle_less),
    "dropped_map_cell": Plant(certify, "prove_clearance", _one_map_cell_less),
    "dropped_new_obstacle": Plant(
        importlib.import_module("optdock.planning.changed_world"), "prove_clearance", _one_new_obstacle_less
    ),
    "dropped_measured_pose": Plant(Footprint, "displacement", _nowhere_off),
    "dropped_path_cell": Plant(motion_bounds.PathMotion, "cells", _middle_cell_less),
    "dropped_time_cell": Plant(trajectory_rules, "initial_cells", _middle_cell_less),
    "curvature_x5": Plant(path_rules, "EXACT_RTOL", _five_times),
    "always_true": Plant(certificate.Certificate, "__bool__", _true),
    "rest_x5": Plant(trajectory_rules, "REST_TOLERANCE", _five_times),
    "lateral_jerk_order": Plant(turning_rules, "LIMITS", _lateral_jerk_of_another_order),
    "view_at_rest": Plant(visibility, "_advance", _at_rest),
    "view_of_one_edge": Plant(visibility, "_lowest_in_cone", _one_edge),
    "view_tolerance_x5": Plant(visibility, "TOLERANCE", _five_times),
    "lateral_jerk_at_ends_only": Plant(turning_rules, "_BENDS", _no_bend_of_lateral_jerk),
}
