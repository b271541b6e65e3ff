"""The rasterizer: which triangle each pixel sees."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, Int

from .._misc import as_float
from .._types import DepthMap, FaceMap, Faces, Resolution
from ._bins import WINDOWS, Capacity, Counts, Cull, Triangles, bin_triangles
from ._depth_test import DepthTest
from ._windows import NOTHING, window_batches, write_depth, write_face

NO_FACE = -1
"""What a pixel that sees nothing holds in a face map."""


class Fragments(eqx.Module):
    """What each pixel sees; row 0 is the bottom row. Neither field carries a gradient: `interpolate` does.

    - `face`: (h, w), index of the nearest face, `NO_FACE` where there is none.
    - `depth`: (h, w), its window depth as the depth buffer holds it, the clear value where there is none.
    """

    face: FaceMap
    depth: DepthMap


def plan(clip: Float[Array, "*b v 4"], faces: Faces, resolution: Resolution, *, cull: Cull = "none") -> Capacity:
    """The capacity that drawing these triangles needs, each number rounded up to a power of two.

    **Arguments:** as for `rasterize`; not for use inside `jax.jit`. Of several views it holds the greatest need.
    """
    clip = clip.astype(jnp.float32).reshape(-1, *clip.shape[-2:])
    counts = _count(clip, faces, resolution, cull, 0)
    if int(counts.clipped):
        counts = _count(clip, faces, resolution, cull, counts.capacity().clipped)
    return counts.capacity()


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
    - `capacity`: room for the triangles of each size. Left out, they are counted first, which needs concrete
        arguments; inside `jax.jit` it must be given, by `plan`.

    **Raises** `ValueError` for a resolution or depth test out of range, or where `capacity` is left out under a
    trace; and a runtime error that names the capacity that is too small: no triangle is ever dropped in silence.
    """
    return _draw(clip, faces, resolution, cull, depth_test, polygon_offset, behind, capacity, with_face=True)


def rasterize_depth(
    clip: Float[Array, "*b v 4"],
    faces: Faces,
    resolution: Resolution,
    *,
    cull: Cull = "none",
    depth_test: DepthTest | None = None,
    polygon_offset: Any = None,
    capacity: Capacity | None = None,
) -> Float[Array, "*b h w"]:
    """The depth buffer alone, (h, w): `rasterize(...).depth`, in less time. It carries no gradient."""
    return _draw(clip, faces, resolution, cull, depth_test, polygon_offset, None, capacity, with_face=False).depth


def _draw(clip, faces, resolution, cull, test, polygon_offset, behind, capacity, *, with_face) -> Any:
    test = test or DepthTest()
    test.check()
    if not all(1 <= n <= 8192 for n in resolution):
        raise ValueError(f"the resolution is {resolution}; expected (height, width), each from 1 to 8192 pixels")
    # The search is integer work and single precision whatever the precision of what is interpolated later.
    clip, faces = lax.stop_gradient(clip).astype(jnp.float32), lax.stop_gradient(faces)
    if capacity is None:
        if isinstance(clip, jax.core.Tracer) or isinstance(faces, jax.core.Tracer):
            raise ValueError(
                "rasterize was called inside jax.jit (or grad, or vmap) without a capacity; expected one, since shapes "
                "must be known there: call plan(clip, faces, resolution) outside on typical values and pass its result"
            )
        capacity = plan(clip, faces, resolution, cull=cull)
    if polygon_offset is not None:
        polygon_offset = lax.stop_gradient(as_float(polygon_offset)).astype(jnp.float32)
    return _rasterize(clip, faces, resolution, cull, test, polygon_offset, behind, capacity, with_face)


@eqx.filter_jit
def _count(clip: Float[Array, "b v 4"], faces: Faces, resolution: Resolution, cull: Cull, clip_capacity: int) -> Counts:
    def count(clip: Array) -> Counts:
        triangles, clipped = bin_triangles(clip, faces, resolution, cull, clip_capacity)
        return triangles.counts(clipped)

    return jax.tree.map(lambda n: n.max(axis=0), jax.vmap(count)(clip))


@eqx.filter_jit
def _rasterize(clip, faces, resolution, cull, test, polygon_offset, behind, capacity, with_face) -> Fragments:
    if clip.ndim > 2:
        view = lambda clip, behind: _rasterize(
            clip, faces, resolution, cull, test, polygon_offset, behind, capacity, with_face
        )
        return jax.vmap(view)(clip, behind)
    triangles, clipped = bin_triangles(clip, faces, resolution, cull, capacity.clipped)
    triangles = _check_capacity(triangles, triangles.counts(clipped), capacity)
    batches = window_batches(triangles, resolution, capacity, test, polygon_offset, behind)
    depth = write_depth(batches, resolution)
    face = write_face(batches, depth, resolution, last=test.compare == "less_equal") if with_face else None
    height, width = resolution
    depth = depth[:height, :width]
    depth = jnp.where(depth < jnp.inf, test.decode(depth), test.clear)
    if face is not None:
        face = face[:height, :width]
        face = jnp.where(face == NOTHING, NO_FACE, face)
    return Fragments(face, depth)


def _check_capacity(triangles: Triangles, counts: Counts, capacity: Capacity) -> Triangles:
    checks = [("clipped", counts.clipped, capacity.clipped), ("large", counts.large, capacity.large)]
    checks += [("blocks", counts.blocks, capacity.blocks)]
    checks += [
        (f"windows[{k}] ({side} x {side} pixels)", counts.windows[k], room)
        for k, (side, room) in enumerate(zip(WINDOWS, capacity.windows, strict=True))
    ]
    for name, count, room in checks:
        triangles = eqx.error_if(
            triangles,
            count > room,
            f"the rasterizer's capacity.{name} of {room} is too small for these triangles, and none may be dropped; "
            "expected at least as many as there are: call plan(...) on them, or give a larger Capacity",
        )
    return triangles
