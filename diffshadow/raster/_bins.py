"""Sorting triangles by the size of their pixel boxes.

A triangle whose box holds no pixel centre, that faces a culled way or lies outside the frustum is dropped before any
pixel is looked at; in a fine mesh that is most of them. The rest fall into size classes, so that each class is one
dense array of windows of the same size. Triangles too big for the largest class are cut into blocks.
"""

from typing import Literal, NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from .._misc import round_up_to_power_of_two
from .._types import ClipVertices, Faces, Resolution
from ._clip import FAN, clip_triangles, needs_clipping
from ._fixed import cross, first_centre, last_centre, snap

Cull = Literal["none", "back", "front"]

WINDOWS = (2, 4, 8, 16, 32)
"""Sides, in pixels, of the windows of the size classes."""
BLOCK = 16
"""Side, in pixels, of the blocks that bigger triangles are cut into."""

_LARGE = len(WINDOWS)
_NOTHING = -1


class Capacity(NamedTuple):
    """How many triangles of each kind a compiled rasterizer has room for; each 0 or a power of two.

    - `clipped`: triangles that cross the near plane or leave the guard band.
    - `windows`: triangles of each size class.
    - `large`: triangles too big for a window, and `blocks`, the blocks that they are cut into.

    `plan` counts what a scene needs. Capacities are part of a compiled function: a new one compiles anew.
    """

    clipped: int
    windows: tuple[int, ...]
    large: int
    blocks: int

    def grown_to(self, other: "Capacity") -> "Capacity":
        """The least capacity that holds what either holds."""
        windows = tuple(max(a, b) for a, b in zip(self.windows, other.windows, strict=True))
        return Capacity(
            max(self.clipped, other.clipped), windows, max(self.large, other.large), max(self.blocks, other.blocks)
        )


class Counts(eqx.Module):
    """How many triangles of each kind there are: what `Capacity` must hold."""

    clipped: Int[Array, ""]
    windows: Int[Array, " classes"]
    large: Int[Array, ""]
    blocks: Int[Array, ""]

    def capacity(self) -> Capacity:
        """Each count rounded up to a power of two."""
        return Capacity(
            round_up_to_power_of_two(int(self.clipped)),
            tuple(round_up_to_power_of_two(int(n)) for n in self.windows),
            round_up_to_power_of_two(int(self.large)),
            round_up_to_power_of_two(int(self.blocks)),
        )


class Triangles(eqx.Module):
    """Triangles in window space, those made by clipping behind the mesh's own.

    - `window`: (v, 3) window coordinates: x and y in pixels, not snapped, and depth.
    - `faces`: (n, 3) indices into them; `source`: (n,) the mesh's face that each is, or is a part of.
    - `size_class`: (n,) index into `WINDOWS`, `len(WINDOWS)` for a large triangle, -1 for one that draws nothing.
    - `blocks`: (n,) how many blocks the box of a large triangle touches, else 0.
    """

    window: Float[Array, "v 3"]
    faces: Int[Array, "n 3"]
    source: Int[Array, " n"]
    size_class: Int[Array, " n"]
    blocks: Int[Array, " n"]

    def counts(self, clipped: Int[Array, ""]) -> Counts:
        """How many triangles fall into each class."""
        windows = jnp.stack([jnp.sum(self.size_class == k) for k in range(len(WINDOWS))])
        return Counts(clipped, windows, jnp.sum(self.size_class == _LARGE), jnp.sum(self.blocks))

    def members(self, size_class: int, capacity: int) -> Int[Array, " capacity"]:
        """Indices of the triangles of a class, filled up with -1."""
        return compact(self.size_class == size_class, capacity)

    def boxes(self, member: Int[Array, " n"], resolution: Resolution) -> tuple[Int[Array, "n 2"], Int[Array, "n 2"]]:
        """The pixel boxes of the triangles `member`, as by `pixel_box`."""
        return pixel_box(snap(self.window[self.faces[member], :2]), resolution)


def compact(mask: Array, capacity: int) -> Int[Array, " capacity"]:
    """Indices where `mask` holds, in order, filled up with -1; those beyond `capacity` are dropped."""
    place = jnp.where(mask, jnp.cumsum(mask, dtype=jnp.int32) - 1, capacity)
    indices = jnp.arange(mask.shape[0], dtype=jnp.int32)
    return jnp.full(capacity, -1, jnp.int32).at[place].set(indices, mode="drop")


def to_window(clip: Float[Array, "*n 4"], resolution: Resolution) -> Float[Array, "*n 3"]:
    """Window coordinates (x and y in pixels, depth in [0, 1]) of clip coordinates; `w = 0` maps to 0."""
    height, width = resolution
    w = clip[..., 3:4]
    # By the reciprocal, and scaled before it is shifted, as graphics hardware does.
    ndc = clip[..., :3] * jnp.where(w == 0, 0, 1 / jnp.where(w == 0, 1, w))
    half = jnp.array([width / 2, height / 2, 0.5], dtype=clip.dtype)
    return ndc * half + half


def bin_triangles(
    clip: ClipVertices, faces: Faces, resolution: Resolution, cull: Cull, clip_capacity: int
) -> tuple[Triangles, Int[Array, ""]]:
    """Every triangle's size class, and how many triangles had to be clipped."""
    # Gather one code a corner: 6 bits for the frustum's planes, 1 for clipping.
    x, y, z, w = (clip[:, k] for k in range(4))
    outside = [x > w, x < -w, y > w, y < -w, z > w, z < -w, needs_clipping(clip, resolution)]
    codes = sum(side.astype(jnp.int32) << bit for bit, side in enumerate(outside))
    c0, c1, c2 = (codes[faces[:, k]] for k in range(3))
    visible = (c0 & c1 & c2 & 0b111111) == 0
    clipped = visible & (((c0 | c1 | c2) >> 6) != 0)

    window, drawn = to_window(clip, resolution), visible & ~clipped
    source = jnp.arange(faces.shape[0], dtype=jnp.int32)
    if clip_capacity:
        chosen = compact(clipped, clip_capacity)
        parts = clip_triangles(clip[faces[chosen]], resolution).reshape(-1, 4)
        new_faces = clip.shape[0] + jnp.arange(parts.shape[0], dtype=jnp.int32).reshape(-1, 3)
        window = jnp.concatenate([window, to_window(parts, resolution)])
        faces = jnp.concatenate([faces, new_faces])
        source = jnp.concatenate([source, jnp.repeat(chosen, FAN)])
        drawn = jnp.concatenate([drawn, jnp.repeat(chosen >= 0, FAN)])
    size_class, blocks = _classify(snap(window[:, :2]), faces, drawn, resolution, cull)
    return Triangles(window, faces, source, size_class, blocks), jnp.sum(clipped)


def pixel_box(xy: Int[Array, "n 3 2"], resolution: Resolution) -> tuple[Int[Array, "n 2"], Int[Array, "n 2"]]:
    """First and last (x, y) pixel whose centre a triangle's bounding box holds, cut to the viewport."""
    height, width = resolution
    low = jnp.maximum(first_centre(xy.min(axis=1)), 0)
    high = jnp.minimum(last_centre(xy.max(axis=1)), jnp.array([width - 1, height - 1], dtype=jnp.int32))
    return low, high


def _classify(fixed: Array, faces: Array, drawn: Array, resolution: Resolution, cull: Cull) -> tuple[Array, Array]:
    corners = fixed[faces]
    a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    area = cross(a[:, 0], a[:, 1], b[:, 0], b[:, 1])
    facing = {"none": area != 0, "back": area > 0, "front": area < 0}[cull]
    low, high = pixel_box(corners, resolution)
    size = jnp.max(high - low, axis=-1) + 1
    kept = drawn & facing & jnp.all(low <= high, axis=-1)
    size_class = sum((size > side).astype(jnp.int32) for side in WINDOWS)
    tiles = jnp.prod(high // BLOCK - low // BLOCK + 1, axis=-1)
    blocks = jnp.where(kept & (size_class == _LARGE), tiles, 0)
    return jnp.where(kept, size_class, _NOTHING).astype(jnp.int32), blocks
