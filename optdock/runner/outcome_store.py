"""File of outcomes, one JSON object per line, from which an interrupted run is resumed.

The first line is the head of the run. Every further start of the run appends its own head, so that each outcome follows
the head of the start that computed it. Outcomes follow in the order in which they became known.
"""

from __future__ import annotations

import fcntl
import hashlib
import importlib.metadata
import json
import os
import platform
import subprocess
from pathlib import Path
from typing import TYPE_CHECKING, Any

from optdock import __version__
from optdock.errors import InvalidFile
from optdock.io.guarded_file import MostBytes, parse_json, read_bytes, read_text
from optdock.runner.cases import Outcome

if TYPE_CHECKING:
    from collections.abc import Mapping

    from optdock.runner.workers import Workers

__all__ = ["FORMAT", "OutcomeStore", "run_head"]

FORMAT = "optdock-outcomes/1"
_PACKAGES = ("numpy", "scipy", "casadi", "ruckig")
_MOST_CPU_INFO = 10_000_000  # bytes, for machines with hundreds of cores


def run_head(task: object, workers: Workers, seed: int | None = None) -> dict[str, Any]:
    """Return the head of a run: everything needed to repeat it, and where it was computed.

    Args:
        task: Everything that determines the cases and their function besides the seed, as JSON values.
        workers: The workers of the run.
        seed: Seed of random numbers, or None.
    """
    told = json.dumps([task, seed, workers.clock], sort_keys=True, allow_nan=False)
    return {
        "format": FORMAT,
        "digest": hashlib.sha256(told.encode()).hexdigest()[:16],
        "seed": seed,
        "clock": workers.clock,
        "workers": workers.scheduler or workers.count,
        "commit": _commit(),
        "versions": {
            "optdock": __version__,
            "python": platform.python_version(),
            **{name: importlib.metadata.version(name) for name in _PACKAGES},
        },
        "machine": {"cpu": _cpu(), "cores": os.cpu_count()},
        "load": [round(load, 2) for load in os.getloadavg()],
    }


class OutcomeStore:
    """Outcomes of a run in a file, to which each outcome is appended as soon as it is known.

    A last line that was not written completely is removed. Only one process can use the file at a time.

    Args:
        path: File to create or to continue.
        head: Head of the run, see `run_head`.

    Attributes:
        earlier: Outcomes of earlier starts of the run by key; `run_cases` removes them as it yields them.

    Raises:
        InvalidFile: If the file belongs to another task, is no file of outcomes, is in use, or cannot be read or
            written.
    """

    def __init__(self, path: str | Path, head: Mapping[str, Any]) -> None:
        self.path = Path(path)
        self.earlier: dict[str, Outcome] = {}
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self._stream = self.path.open("ab")
        except OSError as error:
            raise InvalidFile(f"{path}: cannot be written: {error.strerror or error}") from error
        try:
            self._lock()
            self._read(head)
            self._write(dict(head))
        except BaseException:
            self._stream.close()
            raise

    def __enter__(self) -> OutcomeStore:
        return self

    def __exit__(self, *_: object) -> None:
        self._stream.close()

    def append(self, outcome: Outcome) -> None:
        """Write an outcome.

        Raises:
            InvalidFile: If the file cannot be written.
        """
        self._write(outcome._asdict())

    def _write(self, row: Mapping[str, Any]) -> None:
        line = json.dumps(row, allow_nan=False, separators=(",", ":")) + "\n"
        try:
            self._stream.write(line.encode())
            self._stream.flush()
        except OSError as error:
            raise InvalidFile(f"{self.path}: cannot be written: {error.strerror or error}") from error

    def _lock(self) -> None:
        try:
            fcntl.flock(self._stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise InvalidFile(f"{self.path}: another run is writing this file") from None
        except OSError:  # a file system without locks
            return

    def _read(self, head: Mapping[str, Any]) -> None:
        """Read the earlier outcomes and cut off an incomplete last line."""
        *lines, torn = read_bytes(self.path, MostBytes.OUTCOMES).split(b"\n")
        for number, line in enumerate(lines, start=1):
            self._read_line(line, number, head)
        if torn:
            os.truncate(self.path, sum(map(len, lines)) + len(lines))

    def _read_line(self, line: bytes, number: int, head: Mapping[str, Any]) -> None:
        try:
            row: Any = parse_json(line.decode())
            is_head = row.get("format") == FORMAT
            outcome = None if is_head else Outcome(**row)
        except (ValueError, TypeError, AttributeError):
            outcome, is_head, row = None, False, {}
        if outcome is not None and number > 1:
            self.earlier[outcome.key] = outcome
        elif not is_head:
            raise InvalidFile(f"{self.path}:{number}: is not a line of a file of outcomes ({FORMAT})")
        elif row.get("digest") != head["digest"]:
            raise InvalidFile(
                f"{self.path}:{number}: digest: must be {head['digest']}, got {row.get('digest')}: the file is of a "
                "run with another task, seed or clock; choose another folder or delete the file"
            )


def _commit() -> str | None:
    """Return the commit of the checkout that contains this module, with `-dirty` after changes; None: no checkout."""
    try:
        _git("ls-files", "--error-unmatch", __file__)  # an installed copy may lie in the checkout of another project
        return _git("describe", "--always", "--dirty")
    except (OSError, subprocess.SubprocessError):
        return None


def _git(*command: str) -> str:
    folder = Path(__file__).parent
    done = subprocess.run(["git", *command], cwd=folder, check=True, capture_output=True, text=True, timeout=10.0)
    return done.stdout.strip()


def _cpu() -> str:
    """Return the name of the processor."""
    try:
        told = read_text(Path("/proc/cpuinfo"), _MOST_CPU_INFO)
    except InvalidFile:
        return platform.processor()
    names = [line.partition(":")[2].strip() for line in told.splitlines() if line.startswith("model name")]
    return names[0] if names else platform.machine()
