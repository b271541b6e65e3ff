"""Reads and writes images.

In memory row 0 is the bottom row. Image files (PNG, EXR) begin with the top row; they are flipped in this subpackage
and nowhere else. A `.npy` file stores the array as in memory. Values are linear: no gamma curve is applied.
"""

import math
import os
import warnings
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from PIL import Image, ImageOps

from .._types import HostArray
from ..settings.reference import Encoding
from ._arrays import read_header
from ._atomic import atomic_path
from ._errors import FileError, ImageWarning
from ._exr import read_exr, write_exr
from ._paths import existing_file, on_disk
from ._pixels import Pixels, check_size, three_colours
from ._png import read_png, write_levels

# The writer of animations for each suffix.
_ANIMATIONS: dict[str, dict[str, Any]] = {
    ".webp": {"format": "WEBP", "quality": 75, "method": 4},
    ".gif": {"format": "GIF", "optimize": False},
    ".png": {"format": "PNG"},
}
# The first bytes of each file format, and its usual suffix.
_SIGNATURES = {
    b"\x93NUMPY": ".npy",
    b"\x89PNG\r\n\x1a\n": ".png",
    b"v/1\x01": ".exr",
    b"\xff\xd8\xff": ".jpg",
    b"GIF8": ".gif",
    b"BM": ".bmp",
    b"II*\0": ".tif",
    b"MM\0*": ".tif",
    b"RIFF": ".webp",
    b"#?RADIANCE": ".hdr",
    b"PK\x03\x04": ".npz or .zip",
}
# Encodings that a PNG file may declare if sRGB is expected.
_SRGB = (None, "sRGB", "gAMA, of the exponent 0.45455")
# Rounding may move a mean of values in [0, 1] out of the interval by this much.
_ROUNDING = 1e-5


def write_png(path: str | os.PathLike[str], image: Any) -> None:
    """Writes `image` as a PNG file with 8 bits per channel.

    **Arguments:**

    - `path`: the file to write.
    - `image`: (h, w) grey or (h, w, 3) colour, floats in [0, 1]; row 0 is the bottom row.

    **Raises** `FileError` if the folder is missing or cannot be written to, and `ValueError` if the image has another
    shape, or values that are NaN or outside [0, 1].
    """
    pixels = np.asarray(image)
    if pixels.ndim not in (2, 3) or (pixels.ndim == 3 and pixels.shape[-1] != 3) or pixels.size == 0:
        raise ValueError(f"the image to write has the shape {pixels.shape}; expected (h, w) or (h, w, 3)")
    unit = _in_unit_range(pixels, "the image to write", ValueError)
    _save(path, lambda file: write_levels(file, np.rint(unit[::-1] * 255).astype(np.uint8)))


def read_visibility(path: str | os.PathLike[str]) -> Float[HostArray, "h w"]:
    """Reads a visibility image (1 lit, 0 shadowed) from a `.npy`, `.png`, `.jpg` or `.exr` file.

    - `.npy`: an (h, w) array whose row 0 is the bottom row.
    - `.png`: grey, colour or a palette, with any number of bits, linear from 0 to 1. Colour channels are averaged, and
      alpha is ignored. Significant bits (`sBIT`) and the Exif orientation are applied.
    - `.jpg`: as `.png`, except for compression errors.
    - `.exr`: the channel `Y`, the mean of `R`, `G` and `B`, or the only channel, of the first part with these channels.
      It is divided by alpha, as the format requires. The picture is the content of the display window, rotated
      according to the attribute `Orientation`.

    **Returns:** (h, w), float32. Row 0 is the bottom row.

    **Warns** with `ImageWarning` about everything in the file that is ignored: a transfer curve or colour profile,
    colours, alpha, further channels and parts, and the aspect of pixels that are not square.

    **Raises** `FileError` if the file is missing, damaged or has another format. **Raises** `FileError` also for more
    than one image, for missing pixels, and for values that are NaN or outside [0, 1].
    """
    file = existing_file(path, "visibility")
    pixels = _read(file, _for_suffix(file, _READERS))
    if pixels.ndim != 2 or pixels.size == 0:
        raise FileError(f"the image file {file} holds an array of shape {pixels.shape}; expected (h, w)")
    return _in_unit_range(pixels, f"the image file {file}", FileError)


def read_picture(path: str | os.PathLike[str]) -> tuple[Float[HostArray, "h w 3"], Encoding]:
    """Reads a picture in colour from a `.npy`, `.png`, `.jpg` or `.exr` file.

    - `.npy`: an (h, w, 3) array, linear, whose row 0 is the bottom row.
    - `.png`, `.jpg`: sRGB from 0 to 1; colour profiles in the file are ignored.
    - `.exr`: the channels `R`, `G` and `B`, or one channel of grey, linear; otherwise as for `read_visibility`.

    **Returns:** (h, w, 3), float32, the stored values with row 0 at the bottom, and their encoding.

    **Warns** with `ImageWarning` as `read_visibility` does.

    **Raises** `FileError` if the file is missing, damaged or has another format, if it does not have exactly one image,
    or if values are NaN or infinite.
    """
    file = existing_file(path, "picture")
    read, encoding = _for_suffix(file, _PICTURES)
    with np.errstate(over="ignore"):  # values beyond float32 become infinite, which is checked below
        pixels = _read(file, read).astype(np.float32)
    if pixels.ndim != 3 or pixels.shape[-1] != 3 or pixels.size == 0:
        raise FileError(f"the image file {file} holds an array of shape {pixels.shape}; expected (h, w, 3)")
    if not np.isfinite(pixels).all():
        bad = np.count_nonzero(~np.isfinite(pixels))
        raise FileError(f"the image file {file} has {bad} values that are NaN or infinite; expected numbers")
    return pixels, encoding


def _read(file: Path, read: Callable[[Path], Pixels]) -> HostArray:
    """The pixels of a file. Remarks become warnings."""
    try:
        _check_signature(file)
        pixels, remarks = read(file)
    except FileError:
        raise
    except Exception as error:  # Each format's reader raises its own types.
        reason = " ".join(str(error).split()) or type(error).__name__
        raise FileError(
            f"the image file {file} is damaged or does not have the format of its suffix ({reason}); write it again"
        ) from error
    for remark in remarks:
        warnings.warn(ImageWarning(f"the image file {file} {remark}"), stacklevel=3)
    return pixels


def write_visibility(path: str | os.PathLike[str], image: Any) -> None:
    """Writes a visibility image (h, w) in [0, 1] for `read_visibility`. Row 0 is the bottom row.

    The suffix of `path` selects the format: `.npy` and `.exr` store float32 exactly, `.png` stores 16 bits.

    **Raises** `FileError` for any other suffix, or if the folder is missing or cannot be written to, and `ValueError`
    if the image has another shape, or values that are NaN or outside [0, 1].
    """
    write = _for_suffix(Path(path), _WRITERS)
    pixels = np.asarray(image)
    if pixels.ndim != 2 or pixels.size == 0:
        raise ValueError(f"the visibility image to write has the shape {pixels.shape}; expected (h, w)")
    unit = _in_unit_range(pixels, "the visibility image to write", ValueError)
    _save(path, lambda file: write(file, unit))


def _read_npy(file: Path) -> Pixels:
    # Opened here, because `np.load` leaves a damaged file open.
    with on_disk(file).open("rb") as stream:
        shape, _, dtype = read_header(stream, f"the image file {file}")
        if dtype.kind not in "bfiu":
            raise FileError(f"the image file {file} holds values of type {dtype}; expected real numbers")
        # `np.load` allocates the memory that the header requests before it checks the file's size.
        expected, actual = math.prod(shape) * dtype.itemsize, on_disk(file).stat().st_size - stream.tell()
        if expected != actual:
            raise ValueError(f"it has {actual} bytes of numbers; expected the {expected} of its shape {shape}")
        stream.seek(0)
        return Pixels(np.load(stream, allow_pickle=False))


def _write_npy(file: Path, pixels: HostArray) -> None:
    # Written to a stream, because `np.save` appends `.npy` to unknown suffixes of a path.
    with file.open("wb") as stream:
        np.save(stream, pixels, allow_pickle=False)


def _read_jpeg(file: Path) -> Pixels:
    with Image.open(on_disk(file), formats=["JPEG"]) as image:
        check_size(file, image.height, image.width)
        return Pixels(np.asarray(ImageOps.exif_transpose(image).convert("RGB"), np.float32)[::-1] / 255)


def _read_grey_jpeg(file: Path) -> Pixels:
    return Pixels(_read_jpeg(file).values.mean(axis=-1))


_READERS: Mapping[str, Callable[[Path], Pixels]] = {
    ".npy": _read_npy,
    ".png": read_png,
    ".jpg": _read_grey_jpeg,
    ".jpeg": _read_grey_jpeg,
    ".exr": read_exr,
}
# The readers of pictures, with their encodings.
_PICTURES: Mapping[str, tuple[Callable[[Path], Pixels], Encoding]] = {
    ".npy": (_read_npy, "linear"),
    ".png": (lambda file: read_png(file, three_colours, _SRGB), "srgb"),
    ".jpg": (_read_jpeg, "srgb"),
    ".jpeg": (_read_jpeg, "srgb"),
    ".exr": (lambda file: read_exr(file, three_colours), "linear"),
}
# Writers that accept float32 from 0 to 1.
_WRITERS: Mapping[str, Callable[[Path, HostArray], None]] = {
    ".npy": _write_npy,
    ".png": lambda file, pixels: write_levels(file, np.rint(pixels[::-1].astype(np.float64) * 65535).astype(np.uint16)),
    ".exr": lambda file, pixels: write_exr(file, pixels[::-1]),
}


def _for_suffix[T](path: Path, table: Mapping[str, T]) -> T:
    if path.suffix.lower() not in table:
        raise FileError(f"the suffix of {path} is {path.suffix!r}; expected one of {', '.join(table)}")
    return table[path.suffix.lower()]


def _check_signature(file: Path) -> None:
    """**Raises** `ValueError` if the file's first bytes do not match its suffix, `FileError` if it cannot be read."""
    try:
        with on_disk(file).open("rb") as stream:
            start = stream.read(max(map(len, _SIGNATURES)))
    except OSError as error:
        raise FileError(f"cannot read the image file {file}: {error.strerror or error}") from error
    found = next((kind for signature, kind in _SIGNATURES.items() if start.startswith(signature)), None)
    if found != {".jpeg": ".jpg"}.get(suffix := file.suffix.lower(), suffix):
        what = f"is a {found} file" if found else f"does not begin as a {file.suffix} file" if start else "is empty"
        raise ValueError(f"it {what}")


def _in_unit_range(pixels: HostArray, name: str, error: type[ValueError]) -> HostArray:
    """`pixels` in float32. Values that rounding moved out of range are clipped to [0, 1]."""
    with np.errstate(over="ignore"):  # values beyond float32 become infinite, which is checked below
        values = pixels.astype(np.float32)
    if not np.isfinite(values).all():
        raise error(f"{name} has {np.count_nonzero(~np.isfinite(values))} pixels that are NaN or infinite")
    low, high = float(values.min()), float(values.max())
    if low < -_ROUNDING or high > 1 + _ROUNDING:
        raise error(f"{name} has values from {low:g} to {high:g}; expected 0 to 1: scale or clip them first")
    return np.clip(values, 0, 1)


def _save(path: str | os.PathLike[str], write: Callable[[Path], None]) -> None:
    with atomic_path(path) as temporary:
        try:
            write(temporary)
        except OSError as error:
            raise FileError(f"cannot write {os.path.abspath(path)}: {error.strerror or error}") from error


def write_animation(path: str | os.PathLike[str], frames: Any, milliseconds: int | Sequence[int]) -> None:
    """Writes `frames` as an animation that repeats forever. The suffix selects WebP, GIF or animated PNG.

    **Arguments:**

    - `frames`: (n, h, w, 3) colours, floats in [0, 1] or bytes. Row 0 of each frame is the bottom row.
    - `milliseconds`: the duration of each frame, as one number or one number per frame.

    **Raises** `FileError` if the folder is missing or cannot be written to, or for another suffix, and `ValueError` if
    the frames have another shape, or values that are NaN or outside [0, 1].
    """
    pixels = np.asarray(frames)
    if pixels.ndim != 4 or pixels.shape[-1] != 3 or pixels.size == 0:
        raise ValueError(f"the frames to write have the shape {pixels.shape}; expected (n, h, w, 3)")
    if pixels.dtype != np.uint8:
        pixels = np.rint(_in_unit_range(pixels, "the frames to write", ValueError) * 255).astype(np.uint8)
    first, *others = (Image.fromarray(frame) for frame in pixels[:, ::-1])
    suffix = Path(path).suffix.lower()
    if suffix not in _ANIMATIONS:
        raise FileError(f"{path} has the suffix {suffix!r}; expected {', '.join(_ANIMATIONS)}; change it")
    how: Any = {"save_all": True, "append_images": others, "loop": 0, "duration": milliseconds, **_ANIMATIONS[suffix]}
    _save(path, lambda file: first.save(file, **how))
