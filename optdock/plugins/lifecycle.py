"""Plugin base: parameters, and Nav2's lifecycle, which is optional.

A plugin is ready to use as soon as it is constructed. Servers that manage plugins may in addition walk it through
unconfigured -> inactive -> active -> finalized; a transition that its state does not allow is refused.
"""

from __future__ import annotations

import dataclasses
import logging
import time
from abc import ABC
from dataclasses import dataclass, field
from enum import Enum
from typing import TYPE_CHECKING, ClassVar

import numpy as np

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


class LifecycleState(str, Enum):
    """Where a managed plugin stands."""

    UNCONFIGURED = "unconfigured"
    INACTIVE = "inactive"
    ACTIVE = "active"
    FINALIZED = "finalized"


@dataclass(frozen=True, eq=False)
class PluginContext:
    """What a server hands to a plugin when it configures it: one world, however it is given.

    What a problem says and what stands beside it are joined here, so that a plugin may read either and misses nothing:
    afterwards `footprint` and `costmap` are the problem's where only it has them, and the problem's obstacles hold the
    cells of `costmap` whichever brought it.

    Args:
        name: Name of the plugin instance.
        costmap: Grid to read, the global one where there are two, or None.
        footprint: Robot outline, or None.
        problem: The docking problem at hand, or None outside a docking pipeline.
        clock: Monotonic seconds.
        logger: Where the plugin reports.
        local_costmap: The grid around the robot, read anew in every call: behaviors see it where they ask for it,
            all other plugins, beside the others. It is not part of the problem, since it changes in motion. Where
            neither a problem nor a second grid is given, the one that is serves everybody.

    Raises:
        InvalidValue: `footprint` is not the outline of the problem's robot, or a part is of another class.
    """

    name: str = ""
    costmap: Costmap | None = None
    footprint: Footprint | None = None
    problem: DockingProblem | None = None
    clock: Callable[[], float] = time.monotonic
    logger: logging.Logger = field(default_factory=lambda: logging.getLogger("optdock"))
    local_costmap: Costmap | None = None

    def __post_init__(self) -> None:
        kinds = {"costmap": Costmap, "footprint": Footprint, "problem": DockingProblem, "local_costmap": Costmap}
        for name, kind in kinds.items():
            if getattr(self, name) is not None:
                instance(kind, getattr(self, name), f"context.{name}")
        if self.problem is None:
            if self.costmap is None:
                object.__setattr__(self, "costmap", self.local_costmap)
            return
        outline = self.problem.robot.footprint
        if self.footprint is not None and not np.array_equal(self.footprint.vertices, outline.vertices):
            raise InvalidValue("context.footprint: differs from context.problem.robot.footprint; give one of them")
        object.__setattr__(self, "footprint", outline)
        if self.costmap is not None:
            object.__setattr__(self, "problem", self.problem.among(self.costmap))
        else:
            object.__setattr__(self, "costmap", self.problem.costmap)

    def problem_at_hand(self, called_with: DockingProblem | None) -> DockingProblem | None:
        """The problem that a call is about, among everything that it and the context hold, the local costmap included.

        Args:
            called_with: The problem of the call; None: the configured one. Where it brings a costmap of its own, that
                is the newer picture of the same surroundings and replaces the configured one.
        """
        found = self.problem if called_with is None else called_with
        if found is None:
            return None
        if called_with is not None and called_with.costmap is None and self.costmap is not None:
            found = found.among(self.costmap)
        if self.local_costmap is None:
            return found
        # As it is now, and without the world beyond it: a local grid ends at unknown space.
        local = obstacles_from_costmap(self.local_costmap, unknown_is_obstacle=found.unknown_is_obstacle, border=False)
        return dataclasses.replace(found, obstacles=found.obstacles + local)

    def costmaps(self, needs: CostmapInfoType) -> tuple[Costmap, ...]:
        """The costmaps that `needs` names; where there is no local one, the other serves both."""
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
        """The obstacles that meet a box: the problem's, and the cells of the costmaps that `needs` names, as they are.

        The problem's always count, and with them the cells of the global costmap, which is a part of it.

        Args:
            lower: Lower corner, Shape (2,) [m].
            upper: Upper corner, Shape (2,) [m].
            needs: Which costmaps count beside the problem; both where none is chosen.
        """
        problem = self.problem
        found = ObstacleSet.empty() if problem is None else problem.all_obstacles.in_box(lower, upper)
        for grid in self.costmaps(needs):
            if problem is None or grid is not problem.costmap:
                found = found + obstacles_from_costmap(grid, region=(lower, upper))
        return found


class Plugin(ABC):
    """Base of all plugins.

    A subclass names its `Parameters` class and overrides the `on_*` hooks it needs.

    Args:
        **parameters: Values of the fields of `Parameters`.

    Raises:
        InvalidValue: A parameter is unknown, of the wrong type or out of range.
    """

    Parameters: ClassVar[type[PluginParameters]] = PluginParameters
    parameters: PluginParameters

    def __init__(self, /, **parameters: object) -> None:
        self.parameters = parse_parameters(self.Parameters, parameters, type(self).__name__)
        self.context = PluginContext(name=type(self).__name__)
        self._state = LifecycleState.UNCONFIGURED

    @property
    def name(self) -> str:
        """Name of this instance: the context's, or the class's until it is configured."""
        return self.context.name or type(self).__name__

    @property
    def state(self) -> LifecycleState:
        """Where the plugin stands in its lifecycle."""
        return self._state

    def configure(self, context: PluginContext) -> None:
        """Link the plugin to its surroundings: unconfigured -> inactive.

        Raises:
            LifecycleError: The plugin is not unconfigured.
            InvalidValue: `context` is none.
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
        """Inactive -> active.

        Raises:
            LifecycleError: The plugin is not inactive.
        """
        self._require("activate", LifecycleState.INACTIVE)
        self.on_activate()
        self._state = LifecycleState.ACTIVE

    def deactivate(self) -> None:
        """Active -> inactive.

        Raises:
            LifecycleError: The plugin is not active.
        """
        self._require("deactivate", LifecycleState.ACTIVE)
        self.on_deactivate()
        self._state = LifecycleState.INACTIVE

    def cleanup(self) -> None:
        """Inactive -> unconfigured, resources released.

        Raises:
            LifecycleError: The plugin is not inactive.
        """
        self._require("cleanup", LifecycleState.INACTIVE)
        self.on_cleanup()
        self.context = PluginContext(name=type(self).__name__)
        self._state = LifecycleState.UNCONFIGURED

    def shutdown(self) -> None:
        """Any state but finalized -> finalized, resources released.

        Raises:
            LifecycleError: The plugin is finalized.
        """
        alive = (LifecycleState.UNCONFIGURED, LifecycleState.INACTIVE, LifecycleState.ACTIVE)
        self._require("shutdown", *alive)
        if self._state is LifecycleState.ACTIVE:
            self.on_deactivate()
        if self._state is not LifecycleState.UNCONFIGURED:
            self.on_cleanup()
        self.context = PluginContext(name=type(self).__name__)
        self._state = LifecycleState.FINALIZED

    def set_parameters(self, /, **changes: object) -> None:
        """Change parameters, all of them or none.

        Raises:
            InvalidValue: A name is unknown or the changed set breaks a rule; nothing has changed then.
        """
        merged = {**self.parameters.model_dump(by_alias=True), **changes}
        checked = parse_parameters(self.Parameters, merged, self.context.name)
        self.check_change(checked)
        self.parameters = checked

    def check_change(self, changed: PluginParameters) -> None:  # noqa: B027 - a hook
        """Hook: refuse a change of parameters by raising InvalidValue."""

    def on_configure(self) -> None:  # noqa: B027 - a hook
        """Hook: `self.context` has just been set."""

    def on_activate(self) -> None:  # noqa: B027 - a hook
        """Hook: about to become active."""

    def on_deactivate(self) -> None:  # noqa: B027 - a hook
        """Hook: about to become inactive."""

    def on_cleanup(self) -> None:  # noqa: B027 - a hook
        """Hook: about to lose the context."""

    def _require(self, transition: str, *allowed: LifecycleState) -> None:
        if self._state not in allowed:
            wanted = " or ".join(state.value for state in allowed)
            raise LifecycleError(f"{self.context.name}: cannot {transition} when {self._state.value}, only {wanted}")
