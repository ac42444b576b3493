"""Tables of the calibration study."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from optdock.calibration.conformal_tube import conformal_tube
from optdock.geometry.pose import displacement
from optdock.reports.report import table

if TYPE_CHECKING:
    from collections.abc import Sequence

    from experiments.calibration.study import PairedDocking, QuantityResult
    from experiments.docking.field.outcome import FieldOutcome

__all__ = ["coverage_table", "paired_table", "tube_table"]


def coverage_table(judged: Sequence[QuantityResult]) -> str:
    """Return coverage and width of the intervals and errors of the estimates, per quantity."""
    names = list(dict.fromkeys(one.name for one in judged))
    rows = [("quantity", "truths inside", "no estimate", "mean half interval", "mean error", "rms error")]
    estimated = [one for one in judged if not one.reason]
    for name in names:
        of_name = [one for one in estimated if one.name == name]
        missing = sum(one.name == name for one in judged) - len(of_name)
        errors = np.array([one.value - one.truth for one in of_name] or [np.nan])
        half = np.mean([0.5 * (one.high - one.low) for one in of_name] or [np.nan])
        rows.append(
            (
                name,
                f"{sum(one.inside for one in of_name)}/{len(of_name)}",
                str(missing),
                f"{half:.4f}",
                f"{np.mean(errors):+.4f}",
                f"{np.sqrt(np.mean(errors**2)):.4f}",
            )
        )
    inside = sum(one.inside for one in estimated)
    rows.append(("all", f"{inside}/{len(estimated)} = {100.0 * inside / max(len(estimated), 1):.1f} %", "", "", "", ""))
    return table(rows)


def paired_table(pairs: Sequence[PairedDocking]) -> str:
    """Return the same fresh dockings with the defaults and with the calibrated settings."""
    head = (
        "",
        "good",
        "false docked",
        "collisions",
        "across p95, mm",
        "yaw p95, degrees",
        "along p95, mm",
        "time p50, s",
    )
    rows = [head, _row("defaults", [one.before for one in pairs]), _row("calibrated", [one.after for one in pairs])]
    better = sum(one.after.good and not one.before.good for one in pairs)
    worse = sum(one.before.good and not one.after.good for one in pairs)
    faster = sum(one.after.duration < one.before.duration - 0.1 for one in pairs)
    slower = sum(one.after.duration > one.before.duration + 0.1 for one in pairs)
    return (
        f"{table(rows)}\nof {len(pairs)} pairs: good only when calibrated {better}, only with the defaults {worse}; "
        f"faster when calibrated {faster}, slower {slower}"
    )


def _row(name: str, found: Sequence[FieldOutcome]) -> tuple[str, ...]:
    docked = [one for one in found if one.docked]
    columns = (
        [1e3 * abs(one.cross) for one in docked],
        [np.degrees(abs(one.yaw)) for one in docked],
        [1e3 * abs(one.along) for one in docked],
    )
    return (
        name,
        f"{sum(one.good for one in found)}/{len(found)}",
        str(sum(one.falsely_docked for one in found)),
        str(sum(one.collided for one in found)),
        *(f"{np.percentile(column, 95.0):.2f}" if column else "-" for column in columns),
        f"{np.median([one.duration for one in found]):.1f}",
    )


def tube_table(
    deviations: Sequence[Sequence[tuple[float, float]]], fresh: Sequence[tuple[float, float]], radius: float
) -> str:
    """Return how often dockings stay in the tube estimated from other dockings, for several coverages.

    Fresh dockings are of the robots whose recordings determined the tube. The second check is harder: half of the
    robots determine a tube, and the recordings of the other half are tested against it.

    Args:
        deviations: Per robot and recording: largest lateral distance [m] and rotation [rad].
        fresh: The same for fresh dockings of all robots.
        radius: Circumscribed radius of the footprint [m].
    """
    every, half = ([one for robot in part for one in robot] for part in (deviations, deviations[::2]))
    others = [one for robot in deviations[1::2] for one in robot]
    rows = [("coverage", "tube, cross", "tube, yaw", "fresh dockings inside", "dockings of other robots inside")]
    for coverage in (0.8, 0.9, 0.95, 0.99):
        tube = conformal_tube(every, radius, coverage).tube
        width = ("-", "-") if tube is None else (f"{tube.cross:.4f} m", f"{tube.yaw:.4f} rad")
        rows.append(
            (
                f"{coverage:.0%}",
                *width,
                _inside(every, fresh, radius, coverage),
                _inside(half, others, radius, coverage),
            )
        )
    return table(rows)


def _inside(
    shown: Sequence[tuple[float, float]], fresh: Sequence[tuple[float, float]], radius: float, coverage: float
) -> str:
    if not fresh:
        return "-"
    tube = conformal_tube(shown, radius, coverage).tube
    if tube is None:
        return f"{len(shown)} dockings are too few"
    width = float(displacement(tube.cross, tube.yaw, radius)) * (1.0 + 1e-9)
    inside = sum(float(displacement(cross, yaw, radius)) <= width for cross, yaw in fresh)
    return f"{inside}/{len(fresh)} = {100.0 * inside / len(fresh):.1f} %"
