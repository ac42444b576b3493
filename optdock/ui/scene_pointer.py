"""The pointer on the figure: it grabs a part of the scene, drags it and releases it."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from optdock.errors import InvalidValue
from optdock.model.costs import LETHAL

if TYPE_CHECKING:
    from collections.abc import Callable

    from bokeh.document import Document
    from bokeh.events import Pan, PanEnd, PanStart, Tap

    from optdock.ui.scene_edits import EditedScene
    from optdock.ui.scene_grips import Grip
    from optdock.ui.scene_history import SceneHistory
    from optdock.ui.scene_view import SceneView

__all__ = ["ScenePointer"]

_REACH = 14.0  # [px]: tolerance of a pointer


class ScenePointer:
    """Drags of parts of a scene.

    Args:
        document: Document of the page.
        view: Figure of the scene.
        history: The scene.
        on_select: Called after a part was selected.
        on_map: Called after a drag that began at an occupied cell of the map.
    """

    def __init__(
        self,
        document: Document,
        view: SceneView,
        history: SceneHistory,
        on_select: Callable[[], object],
        on_map: Callable[[], object],
    ) -> None:
        from bokeh import events

        self._document, self._view, self._history = document, view, history
        self._on_select, self._on_map = on_select, on_map
        self._held: tuple[Grip, EditedScene] | None = None  # the grip, and the scene at the beginning of the drag
        self._made = history.scene  # by the drag; after any other change of the scene, the part is not held any more
        self._place: tuple[float, float] | None = None  # newest place of the pointer that has not been applied
        self._on_wall: tuple[float, float] | None = None  # place of the map at which a drag began
        for kind, call in (
            (events.PanStart, self._grab), (events.Pan, self._drag), (events.PanEnd, self._release),
            (events.Tap, self._tap),
        ):  # fmt: skip
            view.axes.on_event(kind, call)

    @property
    def is_dragging(self) -> bool:
        """Whether a part is held."""
        return self._held is not None and self._made is self._history.scene

    def _grab(self, event: PanStart) -> None:
        if self.is_dragging:  # the end of the last drag has been lost
            self._history.drop(lambda scene: scene)
        grip = self._tap(event)
        self._made = self._history.scene
        self._held = None if grip is None else (grip, self._made)
        costmap = self._made.problem.costmap
        is_wall = grip is None and costmap is not None and costmap.cost_at([(event.x, event.y)])[0] == LETHAL
        self._on_wall = (event.x, event.y) if is_wall else None

    def _drag(self, event: Pan) -> None:
        is_first, self._place = self._place is None, (event.x, event.y)
        if is_first:
            self._document.add_next_tick_callback(self._follow)

    def _follow(self) -> None:
        """Move the held part to the newest place of the pointer."""
        place, self._place = self._place, None
        if self._held is not None and place is not None and self.is_dragging:
            grip, base = self._held
            self._history.edit(lambda _: self._dragged(base, grip, place), in_hand=True)

    def _release(self, event: PanEnd) -> None:
        self._place = None
        if self._held is not None and self.is_dragging:
            grip, base = self._held
            self._history.drop(lambda _: self._dragged(base, grip, (event.x, event.y)))
        self._held = None
        # The browser ends the drag of a finger that scrolls the page after a few pixels.
        if self._on_wall is not None and math.dist(self._on_wall, (event.x, event.y)) > self._view.metres(_REACH):
            self._on_map()
        self._on_wall = None

    def _dragged(self, base: EditedScene, grip: Grip, place: tuple[float, float]) -> EditedScene:
        self._made = base.dragged(grip, place)
        return self._made

    def _tap(self, event: PanStart | Tap) -> Grip | None:
        """Select and return the part at the pointer."""
        try:
            grip = self._history.scene.grip_at(event.x, event.y, self._view.metres(_REACH), self._history.selected)
        except (InvalidValue, TypeError):  # outside of the axes
            return None
        if grip is not None:
            self._history.select(grip.name)
            self._on_select()
        return grip
