"""Build hook of the wheel: compiles the kernels, if there is a compiler, and then gives the wheel a platform tag.

Without a compiler the wheel is a pure one, whose kernels are the NumPy twins. An editable install compiles the library
into the source tree.
"""

from __future__ import annotations

import runpy
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface
from packaging.tags import platform_tags


class KernelHook(BuildHookInterface[Any]):
    """Compile the kernels before a wheel is built."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Compile the library and add it to the wheel; `version` is `standard` or `editable`."""
        root = Path(self.root)
        # optdock cannot be imported here, because its dependencies are not installed in the build environment.
        tools = runpy.run_path(str(root / "optdock" / "build_kernels.py"))
        library = root / tools["LIBRARY"]
        try:
            tools["build"](root)
        except (tools["BuildFailed"], OSError) as error:
            library.unlink(missing_ok=True)  # one of an earlier build
            self.app.display_warning(f"optdock: built without kernels in C, NumPy is used instead: {error}")
            return
        if version != "editable":
            build_data["artifacts"].append(f"/{tools['LIBRARY'].as_posix()}")
            build_data["pure_python"] = False
            build_data["tag"] = f"py3-none-{next(platform_tags())}"
