"""Maps of map_server, consisting of a YAML file and an image, read as Nav2's `map_io` reads them."""

from __future__ import annotations

import logging
import math
from collections.abc import Mapping
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeAlias, TypeGuard

import numpy as np
from pydantic import BaseModel, BeforeValidator, ConfigDict, ValidationError, ValidationInfo, field_validator

from optdock.errors import InvalidFile, InvalidValue
from optdock.io.atomic_file import replacing, write_text
from optdock.io.faults import Fault, faults_of, report
from optdock.io.guarded_file import is_regular
from optdock.io.map_image import GreyImage, load_grey_image
from optdock.io.numbers import is_number, unit_fault
from optdock.io.yaml_lines import load_yaml
from optdock.model.costmap import OccupancyGrid
from optdock.model.costs import LETHAL, NO_INFORMATION, OCCUPANCY_UNKNOWN, OccupancyArray

if TYPE_CHECKING:
    from optdock.geometry.arrays import FloatArray, IntArray
    from optdock.io.yaml_lines import Document
    from optdock.model.costmap import Costmap

__all__ = ["MapInfo", "MapMode", "load_map", "occupancy_from_image", "save_map"]

logger = logging.getLogger(__name__)

_PICTURES = (".bmp", ".gif", ".jpeg", ".jpg", ".pgm", ".png", ".ppm", ".tif", ".tiff")
_SAVER_FREE, _SAVER_UNKNOWN, _SAVER_OCCUPIED = 254, 205, 0  # grey values written by map_saver


class MapMode(str, Enum):
    """Conversion of grey values to occupancies."""

    TRINARY = "trinary"
    SCALE = "scale"
    RAW = "raw"


def _name(value: object) -> str:
    if not (isinstance(value, str) and value):
        raise ValueError("must be the name of an image file")
    return value


def _is_finite(value: object) -> TypeGuard[float]:
    return is_number(value) and math.isfinite(value)


def _resolution(value: object) -> float:
    if not (_is_finite(value) and value > 0.0):
        raise ValueError("must be finite and > 0 m")
    return float(value)


def _origin(value: object) -> tuple[float, float]:
    if not (isinstance(value, list) and len(value) == 3 and all(map(_is_finite, value))):
        raise ValueError("must be [x, y, yaw], three finite numbers")
    x, y, yaw = map(float, value)
    if yaw != 0.0:
        reason = "the cells of a costmap run along x and y, and Nav2's costmap ignores the yaw; rotate the image"
        implausible = unit_fault(yaw, "rad")
        got = f"yaw {implausible}; but it must be 0" if implausible else f"yaw must be 0, got {yaw}"
        raise InvalidValue(f"{got}: {reason}")
    return x, y


def _negate(value: object) -> bool:
    if not (isinstance(value, int) and value in (0, 1)):
        raise ValueError("must be 0 or 1")
    return bool(value)


def _probability(value: object) -> float:
    if not (_is_finite(value) and 0.0 <= value <= 1.0):
        raise ValueError("must be a probability in 0..1")
    return float(value)


def _mode(value: object) -> MapMode:
    known = [mode.value for mode in MapMode]
    if not (isinstance(value, str) and value.lower() in known):
        raise ValueError(f"must be one of {', '.join(known)}")
    return MapMode(value.lower())


Probability: TypeAlias = Annotated[float, BeforeValidator(_probability)]


class MapInfo(BaseModel):
    """Content of the YAML file of a map; unknown keys are ignored, as map_server does.

    Attributes:
        image: Name of the image, relative to the file's folder or absolute.
        resolution: Side of a pixel [m].
        origin: Lower left corner of the lower left pixel, x and y [m].
        negate: Whether white is occupied and black free.
        occupied_thresh: Smallest occupancy probability of an occupied cell.
        free_thresh: Largest occupancy probability of a free cell.
        mode: Conversion of grey values to occupancies.
    """

    model_config = ConfigDict(frozen=True, extra="ignore")

    image: Annotated[str, BeforeValidator(_name)]
    resolution: Annotated[float, BeforeValidator(_resolution)]
    origin: Annotated[tuple[float, float], BeforeValidator(_origin)]
    negate: Annotated[bool, BeforeValidator(_negate)]
    occupied_thresh: Probability
    free_thresh: Probability
    mode: Annotated[MapMode, BeforeValidator(_mode)] = MapMode.TRINARY

    @field_validator("free_thresh")
    @classmethod
    def _below_the_other(cls, value: float, info: ValidationInfo) -> float:
        occupied = info.data.get("occupied_thresh", 1.0)
        if value > occupied:
            raise InvalidValue(f"must be <= occupied_thresh = {occupied}, got {value}")
        return value


def load_map(path: str | Path) -> OccupancyGrid:
    """Read a map; `load_map(path).costmap` is its costmap.

    Args:
        path: The YAML file.

    Raises:
        InvalidFile: If the YAML file or the image violates the format; every fault is listed.
    """
    _refuse_picture(Path(path))
    document = load_yaml(path)
    if not isinstance(document.value, Mapping):
        # Only the type is printed, because the file may be any file with confidential content.
        kind = "a list" if isinstance(document.value, list) else "text or a number"
        raise InvalidFile(document.fault((), f"must be a mapping of map_server keys, got {kind}"))
    faults: list[Fault] = []
    info, image = _info(document.value, faults), _image(document, faults)
    if info is not None and image is not None and info.mode is MapMode.RAW and image.maxval != 255:
        message = f"raw needs an image of 8 bit with largest grey value 255, got {image.maxval}"
        faults.append(Fault(("mode",), message))
    if faults or info is None or image is None:
        raise InvalidFile(report(faults, document))
    _warn_of_free_unknowns(path, info, image)
    try:
        return OccupancyGrid(occupancy_from_image(image, info), info.resolution, info.origin)
    except InvalidValue as error:  # the far corner is not finite
        raise InvalidFile(f"{path}: {error}") from error


def save_map(target: str | Path, costmap: Costmap) -> tuple[Path, Path]:
    """Write a costmap as a map, in which lethal cells are occupied, unknown cells unknown, and all other cells free.

    Args:
        target: The YAML file; the image has the same name with the suffix `.pgm`.
        costmap: The costmap.

    Returns:
        The YAML file and the image file.

    Raises:
        InvalidFile: If a file cannot be written.
    """
    target = Path(target)
    image = target.with_suffix(".pgm")
    data = costmap.data
    grey = np.select([data == LETHAL, data == NO_INFORMATION], [_SAVER_OCCUPIED, _SAVER_UNKNOWN], _SAVER_FREE)
    with replacing(image) as temporary:
        header = f"P5 {data.shape[1]} {data.shape[0]} 255\n".encode()
        temporary.write_bytes(header + grey[::-1].astype(np.uint8).tobytes())
    x, y = costmap.origin
    write_text(
        target,
        f"image: {image.name}\nmode: trinary\nresolution: {costmap.resolution!r}\norigin: [{x!r}, {y!r}, 0.0]\n"
        "negate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n",
    )
    return target, image


def _refuse_picture(path: Path) -> None:
    """Raise an error that names the YAML file if the given file is an image."""
    if path.suffix.lower() in _PICTURES and is_regular(path):
        beside = next((file.name for file in map(path.with_suffix, (".yaml", ".yml")) if is_regular(file)), None)
        named = f"next to it, {beside}" if beside else f"that describes it, such as {path.stem}.yaml"
        raise InvalidFile(f"{path}: is an image; give the YAML file {named}")


def _info(values: Mapping[str, object], faults: list[Fault]) -> MapInfo | None:
    try:
        return MapInfo.model_validate(values)
    except ValidationError as error:
        faults.extend(faults_of(error, lambda _: MapInfo.model_fields))
        return None


def _image(document: Document, faults: list[Fault]) -> GreyImage | None:
    """Return the image, even if another key is wrong, so that the faults of both are reported."""
    name = document.value.get("image") if isinstance(document.value, Mapping) else None
    if not (isinstance(name, str) and name):
        return None
    try:
        return load_grey_image(document.path.parent / name)
    except InvalidFile as error:
        faults.append(Fault(("image",), str(error)))
        return None


def occupancy_from_image(image: GreyImage, info: MapInfo) -> OccupancyArray:
    """Return the occupancies of an image, Shape (rows, columns); row 0 is the last row of the image.

    A grey value v corresponds to the probability p = (255 - v) / 255, or v / 255 if negated. A cell is occupied if p >=
    `occupied_thresh` and free if p <= `free_thresh`; between them it is unknown (trinary), or has the value 100 (p -
    free) / (occupied - free), rounded (scale). Transparent pixels are unknown. In raw mode, grey values 0..100 are
    occupancies, and other values are unknown.
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
