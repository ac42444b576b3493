"""At rest before or in the dock: whether it is detected, and whether the robot stands within its tolerances."""

from __future__ import annotations

from typing import TYPE_CHECKING

from optdock.executor.control_cycles import STOP
from optdock.executor.interruptions import NOT_DOCKED, AttemptFailed, Interrupted, TaskFailed
from optdock.executor.task_states import EndingKind, State

if TYPE_CHECKING:
    from collections.abc import Generator

    from optdock.executor.control_cycles import ControlCycles, Cycles, Wish

__all__ = ["SURE_SEEN", "confirm", "has_arrived", "perceive", "stands_docked", "wait_for_detection"]

# [s] for a detection at rest in the dock: of ten a second, half of them lost, one of 1000 takes longer.
_CONFIRMATION = 1.0
_HIDDEN_FOR = 2.5  # [s] for a person who hides a dock that has been seen from near to walk on
# Standard deviations within its tolerances at which a robot stands in the dock: where it was seen there, and where it
# was not, as every detection of a camera that is blind there is from before.
SURE_SEEN, _SURE_UNSEEN = 2.0, 1.0
_UNSURE_WAY = 0.04  # [m], on which it is to be seen twice: one detection may be wrong by less than is noticed
_UNSEEN_WAY = 0.015  # [m]: on less than that no wheel that slips turns a robot by a degree


def stands_docked(cycles: ControlCycles) -> Generator[Wish, None, bool]:
    """Whether the robot stands in its dock before anything is done, as a dock without a signal cannot tell."""
    situation, settings = cycles.situation, cycles.situation.settings
    needs_signal = cycles.situation.dock_type.is_pressed_on or cycles.situation.dock_type.waits_for_charge
    if needs_signal or not situation.estimate.is_near:
        return False
    cycles.state, since = State.PERCEIVING, cycles.now
    while settings.use_detections and not situation.estimate.is_known:
        if cycles.now - since >= _CONFIRMATION:
            return False
        yield from cycles.cycle(STOP)
    return (
        situation.estimate.will_know(0.0)
        and situation.estimate.is_within_tolerances(0.0)
        and not situation.estimate.may_have_turned
    )


def perceive(cycles: ControlCycles) -> Cycles:
    """Look at the dock, at rest, until it has been seen often enough.

    Raises:
        TaskFailed: It is not seen.
    """
    settings, perception = cycles.situation.settings, cycles.situation.perception
    if not settings.use_detections or cycles.situation.estimate.is_found:
        return
    cycles.state = State.PERCEIVING
    since, before = cycles.now, perception.detections.count
    while perception.detections.count - before < settings.least_detections:
        if cycles.now - since > settings.initial_perception_timeout:
            found, far = perception.detections.count - before, perception.detections.too_far
            raise TaskFailed(
                EndingKind.FAILED_TO_DETECT_DOCK,
                f"{found} detections in {cycles.now - since:.1f} s, needed are {settings.least_detections}; "
                f"{perception.detections.rejected} were rejected so far"
                + (f"; the last was {far:.3f} m from the stored dock, which is another one" if far else ""),
            )
        yield from cycles.cycle(STOP)


def wait_for_detection(cycles: ControlCycles) -> Cycles:
    """Where the dock has not been seen for long, look for it again.

    Raises:
        AttemptFailed: It is not seen.
    """
    situation, perception, settings = cycles.situation, cycles.situation.perception, cycles.situation.settings
    is_needed = situation.estimate.detection_is_old
    if not settings.use_detections or not (is_needed or situation.estimate.is_hidden):
        return
    since, before, cycles.state = cycles.now, perception.detections.count, State.WAITING_FOR_DETECTION
    while perception.detections.count - before < (settings.least_detections if is_needed else 1):
        waited = cycles.now - since
        if waited > settings.initial_perception_timeout:
            reason = f"the dock has not been seen for {perception.detection_age:.1f} s"
            raise AttemptFailed(EndingKind.FAILED_TO_DETECT_DOCK, reason)
        if not (is_needed or situation.estimate.is_hidden):
            return
        yield from cycles.cycle(STOP)


def confirm(cycles: ControlCycles) -> Cycles:
    """Look once more, at rest: a wheel that slipped on the last centimetres is seen by the detector alone.

    Raises:
        Interrupted: The robot stands elsewhere.
        AttemptFailed: The dock is not found.
    """
    situation, perception, since = cycles.situation, cycles.situation.perception, cycles.now
    if cycles.situation.settings.use_detections:
        while (
            perception.detections.moved_since_seen() > _UNSEEN_WAY
            or perception.detections.moved_since_seen(2) > _UNSURE_WAY
            or situation.estimate.is_in_doubt
        ):
            patience = _HIDDEN_FOR if situation.estimate.sees_from_near else _CONFIRMATION
            if situation.estimate.may_have_turned:
                patience = cycles.situation.settings.initial_perception_timeout
            if cycles.now - since >= patience:
                break
            yield from cycles.cycle(STOP)
    _require_certainty(cycles)
    is_seen = perception.detections.moved_since_seen() <= _UNSEEN_WAY
    if not situation.estimate.is_within_tolerances(SURE_SEEN if is_seen else _SURE_UNSEEN):
        raise Interrupted(NOT_DOCKED, situation.estimate.where)


def has_arrived(cycles: ControlCycles) -> Generator[Wish, None, bool]:
    """Whether a robot that was stopped on its way into the dock stands in it, as one does that rolls on."""
    situation = cycles.situation
    if cycles.situation.dock_type.is_pressed_on or situation.is_held:
        return False
    if not (situation.estimate.will_know(0.0) and situation.estimate.is_within_tolerances(SURE_SEEN)):
        return False
    try:
        yield from confirm(cycles)
    except (Interrupted, AttemptFailed):
        return False
    return True


def _require_certainty(cycles: ControlCycles) -> None:
    """Raises AttemptFailed if it is unknown whether the robot stands in its dock."""
    situation, perception = cycles.situation, cycles.situation.perception
    kind, unknown = EndingKind.FAILED_TO_DETECT_DOCK, "it cannot be known whether the robot is docked"
    if perception.detections.is_contradicted:
        raise AttemptFailed(kind, "the last detections contradict where the dock was")
    if situation.estimate.may_have_turned:
        raise AttemptFailed(
            kind,
            f"{unknown}: the localization has turned by {perception.unseen_turn:.3f} rad against the odometry, and "
            f"the dock was not seen since",
        )
    if not situation.estimate.will_know(0.0):
        sigma = perception.sigma_after(0.0)
        raise AttemptFailed(
            kind,
            f"{unknown}: not seen for {perception.detection_age:.1f} s, standard deviations {sigma.along:.4f} m "
            f"along, {sigma.cross:.4f} m across, {sigma.yaw:.4f} rad",
        )
