"""The latency of the drive, identified from commands and measured velocities."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from optdock.geometry.arrays import readonly

if TYPE_CHECKING:
    from optdock.geometry.arrays import FloatArray

__all__ = ["DelayEstimate"]

_LONGEST_LATENCY = 0.2  # [s]
_LATENCIES = readonly(np.linspace(0.0, _LONGEST_LATENCY, 11))  # [s], of the models
_LAGS = readonly(np.linspace(0.0, 0.3, 13))  # [s], likewise
_DELAYS = readonly(_LATENCIES[:, None] + _LAGS)
_MOVING = 0.01  # [m/s]: a drive that is held, or whose speed is not measured, says nothing
_MEMORY = 3.0  # [s], after which old evidence counts 1/e
_EVIDENCE = 1e-5  # [m^2/s]: by how much the best model must beat the worst
_BETTER = 0.7  # misfit of a model that replaces the best so far: neighbours must not take turns
_SLEW = 0.5  # [s/s]: how fast the estimate may move, so that the feed-forward does not jump


class DelayEstimate:
    """Runs a bank of models beside the drive, and tells the delay of the one that fits its speed best.

    Every model is a latency followed by a first-order lag; for a feed-forward only their sum matters. The period may
    change from update to update: what was told is remembered with its time, and the models run on that.

    Args:
        delay: What is known already [s].

    Attributes:
        delay: Latency plus lag of the best model [s]; what was known until there is evidence.
    """

    def __init__(self, delay: float = 0.0) -> None:
        self.delay = delay
        self._now = 0.0
        self._since = [-_LONGEST_LATENCY]  # when each command was given [s], the oldest first
        self._told = [0.0]  # [m/s]
        self._speeds = np.zeros((_LATENCIES.size, _LAGS.size))
        self._misfit = np.zeros(self._speeds.shape)
        self._best = 0

    @property
    def latency_and_lag(self) -> tuple[float, float]:
        """The delay in its two parts, as the best model has them [s]."""
        whole = float(_DELAYS.flat[self._best])
        lag = self.delay * float(_LAGS[self._best % _LAGS.size]) / whole if whole > 0.0 else 0.0
        return self.delay - lag, lag

    def update(self, command: float, speed: float, period: float) -> None:
        """Take in the speed [m/s] measured at the end of the `period` [s] in which `command` was given [m/s]."""
        if period <= 0.0:
            return
        self._since.append(self._now)
        self._told.append(command)
        begin, self._now = self._now, self._now + period
        while len(self._since) > 2 and self._since[1] <= begin - _LONGEST_LATENCY:
            del self._since[0], self._told[0]
        self._drive(begin, period)
        if abs(speed) < _MOVING:
            return
        self._misfit *= math.exp(-period / _MEMORY)
        self._misfit += period * (self._speeds - speed) ** 2
        best = int(np.argmin(self._misfit))
        if float(self._misfit.flat[best]) < _BETTER * float(self._misfit.flat[self._best]):
            self._best = best
        convincing = float(self._misfit.max()) - float(self._misfit.flat[best]) > _EVIDENCE
        wanted = float(_DELAYS.flat[self._best]) if convincing else self.delay
        step = _SLEW * period
        self.delay += min(max(wanted - self.delay, -step), step)

    def _drive(self, begin: float, period: float) -> None:
        """Let every model drive the last period: of two commands in it, each as long as it is in force there."""
        since, told = np.array(self._since), np.array(self._told)
        start, end = begin - _LATENCIES, begin - _LATENCIES + period
        first = np.searchsorted(since, start, side="right") - 1
        last = np.searchsorted(since, end, side="left") - 1
        at = start
        for k in range(int(np.max(last - first)) + 1):
            row = np.minimum(first + k, last)
            until = np.where(row >= last, end, np.append(since, np.inf)[row + 1])
            decay = _decay(np.maximum(until - at, 0.0)[:, None])
            self._speeds = decay * self._speeds + (1.0 - decay) * told[row][:, None]
            at = until


def _decay(time: FloatArray) -> FloatArray:
    """What is left of an old speed after `time` [s], for every lag; Shape (n, 1) to (n, lags)."""
    with np.errstate(divide="ignore", invalid="ignore"):
        left: FloatArray = np.where(time > 0.0, np.exp(-time / _LAGS), 1.0)
    return left
