"""Reads OpenGL matrices: the eye's position, near and far, and checks of their validity."""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from .._arithmetic import as_float, concrete
from .._types import HostArray, Mat4, Scalar, Vec3
from ._view import View

_PERSPECTIVE, _PARALLEL = (0.0, 0.0, -1.0, 0.0), (0.0, 0.0, 0.0, 1.0)
# The entries that may be non-zero in each kind of projection, without the last row.
_ENTRIES = {
    True: np.array([[1, 0, 1, 0], [0, 1, 1, 0], [0, 0, 1, 1]], dtype=bool),
    False: np.array([[1, 0, 0, 1], [0, 1, 0, 1], [0, 0, 1, 1]], dtype=bool),
}
# Tolerances in single precision for entries that should be 0 or 1, and for dot products of a rotation's rows.
_EXACT, _RIGID = 1e-6, 1e-4


def matrices_of(name: str, world_to_eye: Any, eye_to_clip: Any, is_perspective: bool | None) -> tuple[Mat4, Mat4, bool]:
    """Both matrices as arrays, and whether the projection is a perspective one.

    **Arguments:**

    - `is_perspective`: by default it is read from the projection's last row.

    **Raises** `ValueError` unless both are finite (4, 4) matrices, the view is rigid, and the projection has the
    form of `perspective` or `orthographic`; and for a traced projection without `is_perspective`.
    """
    world_to_eye, eye_to_clip = as_float(world_to_eye), as_float(eye_to_clip)
    for what, matrix in (("world_to_eye", world_to_eye), ("eye_to_clip", eye_to_clip)):
        if matrix.shape != (4, 4):
            raise ValueError(f"{name}'s {what} has shape {matrix.shape}; expected one matrix, (4, 4)")
        known = concrete(matrix)
        if known is not None and not np.isfinite(known).all():
            raise ValueError(f"{name}'s {what} is {known.tolist()}; expected finite numbers")
    _check_rigid(name, concrete(world_to_eye))
    return world_to_eye, eye_to_clip, _check_projection(name, concrete(eye_to_clip), is_perspective)


def as_opengl(
    world_to_eye: Any, eye_to_clip: Any, left_handed: bool, depth: tuple[float, float]
) -> tuple[HostArray, HostArray]:
    """An engine's matrices, converted to OpenGL's conventions. Arguments are as for `MatrixLight.from_engine`.

    **Raises** `ValueError` for matrices that are not (4, 4), or for equal depths.
    """
    view, projection = (np.array(matrix, np.float64) for matrix in (world_to_eye, eye_to_clip))
    for what, matrix in (("world_to_eye", view), ("eye_to_clip", projection)):
        if matrix.shape != (4, 4):
            raise ValueError(f"the engine's {what} has shape {matrix.shape}; expected one matrix, (4, 4)")
    if np.shape(depth) != (2,) or not np.isfinite(depth).all() or depth[0] == depth[1]:
        raise ValueError(f"the engine's depth is {depth}; expected two numbers that differ, at near and far")
    near, far = depth
    if left_handed:
        # After a half turn about y, the eye looks along -z, and x in the image is also reversed.
        view[[0, 2]] *= -1
        projection[:, [0, 2]] *= -1
        projection[0] *= -1
    projection[2] = (2 * projection[2] - (near + far) * projection[3]) / (far - near)
    return view, projection


def _check_rigid(name: str, matrix: np.ndarray | None) -> None:
    if matrix is None:
        return
    turn = matrix[:3, :3].astype(np.float64)
    is_last = np.allclose(matrix[3], _PARALLEL, atol=_EXACT)
    if not (is_last and np.allclose(turn @ turn.T, np.eye(3), atol=_RIGID) and np.linalg.det(turn) > 0):
        raise ValueError(
            f"{name}'s world_to_eye is {matrix.tolist()}; expected a rotation and translation, with last row 0, 0, 0, "
            "1: transpose it if it acts on row vectors, remove any scale, and mirror it if its eye looks along +z"
        )


def _check_projection(name: str, matrix: np.ndarray | None, is_perspective: bool | None) -> bool:
    """Whether the projection is a perspective one."""
    if matrix is None:
        if is_perspective is None:
            raise ValueError(
                f"{name}'s eye_to_clip is traced, so its kind is unknown; expected is_perspective: pass True or False"
            )
        return is_perspective
    kinds = [
        kind for kind, row in ((True, _PERSPECTIVE), (False, _PARALLEL)) if np.allclose(matrix[3], row, atol=_EXACT)
    ]
    if not kinds:
        raise ValueError(
            f"{name}'s eye_to_clip has the last row {matrix[3].tolist()}; expected 0, 0, -1, 0 of a perspective or "
            "0, 0, 0, 1 of a parallel projection: transpose it if it acts on row vectors"
        )
    kind = kinds[0]
    if is_perspective is not None and is_perspective != kind:
        raise ValueError(
            f"{name} has is_perspective = {is_perspective}, but its eye_to_clip has the last row {matrix[3].tolist()}; "
            "expected them to agree: leave is_perspective out"
        )
    if np.abs(matrix[:3][~_ENTRIES[kind]]).max() > _EXACT or not (matrix[0, 0] > 0 and matrix[1, 1] > 0):
        raise ValueError(
            f"{name}'s eye_to_clip is {matrix.tolist()}; expected a matrix as glFrustum or glOrtho makes, with "
            "positive width and height: flip y if it points down, and do not use oblique near planes"
        )
    return kind


@partial(jax.jit, static_argnums=1)
def near_far_of(eye_to_clip: Mat4, is_perspective: bool) -> tuple[Scalar, Scalar]:
    """Distances of window depth 0 and 1 along the view axis, world units."""
    # For a perspective, -(f + n) / (f - n) and -2 f n / (f - n); for a parallel projection, -2 / (f - n) and -(f + n) /
    # (f - n).
    slope, offset = eye_to_clip[2, 2], eye_to_clip[2, 3]
    if is_perspective:
        return offset / (slope - 1), offset / (slope + 1)
    return (offset + 1) / slope, (offset - 1) / slope


@jax.jit
def eye_of(world_to_eye: Mat4) -> Vec3:
    """The world point that is the origin of eye space."""
    return -jnp.sum(world_to_eye[:3, :3] * world_to_eye[:3, 3:], axis=0)


def view_of(world_to_eye: Mat4, eye_to_clip: Mat4, is_perspective: bool) -> View:
    """The view with both matrices."""
    near, far = near_far_of(eye_to_clip, is_perspective)
    return View(world_to_eye, eye_to_clip, near, far, is_perspective)
