"""A camera's view with window depths that tell surfaces apart.

Window depth is `f / (f - n) (1 - n / z)` at the distance `z` along the view axis. Single precision resolves steps of
2⁻²⁴ near depth 1, which are `2⁻²⁴ z² / n` world units: a sixteenth of `z` if the near distance `n` is a millionth of
it. An image does not depend on the near distance as long as nothing lies before it. So where a camera's near distance
is much less than the distance of the nearest surface, its image is drawn with a greater one. The views of lights stay
as they are, since shadow maps store and compare depths as OpenGL defines them.
"""

import dataclasses

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

from .._arithmetic import dot, is_traced, take
from .._device import is_on_gpu
from .._types import Faces, Scalar
from ..geometry import Mesh, View, eye_of

# The near distance of a view that is fine is not as many times less than the nearest surface's distance, and a parallel
# view's window not as many times deeper than the mesh.
_SLACK = 64
# Nor is it as many times less than the farthest surface's, whose steps of depth are then 2⁻¹² of its distance.
_RANGE = 4096


def drawn_view(view: View, mesh: Mesh) -> View:
    """`view`, a camera's, with near and far moved towards `mesh` where single precision needs it.

    Nothing that `view` sees of `mesh` is cut away. A view whose depths are fine already is returned to the bit.
    """
    # Most views are fine. On CPUs this is known without a program of JAX; from a GPU, vertices would be copied.
    is_known = not is_on_gpu() and not is_traced((view, mesh.vertices))
    return view if is_known and _is_fine(view, np.asarray(mesh.vertices)) else _moved(view, mesh)


def _is_fine(view: View, vertices: np.ndarray) -> bool:
    """Whether the depths of a view tell surfaces apart anywhere before the farthest of these vertices."""
    row = np.asarray(view.world_to_eye)[2]
    distance = -(vertices @ row[:3] + row[3])
    nearest, farthest = np.min(distance, initial=np.inf), np.max(distance, initial=0)
    near, far = (float(each) for each in (view.near, view.far))
    return bool(_SLACK * near > farthest if view.is_perspective else _SLACK * (farthest - nearest) > far - near)


@eqx.filter_jit
def _moved(view: View, mesh: Mesh) -> View:
    fixed, vertices = lax.stop_gradient((view, mesh.vertices))
    distance = fixed.distance(vertices)
    if view.is_perspective:
        farthest = jnp.max(distance, initial=0)
        is_fine = _SLACK * fixed.near > farthest
        near = lax.cond(is_fine, lambda: fixed.near, lambda: _nearest(fixed, vertices, mesh.faces) / 2)
        far = fixed.far
        too_near = (_SLACK * fixed.near < 2 * near) | (_RANGE * fixed.near < jnp.minimum(farthest, far))
        moves = too_near & (near > fixed.near)
        row = [0, 0, -(far + near) / (far - near), -2 * near * (far / (far - near))]
    else:
        low, high = jnp.maximum(fixed.near, jnp.min(distance)), jnp.minimum(fixed.far, jnp.max(distance))
        near, far = jnp.maximum(fixed.near, low - (high - low)), jnp.minimum(fixed.far, high + (high - low))
        moves = (high > low) & (_SLACK * (high - low) < fixed.far - fixed.near)
        row = [0, 0, -2 / (far - near), -(far + near) / (far - near)]
    moved = view.eye_to_clip.at[2].set(jnp.stack([jnp.asarray(entry, near.dtype) for entry in row]))
    return dataclasses.replace(
        view,
        eye_to_clip=jnp.where(moves, moved, view.eye_to_clip),
        near=jnp.where(moves, near, view.near),
        far=jnp.where(moves, far, view.far),
    )


def _nearest(view: View, vertices: Float[Array, "v 3"], faces: Faces) -> Scalar:
    """A lower bound of the distance along the axis at which a perspective view sees a mesh; far if it sees nothing.

    A face is no nearer than its nearest vertex. A face that reaches behind the eye is no nearer than its plane, seen
    along the rays through the image's corners.
    """
    x, y, _, w = (take(values, faces) for values in view.clip_vertices(vertices).T)
    is_outside = jnp.all(x > w, axis=1) | jnp.all(-x > w, axis=1) | jnp.all(y > w, axis=1) | jnp.all(-y > w, axis=1)
    a, b, c = (take(vertices, faces[:, k]) - eye_of(view.world_to_eye) for k in range(3))
    normal = jnp.cross(b - a, c - a)
    length = jnp.sqrt(dot(normal, normal))
    from_plane = jnp.abs(dot(normal, a)) / jnp.where(length > 0, length, 1)
    # The tangents of the angles between the axis and the image's sides.
    tangents = (1 + jnp.abs(view.eye_to_clip[:2, 2])) / jnp.abs(jnp.diagonal(view.eye_to_clip)[:2])
    nearest = jnp.maximum(jnp.min(w, axis=1), from_plane / jnp.sqrt(1 + jnp.sum(tangents**2)))
    is_seen = ~is_outside & (length > 0) & jnp.any(w > view.near, axis=1)
    return jnp.min(jnp.where(is_seen, nearest, view.far), initial=view.far)
