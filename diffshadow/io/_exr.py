"""OpenEXR files: https://openexr.com/en/latest/OpenEXRFileLayout.html."""

import contextlib
import os
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import OpenEXR
from jaxtyping import Float32

from .._types import HostArray
from ._errors import FileError
from ._paths import on_disk
from ._pixels import Merge, Pixels, check_size, mean_colour, upright
from ._text import listed

_DEEP = (OpenEXR.deepscanline, OpenEXR.deeptile)
# Half floats have 11 significant bits. The roundings of a colour and its alpha may differ by this much.
_ROUNDING = 2**-10


class _Chosen(NamedTuple):
    """The selected part of a file: its number, and the names of its channels.

    - `alpha`: the alpha channel of the same layer.
    """

    part: int
    channels: list[str]
    alpha: str


def read_exr(file: Path, merge: Merge = mean_colour) -> Pixels:
    """Reads the channel `Y`, or the result of `merge` for `R`, `G` and `B`, or the only channel, within the display
    window.

    **Raises** `FileError` if no such channel covers every pixel of the window, and other errors if the file is damaged.
    """
    try:
        with _silent(), OpenEXR.File(str(on_disk(file)), header_only=True) as exr:
            headers = [dict(part.header) for part in exr.parts]
    except Exception as error:
        raise ValueError("its header is cut short or garbled") from error
    chosen = _choose(file, headers)
    header = headers[chosen.part]
    for each in headers:
        for window in (each["dataWindow"], each["displayWindow"]):
            low, high = _corners(window)
            check_size(file, *(high - low + 1).tolist()[::-1])
    within = _within(file, header)
    _check(file, header, chosen.channels)
    try:
        with _silent(), OpenEXR.File(str(on_disk(file)), separate_channels=True) as exr:
            channels = exr.parts[chosen.part].channels
            read = lambda name: np.asarray(channels[name].pixels, np.float32)[within]
            colours = [read(name) for name in chosen.channels]
            alpha = read(chosen.alpha) if chosen.alpha in channels else None
    except Exception as error:
        raise ValueError("its pixels are cut short or garbled") from error
    remarks = [*_remarks(headers, chosen)]
    if alpha is not None:
        colours = _without_alpha(colours, alpha, remarks)
    orientation = header.get("Orientation", header.get("orientation", 1))
    values = merge(colours, remarks)
    return Pixels(upright(values, orientation if isinstance(orientation, int) else 1)[::-1], remarks)


def write_exr(file: Path, pixels: Float32[HostArray, "h w"]) -> None:
    """Writes the channel `Y`; row 0 is the top row."""
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    with OpenEXR.File(header, {"Y": np.ascontiguousarray(pixels)}) as exr:
        exr.write(str(file))


@contextlib.contextmanager
def _silent() -> Iterator[None]:
    """Silences OpenEXR, which prints errors of a damaged file directly to the terminal."""
    sys.stderr.flush()
    errors = os.dup(2)
    with open(os.devnull, "w") as nowhere, contextlib.redirect_stdout(nowhere):
        os.dup2(nowhere.fileno(), 2)
        try:
            yield
        finally:
            os.dup2(errors, 2)
            os.close(errors)


def _names(header: Mapping[str, Any]) -> list[str]:
    return [channel.name for channel in header["channels"]]


def _choose(file: Path, headers: Sequence[Mapping[str, Any]]) -> _Chosen:
    """The first part with the channel `Y` or the channels `R`, `G` and `B`; otherwise the only part with one channel.

    **Raises** `FileError` if there is none.
    """
    found = [_Chosen(i, *of_part) for i, header in enumerate(headers) if (of_part := _channels(_names(header)))]
    named = [each for each in found if each.channels[0].rpartition(".")[2] in ("Y", "R")]
    if named or len(found) == 1:
        return [*named, *found][0]
    parts = [listed(_names(header)) for header in headers]
    if len(headers) > 1:
        parts = [f"{names} in part {_part(headers, i)}" for i, names in enumerate(parts)]
    raise FileError(
        f"the image file {file} has the channels {', '.join(parts)}; expected Y, or R, G and B, or only one"
    )


def _channels(names: Sequence[str]) -> tuple[list[str], str] | None:
    """The channels of a part to read, and the name of their alpha. If there are several layers, the layer without a
    name is read."""
    layers = {name.rpartition(".")[0] for name in names}
    prefix = f"{next(iter(layers))}." if len(layers) == 1 and "" not in layers else ""
    colours, alpha = [f"{prefix}{colour}" for colour in "RGB"], f"{prefix}A"
    others = [name for name in names if name != alpha]
    if f"{prefix}Y" in names:
        return [f"{prefix}Y"], alpha
    if set(colours) <= set(names):
        return colours, alpha
    if len(names) == 1:
        return [*names], ""
    return (others, alpha) if len(others) == 1 else None


def _part(headers: Sequence[Mapping[str, Any]], index: int) -> str:
    return str(headers[index].get("name", index))


def _corners(window: Any) -> tuple[HostArray, HostArray]:
    """The lowest and the highest pixel of a window, (x, y)."""
    low, high = (np.array(corner, np.int64) for corner in window)
    return low, high


def _within(file: Path, header: Mapping[str, Any]) -> tuple[slice, slice]:
    """The rows and columns of the data window inside the display window.

    **Raises** `FileError` if the data window does not cover the display window.
    """
    (low, high), (first, last) = _corners(header["dataWindow"]), _corners(header["displayWindow"])
    if (low > first).any() or (high < last).any():
        shown = lambda start, end: f"{tuple(start.tolist())} to {tuple(end.tolist())}"
        raise FileError(
            f"the image file {file} has no pixels for a part of its picture: its dataWindow is from "
            f"{shown(low, high)}, its displayWindow from {shown(first, last)}; expected a dataWindow that covers the "
            "displayWindow: write the whole picture, or set its displayWindow to the picture"
        )
    columns, rows = (slice(int(first[k] - low[k]), int(last[k] - low[k]) + 1) for k in (0, 1))
    return rows, columns


def _check(file: Path, header: Mapping[str, Any], names: Sequence[str]) -> None:
    """**Raises** `FileError` unless the file is the picture of a camera, with the channels `names` in each pixel."""
    fault = None
    if header.get("type") in _DEEP:
        fault = "has several samples to a pixel (deep data); expected one: flatten it"
    elif "envmap" in header:
        fault = "is an environment map (envmap), whose pixels are directions; expected the picture of a camera"
    for channel in header["channels"]:
        if channel.name in names and (channel.xSampling, channel.ySampling) != (1, 1):
            fault = (
                f"has one value of its channel {channel.name} for {channel.xSampling} x {channel.ySampling} pixels; "
                "expected one for each pixel: write it without subsampling"
            )
    if fault is not None:
        raise FileError(f"the image file {file} {fault}")


def _without_alpha(
    colours: Sequence[Float32[HostArray, "h w"]], alpha: Float32[HostArray, "h w"], remarks: list[str]
) -> list[Float32[HostArray, "h w"]]:
    """The colours, divided by alpha. The format stores them multiplied by alpha. Adds to `remarks`."""
    is_partial = (alpha > 0) & (alpha < 1)
    see_through = np.count_nonzero(alpha < 1)
    if see_through:
        remarks.append(
            f"has {see_through} pixels that are transparent, at least in part; EXR stores colours multiplied by "
            "alpha, so they are divided by it where it is not 0: write the image without alpha"
        )
    opaque = []
    for colour in colours:
        divided = colour / np.where(is_partial, alpha, 1)
        opaque.append(np.where(is_partial & (colour <= alpha + _ROUNDING), np.minimum(divided, 1), divided))
    return opaque


def _remarks(headers: Sequence[Mapping[str, Any]], chosen: _Chosen) -> Iterator[str]:
    """Remarks on ignored pixel properties in the headers."""
    header = headers[chosen.part]
    taken = {*chosen.channels, chosen.alpha}
    others = [f"channel {name}" for name in _names(header) if name not in taken]
    others += [f"part {_part(headers, i)}" for i in range(len(headers)) if i != chosen.part]
    if others:
        part = f" of part {_part(headers, chosen.part)}" if len(headers) > 1 else ""
        yield f"is read from {', '.join(chosen.channels)}{part}; left out: {listed(others)}"
    aspect = header.get("pixelAspectRatio", 1)
    if abs(aspect - 1) > 0.01:
        yield f"has pixels that are {aspect:.4g} times as wide as high (pixelAspectRatio); they are read as square"
