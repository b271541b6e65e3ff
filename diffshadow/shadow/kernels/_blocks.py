"""Images cut into the tiles of a pattern."""

import math

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array

# Pixels of a row in two SIMD vectors.
_VECTOR = 16


class Blocks(eqx.Module):
    """An image cut into the tiles of a pattern, without moving anything in memory.

    An image (h, w) becomes (h / rows, rows, w / columns, columns), so that a table (rows, 1, columns) broadcasts to all
    tiles. Tiles narrower than a vector are repeated.
    """

    shape: tuple[int, int] = eqx.field(static=True)
    rows: int = eqx.field(static=True)
    columns: int = eqx.field(static=True)

    @classmethod
    def of(cls, shape: tuple[int, ...], tile: int = 1) -> "Blocks":
        height, width = shape
        return cls((height, width), tile, tile * math.ceil(_VECTOR / tile))

    @property
    def _padding(self) -> tuple[tuple[int, int], tuple[int, int]]:
        height, width = self.shape
        return (0, -height % self.rows), (0, -width % self.columns)

    def cut(self, image: Array) -> Array:
        # Pixels that pad the last blocks are copies of actual ones, so evaluating them is harmless.
        padded = jnp.pad(image, self._padding, mode="edge") if any(after for _, after in self._padding) else image
        height, width = padded.shape
        return padded.reshape(height // self.rows, self.rows, width // self.columns, self.columns)

    def join(self, blocks: Array) -> Array:
        height, width = self.shape
        return blocks.reshape(blocks.shape[0] * self.rows, -1)[:height, :width]
