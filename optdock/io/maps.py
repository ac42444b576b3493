"""Maps of map_server: a YAML file and an image, as Nav2's `map_io` reads them."""

from __future__ import annotations

import logging
import math
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, TypeGuard

import numpy as np

from optdock.costmap.costs import OCCUPANCY_UNKNOWN, OccupancyArray
from optdock.costmap.occupancy import OccupancyGrid
from optdock.errors import InvalidFile, InvalidValue
from optdock.io.map_image import GreyImage, load_grey_image
from optdock.io.numbers import unit_fault
from optdock.io.yaml_lines import Document, load_yaml

if TYPE_CHECKING:
    from optdock.geometry.arrays import FloatArray, IntArray

__all__ = ["MapInfo", "MapMode", "load_map", "occupancy_from_image"]

logger = logging.getLogger(__name__)

_SAVER_UNKNOWN = 205  # the grey that map_saver writes for unknown cells


class MapMode(str, Enum):
    """How grey values become occupancies."""

    TRINARY = "trinary"
    SCALE = "scale"
    RAW = "raw"


@dataclass(frozen=True)
class MapInfo:
    """The content of a map's YAML file.

    Args:
        image: Path of the image.
        resolution: Side of a pixel [m].
        origin: Lower left corner of the lower left pixel, x and y [m].
        negate: Whether white is occupied and black free.
        occupied_thresh: Occupancy probability from which a cell is occupied.
        free_thresh: Occupancy probability up to which a cell is free.
        mode: How grey values become occupancies.
    """

    image: Path
    resolution: float
    origin: tuple[float, float]
    negate: bool
    occupied_thresh: float
    free_thresh: float
    mode: MapMode = MapMode.TRINARY


def load_map(path: str | Path) -> OccupancyGrid:
    """Read a map; `load_map(path).costmap` is its costmap.

    Keys that map_server does not know are ignored, as it ignores them.

    Args:
        path: The YAML file; `image` in it is relative to its folder.

    Raises:
        InvalidFile: The YAML file or the image breaks the format; every fault in both is listed.
    """
    document = load_yaml(path)
    reader = _InfoReader(document)
    info = reader.info()
    image = reader.image_of(info.image if info else reader.image_path())
    if info is None or image is None:
        raise InvalidFile("\n".join(reader.faults))
    if info.mode is MapMode.RAW and image.maxval != 255:
        reader.refuse("mode", f"raw needs an image of 8 bit with largest grey value 255, got {image.maxval}")
        raise InvalidFile("\n".join(reader.faults))
    _warn_of_free_unknowns(path, info, image)
    try:
        return OccupancyGrid(occupancy_from_image(image, info), info.resolution, info.origin)
    except InvalidValue as error:  # a map whose far corner is not a finite number
        raise InvalidFile(f"{path}: {error}") from error


def occupancy_from_image(image: GreyImage, info: MapInfo) -> OccupancyArray:
    """Occupancies of an image, Shape (rows, columns), row 0 the lowest (the image's last).

    With v the grey value, p = (255 - v) / 255, or v / 255 when negated: occupied from `occupied_thresh` on, free up to
    `free_thresh`; between them unknown (trinary) or 100 (p - free) / (occupied - free) rounded (scale). Transparent
    pixels are unknown. Raw takes grey values 0..100 as they are, others are unknown.
    """
    table = _raw_table() if info.mode is MapMode.RAW else _threshold_table(info)
    occupancy = table[image.grey]
    if image.transparent is not None and info.mode is not MapMode.RAW:
        occupancy[image.transparent] = OCCUPANCY_UNKNOWN
    return np.ascontiguousarray(occupancy[::-1])


def _raw_table() -> OccupancyArray:
    grey = np.arange(256)
    return np.where(grey <= 100, grey, OCCUPANCY_UNKNOWN).astype(np.int8)


def _threshold_table(info: MapInfo) -> OccupancyArray:
    grey = np.arange(256)
    probability: FloatArray = (grey if info.negate else 255 - grey) / 255.0
    between: IntArray = np.full(256, OCCUPANCY_UNKNOWN)
    if info.mode is MapMode.SCALE and info.occupied_thresh > info.free_thresh:
        share = (probability - info.free_thresh) / (info.occupied_thresh - info.free_thresh)
        between = np.floor(100.0 * np.clip(share, 0.0, 1.0) + 0.5).astype(np.int64)
    free_or_between = np.where(probability <= info.free_thresh, 0, between)
    return np.where(probability >= info.occupied_thresh, 100, free_or_between).astype(np.int8)


def _warn_of_free_unknowns(path: str | Path, info: MapInfo, image: GreyImage) -> None:
    is_free = _threshold_table(info)[_SAVER_UNKNOWN] == 0
    if info.mode is not MapMode.TRINARY or info.negate or not is_free:
        return
    count = int(np.count_nonzero(image.grey == _SAVER_UNKNOWN))
    if count:
        logger.warning(
            "%s: free_thresh %g makes %d pixels of grey 205 free, which map_saver writes for unknown; 0.196 keeps them",
            path,
            info.free_thresh,
            count,
        )


class _InfoReader:
    """Reads `MapInfo` from a document and collects every fault on the way."""

    def __init__(self, document: Document) -> None:
        self.document = document
        self.faults: list[str] = []
        value = document.value
        self._values: dict[object, object] = dict(value) if isinstance(value, dict) else {}
        if not isinstance(value, dict):
            self.faults.append(document.fault((), f"must be a mapping of map_server keys, got {value!r}"))

    def info(self) -> MapInfo | None:
        """The map's description, or None after a fault."""
        if self.faults:
            return None
        image, resolution, origin = self.image_path(), self._resolution(), self._origin()
        negate, mode = self._negate(), self._mode()
        occupied, free = self._threshold("occupied_thresh"), self._threshold("free_thresh")
        if occupied is not None and free is not None and free > occupied:
            self.refuse("free_thresh", f"must be <= occupied_thresh = {occupied}, got {free}")
        if image is None:
            self.refuse("image", self._missing_or("image", "must be the name of an image file"))
        if self.faults or image is None or resolution is None or origin is None or occupied is None or free is None:
            return None
        return MapInfo(image, resolution, origin, negate, occupied, free, mode)

    def refuse(self, key: str, message: str) -> None:
        """Note a fault."""
        self.faults.append(self.document.fault((key,), message))

    def image_path(self) -> Path | None:
        """Where the image should be, or None where that is not said."""
        name = self._values.get("image")
        return self.document.path.parent / name if isinstance(name, str) and name else None

    def image_of(self, path: Path | None) -> GreyImage | None:
        """The image, or None after a fault."""
        if path is None:
            return None
        try:
            return load_grey_image(path)
        except InvalidFile as error:
            self.refuse("image", str(error))
            return None

    def _missing_or(self, key: str, rule: str) -> str:
        return f"{rule}, got {self._values[key]!r}" if key in self._values else "is missing"

    def _number(self, key: str, rule: str) -> float | None:
        value = self._values.get(key)
        if _is_number(value):
            return float(value)
        self.refuse(key, self._missing_or(key, rule))
        return None

    def _resolution(self) -> float | None:
        rule = "must be finite and > 0 m"
        value = self._number("resolution", rule)
        if value is None or value > 0.0:
            return value
        self.refuse("resolution", f"{rule}, got {value}")
        return None

    def _threshold(self, key: str) -> float | None:
        rule = "must be a probability in 0..1"
        value = self._number(key, rule)
        if value is None or 0.0 <= value <= 1.0:
            return value
        self.refuse(key, f"{rule}, got {value}")
        return None

    def _origin(self) -> tuple[float, float] | None:
        value = self._values.get("origin")
        numbers = [float(v) for v in value if _is_number(v)] if isinstance(value, list) else []
        if not isinstance(value, list) or len(value) != 3 or len(numbers) != 3:
            self.refuse("origin", self._missing_or("origin", "must be [x, y, yaw], three finite numbers"))
            return None
        if numbers[2] != 0.0:
            reason = "the cells of a costmap run along x and y, and Nav2's costmap ignores the yaw; rotate the image"
            implausible = unit_fault(numbers[2], "rad")
            got = f"yaw {implausible}; but it must be 0" if implausible else f"yaw must be 0, got {numbers[2]}"
            self.refuse("origin", f"{got}: {reason}")
            return None
        return numbers[0], numbers[1]

    def _negate(self) -> bool:
        value = self._values.get("negate")
        if not (isinstance(value, (bool, int)) and value in (0, 1)):
            self.refuse("negate", self._missing_or("negate", "must be 0 or 1"))
        return bool(value)

    def _mode(self) -> MapMode:
        value = self._values.get("mode", "trinary")
        known = [mode.value for mode in MapMode]
        if isinstance(value, str) and value.lower() in known:
            return MapMode(value.lower())
        self.refuse("mode", f"must be one of {', '.join(known)}, got {value!r}")
        return MapMode.TRINARY


def _is_number(value: object) -> TypeGuard[float]:
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return False
    try:
        return math.isfinite(value)
    except OverflowError:  # a whole number beyond the largest float
        return False
