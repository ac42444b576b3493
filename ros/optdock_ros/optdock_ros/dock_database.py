"""The docks that the server knows by name, from parameters or a database file."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from optdock.errors import DockNotInDB, DockNotValid, InvalidValue
from optdock.io.quoting import printable
from optdock.io.yaml_lines import Document
from optdock.nav2.docks import DockEntry, load_dock_database, read_dock
from optdock.plugins.parameters import closest

if TYPE_CHECKING:
    from optdock.io.yaml_lines import Keys
    from optdock_ros.dock_plugins import DockPlugin

__all__ = ["Docks", "docks_of_parameters"]


class Docks:
    """Docks and their plugins.

    Args:
        plugins: Dock plugins by the names of their instances.
        entries: Docks by their names.
    """

    def __init__(self, plugins: Mapping[str, DockPlugin], entries: Mapping[str, DockEntry]) -> None:
        self.plugins, self.entries = dict(plugins), dict(entries)

    def reload(self, path: str) -> None:
        """Replace the docks by those of a file.

        Raises:
            InvalidFile: If the file is unreadable or invalid; the docks are unchanged.
        """
        self.entries = load_dock_database(path)

    def find(self, name: str) -> tuple[DockEntry, DockPlugin]:
        """Return a dock and its plugin.

        Raises:
            DockNotInDB: If the name is unknown.
            DockNotValid: If the type of the dock is unknown.
        """
        entry = self.entries.get(name)
        if entry is None:
            known = ", ".join(self.entries) or "none"
            raise DockNotInDB(f"dock_id: there is no dock {name!r}{closest(name, self.entries)}; known: {known}")
        return entry, self.plugin(entry.type, f"dock {name}")

    def plugin(self, type_name: str, owner: str) -> DockPlugin:
        """Return a dock plugin; the only one for an empty name.

        Raises:
            DockNotValid: If the type is unknown.
        """
        if not type_name and len(self.plugins) == 1:
            return next(iter(self.plugins.values()))
        found = self.plugins.get(type_name)
        if found is None:
            known = ", ".join(self.plugins)
            raise DockNotValid(
                f"{owner}: there is no dock type {type_name!r}{closest(type_name, self.plugins)}; known: {known}"
            )
        return found


class _Parameters(Document):
    """Parameters, possibly of several files; a fault names the parameter only."""

    def fault(self, keys: Keys, message: str) -> str:
        return printable(f"{'.'.join(map(str, keys))}: {message}")


def docks_of_parameters(block: Mapping[str, object]) -> dict[str, DockEntry]:
    """Return the docks of a parameter block, or of the file that it names.

    Raises:
        InvalidFile: If the file is invalid.
        InvalidValue: If a dock of the block is invalid; one line per fault.
    """
    path = block.get("dock_database")
    if path:
        return load_dock_database(str(path))
    names = block.get("docks") or []
    if not (isinstance(names, list) and all(isinstance(name, str) for name in names)):
        raise InvalidValue(f"docks: must be a list of names, got {names!r}")
    faults: list[str] = []
    document = _Parameters(Path(), block, {})
    entries = [read_dock(document, (name,), faults) for name in dict.fromkeys(names)]
    if faults:
        raise InvalidValue("\n".join(faults))
    return {entry.name: entry for entry in entries if entry is not None}
