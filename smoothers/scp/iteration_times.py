"""How long the next iteration and the next certificate will take, and whether the time that is left is enough."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from optdock.deadline import Deadline
    from smoothers.scp.nlp import NonlinearProgram
    from smoothers.scp.settings import AnytimeSettings

__all__ = ["IterationTimes"]


class IterationTimes:
    """The clock of one call: expected at first, measured from the first iteration on.

    Args:
        deadline: Seconds left.
        settings: Expected times, and what is held back for a certificate.

    Attributes:
        iteration: Seconds that the next one is expected to take.
        certificate: Likewise; 0 until something is known.
        pace: Shortest iteration over the expected one: what hardly any disturbance could lengthen.
    """

    def __init__(self, deadline: Deadline, settings: AnytimeSettings) -> None:
        self.deadline, self._settings = deadline, settings
        self.iteration = self.certificate = 0.0
        self._certificate_was_measured = False
        self.pace = math.inf

    def expect(self, nlp: NonlinearProgram, pace: float) -> None:
        """Expect the times of a program, on a machine that takes `pace` times as long as that of the benchmarks."""
        self.iteration = pace * self.expected_iteration(nlp)
        self.certificate = self.certificate or pace * _expected(nlp, self._settings.certificate_seconds)

    def expected_iteration(self, nlp: NonlinearProgram) -> float:
        """Seconds that an iteration takes on the machine of the benchmarks."""
        corners = math.prod(nlp.scene.body.vertices.shape[:2])
        return _expected(nlp, self._settings.iteration_seconds) + corners * self._settings.iteration_per_corner

    def measured(self, seconds: float, expected: float) -> None:
        """Take in that an iteration took so long [s], where so long was expected [s]."""
        self.pace = min(self.pace, seconds / expected)
        self.iteration = max(self._settings.longest_fades * self.iteration, seconds)
        if not self._certificate_was_measured:  # but how fast this machine is was
            self.certificate = max(self.certificate, self._settings.certificate_per_iteration * self.iteration)

    def certified(self, since: float) -> float:
        """Take in that a certificate took from `since` [s] until now; returns how long that is [s]."""
        self.certificate, self._certificate_was_measured = self.deadline.elapsed - since, True
        return self.certificate

    def no_more_iterations(self) -> bool:
        """Whether there is less time than an iteration is expected to take."""
        return not self.deadline.fits(self.iteration)

    def reserve(self, *, has_candidate: bool) -> float:
        """Seconds for the certificate of the candidate, where there is one."""
        return self._settings.certificate_reserve * self.certificate if has_candidate else 0.0

    def is_late(self) -> bool:
        """Whether a certificate that is not done yet comes too late."""
        return self.deadline.left < -self._settings.latest


def _expected(nlp: NonlinearProgram, share: tuple[float, float, float]) -> float:
    """Seconds that something takes on the machine of the benchmarks."""
    obstacles, parts = len(nlp.scene.obstacles), len(nlp.scene.body.vertices)
    return share[0] + obstacles * (share[1] + share[2] * parts * float(nlp.lengths.sum()))
