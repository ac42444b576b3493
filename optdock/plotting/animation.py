"""Animated GIF of a drive."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from optdock.geometry.pose import transform_points
from optdock.io.atomic_file import replacing
from optdock.plotting.canvas import COLOURS, DPI, canvas_of, new_figure
from optdock.plotting.scene import OutlineStyle, draw_footprints, draw_scene, view_of

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from PIL.Image import Image

    from optdock.geometry.arrays import FloatArray
    from optdock.model.problem import DockingProblem

__all__ = ["frame_count", "save_animation", "save_gif"]

_APART = 0.15  # [m]: distance between the outlines that stay in the picture
_FRAME_TIME = 0.1  # [s]
_MOST_FRAMES = 150
_HOLD = 1500  # [ms] on the last frame
_BORDER = 0.06  # [inch] of white around the axes


def save_animation(
    target: str | Path,
    problem: DockingProblem,
    times: FloatArray,
    poses: FloatArray,
    on_frame: Callable[[int, int], None] | None = None,
) -> None:
    """Write an animation of the drive and the swept area with ten frames per second; long drives are played faster.

    Args:
        target: GIF file to write.
        problem: The docking problem.
        times: Times of the poses, Shape (n,) [s].
        poses: Driven poses, Shape (n, 3) [m, m, rad].
        on_frame: Callback with the number of finished frames and of all frames.

    Raises:
        MissingExtra: If Matplotlib is not installed.
        InvalidFile: If the file cannot be written.
    """
    stage = _Stage(problem, poses)
    count = frame_count(float(times[-1]))
    frames: list[Image] = []
    for i, time in enumerate(np.linspace(times[0], times[-1], count)):
        pose = np.array([[np.interp(time, times, poses[:, k]) for k in range(3)]])
        frames.append(stage.frame(pose, f"{time:.1f} s"))
        if on_frame is not None:
            on_frame(i + 1, count)
    save_gif(target, frames, float(times[-1]))


def frame_count(duration: float) -> int:
    """Return the number of frames for a drive of `duration` [s]: ten per second, at most 150."""
    return min(max(math.ceil(duration / _FRAME_TIME), 2), _MOST_FRAMES)


def save_gif(target: str | Path, frames: list[Image], duration: float) -> None:
    """Write frames that last `duration` [s], at least ten per second, as a loop with a pause on the last frame.

    Raises:
        InvalidFile: If the file cannot be written.
    """
    step = int(1e3 * min(duration / len(frames), _FRAME_TIME))
    with replacing(target) as temporary:
        frames[0].save(
            temporary,
            format="GIF",
            save_all=True,
            append_images=frames[1:],
            duration=[step] * (len(frames) - 1) + [_HOLD],
            loop=0,
            disposal=1,
        )


class _Stage:
    """Scene, which is drawn once, and robot, which is drawn in every frame."""

    def __init__(self, problem: DockingProblem, poses: FloatArray) -> None:
        view = view_of(problem, [poses])
        figure = new_figure(*view.figure_size(width=7.0, tallest=7.0))
        self._axes = figure.add_subplot()
        draw_scene(self._axes, problem, view)
        goal = OutlineStyle(edge=COLOURS["goal"], line="--", order=4.0)
        draw_footprints(self._axes, problem.robot.footprint, problem.goal.as_array()[None], goal)
        self._axes.plot(poses[:, 0], poses[:, 1], color=COLOURS["path"], linewidth=1.0, alpha=0.5)
        self._vertices = problem.robot.footprint.vertices
        self._nose = np.array([[0.0, 0.0], [float(np.max(self._vertices[:, 0])), 0.0]])
        self._canvas = canvas_of(figure)
        self._canvas.draw()
        self._background = self._canvas.copy_from_bbox(figure.bbox)
        (left, bottom), (right, top) = DPI * figure.get_tightbbox().padded(_BORDER).get_points()
        wide, high = figure.bbox.size
        self._crop = (
            max(0, int(left)),
            max(0, int(high - top)),
            min(int(wide), math.ceil(right)),
            int(high - max(0.0, bottom)),
        )
        (self._outline,) = self._axes.fill(
            [0.0, 0.0, 1.0], [0.0, 1.0, 0.0], facecolor=COLOURS["robot"], edgecolor="black", alpha=0.85
        )
        (self._trace,) = self._axes.fill(
            [0.0, 0.0, 1.0], [0.0, 1.0, 0.0], fill=False, edgecolor=COLOURS["robot"], linewidth=0.6
        )
        self._left_behind: FloatArray | None = None  # pose of the last outline that stays in the picture
        (self._arrow,) = self._axes.plot([], [], color="black", linewidth=2.0)
        self._palette: Image | None = None  # palette of the first frame, which has all colours
        self._clock = self._axes.text(0.02, 0.96, "", transform=self._axes.transAxes, va="top", fontsize=11)

    def frame(self, pose: FloatArray, clock: str) -> Image:
        """Return the picture with the robot at a pose, Shape (1, 3)."""
        from PIL import Image as Images

        self._outline.set_xy(transform_points(pose, self._vertices)[0])
        self._arrow.set_data(*transform_points(pose, self._nose)[0].T)
        self._clock.set_text(clock)
        self._canvas.restore_region(self._background)
        if self._left_behind is None or np.hypot(*(pose - self._left_behind)[0, :2]) >= _APART:
            self._left_behind = pose
            self._trace.set_xy(self._outline.get_xy())
            self._axes.draw_artist(self._trace)
            self._background = self._canvas.copy_from_bbox(self._axes.figure.bbox)
        for artist in (self._outline, self._arrow, self._clock):
            self._axes.draw_artist(artist)
        picture = Images.fromarray(np.asarray(self._canvas.buffer_rgba())[..., :3].copy()).crop(self._crop)
        if self._palette is None:
            self._palette = picture.quantize(colors=128, method=Images.Quantize.FASTOCTREE)
        return picture.quantize(palette=self._palette, dither=Images.Dither.NONE)
