"""The content of a page that is being opened: a scene, a recorded docking or a survey, from a file or a link."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from optdock.errors import InvalidValue, OptdockError
from optdock.io.quoting import shown
from optdock.ui.recorded_docking import recorded_docking
from optdock.ui.scene_files import open_scene
from optdock.ui.scene_links import from_link
from optdock.ui.scene_maps import inside
from optdock.ui.surveyed_floor import surveyed_floor

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from optdock.ui.recorded_docking import RecordedDocking
    from optdock.ui.scene_edits import EditedScene
    from optdock.ui.surveyed_floor import SurveyedFloor

__all__ = ["AskedPage", "asked_page", "open_source"]

_LONGEST_NAME = 200  # characters of a file in the address of a page


class AskedPage(NamedTuple):
    """Content of a page.

    Attributes:
        opened: The scene, or a docking or survey with its scene.
        fault: Message of an address that is wrong, for which the first scene is opened; otherwise empty.
        variant: Variant of the colours of `PALETTE`: 0 for light, 1 for dark pages.
    """

    opened: EditedScene | RecordedDocking | SurveyedFloor
    fault: str
    variant: int


def asked_page(source: Path | None, folder: Path, arguments: Mapping[str, list[bytes]]) -> AskedPage:
    """Return the content of a page; may be called in any thread.

    Args:
        source: File with which the program was started, or None.
        folder: Folder in which the page may read and write files.
        arguments: Arguments of the query: `scene`, a link; `file`, a file in the folder; `theme`, `dark` or nothing.
            An argument that is wrong becomes a message on the page with the first scene.
    """
    given = {name: arguments.get(name, [b""])[0].decode("utf-8", "replace") for name in ("scene", "file", "theme")}
    fault = ""
    try:
        opened = _opened(source, folder, given)
    except OptdockError as error:
        fault = str(error)
        try:
            opened = open_source(source, folder)
        except OptdockError:  # the file has changed since the program was started
            opened = open_scene(None, folder)
    return AskedPage(opened, fault, int(given["theme"] == "dark"))


def open_source(source: str | Path | None, folder: Path) -> EditedScene | RecordedDocking | SurveyedFloor:
    """Return the scene of a file, the docking of a log (suffix `.jsonl`), or the survey of a folder.

    Raises:
        InvalidFile: If the file cannot be read.
        InvalidValue: If it is not inside the folder, or does not fit.
    """
    if source is not None and str(source).lower().endswith(".jsonl"):
        return recorded_docking(source, folder)
    if source is not None and (inside(source, folder) / "survey.json").is_file():
        return surveyed_floor(source, folder)
    return open_scene(source, folder)


def _opened(
    source: Path | None, folder: Path, given: Mapping[str, str]
) -> EditedScene | RecordedDocking | SurveyedFloor:
    if given["scene"]:
        return from_link(given["scene"], folder)
    if len(given["file"]) > _LONGEST_NAME:
        raise InvalidValue(f"file: must have at most {_LONGEST_NAME} characters, got {shown(given['file'])}")
    return open_source(given["file"] or source, folder)
