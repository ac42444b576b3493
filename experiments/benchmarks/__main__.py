"""Run benchmarks: every module of this package that has a `main(arguments)`.

    python -m experiments.benchmarks                              # all, full size
    python -m experiments.benchmarks smoothing --seeds 3 --families alcove,parallel
    python -m experiments.benchmarks smoothing --help

Options may follow a single name. One thread, set before numpy is imported.
"""

from __future__ import annotations

import importlib
import os
import pkgutil
import sys
from typing import TYPE_CHECKING

import experiments.benchmarks as package

if TYPE_CHECKING:
    from collections.abc import Callable


THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


def benchmarks() -> dict[str, Callable[[list[str]], int | None]]:
    """Return the benchmarks by name."""
    names = [module.name for module in pkgutil.iter_modules(package.__path__) if module.name != "__main__"]
    modules = {name: importlib.import_module(f"{package.__name__}.{name}") for name in names}
    return {name: module.main for name, module in modules.items() if hasattr(module, "main")}


def run(arguments: list[str]) -> int:
    """Run the benchmarks named in `arguments`, or all; return the exit status."""
    os.environ.update(dict.fromkeys(THREAD_VARIABLES, "1"))  # numpy reads them only when a benchmark imports it
    known = benchmarks()
    if arguments[:1] in (["-h"], ["--help"]):
        print(f"usage: python -m {package.__name__} [NAME ...] | NAME OPTIONS\n\n{__doc__}\nnames: {', '.join(known)}")
        return 0
    first_option = next((i for i, word in enumerate(arguments) if word.startswith("-")), len(arguments))
    names, options = arguments[:first_option], arguments[first_option:]
    unknown = [name for name in names if name not in known]
    if unknown or (options and len(names) != 1):
        print(f"usage: python -m {package.__name__} [NAME ...] | NAME OPTIONS", file=sys.stderr)
        print(f"names: {', '.join(known)}; got {' '.join(arguments)}", file=sys.stderr)
        return 2
    return max(known[name](options) or 0 for name in names or known)


if __name__ == "__main__":
    sys.exit(run(sys.argv[1:]))
