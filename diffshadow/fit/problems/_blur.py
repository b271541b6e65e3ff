"""The Gaussian that blurs compared images if lights or meshes move.

Without a blur, a shadow has no gradient towards its target if the distance exceeds the width of its outline. The
outlines of a map are also as soft as its texels, while a reference's outlines are sharp. Without a blur, a fit would
interpret this difference as a light at another position.
"""

import itertools
import math
from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.fft import next_fast_len

from ..._types import Scalar
from ...settings.fit import BLUR, widest_blur

REACH_OF_BLUR = 4
"""The distance at which the Gaussian is practically 0, in standard deviations."""
# The approximate ratio of consecutive widths. With a ratio of ten, a quarter of the fits of point lights over a teapot
# failed.
_STEP = 3


def blurs_of(blurs: Sequence[float] | None, *sides: int) -> tuple[float, ...]:
    """`blurs`, the standard deviations in pixels. By default, they range from the widest for images of these `sides`
    down to `BLUR`.

    **Raises** `ValueError` unless the blurs fall and the first is no wider than the widest.
    """
    most = widest_blur(*sides)
    if blurs is None:
        count = 1 + round(math.log(most / BLUR, _STEP))
        return tuple(np.geomspace(most, BLUR, count).tolist()) if count > 1 else (BLUR,)
    check_falling(blurs)
    if blurs[0] > most:
        raise ValueError(
            f"a blur of {blurs[0]:g} pixels is too wide for an image with a side of {min(sides)}; expected {most:g} or "
            "less, an eighth of it: make the blur narrower, or the image larger"
        )
    return tuple(blurs)


def check_falling(blurs: Sequence[float]) -> None:
    """**Raises** `ValueError` unless the `blurs` of a fit fall."""
    if not len(blurs) or any(a <= b for a, b in itertools.pairwise(blurs)):
        raise ValueError(f"the blurs are {list(blurs)}; expected numbers that fall, such as [24, 3]")


@eqx.filter_jit
def blurred(images: Float[Array, "*n h w"], deviation: Scalar | float) -> Float[Array, "*n h w"]:
    """Images under a Gaussian with the standard `deviation` σ in pixels, 0 or more. Beyond their borders, images are 0.

    Its spectrum at f cycles per pixel is multiplied by the Gaussian's, exp(-2 π² σ² f²). One program therefore serves
    every σ, in the same time.
    """
    height, width = images.shape[-2:]
    # The padding keeps the blur from wrapping around to the opposite border.
    padding = math.ceil(REACH_OF_BLUR * widest_blur(height, width))
    sides: Any = tuple(next_fast_len(side + padding, real=True) for side in (height, width))
    gaussian = lambda frequency: jnp.exp(-2 * (math.pi * deviation * frequency) ** 2)
    rows, columns = gaussian(np.fft.fftfreq(sides[0])), gaussian(np.fft.rfftfreq(sides[1]))
    spectrum = jnp.fft.rfft2(images, s=sides) * rows[:, None] * columns
    return jnp.fft.irfft2(spectrum, s=sides)[..., :height, :width].astype(images.dtype)
