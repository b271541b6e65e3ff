"""Means of compares over the taps of engines' filters."""

import math
from collections.abc import Callable
from typing import Any, Literal

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from ..._arithmetic import as_float
from ..._types import HostArray
from ..filters._castano import CASTANO_KERNELS
from ._textures import bilinear

Compared = Callable[[Array], Array]
"""The result of the compare with the receiver, for each stored value."""
TentSize = Literal[1, 3, 5]
"""The width of a tent in texels; 1 for a single bilinear compare."""


def same(x: Array) -> Array:
    return x


def mean_of(tap: Compared, taps: HostArray, shape: tuple[int, ...]) -> Array:
    """The mean of `tap` over `taps` (n, d). Results of `tap` have the shape `shape`."""
    add = lambda total, at: (total + tap(at), None)
    return lax.scan(add, jnp.zeros(shape), as_float(taps))[0] / len(taps)


def tent(
    depth: Float[Array, "m m"],
    u: Float[Array, "h w"],
    v: Float[Array, "h w"],
    compared: Compared,
    size: TentSize,
) -> Float[Array, "h w"]:
    """The mean of 1, 4 or 9 bilinear compares, weighted by a tent (Castaño, "Shadow mapping summary", 2013)."""
    if size == 1:
        return bilinear(depth, u, v, compared)
    across = depth.shape[-1]
    (weights_x, places_x), (weights_y, places_y) = (_tent_taps(at * across + 0.5, size) for at in (u, v))
    count = len(weights_x)

    def add(total: Array, k: Array) -> tuple[Array, None]:
        i, j = k % count, k // count
        tap = bilinear(depth, places_x[i] / across, places_y[j] / across, compared)
        return total + weights_x[i] * weights_y[j] * tap, None

    total = lax.scan(add, jnp.zeros_like(u), jnp.arange(count * count, dtype=jnp.int32))[0]
    return total / (16 if size == 3 else 144)


def _tent_taps(at: Float[Array, "h w"], size: TentSize) -> tuple[Float[Array, "k h w"], Float[Array, "k h w"]]:
    """Weights and positions, in texels, of the taps along one axis."""
    whole = jnp.floor(lax.stop_gradient(at))
    s = at - whole
    weights: list[Any]
    if size == 3:
        weights = [3 - 2 * s, 1 + 2 * s]
        offsets = [(2 - s) / weights[0] - 1, s / weights[1] + 1]
    else:
        weights = [4 - 3 * s, jnp.full_like(s, 7), 1 + 3 * s]
        offsets = [(3 - 2 * s) / weights[0] - 2, (3 + s) / 7, s / weights[2] + 2]
    return jnp.stack(weights), jnp.stack([whole - 0.5 + offset for offset in offsets])


def castano_radius(size: int) -> float:
    """The radius in texels of a disk with the same standard deviation as Castaño's kernel of `size` texels."""
    weights = CASTANO_KERNELS.get(size, (1,))
    squares = sum(weight * (i - size // 2) ** 2 for i, weight in enumerate(weights))
    # A disk's standard deviation along an axis is half its radius.
    return 2 * math.sqrt(squares / sum(weights))
