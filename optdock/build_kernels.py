"""Compile the kernels, all files `*_kernel.c` beside their NumPy twins, into one shared library in this package.

    python -m optdock.build_kernels          # again after a change of the sources, or once a compiler is there

The build hook of the wheel (`hatch_build.py`) runs this file too, so it imports the standard library alone. The digest
of the sources is compiled into the library; `optdock.kernels` rejects a library with the digest of other sources.
"""

from __future__ import annotations

import hashlib
import os
import shlex
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

__all__ = ["FLAGS", "LIBRARY", "BuildFailed", "build", "digest_of", "kernel_sources"]

PACKAGES = ("optdock", "smoothers")
# Relative to the folder that contains the packages. With the suffix .so Python would take it for a module.
LIBRARY = Path("optdock", "_kernels.shared")
ABOUT = Path("optdock", "kernels.c")  # digest and self-test of the library
# Contraction to fused operations would change roundings, and with fast-math comparisons with NaN would be removed.
FLAGS = ("-O2", "-std=c99", "-ffp-contract=off", "-fno-fast-math", "-fPIC", "-shared")


class BuildFailed(Exception):
    """There is no compiler, or it failed; the message has the reason."""


def kernel_sources(root: Path) -> list[Path]:
    """Return the C files below `root`, relative to it, in a fixed order."""
    found = [path for package in PACKAGES for path in (root / package).rglob("*_kernel.c")]
    return [ABOUT, *sorted(path.relative_to(root) for path in found)]


def digest_of(root: Path, sources: list[Path]) -> str:
    """Return a hexadecimal digest of the names and contents of files, given relative to `root`."""
    found = hashlib.sha256()
    for source in sources:
        content = (root / source).read_bytes()
        found.update(f"{source.as_posix()} {len(content)}\n".encode() + content)
    return found.hexdigest()


def build(root: Path, library: Path | None = None, more_flags: tuple[str, ...] = ()) -> Path:
    """Compile all kernels with the compiler in the environment variable `CC`, by default `cc`.

    Args:
        root: Folder that contains the packages.
        library: The file to write, replaced atomically; None for `LIBRARY` below `root`.
        more_flags: Further flags, such as those of sanitizers.

    Returns:
        The path of the library.

    Raises:
        BuildFailed: If there is no compiler or a source does not compile.
    """
    compiler = shlex.split(os.environ.get("CC") or "cc")
    if not compiler or shutil.which(compiler[0]) is None:
        raise BuildFailed(f"no C compiler: {' '.join(compiler)} is not a command")
    library, sources = library or root / LIBRARY, kernel_sources(root)
    listed = " ".join(source.as_posix() for source in sources)
    about = f'-DOPTDOCK_DIGEST="{digest_of(root, sources)}"', f'-DOPTDOCK_SOURCES="{listed}"'
    with tempfile.TemporaryDirectory(dir=library.parent) as folder:
        made = Path(folder, library.name)
        command = (*compiler, *FLAGS, *more_flags, *about, "-o", str(made), *map(str, sources), "-lm")
        done = subprocess.run(command, cwd=root, capture_output=True, text=True, check=False)
        if done.returncode != 0:
            raise BuildFailed(f"{' '.join(compiler)} failed with status {done.returncode}:\n{done.stderr}")
        made.replace(library)
    return library


def _main() -> int:
    try:
        library = build(Path(__file__).resolve().parents[1])
    except (BuildFailed, OSError) as error:
        sys.stderr.write(f"{error}\n")
        return 1
    sys.stdout.write(f"{library}\n")
    return 0


if __name__ == "__main__":
    sys.exit(_main())
