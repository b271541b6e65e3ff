"""Shared code of the image readers: limits, orientations, and the treatment of colours."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float32, Shaped

from .._types import HostArray
from ._errors import FileError

# 8192 squared: far more pixels than any compared image, in a few hundred megabytes.
MAX_PIXELS = 1 << 26
# Lossy compression may make the channels of a grey image differ by this much.
_GREY = 1 / 64


class Pixels(NamedTuple):
    """The pixels of an image file.

    - `values`: row 0 is the bottom row.
    - `remarks`: ignored metadata about pixels, each phrased to follow the file's name.
    """

    values: HostArray
    remarks: list[str] = []  # noqa: RUF012


def check_size(file: Path, rows: int, columns: int) -> None:
    """**Raises** `FileError` if there are no pixels, or more than `MAX_PIXELS`."""
    if not 0 < rows * columns <= MAX_PIXELS:
        raise FileError(
            f"the image file {file} has {rows} x {columns} pixels; expected 1 to {MAX_PIXELS:,} in total: scale it down"
        )


def upright(rows: Shaped[HostArray, "h w *c"], orientation: int) -> Shaped[HostArray, "h2 w2 *c"]:
    """Rotates or mirrors an image by Exif's tag Orientation (Exif 2.32, section 4.6.4); row 0 is the top row."""
    match orientation:
        case 2:
            return rows[:, ::-1]
        case 3:
            return rows[::-1, ::-1]
        case 4:
            return rows[::-1]
        case 5:
            return rows.swapaxes(0, 1)
        case 6:
            return rows.swapaxes(0, 1)[:, ::-1]
        case 7:
            return rows.swapaxes(0, 1)[::-1, ::-1]
        case 8:
            return rows.swapaxes(0, 1)[::-1]
    return rows


def mean_colour(channels: Sequence[Shaped[HostArray, "h w"]], remarks: list[str]) -> Float32[HostArray, "h w"]:
    """The mean of one channel or several. Adds a remark if the channels differ."""
    if len(channels) == 1:
        return np.asarray(channels[0], np.float32)
    stacked = np.stack(channels).astype(np.float32)
    apart = float(np.ptp(stacked, axis=0).max())
    if apart > _GREY:
        remarks.append(
            f"is in colour: its channels differ by up to {apart:.2g}; their mean is read without regard to "
            "primaries: write only the visibility, in grey"
        )
    return stacked.mean(axis=0)


def three_colours(channels: Sequence[Shaped[HostArray, "h w"]], remarks: list[str]) -> Float32[HostArray, "h w 3"]:
    """Red, green and blue; grey has the same value in all of them."""
    return np.stack([*channels] * (3 // len(channels)), axis=-1).astype(np.float32)


Merge = Callable[[Sequence[Shaped[HostArray, "h w"]], list[str]], HostArray]
"""How a reader combines one or three channels; it may add remarks."""
