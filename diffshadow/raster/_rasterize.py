"""The rasterizer: which triangle each pixel sees."""

import itertools
from collections.abc import Iterator
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.core import Tracer
from jaxtyping import Array, Bool, Float, Int

from .._misc import as_float, as_int
from .._types import ClipVertices, Faces, Resolution
from ._bins import LARGE, WINDOWS, Capacity, Counts, Cull, bin_triangles
from ._depth_test import DepthTest
from ._fixed import Size
from ._windows import Windows, count, find_candidates, set_up_windows, write_depth, write_depth_and_face

# The least capacity with which parts are counted, which is enough for most scenes.
_PARTS = Capacity(clipped=256, large=256, candidates=1 << 16)
# Meshes of up to so many faces are padded: filling up a larger one takes time that counts beside drawing it.
_MOST_PADDED = 1 << 16
_LEAST_PADDED = 64
# Faces that are counted at once.
_CHUNK = 1 << 14
# The frustum rejects it.
_OUTSIDE = (0, 0, 2, 1)
NO_FACE = -1
"""What a pixel that sees nothing holds in a face map."""
Overflow = Bool[Array, ""]
"""Whether a capacity was too small, and something is missing from what was drawn."""


class Fragments(eqx.Module):
    """What each pixel sees; row 0 is the bottom row. Neither field carries a gradient: `interpolate` does.

    - `face`: (h, w), index of the nearest face, `NO_FACE` where there is none.
    - `depth`: (h, w), its window depth as the depth buffer holds it, the clear value where there is none.

    Of several views drawn at once, (b, h, w).
    """

    face: Int[Array, "*b h w"]
    depth: Float[Array, "*b h w"]


def plan(clip: Float[Array, "*b v 4"], faces: Faces, resolution: Resolution, *, cull: Cull = "none") -> Capacity:
    """The capacity that drawing these triangles needs, each number rounded up, so that like scenes share what is
    compiled.

    **Arguments:** as for `rasterize`; not for use inside `jax.jit`. Of several views it holds the greatest need.
    """
    clip, size = clip.astype(jnp.float32).reshape(-1, *clip.shape[-2:]), as_int(resolution)
    chunks = [list(_chunks(view, faces)) for view in clip]
    # Parts of clipped and of large triangles are counted up to a capacity of their own.
    capacity = _PARTS
    combined = lambda reduce, counts: jax.tree.map(lambda *each: reduce(np.stack(each), axis=0), *counts)
    while True:
        counted = [[_count(*chunk, size, cull, capacity) for chunk in view] for view in chunks]
        fullest = combined(np.max, itertools.chain(*counted)).capacity()
        # Windows and blocks are counted without a capacity: the compiled program does not depend on their number.
        parts = fullest._replace(windows=capacity.windows, blocks=capacity.blocks)
        if capacity == capacity.grown_to(parts):
            return combined(np.max, [combined(np.sum, view) for view in counted]).capacity()
        capacity = capacity.grown_to(parts)


def _chunks(clip: ClipVertices, faces: Faces) -> Iterator[tuple[ClipVertices, Faces]]:
    """The triangles in chunks of one size, which share a compiled program whatever the mesh; a large mesh as it is."""
    if faces.shape[0] > _MOST_PADDED:
        yield clip, faces
        return
    corners = np.asarray(clip)[np.asarray(faces)].reshape(-1, 4)
    step = 3 * _CHUNK
    for start in range(0, max(len(corners), 1), step):
        chunk = np.full((step, 4), _OUTSIDE, corners.dtype)
        part = corners[start : start + step]
        chunk[: len(part)] = part
        yield jnp.asarray(chunk), jnp.arange(step, dtype=jnp.int32).reshape(-1, 3)


def padded(clip: Float[Array, "*b v 4"], faces: Faces) -> tuple[Float[Array, "*b V 4"], Int[Array, "F 3"]]:
    """The triangles and others behind them that are never seen, so that meshes of like size share what is compiled.

    Traced ones stay as they are: their program is the caller's.
    """
    count, vertices = faces.shape[0], clip.shape[-2]
    if count > _MOST_PADDED or isinstance(clip, Tracer) or isinstance(faces, Tracer):
        return clip, faces
    # In NumPy, whose copies need no compiling.
    more_faces = np.full((_padded_size(count), 3), vertices, np.asarray(faces).dtype)
    more_faces[:count] = faces
    more = np.empty((*clip.shape[:-2], _padded_size(vertices + 1), 4), np.asarray(clip).dtype)
    more[..., :vertices, :] = clip
    more[..., vertices:, :] = _OUTSIDE
    return jnp.asarray(more), jnp.asarray(more_faces)


def _padded_size(number: int) -> int:
    """The next power of two; of small numbers, every second one."""
    power = max(number - 1, _LEAST_PADDED - 1).bit_length()
    return 1 << (power + power % 2 if number <= 4096 else power)


def rasterize(
    clip: Float[Array, "*b v 4"],
    faces: Faces,
    resolution: Resolution,
    *,
    cull: Cull = "none",
    depth_test: DepthTest | None = None,
    polygon_offset: Any = None,
    behind: Int[Array, "*b h w"] | None = None,
    capacity: Capacity | None = None,
    overflows: list[Overflow] | None = None,
) -> Fragments:
    """The nearest face at every pixel centre, by OpenGL's rules.

    Triangles snap to 1/256 pixel, shared edges are covered exactly once, and what lies before the near plane or
    beyond the far plane is cut away.

    **Arguments:**

    - `clip`: (v, 4), vertices in OpenGL clip space; `w` may have either sign. With a leading axis, (b, v, 4), several
        views are drawn at once, and every result has that axis too.
    - `faces`: (f, 3), indices into `clip`; anticlockwise in the window is a front face.
    - `resolution`: (height, width) in pixels, each at most 8192.
    - `cull`: which faces are left out.
    - `depth_test`: format, comparison and clear value of the depth buffer; float32, `"less"` and 1 if left out.
    - `polygon_offset`: (factor, units) of OpenGL's polygon offset, or none.
    - `behind`: (h, w), a face map: at each pixel its face is passed over. Given the result of a first call, the
        second-nearest layer is drawn.
    - `capacity`: how many triangles of each size can be drawn. Left out, they are counted first, which needs concrete
        arguments; inside `jax.jit` it must be given, by `plan`.
    - `overflows`: a list that is appended whether the capacity is too small, (), instead of an error. Triangles are
        missing from the result then: it is for callers that throw it away and draw again.

    **Raises** `ValueError` for a resolution or depth test out of range, or where `capacity` is left out under a
    trace; and, without `overflows`, a runtime error that names the capacity that is too small: no triangle is ever
    dropped in silence.
    """
    return _draw(clip, faces, resolution, cull, depth_test, polygon_offset, behind, capacity, True, overflows)


def rasterize_depth(
    clip: Float[Array, "*b v 4"],
    faces: Faces,
    resolution: Resolution,
    *,
    cull: Cull = "none",
    depth_test: DepthTest | None = None,
    polygon_offset: Any = None,
    capacity: Capacity | None = None,
    overflows: list[Overflow] | None = None,
) -> Float[Array, "*b h w"]:
    """The depth buffer alone, (h, w): `rasterize(...).depth`, in less time. It carries no gradient."""
    return _draw(clip, faces, resolution, cull, depth_test, polygon_offset, None, capacity, False, overflows)


def _draw(clip, faces, resolution, cull, test, polygon_offset, behind, capacity, with_face, overflows) -> Any:
    test = test or DepthTest()
    test.check()
    if not all(1 <= n <= 8192 for n in resolution):
        raise ValueError(f"the resolution is {resolution}; expected (height, width), each from 1 to 8192 pixels")
    # The search is integer work and single precision whatever the precision of what is interpolated later.
    clip, faces = lax.stop_gradient(clip).astype(jnp.float32), lax.stop_gradient(faces)
    if capacity is None and (isinstance(clip, Tracer) or isinstance(faces, Tracer)):
        raise ValueError(
            "rasterize was called inside jax.jit (or grad, or vmap) without a capacity; expected one, since shapes "
            "must be known there: call plan(clip, faces, resolution) outside on typical values and pass its result"
        )
    if capacity is None:
        capacity = plan(clip, faces, resolution, cull=cull)
    clip, faces = padded(clip, faces)
    if polygon_offset is not None:
        polygon_offset = lax.stop_gradient(as_float(polygon_offset)).astype(jnp.float32)
    checked = overflows is None
    drawn, overflow = _rasterize(
        clip, faces, resolution, cull, test, polygon_offset, behind, capacity, with_face, checked
    )
    if overflows is not None:
        overflows.append(overflow)
    return drawn


@eqx.filter_jit
def _count(clip: ClipVertices, faces: Faces, resolution: Size, cull: Cull, capacity: Capacity) -> Counts:
    triangles = bin_triangles(clip, faces, resolution, cull, capacity.clipped, range(LARGE))
    return count(triangles, find_candidates(triangles, resolution, capacity))


@eqx.filter_jit
def _rasterize(
    clip, faces, resolution, cull, test, polygon_offset, behind, capacity, with_face, checked
) -> tuple[Fragments | Float[Array, "*b h w"], Overflow]:
    """What is drawn, and whether triangles are missing, which is an error if it is `checked`."""

    def prepare(clip: Array) -> tuple[Windows, Counts]:
        triangles = bin_triangles(clip, faces, resolution, cull, capacity.clipped, capacity.classes)
        found = find_candidates(triangles, resolution, capacity)
        return set_up_windows(triangles, found, resolution, capacity, test, polygon_offset), count(triangles, found)

    def write(ready: Windows, behind: Array | None, empty: tuple[Array, Array]) -> Fragments | Array:
        no_face, clear = empty
        decoded = lambda depth: jnp.where(depth < jnp.inf, test.decode(depth), clear)
        if not with_face:
            return decoded(write_depth(ready, resolution, test))
        depth, face = write_depth_and_face(ready, resolution, test, behind)
        return Fragments(jnp.where(face < 0, no_face, face), decoded(depth))

    def empty(counts: Counts) -> tuple[Array, Array]:
        return empty_within_capacity(counts, capacity, test) if checked else _empty(test)

    if clip.ndim == 2:
        ready, counts = prepare(clip)
        return write(ready, behind, empty(counts)), jnp.any(_exceeds(counts, capacity))
    ready, counts = jax.vmap(prepare)(clip)
    # As many chunks for each view as the fullest needs: a loop of one length can run over all views together.
    used, counts = jax.tree.map(lambda n: n.max(axis=0), (ready.used, counts))
    ready = eqx.tree_at(lambda ready: ready.used, ready, used)
    axes = eqx.tree_at(lambda ready: ready.used, jax.tree.map(lambda _: 0, ready), None)
    views = jax.vmap(write, in_axes=(axes, None if behind is None else 0, None))
    return views(ready, behind, empty(counts)), jnp.any(_exceeds(counts, capacity))


def _empty(test: DepthTest) -> tuple[Array, Array]:
    """Face and depth of a pixel that sees nothing."""
    return jnp.int32(NO_FACE), jnp.float32(test.clear)


# Clipping and large triangles come before their parts, whose counts are too low if their own capacity is too small.
_KINDS = ("clipped", "large", "candidates", "blocks")


def _exceeds(counts: Counts, capacity: Capacity) -> Bool[Array, " k"]:
    """Whether there are more of each kind than the capacity allows: of `_KINDS`, then of each size class."""
    number = jnp.stack([*(getattr(counts, kind) for kind in _KINDS), *counts.windows])
    most = [*(getattr(capacity, kind) for kind in _KINDS), *capacity.windows]
    return number > jnp.asarray(most, jnp.int32)


def empty_within_capacity(counts: Counts, capacity: Capacity, test: DepthTest) -> tuple[Array, Array]:
    """Face and depth of a pixel that sees nothing, after a check that the capacity suffices for all triangles.

    The check depends on these since either result needs its own, also where no triangle is read.
    """
    named = [(kind, getattr(capacity, kind)) for kind in _KINDS]
    named += [
        (f"windows[{k}] ({side} x {side} pixels)", most)
        for k, (side, most) in enumerate(zip(WINDOWS, capacity.windows, strict=True))
    ]
    messages = [
        f"the rasterizer's capacity.{name} of {most} is too small for these triangles, and none may be dropped; "
        "expected at least as many as there are: call plan(...) on them, or give a larger Capacity"
        for name, most in named
    ]
    exceeds = _exceeds(counts, capacity)
    return eqx.branched_error_if(_empty(test), jnp.any(exceeds), jnp.argmax(exceeds), messages)
