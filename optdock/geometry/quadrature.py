"""Numerical integration of functions with kinks."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable

    from optdock.geometry.arrays import FloatArray

__all__ = ["adaptive_integral"]


def _lobatto(count: int) -> tuple[FloatArray, FloatArray]:
    """Nodes and weights on [-1, 1], both ends included ([Abramowitz1964] eq. 25.4.32); exact to degree 2 count - 3."""
    legendre = np.polynomial.Legendre.basis(count - 1)
    nodes = np.concatenate(([-1.0], np.sort(legendre.deriv().roots().real), [1.0]))
    weights: FloatArray = 2.0 / (count * (count - 1) * legendre(nodes) ** 2)
    return nodes, weights


# Nodes at the ends, because a kink between an end and the first node of a Gauss rule goes unseen, in halves as well.
_NODES, _WEIGHTS = _lobatto(16)
_MAX_HALVINGS = 40


def adaptive_integral(function: Callable[[FloatArray], FloatArray], breaks: FloatArray, rtol: float = 1e-13) -> float:
    """Integral from the first to the last of `breaks`.

    16-point Gauss-Lobatto quadrature of every panel is compared with that of its halves; panels that differ are halved
    again, all of one level in one call. A kink inside a panel thus costs one more call per halving. Agreement is no
    proof: with a kink the relative error stays mostly below 1e-12, but up to 1e-9 has been seen.

    Args:
        function: Values at points, Shape (n,) to Shape (n,).
        breaks: Shape (m,), increasing; the function is smooth between most of them.
        rtol: Accepted difference, relative to the integral of |function|.
    """
    low, high = breaks[:-1], breaks[1:]
    coarse = _panels(function, low, high)
    scale, total = float(np.sum(np.abs(coarse))), 0.0
    for _ in range(_MAX_HALVINGS):
        middle = 0.5 * (low + high)
        low, high = np.concatenate((low, middle)), np.concatenate((middle, high))
        fine = _panels(function, low, high)
        pairs = fine.reshape(2, -1).sum(axis=0)
        open_panels = np.abs(pairs - coarse) > rtol * scale
        total += float(np.sum(pairs[~open_panels]))
        keep = np.tile(open_panels, 2)
        low, high, coarse = low[keep], high[keep], fine[keep]
        if low.size == 0:
            break
    return total + float(np.sum(coarse))


def _panels(function: Callable[[FloatArray], FloatArray], low: FloatArray, high: FloatArray) -> FloatArray:
    """Quadrature of every panel. Shape (m,)."""
    half = 0.5 * (high - low)
    points = (0.5 * (low + high))[:, None] + half[:, None] * _NODES
    # Where the function jumps at a break, the panel before it must not see the value after it.
    points = np.minimum(points, np.nextafter(high, low)[:, None])
    values = function(points.ravel()).reshape(points.shape)
    integrals: FloatArray = half * (values @ _WEIGHTS)
    return integrals
