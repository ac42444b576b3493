"""Estimates with 95 % confidence intervals, and what to say where a log holds none."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from optdock.geometry.arrays import FloatArray, IntArray

__all__ = [
    "CONFIDENCE",
    "LEAST_CLUSTERS",
    "Fit",
    "Quantity",
    "clusters_of",
    "fit",
    "mean_of",
    "poisson_rate",
    "share_of",
    "unknown",
]

CONFIDENCE = 0.95
LEAST_CLUSTERS = 3  # with fewer of them an interval is that of one degree of freedom: 13 standard deviations
_EVALUATIONS = 60  # of problems with three parameters that are solved within ten
_STEP = 1e-4  # of the spread of a parameter: where its central difference is exact to eight digits


@dataclass(frozen=True)
class Quantity:
    """A property of a robot, as some recordings tell it.

    Args:
        name: What it is.
        unit: Of all three numbers.
        value: The estimate; NaN where the recordings cannot tell.
        low: Of its 95 % confidence interval.
        high: Likewise.
        samples: How many measurements it is of.
        sources: How many recordings it is of.
        reason: Why the recordings cannot tell; empty where they can.
    """

    name: str
    unit: str
    value: float = math.nan
    low: float = math.nan
    high: float = math.nan
    samples: int = 0
    sources: int = 0
    reason: str = ""

    def __bool__(self) -> bool:
        """Whether the recordings can tell it."""
        return not self.reason

    @property
    def half_width(self) -> float:
        """Half of the interval's length."""
        return 0.5 * (self.high - self.low)


def unknown(name: str, unit: str, reason: str, samples: int = 0) -> Quantity:
    """A quantity that the recordings cannot tell."""
    return Quantity(name, unit, samples=samples, reason=reason)


class Fit(NamedTuple):
    """Parameters that fit measurements best.

    Attributes:
        values: The parameters, Shape (p,).
        covariance: Of them, Shape (p, p).
        freedom: Degrees of freedom of Student's t in their intervals.
        residuals: What is left, Shape (n,), in the units that were given.
    """

    values: FloatArray
    covariance: FloatArray
    freedom: float
    residuals: FloatArray

    def interval(self, index: int) -> tuple[float, float, float]:
        """Value, lower and upper bound of a parameter."""
        half = student(self.freedom) * math.sqrt(max(float(self.covariance[index, index]), 0.0))
        value = float(self.values[index])
        return value, value - half, value + half


def student(freedom: float) -> float:
    """How many standard deviations the 95 % interval extends to either side."""
    from scipy.stats import t

    return float(t.ppf(0.5 + 0.5 * CONFIDENCE, freedom))


def clusters_of(times: Iterable[FloatArray], length: float) -> list[IntArray]:
    """Of each residual: which stretch of which recording it is of, numbered through all recordings.

    Args:
        times: Of the residuals of each recording, since it began, Shape (n,) [s].
        length: Of a stretch [s].

    Returns:
        An array for each recording, Shape (n,).
    """
    found: list[IntArray] = []
    count = 0
    for since in times:
        number = (since / length).astype(np.intp) + count
        count = int(number.max()) + 1 if len(number) else count
        found.append(number)
    return found


def fit(
    residuals: Callable[[FloatArray], FloatArray],
    guess: Sequence[float],
    clusters: IntArray,
    scales: Sequence[float],
    *,
    bounds: tuple[Sequence[float], Sequence[float]] | None = None,
) -> Fit:
    """Robust least squares whose intervals hold where residuals of a cluster depend on each other.

    The loss is the soft L1 one, beyond 2.5 robust standard deviations of the residuals. The covariance is the clustered
    sandwich of [Cameron2015], H^-1 (sum of g g') H^-1 times G / (G - 1), with g the gradient of one of G clusters.

    Args:
        residuals: Of the parameters, Shape (n,).
        guess: Where to begin, p numbers.
        clusters: Which cluster each residual is of, Shape (n,).
        scales: What a small change of each parameter is.
        bounds: Lowest and highest values.
    """
    from scipy.optimize import least_squares

    start, steps = np.array(guess, dtype=np.float64), np.array(scales, dtype=np.float64)
    limits = bounds if bounds is not None else (-np.inf, np.inf)

    def solved(begin: FloatArray) -> tuple[FloatArray, FloatArray, float]:
        """Parameters, residuals, and the size from which on a residual counts less."""
        size = 2.5 * 1.4826 * float(np.median(np.abs(residuals(begin)))) + 1e-12
        found = least_squares(
            residuals, begin, x_scale=steps, loss="soft_l1", f_scale=size, bounds=limits, max_nfev=_EVALUATIONS
        )
        return found.x, residuals(found.x), size

    # The size that the guess has left is of no use; that of the second solution changes by a tenth at most.
    values, left, size = solved(solved(solved(start)[0])[0])
    weights = 1.0 / np.sqrt(1.0 + (left / size) ** 2)
    slopes = np.column_stack(
        [
            (residuals(values + step) - residuals(values - step)) / (2.0 * step[k])
            for k, step in enumerate(np.diag(_STEP * steps))
        ]
    )
    scored = slopes * (weights * left)[:, None]
    names, index = np.unique(clusters, return_inverse=True)
    gradients = np.zeros((len(names), len(start)))
    np.add.at(gradients, index, scored)
    inverse = np.linalg.pinv(slopes.T @ (weights[:, None] * slopes))
    count = max(len(names), 2)
    covariance = inverse @ (gradients.T @ gradients) @ inverse * (count / (count - 1.0))
    return Fit(values, covariance, count - 1.0, left)


def mean_of(values: FloatArray) -> tuple[float, float, float]:
    """Mean of two or more independent values, with the bounds of its Student interval."""
    mean, half = float(np.mean(values)), student(len(values) - 1.0) * float(np.std(values, ddof=1)) / len(values) ** 0.5
    return mean, mean - half, mean + half


def share_of(count: int, total: int) -> tuple[float, float, float]:
    """A share of so many, with the bounds of [Clopper1934]."""
    from scipy.stats import beta

    tail = 0.5 * (1.0 - CONFIDENCE)
    low = float(beta.ppf(tail, count, total - count + 1)) if count > 0 else 0.0
    high = float(beta.ppf(1.0 - tail, count + 1, total - count)) if count < total else 1.0
    return count / total, low, high


def poisson_rate(count: int, exposure: float) -> tuple[float, float, float]:
    """Events per unit of exposure, with the exact bounds of [Garwood1936]."""
    from scipy.stats import chi2

    tail = 0.5 * (1.0 - CONFIDENCE)
    low = 0.5 * float(chi2.ppf(tail, 2 * count)) if count > 0 else 0.0
    return count / exposure, low / exposure, 0.5 * float(chi2.ppf(1.0 - tail, 2 * count + 2)) / exposure
