"""Plant faults in the product and count how many of them the tests find.

    python -m experiments.mutations --count 60 --seed 1 --out results/mutations/before.json
    python -m experiments.mutations --repeat results/mutations/before.json --out results/mutations/after.json

Each fault changes one operator, comparison or number on one line. It counts as found when a test fails, within
`--seconds` of CPU time, in the files that import the changed module directly or through one other module. `--repeat`
plants the faults of an earlier run again: a fault whose line the tree no longer has exactly once is left out, so that
two states are compared on the same faults. The faults are planted in a copy of the tree.
"""

from __future__ import annotations

import argparse
import ast
import json
import os
import random
import resource
import shutil
import subprocess
import sys
import tempfile
from collections import defaultdict
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

__all__ = ["Fault", "main"]

PRODUCT = "optdock", "smoothers", "checkers"
_COMPARISONS = {ast.Lt: "<=", ast.LtE: "<", ast.Gt: ">=", ast.GtE: ">", ast.Eq: "!=", ast.NotEq: "=="}
_OPERATORS = {ast.Add: ("+", "-"), ast.Sub: ("-", "+"), ast.Mult: ("*", "/"), ast.Div: ("/", "*")}
_SYMBOLS = {ast.Lt: "<", ast.LtE: "<=", ast.Gt: ">", ast.GtE: ">=", ast.Eq: "==", ast.NotEq: "!="}
_CALLS = {"min": "max", "max": "min", "minimum": "maximum", "maximum": "minimum", "floor": "ceil", "ceil": "floor"}


class Fault(NamedTuple):
    """One planted fault: in `file`, the line `before` (stripped) becomes `after`."""

    file: str
    before: str
    after: str


def faults_of(root: Path, file: Path) -> Iterator[Fault]:
    """Yield every fault that can be planted in the function bodies of one file."""
    text = file.read_text(encoding="utf-8")
    lines = text.splitlines()
    for function in ast.walk(ast.parse(text)):
        if not isinstance(function, ast.FunctionDef):
            continue
        for statement in function.body:
            for node in ast.walk(statement):
                for row, begin, end, new in _edits(node, lines):
                    line = lines[row - 1]
                    changed = line[:begin] + new + line[end:]
                    if changed != line and "#" not in line[:begin]:
                        yield Fault(str(file.relative_to(root)), line.strip(), changed.strip())


def _edits(node: ast.AST, lines: Sequence[str]) -> Iterator[tuple[int, int, int, str]]:
    """Yield (line number, first column, end column, replacement) of the changes of one node."""
    if isinstance(node, ast.Compare) and type(node.ops[0]) in _COMPARISONS:
        yield from _between(
            node.left, node.comparators[0], _SYMBOLS[type(node.ops[0])], _COMPARISONS[type(node.ops[0])], lines
        )
    elif isinstance(node, ast.BinOp) and type(node.op) in _OPERATORS:
        yield from _between(node.left, node.right, *_OPERATORS[type(node.op)], lines)
    elif isinstance(node, ast.BoolOp):
        old, new = ("and", "or") if isinstance(node.op, ast.And) else ("or", "and")
        yield from _between(node.values[0], node.values[1], old, new, lines)
    elif isinstance(node, ast.Constant) and type(node.value) in {int, float} and node.end_col_offset is not None:
        new = str(node.value + 1) if isinstance(node.value, int) else repr(node.value * 1.2 + (node.value == 0.0))
        yield node.lineno, node.col_offset, node.end_col_offset, new
    elif isinstance(node, ast.Call) and isinstance(node.func, ast.Name | ast.Attribute):
        name = node.func.id if isinstance(node.func, ast.Name) else node.func.attr
        end = node.func.end_col_offset
        if name in _CALLS and end is not None and node.func.end_lineno is not None:
            yield node.func.end_lineno, end - len(name), end, _CALLS[name]


def _between(
    left: ast.expr, right: ast.expr, old: str, new: str, lines: Sequence[str]
) -> Iterator[tuple[int, int, int, str]]:
    """Yield the change of an operator between two operands on one line."""
    if left.end_lineno == right.lineno and left.end_col_offset is not None:
        between = lines[right.lineno - 1][left.end_col_offset : right.col_offset]
        if between.count(old) == 1:
            begin = left.end_col_offset + between.index(old)
            yield right.lineno, begin, begin + len(old), new


def drawn(root: Path, count: int, seed: int) -> list[Fault]:
    """Draw faults, at most one per line, each on a line that the product has exactly once."""
    made = [
        fault
        for package in PRODUCT
        for file in sorted((root / package).rglob("*.py"))
        for fault in faults_of(root, file)
    ]
    homes = _homes(root)
    made = [fault for fault in made if len(homes[fault.before]) == 1]
    random.Random(seed).shuffle(made)
    one_per_line = {fault.before: fault for fault in reversed(made)}
    return [fault for fault in made if one_per_line[fault.before] is fault][:count]


def _homes(root: Path) -> dict[str, list[Path]]:
    """Map each stripped line of the product to the files that have it, one entry per occurrence."""
    homes: dict[str, list[Path]] = defaultdict(list)
    for package in PRODUCT:
        for file in (root / package).rglob("*.py"):
            for line in file.read_text(encoding="utf-8").splitlines():
                homes[line.strip()].append(file)
    return homes


def _imports(root: Path) -> dict[str, set[str]]:
    """Map each Python file of product and tests to the modules that it imports."""
    found: dict[str, set[str]] = {}
    for folder in (*PRODUCT, "tests"):
        for file in (root / folder).rglob("*.py"):
            names = set()
            for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
                if isinstance(node, ast.ImportFrom) and node.module:
                    names |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
                elif isinstance(node, ast.Import):
                    names |= {alias.name for alias in node.names}
            found[str(file.relative_to(root))] = names
    return found


def tests_for(file: str, imports: dict[str, set[str]]) -> list[str]:
    """Return the test files that import a module directly, then those that do so through one other module."""
    module = file.removesuffix(".py").replace("/", ".")
    users = [one for one, names in imports.items() if module in names]
    direct = [one for one in users if one.startswith("tests/")]
    through = {
        one.removesuffix(".py").removesuffix("/__init__").replace("/", ".")
        for one in users
        if not one.startswith("tests/")
    }
    indirect = [one for one, names in imports.items() if one.startswith("tests/") and names & through]
    found = dict.fromkeys([*sorted(direct), *sorted(indirect)])
    return [one for one in found if Path(one).name.startswith("test_")]


def _found_by_tests(root: Path, tests: Sequence[str], seconds: int) -> bool:
    """Return whether a test of the files fails, or a file cannot be imported, within the CPU time [s]."""

    def limited() -> None:
        resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds))

    command = [sys.executable, "-m", "pytest", "-q", "-x", "-p", "no:cacheprovider", "--no-header", *tests]
    # The kernels in C do not contain the faults, which are inserted in Python.
    environment = {**os.environ, "PYTHONPATH": str(root), "HYPOTHESIS_PROFILE": "ci", "OPTDOCK_KERNELS": "twin"}
    run = subprocess.run(command, cwd=root, env=environment, capture_output=True, preexec_fn=limited, check=False)
    return run.returncode in {1, 2}  # 2: interrupted by an error of the import


def judged(root: Path, faults: Sequence[Fault], seconds: int) -> Iterator[tuple[Fault, bool | None]]:
    """Yield each fault and whether the tests find it; None where its line is not in the product exactly once."""
    homes, imports = _homes(root), _imports(root)
    for fault in faults:
        if len(homes[fault.before]) != 1:
            yield fault, None
            continue
        file = homes[fault.before][0]
        original = file.read_text(encoding="utf-8")
        file.write_text(original.replace(fault.before, fault.after, 1), encoding="utf-8")
        try:
            tests = tests_for(str(file.relative_to(root)), imports)
            yield fault, bool(tests) and _found_by_tests(root, tests, seconds)
        finally:
            file.write_text(original, encoding="utf-8")


def main(arguments: Sequence[str] | None = None) -> int:
    """Plant the faults one by one, print the score and write the list."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=60)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--seconds", type=int, default=60, help="CPU time for each fault [s] (default: %(default)s)")
    parser.add_argument("--repeat", type=Path, help="repeat the faults of this file")
    parser.add_argument("--out", type=Path, default=Path("results/mutations/faults.json"))
    options = parser.parse_args(arguments)
    root = Path(__file__).parents[1]
    if options.repeat:
        faults = [Fault(*entry[:3]) for entry in json.loads(options.repeat.read_text(encoding="utf-8"))]
    else:
        faults = drawn(root, options.count, options.seed)
    results = []
    options.out.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "tree"
        shutil.copytree(root, copy, ignore=shutil.ignore_patterns(".venv*", ".git", "results", "site", ".*_cache"))
        for fault, is_found in judged(copy, faults, options.seconds):
            results.append([*fault, is_found])
            verdict = "left out" if is_found is None else "found" if is_found else "MISSED"
            print(f"{len(results):3d} {verdict:8s} {fault.file}: {fault.after}", flush=True)
            options.out.write_text(json.dumps(results, indent=1), encoding="utf-8")
    planted = [row[3] for row in results if row[3] is not None]
    print(f"{sum(planted)} of {len(planted)} faults found, {len(results) - len(planted)} left out")
    return 0


if __name__ == "__main__":
    sys.exit(main())
