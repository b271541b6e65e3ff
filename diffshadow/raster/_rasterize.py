"""The rasterizer: which triangle each pixel sees."""

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, Int

from .._types import ClipVertices, DepthMap, FaceMap, Faces, Resolution
from ._bins import BLOCK, WINDOWS, Capacity, Counts, Cull, Triangles, bin_triangles, pixel_box
from ._coverage import edge_form, window_depth

NO_FACE = -1
"""What a pixel that sees nothing holds in a face map."""

_INDEX_OF_NOTHING = jnp.iinfo(jnp.int32).max


class Fragments(eqx.Module):
    """What each pixel sees; row 0 is the bottom row. Neither field carries a gradient: `interpolate` does.

    - `face`: (h, w), index of the nearest face, `NO_FACE` where there is none.
    - `depth`: (h, w), its window depth, 1 where there is none.
    """

    face: FaceMap
    depth: DepthMap


def plan(clip: ClipVertices, faces: Faces, resolution: Resolution, *, cull: Cull = "none") -> Capacity:
    """The capacity that drawing these triangles needs, each number rounded up to a power of two.

    **Arguments:** as for `rasterize`; not for use inside `jax.jit`.
    """
    capacity = Capacity(0, (0,) * len(WINDOWS), 0, 0)
    counts = _count(clip, faces, resolution, cull, 0)
    if int(counts.clipped):
        capacity = counts.capacity()
        counts = _count(clip, faces, resolution, cull, capacity.clipped)
    return counts.capacity()


def rasterize(
    clip: ClipVertices,
    faces: Faces,
    resolution: Resolution,
    *,
    cull: Cull = "none",
    capacity: Capacity | None = None,
) -> Fragments:
    """The nearest face at every pixel centre, by OpenGL's rules.

    Triangles snap to 1/256 pixel, shared edges are covered exactly once, what lies before the near plane or beyond
    the far plane is cut away, and of two faces at the same depth the one with the lower index is seen.

    **Arguments:**

    - `clip`: (v, 4), vertices in OpenGL clip space; `w` may have either sign.
    - `faces`: (f, 3), indices into `clip`; anticlockwise in the window is a front face.
    - `resolution`: (height, width) in pixels, each at most 8192.
    - `cull`: which faces are left out.
    - `capacity`: room for the triangles of each size. Left out, they are counted first, which needs concrete
        arguments; inside `jax.jit` it must be given, by `plan`.

    **Raises** `ValueError` where `capacity` is left out under a trace, and a runtime error that names the capacity
    that is too small: no triangle is ever dropped in silence.
    """
    clip, faces = lax.stop_gradient(clip), lax.stop_gradient(faces)
    if capacity is None:
        if isinstance(clip, jax.core.Tracer) or isinstance(faces, jax.core.Tracer):
            raise ValueError(
                "rasterize was called inside jax.jit (or grad, or vmap) without a capacity; expected one, since shapes "
                "must be known there: call plan(clip, faces, resolution) outside on typical values and pass its result"
            )
        capacity = plan(clip, faces, resolution, cull=cull)
    return _rasterize(clip, faces, resolution, cull, capacity)


@partial(jax.jit, static_argnums=(2, 3, 4))
def _count(clip: ClipVertices, faces: Faces, resolution: Resolution, cull: Cull, clip_capacity: int) -> Counts:
    triangles, clipped = bin_triangles(clip, faces, resolution, cull, clip_capacity)
    return triangles.counts(clipped)


@partial(jax.jit, static_argnums=(2, 3, 4))
def _rasterize(clip: ClipVertices, faces: Faces, resolution: Resolution, cull: Cull, capacity: Capacity) -> Fragments:
    triangles, clipped = bin_triangles(clip, faces, resolution, cull, capacity.clipped)
    batches = _window_batches(triangles, resolution, capacity) + _block_batches(triangles, resolution, capacity)

    height, width = resolution
    margin = max(WINDOWS)
    padded = (height + margin, width + margin)
    depth = jnp.full(padded, jnp.inf, clip.dtype)
    for corner, z, _ in batches:
        depth = lax.scatter_min(depth, corner, z, _WINDOW_SCATTER, mode=lax.GatherScatterMode.PROMISE_IN_BOUNDS)
    face = jnp.full(padded, _INDEX_OF_NOTHING, jnp.int32)
    for corner, z, source in batches:
        settled = lax.gather(depth, corner, _WINDOW_GATHER, z.shape[1:], mode=lax.GatherScatterMode.PROMISE_IN_BOUNDS)
        won = jnp.where((z == settled) & (z < jnp.inf), source[:, None, None], _INDEX_OF_NOTHING)
        face = lax.scatter_min(face, corner, won, _WINDOW_SCATTER, mode=lax.GatherScatterMode.PROMISE_IN_BOUNDS)
    depth, face = depth[:height, :width], face[:height, :width]
    seen = face != _INDEX_OF_NOTHING
    fragments = Fragments(jnp.where(seen, face, NO_FACE), jnp.where(seen, depth, 1))
    return _check_capacity(fragments, triangles.counts(clipped), capacity)


_WINDOW_SCATTER = lax.ScatterDimensionNumbers(
    update_window_dims=(1, 2), inserted_window_dims=(), scatter_dims_to_operand_dims=(0, 1)
)
_WINDOW_GATHER = lax.GatherDimensionNumbers(offset_dims=(1, 2), collapsed_slice_dims=(), start_index_map=(0, 1))

_Batch = tuple[Int[Array, "n 2"], Float[Array, "n s s"], Int[Array, " n"]]
"""Windows to write: (row, column) of their lower left corner, depths, and face."""


def _window_batches(triangles: Triangles, resolution: Resolution, capacity: Capacity) -> list[_Batch]:
    batches = []
    for size_class, (side, room) in enumerate(zip(WINDOWS, capacity.windows, strict=True)):
        if room:
            member = triangles.members(size_class, room)
            corners = triangles.faces[member]
            xy, z = triangles.fixed[corners], triangles.depth[corners]
            pixel, _ = pixel_box(xy, resolution)
            pixel = jnp.where((member >= 0)[:, None], pixel, 0)
            depth = window_depth(edge_form(xy, z, pixel), member >= 0, side)
            batches.append((pixel[:, ::-1], depth, triangles.source[member]))
    return batches


def _block_batches(triangles: Triangles, resolution: Resolution, capacity: Capacity) -> list[_Batch]:
    if not capacity.blocks:
        return []
    member = triangles.members(len(WINDOWS), capacity.large)
    # Number the blocks of all large triangles through: block p belongs to the triangle whose run holds p.
    lengths = jnp.where(member >= 0, triangles.blocks[member], 0)
    starts = jnp.cumsum(lengths) - lengths
    total = jnp.sum(lengths)
    marks = jnp.zeros(capacity.blocks, jnp.int32).at[jnp.where(lengths > 0, starts, capacity.blocks)]
    owner = jnp.cumsum(marks.add(1, mode="drop")) - 1
    block = jnp.arange(capacity.blocks, dtype=jnp.int32)
    used = block < total

    corners = triangles.faces[member]
    xy = triangles.fixed[corners]
    low, high = pixel_box(xy, resolution)
    first = low // BLOCK
    columns = (high // BLOCK - first + 1)[:, 0]
    within = block - starts[owner]
    tile = first[owner] + jnp.stack([within % columns[owner], within // columns[owner]], axis=-1)
    pixel = jnp.where(used[:, None], tile * BLOCK, 0)
    form = edge_form(xy[owner], triangles.depth[corners][owner], pixel)
    depth = window_depth(form, used, BLOCK)
    return [(pixel[:, ::-1], depth, triangles.source[member][owner])]


def _check_capacity(fragments: Fragments, counts: Counts, capacity: Capacity) -> Fragments:
    # Checked on the result: triangles for which there is no room at all are not read, and their check with them.
    checks = [("clipped", counts.clipped, capacity.clipped)]
    checks += [
        (f"windows[{k}] ({side} x {side} pixels)", counts.windows[k], room)
        for k, (side, room) in enumerate(zip(WINDOWS, capacity.windows, strict=True))
    ]
    checks += [("large", counts.large, capacity.large), ("blocks", counts.blocks, capacity.blocks)]
    messages = [
        f"the rasterizer's capacity.{name} of {room} is too small for these triangles, and none may be dropped; "
        "expected at least as many as there are: call plan(...) on them, or give a larger Capacity"
        for name, _, room in checks
    ]
    # Clipping comes first, since without room for it the other counts are too low.
    short = jnp.stack([count > room for _, count, room in checks])
    return eqx.branched_error_if(fragments, jnp.any(short), jnp.argmax(short), messages)
