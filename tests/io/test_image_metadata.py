"""What image files say of their pixels is obeyed, or named."""

import io
import struct
import warnings
import zlib

import numpy as np
import OpenEXR
import pytest
from PIL import Image

from diffshadow.io import FileError, ImageWarning, read_visibility, write_visibility

# Of no symmetry. Row 0 is the top row.
TOP = np.array([[0.0, 0.2, 0.4, 0.6], [1.0, 0.8, 0.0, 0.2], [0.4, 1.0, 0.6, 0.8]], np.float32)
LEVELS = np.rint(TOP * 255).astype(np.uint8)
FULL = np.full_like(LEVELS, 255)


def read(path):
    """The image, row 0 the top row, and what was said of it, after the file's name."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        pixels = read_visibility(path)
    assert all(each.category is ImageWarning for each in caught)
    start = f"the image file {path} "
    assert all(str(each.message).startswith(start) for each in caught)
    return pixels[::-1], [str(each.message).removeprefix(start) for each in caught]


# --- PNG ---


def chunk(kind, data):
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def png(samples, depth=8, kind=0, chunks=()):
    """A PNG file of samples (h, w, c) with `depth` bits; `chunks` come before the pixels."""
    samples = np.asarray(samples)
    rows, columns = samples.shape[:2]
    if depth < 8:
        bits = (samples.reshape(rows, -1)[..., None] >> np.arange(depth)[::-1]) & 1
        lines = [np.packbits(row).tobytes() for row in bits.reshape(rows, -1)]
    else:
        lines = [row.astype(">u2" if depth == 16 else "u1").tobytes() for row in samples.reshape(rows, -1)]
    header = struct.pack(">IIBBBBB", columns, rows, depth, kind, 0, 0, 0)
    body = zlib.compress(b"".join(b"\0" + line for line in lines))
    parts = [chunk(b"IHDR", header), *(chunk(*each) for each in chunks), chunk(b"IDAT", body), chunk(b"IEND", b"")]
    return b"\x89PNG\r\n\x1a\n" + b"".join(parts)


def with_chunk(kind, data):
    return png(LEVELS, chunks=[(kind, data)])


def saved(image, **options):
    file = io.BytesIO()
    image.save(file, "PNG", **options)
    return file.getvalue()


def exif(orientation):
    return (
        b"eXIf",
        b"MM\0*\0\0\0\x08\0\x01\x01\x12\0\x03\0\0\0\x01" + struct.pack(">H", orientation) + b"\0\0" + bytes(4),
    )


WORDS = np.rint(TOP * 65535).astype(np.uint16)
# A level that eight bits cannot tell from its neighbours.
WORDS[0, 0] = 130
FINE = WORDS / 65535
GREYS = b"".join(bytes([level] * 3) for level in (0, 51, 102, 153, 204, 255))
NUMBERS = np.rint(TOP * 5).astype(int)
STACKED = lambda *channels: np.stack(channels, axis=-1)
PLAIN = {
    "1 bit": (png(TOP > 0.5, 1), TOP > 0.5),
    "2 bits": (png(np.rint(TOP * 3).astype(int), 2), np.rint(TOP * 3) / 3),
    "4 bits": (png(np.rint(TOP * 15).astype(int), 4), TOP),
    "8 bits": (png(LEVELS), TOP),
    "16 bits": (png(WORDS, 16), FINE),
    "alpha": (png(STACKED(LEVELS, FULL), kind=4), TOP),
    "colour": (png(STACKED(LEVELS, LEVELS, LEVELS), kind=2), TOP),
    "colour and alpha": (png(STACKED(LEVELS, LEVELS, LEVELS, FULL), kind=6), TOP),
    "16 bits and alpha": (png(STACKED(WORDS, np.full_like(WORDS, 65535)), 16, 4), FINE),
    "16 bits of colour": (png(STACKED(WORDS, WORDS, WORDS), 16, 2), FINE),
    "16 bits of colour and alpha": (png(STACKED(WORDS, WORDS, WORDS, np.full_like(WORDS, 65535)), 16, 6), FINE),
    "palette": (png(NUMBERS, 8, 3, [(b"PLTE", GREYS)]), TOP),
    "small palette": (png(NUMBERS, 4, 3, [(b"PLTE", GREYS)]), TOP),
    "linear gamma": (with_chunk(b"gAMA", struct.pack(">I", 100000)), TOP),
    "linear transfer": (with_chunk(b"cICP", b"\x01\x08\0\x01"), TOP),
    "primaries of grey": (with_chunk(b"cHRM", bytes(32)), TOP),
    # Five bits, with zeros or copies of the upper bits below.
    "significant bits, zeros": (
        png(np.rint(TOP * 31).astype(int) << 3, chunks=[(b"sBIT", b"\x05")]),
        np.rint(TOP * 31) / 31,
    ),
    "significant bits, copies": (png(LEVELS, chunks=[(b"sBIT", b"\x05")]), (LEVELS >> 3) / 31),
    "a transparent colour that is not used": (with_chunk(b"tRNS", struct.pack(">H", 7)), TOP),
    "turned": (png(LEVELS[::-1, ::-1], chunks=[exif(3)]), TOP),
    "square pixels": (with_chunk(b"pHYs", struct.pack(">IIB", 2835, 2835, 1)), TOP),
    "one frame": (with_chunk(b"acTL", struct.pack(">II", 1, 0)), TOP),
}
REMARKED = {
    "curve": (with_chunk(b"sRGB", b"\0"), TOP, "has the chunk sRGB; its values are still read as linear"),
    "gamma": (with_chunk(b"gAMA", struct.pack(">I", 45455)), TOP, "has the chunk gAMA, of the exponent 0.45455;"),
    "profile": (
        with_chunk(b"iCCP", b"Display P3\0\0" + zlib.compress(bytes(200))),
        TOP,
        "has the chunk iCCP, the colour profile 'Display P3';",
    ),
    "transfer": (with_chunk(b"cICP", b"\x09\x10\0\x01"), TOP, "has the chunk cICP, of the transfer function 16;"),
    "several that agree": (
        png(LEVELS, chunks=[(b"gAMA", struct.pack(">I", 45455)), (b"sRGB", b"\0"), (b"cHRM", bytes(32))]),
        TOP,
        "has the chunk sRGB;",
    ),
    "alpha": (png(STACKED(LEVELS, np.where(TOP > 0.7, 9, 255)), kind=4), TOP, "has 4 pixels that are transparent"),
    "a transparent grey": (with_chunk(b"tRNS", struct.pack(">H", 51)), TOP, "has 2 pixels that are transparent"),
    "a transparent grey of 2 bits": (
        png(np.rint(TOP * 3).astype(int), 2, chunks=[(b"tRNS", struct.pack(">H", 3))]),
        np.rint(TOP * 3) / 3,
        "has 2 pixels that are transparent",
    ),
    "a transparent colour": (
        png(STACKED(LEVELS, LEVELS, LEVELS), kind=2, chunks=[(b"tRNS", struct.pack(">3H", 0, 0, 0))]),
        TOP,
        "has 2 pixels that are transparent",
    ),
    "a transparent palette": (
        png(NUMBERS, 8, 3, [(b"PLTE", GREYS), (b"tRNS", b"\xff\x80")]),
        TOP,
        "has 2 pixels that are transparent",
    ),
    "red": (
        png(STACKED(LEVELS, 0 * LEVELS, 0 * LEVELS), kind=2),
        TOP / 3,
        "is in colour: its channels differ by up to 1; their mean is read",
    ),
    "wide pixels": (
        with_chunk(b"pHYs", struct.pack(">IIB", 1000, 2000, 1)),
        TOP,
        "has pixels that are 2 times as wide as high (pHYs)",
    ),
    "damaged Exif": (
        with_chunk(b"eXIf", exif(6)[1][:-9]),
        TOP,
        "has Exif data that is damaged; the image is read as up",
    ),
    "on a page": (with_chunk(b"oFFs", struct.pack(">iiB", 7, -5, 0)), TOP, "begins at (7, -5) on its page (oFFs);"),
}


@pytest.mark.parametrize("name", PLAIN)
def test_a_png_of_any_kind_is_read_at_its_depth(name, tmp_path):
    data, expected = PLAIN[name]
    (tmp_path / "a.png").write_bytes(data)
    pixels, said = read(tmp_path / "a.png")
    np.testing.assert_allclose(pixels, expected, atol=1e-6)
    assert said == []


@pytest.mark.parametrize("name", REMARKED)
def test_what_a_png_says_otherwise_of_its_pixels_is_named_once(name, tmp_path):
    data, expected, start = REMARKED[name]
    (tmp_path / "a.png").write_bytes(data)
    pixels, said = read(tmp_path / "a.png")
    np.testing.assert_allclose(pixels, expected, atol=1e-6)
    assert [text.startswith(start) for text in said] == [True], said


def test_an_interlaced_png_is_read_as_any_other(tmp_path):
    levels = np.random.default_rng(0).integers(0, 256, (13, 11)).astype(np.uint8)
    # The passes of Adam7: first row, first column, and the steps between rows and columns.
    passes = [(0, 0, 8, 8), (0, 4, 8, 8), (4, 0, 8, 4), (0, 2, 4, 4), (2, 0, 4, 2), (0, 1, 2, 2), (1, 0, 2, 1)]
    lines = [b"\0" + row.tobytes() for y, x, down, across in passes for row in levels[y::down, x::across] if row.size]
    header = chunk(b"IHDR", struct.pack(">IIBBBBB", 11, 13, 8, 0, 0, 0, 1))
    parts = [header, chunk(b"IDAT", zlib.compress(b"".join(lines))), chunk(b"IEND", b"")]
    (tmp_path / "a.png").write_bytes(b"\x89PNG\r\n\x1a\n" + b"".join(parts))
    np.testing.assert_allclose(read(tmp_path / "a.png")[0], levels / 255, atol=1e-6)


TRANSPOSES = {
    2: Image.Transpose.FLIP_LEFT_RIGHT,
    3: Image.Transpose.ROTATE_180,
    4: Image.Transpose.FLIP_TOP_BOTTOM,
    5: Image.Transpose.TRANSPOSE,
    6: Image.Transpose.ROTATE_270,
    7: Image.Transpose.TRANSVERSE,
    8: Image.Transpose.ROTATE_90,
}


@pytest.mark.parametrize("orientation", range(1, 9))
def test_images_are_turned_as_their_orientation_says(orientation, tmp_path):
    image = Image.fromarray(LEVELS)
    turned = np.asarray(image.transpose(TRANSPOSES[orientation]) if orientation > 1 else image)
    (tmp_path / "a.png").write_bytes(png(LEVELS, chunks=[exif(orientation)]))
    write_exr(tmp_path / "a.exr", {"Orientation": orientation}, Y=TOP)
    for name in ("a.png", "a.exr"):
        pixels, said = read(tmp_path / name)
        np.testing.assert_allclose(pixels, turned / 255, atol=1e-6)
        assert said == []


def test_an_animation_is_refused(tmp_path):
    frames = [Image.fromarray(LEVELS), Image.fromarray(255 - LEVELS)]
    (tmp_path / "a.png").write_bytes(saved(frames[0], save_all=True, append_images=frames[1:]))
    with pytest.raises(FileError, match=r"a\.png is an animation of 2 images; expected one image"):
        read_visibility(tmp_path / "a.png")


# --- OpenEXR ---


def write_exr(path, attributes=None, **channels):
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage, **(attributes or {})}
    with OpenEXR.File(
        header, {name.replace("_", "."): np.ascontiguousarray(each) for name, each in channels.items()}
    ) as exr:
        exr.write(str(path))


def window(x, y, width=4, height=3):
    return np.array([x, y], np.int32), np.array([x + width - 1, y + height - 1], np.int32)


TILES = {"type": OpenEXR.tiledimage, "tiles": OpenEXR.TileDescription()}
HALF = np.full_like(TOP, 0.5)
EXR = {
    "half": ({}, {"Y": TOP.astype(np.float16)}, TOP.astype(np.float16), []),
    "whole numbers": ({}, {"Y": (TOP > 0.5).astype(np.uint32)}, TOP > 0.5, []),
    "from the bottom": ({"lineOrder": OpenEXR.DECREASING_Y}, {"Y": TOP}, TOP, []),
    "tiles": (TILES, {"Y": TOP}, TOP, []),
    "colours": ({}, {"RGB": STACKED(TOP, TOP, TOP)}, TOP, []),
    "opaque": ({}, {"RGBA": STACKED(TOP, TOP, TOP, 0 * TOP + 1)}, TOP, []),
    "one channel of any name": ({}, {"shadow": TOP}, TOP, []),
    "one layer": ({}, {"shadow_R": TOP, "shadow_G": TOP, "shadow_B": TOP}, TOP, []),
    "alpha alone": ({}, {"A": TOP}, TOP, []),
    "windows apart from zero": ({"dataWindow": window(7, -5), "displayWindow": window(7, -5)}, {"Y": TOP}, TOP, []),
    "more than is shown": (
        {"dataWindow": window(-1, -2), "displayWindow": window(0, 0, 2, 1)},
        {"Y": TOP},
        TOP[2:, 1:3],
        [],
    ),
    "red": ({}, {"RGB": STACKED(TOP, 0 * TOP, 0 * TOP)}, TOP / 3, ["is in colour: its channels differ by up to 1;"]),
    "alpha": ({}, {"Y": TOP / 2, "A": HALF}, TOP, ["has 12 pixels that are transparent"]),
    "alpha of zero": ({}, {"Y": TOP, "A": 0 * TOP}, TOP, ["has 12 pixels that are transparent"]),
    "rounded alpha": (
        {},
        {"Y": np.full_like(TOP, 1 / 3).astype(np.float16), "A": np.full_like(TOP, 0.33325).astype(np.float16)},
        np.ones_like(TOP),
        ["has 12 pixels that are transparent"],
    ),
    "more channels": (
        {},
        {"Y": TOP, "Z": 9 * TOP, "sun_Y": HALF},
        TOP,
        ["is read from Y; left out: channel Z, channel sun.Y"],
    ),
    "wide pixels": (
        {"pixelAspectRatio": 2.0},
        {"Y": TOP},
        TOP,
        ["has pixels that are 2 times as wide as high (pixelA"],
    ),
}


@pytest.mark.parametrize("name", EXR)
def test_what_an_exr_says_of_its_pixels_is_obeyed_or_named(name, tmp_path):
    attributes, channels, expected, starts = EXR[name]
    write_exr(tmp_path / "a.exr", attributes, **channels)
    pixels, said = read(tmp_path / "a.exr")
    np.testing.assert_allclose(pixels, expected, atol=1e-6)
    assert len(said) == len(starts)
    assert all(text.startswith(start) for text, start in zip(said, starts, strict=True)), said


EXR_REFUSED = {
    "shifted": (
        {"dataWindow": window(2, 1), "displayWindow": window(0, 0)},
        {"Y": TOP},
        r"has no pixels for a part of its picture: its dataWindow is from \(2, 1\) to \(5, 3\), its displayWindow from "
        r"\(0, 0\) to \(3, 2\); expected a dataWindow that covers the displayWindow",
    ),
    "cropped": ({"displayWindow": window(0, 0, 5, 3)}, {"Y": TOP}, "has no pixels for a part of its picture"),
    "all around": ({"envmap": OpenEXR.Envmap.ENVMAP_LATLONG}, {"Y": TOP}, "is an environment map"),
    "two channels": ({}, {"first": TOP, "second": TOP}, "has the channels first, second; expected Y, or R, G and B"),
    "two layers": ({}, {"sun_Y": TOP, "moon_Y": TOP}, r"has the channels moon\.Y, sun\.Y; expected Y"),
    "huge": ({"displayWindow": window(0, 0, 90000, 80000)}, {"Y": TOP}, "has 80000 x 90000 pixels"),
}


@pytest.mark.parametrize("name", EXR_REFUSED)
def test_an_exr_that_is_no_whole_picture_is_refused(name, tmp_path, capfd):
    attributes, channels, said = EXR_REFUSED[name]
    write_exr(tmp_path / "a.exr", attributes, **channels)
    with pytest.raises(FileError, match=rf"a\.exr {said}"):
        read_visibility(tmp_path / "a.exr")
    assert capfd.readouterr() == ("", "")


def write_parts(path, **parts):
    header = {"type": OpenEXR.scanlineimage}
    with OpenEXR.File([OpenEXR.Part(dict(header), channels, name) for name, channels in parts.items()]) as exr:
        exr.write(str(path))


def test_the_part_with_the_visibility_is_read(tmp_path):
    write_parts(tmp_path / "a.exr", depth={"Z": 9 * TOP}, shadow={"Y": TOP, "id": TOP})
    pixels, said = read(tmp_path / "a.exr")
    np.testing.assert_array_equal(pixels, TOP)
    assert said == ["is read from Y of part shadow; left out: channel id, part depth"]
    write_parts(tmp_path / "b.exr", depth={"Z": TOP}, shadow={"V": TOP})
    with pytest.raises(FileError, match="has the channels Z in part depth, V in part shadow; expected Y"):
        read_visibility(tmp_path / "b.exr")


def uncompressed_exr(channels, columns, rows):
    """An EXR file of float channels, each a name, its step between columns and rows, and its pixels."""
    attribute = lambda name, kind, data: name + b"\0" + kind + b"\0" + struct.pack("<i", len(data)) + data
    names = b"".join(
        name.encode() + b"\0" + struct.pack("<i4B2i", 2, 0, 0, 0, 0, step, step) for name, step, _ in channels
    )
    box = struct.pack("<4i", 0, 0, columns - 1, rows - 1)
    header = struct.pack("<2i", 20000630, 2) + b"".join(
        [
            attribute(b"channels", b"chlist", names + b"\0"),
            attribute(b"compression", b"compression", b"\0"),
            attribute(b"dataWindow", b"box2i", box),
            attribute(b"displayWindow", b"box2i", box),
            attribute(b"lineOrder", b"lineOrder", b"\0"),
            attribute(b"pixelAspectRatio", b"float", struct.pack("<f", 1)),
            attribute(b"screenWindowCenter", b"v2f", struct.pack("<2f", 0, 0)),
            attribute(b"screenWindowWidth", b"float", struct.pack("<f", 1)),
            b"\0",
        ]
    )
    lines = []
    for y in range(rows):
        row = b"".join(pixels[y // step].astype("<f4").tobytes() for _, step, pixels in channels if y % step == 0)
        lines.append(struct.pack("<2i", y, len(row)) + row)
    starts = np.cumsum([0, *map(len, lines[:-1])]) + len(header) + 8 * rows
    return header + starts.astype("<u8").tobytes() + b"".join(lines)


def test_luminance_is_read_and_chroma_of_fewer_pixels_is_named(tmp_path):
    pixels = np.linspace(0, 1, 16).reshape(4, 4)
    chroma = np.zeros((2, 2))
    (tmp_path / "a.exr").write_bytes(uncompressed_exr([("BY", 2, chroma), ("RY", 2, chroma), ("Y", 1, pixels)], 4, 4))
    found, said = read(tmp_path / "a.exr")
    np.testing.assert_allclose(found, pixels, atol=1e-6)
    assert said == ["is read from Y; left out: channel BY, channel RY"]
    (tmp_path / "b.exr").write_bytes(uncompressed_exr([("Y", 2, chroma)], 4, 4))
    with pytest.raises(FileError, match="has one value of its channel Y for 2 x 2 pixels; expected one for each"):
        read_visibility(tmp_path / "b.exr")


# --- Arrays ---


def test_arrays_in_any_order_are_read_as_they_are(tmp_path):
    for name, array in {
        "columns": np.asfortranarray(TOP),
        "big": TOP.astype(">f4"),
        "double": TOP.astype(np.float64),
        "half": TOP.astype(np.float16),
        "bool": TOP > 0.5,
    }.items():
        np.save(tmp_path / f"{name}.npy", array)
        np.testing.assert_array_equal(read_visibility(tmp_path / f"{name}.npy"), array.astype(np.float32), err_msg=name)
    np.save(tmp_path / "bytes.npy", LEVELS)
    with pytest.raises(FileError, match="has values from 0 to 255; expected 0 to 1: scale"):
        read_visibility(tmp_path / "bytes.npy")


def test_what_is_written_is_read_without_a_remark(tmp_path):
    for suffix in (".png", ".exr", ".npy"):
        write_visibility(tmp_path / f"a{suffix}", TOP)
        assert read(tmp_path / f"a{suffix}")[1] == []
