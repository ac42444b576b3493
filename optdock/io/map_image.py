"""Grey values of map images; the header is checked before memory is allocated for the pixels."""

from __future__ import annotations

import io
import struct
import warnings
import zlib
from typing import TYPE_CHECKING, BinaryIO, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from optdock.errors import InvalidFile
from optdock.geometry.arrays import readonly
from optdock.io.guarded_file import MostBytes, read_bytes
from optdock.io.quoting import shortened

if TYPE_CHECKING:
    from pathlib import Path

    from PIL.Image import Image
    from PIL.ImageFile import ImageFile

    from optdock.geometry.arrays import BoolArray

__all__ = ["MAX_PIXELS", "GreyImage", "load_grey_image"]

GreyArray: TypeAlias = NDArray[np.uint8]

MAX_PIXELS = 25_000_000  # 5000 x 5000 cells, 250 m x 250 m at 5 cm; less than a second and 400 MB in any format
_MAX_PLAIN_PIXELS = 2_000_000  # 0.3 us each
_BAND = 256  # rows converted at a time; colours take four times the memory of grey values

# Other formats of Pillow may call external programs.
_FORMATS = ("BMP", "GIF", "JPEG", "PNG", "PPM", "TIFF")
_DEEP_MODES = ("I", "I;16", "I;16B", "I;16L", "I;16N")
_FROM_DEEP = readonly(((np.arange(65536) * 510 + 65535) // (2 * 65535)).astype(np.uint8))
# Raised by Pillow's decoders for damaged files.
_DAMAGE = (OSError, SyntaxError, ValueError, EOFError, OverflowError, IndexError, TypeError, struct.error, zlib.error)


class GreyImage(NamedTuple):
    """Grey values of an image, read as map_server reads them.

    Attributes:
        grey: Shape (height, width), 0 black to 255 white; row 0 is the top.
        transparent: Shape (height, width), where alpha is below 255; None without an alpha channel.
        maxval: Largest possible value of the file, 255 for 8 bit; `grey` is scaled to 0..255.
    """

    grey: GreyArray
    transparent: BoolArray | None = None
    maxval: int = 255


def load_grey_image(path: Path) -> GreyImage:
    """Read an image of at most `MAX_PIXELS` pixels; colours are converted to luma (ITU-R BT.601).

    Raises:
        InvalidFile: If the file is missing, not an image, damaged, truncated, empty or too large.
    """
    return _read(path, io.BytesIO(read_bytes(path, MostBytes.IMAGE)))


def _read(path: Path, stream: BinaryIO) -> GreyImage:
    from PIL import Image, UnidentifiedImageError

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # `_check_size` limits the size; damage raises an error or is harmless
            image = Image.open(stream, formats=_FORMATS)
            _check_size(path, image.width, image.height)
            maxval = _largest_value(image, stream)
            return _grey_of(path, image, maxval)
    except UnidentifiedImageError as error:
        raise InvalidFile(f"{path}: is not an image that can be read (PGM, PNG, BMP, ...)") from error
    except Image.DecompressionBombError as error:
        raise InvalidFile(f"{path}: more than the {MAX_PIXELS} pixels allowed; crop the map") from error
    except _DAMAGE as error:
        raise InvalidFile(f"{path}: is damaged or truncated: {shortened(str(error))}") from error


def _check_size(path: Path, width: int, height: int) -> None:
    if width < 1 or height < 1:
        raise InvalidFile(f"{path}: the image has no pixel: {width} x {height}")
    if width * height > MAX_PIXELS:
        raise InvalidFile(f"{path}: {width} x {height} pixels are more than the {MAX_PIXELS} allowed; crop the map")


def _largest_value(image: ImageFile, stream: BinaryIO) -> int:
    """Return the largest possible value in the file, which in a PGM may differ from 255 and 65535.

    Pillow rejects larger values in a plain PGM but reads larger values in a raw PGM as white. This function therefore
    checks the values of a raw PGM.
    """
    codec, _, offset, arguments = image.tile[0] if image.tile else ("", None, 0, ())
    if codec == "ppm_plain" and image.width * image.height > _MAX_PLAIN_PIXELS:
        raise ValueError(f"an ASCII PGM may have at most {_MAX_PLAIN_PIXELS} pixels; save it as a binary PGM or as PNG")
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
    if image.mode == "F":
        raise InvalidFile(f"{path}: floating-point images are not maps; save it with 8 bit")
    has_alpha = image.mode in ("LA", "La", "PA", "RGBA", "RGBa") or "transparency" in image.info
    has_alpha = has_alpha and image.mode not in _DEEP_MODES
    grey = np.empty((image.height, image.width), dtype=np.uint8)
    transparent = np.empty(grey.shape, dtype=np.bool_) if has_alpha else None
    for top in range(0, image.height, _BAND):
        rows = slice(top, min(top + _BAND, image.height))
        part = image.crop((0, rows.start, image.width, rows.stop))
        if image.mode in _DEEP_MODES:
            grey[rows] = _FROM_DEEP[np.clip(np.asarray(part), 0, 65535).astype(np.uint16)]
        elif transparent is None:
            grey[rows] = np.asarray(part.convert("L"))
        else:
            colours = part.convert("RGBA")
            transparent[rows] = np.asarray(colours.getchannel("A")) < 255
            grey[rows] = np.asarray(colours.convert("L"))
    return GreyImage(grey, transparent, maxval)
