"""Links that contain a scene: a version, and the base64url text of the compressed scenario file.

Version 1 is a scene without a map. Version 2 ends with the digest of the map, whose path within the folder of the
program is the key `map` of the scenario file. A link may come from anyone: it is limited in size before and after
decompression, and only a map within the folder is read for it.
"""

from __future__ import annotations

import base64
import binascii
import re
import zlib
from typing import TYPE_CHECKING

from optdock.config.scenario import parse_scenario
from optdock.config.writing import check_supported, document_text, scenario_document
from optdock.errors import InvalidValue, OptdockError
from optdock.io.quoting import shown
from optdock.ui.scene_edits import EditedScene
from optdock.ui.scene_fields import LONGEST_MESSAGE, MOST_SECONDS
from optdock.ui.scene_maps import linked_map, linked_name, map_digest

if TYPE_CHECKING:
    from pathlib import Path

    from optdock.model.costmap import Costmap

__all__ = ["from_link", "to_link"]

_LINK = re.compile(r"([0-9]{1,3})\.([A-Za-z0-9_-]+)(?:\.([0-9a-f]{16}))?")
_MOST_CHARACTERS = 16_000  # of a link; servers accept 64 kB of headers, many programs less
_MOST_BYTES = 64_000  # of the scenario file


def to_link(scene: EditedScene, folder: str | Path) -> str:
    """Return the text of a link to a scene, for the query of a URL.

    Args:
        scene: The scene.
        folder: Folder within which the link names the map.

    Raises:
        InvalidValue: If the scene has values without a key in a scenario file, a map that is neither in the folder nor
            the built-in one, or is too large for a link.
    """
    check_supported(scene.problem)
    costmap = scene.problem.costmap
    name = "" if costmap is None else linked_name(scene.map_source, folder)
    content = document_text(scenario_document(scene.scenario, map_name=name, obstacles=scene.polygons)).encode()
    text = base64.urlsafe_b64encode(zlib.compress(content, 9)).decode("ascii").rstrip("=")
    link = f"1.{text}" if costmap is None else f"2.{text}.{map_digest(costmap)}"
    if len(content) > _MOST_BYTES or len(link) > _MOST_CHARACTERS:
        raise InvalidValue(f"link: the scene is too large, {len(content)} bytes")
    return link


def from_link(text: str, folder: str | Path) -> EditedScene:
    """Return the scene of a link, which may be any text.

    Args:
        text: The link.
        folder: Folder within which the link names the map.

    Raises:
        InvalidValue: If the text is not a link of these versions, is too large, or contains an invalid scenario, a map
            that cannot be read or has changed, or a time budget above `MOST_SECONDS`.
    """
    content, known = _content(text)
    source: Path | None = None

    def _costmap(name: str) -> Costmap:
        nonlocal source
        costmap, source = linked_map(name, folder)
        if map_digest(costmap) != known:
            raise InvalidValue(f"{shown(name)} has changed since the link was made")
        return costmap

    try:
        scenario = parse_scenario(content, "link", _costmap if known else None)
    except OptdockError as error:
        message = str(error)
        raise InvalidValue(
            message if len(message) <= LONGEST_MESSAGE else f"{message[: LONGEST_MESSAGE - 3]}..."
        ) from None
    if scenario.time_budget > MOST_SECONDS:
        raise InvalidValue(f"link: time_budget: must be <= {MOST_SECONDS:g} s, got {scenario.time_budget:g}")
    if known and source is None:
        raise InvalidValue("link: is damaged: it names no map")
    return EditedScene(scenario, source)


def _content(text: str) -> tuple[str, str]:
    """Return the scenario file in a link, and the digest of its map; empty without a map."""
    if not isinstance(text, str) or len(text) > _MOST_CHARACTERS:
        raise InvalidValue(f"link: must be text of at most {_MOST_CHARACTERS} characters")
    match = _LINK.fullmatch(text)
    if match is None:
        raise InvalidValue(f"link: must be a version and base64url text, such as 1.eJw, got {shown(text)}")
    if match[1] not in ("1", "2"):
        raise InvalidValue(f"link: its version is {match[1]}; this program reads the versions 1 and 2")
    if (match[1] == "2") != (match[3] is not None):
        raise InvalidValue("link: is damaged: only version 2 has the digest of a map")
    reader = zlib.decompressobj()
    try:
        packed = base64.b64decode(match[2] + "=" * (-len(match[2]) % 4), b"-_", validate=True)
        content = reader.decompress(packed, _MOST_BYTES)
        scenario = content.decode()
    except (binascii.Error, zlib.error, UnicodeDecodeError):
        raise InvalidValue("link: is damaged: it does not contain a compressed text") from None
    if not reader.eof or reader.unused_data:
        raise InvalidValue(f"link: is damaged, or its scenario has more than {_MOST_BYTES} bytes")
    return scenario, match[3] or ""
