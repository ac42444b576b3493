"""Size of the trusted code of certificates and proofs of impossibility, and its libraries."""

import ast
import io
import re
import tokenize
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
MODULES = {
    ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__"): path
    for path in (ROOT / "optdock").rglob("*.py")
}
IGNORED = (tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENDMARKER)
PAGE = (ROOT / "docs" / "theory" / "certificate.md").read_text(encoding="utf-8")


def imported(path):
    """Yield everything that a module imports, also for type annotations."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom):
            yield from (f"{node.module}.{alias.name}" for alias in node.names)
        elif isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)


def reached(*begin):
    """Return the modules of this project that are reached by imports, and the names of other packages."""
    found, others, left = set(), set(), list(begin)
    while left:
        module = left.pop()
        if module in found:
            continue
        found.add(module)
        for name in imported(MODULES[module]):
            home = next((one for one in (name, name.rpartition(".")[0]) if one in MODULES), None)
            left += [home] if home else []
            others |= set() if home else {name.partition(".")[0]}
    return found, others


def lines_of_code(path):
    """Count the lines that hold more than comments and docstrings."""
    text, documented, lines = path.read_text(encoding="utf-8"), set(), set()
    for node in ast.walk(ast.parse(text)):
        kinds = (ast.Module, ast.ClassDef, ast.FunctionDef)
        if isinstance(node, kinds) and ast.get_docstring(node, clean=False) is not None:
            documented.update(range(node.body[0].lineno, node.body[0].end_lineno + 1))
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type not in IGNORED:
            lines.update(range(token.start[0], token.end[0] + 1))
    return len(lines - documented)


def kernels_of(modules):
    """Return the C files beside modules, and that with the self-test, which is needed to use any of them."""
    beside = [MODULES[one].with_name(f"{MODULES[one].stem}_kernel.c") for one in modules]
    found = [path for path in beside if path.is_file()]
    return [*found, ROOT / "optdock" / "kernels.c"] if found else []


def lines_of_c(path):
    """Count the lines that hold more than comments."""
    code = re.sub(r"/\*.*?\*/", "", path.read_text(encoding="utf-8"), flags=re.DOTALL)
    return sum(bool(line.strip()) for line in code.splitlines())


@pytest.mark.parametrize(
    ("begin", "said"),
    [
        (("optdock.verification.certify",), r"depends on at most ([\d,]+)\s+lines\s+of\s+code\s+in\s+(\d+)\s+modules"),
        (
            ("optdock.impossibility.proof", "optdock.impossibility.blocked_straight"),
            r"impossibility\]?\S*\s+on\s+([\d,]+)\s+lines\s+in\s+(\d+)\s+modules",
        ),
    ],
    ids=["certificates", "proofs of impossibility"],
)
def test_the_page_says_how_much_code_must_be_trusted(begin, said):
    """No solver is among the trusted code; NumPy and shapely are."""
    modules, others = reached(*begin)
    lines, count = (int(number.replace(",", "")) for number in re.search(said, PAGE).groups())
    assert lines - 100 < sum(lines_of_code(MODULES[module]) for module in modules) <= lines
    assert len(modules) == count
    assert others & {"scipy", "casadi", "ruckig", "matplotlib", "yaml"} == set()
    assert not [module for module in modules if re.match(r"optdock\.(planners|planning|timing|plugins|io)\b", module)]


def test_the_page_says_which_code_in_c_must_be_trusted():
    """The kernels of the smoother and the search are not among it; `test_impossibility` shows that proofs call none."""
    trusted = kernels_of(reached("optdock.verification.certify")[0])
    names = {path.name for path in trusted}
    ours = {"conservative_advancement_kernel.c", "turning_rules_kernel.c"}
    assert names == ours | {"clothoid_kernel.c", "kernels.c"}
    said = int(re.search(r"at most ([\d,]+)\s+lines\s+of\s+C", PAGE).group(1))
    assert said - 30 < sum(map(lines_of_c, trusted)) <= said
    reached_by_proofs = kernels_of(reached("optdock.impossibility.proof", "optdock.impossibility.blocked_straight")[0])
    assert not {path.name for path in reached_by_proofs} & ours
