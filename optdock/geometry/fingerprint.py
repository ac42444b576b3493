"""Short digests of what a certificate was proven against, so that a mismatch can be named.

Two problems with equal digests are the same to the last bit of every number; equal numbers written in another way
(`-0.0`, an integer) have equal digests.
"""

from __future__ import annotations

import hashlib
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

__all__ = ["ProblemFingerprint", "digest"]

_DIGEST_BYTES = 8  # two problems in 2^64 have the same; a mismatch is a mistake, not an attack


class ProblemFingerprint(NamedTuple):
    """Digests of the parts of a docking problem, hexadecimal; `frame` is the name itself.

    `footprint`: the robot's outline. `limits`: its motion limits, drive and camera. `obstacles`: everything that must
    not be touched, the station included. `clearance`: the rule. `dock`: pose, station, gear, straight, approach and
    view. `start`: pose, speed, curvature and acceleration.
    """

    footprint: str
    limits: str
    obstacles: str
    clearance: str
    dock: str
    start: str
    frame: str

    def differences(self, other: ProblemFingerprint) -> tuple[str, ...]:
        """The names of the parts that differ."""
        return tuple(name for name in self._fields if getattr(self, name) != getattr(other, name))


def digest(*parts: ArrayLike | str) -> str:
    """One digest of numbers, arrays and words, in this order and in these shapes."""
    found = hashlib.blake2b(digest_size=_DIGEST_BYTES)
    for part in parts:
        if isinstance(part, str):
            found.update(b"word" + part.encode() + b"\0")
        else:
            values = np.asarray(part, dtype=np.float64) + 0.0  # -0.0 + 0.0 is 0.0
            found.update(repr(values.shape).encode() + values.tobytes())
    return found.hexdigest()
