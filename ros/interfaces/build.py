"""Compile the interface definitions of this folder for the `rclpy` of this Python, and install them.

    python ros/interfaces/build.py

A ROS distribution contains the packages `nav2_msgs`, `tf2_msgs` and `bond`, but the wheels of `rclpy` do not. This
script compiles the definitions that the tests need, with the names and the order of the fields. A line that ends in
`# not in jazzy` is left out for the wheels of Jazzy. It requires a C and a C++ compiler and takes 15 s; it does nothing
if definitions, script, interpreter and wheels are unchanged.

The generators are called directly, because the wheels' CMake exports contain directories of the building machine.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import logging
import os
import shutil
import subprocess
import sys
import sysconfig
import tempfile
from concurrent.futures import ThreadPoolExecutor
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from rosidl_cli.command.hash.api import generate_type_hashes
from rosidl_cli.command.translate.api import translate
from rosidl_generator_c.cli import GenerateC
from rosidl_generator_py.cli import GeneratePython
from rosidl_typesupport_c.cli import GenerateCTypesupport
from rosidl_typesupport_fastrtps_c.cli import GenerateFastRTPSCTypesupport
from rosidl_typesupport_introspection_c.cli import GenerateIntrospectionCTypesupport

if TYPE_CHECKING:
    from collections.abc import Iterator

HERE = Path(__file__).resolve().parent
PREFIX = Path(sys.prefix)
SITE = Path(sysconfig.get_path("purelib"))
MARK = PREFIX / ".interfaces"
PACKAGES = ("bond", "tf2_msgs", "nav2_msgs")
KINDS = (".action", ".msg", ".srv")
ABSENT = tuple(
    f"# not in {name}" for name in ("jazzy",) if any(metadata.distributions(name=f"ros-{name}-rclpy"))
)  # ends of lines that the distribution of the wheels lacks
# The middleware of the wheels uses its own type support. Without the introspection type support every service and
# action of these packages logs warnings.
MIDDLEWARE, INTROSPECTION = "rosidl_typesupport_fastrtps_c", "rosidl_typesupport_introspection_c"
# Libraries of the generated code, in addition to those of the packages whose messages it uses.
RUNTIME = (
    "rosidl_runtime_c", "rosidl_typesupport_c", MIDDLEWARE, INTROSPECTION, "rosidl_typesupport_fastrtps_cpp", "fastcdr",
    "rmw",
)  # fmt: skip
FLAGS = ("-O1", "-fPIC", "-w", "-pipe")


class Library(NamedTuple):
    """Suffix of a shared library in a ROS build, and its sources."""

    suffix: str
    sources: list[Path]


def main() -> None:
    """Build all packages if anything has changed."""
    key = fingerprint()
    if MARK.exists() and MARK.read_text() == key:
        return
    MARK.unlink(missing_ok=True)
    for tool in ("cc", "c++"):
        if shutil.which(tool) is None:
            sys.exit(f"{tool}: not found; it is needed to compile nav2_msgs, tf2_msgs and bond for the tests")
    os.environ["AMENT_PREFIX_PATH"] = str(PREFIX)  # where the generators find their templates
    with tempfile.TemporaryDirectory() as work:
        for package in PACKAGES:
            build(package, Path(work) / package)
    MARK.write_text(key)


def fingerprint() -> str:
    """Return a digest of everything that the result depends on."""
    digest = hashlib.sha256(sys.version.encode())
    for path in sorted(HERE.rglob("*")):
        if path.suffix in (*KINDS, ".py"):
            digest.update(f"{path.relative_to(HERE)}\0".encode() + path.read_bytes())
    wheels = {f"{found.name}=={found.version}" for found in metadata.distributions() if found.name.startswith("ros")}
    digest.update("\n".join(sorted(wheels)).encode())
    return digest.hexdigest()


def build(package: str, work: Path) -> None:
    """Generate, compile and install one package."""
    definitions = defined(package, work / "definitions")
    named = [f"{definitions}:{p.relative_to(definitions)}" for p in sorted(definitions.rglob("*")) if p.suffix in KINDS]
    share = PREFIX / "share" / package
    known = [str(p) for p in (PREFIX / "share").iterdir() if p != share and any(p.glob("*/*.idl"))]
    # Headers are included as <package/...>, so the folders above are include directories.
    code, dynamic = work / "c" / package, work / "introspection" / package
    dispatch, python = work / "dispatch", work / "python"
    with quiet():
        files = translate(
            package_name=package, interface_files=named, include_paths=known, output_format="idl", output_path=share
        )
        hashes = generate_type_hashes(
            package_name=package, interface_files=files, include_paths=known, output_path=share
        )
        GenerateC("c").generate(package, files, known, code, hashes)
        GenerateFastRTPSCTypesupport("fastrtps").generate(package, files, known, code)
        GenerateIntrospectionCTypesupport("introspection").generate(package, files, known, dynamic)
        GenerateCTypesupport("c", typesupport_implementations=[MIDDLEWARE, INTROSPECTION]).generate(
            package, files, known, dispatch
        )
        GeneratePython("py", typesupport_implementations=["rosidl_typesupport_c"]).generate(
            package, files, known, python
        )
    libraries = (
        Library("rosidl_generator_c", list(code.rglob("*.c"))),
        Library(MIDDLEWARE, list(code.rglob("*.cpp"))),
        Library(INTROSPECTION, list(dynamic.rglob("*.c"))),
        Library("rosidl_typesupport_c", list(dispatch.rglob("*.cpp"))),
        Library("rosidl_generator_py", list(python.rglob("*_s.c"))),
    )
    entry = python / f"_{package}_s.ep.rosidl_typesupport_c.c"
    compile_all([*(path for library in libraries for path in library.sources), entry], work)
    install(package, libraries, entry, [Path(p).name for p in known])


def defined(package: str, target: Path) -> Path:
    """Copy the definitions of a package, without the lines that the distribution of the wheels lacks."""
    shutil.copytree(HERE / package, target)
    for path in target.rglob("*.*"):
        lines = path.read_text(encoding="utf-8").splitlines(keepends=True)
        path.write_text("".join(line for line in lines if not line.rstrip().endswith(ABSENT)), encoding="utf-8")
    return target


@contextlib.contextmanager
def quiet() -> Iterator[None]:
    """Suppress the output of the generators unless they fail."""
    output = io.StringIO()
    log = logging.getLogger("rosidl_cli.entry_points")
    log.addFilter(is_no_duplicate)
    try:
        with contextlib.redirect_stdout(output):
            yield
    except BaseException:
        sys.stderr.write(output.getvalue())
        raise
    finally:
        log.removeFilter(is_no_duplicate)


def is_no_duplicate(record: logging.LogRecord) -> bool:
    """Whether a log record is not a warning about duplicate entry points of the wheels."""
    return not record.getMessage().startswith("Found duplicate entry point")


def compile_all(sources: list[Path], work: Path) -> None:
    """Compile every source to an object file next to it."""
    headers = [
        work / "c",
        work / "introspection",
        PREFIX / "include",
        *(PREFIX / "include").iterdir(),
        sysconfig.get_path("include"),
    ]
    flags = [*FLAGS, *(f"-I{path}" for path in [*headers, np.get_include()])]

    def compiled(path: Path) -> None:
        run("c++" if path.suffix == ".cpp" else "cc", *flags, "-c", path, "-o", f"{path}.o")

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        list(pool.map(compiled, sources))


def install(package: str, libraries: tuple[Library, ...], entry: Path, used: list[str]) -> None:
    """Link the libraries and the extension into this Python's environment."""
    lib = PREFIX / "lib"
    suffixes = [library.suffix for library in libraries]
    others = [f"-l{name}__{suffix}" for name in used for suffix in suffixes]
    others = [name for name in others if (lib / f"lib{name[2:]}.so").exists()]
    link = ["c++", "-shared", f"-L{lib}", f"-Wl,-rpath,{lib}", f"-Wl,-rpath-link,{lib}", "-Wl,--as-needed"]
    other = [*others, *(f"-l{name}" for name in RUNTIME)]
    own: list[str] = []
    for suffix, sources in libraries:
        run(*link, *(f"{path}.o" for path in sources), *own, *other, "-o", lib / f"lib{package}__{suffix}.so")
        own.append(f"-l{package}__{suffix}")
    module = SITE / package
    shutil.rmtree(module, ignore_errors=True)
    shutil.copytree(entry.parent, module, ignore=shutil.ignore_patterns("*.c", "*.o"))
    (module / "__init__.py").touch()
    run(*link, f"{entry}.o", *own, *other, "-o", module / f"{package}_s__rosidl_typesupport_c.so")


def run(*command: object) -> None:
    """Run a compiler; it prints its errors itself."""
    subprocess.run([str(part) for part in command], check=True)


main()
