"""Checks what is in a wheel: the three packages, their types, stubs and data, and nothing else."""

import sys
import zipfile

PACKAGES = {"optdock", "smoothers", "checkers"}
NEEDED = {f"{package}/py.typed" for package in PACKAGES} | {
    "optdock/__init__.pyi",
    "optdock/config/demo/hall.yaml",
    "optdock/config/demo/hall_map.png",
    "optdock/reports/html/templates/page.html",
    "optdock/ui/scenes/no_way.yaml",
    "optdock/ui/templates/ui.html",
    "optdock/kernels.c",
    "optdock/verification/conservative_advancement_kernel.c",
}
SUFFIXES = (".py", ".pyi", ".typed", ".yaml", ".png", ".css", ".html", ".js", ".c")
LIBRARY = "optdock/_kernels.shared"


def faults(names: list[str]) -> list[str]:
    """What is wrong with the files of a wheel, a line each."""
    files = [name for name in names if not name.partition("/")[0].endswith(".dist-info")]
    found = [
        f"{name}: beside {', '.join(sorted(PACKAGES))}" for name in files if name.partition("/")[0] not in PACKAGES
    ]
    found += [f"{name}: missing" for name in sorted(NEEDED - set(files))]
    return found + [f"{name}: neither code nor data" for name in files if not name.endswith((*SUFFIXES, LIBRARY))]


def wrong_tag(wheel: str, names: list[str]) -> list[str]:
    """Whether the tag of a wheel contradicts its content: a platform if it has compiled kernels, any otherwise."""
    is_pure = wheel.endswith("-py3-none-any.whl")
    return [] if is_pure != (LIBRARY in names) else [f"{wheel}: its tag does not fit its kernels"]


if __name__ == "__main__":
    with zipfile.ZipFile(sys.argv[1]) as wheel:
        names = wheel.namelist()
        wrong = [*faults(names), *wrong_tag(sys.argv[1].rpartition("/")[2], names)]
    print("\n".join(wrong) or f"{sys.argv[1].rpartition('/')[2]}: complete")
    sys.exit(bool(wrong))
