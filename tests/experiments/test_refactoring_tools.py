"""The tools that compare two states of the tree: planted faults and recordings."""

import ast
import json

import pytest

from experiments import identity, mutations

SOURCE = '''
def clipped(x, low, high):
    """Return x within 2 limits."""
    if x < low and low < 3:
        return max(x, low) + 1.5
    return x
'''


def test_every_fault_changes_one_line_and_compiles(tmp_path):
    (tmp_path / "module.py").write_text(SOURCE)
    faults = list(mutations.faults_of(tmp_path, tmp_path / "module.py"))
    changes = {(fault.before, fault.after) for fault in faults}
    assert ("if x < low and low < 3:", "if x <= low and low < 3:") in changes
    assert ("if x < low and low < 3:", "if x < low or low < 3:") in changes
    assert ("return max(x, low) + 1.5", "return min(x, low) + 1.5") in changes
    assert ("return max(x, low) + 1.5", "return max(x, low) - 1.5") in changes
    assert not any('"""' in fault.before for fault in faults)
    for fault in faults:
        ast.parse(SOURCE.replace(fault.before, fault.after, 1))


def test_tests_are_found_by_direct_and_indirect_imports():
    imports = {
        "optdock/a.py": set(),
        "optdock/b.py": {"optdock.a"},
        "tests/test_a.py": {"optdock.a"},
        "tests/test_b.py": {"optdock.b"},
        "tests/test_c.py": {"optdock.c"},
    }
    assert mutations.tests_for("optdock/a.py", imports) == ["tests/test_a.py", "tests/test_b.py"]


@pytest.mark.parametrize(("changed", "status"), [(False, 0), (True, 1)])
def test_recordings_are_compared(tmp_path, capsys, changed, status):
    before, after = tmp_path / "before.json", tmp_path / "after.json"
    before.write_text(json.dumps({"plan, a": ["certified", "1"], "plan, b": ["certified", "2"]}))
    after.write_text(json.dumps({"plan, a": ["certified", "1"], "plan, b": ["certified", "3" if changed else "2"]}))
    assert identity.compare(before, after) == status
    assert ("2 -> 3" in capsys.readouterr().out) is changed
