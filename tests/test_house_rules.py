"""The project's rules on its own source: docstrings, exports, configured paths."""

import ast
import importlib
import re
from importlib.metadata import entry_points
from pathlib import Path

import pytest

try:
    import tomllib
except ModuleNotFoundError:  # Python 3.10
    import tomli as tomllib

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("optdock", "smoothers", "checkers")
SOURCES = sorted(path for package in PACKAGES for path in (ROOT / package).rglob("*.py"))


def relative(path):
    return str(path.relative_to(ROOT))


@pytest.mark.parametrize("path", SOURCES, ids=relative)
def test_exports_are_exactly_what_exists(path):
    name = ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")
    if name.endswith("__main__"):
        return
    module = importlib.import_module(name)
    exported = getattr(module, "__all__", None)
    if exported is None:
        public = [
            n for n in vars(module) if not n.startswith("_") and getattr(vars(module)[n], "__module__", "") == name
        ]
        assert public == [], "a module with public names lists them in __all__"
        return
    assert sorted(set(exported)) == sorted(exported)
    assert [n for n in exported if not hasattr(module, n)] == []


def raising(node):
    """Names of the exceptions that a function raises in its own body, chained re-raises left out."""
    found = set()
    for inner in ast.walk(node):
        if isinstance(inner, ast.Raise) and isinstance(inner.exc, ast.Call) and isinstance(inner.exc.func, ast.Name):
            found.add(inner.exc.func.id)
    return found


@pytest.mark.parametrize("path", SOURCES, ids=relative)
def test_public_functions_that_raise_say_so(path):
    silent = []
    tree = ast.parse(path.read_text())
    hidden = {
        id(n) for c in ast.walk(tree) if isinstance(c, ast.ClassDef) and c.name.startswith("_") for n in ast.walk(c)
    }
    for node in (n for n in ast.walk(tree) if isinstance(n, ast.FunctionDef) and id(n) not in hidden):
        doc = ast.get_docstring(node) or ""
        private = node.name.startswith("_") or path.name.startswith("_")
        if not private and raising(node) - {"TypeError", "AttributeError", "AssertionError"} and "Raises:" not in doc:
            silent.append(node.name)
    assert silent == []


def test_every_entry_point_loads():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    for group, points in project["entry-points"].items():
        installed = {point.name: point for point in entry_points(group=group)}
        for name, target in points.items():
            assert installed[name].value == target
            assert installed[name].load().__name__ == name


def test_configured_paths_exist():
    config = tomllib.loads((ROOT / "pyproject.toml").read_text())
    for name in config["tool"]["pytest"]["ini_options"]["testpaths"]:
        assert (ROOT / name).is_dir()
    for name in (*config["tool"]["mypy"]["packages"], *config["tool"]["importlinter"]["root_packages"]):
        assert (ROOT / name / "py.typed").is_file()
    for layer in config["tool"]["importlinter"]["contracts"][0]["layers"]:
        for name in re.split(r"\s*[|:]\s*", layer):
            module = ROOT.joinpath(*name.split("."))
            assert module.is_dir() or module.with_suffix(".py").is_file(), name
