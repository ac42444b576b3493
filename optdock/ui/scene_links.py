"""Links that contain a scene: `1.` and the base64url text of the compressed scenario file.

A link may come from anyone. It is limited in size before and after decompression, and no file is read for it.
"""

from __future__ import annotations

import base64
import binascii
import re
import zlib

from optdock.config.scenario import parse_scenario
from optdock.config.writing import check_supported, document_text, scenario_document
from optdock.errors import InvalidValue, OptdockError
from optdock.io.quoting import shown
from optdock.ui.scene_edits import EditedScene
from optdock.ui.scene_fields import LONGEST_MESSAGE, MOST_SECONDS

__all__ = ["from_link", "to_link"]

_VERSION = "1"
_LINK = re.compile(r"([0-9]{1,3})\.([A-Za-z0-9_-]+)")
_MOST_CHARACTERS = 16_000  # of a link; servers accept 64 kB of headers, many programs less
_MOST_BYTES = 64_000  # of the scenario file


def to_link(scene: EditedScene) -> str:
    """Return the text of a link to a scene, for the query of a URL.

    Raises:
        InvalidValue: If the scene has a map or values without a key in a scenario file, or is too large for a link.
    """
    if scene.problem.costmap is not None:
        raise InvalidValue("link: the scene has a map, which a link cannot contain; save the scenario instead")
    check_supported(scene.problem)
    content = document_text(scenario_document(scene.scenario, obstacles=scene.polygons)).encode()
    text = base64.urlsafe_b64encode(zlib.compress(content, 9)).decode("ascii").rstrip("=")
    link = f"{_VERSION}.{text}"
    if len(content) > _MOST_BYTES or len(link) > _MOST_CHARACTERS:
        raise InvalidValue(f"link: the scene is too large, {len(content)} bytes; save the scenario instead")
    return link


def from_link(text: str) -> EditedScene:
    """Return the scene of a link, which may be any text.

    Raises:
        InvalidValue: If the text is not a link of this version, is too large, or contains an invalid scenario, a map,
            or a time budget above `MOST_SECONDS`.
    """
    try:
        scenario = parse_scenario(_content(text), "link")
    except InvalidValue:
        raise
    except OptdockError as error:
        message = str(error)
        raise InvalidValue(
            message if len(message) <= LONGEST_MESSAGE else f"{message[: LONGEST_MESSAGE - 3]}..."
        ) from None
    if scenario.time_budget > MOST_SECONDS:
        raise InvalidValue(f"link: time_budget: must be <= {MOST_SECONDS:g} s, got {scenario.time_budget:g}")
    return EditedScene(scenario)


def _content(text: str) -> str:
    """Return the scenario file in a link."""
    if not isinstance(text, str) or len(text) > _MOST_CHARACTERS:
        raise InvalidValue(f"link: must be text of at most {_MOST_CHARACTERS} characters")
    match = _LINK.fullmatch(text)
    if match is None:
        raise InvalidValue(f"link: must be {_VERSION}. and base64url text, got {shown(text)}")
    if match[1] != _VERSION:
        raise InvalidValue(f"link: its version is {match[1]}; this program reads version {_VERSION}")
    reader = zlib.decompressobj()
    try:
        packed = base64.b64decode(match[2] + "=" * (-len(match[2]) % 4), b"-_", validate=True)
        content = reader.decompress(packed, _MOST_BYTES)
        scenario = content.decode()
    except (binascii.Error, zlib.error, UnicodeDecodeError):
        raise InvalidValue("link: is damaged: it does not contain a compressed text") from None
    if not reader.eof or reader.unused_data:
        raise InvalidValue(f"link: is damaged, or its scenario has more than {_MOST_BYTES} bytes")
    return scenario
