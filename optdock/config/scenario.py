"""Scenario files: a docking problem with plugins and time budget."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from pydantic import ValidationError

from optdock.config.plugin_sections import PLUGIN_DEFAULTS, planners, plugin_choice
from optdock.config.scenario_keys import SECTIONS, ScenarioDocument, known_keys, synonym
from optdock.errors import InvalidFile, InvalidValue, OptdockError
from optdock.geometry.obstacles import ObstacleSet
from optdock.io.faults import Fault, faults_of, report
from optdock.io.maps import load_map
from optdock.io.quoting import shown
from optdock.io.yaml_lines import load_yaml, parse_yaml
from optdock.model.limits import LIMIT_UNITS
from optdock.model.problem import DockingProblem
from optdock.planning.pipeline import DEFAULT_PLANNERS, DEFAULT_TIME_BUDGET, plan_dock
from optdock.plugins.interfaces import never_cancelled
from optdock.plugins.registry import PluginChoice

if TYPE_CHECKING:
    from collections.abc import Callable

    from optdock.geometry.footprint import Footprint
    from optdock.io.yaml_lines import Document
    from optdock.model.costmap import Costmap
    from optdock.planning.plan import DockPlan

__all__ = ["Scenario", "demo_scenario", "load_scenario", "parse_scenario", "problem_of"]

logger = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class Scenario:
    """Content of a scenario file.

    Args:
        problem: The docking problem.
        time_budget: Wall-clock time for planning [s].
        planner: Planners of raw paths, in order.
        smoother: Smoother of raw paths.
        timing: Time parameterizer.
        controller: Controller for `optdock simulate`.
        goal_checker: Goal checker for `optdock simulate`.
        source: The file.
        default_limits: Names of the motion limits that are missing in the file; these limits have the defaults of
            `MotionLimits`.
        polygons: Obstacles of the file as whole polygons of points [m]; the problem has their convex pieces.
            None if only the pieces are known.
    """

    problem: DockingProblem
    time_budget: float = DEFAULT_TIME_BUDGET
    planner: tuple[PluginChoice, ...] = tuple(PluginChoice(name) for name in DEFAULT_PLANNERS)
    smoother: PluginChoice = PluginChoice(PLUGIN_DEFAULTS["smoother"])
    timing: PluginChoice = PluginChoice(PLUGIN_DEFAULTS["timing"])
    controller: PluginChoice = PluginChoice(PLUGIN_DEFAULTS["controller"])
    goal_checker: PluginChoice = PluginChoice(PLUGIN_DEFAULTS["goal_checker"])
    source: Path = Path("scenario.yaml")
    default_limits: frozenset[str] = frozenset()
    polygons: tuple[tuple[tuple[float, float], ...], ...] | None = None

    def plan(
        self, time_budget: float | None = None, *, cancel_checker: Callable[[], bool] = never_cancelled
    ) -> DockPlan:
        """Plan with the plugins and the time budget of the file.

        Args:
            time_budget: Wall-clock time [s]; None: the time budget of the file.
            cancel_checker: As in `plan_dock`.

        Raises:
            OptdockError: If no certified plan is found; see `plan_dock`.
        """
        return plan_dock(
            self.problem,
            time_budget=self.time_budget if time_budget is None else time_budget,
            planner=self.planner,
            smoother=self.smoother,
            timing=self.timing,
            cancel_checker=cancel_checker,
        )


def load_scenario(source: str | Path) -> Scenario:
    """Read a scenario file, format `optdock-scenario/1`.

    Raises:
        InvalidFile: If the file cannot be read or violates the format. The message has one line per fault, with file,
            line, key, value and rule.
    """
    folder = Path(source).parent
    return _scenario(load_yaml(source), Path(source), lambda name: load_map(folder / name).costmap)


def parse_scenario(text: str, name: str, costmap_of: Callable[[str], Costmap] | None = None) -> Scenario:
    """Return the scenario of a text, format `optdock-scenario/1`; no file is read.

    Args:
        text: Content of a scenario file.
        name: Name of the text in messages.
        costmap_of: Function that returns the costmap of the map that the text names; None: a map is not allowed.

    Raises:
        InvalidFile: If the text violates the format, or names a map that is not allowed or for which `costmap_of`
            raises an error of the library.
    """
    return _scenario(parse_yaml(text, Path(name)), Path(name), costmap_of or _no_map)


def _no_map(_: str) -> Costmap:
    raise InvalidValue("is not allowed here; only a scenario file may name a map")


def _scenario(located: Document, source: Path, costmap_of: Callable[[str], Costmap]) -> Scenario:
    if not isinstance(located.value, Mapping):
        raise InvalidFile(f"{source}: must be a mapping with the key format: optdock-scenario/1")
    format_ = located.value.get("format")
    if format_ != "optdock-scenario/1" and not {"robot", "dock", "start"} & set(located.value):
        found = "" if format_ is None else f"; its format is {shown(format_)}"
        raise InvalidFile(f"{source}: is not a scenario: it has none of the keys robot, dock and start{found}")
    faults: list[Fault] = []
    document = _document(located.value, faults)
    choices = {kind: plugin_choice(kind, located.value.get(kind, {}), faults) for kind in SECTIONS}
    costmap = _costmap(located.value.get("map"), faults, costmap_of)
    if faults or document is None:
        raise InvalidFile(report(faults, located))
    _warn_of_outside_origin(source, document.robot.value().footprint)
    planner = planners(choices.pop("planner"), located.value.get("planner"))
    return Scenario(
        problem=_problem(document, costmap, located),
        time_budget=document.time_budget,
        source=source,
        default_limits=frozenset(LIMIT_UNITS) - document.robot.limits.model_fields_set,
        polygons=tuple(tuple((float(x), float(y)) for x, y in polygon) for polygon in document.obstacles),
        planner=planner,
        **choices,
    )


def _document(value: Mapping[str, object], faults: list[Fault]) -> ScenarioDocument | None:
    try:
        return ScenarioDocument.model_validate(value)
    except ValidationError as error:
        faults.extend(faults_of(error, known_keys, synonym=synonym))
        return None


def _costmap(name: object, faults: list[Fault], costmap_of: Callable[[str], Costmap]) -> Costmap | None:
    """Return the costmap of a map; None if there is no map or it has faults."""
    if not isinstance(name, str):
        return None
    try:
        return costmap_of(name)
    except OptdockError as error:
        faults.extend(Fault(("map",), line) for line in str(error).splitlines())
        return None


def _problem(document: ScenarioDocument, costmap: Costmap | None, located: Document) -> DockingProblem:
    """Return the problem, and check the rules that relate its parts.

    Raises:
        InvalidFile: If such a rule is violated.
    """
    try:
        return problem_of(document, costmap)
    except InvalidValue as error:
        name, _, rule = str(error).partition(": ")
        raise InvalidFile(located.fault(tuple(name.split(".")), rule)) from error


def problem_of(document: ScenarioDocument, costmap: Costmap | None) -> DockingProblem:
    """Return the problem of a scenario document with a costmap.

    Raises:
        InvalidValue: If its parts are inconsistent.
    """
    return DockingProblem(
        start=document.start.pose,
        dock=document.dock.value(),
        robot=document.robot.value(),
        obstacles=ObstacleSet.from_polygons(document.obstacles),
        clearance=document.clearance.value(),
        start_speed=document.start.speed,
        start_curvature=document.start.known_curvature,
        start_acceleration=document.start.acceleration,
        costmap=costmap,
        frame=document.frame,
    )


def _warn_of_outside_origin(source: Path, outline: Footprint) -> None:
    """Warn if the origin is outside the outline; usually the outline is then given in a different frame."""
    if not any(np.all(body.offsets >= 0.0) for body in outline.bodies):
        logger.warning(
            "%s: robot.footprint does not contain [0, 0], the point of the robot that follows the path; is it in "
            "the frame of the robot?",
            source,
        )


def demo_scenario() -> Path:
    """Return the path of the built-in scenario: a hall with a shelf, a pillar and a dock."""
    return Path(__file__).with_name("demo") / "hall.yaml"
