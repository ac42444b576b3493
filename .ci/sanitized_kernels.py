"""Run the tests of the kernels with a library that is compiled with the address and undefined-behaviour sanitizers.

    python .ci/sanitized_kernels.py [arguments of pytest]

An access beyond an array or an undefined operation ends the process with the report of the sanitizer.
"""

import os
import shlex
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from optdock.build_kernels import build  # noqa: E402 - the copy beside this file

FLAGS = (
    "-Wall",
    "-Wextra",
    "-Werror",
    "-g",
    "-O1",
    "-fsanitize=address,undefined,float-cast-overflow",
    "-fno-sanitize-recover=all",
)
TESTS = (
    "tests/optdock/geometry/test_clothoid.py::test_both_lanes_are_equal",
    "tests/optdock/test_kernels.py",
    "tests/smoothers/test_clearance_along.py",
    "tests/smoothers/test_initial_guess_kernel.py",
    "tests/smoothers/test_loop_kernel.py",
    "tests/smoothers/test_rollout_kernel.py",
    "tests/smoothers/test_term_kernels.py::test_terms_along_a_path_and_their_rows_are_equal_in_both_lanes",
    "tests/smoothers/test_term_kernels.py::test_samples_of_clothoids_are_equal_in_both_lanes_and_lie_on_the_path",
    "tests/smoothers/test_view.py::test_the_kernel_is_equal_to_numpy",
    "tests/smoothers/test_view.py::test_the_kernel_is_equal_to_numpy_far_from_the_origin_at_the_camera_and_without_numbers",
    "tests/optdock/test_deformation.py::test_kernels_return_what_their_twins_do",
    "tests/optdock/test_deformation.py::test_derivatives_are_those_of_finite_differences",
    "tests/optdock/test_minimizer.py::test_the_guess_does_not_change_the_solution",
    "tests/optdock/controllers/test_delay.py",
    "tests/optdock/controllers/test_look_ahead.py",
    "tests/optdock/controllers/test_mpc_program.py",
    "tests/optdock/controllers/test_motion_table.py",
    "tests/optdock/executor/test_pose_filter.py",
    "tests/optdock/executor/test_tube_monitor.py",
    "tests/optdock/planners/manoeuvres/test_planner_kernels.py",
    "tests/optdock/planners/manoeuvres/test_search_kernels.py",
    "tests/optdock/timing/test_interior_point.py",
    "tests/optdock/timing/test_timing_kernels.py",
    "tests/optdock/verification/test_search_for_proofs.py",
    "tests/optdock/verification/test_turning_rules.py",
)


def preloaded() -> str:
    """Return the sanitizers' libraries, which must be loaded before all others."""
    compiler = shlex.split(os.environ.get("CC") or "cc")
    names = ("libasan.so", "libubsan.so")
    found = [subprocess.check_output([*compiler, f"-print-file-name={name}"], text=True).strip() for name in names]
    return ":".join(str(Path(one).resolve()) for one in found)


def main(arguments: list[str]) -> int:
    """Compile the library, run the tests and return their exit status."""
    with tempfile.TemporaryDirectory() as folder:
        library = build(ROOT, Path(folder, "_sanitized.shared"), FLAGS)
        environment = {
            **os.environ,
            "OPTDOCK_TEST_LIBRARY": str(library),
            "LD_PRELOAD": preloaded(),
            "ASAN_OPTIONS": "detect_leaks=0",  # Python keeps memory until it ends
            "UBSAN_OPTIONS": "print_stacktrace=1",
        }
        # The sanitizers refuse CasADi's plugins, which whole plans load; the others compile or start a program.
        left_out = "not plans and not library and not source and not compiler and not version"
        chosen = arguments or [*TESTS, "-k", left_out]
        return subprocess.run(
            [sys.executable, "-m", "pytest", "-q", "--capture=no", "-p", "no:cacheprovider", *chosen],
            cwd=ROOT,
            check=False,
            env=environment,
        ).returncode


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
