"""Scenario files: one docking problem with the plugins and the time to solve it."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from pydantic import ValidationError

from optdock.config.document import SECTIONS, ScenarioDocument, known_keys, synonym
from optdock.config.plugin_sections import PLUGIN_DEFAULTS, planners, plugin_choice
from optdock.errors import InvalidFile, InvalidValue, OptdockError
from optdock.geometry.obstacles import ObstacleSet
from optdock.io.faults import Fault, faults_of, report
from optdock.io.maps import load_map
from optdock.io.quoting import shown
from optdock.io.yaml_lines import load_yaml
from optdock.model.limits import LIMIT_UNITS
from optdock.model.problem import DockingProblem
from optdock.planning.pipeline import DEFAULT_PLANNERS, DEFAULT_TIME_BUDGET, plan_dock
from optdock.plugins.registry import PluginChoice

if TYPE_CHECKING:
    from optdock.geometry.footprint import Footprint
    from optdock.io.yaml_lines import Document
    from optdock.model.costmap import Costmap
    from optdock.planning.plan import DockPlan

__all__ = ["Scenario", "demo_scenario", "load_scenario", "problem_of"]

logger = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class Scenario:
    """What a scenario file says.

    Args:
        problem: The docking problem.
        time_budget: Wall-clock seconds for planning it.
        planner: Make the guesses, in this order.
        smoother: Makes it drivable.
        timing: Gives it its time law.
        controller: What drives the result in `optdock simulate`.
        goal_checker: What decides there that the robot has arrived.
        source: The file.
        default_limits: The motion limits that the file does not give, so that `MotionLimits`'s own hold.
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

    def plan(self, time_budget: float | None = None) -> DockPlan:
        """The certified plan, by the plugins and in the time that the file asks for.

        Args:
            time_budget: Wall-clock seconds; None: the file's.

        Raises:
            OptdockError: There is none; see `plan_dock`.
        """
        return plan_dock(
            self.problem,
            time_budget=self.time_budget if time_budget is None else time_budget,
            planner=self.planner,
            smoother=self.smoother,
            timing=self.timing,
        )


def load_scenario(source: str | Path) -> Scenario:
    """Read a scenario file, format `optdock-scenario/1`.

    Raises:
        InvalidFile: The file cannot be read or breaks the format; the message lists every fault, one per line, with
            file, line, key, value and rule.
    """
    source = Path(source)
    located = load_yaml(source)
    if not isinstance(located.value, Mapping):
        raise InvalidFile(f"{source}: must be a mapping with the key format: optdock-scenario/1")
    said = located.value.get("format")
    if said != "optdock-scenario/1" and not {"robot", "dock", "start"} & set(located.value):
        format_ = "" if said is None else f"; its format is {shown(said)}"
        raise InvalidFile(f"{source}: is not a scenario: it has none of the keys robot, dock and start{format_}")
    faults: list[Fault] = []
    document = _document(located.value, faults)
    choices = {kind: plugin_choice(kind, located.value.get(kind, {}), faults) for kind in SECTIONS}
    costmap = _costmap(source, located.value.get("map"), faults)
    if faults or document is None:
        raise InvalidFile(report(faults, located))
    _warn_of_an_outline_aside(source, document.robot.value().footprint)
    asked = planners(choices.pop("planner"), located.value.get("planner"))
    return Scenario(
        problem=_problem(document, costmap, located),
        time_budget=document.time_budget,
        source=source,
        default_limits=frozenset(LIMIT_UNITS) - document.robot.limits.model_fields_set,
        planner=asked,
        **choices,
    )


def _document(value: Mapping[str, object], faults: list[Fault]) -> ScenarioDocument | None:
    try:
        return ScenarioDocument.model_validate(value)
    except ValidationError as error:
        faults.extend(faults_of(error, known_keys, synonym=synonym))
        return None


def _costmap(source: Path, name: object, faults: list[Fault]) -> Costmap | None:
    """The map, found relative to the scenario."""
    if not isinstance(name, str):
        return None
    try:
        return load_map(source.parent / name).costmap
    except OptdockError as error:
        faults.extend(Fault(("map",), line) for line in str(error).splitlines())
        return None


def _problem(document: ScenarioDocument, costmap: Costmap | None, located: Document) -> DockingProblem:
    """The whole, which has a rule that its parts do not know.

    Raises:
        InvalidFile: It is broken.
    """
    try:
        return problem_of(document, costmap)
    except InvalidValue as error:
        name, _, rule = str(error).partition(": ")
        raise InvalidFile(located.fault(tuple(name.split(".")), rule)) from error


def problem_of(document: ScenarioDocument, costmap: Costmap | None) -> DockingProblem:
    """The problem that a scenario document says, among the cells of a costmap.

    Raises:
        InvalidValue: Its parts do not go together.
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


def _warn_of_an_outline_aside(source: Path, outline: Footprint) -> None:
    """A robot whose own origin lies outside of it may be meant, but is more often an outline of another frame."""
    if not any(np.all(body.offsets >= 0.0) for body in outline.bodies):
        logger.warning(
            "%s: robot.footprint does not contain [0, 0], the point of the robot that follows the path; is it seen "
            "from there?",
            source,
        )


def demo_scenario() -> Path:
    """Returns the path of the built-in scenario: a hall with a shelf, a pillar and a dock; its map lies beside it."""
    return Path(__file__).with_name("demo") / "hall.yaml"
