"""Animated GIF of a docking in MuJoCo, rendered by MuJoCo; needs the extra `sim`."""

from __future__ import annotations

import math
import os
import sys
from contextlib import ExitStack
from importlib import import_module
from typing import TYPE_CHECKING, Any

import numpy as np

from experiments.mujoco.plant import MujocoPhysics, load_mujoco
from optdock.errors import InvalidValue, MissingExtra
from optdock.plotting.animation import frame_count, save_gif

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from PIL.Image import Image

    from experiments.mujoco.plant import MujocoDrive
    from optdock.geometry.arrays import FloatArray
    from optdock.simulation.plant import PlantState

__all__ = ["save_mujoco_animation"]

_WIDTH = 720  # pixels
_MARGIN = 0.15  # [m] around robot and station
_ELEVATION = -60.0  # [deg] of the camera
_TRACE = (0.0, 0.45, 0.70, 1.0)  # Okabe and Ito's blue
_TRACE_WIDTH, _TRACE_HEIGHT = 0.006, 0.003  # [m]
_COLOURS = 64


def save_mujoco_animation(target: str | Path, drive: MujocoDrive, states: Sequence[PlantState]) -> None:
    """Write an animation of a docking, seen from above its right side, ten frames a second, time-lapse for long runs.

    The projection is parallel: the scale is constant along the dock's axis and across it.

    Args:
        target: GIF file to write.
        drive: The plant that made the states.
        states: States of the plant, the oldest first.

    Raises:
        MissingExtra: If MuJoCo is not installed, or this machine cannot render.
        InvalidValue: If there are fewer than two states, or they are of another plant.
        InvalidFile: If the file cannot be written.
    """
    from PIL import Image as Images
    from PIL import ImageDraw

    if len(states) < 2:
        raise InvalidValue(f"mujoco: an animation needs at least two states, got {len(states)}")
    times = np.array([state.time for state in states])
    count = frame_count(float(times[-1] - times[0]))
    with ExitStack() as closing:
        camera = _Camera(drive, states, closing)
        frames: list[Image] = []
        for time in np.linspace(times[0], times[-1], count):
            last = int(np.searchsorted(times, time, side="right")) - 1
            drive.show(states[last])
            trace = np.array([(state.pose.x, state.pose.y) for state in states[: last + 1]])
            picture = camera.picture(trace)
            ImageDraw.Draw(picture).text((12, 8), _words(states[: last + 1]), fill=(0, 0, 0), font_size=18)
            frames.append(picture)
    palette = frames[-1].quantize(_COLOURS)
    frames = [picture.quantize(palette=palette, dither=Images.Dither.NONE) for picture in frames]
    save_gif(target, frames, float(times[-1] - times[0]))


def _words(states: Sequence[PlantState]) -> str:
    """Return a caption: time, and the largest contact force so far."""
    forces = [state.physics.force for state in states if isinstance(state.physics, MujocoPhysics)]
    largest = max(float(np.max(np.hypot(force[:, 0], force[:, 1]), initial=0.0)) for force in forces)
    return f"{states[-1].time:.1f} s   largest contact force {largest:.0f} N"


class _Camera:
    """Renderer of a plant's data with the whole run in view; released when `closing` closes."""

    def __init__(self, drive: MujocoDrive, states: Sequence[PlantState], closing: ExitStack) -> None:
        self._mujoco = mujoco = load_mujoco()
        self._drive = drive
        robot, dock = drive.robot.footprint, drive.dock
        reach = robot.circumscribed_radius + _MARGIN
        points = np.array([(state.pose.x, state.pose.y) for state in states] + [(dock.pose.x, dock.pose.y)])
        c, s = math.cos(dock.pose.yaw), math.sin(dock.pose.yaw)
        seen = points @ np.array([[c, -s], [s, c]])  # along and across the dock's axis
        lower, upper = seen.min(axis=0) - reach, seen.max(axis=0) + reach
        wide, deep = upper - lower
        tall = deep * math.sin(math.radians(-_ELEVATION))
        self._width, self._height = _WIDTH, 2 * round(0.5 * _WIDTH * tall / wide)
        middle = 0.5 * (lower + upper) @ np.array([[c, s], [-s, c]])
        self._view = view = mujoco.MjvCamera()
        view.lookat[:] = *middle, 0.0
        view.distance, view.azimuth, view.elevation = 10.0, 90.0 + math.degrees(dock.pose.yaw), _ELEVATION
        view.orthographic = drive.model.vis.global_.orthographic = 1
        drive.model.vis.global_.fovy = tall  # in a parallel projection the height of the picture [m]
        drive.model.vis.global_.offwidth = max(self._width, drive.model.vis.global_.offwidth)
        drive.model.vis.global_.offheight = max(self._height, drive.model.vis.global_.offheight)
        canvas = _canvas(self._width, self._height)
        closing.callback(canvas.free)
        canvas.make_current()
        self._scene = mujoco.MjvScene(drive.model, maxgeom=2 * len(states) + 100)
        self._context = mujoco.MjrContext(drive.model, mujoco.mjtFontScale.mjFONTSCALE_100)
        closing.callback(self._context.free)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._context)

    def picture(self, trace: FloatArray) -> Image:
        """Return a picture of the current data of the plant and of the trace of its axle, Shape (n, 2) [m]."""
        from PIL import Image as Images

        mujoco, scene = self._mujoco, self._scene
        everything = mujoco.mjtCatBit.mjCAT_ALL
        mujoco.mjv_updateScene(
            self._drive.model, self._drive.data, mujoco.MjvOption(), None, self._view, everything, scene
        )
        for start, end in zip(trace[:-1:2], trace[2::2], strict=False):
            geom = scene.geoms[scene.ngeom]
            mujoco.mjv_initGeom(
                geom,
                mujoco.mjtGeom.mjGEOM_CAPSULE,
                np.zeros(3),
                np.zeros(3),
                np.zeros(9),
                np.array(_TRACE, dtype=np.float32),
            )
            ends = (np.array([*point, _TRACE_HEIGHT]) for point in (start, end))
            mujoco.mjv_connector(geom, mujoco.mjtGeom.mjGEOM_CAPSULE, _TRACE_WIDTH, *ends)
            scene.ngeom += 1
        area = mujoco.MjrRect(0, 0, self._width, self._height)
        mujoco.mjr_render(area, scene, self._context)
        pixels = np.empty((self._height, self._width, 3), dtype=np.uint8)
        mujoco.mjr_readPixels(pixels, None, area, self._context)
        return Images.fromarray(pixels[::-1].copy())


def _canvas(width: int, height: int) -> Any:  # noqa: ANN401 - one of three classes of MuJoCo's
    """Return an OpenGL context of the first available kind, or of the kind in `MUJOCO_GL`."""
    chosen = os.environ.get("MUJOCO_GL", "").lower()
    kinds = (
        (chosen,)
        if chosen in ("egl", "osmesa", "glfw")
        else ("egl", "osmesa")
        if sys.platform == "linux"
        else ("glfw",)
    )
    reasons = []
    for kind in kinds:
        canvas, reason = _opened(kind, width, height)
        if canvas is not None:
            return canvas
        reasons.append(reason)
    raise MissingExtra(f"MuJoCo cannot draw here, install EGL or OSMesa (libegl1, libosmesa6): {'; '.join(reasons)}")


def _opened(kind: str, width: int, height: int) -> tuple[Any, str]:
    """Return a context of this kind, or None and the reason; drivers and PyOpenGL raise arbitrary exceptions."""
    try:
        return import_module(f"mujoco.{kind}").GLContext(width, height), ""
    except Exception as error:
        return None, f"{kind}: {type(error).__name__}: {error}"
