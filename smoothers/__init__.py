"""Path smoothers, plugins of `optdock.smoothers`, and terms for one of them, each imported on first use."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from smoothers.casadi_smoother import CasadiSmoother
    from smoothers.nav2.savitzky_golay import SavitzkyGolaySmoother
    from smoothers.nav2.simple import SimpleSmoother
    from smoothers.terms import HardTerm, SoftTerm

_HOMES = {
    "CasadiSmoother": "smoothers.casadi_smoother",
    "HardTerm": "smoothers.terms",
    "SavitzkyGolaySmoother": "smoothers.nav2.savitzky_golay",
    "SimpleSmoother": "smoothers.nav2.simple",
    "SoftTerm": "smoothers.terms",
}

__all__ = ["CasadiSmoother", "HardTerm", "SavitzkyGolaySmoother", "SimpleSmoother", "SoftTerm"]


def __getattr__(name: str) -> object:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(_HOMES[name]), name)
