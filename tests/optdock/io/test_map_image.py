import contextlib
import io
import struct
import zlib

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from optdock.errors import InvalidFile
from optdock.io.map_image import MAX_PIXELS, load_grey_image

GREY = np.array([[0, 100, 205], [254, 255, 7]], dtype=np.uint8)


@pytest.fixture
def image(tmp_path):
    def load(content, name="map.pgm"):
        path = tmp_path / name
        path.write_bytes(content)
        return load_grey_image(path)

    return load


def png(array, mode=None, **options):
    stream = io.BytesIO()
    (Image.fromarray(array) if mode is None else Image.fromarray(array).convert(mode)).save(stream, "PNG", **options)
    return stream.getvalue()


def test_raw_pgm(image):
    assert image(b"P5\n3 2\n255\n" + GREY.tobytes()).grey.tolist() == GREY.tolist()


def test_raw_pgm_with_comments_anywhere_in_the_header(image):
    head = b"P5 # made by hand\n# second\n3 # width\n\t2\n#x#y\n255\n"
    assert image(head + GREY.tobytes()).grey.tolist() == GREY.tolist()


def test_the_first_pixel_may_look_like_white_space_or_a_comment(image):
    grey = np.array([[10, 35, 32]], dtype=np.uint8)
    assert image(b"P5 3 1 255\n" + grey.tobytes()).grey.tolist() == grey.tolist()


def test_plain_pgm(image):
    assert image(b"P2\n# c\n3 2\n255\n0 100 205 # row\n254\n255 7\n").grey.tolist() == GREY.tolist()


def test_sixteen_bit_pgm_is_big_endian_and_scaled_to_eight(image):
    values = np.array([[0, 257 * 100, 65535]], dtype=">u2")
    loaded = image(b"P5 3 1 65535\n" + values.tobytes())
    assert loaded.grey.tolist() == [[0, 100, 255]]
    assert loaded.maxval == 65535


@given(st.integers(1, 65535), st.data())
def test_other_largest_values_scale_to_the_nearest_grey(tmp_path_factory, maxval, data):
    values = data.draw(st.lists(st.integers(0, maxval), min_size=1, max_size=5))
    path = tmp_path_factory.mktemp("pgm") / "map.pgm"
    path.write_text(f"P2 {len(values)} 1 {maxval}\n{' '.join(map(str, values))}")
    grey = load_grey_image(path).grey[0]
    assert np.all(np.abs(grey - np.array(values) * 255 / maxval) <= 0.502)  # beyond 255 by way of 16 bit


def test_png_and_pgm_agree(image):
    assert image(png(GREY), "map.png").grey.tolist() == GREY.tolist()


def test_sixteen_bit_png_is_scaled(image):
    loaded = image(png(np.array([[0, 257 * 100, 65535]], dtype=np.uint16)), "map.png")
    assert loaded.grey.tolist() == [[0, 100, 255]]
    assert loaded.maxval == 65535


def test_one_bit_png(image):
    assert image(png(GREY > 127, "1"), "map.png").grey.tolist() == [[0, 0, 255], [255, 255, 0]]


def test_colours_become_their_luma(image):
    rgb = np.array([[[255, 0, 0], [0, 255, 0], [0, 0, 255]]], dtype=np.uint8)
    assert image(png(rgb), "map.png").grey.tolist() == [[76, 150, 29]]


@pytest.mark.parametrize("mode", ["RGBA", "LA"])
def test_alpha_below_full_is_transparent(image, mode):
    rgba = np.array([[[9, 9, 9, 255], [9, 9, 9, 254], [9, 9, 9, 0]]], dtype=np.uint8)
    loaded = image(png(rgba, mode), "map.png")
    assert loaded.transparent.tolist() == [[False, True, True]]
    assert loaded.grey.tolist() == [[9, 9, 9]]


def test_a_transparent_colour_counts_as_alpha(image):
    loaded = image(png(GREY, transparency=205), "map.png")
    assert loaded.transparent.tolist() == [[False, False, True], [False, False, False]]


def png_header(width, height):
    chunks = b""
    for kind, content in (
        (b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)),
        (b"IDAT", zlib.compress(b"0")),
    ):
        chunks += struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))
    return b"\x89PNG\r\n\x1a\n" + chunks


@pytest.mark.parametrize(
    "content",
    [
        b"P5 100000 100000 255\n",
        b"P2 11586 11586 255\n",
        b"P6 100000 100000 255\n",
        png_header(12000, 12000),
        png_header(2**31 - 1, 2**31 - 1),
    ],
)
def test_huge_headers_are_refused_before_anything_is_allocated(image, content):
    with pytest.raises(InvalidFile, match=str(MAX_PIXELS)):
        image(content)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"P5 3 2 255\n" + GREY.tobytes()[:-1], "truncated"),
        (b"P5 3 1 65535\n12345", "truncated"),
        (b"P5 3 1 100\n12", "truncated"),
        (b"P2 3 2 255\n1 2 3", "truncated"),
        (b"P5 0 2 255\n", "not an image"),
        (b"P5 3 2 0\n", "maxval must be greater than 0"),
        (b"P5 3 2 65536\n", "less than 65536"),
        (b"P5 -3 2 255\n", "not an image"),
        (b"P5", "reading header"),
        (b"P5 999999999999999999 999999999999999999 255\n", "file header"),
        (b"P5 3 2 255", "truncated"),
        (b"P2 1 1 255\nx", "truncated: .*b'x'"),
        (b"P2 1 1 255\n1.5", "truncated: .*b'1.5'"),
        (b"P2 1 1 255\n" + b"9" * 30, "too long"),
        (b"P2 2 1 255\n1 256", "too large.*: 256"),
        (b"P2 1 1 255\n-1", "negative: -1"),
        (b"P5 1 1 100\n\xff", r"0\.\.100, got 255"),
        (b"P5 2 1 1000\n\x00\x01\x03\xe9", r"0\.\.1000, got 1001"),
        (b"not an image", "not an image"),
        (b"", "not an image"),
        (png(np.random.default_rng(0).integers(0, 255, (50, 50), dtype=np.uint8))[:1500], "damaged or truncated"),
    ],
)
def test_bad_images_are_named(image, content, message):
    with pytest.raises(InvalidFile, match=message) as error:
        image(content)
    assert "map.pgm" in str(error.value)


def test_hash_signs_without_end_do_not_hang(image):
    with pytest.raises(InvalidFile, match="reading header"):
        image(b"P5 " + b"#" * 60000)


def test_a_floating_point_image_is_refused(image):
    stream = io.BytesIO()
    Image.fromarray(np.zeros((2, 2), dtype=np.float32)).save(stream, "TIFF")
    with pytest.raises(InvalidFile, match="floating-point"):
        image(stream.getvalue(), "map.tif")


def test_missing_images_and_folders_are_named(tmp_path):
    with pytest.raises(InvalidFile, match=r"none\.pgm: cannot be read: No such file"):
        load_grey_image(tmp_path / "none.pgm")
    with pytest.raises(InvalidFile, match="cannot be read"):
        load_grey_image(tmp_path)


@given(st.integers(0, 10**6), st.integers(0, 255), st.booleans())
def test_no_damaged_png_escapes_as_another_error(tmp_path_factory, place, value, cut):
    content = bytearray(png(np.arange(256, dtype=np.uint8).reshape(16, 16)))
    content[place % len(content)] = value
    path = tmp_path_factory.mktemp("png") / "map.png"
    path.write_bytes(content[: place % len(content)] if cut else content)
    with contextlib.suppress(InvalidFile):
        assert load_grey_image(path).grey.ndim == 2
