"""The interface of sampling patterns."""

import math

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..._arithmetic import as_float
from ..._checks import check_arguments, check_value
from ..._types import HostArray
from ...settings.patterns import MAX_PATTERN_TAPS, PatternSamples
from ...settings.patterns import Pattern as Settings

EARLY_SAMPLES = 8
"""How many samples, from the first, an early-out takes."""


class Pattern(eqx.Module):
    """A set of points in the unit disk for each pixel.

    - `offsets`: (n, p, p, 2), `n` points for each pixel of a tile of `p` by `p` pixels, which repeats over the image.
        They carry no gradient. An early-out takes the first 8, which lie far out and in all directions.
    - `rotated`: whether each pixel rotates its set by its own angle, from interleaved gradient noise (Jimenez, "Next
        Generation Post Processing in Call of Duty: Advanced Warfare", SIGGRAPH 2014).

    **Raises** `ValueError` if the offsets have another shape.
    """

    offsets: Float[Array, "n p p 2"]
    rotated: bool = eqx.field(static=True, default=Settings.rotated)

    def __check_init__(self):
        shape = self.offsets.shape
        if len(shape) != 4 or min(shape) < 1 or shape[1] != shape[2] or shape[3] != 2:
            raise ValueError(f"the pattern's offsets have shape {shape}; expected (n, p, p, 2), none of them 0")

    @property
    def samples(self) -> int:
        """Number of points per pixel."""
        return self.offsets.shape[0]


def interleaved_gradient_noise(shape: tuple[int, ...], first: float = 0.0) -> Float[Array, "h w"]:
    """Noise in [0, 1) for the pixels of an image of `shape` (h, w), evenly spread over any 3 x 3 of them.

    After Jimenez (2014), as cited for `Pattern`. `first` is both coordinates of the lower left pixel: 0.5 where pixels
    are at their centres.
    """
    height, width = shape
    x, y = (jnp.arange(size, dtype=jnp.float32) + first for size in (width, height))
    y = y[:, None]
    fraction = lambda t: t - jnp.floor(t)
    return fraction(52.9829189 * fraction(0.06711056 * x + 0.00583715 * y))


def check_counts(samples: int | tuple[int, int], pattern_size: int) -> None:
    """**Raises** `ValueError` if a number is out of its range, or there are too many taps in a tile."""
    for count in samples if isinstance(samples, tuple) else (samples,):
        check_value("the pattern's samples", count, PatternSamples)
    check_arguments(Settings, pattern_size=pattern_size)
    taps = math.prod(np.atleast_1d(samples).tolist()) * pattern_size**2
    if taps > MAX_PATTERN_TAPS:
        raise ValueError(
            f"the pattern has samples {samples} and pattern_size {pattern_size}, which makes {taps:,} taps per tile; "
            f"expected at most {MAX_PATTERN_TAPS:,}: lower one of them"
        )


def pattern_of(points: HostArray, rotated: bool) -> Pattern:
    """The pattern of `points` (p, p, n, 2), a set for each pixel, ordered for an early-out."""
    return Pattern(as_float(np.moveaxis(outer_first(points), 2, 0)), rotated)


def outer_first(points: HostArray) -> HostArray:
    """Reorders sets (..., n, 2): first the outermost point of each of 8 sectors, then all others, inwards."""
    x, y = points[..., 0], points[..., 1]
    radius = np.hypot(x, y)
    sector = np.floor(np.arctan2(y, x) / (2 * np.pi) * EARLY_SAMPLES) % EARLY_SAMPLES
    leads = np.zeros(radius.shape, bool)
    for k in range(EARLY_SAMPLES):
        own = np.where(sector == k, radius, -1)
        outermost = np.argmax(own, axis=-1)[..., None]
        exists = np.take_along_axis(own, outermost, -1) >= 0
        np.put_along_axis(leads, outermost, np.take_along_axis(leads, outermost, -1) | exists, -1)
    # Radii are at most 1, so adding 2 puts leading points before all others.
    order = np.argsort(-(radius + 2 * leads), axis=-1, kind="stable")
    return np.take_along_axis(points, order[..., None], -2)
