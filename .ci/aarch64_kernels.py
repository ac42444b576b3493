"""Run the tests of the kernels, and whole plans, with the kernels compiled for aarch64 and run by a CPU emulator.

    python .ci/aarch64_kernels.py [arguments of pytest]

It needs `ziglang` (the cross compiler), `unicorn` (the emulator) and `pyelftools`. Every result must be that of this
machine. A library whose products and sums were contracted, as is usual on this processor, must fail its self-test.
"""

from __future__ import annotations

import os
import sys
import tempfile
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from emulated_library import EmulatedLibrary  # noqa: E402 - the copy beside this file
from sanitized_kernels import TESTS  # noqa: E402

from experiments.families import instance  # noqa: E402
from optdock import kernels  # noqa: E402
from optdock.build_kernels import build  # noqa: E402
from optdock.deadline import budget_clock  # noqa: E402
from optdock.errors import OptdockError  # noqa: E402
from optdock.planning.pipeline import plan_dock  # noqa: E402

COMPILER = f"{sys.executable} -m ziglang cc -target aarch64-linux-gnu.2.17"
# Comparisons of both lanes; those that compile a library, start a program or take long are left out.
CHOSEN = (
    "(last_bit or lanes or mpc_program or motion_table or look_ahead or first_ramp or minimizer or kernels_return) "
    "and not source and not compiler and not version and not library"
)
FAMILIES = ("open_s", "reverse_cusp", "angled_hexagon", "gap_blocked")
BUDGET = 0.3  # [s] of counted work, the same with every kernel


def compiled(folder: str, *flags: str) -> EmulatedLibrary:
    """Return the library compiled for aarch64."""
    before = os.environ.get("CC", "cc")
    os.environ["CC"] = COMPILER
    try:
        return EmulatedLibrary(build(ROOT, Path(folder, f"_aarch64{len(flags)}.shared"), flags))
    finally:
        os.environ["CC"] = before


def self_test(library: EmulatedLibrary) -> int:
    """Return the number of the first failure of the self-test, or 0."""
    given = np.array(kernels._SELF_TESTED)
    return library.call("optdock_kernels_self_test", (), (), ((given, given.size),))


def emulate(library: EmulatedLibrary) -> None:
    """Run every kernel of this process in the emulator."""
    checked = kernels.Kernel.__call__

    def call(self: kernels.Kernel, sizes: tuple, numbers: tuple, arrays: tuple) -> int:
        self._function = lambda *_: library.call(self._symbol, sizes, numbers, arrays)
        return checked(self, sizes, numbers, arrays)

    kernels.Kernel.__call__ = call


def plans() -> list[tuple]:
    """Return prices and digests of plans and messages of failures."""
    problems = [instance(family, 0).problem for family in FAMILIES]
    found = []
    with budget_clock("counted"):
        for problem in problems:
            try:
                plan = plan_dock(problem, time_budget=BUDGET)
                found.append((plan.price, plan.path.digest, plan.trajectory.duration))
            except OptdockError as error:  # noqa: PERF203 - a few problems
                found.append((type(error).__name__, str(error)))
    return found


def main(arguments: list[str]) -> int:
    """Compile the library, run the tests and return their exit status."""
    with tempfile.TemporaryDirectory() as folder:
        library, contracted = compiled(folder), compiled(folder, "-ffp-contract=fast")
    assert self_test(library) == 0
    assert self_test(contracted) == 1, "contraction of products was not detected"
    here = plans()
    emulate(library)
    there = plans()
    assert here == there, [pair for pair in zip(here, there, strict=True) if pair[0] != pair[1]]
    print(f"{len(here)} plans on aarch64 are those of this machine, to the last bit")
    chosen = arguments or [*TESTS, "-k", CHOSEN]
    status = pytest.main(["-q", "-p", "no:cacheprovider", *chosen])
    unused = {name for name in library.functions if name.startswith("optdock_")} - library.called
    unused = {name for name in unused if not name.startswith("optdock_kernels_")}
    assert arguments or not unused, f"not called: {', '.join(sorted(unused))}"
    return int(status)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
