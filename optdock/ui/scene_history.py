"""The scene of a page with its earlier versions, the selected part, and edits by buttons and keys."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Protocol

from optdock.errors import OptdockError

if TYPE_CHECKING:
    from collections.abc import Callable

    from optdock.plotting.scene import View
    from optdock.ui.scene_edits import EditedScene

__all__ = ["STEP", "TURN", "SceneHistory"]

STEP, TURN = 0.05, math.radians(5.0)  # [m], [rad] of a button or key
_MOST = 100  # earlier scenes
_MOVES = {"ArrowLeft": (-STEP, 0.0), "ArrowRight": (STEP, 0.0), "ArrowUp": (0.0, STEP), "ArrowDown": (0.0, -STEP)}
_TURNS = {"q": TURN, "e": -TURN}


class SceneChanged(Protocol):
    """Function that is called after a change of a scene."""

    def __call__(self, *, in_hand: bool, fault: str) -> object:
        """Show the scene.

        Args:
            in_hand: Whether the change goes on, as during a drag.
            fault: Message of a refused change; otherwise empty.
        """


class SceneHistory:
    """A scene that is edited.

    Attribute `scene`: the present scene. Attribute `selected`: name of the part to which keys and buttons apply.

    Args:
        scene: The first scene.
        on_change: Called after every change, and after a refused change.
    """

    def __init__(self, scene: EditedScene, on_change: SceneChanged) -> None:
        self.scene, self.selected = scene, "start"
        self._on_change = on_change
        self._earlier: list[EditedScene] = []
        self._later: list[EditedScene] = []
        self._base: EditedScene | None = None  # the scene at the beginning of a change that goes on

    def edit(self, change: Callable[[EditedScene], EditedScene], *, in_hand: bool = False) -> None:
        """Replace the scene by a changed one; it stays as it is if the change raises an error.

        Args:
            change: Function that returns the changed scene.
            in_hand: Whether the change goes on, as during a drag. The next edit that does not go on ends it, and all of
                it is one step of `undo`.
        """
        fault, changed = "", self.scene
        try:
            changed = change(self.scene)
        except OptdockError as error:
            fault = str(error)
        if changed is not self.scene or (self._base is not None and not in_hand):
            self._replace(changed, in_hand=in_hand)
        if fault:
            self.select(self.selected)
            self._on_change(in_hand=in_hand, fault=fault)

    def drop(self, change: Callable[[EditedScene], EditedScene]) -> None:
        """End a change that went on; after an error, its last valid scene stays.

        Args:
            change: Function that returns the changed scene.
        """
        self._base = self._base or self.scene
        self.edit(change)

    def undo(self) -> None:
        """Return to the scene before the last change."""
        if self._base is not None:  # the change that goes on is undone
            self._remember(self._base)
            self._base = None
        self._travel(self._earlier, self._later)

    def redo(self) -> None:
        """Repeat a change that was undone."""
        if self._base is None:
            self._travel(self._later, self._earlier)

    def select(self, name: str) -> None:
        """Select a part, or the start if the scene has no such part."""
        self.selected = name if any(one.name == name for one in self.scene.handles) else "start"

    def nudge(self, dx: float, dy: float) -> None:
        """Move the selected part [m]."""
        self.edit(lambda scene: scene.nudged(scene.grip(self.selected), dx, dy))

    def turn(self, angle: float) -> None:
        """Turn the selected part [rad]."""
        self.edit(lambda scene: scene.turned(scene.grip(self.selected), angle))

    def remove(self) -> None:
        """Remove the selected obstacle, and select the start, because later obstacles have new names."""
        before = self.scene
        self.edit(lambda scene: scene.removed(scene.grip(self.selected)))
        if self.scene is not before:
            self.select("start")

    def add(self, view: View, *, is_wall: bool) -> None:
        """Add a box, or a wall of a quarter of the width of a view, in the middle of the view, and select it."""
        x, y, half = 0.5 * (view.left + view.right), 0.5 * (view.bottom + view.top), 0.125 * (view.right - view.left)
        self.selected = f"obstacles[{len(self.scene.polygons)}]"
        self.edit(lambda scene: scene.added_wall(x - half, y, x + half, y) if is_wall else scene.added_box(x, y))

    def press(self, key: str) -> None:
        """Apply a key: arrows move the selected part, q and e turn it, Delete removes it, z undoes."""
        if key in _MOVES:
            self.nudge(*_MOVES[key])
        elif key in _TURNS:
            self.turn(_TURNS[key])
        elif key == "Delete":
            self.remove()
        elif key == "z":
            self.undo()

    def _replace(self, changed: EditedScene, *, in_hand: bool) -> None:
        before = self.scene if self._base is None else self._base
        self._base = before if in_hand else None
        if not in_hand and changed is not before:
            self._remember(before)
        self.scene = changed
        self.select(self.selected)
        self._on_change(in_hand=in_hand, fault="")

    def _remember(self, scene: EditedScene) -> None:
        self._earlier.append(scene)
        del self._earlier[:-_MOST]
        self._later.clear()

    def _travel(self, source: list[EditedScene], target: list[EditedScene]) -> None:
        if source:
            target.append(self.scene)
            self.scene = source.pop()
            self.select(self.selected)
            self._on_change(in_hand=False, fault="")
