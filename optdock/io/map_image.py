"""Grey values of map images, by Pillow; the header is judged before any memory is taken for the pixels."""

from __future__ import annotations

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
    from PIL.ImageFile import ImageFile

    from optdock.geometry.arrays import BoolArray

__all__ = ["MAX_PIXELS", "GreyImage", "load_grey_image"]

GreyArray: TypeAlias = NDArray[np.uint8]

MAX_PIXELS = 2**27  # 11585 x 11585 cells, 579 m x 579 m at 5 cm

_DEEP_MODES = ("I", "I;16", "I;16B", "I;16L", "I;16N")
# What Pillow's decoders raise on damaged files.
_DAMAGE = (OSError, SyntaxError, ValueError, EOFError, OverflowError, IndexError, TypeError, struct.error, zlib.error)


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
            return _read(path, stream)
    except OSError as error:
        raise InvalidFile(f"{path}: cannot be read: {error.strerror or error}") from error
    except ValueError as error:  # a path with a zero byte
        raise InvalidFile(f"{path}: cannot be read: {error}") from error


def _read(path: Path, stream: BinaryIO) -> GreyImage:
    from PIL import Image, UnidentifiedImageError

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # `_check_size` is the limit; damage is an error or does not matter
            image = Image.open(stream)
            _check_size(path, image.width, image.height)
            maxval = _largest_value(image, stream)
            return _grey_of(path, image, maxval)
    except UnidentifiedImageError as error:
        raise InvalidFile(f"{path}: is not an image that can be read (PGM, PNG, BMP, ...)") from error
    except Image.DecompressionBombError as error:
        raise InvalidFile(f"{path}: more than the {MAX_PIXELS} pixels allowed; crop the map") from error
    except _DAMAGE as error:
        raise InvalidFile(f"{path}: is damaged or cut short: {error}") from error


def _check_size(path: Path, width: int, height: int) -> None:
    if width < 1 or height < 1:
        raise InvalidFile(f"{path}: the image has no pixel: {width} x {height}")
    if width * height > MAX_PIXELS:
        raise InvalidFile(f"{path}: {width} x {height} pixels are more than the {MAX_PIXELS} allowed; crop the map")


def _largest_value(image: ImageFile, stream: BinaryIO) -> int:
    """The largest value that the file can hold; a PGM may say another one than 255 or 65535.

    Pillow refuses larger values of a plain PGM, but takes those of a raw one for white: they are looked for here.
    """
    codec, _, offset, arguments = image.tile[0] if image.tile else ("", None, 0, ())
    if codec not in ("ppm", "ppm_plain") or not isinstance(arguments, tuple):
        return 65535 if image.mode in _DEEP_MODES else 255
    maxval = int(arguments[1])
    if codec == "ppm":
        place = stream.tell()
        stream.seek(offset)
        values = np.frombuffer(stream.read(), np.dtype(np.uint8 if maxval < 256 else ">u2"))
        stream.seek(place)
        if values[: image.width * image.height].max(initial=0) > maxval:
            raise ValueError(f"grey values must be in 0..{maxval}, got {values.max()}")
    return maxval


def _grey_of(path: Path, image: Image, maxval: int) -> GreyImage:
    if image.mode in _DEEP_MODES:
        deep = np.clip(np.asarray(image).astype(np.int64), 0, 65535)
        return GreyImage(((deep * 510 + 65535) // (2 * 65535)).astype(np.uint8), None, maxval)
    if image.mode == "F":
        raise InvalidFile(f"{path}: floating-point images are no maps; save it with 8 bit")
    has_alpha = image.mode in ("LA", "La", "PA", "RGBA", "RGBa") or "transparency" in image.info
    if not has_alpha:
        return GreyImage(np.array(image.convert("L"), dtype=np.uint8), None, maxval)
    colours = image.convert("RGBA")
    transparent: BoolArray = np.asarray(colours.getchannel("A")) < 255
    return GreyImage(np.array(colours.convert("L"), dtype=np.uint8), transparent, maxval)
