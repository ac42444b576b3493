"""Base class of plugins, with parameters, context and Nav2's lifecycle.

A plugin can be used as soon as it is constructed. Servers may also manage its lifecycle: unconfigured -> inactive ->
active -> finalized.
"""

from __future__ import annotations

import dataclasses
import logging
from abc import ABC
from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from optdock.deadline import now
from optdock.errors import InvalidValue, LifecycleError
from optdock.geometry.checked import instance
from optdock.geometry.footprint import Footprint
from optdock.geometry.obstacles import ObstacleSet
from optdock.model.cell_obstacles import obstacles_from_costmap
from optdock.model.costmap import Costmap
from optdock.model.problem import DockingProblem
from optdock.plugins.outcomes import CostmapInfoType
from optdock.plugins.parameters import PluginParameters, parse_parameters

if TYPE_CHECKING:
    from collections.abc import Callable

    from optdock.geometry.arrays import FloatArray

__all__ = ["LifecycleState", "Plugin", "PluginContext"]


_LOGGER = logging.getLogger("optdock")


class LifecycleState(str, Enum):
    """State of a managed plugin."""

    UNCONFIGURED = "unconfigured"
    INACTIVE = "inactive"
    ACTIVE = "active"
    FINALIZED = "finalized"


@dataclass(frozen=True, eq=False)
class PluginContext:
    """Data for a plugin: costmaps, footprint and problem. Missing parts are derived from the others.

    `footprint` and `costmap` default to those of the problem, and the obstacles of the problem include the cells of
    `costmap`.

    Args:
        name: Name of the plugin instance.
        costmap: Global costmap, or None.
        footprint: Robot outline, or None.
        problem: Docking problem, or None.
        clock: Function that returns a monotonic time [s]; by default `optdock.deadline.now`.
        logger: Logger of the plugin.
        local_costmap: Costmap around the robot, which is read in every call and is not part of the problem; or None. If
            there is neither a problem nor a global costmap, this costmap also replaces the global costmap.

    Raises:
        InvalidValue: If `footprint` is not the outline of the problem's robot, or a part has a wrong type.
    """

    name: str = ""
    costmap: Costmap | None = None
    footprint: Footprint | None = None
    problem: DockingProblem | None = None
    clock: Callable[[], float] = now
    logger: logging.Logger = _LOGGER
    local_costmap: Costmap | None = None

    def __post_init__(self) -> None:
        for kind, value, name in (
            (Costmap, self.costmap, "costmap"),
            (Footprint, self.footprint, "footprint"),
            (DockingProblem, self.problem, "problem"),
            (Costmap, self.local_costmap, "local_costmap"),
        ):
            if value is not None and type(value) is not kind:
                instance(kind, value, f"context.{name}")
        problem, costmap = self.problem, self.costmap
        if problem is None:
            if costmap is None and self.local_costmap is not None:
                vars(self).update(costmap=self.local_costmap)
            return
        outline = problem.robot.footprint
        if self.footprint is not None and not np.array_equal(self.footprint.vertices, outline.vertices):
            raise InvalidValue("context.footprint: differs from context.problem.robot.footprint; give one of them")
        problem, costmap = (problem, problem.costmap) if costmap is None else (problem.among(costmap), costmap)
        vars(self).update(footprint=outline, problem=problem, costmap=costmap)

    def problem_at_hand(self, called_with: DockingProblem | None) -> DockingProblem | None:
        """Return the problem of a call with the obstacles of the context and of the local costmap, or None.

        Args:
            called_with: Problem of the call, whose costmap replaces the configured costmap; None: the configured
                problem.
        """
        found = self.problem if called_with is None else called_with
        if found is None:
            return None
        if called_with is not None and called_with.costmap is None and self.costmap is not None:
            found = found.among(self.costmap)
        if self.local_costmap is None:
            return found
        # Without a border, because the space beyond a local costmap is not an obstacle.
        local = obstacles_from_costmap(self.local_costmap, unknown_is_obstacle=found.unknown_is_obstacle, border=False)
        return dataclasses.replace(found, obstacles=found.obstacles + local)

    def costmaps(self, needs: CostmapInfoType) -> tuple[Costmap, ...]:
        """Return the costmaps named by `needs`; the global costmap replaces a missing local costmap."""
        local = self.costmap if self.local_costmap is None else self.local_costmap
        asked = {
            CostmapInfoType.NONE: (),
            CostmapInfoType.LOCAL: (local,),
            CostmapInfoType.GLOBAL: (self.costmap,),
            CostmapInfoType.BOTH: (local, self.costmap),
        }[needs]
        return tuple(grid for grid in dict.fromkeys(asked) if grid is not None)

    def obstacles_near(
        self, lower: FloatArray, upper: FloatArray, needs: CostmapInfoType = CostmapInfoType.BOTH
    ) -> ObstacleSet:
        """Return the obstacles in a box: obstacles of the problem, and cells of the costmaps named by `needs`.

        Args:
            lower: Lower corner, Shape (2,) [m].
            upper: Upper corner, Shape (2,) [m].
            needs: Costmaps whose cells are added to the obstacles of the problem; these already include the cells of
                the global costmap.
        """
        problem = self.problem
        found = ObstacleSet.empty() if problem is None else problem.all_obstacles.in_box(lower, upper)
        for grid in self.costmaps(needs):
            if problem is None or grid is not problem.costmap:
                found = found + obstacles_from_costmap(grid, region=(lower, upper))
        return found


class Plugin(ABC):
    """Base class of all plugins; subclasses set `Parameters` and may override the `on_*` hooks.

    A transition raises LifecycleError if the present state does not allow it.

    Args:
        **parameters: Values of the fields of `Parameters`.

    Raises:
        InvalidValue: If a parameter is unknown, of the wrong type or out of range.
    """

    Parameters: ClassVar[type[PluginParameters]] = PluginParameters
    parameters: PluginParameters

    def __init__(self, /, **parameters: object) -> None:
        self.parameters = parse_parameters(self.Parameters, parameters, type(self).__name__)
        self.context = self._unconfigured = PluginContext(name=type(self).__name__)
        self._state = LifecycleState.UNCONFIGURED

    @property
    def name(self) -> str:
        """Name of the instance in its context, or else name of its class."""
        return self.context.name or type(self).__name__

    @property
    def state(self) -> LifecycleState:
        """State in the lifecycle."""
        return self._state

    def configure(self, context: PluginContext) -> None:
        """Set the context: unconfigured -> inactive.

        Raises:
            InvalidValue: If `context` is not a PluginContext.
        """
        self._require("configure", LifecycleState.UNCONFIGURED)
        if not isinstance(context, PluginContext):
            raise InvalidValue(f"{self.context.name}: configure needs a PluginContext, got {context!r}")
        previous, self.context = self.context, context
        try:
            self.on_configure()
        except BaseException:
            self.context = previous
            raise
        self._state = LifecycleState.INACTIVE

    def activate(self) -> None:
        """Activate the plugin: inactive -> active."""
        self._require("activate", LifecycleState.INACTIVE)
        self.on_activate()
        self._state = LifecycleState.ACTIVE

    def deactivate(self) -> None:
        """Deactivate the plugin: active -> inactive."""
        self._require("deactivate", LifecycleState.ACTIVE)
        self.on_deactivate()
        self._state = LifecycleState.INACTIVE

    def cleanup(self) -> None:
        """Release resources: inactive -> unconfigured."""
        self._require("cleanup", LifecycleState.INACTIVE)
        self.on_cleanup()
        self.context, self._state = self._unconfigured, LifecycleState.UNCONFIGURED

    def shutdown(self) -> None:
        """Release resources: any state except finalized -> finalized."""
        self._require("shutdown", LifecycleState.UNCONFIGURED, LifecycleState.INACTIVE, LifecycleState.ACTIVE)
        if self._state is LifecycleState.ACTIVE:
            self.on_deactivate()
        if self._state is not LifecycleState.UNCONFIGURED:
            self.on_cleanup()
        self.context, self._state = self._unconfigured, LifecycleState.FINALIZED

    def set_parameters(self, /, **changes: object) -> None:
        """Change several parameters in one step.

        Raises:
            InvalidValue: If a name is unknown or the changed set is invalid; in this case no parameter is changed.
        """
        merged = {**self.parameters.model_dump(by_alias=True), **changes}
        checked = parse_parameters(self.Parameters, merged, self.context.name)
        self.check_change(checked)
        self.parameters = checked

    def check_change(self, changed: PluginParameters) -> None:  # noqa: B027 - a hook
        """Check a change of parameters; overrides raise InvalidValue to reject it."""

    def on_configure(self) -> None:  # noqa: B027 - a hook
        """Hook after `self.context` is set."""

    def on_activate(self) -> None:  # noqa: B027 - a hook
        """Hook before the plugin becomes active."""

    def on_deactivate(self) -> None:  # noqa: B027 - a hook
        """Hook before the plugin becomes inactive."""

    def on_cleanup(self) -> None:  # noqa: B027 - a hook
        """Hook before the context is removed."""

    def _require(self, transition: str, *allowed: LifecycleState) -> None:
        if self._state not in allowed:
            wanted = " or ".join(state.value for state in allowed)
            raise LifecycleError(f"{self.context.name}: cannot {transition} when {self._state.value}, only {wanted}")
