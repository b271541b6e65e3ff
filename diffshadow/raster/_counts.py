"""Counting fragments in front of or behind a depth buffer, as a two-sided stencil buffer does.

Instead of keeping the nearest of all fragments, every pixel adds up the weights of those that pass, or of those that
fail, the depth test against a buffer that does not change. Triangles are clipped, binned, covered and written as the
depth pass does it, with a scatter that adds in place of one that keeps the least; so a triangle that both draw has
bit-equal depths in both.

The far plane cuts nothing: fragments beyond it count as if they lay in it (OpenGL's depth clamp).
"""

from typing import Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.core import Tracer
from jaxtyping import Array, Float, Int

from .._types import ClipVertices, DepthMap, Faces, Resolution
from ._bins import Capacity, Triangles, bin_triangles
from ._coverage import EdgeForm, window_depth
from ._depth_test import DepthTest
from ._fixed import signed_area
from ._rasterize import empty_within_capacity, padded, plan
from ._windows import (
    GATHER,
    IN_BOUNDS,
    PADDING,
    SCATTER,
    Windows,
    corner,
    count,
    find_candidates,
    over_windows,
    set_up_windows,
)

When = Literal["pass", "fail"]

# Depths at the far plane are drawn too.
_CLAMPED = DepthTest(compare="less_equal")


def plan_counts(clip: ClipVertices, faces: Faces, weights: Int[Array, " f"], resolution: Resolution) -> Capacity:
    """The capacity that `count_fragments` needs; arguments as there, concrete."""
    return plan(*_triangles(clip, faces, weights), resolution)


def count_fragments(
    clip: ClipVertices,
    faces: Faces,
    weights: Int[Array, " f"],
    depth: DepthMap,
    when: When,
    *,
    capacity: Capacity | None = None,
) -> Int[Array, "h w"]:
    """For each pixel, the sum of the weights of the front faces' fragments, less that of the back faces'.

    **Arguments:**

    - `clip`: (v, 4), vertices in OpenGL clip space; `w` may have either sign, or be 0 for a vertex at infinity.
    - `faces`: (f, 3), indices into `clip`; anticlockwise in the window is a front face.
    - `weights`: (f,), how often each face counts; a face of weight 0 costs next to nothing.
    - `depth`: (h, w), window depth, from `rasterize`. The sum is for its resolution.
    - `when`: which fragments count, those that `"pass"`, which are nearer than `depth`, or those that `"fail"`, which
        are not. What lies before the near plane is clipped away in either case.
    - `capacity`: how many triangles of each size can be drawn. Left out, they are counted first, which needs concrete
        arguments; inside `jax.jit` it must be given, by `plan_counts`.

    **Raises** `ValueError` if `when` is neither, or `capacity` is left out under a trace; and a runtime error that
    names the capacity that is too small.
    """
    if when not in ("pass", "fail"):
        raise ValueError(f'the fragments to count are those that {when!r}; expected "pass" or "fail"')
    if capacity is None:
        if any(isinstance(x, Tracer) for x in (clip, faces, weights)):
            raise ValueError(
                "count_fragments was called inside jax.jit (or grad, or vmap) without a capacity; expected one, since "
                "shapes must be known there: call plan_counts(...) outside on typical values and pass its result"
            )
        height, width = depth.shape
        capacity = plan_counts(clip, faces, weights, (height, width))
    count = weights.shape[0]
    clip, faces = padded(clip, faces)
    if faces.shape[0] > count:
        weights = jnp.asarray(np.pad(np.asarray(weights), (0, faces.shape[0] - count)))
    return _count_fragments(clip, faces, weights, depth, when, capacity)


@eqx.filter_jit
def _triangles(clip: ClipVertices, faces: Faces, weights: Int[Array, " f"]) -> tuple[Float[Array, "w 4"], Faces]:
    """The triangles as the binning wants them: it drops those that do not count, and none that lies beyond the far
    plane."""
    clip = lax.stop_gradient(clip)
    vertices = clip.shape[0]
    # Triangles wholly beyond the far plane are moved into it, by second copies of their vertices.
    beyond = clip[:, 2] > clip[:, 3]
    all_beyond = beyond[faces[:, 0]] & beyond[faces[:, 1]] & beyond[faces[:, 2]]
    flattened = clip.at[:, 2].set(clip[:, 3])
    faces = jnp.where(all_beyond[:, None], faces + vertices, faces)
    # Those that do not count become this vertex, which the frustum rejects.
    outside = jnp.array([[0, 0, 2, 1]], clip.dtype)
    faces = jnp.where(weights[:, None] == 0, 2 * vertices, faces)
    return jnp.concatenate([clip, flattened, outside]), faces


@eqx.filter_jit
def _count_fragments(clip, faces, weights, depth, when, capacity) -> Int[Array, "h w"]:
    resolution = depth.shape
    clip, faces = _triangles(clip.astype(depth.dtype), faces, weights)
    triangles = bin_triangles(clip, faces, resolution, "none", capacity.clipped, capacity.classes)
    found = find_candidates(triangles, resolution, capacity)
    counts = count(triangles, found)
    signed = (weights[triangles.source] * _facing(triangles)).astype(jnp.int32)
    # Windows then know which triangle each is of, rather than which face.
    own = jnp.arange(triangles.source.shape[0], dtype=jnp.int32)
    ready = set_up_windows(eqx.tree_at(lambda t: t.source, triangles, own), found, resolution, capacity, _CLAMPED, None)
    ready = eqx.tree_at(lambda r: r.form.greatest, ready, jnp.minimum(ready.form.greatest, 1))
    # The check holds integers that a trace in single precision cannot lower in double.
    with jax.enable_x64(False):
        counts = jax.tree.map(lambda n: n.astype(jnp.int32), counts)
        _, nothing = empty_within_capacity(counts, capacity, DepthTest(clear=0.0))
    return _add(ready, signed, depth, when, nothing.astype(jnp.int32))


def _facing(triangles: Triangles) -> Int[Array, " n"]:
    """+1 for front faces, -1 for back faces, exact on the snapped corners."""
    corners = triangles.corners(jnp.arange(triangles.faces.shape[0], dtype=jnp.int32))
    return jnp.sign(signed_area(*corners.snapped())).astype(jnp.int32)


def _add(
    ready: Windows, signed: Int[Array, " n"], depth: DepthMap, when: When, nothing: Int[Array, ""]
) -> Int[Array, "h w"]:
    """The sum at every pixel, over windows whose `source` indexes `signed` (n,), in chunks that fit a cache."""
    height, width = depth.shape
    buffer = jnp.broadcast_to(nothing, (height + PADDING, width + PADDING))
    padded = jnp.pad(lax.stop_gradient(depth), ((0, PADDING), (0, PADDING)))
    weight = jnp.where(ready.source >= 0, signed[ready.source], 0)

    def write(buffer: Array, form: EdgeForm, weight: Array, side: int, fresh: Array) -> Array:
        updates = jnp.where(fresh, weight, 0)[:, None, None] * _counted(form, side, padded, when)
        return lax.scatter_add(buffer, corner(form), updates, SCATTER, mode=IN_BOUNDS)

    weighted = eqx.tree_at(lambda windows: windows.source, ready, weight)
    return over_windows(weighted, buffer, write)[:height, :width]


def _counted(form: EdgeForm, side: int, padded: DepthMap, when: When) -> Int[Array, "n side side"]:
    """1 at the pixels whose fragments count, else 0."""
    z = window_depth(form, jnp.ones(form.x.shape, bool), side, _CLAMPED)
    # As the depth pass stores it alone, whatever the compiler would fuse it with.
    z = lax.optimization_barrier(z)
    stored = lax.gather(padded, corner(form), GATHER, (side, side), mode=IN_BOUNDS)
    covered, nearer = z < jnp.inf, z < stored
    return (covered & (nearer if when == "pass" else ~nearer)).astype(jnp.int32)
