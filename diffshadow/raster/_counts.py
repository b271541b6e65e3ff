"""Counts fragments in front of or behind a depth buffer, like a two-sided stencil buffer.

The depth pass keeps the nearest fragment of each pixel. This pass instead adds up the weights of all fragments that
pass the depth test against a fixed buffer, or of all fragments that fail it. Both passes clip, bin, cover and write
triangles in the same way, except that this scatter adds. A triangle therefore has bit-equal depths in both.

The far plane clips nothing. Fragments beyond it are moved into it (OpenGL's depth clamp).
"""

from typing import Literal

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.core import Tracer
from jaxtyping import Array, Bool, Float, Int

from .._arithmetic import as_array
from .._checks import check_value
from .._padding import padded_to
from .._types import ClipVertices, DepthMap, Faces
from ._bins import FACING, bin_triangles
from ._coverage import EdgeForm, window_depth
from ._depth_test import DepthTest
from ._rasterize import padded
from ._windows import CLIPPED_READS, DROPPED_WRITES, GATHER, PADDING, SCATTER, DrawPass, corner

When = Literal["pass", "fail"]

# Also draws depths at the far plane.
_CLAMPED = DepthTest(compare="less_equal")


def count_fragments(
    clip: ClipVertices,
    faces: Faces,
    weights: Int[Array, " f"],
    depth: DepthMap,
    when: When,
) -> Int[Array, "h w"]:
    """For each pixel, the sum of the weights of front faces' fragments minus the sum for back faces.

    **Arguments:**

    - `clip`: (v, 4), vertices in OpenGL clip space. `w` may have either sign, or be 0 for a vertex at infinity.
    - `faces`: (f, 3), indices into `clip`. Front faces are anticlockwise in the window.
    - `weights`: (f,), the weight of each face. A face of weight 0 takes almost no time.
    - `depth`: (h, w), window depth, from `rasterize`. The sums have its resolution.
    - `when`: the fragments to count: `"pass"` for fragments nearer than `depth`, `"fail"` for all others. Geometry in
      front of the near plane is clipped in both cases.

    **Raises** `ValueError` for any other `when`.
    """
    check_value("which fragments count", when, When)
    if not isinstance(weights, Tracer):
        clip, faces = padded(clip, faces)
        weights = as_array(padded_to(weights, faces.shape[0]))
    # The choice is data, so that both choices share a program.
    return _count_fragments(clip, faces, weights, depth, np.bool_(when == "pass"))


@eqx.filter_jit
def _count_fragments(clip, faces, weights, depth, nearer) -> Int[Array, "h w"]:
    height, width = depth.shape
    clip, faces = _flattened(lax.stop_gradient(clip).astype(depth.dtype), faces, weights)
    triangles = bin_triangles(clip, faces, (height, width), FACING["none"])
    drawing = DrawPass(triangles, (height, width), FACING["none"], _CLAMPED)
    buffer = jnp.zeros((height + PADDING, width + PADDING), jnp.int32)
    padded = jnp.pad(lax.stop_gradient(depth), ((0, PADDING), (0, PADDING)))

    def write(buffer: Array, form: EdgeForm, source: Int[Array, " n"], side: int) -> Array:
        form = eqx.tree_at(lambda form: form.greatest, form, jnp.minimum(form.greatest, 1))
        weight = (jnp.where(source >= 0, weights[source], 0) * form.turn).astype(jnp.int32)
        updates = weight[:, None, None] * _counted(form, side, padded, nearer)
        return lax.scatter_add(buffer, corner(form), updates, SCATTER, mode=DROPPED_WRITES)

    return drawing.draw(buffer, write)[:height, :width]


def _flattened(clip: ClipVertices, faces: Faces, weights: Int[Array, " f"]) -> tuple[Float[Array, "w 4"], Faces]:
    """The triangles. Triangles beyond the far plane are moved into it, and triangles that do not count are moved out of
    sight."""
    vertices = clip.shape[0]
    # Triangles that lie entirely beyond the far plane get second copies of their vertices in it.
    beyond = clip[:, 2] > clip[:, 3]
    all_beyond = beyond[faces[:, 0]] & beyond[faces[:, 1]] & beyond[faces[:, 2]]
    flattened = clip.at[:, 2].set(clip[:, 3])
    faces = jnp.where(all_beyond[:, None], faces + vertices, faces)
    # Triangles that do not count get this vertex, which the frustum rejects.
    outside = jnp.array([[0, 0, 2, 1]], clip.dtype)
    faces = jnp.where(weights[:, None] == 0, 2 * vertices, faces)
    return jnp.concatenate([clip, flattened, outside]), faces


def _counted(form: EdgeForm, side: int, padded: DepthMap, nearer: Bool[Array, ""]) -> Int[Array, "n side side"]:
    """1 for counted fragments, which are `nearer` or not, and 0 for other pixels."""
    z = window_depth(form, jnp.ones(form.x.shape, bool), side, _CLAMPED)
    # The depth as the depth pass stores it, even where the compiler fuses operations.
    z = lax.optimization_barrier(z)
    stored = lax.gather(padded, corner(form), GATHER, (side, side), mode=CLIPPED_READS)
    covered, is_nearer = z < jnp.inf, z < stored
    return (covered & (is_nearer == nearer)).astype(jnp.int32)
