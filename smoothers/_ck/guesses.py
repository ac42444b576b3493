"""First variables without an earlier result: fitted to the input's headings, or driven along the input."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from smoothers._ck.closing import clipped
from smoothers._ck.pursuit import pursued_variables
from smoothers._ck.rollout import Variables, roll_out

if TYPE_CHECKING:
    from optdock.geometry.arrays import FloatArray
    from smoothers._ck.closing import Bounds, Ends
    from smoothers._ck.initial import Traced
    from smoothers._ck.layout import Layout

__all__ = ["Guesses"]

_ASTRAY, _TURNED_AWAY = 0.4, 0.4  # [m], [rad]: a fit that leads further from the input is not begun with
_DIFFERENT = 0.15  # [m]: guesses closer together lead to the same result


@dataclass(frozen=True, eq=False)
class Guesses:
    """The two guesses for one input.

    Args:
        layout: Shape of the path.
        traced: The input at the nodes.
        lengths: Gear lengths to begin with, Shape (num_gears,) [m].
        ends: Start, target, gears.
        bounds: Curvatures and lengths stay inside.
    """

    layout: Layout
    traced: Traced
    lengths: FloatArray
    ends: Ends
    bounds: Bounds

    @cached_property
    def fitted(self) -> Variables:
        """Curvatures whose headings fit the input's in the least squares sense, smoothed and cut to the limit."""
        turned = self.layout.fit @ (self.traced.headings - self.ends.start[2])
        return clipped(Variables(turned / self.layout.per_knot(self.lengths), self.lengths.copy()), self.bounds)

    @cached_property
    def pursued(self) -> Variables:
        """A drive along the input within the limits."""
        return clipped(pursued_variables(self.layout, self.traced.positions, self.ends, self.bounds), self.bounds)

    @cached_property
    def first(self) -> Variables:
        """The fit, or the drive where the fit leads away from the input."""
        driven = roll_out(self.layout, self.fitted, self.ends.start, self.ends.signs)
        away = np.abs(driven.poses[:, :2] - self.traced.positions).max()
        turned = abs(float(driven.poses[-1, 2] - self.ends.target[2]))
        return self.fitted if away < _ASTRAY and turned < _TURNED_AWAY else self.pursued

    def other(self) -> Variables | None:
        """The guess that is not the first, or None where it is much the same."""
        second = self.pursued if self.first is self.fitted else self.fitted
        poses = [roll_out(self.layout, v, self.ends.start, self.ends.signs).poses for v in (self.first, second)]
        apart = float(np.abs(poses[0][:, :2] - poses[1][:, :2]).max())
        return second if apart > _DIFFERENT else None
