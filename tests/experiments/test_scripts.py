"""Every script prints its help without running anything."""

import pkgutil
import runpy
import sys
from pathlib import Path

import pytest

import experiments.benchmarks

ROOT = Path(__file__).resolve().parents[2]
SCRIPTS = sorted(str(script) for script in (ROOT / "experiments").glob("*.py") if "__main__" in script.read_text())
BENCHMARKS = [
    name
    for _, name, _ in pkgutil.iter_modules(experiments.benchmarks.__path__)
    if name != "__main__" and "\ndef main(" in (ROOT / "experiments" / "benchmarks" / f"{name}.py").read_text()
]


def test_scripts_are_found():
    assert len(SCRIPTS) >= 4
    assert len(BENCHMARKS) >= 8


@pytest.fixture
def as_before(monkeypatch, tmp_path):
    """Run in an empty folder, and restore the process state changed by a script."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        monkeypatch.setenv(name, "1")


@pytest.mark.parametrize(
    "command",
    [
        *([script] for script in SCRIPTS),
        ["experiments.fuzz"],
        ["experiments.benchmarks"],
        *(["experiments.benchmarks", name] for name in BENCHMARKS),
    ],
    ids=lambda command: " ".join(Path(word).name for word in command),
)
def test_help_runs_nothing(as_before, tmp_path, monkeypatch, capsys, command):
    monkeypatch.setattr(sys, "argv", [*command, "--help"])
    monkeypatch.delitem(sys.modules, f"{command[0]}.__main__", raising=False)
    run = runpy.run_path if command[0].endswith(".py") else runpy.run_module
    with pytest.raises(SystemExit) as left:
        run(command[0], run_name="__main__")
    out, err = capsys.readouterr()
    assert (left.value.code, err) == (0, "")
    assert out.startswith("usage: ")
    assert list(tmp_path.iterdir()) == []
