"""Sorting triangles by the size of their pixel boxes.

A triangle whose box holds no pixel centre, that faces a culled way or lies outside the frustum is dropped before any
pixel is looked at; in a fine mesh that is most of them. The rest fall into size classes, so that each class is one
dense array of windows of the same size. Triangles too big for the largest window are cut into blocks.

Corners are kept as an array of its own for each coordinate of each corner: that is what vectorizes.
"""

from collections.abc import Sequence
from typing import Literal, NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from .._misc import round_up_to_power_of_two, take
from .._types import ClipVertices, Faces
from ._clip import FAN, clip_triangles, needs_clipping
from ._compact import Ranks, compact, rank_in_class
from ._fixed import Size, first_centre, last_centre, signed_area, snap

Cull = Literal["none", "back", "front"]

WINDOWS = (2, 4, 8, 16, 32)
"""Sides, in pixels, of the windows of the size classes."""
LARGE = len(WINDOWS)
"""The size class of triangles too big for a window."""
BLOCK = 16
"""Side, in pixels, of the blocks that those are cut into."""

_NOTHING = -1
# Small capacities are rounded up to these. Loops end with the last window in use, so that the rest costs little.
_ROUND_NUMBERS = (0, 256, 4096)
# In the windows of a larger class, so many pixels are looked at in less time than a loop of their own takes to compile.
_FEW_PIXELS = 1 << 16


class Capacity(NamedTuple):
    """How many triangles of each kind a compiled rasterizer can draw; each 0 or a power of two.

    - `clipped`: triangles that cross the near plane or leave the guard band.
    - `windows`: triangles of each size class. A class of capacity 0 passes its triangles on to the next larger one:
        each class takes time to compile, so a few small triangles had better share a larger window.
    - `large`: triangles too big for a window; `candidates`, the blocks that their boxes touch; and `blocks`, those
        among them that the triangles themselves may touch.

    `plan` counts what a scene needs. Capacities are part of a compiled function: a new one compiles anew.
    """

    clipped: int = 0
    windows: tuple[int, ...] = (0,) * len(WINDOWS)
    large: int = 0
    candidates: int = 0
    blocks: int = 0

    def grown_to(self, other: "Capacity") -> "Capacity":
        """The least capacity that surely holds what either holds."""
        capacity = {k: max(self._capacity_from(k), other._capacity_from(k)) for k in {*self.classes, *other.classes}}
        return Capacity(
            clipped=max(self.clipped, other.clipped),
            windows=tuple(capacity.get(k, 0) for k in range(LARGE)),
            large=max(self.large, other.large),
            candidates=max(self.candidates, other.candidates),
            blocks=max(self.blocks, other.blocks),
        )

    @property
    def classes(self) -> tuple[int, ...]:
        """The size classes whose capacity is not 0."""
        return tuple(k for k, capacity in enumerate(self.windows) if capacity)

    def _capacity_from(self, size_class: int) -> int:
        """Capacity for triangles of a size class, in its windows or in larger ones."""
        return next((capacity for capacity in self.windows[size_class:] if capacity), self.large)


class Counts(eqx.Module):
    """How many triangles and blocks of each kind there are: what a `Capacity` must hold."""

    clipped: Int[Array, ""]
    windows: Int[Array, " classes"]
    large: Int[Array, ""]
    candidates: Int[Array, ""]
    blocks: Int[Array, ""]

    def capacity(self) -> Capacity:
        """Each count rounded up, so that like scenes share what is compiled; a few small triangles share the windows
        of larger ones."""
        windows = [int(n) for n in self.windows]
        for k in range(LARGE - 1):
            larger = next((j for j in range(k + 1, LARGE) if windows[j]), LARGE - 1)
            if windows[k] * WINDOWS[larger] ** 2 <= _FEW_PIXELS:
                windows[k], windows[larger] = 0, windows[k] + windows[larger]
        large, candidates, blocks = (_rounded_up(int(n)) for n in (self.large, self.candidates, self.blocks))
        return Capacity(_rounded_up(int(self.clipped)), tuple(map(_rounded_up, windows)), large, candidates, blocks)


def _rounded_up(number: int) -> int:
    return next((capacity for capacity in _ROUND_NUMBERS if number <= capacity), round_up_to_power_of_two(number))


class Corners(NamedTuple):
    """Corners of triangles in window coordinates: `x`, `y` in pixels, not snapped, and depth `z`; three (n,) each."""

    x: list[Float[Array, " n"]]
    y: list[Float[Array, " n"]]
    z: list[Float[Array, " n"]]

    def snapped(self) -> tuple[list[Int[Array, " n"]], list[Int[Array, " n"]]]:
        """x and y in sub-pixels."""
        return [snap(x) for x in self.x], [snap(y) for y in self.y]


class Box(NamedTuple):
    """First and last pixel whose centre a triangle's bounding box holds, within the viewport; each (n,)."""

    left: Int[Array, " n"]
    bottom: Int[Array, " n"]
    right: Int[Array, " n"]
    top: Int[Array, " n"]


class Triangles(eqx.Module):
    """Triangles in window space, those made by clipping behind the mesh's own.

    - `x`, `y`, `z`: (v,) window coordinates of the vertices, not snapped.
    - `faces`: (n, 3) indices into them; `source`: (n,) the mesh's face that each is, or is a part of.
    - `size_class`: (n,) index into `WINDOWS`, `LARGE` for a large triangle, -1 for one that draws nothing.
    - `ranks`: each one's place among those of its class.
    - `clipped`: how many of the mesh's faces had to be clipped.
    """

    x: Float[Array, " v"]
    y: Float[Array, " v"]
    z: Float[Array, " v"]
    faces: Int[Array, "n 3"]
    source: Int[Array, " n"]
    size_class: Int[Array, " n"]
    ranks: Ranks
    clipped: Int[Array, ""]

    def corners(self, member: Int[Array, " m"]) -> Corners:
        """The corners of the triangles `member`."""
        vertices = [take(self.faces[:, k], member) for k in range(3)]
        return Corners(*([take(values, vertex) for vertex in vertices] for values in (self.x, self.y, self.z)))


def to_window(clip: Float[Array, "n 4"], resolution: Size) -> tuple[Array, Array, Array]:
    """Window x and y in pixels and depth in [0, 1] of clip coordinates, each (n,); `w = 0` maps to the middle."""
    height, width = resolution
    w = clip[:, 3]
    # By the reciprocal, and scaled before it is shifted, as graphics hardware does.
    inverse = jnp.where(w == 0, 0, 1 / jnp.where(w == 0, 1, w))
    scaled = lambda k, half: clip[:, k] * inverse * half + half
    return scaled(0, width / 2), scaled(1, height / 2), scaled(2, 0.5)


def pixel_box(x: Sequence[Int[Array, " n"]], y: Sequence[Int[Array, " n"]], resolution: Size) -> Box:
    """The pixel box of triangles whose three corners are at fixed-point `x` and `y`."""
    height, width = resolution
    least = lambda values: jnp.minimum(jnp.minimum(values[0], values[1]), values[2])
    greatest = lambda values: jnp.maximum(jnp.maximum(values[0], values[1]), values[2])
    return Box(
        jnp.maximum(first_centre(least(x)), 0),
        jnp.maximum(first_centre(least(y)), 0),
        jnp.minimum(last_centre(greatest(x)), width - 1),
        jnp.minimum(last_centre(greatest(y)), height - 1),
    )


def bin_triangles(
    clip: ClipVertices, faces: Faces, resolution: Size, cull: Cull, clip_capacity: int, classes: Sequence[int]
) -> Triangles:
    """Every triangle and its size class, which is one of `classes`, or `LARGE`."""
    visible, clipped = _sides(clip, faces, resolution)
    # Without the barrier the compiler computes each vertex anew for every corner that gathers it.
    x, y, z = lax.optimization_barrier(to_window(clip, resolution))
    source, drawn = jnp.arange(faces.shape[0], dtype=jnp.int32), visible & ~clipped
    if clip_capacity:
        chosen = compact(clipped, clip_capacity)
        parts = clip_triangles(clip[faces[chosen]], resolution).reshape(-1, 4)
        new_faces = clip.shape[0] + jnp.arange(parts.shape[0], dtype=jnp.int32).reshape(-1, 3)
        x, y, z = (jnp.concatenate(both) for both in zip((x, y, z), to_window(parts, resolution), strict=True))
        faces = jnp.concatenate([faces, new_faces])
        source = jnp.concatenate([source, jnp.repeat(chosen, FAN)])
        drawn = jnp.concatenate([drawn, jnp.repeat(chosen >= 0, FAN)])
    fixed_x, fixed_y = lax.optimization_barrier((snap(x), snap(y)))
    size_class = lax.optimization_barrier(_classify(fixed_x, fixed_y, faces, drawn, resolution, cull, classes))
    ranks = rank_in_class(size_class, LARGE + 1)
    return Triangles(x, y, z, faces, source, size_class, ranks, jnp.sum(clipped))


def _sides(clip: ClipVertices, faces: Faces, resolution: Size) -> tuple[Bool[Array, " f"], Bool[Array, " f"]]:
    """Which faces may be seen at all, and which of those need clipping."""
    x, y, z, w = (clip[:, k] for k in range(4))
    # One code a vertex, and so one gather a corner: 6 bits for the frustum's planes, 1 for clipping.
    tests = [x > w, x < -w, y > w, y < -w, z > w, z < -w, needs_clipping(clip, resolution)]
    codes = lax.optimization_barrier(sum(test.astype(jnp.int32) << bit for bit, test in enumerate(tests)))
    first, second, third = (take(codes, faces[:, k]) for k in range(3))
    visible = (first & second & third & 0b111111) == 0
    return visible, visible & (((first | second | third) >> 6) != 0)


def _classify(
    x: Int[Array, " v"],
    y: Int[Array, " v"],
    faces: Faces,
    drawn: Array,
    resolution: Size,
    cull: Cull,
    classes: Sequence[int],
) -> Int[Array, " f"]:
    xs, ys = ([take(values, faces[:, k]) for k in range(3)] for values in (x, y))
    area = signed_area(xs, ys)
    facing = {"none": area != 0, "back": area > 0, "front": area < 0}[cull]
    box = pixel_box(xs, ys, resolution)
    size = jnp.maximum(box.right - box.left, box.top - box.bottom) + 1
    kept = drawn & facing & (box.left <= box.right) & (box.bottom <= box.top)
    size_class = jnp.full_like(size, LARGE)
    for k in sorted(classes, reverse=True):
        size_class = jnp.where(size <= WINDOWS[k], k, size_class)
    return jnp.where(kept, size_class, _NOTHING)
