"""Plan files, format `optdock-plan/1`: strict JSON, written atomically."""

from __future__ import annotations

import csv
import io
import itertools
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path as FilePath
from typing import TYPE_CHECKING, Annotated, Literal, NamedTuple, TypeAlias, TypeVar

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, JsonValue, ValidationError

from optdock.errors import InvalidFile, InvalidPath, InvalidValue
from optdock.geometry.arrays import frozen_array
from optdock.geometry.checked import number
from optdock.impossibility import NoMotionProof, impossibility_from_dict
from optdock.io.atomic_file import write_text
from optdock.io.guarded_file import MostBytes, parse_json, read_text
from optdock.io.path_columns import Number, PathColumns, check_sampled_curvature, path_columns, path_from_columns
from optdock.io.quoting import listed, shortened, shown
from optdock.model.constant_jerk import TimeLaw
from optdock.samples import SampledMotion

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from optdock.errors import OptdockError
    from optdock.model.path import Path
    from optdock.model.trajectory import Trajectory

__all__ = [
    "CERTIFIED",
    "PLAN_FORMAT",
    "UNKNOWN",
    "PlanError",
    "PlanFile",
    "TrajectoryColumns",
    "load_plan",
    "parse_plan",
    "save_columns_csv",
    "save_plan",
    "strict_json",
]

PLAN_FORMAT = "optdock-plan/1"
DEFAULT_SPACING = 0.02
DEFAULT_PERIOD = 0.02
CERTIFIED, UNKNOWN = "certified", "unknown"
MAX_SAMPLES = 50_000  # of a path or a trajectory: 1 km, 1000 s; two paths and a trajectory of this size have 22 MB
_MOST_UNKNOWN = 20  # keys that are listed
MAX_PHASES = 10_000  # of a time law; plans of optdock have about ten per gear

T = TypeVar("T")
D = TypeVar("D")
Time: TypeAlias = Annotated[float, Field(ge=-1e11, le=1e11)]  # [s]


class TrajectoryColumns(SampledMotion):
    """Samples of a timed motion, as columns of a plan file."""

    __slots__ = ()

    @classmethod
    def from_trajectory(cls, trajectory: Trajectory, period: float) -> TrajectoryColumns:
        """Sample a motion at intervals of at most `period` [s], including ends and cusps.

        Raises:
            InvalidValue: If the period is not > 0 or gives more than `MAX_SAMPLES` samples.
        """
        _check_step("period", period, "s", trajectory.duration)
        samples = trajectory.sample(period)
        return cls(**{name: getattr(samples, name) for name in cls._fields})


class PlanError(NamedTuple):
    """Reason why planning failed: the error code of the Nav2 action, a message, and data that locate the failure."""

    code: int
    message: str
    where: Mapping[str, object]

    @classmethod
    def from_exception(cls, error: OptdockError) -> PlanError:
        """Return the entry for an exception."""
        return cls(error.code, str(error), error.where)


@dataclass(frozen=True, eq=False, repr=False)
class PlanFile:
    """Content of a plan file; missing parts are None.

    Args:
        status: `certified`, or the name of the error that ended the planning.
        completed: False if the deadline ended the planning early.
        frame: Name of the coordinate frame.
        raw_path: Path of the planner.
        path: Smoothed path.
        trajectory: Samples of the timed motion.
        time_law: Exact time law of the samples; None if only the samples are known.
        certificate: Values of the certificate, see `Certificate.as_dict`.
        timing_ms: Milliseconds per stage.
        error: Reason for the failure.
        tried: Guesses that were tried and their results, see `Attempt.as_dict`.
        impossibility: Proof that no plan exists.
        proof: Statement of the problem and cells of the path for the second judge, see `proof_cells.proof_of`.
        unjudged: Names of values in a file that cannot be checked: unknown keys, and the curvature of a raw path
            without exact curves.

    Raises:
        InvalidPath: If a path is in a different frame.
    """

    status: str = CERTIFIED
    completed: bool = False
    frame: str = "map"
    raw_path: Path | None = None
    path: Path | None = None
    trajectory: TrajectoryColumns | None = None
    time_law: TimeLaw | None = None
    certificate: Mapping[str, object] | None = None
    timing_ms: Mapping[str, float] = field(default_factory=dict)
    error: PlanError | None = None
    impossibility: NoMotionProof | None = None
    tried: Sequence[Mapping[str, object]] = ()
    unjudged: tuple[str, ...] = ()
    proof: Mapping[str, object] | None = None

    def __post_init__(self) -> None:
        for name in ("raw_path", "path"):
            path: Path | None = getattr(self, name)
            object.__setattr__(self, name, None if path is None else path.with_frame(self.frame))

    def __repr__(self) -> str:
        has = [name for name in ("raw_path", "path", "trajectory", "time_law") if getattr(self, name) is not None]
        reason = f" ({self.error.message})" if self.error is not None else ""
        return f"<PlanFile {self.status}{reason}, with {', '.join(has) or 'nothing'} in {self.frame!r}>"

    def as_json(self, *, spacing: float = DEFAULT_SPACING) -> str:
        """Return the text of the file.

        Args:
            spacing: Largest distance between path samples [m].

        Raises:
            InvalidValue: If a number of a path or trajectory is not finite, or the spacing is not > 0 or gives more
                than `MAX_SAMPLES` samples.
        """
        paths = {name: path for name, path in (("raw_path", self.raw_path), ("path", self.path)) if path is not None}
        _check_step("spacing", spacing, "m", max((path.length for path in paths.values()), default=0.0))
        head = {"format": PLAN_FORMAT, "status": self.status, "completed": self.completed, "frame": self.frame}
        body: dict[str, object] = {name: path_columns(path, spacing) for name, path in paths.items()}
        if self.trajectory is not None:
            columns = {name: column.tolist() for name, column in self.trajectory._asdict().items()}
            body["trajectory"] = columns if self.time_law is None else {**columns, "phases": _phases(self.time_law)}
        if self.certificate is not None:
            body["certificate"] = finite_or_null(self.certificate)
        if self.error is not None:
            body["error"] = finite_or_null(self.error._asdict())
        if self.impossibility is not None:
            body["impossibility"] = self.impossibility.as_dict()
        if self.tried:
            body["tried"] = finite_or_null(self.tried)
        if self.proof is not None:
            body["proof"] = self.proof
        return strict_json({**head, **body, "timing_ms": finite_or_null(self.timing_ms)})


def _phases(law: TimeLaw) -> Mapping[str, object]:
    """Return a time law as plain JSON values."""
    start = [law.start_s, law.start_speed, law.start_acceleration]
    return {"start": start, "durations": law.durations.tolist(), "jerks": law.jerks.tolist()}


def _check_step(name: str, step: float, unit: str, extent: float) -> None:
    if not (math.isfinite(number(step, name)) and step > 0.0):
        raise InvalidValue(f"{name}: must be finite and > 0 {unit}, got {step}")
    if extent > MAX_SAMPLES * step:
        raise InvalidValue(
            f"{name}: must be >= {extent / MAX_SAMPLES:.3g} {unit} for at most {MAX_SAMPLES} samples of "
            f"{extent:.6g} {unit}, got {step}"
        )


def finite_or_null(value: object) -> object:
    """Convert to plain JSON values: arrays become lists, numbers that are not finite become null."""
    if isinstance(value, float | np.floating):
        return float(value) if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {str(key): finite_or_null(item) for key, item in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return finite_or_null(value.tolist())
    if isinstance(value, Sequence) and not isinstance(value, str):
        return [finite_or_null(item) for item in value]
    return value if isinstance(value, str | int) or value is None else str(value)


def strict_json(document: Mapping[str, object]) -> str:
    """Return strict JSON with one top-level key per line.

    Raises:
        InvalidValue: If a number is not finite.
    """
    try:
        lines = [f"{json.dumps(key)}: {json.dumps(value, allow_nan=False)}" for key, value in document.items()]
    except ValueError as error:
        raise InvalidValue(f"plan file: every number must be finite: {error}") from error
    return "{" + ",\n ".join(lines) + "}\n"


def save_plan(target: str | FilePath, plan: PlanFile, *, spacing: float = DEFAULT_SPACING) -> None:
    """Write a plan file.

    Args:
        target: The file.
        plan: Its content.
        spacing: Largest distance between path samples [m].

    Raises:
        InvalidFile: If the file cannot be written.
        InvalidValue: If a number is not finite; in this case nothing is written.
    """
    write_text(FilePath(target), plan.as_json(spacing=spacing))


_CSV_UNITS = {
    "t": "s", "x": "m", "y": "m", "yaw": "rad", "speed": "m/s", "acceleration": "m/s^2", "jerk": "m/s^3",
    "yaw_rate": "rad/s", "yaw_acceleration": "rad/s^2",
}  # fmt: skip


def save_columns_csv(target: str | FilePath, columns: SampledMotion) -> None:
    """Write a sampled motion as CSV: a header with units, then one row per sample with all digits.

    Raises:
        InvalidFile: If the file cannot be written.
    """
    text = io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(f"{name} [{_CSV_UNITS[name]}]" for name in columns._fields)
    rows.writerows(np.column_stack(columns).tolist())
    write_text(FilePath(target), text.getvalue())


class _Model(BaseModel):
    model_config = ConfigDict(strict=True, frozen=True, extra="ignore", allow_inf_nan=False, defer_build=True)


class _PhasesDocument(_Model):
    """Phases of constant jerk along the travel: start [m, m/s, m/s^2], durations [s], jerks [m/s^3]."""

    start: Annotated[list[Number], Field(min_length=3, max_length=3)]
    durations: Annotated[list[Number], Field(max_length=MAX_PHASES)]
    jerks: Annotated[list[Number], Field(max_length=MAX_PHASES)]


class _TrajectoryDocument(_Model):
    t: list[Time]
    x: list[Number]
    y: list[Number]
    yaw: list[Number]
    speed: list[Number]
    acceleration: list[Number]
    jerk: list[Number]
    yaw_rate: list[Number]
    yaw_acceleration: list[Number]
    phases: _PhasesDocument | None = None


class _Open(_Model):
    """Base model of documents whose unknown keys are kept."""

    model_config = ConfigDict(strict=True, frozen=True, extra="allow", allow_inf_nan=False, defer_build=True)


_Positive: TypeAlias = Annotated[float, Field(ge=0.0, le=1e12)]


class _VerdictDocument(_Open):
    """Keys that both kinds of certificates have."""

    certified: bool | None = None
    path: str | None = None
    violations: list[dict[str, JsonValue]] = []


class _MotionCertificateDocument(_VerdictDocument):
    duration: _Positive | None = None
    ratios: dict[str, Number | None] = {}


class _CertificateDocument(_VerdictDocument):
    """Values of `Certificate`; null means infinity."""

    min_clearance: Number | None = None
    required_clearance: Number | None = None
    at_s: Number | None = None
    margin: Number | None = None
    max_curvature: Number | None = None
    max_curvature_rate: Annotated[float, Field(ge=-1e18, le=1e18)] | None = None
    length: Number | None = None
    start_relief: Number | None = None
    tube: Number | None = None
    view_margin: Number | None = None
    poses_checked: Annotated[int, Field(ge=0)] | None = None
    nearest: str | None = None
    problem: dict[str, str] | None = None
    trajectory: _MotionCertificateDocument | None = None


class _AttemptDocument(_Open):
    """A guess and its result, see `Attempt.as_dict`."""

    stage: str | None = None
    length: _Positive | None = None
    cusps: Annotated[int, Field(ge=0)] | None = None
    seconds: _Positive | None = None
    price: _Positive | None = None
    reason: str | None = None


class _ErrorDocument(_Model):
    code: int = 0
    message: str = ""
    where: dict[str, JsonValue] = {}


class _PlanDocument(_Model):
    format: Literal["optdock-plan/1"]
    status: str = UNKNOWN
    completed: bool = False
    frame: str = "map"
    raw_path: PathColumns | None = None
    path: PathColumns | None = None
    trajectory: _TrajectoryDocument | None = None
    certificate: _CertificateDocument | None = None
    timing_ms: dict[str, _Positive | None] = {}
    error: _ErrorDocument | None = None
    impossibility: dict[str, JsonValue] | None = None
    proof: dict[str, JsonValue] | None = None
    tried: list[_AttemptDocument] = []


def load_plan(source: str | FilePath) -> PlanFile:
    """Read a plan file from any source; unknown keys are ignored.

    Raises:
        InvalidFile: If the file cannot be read, is not strict JSON, or violates the format; every fault is listed.
    """
    source = FilePath(source)
    return parse_plan(read_text(source, MostBytes.JSON), str(source))


def parse_plan(text: str, source: str) -> PlanFile:
    """Parse the text of a plan file.

    Args:
        text: Text of the file.
        source: Name of the file for messages.

    Raises:
        InvalidFile: If the text is not strict JSON or violates the format; every fault is listed.
    """
    document, unknown = _parsed(text, source)
    faults: list[str] = []
    raw_path = _built(document.raw_path, lambda columns: path_from_columns(columns, "raw_path"), faults)
    path = _built(document.path, lambda columns: path_from_columns(columns, "path"), faults)
    if path is not None and not path[1]:
        _built(document.path, lambda columns: check_sampled_curvature(columns, "path"), faults)
    if raw_path is not None and not raw_path[1]:
        unknown = (*unknown, "raw_path.curvature (of samples)")
    trajectory = _built(document.trajectory, _trajectory, faults)
    phases = None if document.trajectory is None else document.trajectory.phases
    time_law = _built(phases, _time_law, faults)
    proof = _built(document.impossibility, impossibility_from_dict, faults)
    if faults:
        raise InvalidFile("\n".join(f"{source}: {fault}" for fault in faults))
    return PlanFile(
        status=document.status,
        completed=document.completed,
        frame=document.frame,
        raw_path=None if raw_path is None else raw_path[0],
        path=None if path is None else path[0],
        trajectory=trajectory,
        time_law=time_law,
        certificate=None if document.certificate is None else document.certificate.model_dump(exclude_unset=True),
        timing_ms={key: value for key, value in document.timing_ms.items() if value is not None},
        error=None if document.error is None else PlanError(*document.error.model_dump().values()),
        impossibility=proof,
        tried=tuple(attempt.model_dump(exclude_unset=True) for attempt in document.tried),
        unjudged=unknown,
        proof=document.proof,
    )


def _built(document: D | None, build: Callable[[D], T], faults: list[str]) -> T | None:
    """Return the result of `build`; an error is added to `faults`, so that other parts are also checked."""
    try:
        return None if document is None else build(document)
    except (InvalidFile, InvalidValue, InvalidPath) as error:
        faults.append(str(error))
        return None


def _unknown_keys(values: object, document: BaseModel, above: str = "") -> Iterator[str]:
    """Yield the keys that the document models ignore, in the parts that are checked."""
    if not isinstance(values, dict):
        return
    for key, value in values.items():
        known = getattr(document, key, None) if key in type(document).model_fields else None
        if key not in type(document).model_fields:
            yield f"{shortened(f'{above}{key}')} (unknown)"
        elif isinstance(known, BaseModel) and known.model_config.get("extra") == "ignore":
            yield from _unknown_keys(value, known, f"{above}{key}.")


def _parsed(text: str, source: str) -> tuple[_PlanDocument, tuple[str, ...]]:
    """Return the document and its unknown keys."""
    try:
        values = parse_json(text)
        document = _PlanDocument.model_validate(values)
        return document, tuple(itertools.islice(_unknown_keys(values, document), _MOST_UNKNOWN))
    except json.JSONDecodeError as error:
        raise InvalidFile(f"{source}:{error.lineno}: not JSON: {error.msg}") from error
    except ValidationError as error:
        faults = [_fault(source, item) for item in error.errors(include_url=False)]
        raise InvalidFile(listed(source, faults)) from error
    except ValueError as error:
        raise InvalidFile(f"{source}: not a plan file: {shortened(str(error))}") from error


def _fault(source: str, item: Mapping[str, object]) -> str:
    path = item["loc"]
    place = ".".join(str(part) for part in path) if isinstance(path, tuple) else str(path)
    got = "" if item["type"] == "missing" or isinstance(item["input"], dict | list) else f", got {shown(item['input'])}"
    return f"{source}: {shortened(place) or 'top level'}: {shortened(str(item['msg']))}{got}"


def _trajectory(document: _TrajectoryDocument) -> TrajectoryColumns:
    values = {key: frozen_array(getattr(document, key), f"trajectory.{key}") for key in TrajectoryColumns._fields}
    count = values["t"].size
    for key, column in values.items():
        if column.size != count:
            raise InvalidFile(
                f"trajectory.{key}: must have as many values as trajectory.t = {count}, got {column.size}"
            )
    if count < 2 or not np.all(np.diff(values["t"]) > 0.0):
        raise InvalidFile("trajectory.t: needs at least 2 samples, strictly increasing")
    return TrajectoryColumns(**values)


def _time_law(phases: _PhasesDocument) -> TimeLaw:
    durations, jerks = np.array(phases.durations), np.array(phases.jerks)
    if durations.size == jerks.size:  # short phases may be rounded to 0
        durations, jerks = durations[durations != 0.0], jerks[durations != 0.0]
    try:
        return TimeLaw(durations, jerks, *phases.start)
    except InvalidValue as error:
        raise InvalidFile(f"trajectory.phases: {error}") from error
