"""Timing of the control loop: the period between calls, and the delay of the drive."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from optdock.errors import NoValidControl
from optdock.geometry.arrays import readonly
from optdock.geometry.checked import finite_number
from optdock.kernels import Kernel, twin_of

if TYPE_CHECKING:
    from optdock.geometry.arrays import FloatArray
    from optdock.plugins.lifecycle import PluginContext

__all__ = ["ControlClock", "DelayEstimate", "advanced"]

_FIRST = 0.005  # [s]: assumed before the first call, so that its command is also admissible at 200 Hz
_LONGEST = 0.5  # [s]: after a longer silence the response to the last command is unknown
_MOST_GROWTH = 2.0  # factor on the filtered period that bounds the effect of one late call
_SMOOTHING = 0.2  # weight of the newest period in the filtered period

_LONGEST_LATENCY = 0.2  # [s]
_LATENCIES = readonly(np.linspace(0.0, _LONGEST_LATENCY, 11))  # [s], of the models
_LAGS = readonly(np.linspace(0.0, 0.3, 13))  # [s], of the models
_MODELS = readonly(np.concatenate((_LATENCIES, _LAGS)))
_DELAYS = readonly(_LATENCIES[:, None] + _LAGS)
_MOVING = 0.01  # [m/s]: slower measurements are ignored: the drive is held, or its speed is not measured
_MEMORY = 3.0  # [s], time constant of forgetting
_EVIDENCE = 1e-5  # [m^2/s]: least difference between the best and the worst misfit
_BETTER = 0.7  # misfit of a new best model relative to the present one (hysteresis)
_SLEW = 0.5  # [s/s]: largest change of the estimate, so that the feed-forward does not jump


class ControlClock:
    """Period of the calls, measured from their stamps.

    Attributes:
        now: Stamp of the last call [s]; None before the first call.
        elapsed: Time between the last two calls [s], at most half a second.
        period: Filtered period, the estimate of the next period [s].
        learnt: Whether the last call was the first call with a measured period.
        silent: Whether the last call was the first call, or came more than half a second after the previous call.
    """

    def __init__(self) -> None:
        self.now: float | None = None
        self.elapsed = 0.0
        self.period = _FIRST
        self.learnt = False
        self.silent = True
        self._gaps = 0

    def tick(self, stamp: float | None, context: PluginContext, period: float | None = None) -> None:
        """Register a call.

        Args:
            stamp: Time of the call [s]; None: the present time on the context's clock.
            context: Context with the clock and the name for messages.
            period: Fixed period [s]; None: measured.

        Raises:
            NoValidControl: If the clock went back. Calls are rejected until the clock has caught up or is reset.
            InvalidValue: If the stamp is not a finite number.
        """
        stamp = context.clock() if stamp is None else finite_number(stamp, f"{context.name}: stamp")
        before = self.now
        if before is not None and stamp < before:
            raise NoValidControl(
                f"{context.name}: the clock went back from {before} s to {stamp} s; reset the controller if intended",
                where={"stamp": stamp, "before": before},
            )
        self.now = stamp
        if period is not None:
            self.elapsed = self.period = period
            self.silent = self.learnt = before is None
            return
        gap = math.inf if before is None else stamp - before
        self.silent = gap > _LONGEST
        self.elapsed = min(gap, _LONGEST) if before is not None else _FIRST
        self.learnt = False
        if gap == 0.0 or self.silent:
            return
        self._gaps += 1
        self.learnt = self._gaps == 1
        self.period = (
            gap if self.learnt else self.period + _SMOOTHING * (min(gap, _MOST_GROWTH * self.period) - self.period)
        )


class DelayEstimate:
    """Estimator of the drive's delay by a bank of models, from commands and measured speeds.

    Every model is a latency followed by a first-order lag; the feed-forward needs only their sum. The period may vary.

    Args:
        delay: Known delay [s].

    Attributes:
        delay: Latency plus lag of the best model [s]; the known delay until the data determine it.
    """

    def __init__(self, delay: float = 0.0) -> None:
        self.delay = delay
        self._now = 0.0
        self._since = [-_LONGEST_LATENCY]  # times of the commands [s], the oldest first
        self._commands = [0.0]  # [m/s]
        self._share_of_lag = 0.0
        self._models = np.zeros((2, _LATENCIES.size, _LAGS.size))  # speeds [m/s] and misfits [m^2/s]
        self._best = 0

    @property
    def latency_and_lag(self) -> tuple[float, float]:
        """Latency and lag [s]: the delay, divided in the same ratio as in the best model."""
        lag = self.delay * self._share_of_lag
        return self.delay - lag, lag

    def update(self, command: float, speed: float, period: float) -> None:
        """Update with the speed [m/s] measured at the end of a `period` [s] of the given `command` [m/s]."""
        if period <= 0.0:
            return
        self._since.append(self._now)
        self._commands.append(command)
        begin, self._now = self._now, self._now + period
        while len(self._since) > 2 and self._since[1] <= begin - _LONGEST_LATENCY:
            del self._since[0], self._commands[0]
        is_moving = abs(speed) >= _MOVING
        forgotten, weight = (math.exp(-period / _MEMORY), period) if is_moving else (1.0, 0.0)
        history = self._since, self._commands
        self._models = advanced(self._models, history, (begin, period), (speed, forgotten, weight))
        if not is_moving:
            return
        misfit = self._models[1]
        best = int(misfit.argmin())
        if misfit.item(best) < _BETTER * misfit.item(self._best):
            self._best = best
            whole = _DELAYS.item(best)
            self._share_of_lag = _LAGS.item(best % _LAGS.size) / whole if whole > 0.0 else 0.0
        convincing = float(misfit.max()) - misfit.item(best) > _EVIDENCE
        wanted = _DELAYS.item(self._best) if convincing else self.delay
        step = _SLEW * period
        self.delay += min(max(wanted - self.delay, -step), step)


_ADVANCE = Kernel("optdock_advance_models", sizes=3, numbers=5)


def _advanced_natively(
    models: FloatArray,
    history: tuple[list[float], list[float]],
    span: tuple[float, float],
    measured: tuple[float, float, float],
) -> FloatArray:
    (_, latencies, lags), given, count = models.shape, len(history[0]), models.size
    out, commands = np.empty(models.shape), np.array(history[0] + history[1])
    arrays = (models, count), (commands, 2 * given), (_MODELS, latencies + lags), (out, count)
    _ADVANCE((latencies, lags, given), (*span, *measured), arrays)
    return out


@twin_of(_advanced_natively)
def advanced(
    models: FloatArray,
    history: tuple[list[float], list[float]],
    span: tuple[float, float],
    measured: tuple[float, float, float],
) -> FloatArray:
    """Return all models after a period, from the commands in force during this period and the speed at its end.

    Args:
        models: Speeds [m/s] and misfits [m^2/s] at the begin, Shape (2, latencies, lags).
        history: Times at which the commands came into force, ascending; the first is not later than the begin minus the
            longest latency [s]. Speeds that were commanded [m/s].
        span: Begin and duration of the period [s].
        measured: Speed at the end [m/s], factor on the misfits, and the duration for which the new errors count [s].

    Returns:
        Shape (2, latencies, lags).
    """
    speeds, misfits = models
    (times, values), (begin, period), (speed, kept, weight) = map(np.array, history), span, measured
    start, end = begin - _LATENCIES, begin - _LATENCIES + period
    first = np.searchsorted(times, start, side="right") - 1
    last = np.searchsorted(times, end, side="left") - 1
    at = start
    for k in range(int(np.max(last - first)) + 1):
        row = np.minimum(first + k, last)
        until = np.where(row >= last, end, np.append(times, np.inf)[row + 1])
        time = np.maximum(until - at, 0.0)[:, None]
        with np.errstate(divide="ignore", invalid="ignore"):
            decay = np.where(time > 0.0, np.exp(-time / _LAGS), 1.0)
        speeds = decay * speeds + (1.0 - decay) * values[row][:, None]
        at = until
    return np.stack((speeds, kept * misfits + weight * (speeds - speed) ** 2))
