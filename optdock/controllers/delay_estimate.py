"""How late the drive answers, identified on the way from what it was told and what it does."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from optdock.geometry.arrays import FloatArray

__all__ = ["DelayEstimate"]

_LONGEST_LATENCY, _LONGEST_LAG = 0.2, 0.3  # [s], bounds of the models
_LAG_STEP = 0.025  # [s]
_MOVING = 0.01  # [m/s]: a drive that is held, or whose speed is not measured, says nothing
_MEMORY = 3.0  # [s], after which old evidence counts 1/e
_EVIDENCE = 1e-5  # [m^2/s]: by how much the best model must beat the worst
_SLEW = 0.5  # [s/s]: how fast the estimate may move, so that the feed-forward does not jump


class DelayEstimate:
    """Runs a bank of models beside the drive, and tells the delay of the one that fits its speed best.

    Every model is a latency followed by a first-order lag; for a feed-forward only their sum matters.

    Args:
        period: Time between two updates [s].
        delay: What is known already [s].

    Attributes:
        delay: Latency plus lag of the best model [s]; what was known until there is evidence.
    """

    def __init__(self, period: float, delay: float = 0.0) -> None:
        self.delay = delay
        self._period = period
        lags = np.arange(0.0, _LONGEST_LAG + 1e-9, _LAG_STEP)
        self._latencies = np.arange(math.floor(_LONGEST_LATENCY / period + 1e-9) + 1)  # in periods
        with np.errstate(divide="ignore"):
            self._gain = np.where(lags > 0.0, 1.0 - np.exp(-period / np.maximum(lags, 1e-12)), 1.0)
        self._delays = period * self._latencies[:, None] + lags
        self._history: FloatArray = np.zeros(self._latencies.size)
        self._speeds = np.zeros(self._delays.shape)
        self._misfit = np.zeros(self._delays.shape)

    def update(self, command: float, speed: float) -> None:
        """Take in the speed [m/s] measured at the end of the period in which `command` was given [m/s]."""
        self._history = np.concatenate(([command], self._history[:-1]))
        self._speeds += self._gain * (self._history[:, None] - self._speeds)
        if abs(speed) < _MOVING:
            return
        self._misfit *= 1.0 - self._period / _MEMORY
        self._misfit += self._period * (self._speeds - speed) ** 2
        best = int(np.argmin(self._misfit))
        convincing = float(self._misfit.max()) - float(self._misfit.flat[best]) > _EVIDENCE
        wanted = float(self._delays.flat[best]) if convincing else self.delay
        step = _SLEW * self._period
        self.delay += min(max(wanted - self.delay, -step), step)
