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
}
SUFFIXES = (".py", ".pyi", ".typed", ".yaml", ".png", ".css", ".html", ".js")


def faults(names: list[str]) -> list[str]:
    """What is wrong with the files of a wheel, a line each."""
    files = [name for name in names if not name.partition("/")[0].endswith(".dist-info")]
    found = [
        f"{name}: beside {', '.join(sorted(PACKAGES))}" for name in files if name.partition("/")[0] not in PACKAGES
    ]
    found += [f"{name}: missing" for name in sorted(NEEDED - set(files))]
    return found + [f"{name}: neither code nor data" for name in files if not name.endswith(SUFFIXES)]


if __name__ == "__main__":
    with zipfile.ZipFile(sys.argv[1]) as wheel:
        wrong = faults(wheel.namelist())
    print("\n".join(wrong) or f"{sys.argv[1].rpartition('/')[2]}: complete")
    sys.exit(bool(wrong))
