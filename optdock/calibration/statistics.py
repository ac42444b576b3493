"""Estimates with 95 % confidence intervals: robust fits, maximum likelihood, means, shares and rates."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from optdock.geometry.arrays import FloatArray, IntArray

__all__ = [
    "LEAST_CLUSTERS",
    "Fit",
    "Quantity",
    "clusters_of",
    "fit",
    "likelihood_covariance",
    "mean_of",
    "poisson_rate",
    "share_of",
    "student",
    "unknown",
]

_CONFIDENCE = 0.95
_TAIL = 0.5 * (1.0 - _CONFIDENCE)
LEAST_CLUSTERS = 3  # two clusters leave one degree of freedom, which gives an interval of 13 standard deviations
_EVALUATIONS = 60  # problems with three parameters converge within ten
_STEP = 1e-4  # of the scale of a parameter, where its central difference is exact to eight digits


@dataclass(frozen=True)
class Quantity:
    """A property of a robot, estimated from recordings; its truth value is False if the property is unknown.

    Args:
        name: Name in the report.
        unit: Unit of `value`, `low` and `high`.
        value: Estimate; NaN if unknown.
        low: Lower bound of the 95 % confidence interval.
        high: Upper bound.
        samples: Number of measurements used.
        sources: Number of recordings used.
        reason: Reason why the quantity is unknown; empty if it is known.
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
        """Whether the quantity is known."""
        return not self.reason

    @property
    def half_width(self) -> float:
        """Half the length of the interval."""
        return 0.5 * (self.high - self.low)


def unknown(name: str, unit: str, reason: str, samples: int = 0) -> Quantity:
    """Return a quantity without an estimate, with the reason why it is unknown."""
    return Quantity(name, unit, samples=samples, reason=reason)


def student(freedom: float) -> float:
    """Return the half width of the 95 % interval of Student's t, in standard deviations."""
    from scipy.stats import t

    return float(t.ppf(0.5 + 0.5 * _CONFIDENCE, freedom))


def mean_of(values: FloatArray) -> tuple[float, float, float]:
    """Return the mean of two or more independent values and its 95 % confidence bounds by Student's t."""
    mean, half = float(np.mean(values)), student(len(values) - 1.0) * float(np.std(values, ddof=1)) / len(values) ** 0.5
    return mean, mean - half, mean + half


def share_of(count: int, total: int) -> tuple[float, float, float]:
    """Return the share `count / total` and its 95 % Clopper-Pearson confidence bounds ([Clopper1934])."""
    from scipy.stats import beta

    low = float(beta.ppf(_TAIL, count, total - count + 1)) if count > 0 else 0.0
    high = float(beta.ppf(1.0 - _TAIL, count + 1, total - count)) if count < total else 1.0
    return count / total, low, high


def poisson_rate(count: int, exposure: float) -> tuple[float, float, float]:
    """Return the number of events per unit of exposure and its exact 95 % confidence bounds ([Garwood1936])."""
    from scipy.stats import chi2

    low = 0.5 * float(chi2.ppf(_TAIL, 2 * count)) if count > 0 else 0.0
    return count / exposure, low / exposure, 0.5 * float(chi2.ppf(1.0 - _TAIL, 2 * count + 2)) / exposure


def clusters_of(times: Iterable[FloatArray], length: float) -> list[IntArray]:
    """Assign samples to time intervals, which are numbered consecutively over all recordings.

    Args:
        times: For each recording, the sample times since its beginning, Shape (n,) [s].
        length: Duration of an interval [s].

    Returns:
        For each recording, the cluster index of every sample, Shape (n,).
    """
    found: list[IntArray] = []
    count = 0
    for since in times:
        number = (since / length).astype(np.intp) + count
        count = int(number.max()) + 1 if len(number) else count
        found.append(number)
    return found


class Fit(NamedTuple):
    """Result of a robust least squares fit.

    Attributes:
        values: Parameters, Shape (p,).
        covariance: Covariance of the parameters, Shape (p, p).
        freedom: Degrees of freedom of Student's t for the intervals.
    """

    values: FloatArray
    covariance: FloatArray
    freedom: float

    def interval(self, index: int) -> tuple[float, float, float]:
        """Return the value, the lower and the upper bound of a parameter."""
        half = student(self.freedom) * math.sqrt(max(float(self.covariance[index, index]), 0.0))
        value = float(self.values[index])
        return value, value - half, value + half


def fit(
    residuals: Callable[[FloatArray], FloatArray],
    guess: Sequence[float],
    clusters: IntArray,
    scales: Sequence[float],
    *,
    bounds: tuple[Sequence[float], Sequence[float]] | None = None,
) -> Fit:
    """Fit parameters by robust least squares, with intervals for residuals that are correlated within clusters.

    The loss is soft L1 beyond 2.5 robust standard deviations of the residuals. The covariance is the clustered
    sandwich of [Cameron2015], H^-1 (sum of g g') H^-1 times G / (G - 1), with g the gradient of one of G clusters.

    Args:
        residuals: Function from the parameters, Shape (p,), to the residuals, Shape (n,).
        guess: Initial parameters.
        clusters: Cluster index of each residual, Shape (n,).
        scales: Typical change of each parameter.
        bounds: Lower and upper bounds of the parameters.
    """
    from scipy.optimize import least_squares

    start, steps = np.array(guess, dtype=np.float64), np.array(scales, dtype=np.float64)
    limits = bounds if bounds is not None else (-np.inf, np.inf)

    def solved(begin: FloatArray) -> tuple[FloatArray, FloatArray, float]:
        """Return the parameters, the residuals and the scale of the loss."""
        size = 2.5 * 1.4826 * float(np.median(np.abs(residuals(begin)))) + 1e-12
        found = least_squares(
            residuals, begin, x_scale=steps, loss="soft_l1", f_scale=size, bounds=limits, max_nfev=_EVALUATIONS
        )
        return found.x, residuals(found.x), size

    # The scale at the guess is meaningless; after the second solution it changes by at most a tenth.
    values, left, size = solved(solved(solved(start)[0])[0])
    weights = 1.0 / np.sqrt(1.0 + (left / size) ** 2)
    slopes = _central_slopes(residuals, values, _STEP * steps)
    names, index = np.unique(clusters, return_inverse=True)
    gradients = _cluster_sums(slopes * (weights * left)[:, None], index, len(names))
    inverse = np.linalg.pinv(slopes.T @ (weights[:, None] * slopes))
    count = max(len(names), 2)
    covariance = inverse @ (gradients.T @ gradients) @ inverse * (count / (count - 1.0))
    return Fit(values, covariance, count - 1.0)


def likelihood_covariance(
    log_densities: Callable[[FloatArray], FloatArray], values: FloatArray, clusters: IntArray
) -> FloatArray:
    """Return the clustered sandwich covariance [Cameron2015] of a maximum likelihood estimate, Shape (p, p).

    Args:
        log_densities: Function from the parameters, Shape (p,), to the log density of each sample, Shape (n,).
        values: Estimate, Shape (p,).
        clusters: Cluster index of each sample, Shape (n,).
    """
    step = 1e-3 * np.maximum(np.abs(values), 0.1)

    def slopes(at: FloatArray) -> FloatArray:
        return _central_slopes(log_densities, at, step)

    curvature = np.array(
        [
            np.sum(slopes(values + row) - slopes(values - row), axis=0) / (2.0 * row[k])
            for k, row in enumerate(np.diag(10.0 * step))
        ]
    )
    scores = _cluster_sums(slopes(values), clusters, int(clusters.max()) + 1)
    inverse = np.linalg.pinv(-0.5 * (curvature + curvature.T), rcond=1e-10)
    covariance: FloatArray = inverse @ (scores.T @ scores) @ inverse
    return covariance


def _central_slopes(function: Callable[[FloatArray], FloatArray], at: FloatArray, steps: FloatArray) -> FloatArray:
    """Return the derivatives of `function` by central differences, Shape (n, p)."""
    return np.column_stack(
        [(function(at + row) - function(at - row)) / (2.0 * row[k]) for k, row in enumerate(np.diag(steps))]
    )


def _cluster_sums(rows: FloatArray, clusters: IntArray, count: int) -> FloatArray:
    """Return the sum of the rows of each cluster, Shape (count, p)."""
    sums = np.zeros((count, rows.shape[1]))
    np.add.at(sums, clusters, rows)
    return sums
