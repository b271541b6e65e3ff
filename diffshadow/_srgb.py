"""The colour encoding of common image files: sRGB (IEC 61966-2-1)."""

from typing import Any

from ._arithmetic import array_module


def to_srgb(linear: Any) -> Any:
    """The transfer function of sRGB, from linear colours in [0, 1] to the same range, of any shape.

    Uses NumPy, or JAX if `linear` is traced.
    """
    xp = array_module(linear)
    is_dark = linear <= 0.0031308
    # The power has no derivative at 0.
    return xp.where(is_dark, 12.92 * linear, 1.055 * xp.where(is_dark, 1, linear) ** (1 / 2.4) - 0.055)


def from_srgb(encoded: Any) -> Any:
    """The inverse of `to_srgb`."""
    xp = array_module(encoded)
    return xp.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)
