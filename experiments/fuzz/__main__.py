"""Command line of the fuzzer."""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from experiments.fuzz.lanes import Lanes

# numpy reads these when it is first imported, here and in every process started from here.
os.environ.update(dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1"))

ALL = (
    "paths",
    "trajectories",
    "timings",
    "limits",
    "plans",
    "prices",
    "replans",
    "measured",
    "decisions",
    "impossibilities",
    "kernels",
    "timing_kernels",
    "files",
    "damaged_files",
    "judged",
    "values",
    "views",
)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m experiments.fuzz", description="Fuzz optdock against an oracle.")
    parser.add_argument(
        "--seconds", type=float, default=600.0, help="CPU time of each process [s] (default: %(default)s)"
    )
    parser.add_argument("--seed", type=int, default=1, help="seed of all cases (default: %(default)s)")
    parser.add_argument("--kinds", default=",".join(ALL), help="comma-separated names (default: %(default)s)")
    parser.add_argument("--jobs", type=int, default=1, help="number of processes (default: %(default)s)")
    parser.add_argument("--count", type=int, help="number of cases of every kind (default: until the time is up)")
    parser.add_argument("--verdicts", default="", help="verdicts at which a kind ends: paths=1000,plans=200")
    parser.add_argument(
        "--lanes", default="own", help="lane of the kernels: own, twin (NumPy alone), or both (default: %(default)s)"
    )
    parser.add_argument("--resume", action="store_true", help="continue the campaign of this seed in --out")
    parser.add_argument(
        "--out", type=Path, default=Path("results/fuzz"), help="directory of failing cases (default: %(default)s)"
    )
    parser.add_argument("--plant", help="plant this mistake in the certificate, and stop when it is found")
    parser.add_argument("--replay", type=Path, help="check the case in a file again")
    return parser


def main(arguments: list[str] | None = None) -> int:
    """Run; return 0 without failures, 1 with failures, 2 for bad usage; with --plant: 0 if it was found."""
    options = _parser().parse_args(arguments)
    kinds = tuple(options.kinds.split(","))
    if not set(kinds) <= set(ALL):
        print(f"--kinds: known are {', '.join(ALL)}; got {options.kinds}", file=sys.stderr)
        return 2
    wanted = _wanted(options.verdicts)
    if wanted is None or not set(wanted) <= set(kinds):
        print(f"--verdicts: must be KIND=NUMBER,... of the kinds of --kinds; got {options.verdicts}", file=sys.stderr)
        return 2
    from experiments.fuzz.lanes import LANES

    if options.lanes not in LANES:
        print(f"--lanes: must be one of {', '.join(LANES)}; got {options.lanes}", file=sys.stderr)
        return 2
    if options.replay is not None:
        return _replay(options.replay, options.plant, options.lanes)
    return _campaign(options, kinds, wanted)


def _wanted(text: str) -> dict[str, int] | None:
    """Return the number of verdicts of every kind; None if the text is invalid."""
    try:
        return {kind: int(number) for kind, number in (part.split("=") for part in text.split(",") if part)}
    except ValueError:
        return None


def _campaign(options: argparse.Namespace, kinds: tuple[str, ...], wanted: dict[str, int]) -> int:
    from experiments.fuzz.campaign import Campaign, run

    campaign = Campaign(
        kinds=kinds,
        seed=options.seed,
        seconds=options.seconds,
        count=options.count,
        out=options.out,
        wanted=wanted,
        lanes=options.lanes,
        resume=options.resume,
        stop_at_fault=options.plant is not None,
        plant=options.plant,
    )
    tally = run(campaign, options.jobs)
    for line in tally.lines():
        print(line)
    if options.plant is not None:
        print(f"planted {options.plant}: {'found' if tally.failed else 'NOT FOUND'}")
        return 0 if tally.failed else 1
    return 1 if tally.failed else 0


def _replay(source: Path, plant: str | None, lanes: Lanes) -> int:
    from experiments.fuzz.campaign import judge_once, prepare
    from experiments.fuzz.case import load_case
    from experiments.fuzz.lanes import using_lanes

    try:
        case = load_case(source)
    except (OSError, ValueError, KeyError, TypeError) as error:
        print(f"--replay: {source} is no saved case: {type(error).__name__}: {error}", file=sys.stderr)
        return 2
    prepare()
    with using_lanes(lanes):
        verdict = judge_once(case, plant)
    print(f"{verdict.outcome}: {verdict.detail}" if verdict.detail else verdict.outcome)
    return 1 if verdict.is_fault else 0


if __name__ == "__main__":
    sys.exit(main())
