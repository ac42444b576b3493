"""Files of the folder of the page, and its maps, which are read again only after they have changed.

Names of files may come from the page, so every file is inside the folder after links and `..` have been resolved.
"""

from __future__ import annotations

import functools
import hashlib
from collections.abc import Mapping
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import TYPE_CHECKING

from optdock.config import demo_scenario
from optdock.errors import InvalidValue
from optdock.io.maps import load_map
from optdock.io.quoting import shown
from optdock.io.yaml_lines import load_yaml

if TYPE_CHECKING:
    from optdock.model.costmap import Costmap

__all__ = ["inside", "is_inside", "known_costmap", "linked_map", "linked_name", "map_digest"]

_BUILT_IN = demo_scenario().with_name("hall_map.yaml")
_BUILT_IN_NAME = f"optdock:{_BUILT_IN.name}"  # in links
_LONGEST_NAME = 200  # characters in a link
_MOST_MAPS = 4  # that are kept


def is_inside(file: str | Path, folder: str | Path) -> bool:
    """Whether a file, whose name is relative to the folder or absolute, is inside the folder."""
    try:
        root = Path(folder).resolve(strict=True)
        return (root / file).resolve().is_relative_to(root)
    except (OSError, ValueError, RuntimeError):  # no folder; a null byte; a loop of links
        return False


def inside(file: str | Path, folder: str | Path) -> Path:
    """Return the path of a file.

    Raises:
        InvalidValue: If the file is not inside the folder.
    """
    if not (isinstance(file, str | Path) and is_inside(file, folder)):
        raise InvalidValue(f"file: {shown(str(file))} is not in the folder of optdock ui, {shown(str(folder))}")
    return Path(folder).resolve() / file


def known_costmap(file: str | Path, folder: str | Path) -> Costmap:
    """Return the costmap of a map (map_server YAML); the same one while neither of its files has changed.

    Raises:
        InvalidFile: If the map cannot be read.
        InvalidValue: If the map or its image is not inside the folder.
    """
    file = inside(file, folder)
    content = load_yaml(file).value
    image = content.get("image") if isinstance(content, Mapping) else None
    files = [file, *([inside(file.parent / image, folder)] if isinstance(image, str) else [])]
    return _read(file, tuple(map(_state, files)))


@functools.lru_cache(maxsize=_MOST_MAPS)
def _read(file: Path, _: tuple[tuple[int, ...], ...]) -> Costmap:
    return load_map(file).costmap.frozen()


def _state(file: Path) -> tuple[int, ...]:
    """Return numbers of which one differs after a file has changed; none for a missing file."""
    try:
        found = file.stat()
    except (OSError, ValueError):  # which the reader reports
        return ()
    return found.st_dev, found.st_ino, found.st_size, found.st_mtime_ns, found.st_ctime_ns


# Maps in links.


def linked_name(source: Path | None, folder: str | Path) -> str:
    """Return the name of a map in a link: its path within the folder, or the name of the built-in map.

    Raises:
        InvalidValue: If it is neither.
    """
    if source == _BUILT_IN:
        return _BUILT_IN_NAME
    root = Path(folder).resolve()
    paths = [] if source is None else [source, source.resolve()]
    name = next((path.relative_to(root).as_posix() for path in paths if path.is_relative_to(root)), "")
    if not name or len(name) > _LONGEST_NAME or not name.isprintable():
        raise InvalidValue("link: the map of the scene is not a file of the folder of optdock ui")
    return name


def linked_map(name: str, folder: str | Path) -> tuple[Costmap, Path]:
    """Return the costmap and the file of a map in a link, whose name may be any text.

    Raises:
        InvalidFile: If the map cannot be read.
        InvalidValue: If the name is no path within the folder, or the map or its image is not inside the folder.
    """
    if name == _BUILT_IN_NAME:
        return known_costmap(_BUILT_IN, _BUILT_IN.parent), _BUILT_IN
    if len(name) > _LONGEST_NAME or PurePosixPath(name).is_absolute() or PureWindowsPath(name).anchor:
        raise InvalidValue(f"must be a path within the folder of optdock ui, got {shown(name)}")
    file = inside(name, folder)
    return known_costmap(file, folder), file


@functools.lru_cache(maxsize=_MOST_MAPS)
def map_digest(costmap: Costmap) -> str:
    """Return the hexadecimal digest of the cells of a frozen costmap."""
    found = hashlib.blake2b(repr((costmap.data.shape, costmap.resolution, costmap.origin)).encode(), digest_size=8)
    found.update(costmap.data.tobytes())
    return found.hexdigest()
