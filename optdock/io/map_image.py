"""Grey values of map images: plain and raw PGM by an own reader, everything else by Pillow.

The header is judged before any memory is taken for the pixels, so a small file cannot claim a huge map.
"""

from __future__ import annotations

import re
import struct
import warnings
import zlib
from typing import TYPE_CHECKING, BinaryIO, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from optdock.errors import InvalidFile

if TYPE_CHECKING:
    from pathlib import Path

    from PIL.Image import Image

    from optdock.geometry.arrays import BoolArray

__all__ = ["MAX_PIXELS", "GreyImage", "load_grey_image"]

GreyArray: TypeAlias = NDArray[np.uint8]

MAX_PIXELS = 2**27  # 11585 x 11585 cells, 579 m x 579 m at 5 cm

_SPACE = rb"(?:[ \t\r\n\v\f]|#[^\r\n]*[\r\n])+"
_PGM_HEADER = re.compile(
    rb"P([25])" + _SPACE + rb"(\d{1,18})" + _SPACE + rb"(\d{1,18})" + _SPACE + rb"(\d{1,18})(?:#[^\r\n]*)?[ \t\r\n\v\f]"
)
_PGM_HEADER_BYTES = 65536
_DEEP_MODES = ("I", "I;16", "I;16B", "I;16L", "I;16N")


class GreyImage(NamedTuple):
    """An image as map_server sees it.

    Attributes:
        grey: Shape (height, width), 0 black to 255 white; row 0 is the top.
        transparent: Shape (height, width), where alpha is below full; None without an alpha channel.
        maxval: Largest value that the file can hold, 255 for 8 bit; other scales have been brought to 0..255.
    """

    grey: GreyArray
    transparent: BoolArray | None = None
    maxval: int = 255


def load_grey_image(path: Path) -> GreyImage:
    """Read an image of at most `MAX_PIXELS` pixels; colours become their luma (ITU-R BT.601).

    Raises:
        InvalidFile: Missing, not an image, damaged, cut short, empty or too large.
    """
    try:
        with path.open("rb") as stream:
            head = stream.read(_PGM_HEADER_BYTES)
            stream.seek(0)
            is_pgm = head[:2] in (b"P2", b"P5")
            return _read_pgm(path, stream, head) if is_pgm else _read_by_pillow(path, stream)
    except OSError as error:
        raise InvalidFile(f"{path}: cannot be read: {error.strerror or error}") from error
    except ValueError as error:  # a path with a zero byte
        raise InvalidFile(f"{path}: cannot be read: {error}") from error


def _check_size(path: Path, width: int, height: int) -> None:
    if width < 1 or height < 1:
        raise InvalidFile(f"{path}: the image has no pixel: {width} x {height}")
    if width * height > MAX_PIXELS:
        raise InvalidFile(f"{path}: {width} x {height} pixels are more than the {MAX_PIXELS} allowed; crop the map")


def _read_pgm(path: Path, stream: BinaryIO, head: bytes) -> GreyImage:
    header = _PGM_HEADER.match(head)
    if header is None:
        raise InvalidFile(f"{path}: the PGM header must hold width, height and largest grey value")
    is_plain = header[1] == b"2"
    width, height, maxval = (int(header[n]) for n in (2, 3, 4))
    _check_size(path, width, height)
    if not 1 <= maxval <= 65535:
        raise InvalidFile(f"{path}: the PGM's largest grey value must be in 1..65535, got {maxval}")
    stream.seek(header.end())
    count = width * height
    values = _plain_values(path, stream, count) if is_plain else _raw_values(stream, count, maxval)
    if values.size < count:
        raise InvalidFile(f"{path}: is cut short: {width} x {height} = {count} pixels announced, {values.size} found")
    if values.min() < 0 or values.max() > maxval:
        raise InvalidFile(f"{path}: grey values must be in 0..{maxval}, got {values.min()}..{values.max()}")
    return GreyImage(_to_8_bit(values.reshape(height, width), maxval), None, maxval)


def _plain_values(path: Path, stream: BinaryIO, count: int) -> NDArray[np.int64]:
    words = re.sub(rb"#[^\r\n]*", b"", stream.read()).split(None, count)[:count]
    try:
        return np.array([int(word) for word in words], dtype=np.int64)
    except (ValueError, OverflowError) as error:
        raise InvalidFile(f"{path}: a plain PGM holds whole numbers only: {error}") from error


def _raw_values(stream: BinaryIO, count: int, maxval: int) -> NDArray[np.int64] | NDArray[np.uint8]:
    kind = np.dtype(np.uint8 if maxval < 256 else ">u2")
    content = stream.read(count * kind.itemsize)
    values = np.frombuffer(content, kind, len(content) // kind.itemsize)
    return values.astype(np.int64) if kind.itemsize > 1 else values.astype(np.uint8)


def _to_8_bit(values: NDArray[np.int64] | NDArray[np.uint8], maxval: int) -> GreyArray:
    """Grey values brought from 0..maxval to the nearest in 0..255."""
    if maxval == 255:
        return values.astype(np.uint8)
    scaled: GreyArray = ((values.astype(np.int64) * 510 + maxval) // (2 * maxval)).astype(np.uint8)
    return scaled


def _read_by_pillow(path: Path, stream: BinaryIO) -> GreyImage:
    from PIL import Image, UnidentifiedImageError

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # `_check_size` is the limit; damage is an error or does not matter
            image = Image.open(stream)
            _check_size(path, image.width, image.height)
            return _grey_of(path, image)
    except UnidentifiedImageError as error:
        raise InvalidFile(f"{path}: is not an image that can be read (PGM, PNG, BMP, ...)") from error
    except Image.DecompressionBombError as error:
        raise InvalidFile(f"{path}: more than the {MAX_PIXELS} pixels allowed; crop the map") from error
    # What Pillow's decoders raise on damaged files.
    except (
        OSError,
        SyntaxError,
        ValueError,
        EOFError,
        OverflowError,
        IndexError,
        TypeError,
        struct.error,
        zlib.error,
    ) as error:
        raise InvalidFile(f"{path}: is damaged or cut short: {error}") from error


def _grey_of(path: Path, image: Image) -> GreyImage:
    if image.mode in _DEEP_MODES:
        return GreyImage(_to_8_bit(np.clip(np.asarray(image).astype(np.int64), 0, 65535), 65535), None, 65535)
    if image.mode == "F":
        raise InvalidFile(f"{path}: floating-point images are no maps; save it with 8 bit")
    has_alpha = image.mode in ("LA", "La", "PA", "RGBA", "RGBa") or "transparency" in image.info
    if not has_alpha:
        return GreyImage(np.array(image.convert("L"), dtype=np.uint8))
    colours = image.convert("RGBA")
    transparent: BoolArray = np.asarray(colours.getchannel("A")) < 255
    return GreyImage(np.array(colours.convert("L"), dtype=np.uint8), transparent)
