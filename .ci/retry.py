"""Run pytest, and once more, alone, what failed of tests that need real time; too many of those are no accident.

    python .ci/retry.py --most 5 --beside "-n 3 --dist loadfile" -- -q -c ros/tests/pytest.ini ros/tests

Whatever else stops pytest, such as an error while it collects, is not tried again. The last line names what was.
"""

from __future__ import annotations

import argparse
import json
import shlex
import subprocess
import sys
import tempfile
from pathlib import Path

_FAILED = 1  # pytest's exit status where tests ran and some failed


def main() -> int:
    """The exit status of pytest: of the second run where there is one."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--most", type=int, default=5, help="tests that may be tried again (default: %(default)s)")
    parser.add_argument("--beside", default="", help="options of the first run alone, in one word")
    parser.add_argument("arguments", nargs="+", help="of pytest")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as cache:  # of no earlier run
        pytest = [sys.executable, "-m", "pytest", "-o", f"cache_dir={cache}", *options.arguments]
        status = subprocess.run([*pytest, *shlex.split(options.beside)], check=False).returncode
        if status != _FAILED:
            return status
        failed = sorted(json.loads((Path(cache) / "v" / "cache" / "lastfailed").read_text(encoding="utf-8")))
        if not 0 < len(failed) <= options.most:
            print(f"{len(failed)} tests failed, at most {options.most} may be tried again: none is", flush=True)
            return status
        print(f"{len(failed)} tests failed beside others and are tried again alone:", *failed, sep="\n  ", flush=True)
        status = subprocess.run([*pytest, "--last-failed", "--last-failed-no-failures", "none"], check=False).returncode
    outcome = "and passed" if status == 0 else "and failed again, some or all"
    print(f"tried again, {outcome}: {', '.join(failed)}", flush=True)
    return status


if __name__ == "__main__":
    sys.exit(main())
