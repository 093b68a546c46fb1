"""Stored images: every encoding of one image gives that image, and damage is told."""

import struct
from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from tum_folder import png
from vlmm_log import rvl
from vlmm_log.readers import compressed_depth
from vlmm_log.readers.images import ImageError, decode_depth, decode_rgb, depth_values, media_type
from vlmm_log.readers.stored import StoredImage

RNG = np.random.default_rng(5)
RGB = RNG.integers(0, 256, (34, 46, 3), np.uint8)
DEPTH = RNG.integers(0, 2**16, (34, 46), np.uint16)
DEPTH[RNG.random(DEPTH.shape) < 0.3] = 0
METRES = (DEPTH / 5000).astype(np.float32)
PADDING = 5  # bytes at the end of each row, an odd number


def bare(pixels, encoding, big_endian=False):
    """The message of ``pixels``, with padded rows."""
    height, width = pixels.shape[:2]
    rows = pixels.astype(pixels.dtype.newbyteorder(">" if big_endian else "<")).reshape(height, -1).view(np.uint8)
    rows = np.pad(rows, ((0, 0), (0, PADDING)), constant_values=77)
    return StoredImage(rows.tobytes(), encoding, height, width, rows.shape[1], big_endian)


def wide(pixels):
    """16 bits a number, whose upper 8 are those given."""
    return (pixels.astype(np.uint16) << 8) | RNG.integers(0, 256, pixels.shape, np.uint16)


def with_alpha(pixels):
    return np.dstack([pixels, RNG.integers(0, 256, pixels.shape[:2], np.uint8)])


def file(image, kind=".png"):
    return StoredImage(cv2.imencode(kind, image)[1].tobytes())


# ---- colour

GREY = RGB[..., 0]
BGR = RGB[..., ::-1]
COLOURS = {
    "rgb8": RGB,
    "bgr8": BGR,
    "rgba8": with_alpha(RGB),
    "bgra8": with_alpha(BGR),
    "8UC3": BGR,
    "8UC4": with_alpha(BGR),
    "rgb16": wide(RGB),
    "bgr16": wide(BGR),
    "rgba16": wide(with_alpha(RGB)),
    "bgra16": wide(with_alpha(BGR)),
}


@pytest.mark.parametrize("big_endian", [False, True])
@pytest.mark.parametrize("encoding", COLOURS)
def test_colour_of_any_order_and_depth(encoding, big_endian):
    image = bare(COLOURS[encoding], encoding, big_endian)
    for data in (image.data, memoryview(image.data), image.data + b"more"):
        assert np.array_equal(decode_rgb(replace(image, data=data)), RGB)


@pytest.mark.parametrize("image", [bare(GREY, "mono8"), bare(GREY, "8UC1"), bare(wide(GREY), "mono16"), file(GREY)])
def test_grey_is_equal_in_all_channels(image):
    assert np.array_equal(decode_rgb(image), np.dstack([GREY] * 3))


def test_encoded_files_are_known_by_their_bytes():
    assert np.array_equal(decode_rgb(file(BGR)), RGB)
    smooth = cv2.GaussianBlur(RGB, (0, 0), 4)
    for kind in (".jpg", ".webp"):
        assert np.abs(decode_rgb(file(smooth[..., ::-1], kind)).astype(int) - smooth).mean() < 5
    assert [media_type(file(BGR, k).data) for k in (".png", ".jpg", ".webp")] == ["image/png", "image/jpeg", None]


@pytest.mark.parametrize("bits", [8, 16])
@pytest.mark.parametrize("pattern", ["rggb", "bggr", "gbrg", "grbg"])
def test_bayer_patterns_are_named_by_their_first_pixels(pattern, bits):
    colour = {"r": 200, "g": 120, "b": 40}
    mosaic = np.tile(np.array([colour[c] for c in pattern], np.uint8).reshape(2, 2), (20, 24))
    image = bare(mosaic if bits == 8 else wide(mosaic), f"bayer_{pattern}{bits}", big_endian=bits == 16)
    assert np.array_equal(decode_rgb(image), np.full((40, 48, 3), (200, 120, 40)))


@pytest.mark.parametrize(
    ("encodings", "order"), [(("yuv422", "uyvy"), (1, 0, 2, 0)), (("yuv422_yuy2", "yuyv"), (0, 1, 0, 2))]
)
def test_yuv_in_both_orders(encodings, order):
    for yuv, rgb in (((81, 90, 240), (255, 0, 0)), ((41, 240, 110), (0, 0, 255)), ((126, 128, 128), (128, 128, 128))):
        pixels = np.tile(np.array([yuv[i] for i in order], np.uint8).reshape(1, 2, 2), (40, 24, 1))  # of ITU-R BT.601
        for encoding in encodings:
            assert np.abs(decode_rgb(bare(pixels, encoding)).astype(int) - rgb).max() <= 2


ROWS = bare(RGB, "rgb8")


@pytest.mark.parametrize(
    ("image", "reason"),
    [
        (replace(ROWS, data=ROWS.data[:-1]), "image data is shorter than its height and step say"),
        (replace(ROWS, height=35), "image data is shorter than its height and step say"),
        (replace(ROWS, step=3 * 46 - 1), "image rows are longer than its step says"),
        (replace(ROWS, data=b""), "colour image has no data"),
        (replace(ROWS, width=0), "colour image is smaller than 32 px"),
        (replace(ROWS, height=31), "colour image is smaller than 32 px"),
        (replace(ROWS, width=45, encoding="uyvy"), "colour image in YUV 4:2:2 has an odd width"),
        (replace(ROWS, encoding="32FC1"), "encoding '32FC1' is not one that colour is read from"),
        (replace(ROWS, encoding="\x1b[2J"), r"encoding '\x1b[2J' is not one that colour is read from"),
        (file(BGR[:31]), "colour image is smaller than 32 px"),
        (StoredImage(b""), "colour image cannot be decoded"),
        (StoredImage(b"no image"), "colour image cannot be decoded"),
    ],
)
def test_colour_that_cannot_be_used(image, reason):
    with pytest.raises(ImageError) as e:
        decode_rgb(image)
    assert str(e.value) == reason


# ---- depth


def message(values, form, encoding="16UC1"):
    return StoredImage(compressed_depth.encode(values, form), f"{encoding}; compressedDepth {form}")


STORED = {
    "PNG": file(DEPTH),
    "16UC1": bare(DEPTH, "16UC1"),
    "big-endian": bare(DEPTH, "16UC1", big_endian=True),
    "mono16": bare(DEPTH, "mono16"),
    "compressedDepth": message(DEPTH, "png"),
    "of no form": replace(message(DEPTH, "png"), encoding="16UC1; compressedDepth"),
    "without header": replace(file(DEPTH), encoding="16UC1; compressedDepth png"),
    "RVL": message(DEPTH, "rvl"),
    "RVL, mono16": message(DEPTH, "rvl", "mono16"),
}


@pytest.mark.parametrize("name", STORED)
def test_depth_in_integers(name):
    image = STORED[name]
    for data in (image.data, memoryview(image.data)):
        values = depth_values(replace(image, data=data))
        assert values.dtype == np.uint16
        assert np.array_equal(values, DEPTH)


@pytest.mark.parametrize("big_endian", [False, True])
@pytest.mark.parametrize(("encoding", "kind"), [("32FC1", np.float32), ("64FC1", np.float64)])
def test_depth_in_floats(encoding, kind, big_endian):
    values = depth_values(bare(METRES.astype(kind), encoding, big_endian))
    assert values.dtype == np.float32
    assert np.array_equal(values, METRES)


def test_one_depth_has_equal_bits_however_it_is_stored():
    mm = np.resize(np.arange(13108, dtype=np.uint16), (128, 103))  # 5 of each, 5000 per metre, still fit 16 bits
    of_mm = decode_depth(bare(mm, "16UC1"), 1000, 0.1, 10)
    of_fifths = decode_depth(bare(mm * np.uint16(5), "16UC1"), 5000, 0.1, 10)
    of_metres = decode_depth(bare(mm / 1000, "64FC1"), 1, 0.1, 10)
    exact = np.where((mm >= 100) & (mm <= 10_000), mm / 1000, np.nan).astype(np.float32)
    for depth in (of_mm, of_fifths, of_metres):
        assert depth.dtype == np.float32
        assert np.array_equal(depth, exact, equal_nan=True)


@given(st.integers(0, 70_000), st.integers(0, 70_000), st.sampled_from([1, 250, 1000, 5000]))
def test_the_range_holds_its_ends_and_never_zero(a, b, units):
    low, high = sorted((a, b))
    values = np.unique(np.clip([0, 1, low - 1, low, low + 1, high - 1, high, high + 1, 65535], 0, 65535))
    row = np.resize(values, 32).astype(np.uint16)
    pixels = np.tile(row, (32, 1))
    inside = (row >= low) & (row <= high) & (row > 0)
    for image, per_meter in ((bare(pixels, "16UC1"), units), (bare(pixels / units, "64FC1"), 1)):
        depth = decode_depth(image, per_meter, low / units, high / units)
        assert np.array_equal(np.isfinite(depth[0]), inside)
        assert np.isnan(depth[0][~inside]).all()


@pytest.mark.parametrize("encoding", ["32FC1", "64FC1"])
def test_what_is_no_depth_is_unseen_in_any_range(encoding):
    kind = np.float32 if encoding == "32FC1" else np.float64
    odd = [np.nan, np.inf, -np.inf, 0, -0.0, -1, np.finfo(kind).max, 6e8, 1e-10, 3]
    depth = decode_depth(bare(np.tile(np.array(odd, kind), (32, 4)), encoding), 0.5, 0, np.inf)
    assert np.array_equal(depth[0, :10], [np.nan] * 9 + [6], equal_nan=True)


@pytest.mark.parametrize(
    ("image", "reason"),
    [
        (file(GREY), "depth image is 8-bit; 16-bit PNG is expected"),
        (file(GREY, ".jpg"), "depth image is 8-bit; 16-bit PNG is expected"),
        (file(BGR), "depth image has 3 channels; one is expected"),
        (file(DEPTH[:31]), "depth image is smaller than 32 px"),
        (message(DEPTH[:31], "rvl"), "depth image is smaller than 32 px"),
        (StoredImage(b""), "depth image cannot be decoded"),
        (replace(bare(DEPTH, "16UC1"), data=b""), "depth image has no data"),
        (bare(GREY, "8UC1"), "depth image has encoding '8UC1'; 16UC1 or 32FC1 is expected"),
        (bare(RGB, "rgb8"), "depth image has encoding 'rgb8'; 16UC1 or 32FC1 is expected"),
        (bare(DEPTH, "bayer_rggb16"), "depth image has encoding 'bayer_rggb16'; 16UC1 or 32FC1 is expected"),
        (message(DEPTH, "png", "8UC1"), "compressedDepth image is of neither 16UC1 nor 32FC1"),
        (replace(STORED["RVL"], encoding="16UC1; compressedDepth zip"), "compressedDepth image is neither PNG nor RVL"),
        (replace(STORED["RVL"], data=STORED["RVL"].data[:12]), "compressedDepth image ends within its header"),
        (replace(STORED["RVL"], data=STORED["RVL"].data[:20]), "RVL image ends within its header"),
        (replace(STORED["RVL"], data=STORED["RVL"].data[:-4]), "RVL data are damaged"),
        (replace(STORED["RVL"], data=b"\0" * 12 + b"\xff\xff\xff\x7f" * 3), "RVL image has a damaged size"),
        (
            replace(STORED["without header"], encoding="32FC1; compressedDepth png"),
            "compressedDepth image of 32FC1 lacks the header that gives its scale",
        ),
        (message(DEPTH, "png", "32FC1"), "compressedDepth image has a damaged header"),  # A is 0
    ],
)
def test_depth_that_cannot_be_used(image, reason):
    with pytest.raises(ImageError) as e:
        depth_values(image)
    assert str(e.value) == reason


# ---- compressedDepth and RVL


@pytest.mark.parametrize("form", ["png", "rvl"])
def test_floats_are_quantised_inverse_depth(form):
    A, B = 100 * 101.0, 1 - 100 * 101 / 10.0  # depth_quantization 100, depth_max 10 m
    z = RNG.uniform(0.2, 9.9, (34, 46))
    v = (A / z + B).astype(np.uint16)
    v[3, 4] = 0
    image = message(v, form, "32FC1")
    depth = depth_values(replace(image, data=struct.pack("<iff", 0, A, B) + image.data[12:]))
    assert depth.dtype == np.float32
    assert np.argwhere(np.isnan(depth)).tolist() == [[3, 4]]
    seen = v > 0
    assert np.all(np.abs(1 / depth - 1 / z)[seen] <= 1.01 / A)


def test_only_what_loses_nothing_is_encoded():
    for values in (METRES, GREY, DEPTH[None]):
        with pytest.raises(ValueError, match="compressedDepth without loss takes uint16"):
            compressed_depth.encode(values, "png")


def test_the_png_of_a_message():
    data = png(DEPTH)
    for image in (data, bytes(12) + data, memoryview(bytes(12) + data)):
        assert compressed_depth.png_of(image) == data
    assert compressed_depth.png_of(STORED["RVL"].data) is None


@pytest.mark.parametrize(
    ("values", "nibbles"),
    [
        ([], ""),
        ([0, 0, 5, 6, 4], "2 3 A1 2 3 00"),  # 2 zeros, 3 others: +5 is 10, +1 is 2, -2 is 3
        ([65535, 0], "0 1 EFFFF3 1 0 000000"),  # +65535 is 131070, octal 377776
        ([0] * 9, "91 0 00000"),
        ([7, 0, 6], "0 1 E1 1 1 1 0"),  # the difference reaches over zeros: -1 is 1
    ],
)
def test_rvl_is_the_papers(values, nibbles):
    words = bytes.fromhex(nibbles.replace(" ", ""))
    data = b"".join(words[i : i + 4][::-1] for i in range(0, len(words), 4))
    assert rvl.encode(np.array(values, np.uint16)) == data
    assert rvl.decode(data, len(values)).tolist() == values


runs = st.lists(st.tuples(st.sampled_from([0, 1, 8, 32767, 65535]) | st.integers(0, 65535), st.integers(1, 600)))


@given(arrays(np.uint16, st.integers(0, 80)) | runs.map(lambda r: np.repeat(*np.array([(0, 0), *r], int).T)))
@example(np.zeros(640 * 480))
@example(np.tile([65535, 1], 5000))
@example(np.tile([65535, 0, 1], 5000))
def test_rvl_loses_nothing(values):
    values = values.astype(np.uint16)
    data = rvl.encode(values)
    assert len(data) <= 4 * values.size
    assert np.array_equal(rvl.decode(data, values.size), values)
    assert np.array_equal(rvl.decode(data + b"more", values.size), values)


def test_rvl_of_a_signed_encoder():
    data = bytes.fromhex("01FFDBC1")[::-1]  # 40000 is -25536 to it, which is 51071, octal 143577
    assert rvl.decode(data, 1).tolist() == [40000]


@pytest.mark.parametrize("values", [[0] * 20, [9] * 20, [0, 0, 9, 9, 9, 0, 0, 0, 9]])
def test_rvl_longer_than_its_image_ends_within_it(values):
    data = rvl.encode(np.array(values, np.uint16))
    for pixels in range(1, 8):
        memory = np.full(40, 1234, np.uint16)
        assert rvl._decode(np.frombuffer(data, "<u4").astype(np.uint32), memory[:pixels]) <= pixels
        assert np.all(memory[pixels:] == 1234)
    with pytest.raises(ValueError, match="RVL data are damaged"):
        rvl.decode(data, 1)


# ---- damage

FORMATS = [f"{pixels}; compressedDepth {form}" for pixels in ("16UC1", "32FC1") for form in ("png", "rvl")]
ENCODINGS = ["", "rgb8", "bgra16", "mono8", "bayer_gbrg16", "yuyv", "16UC1", "64FC1", "other", *FORMATS]
WHOLE = [*STORED.values(), file(BGR), file(BGR, ".jpg"), file(BGR, ".webp"), bare(METRES, "32FC1"), ROWS]
any_image = st.builds(
    StoredImage,
    st.binary(max_size=200) | st.builds(lambda unit: unit * 700, st.binary(min_size=8, max_size=8)),
    st.sampled_from(ENCODINGS),
    st.integers(0, 40),
    st.integers(0, 40),
    st.integers(0, 200),
    st.booleans(),
)


@st.composite
def damaged(draw):
    """A good message, cut short, with a few bits turned."""
    image = draw(st.sampled_from(WHOLE))
    data = bytearray(image.data[: draw(st.none() | st.integers(0, len(image.data)))])
    near = st.integers(0, 60) | st.integers(0, 10_000)  # headers are worth more attempts
    for place, bit in draw(st.lists(st.tuples(near, st.integers(0, 7)), max_size=4)):
        if data:
            data[place % len(data)] ^= 1 << bit
    return replace(image, data=bytes(data))


@given(any_image | damaged())
def test_damage_is_told_and_never_worse(image):
    for decode in (decode_rgb, lambda i: decode_depth(i, 1000, 0.1, 10)):
        try:
            out = decode(image)
        except ImageError as e:
            assert str(e)
        else:
            assert out.dtype == (np.uint8 if decode is decode_rgb else np.float32)
            assert out.ndim == (3 if decode is decode_rgb else 2)
            assert min(out.shape[:2]) >= 32
