"""PNG files: https://www.w3.org/TR/png-3."""

import io
import struct
import warnings
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float32, Shaped, UInt
from PIL import Image

from .._types import HostArray
from ._errors import FileError
from ._paths import on_disk
from ._pixels import Merge, Pixels, check_size, mean_colour, upright
from ._text import excerpt

# Colour types of images.
_GREY, _COLOUR, _PALETTE, _GREY_ALPHA = 0, 2, 3, 4
# Encodings that are proportional to light: a code of the chunk cICP, and a gamma in 100,000ths.
_LINEAR_TRANSFER, _LINEAR_GAMMA = 8, 100_000
_EXIF_ORIENTATION = 0x0112


class _Samples(NamedTuple):
    """Samples from 0 to 2^depth - 1. Row 0 is the top row.

    - `colours`: one channel or three.
    - `opacity`: `None` if the image has neither alpha nor a transparent colour.
    """

    colours: list[UInt[HostArray, "h w"]]
    opacity: UInt[HostArray, "h w"] | None
    depth: int


def read_png(file: Path, merge: Merge = mean_colour, curves: Sequence[str | None] = (None,)) -> Pixels:
    """Reads the stored values of an image from 0 to 1: the mean of its colours, or the result of `merge`. Alpha is
    ignored.

    **Arguments:** `curves`: the encodings that need no remark.

    **Raises** `FileError` for an animation, or too many pixels, and other errors if the file is damaged.
    """
    data = on_disk(file).read_bytes()
    # The signature, and the header's length and name, come before the width and height.
    if len(data) < 26:
        raise ValueError("its header is cut short")
    columns, rows, depth, kind = struct.unpack_from(">IIBB", data, 16)
    check_size(file, rows, columns)
    chunks = _chunks(data)
    frames = int.from_bytes(chunks.get(b"acTL", b"")[:4])
    if frames > 1:
        raise FileError(f"the image file {file} is an animation of {frames} images; expected one image")
    samples = _samples(data, depth, kind, chunks.get(b"tRNS", b""))
    remarks = [*_remarks(chunks, curves)]
    see_through = 0 if samples.opacity is None else np.count_nonzero(samples.opacity < 2**samples.depth - 1)
    if see_through:
        remarks.append(
            f"has {see_through} pixels that are transparent, at least in part; their colours are read as if they were "
            "opaque: write it without alpha"
        )
    significant = [*chunks.get(b"sBIT", b""), *[0] * len(samples.colours)]
    colours = [_unit(each, samples.depth, bits) for each, bits in zip(samples.colours, significant, strict=False)]
    values = merge(colours, remarks)
    return Pixels(upright(values, _orientation(data, remarks))[::-1], remarks)


def write_levels(file: Path, levels: UInt[HostArray, "h w *c"]) -> None:
    """Writes grey with 8 or 16 bits, or colours with 8 bits. Row 0 is the top row."""
    Image.fromarray(levels).save(file)


def _chunks(data: bytes) -> Mapping[bytes, bytes]:
    """The first chunk of each type."""
    found: dict[bytes, bytes] = {}
    at = 8
    while at + 8 <= len(data):
        (size,) = struct.unpack_from(">I", data, at)
        found.setdefault(data[at + 4 : at + 8], data[at + 8 : at + 8 + size])
        at += 12 + size
    return found


def _samples(data: bytes, depth: int, kind: int, transparent: bytes) -> _Samples:
    """The samples at their full depth.

    **Arguments:**

    - `transparent`: the chunk tRNS, which makes a colour or entries of the palette transparent.
    """
    if kind == _PALETTE:
        # A palette has 8 bits.
        *colours, opacity = _split(_decoded(data, convert="RGBA"))
        return _Samples(colours, opacity if transparent else None, 8)
    channels = _wide(data, kind) if depth == 16 else _split(_decoded(data))
    if 1 < depth < 8:
        # Pillow stretches them to 8 bits.
        channels = [channel // (255 // (2**depth - 1)) for channel in channels]
    if kind not in (_GREY, _COLOUR):
        return _Samples(channels[:-1], channels[-1], depth)
    return _Samples(channels, _opacity(channels, depth, transparent), depth)


def _wide(data: bytes, kind: int) -> list[UInt[HostArray, "h w"]]:
    """The channels of a 16-bit image. Pillow drops the lower bytes unless the image is grey."""
    if kind == _GREY:
        return [_decoded(data).astype(np.uint16)]
    if kind == _GREY_ALPHA:
        # Four channels of a byte are stored in the same way.
        parts = _split(_decoded(data, raw="RGBA"))
        upper, lower = parts[0::2], parts[1::2]
    else:
        # In the other byte order, the lower bytes become the upper ones.
        mode = "RGB" if kind == _COLOUR else "RGBA"
        upper, lower = _split(_decoded(data)), _split(_decoded(data, raw=f"{mode};16L"))
    return [high.astype(np.uint16) << 8 | low for high, low in zip(upper, lower, strict=True)]


def _decoded(data: bytes, raw: str | None = None, convert: str | None = None) -> Shaped[HostArray, "h w *c"]:
    """The pixels as Pillow reads them, or the stored bytes interpreted in Pillow's raw mode `raw`."""
    # Pillow warns about damage that does not affect the pixels.
    with warnings.catch_warnings(action="ignore"), Image.open(io.BytesIO(data), formats=["PNG"]) as image:
        if raw is not None:
            image.tile = [image.tile[0]._replace(args=raw)]
        return np.asarray(image if convert is None else image.convert(convert))


def _split(pixels: Shaped[HostArray, "h w *c"]) -> list[UInt[HostArray, "h w"]]:
    """The channels of an image of up to 8 bits."""
    channels = pixels[..., None] if pixels.ndim == 2 else pixels
    return [*np.moveaxis(channels.astype(np.uint8), -1, 0)]


def _opacity(
    channels: Sequence[UInt[HostArray, "h w"]], depth: int, transparent: bytes
) -> UInt[HostArray, "h w"] | None:
    """The opacity of an image without alpha: 0 where it has the transparent colour."""
    if len(transparent) < 2 * len(channels):
        return None
    key = struct.unpack_from(f">{len(channels)}H", transparent)
    is_key = np.all([channel == level for channel, level in zip(channels, key, strict=True)], axis=0)
    return np.where(is_key, 0, 2**depth - 1).astype(channels[0].dtype)


def _unit(channel: UInt[HostArray, "h w"], depth: int, significant: int) -> Float32[HostArray, "h w"]:
    """The samples from 0 to 1. Writers may store anything in the bits below the `significant` ones (section
    11.3.2.7)."""
    bits = significant if 0 < significant < depth else depth
    return (channel >> (depth - bits)).astype(np.float32) / (2**bits - 1)


def _orientation(data: bytes, remarks: list[str]) -> int:
    """The orientation of the image from its Exif or XMP data; 1 if they have none. Damage is added to `remarks`."""
    try:
        # Pillow warns about some kinds of damage, and raises errors of any type about others.
        with warnings.catch_warnings(action="error"), Image.open(io.BytesIO(data), formats=["PNG"]) as image:
            return int(image.getexif().get(_EXIF_ORIENTATION, 1))
    except Exception:
        remarks.append("has Exif data that is damaged; the image is read as upright")
        return 1


def _remarks(chunks: Mapping[bytes, bytes], curves: Sequence[str | None]) -> Iterator[str]:
    """Remarks on ignored pixel properties in the chunks."""
    encoding = _encoding(chunks)
    if encoding not in curves:
        read, mend = ("linear", "without a curve") if None in curves and len(curves) == 1 else ("sRGB", "in sRGB")
        yield (
            f"has the chunk {encoding}; its values are still read as {read}, from 0 in shadow to 1 in light: "
            f"write them {mend}, or as .npy or .exr"
        )
    across, down, _ = struct.unpack(">IIB", chunks.get(b"pHYs", bytes(9)))
    if across and down and abs(down / across - 1) > 0.01:
        yield f"has pixels that are {down / across:.4g} times as wide as high (pHYs); they are read as square"
    x, y, _ = struct.unpack(">iiB", chunks.get(b"oFFs", bytes(9)))
    if x or y:
        yield f"begins at ({x}, {y}) on its page (oFFs); it is read as the whole picture"


def _encoding(chunks: Mapping[bytes, bytes]) -> str | None:
    """The name of the chunk that declares a nonlinear transfer function, or `None`. Of several such chunks, the format
    defines which one counts."""
    if b"cICP" in chunks:
        transfer = chunks[b"cICP"][1]
        return None if transfer == _LINEAR_TRANSFER else f"cICP, of the transfer function {transfer}"
    if b"iCCP" in chunks:
        name = chunks[b"iCCP"].partition(b"\0")[0].decode("latin-1")
        return f"iCCP, the colour profile {excerpt(name)}"
    if b"sRGB" in chunks:
        return "sRGB"
    (gamma,) = struct.unpack(">I", chunks.get(b"gAMA", bytes(4)))
    is_linear = not gamma or abs(gamma / _LINEAR_GAMMA - 1) < 0.01
    return None if is_linear else f"gAMA, of the exponent {gamma / _LINEAR_GAMMA:g}"
