"""The project's rules on its own source: docstrings, exports, configured paths."""

import ast
import functools
import importlib
import re
import sys
import types
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


@functools.cache
def tree_of(path):
    return ast.parse(path.read_text())


def statements(node):
    """Return a node and all statements below it, without their expressions, which contain none."""
    found = [node]
    for one in found:
        for field in ("body", "orelse", "handlers", "finalbody", "cases"):
            found += getattr(one, field, ())
    return found


def module_name(path):
    return ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")


def wrong_exports(name):
    """What stands in `__all__` twice or without being there, or is public without standing in it."""
    module = importlib.import_module(name)
    exported = getattr(module, "__all__", None)
    if exported is None:
        return [n for n, value in vars(module).items() if n[0] != "_" and getattr(value, "__module__", "") == name]
    return [n for n in exported if exported.count(n) > 1 or not hasattr(module, n)]


def test_exports_are_exactly_what_exists():
    names = [module_name(path) for path in SOURCES if path.stem != "__main__"]
    assert {name: wrong for name in names if (wrong := wrong_exports(name))} == {}


def raised(node):
    """Names of the exceptions that a function raises in its own body, chained re-raises left out."""
    calls = (
        inner.exc for inner in statements(node) if isinstance(inner, ast.Raise) and isinstance(inner.exc, ast.Call)
    )
    return {call.func.id for call in calls if isinstance(call.func, ast.Name)}


def silent_about_errors(path):
    """Public functions of a public module that raise an error of ours and have no `Raises:`."""
    if "raise " not in path.read_text():
        return []
    below = statements(tree_of(path))
    private = [c for c in below if isinstance(c, ast.ClassDef) and c.name.startswith("_")]
    hidden = {id(inner) for c in private for inner in statements(c)}
    public = (n for n in below if isinstance(n, ast.FunctionDef) and n.name[0] != "_" and id(n) not in hidden)
    own = {"TypeError", "AttributeError", "AssertionError"}
    return [n.name for n in public if raised(n) - own and "Raises:" not in (ast.get_docstring(n) or "")]


def test_public_functions_that_raise_say_so():
    sources = [path for path in SOURCES if path.name[0] != "_" or path.stem == "__init__"]
    assert {str(path.relative_to(ROOT)): silent for path in sources if (silent := silent_about_errors(path))} == {}


def test_the_two_rules_see_what_breaks_them(tmp_path):
    """Both lints, seen failing: a ghost export, a public name left out, a raise without a word."""
    broken = tmp_path / "broken.py"
    broken.write_text(
        "__all__ = ['ghost', 'told']\n"
        'def told():\n    """Go.\n\n    Raises:\n        ValueError: always.\n    """\n    raise ValueError(\'x\')\n'
        'def silent():\n    """Go."""\n    raise ValueError(\'x\')\n'
    )
    assert silent_about_errors(broken) == ["silent"]
    module = types.ModuleType("broken")
    exec(broken.read_text(), vars(module))
    with pytest.MonkeyPatch.context() as patched:
        patched.setitem(sys.modules, "broken", module)
        assert wrong_exports("broken") == ["ghost"]
        del module.__all__
        assert wrong_exports("broken") == ["told", "silent"]


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


# What opens a file, and where that is right all the same: the guarded reader itself, Pillow on bytes that it has read,
# rosbags behind `check_regular`, a launch file, whose Python need not have optdock, the judge, which imports nothing,
# and the build of the kernels, which runs before the dependencies of optdock are installed.
OPENERS = {"open", "fdopen", "read_text", "read_bytes", "fromfile", "loadtxt", "genfromtxt", "memmap", "from_xml_path"}
OPENING_IS_RIGHT = {
    ("optdock/build_kernels.py", "(root / source).read_bytes"),
    ("optdock/io/guarded_file.py", "os.open"),
    ("optdock/io/guarded_file.py", "os.fdopen"),
    ("optdock/io/guarded_file.py", "read_bytes"),
    ("optdock/io/map_image.py", "Image.open"),
    ("optdock/ros/bag.py", "reader.open"),
    ("optdock/verification/judge.py", "Path((arguments or sys.argv[1:])[0]).read_text"),
    ("ros/optdock_ros/launch/servers.launch.py", "file.read_text"),
}


def opened_files(tree):
    """Calls that open a file to read it, but for those of the guarded reader."""
    guarded = {
        alias.asname or alias.name
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom) and node.module == "optdock.io.guarded_file"
        for alias in node.names
    }
    for node in ast.walk(tree):
        if not isinstance(node, ast.Call):
            continue
        name = getattr(node.func, "attr", getattr(node.func, "id", ""))
        modes = [
            *node.args[isinstance(node.func, ast.Name) : 2],
            *(keyword.value for keyword in node.keywords if keyword.arg == "mode"),
        ]
        writes = any(isinstance(mode, ast.Constant) and re.fullmatch("[wax]b?", str(mode.value)) for mode in modes)
        if name in OPENERS and not writes and not (isinstance(node.func, ast.Name) and name in guarded):
            yield ast.unparse(node.func)


def test_files_are_read_through_the_guarded_reader_alone():
    sources = [*SOURCES, *sorted((ROOT / "ros" / "optdock_ros").rglob("*.py"))]
    found = {
        (path.relative_to(ROOT).as_posix(), call)
        for path in sources
        if any(name in path.read_text() for name in OPENERS)
        for call in opened_files(tree_of(path))
    }
    assert found == OPENING_IS_RIGHT


@pytest.mark.parametrize(
    "code",
    ["open('f')", "f.open()", "Path('f').read_text()", "f.read_bytes()", "io.open('f', 'rb')", "np.fromfile(f)"],
)
def test_the_rule_of_the_guarded_reader_sees_what_breaks_it(code):
    assert [*opened_files(ast.parse(code))]
    assert not [*opened_files(ast.parse("open('f', 'w'); f.open(mode='a'); f.open('w')"))]
