"""optdock: certified docking trajectories for wheeled robots.

    import optdock as od

    robot = od.Robot(od.Footprint.rectangle(0.45, 0.45, 0.6), od.MotionLimits(max_curvature=1.5))
    problem = od.DockingProblem(od.Pose2(1.0, 0.2, 0.4), od.Dock(od.Pose2(4.0, 1.0, 0.0)), robot)
    plan = od.plan_dock(problem, time_budget=0.1)

The public names are listed in `__init__.pyi`; each is imported on its first use, so that `import optdock` is fast.
Plugins of other packages are found by their entry points.
"""

from __future__ import annotations

import logging

import lazy_loader

__version__ = "0.1.0"
_OF_PLUGIN_PACKAGES = ("AxisGoalChecker", "CasadiSmoother")

_attribute, _, _names = lazy_loader.attach_stub(__name__, __file__)
__all__ = sorted([*_names, *_OF_PLUGIN_PACKAGES])  # noqa: PLE0605 - a list of names at run time

logging.getLogger(__name__).addHandler(logging.NullHandler())


def __dir__() -> list[str]:
    return [*__all__, "__version__"]


def __getattr__(name: str) -> object:
    if name in _OF_PLUGIN_PACKAGES:
        from optdock.plugins.registry import plugin_class

        return plugin_class(name)
    return _attribute(name)
