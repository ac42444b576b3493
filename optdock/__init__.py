"""optdock: certified docking trajectories for wheeled robots.

    import optdock
    problem = optdock.load_scenario("bay.yaml").problem
    plan = optdock.plan_dock(problem, time_budget=0.1)

Names are imported on first use, so that `import optdock` stays cheap.
"""

from __future__ import annotations

import importlib
import logging
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from optdock.config import Scenario, load_scenario
    from optdock.pipeline import DockPlan, plan_dock, warm_up
    from optdock.verification import Certificate, certify_path, certify_trajectory

_HOMES = {
    "Certificate": "optdock.verification",
    "DockPlan": "optdock.pipeline",
    "Scenario": "optdock.config",
    "certify_path": "optdock.verification",
    "certify_trajectory": "optdock.verification",
    "load_scenario": "optdock.config",
    "plan_dock": "optdock.pipeline",
    "warm_up": "optdock.pipeline",
}

__all__ = [
    "Certificate",
    "DockPlan",
    "Scenario",
    "certify_path",
    "certify_trajectory",
    "load_scenario",
    "plan_dock",
    "warm_up",
]
__version__ = "0.1.0"

logging.getLogger(__name__).addHandler(logging.NullHandler())


def __getattr__(name: str) -> object:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(_HOMES[name]), name)
