"""Rigid and projective transforms, all `(4, 4)` matrices that act on column vectors from the left.

Outside of `jit`, each is one compiled program, which all cameras and lights share.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._arithmetic import as_float, dot, normalize, safe_norm
from .._types import Mat4, Scalar, Vec3


@jax.jit
def translation(offset: Vec3) -> Mat4:
    """Moves by `offset` (3,), in world units."""
    return jnp.eye(4, dtype=as_float(offset).dtype).at[:3, 3].set(as_float(offset))


@jax.jit
def scaling(factor: Vec3 | Scalar | float) -> Mat4:
    """Scales about the origin by `factor`, a scalar or one factor per axis."""
    return jnp.diag(jnp.append(jnp.broadcast_to(as_float(factor), (3,)), 1.0))


@jax.jit
def rotation(axis: Vec3, angle: Scalar | float) -> Mat4:
    """Rotates about `axis` through the origin by `angle` radians, by the right-hand rule (Rodrigues' formula)."""
    x, y, z = normalize(as_float(axis))
    cross = jnp.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    # R = I + sin(a) K + (1 - cos(a)) K²
    upper = jnp.eye(3) + jnp.sin(angle) * cross + (1 - jnp.cos(angle)) * jnp.matmul(cross, cross, precision="highest")
    return jnp.eye(4).at[:3, :3].set(upper)


def rotation_less_one(vector: Vec3) -> Float[Array, "3 3"]:
    """The rotation about `vector` by its length in radians (Rodrigues' formula), minus the identity, smooth at 0."""
    x, y, z = vector
    zero = jnp.zeros_like(x)
    cross = jnp.stack([jnp.stack(row) for row in ([zero, -z, y], [z, zero, -x], [-y, x, zero])])
    angle = safe_norm(vector)
    # R - I = sin(a) / a K + (1 - cos(a)) / a² K², with K the cross product with the vector itself.
    first, second = jnp.sinc(angle / jnp.pi), jnp.sinc(angle / (2 * jnp.pi)) ** 2 / 2
    return first * cross + second * jnp.matmul(cross, cross, precision="highest")


@jax.jit
def frame(forward: Vec3, up: Vec3) -> Float[Array, "3 3"]:
    """Rows `right, up, backward` of the view that looks along `forward`.

    If `up` is within about 0.1° of `forward`, the coordinate axis least parallel to `forward` is used instead.
    """
    backward = -normalize(forward)
    side = jnp.cross(up, backward)
    # Not `<=`, so that an `up` whose square overflows counts as parallel too.
    is_parallel = ~(dot(side, side) > 3e-6 * dot(up, up))
    x, y, z = jnp.abs(backward)
    spare = jnp.stack([(x <= y) & (x <= z), (y < x) & (y <= z), (z < x) & (z < y)]).astype(backward.dtype)
    right = normalize(jnp.where(is_parallel, jnp.cross(spare, backward), side))
    return jnp.stack([right, jnp.cross(backward, right), backward])


@jax.jit
def look_at(eye: Vec3, forward: Vec3, up: Vec3) -> Mat4:
    """World space to eye space: the eye at the origin, looking along `-z` (`gluLookAt`)."""
    rows = frame(forward, up)
    last = jnp.array([[0, 0, 0, 1]], rows.dtype)
    return jnp.concatenate([jnp.concatenate([rows, -dot(rows, eye)[:, None]], axis=1), last])


@jax.jit
def perspective(left_right: Float[Array, "2"], bottom_top: Float[Array, "2"], near: Scalar, far: Scalar) -> Mat4:
    """OpenGL's perspective projection (`glFrustum`): eye space to clip space.

    `left_right` and `bottom_top` are tangents, that is, extents at distance 1 in front of the eye; `near` and `far`
    are distances in world units.
    """
    (left, right), (bottom, top) = left_right, bottom_top
    depth = far - near
    rows = [
        [2 / (right - left), 0, (right + left) / (right - left), 0],
        [0, 2 / (top - bottom), (top + bottom) / (top - bottom), 0],
        [0, 0, -(far + near) / depth, -2 * far * near / depth],
        [0, 0, -1, 0],
    ]
    return jnp.stack([jnp.stack([as_float(x) for x in row]) for row in rows])


@jax.jit
def centred_perspective(fov_y: Scalar, near: Scalar, far: Scalar, aspect: Scalar | float = 1.0) -> Mat4:
    """`perspective` about the axis (`gluPerspective`): `fov_y` degrees high, and `aspect` times as wide."""
    sides = jnp.tan(jnp.deg2rad(fov_y) / 2) * jnp.array([-1.0, 1.0])
    return perspective(aspect * sides, sides, near, far)


@jax.jit
def infinite_far(projection: Mat4, near: Scalar) -> Mat4:
    """A perspective `projection` with its far plane moved to infinity.

    Window depth at distance `z` becomes `1 - near / z`. Points at infinity, whose `w` in eye space is 0, are at depth 1
    exactly. `near` is a distance in world units.
    """
    row = jnp.stack([as_float(x) for x in (0, 0, -1, -2 * near)])
    return projection.at[2].set(row)


@jax.jit
def orthographic(left_right: Float[Array, "2"], bottom_top: Float[Array, "2"], near: Scalar, far: Scalar) -> Mat4:
    """OpenGL's parallel projection (`glOrtho`): eye space to clip space; all arguments in world units."""
    (left, right), (bottom, top) = left_right, bottom_top
    depth = far - near
    rows = [
        [2 / (right - left), 0, 0, -(right + left) / (right - left)],
        [0, 2 / (top - bottom), 0, -(top + bottom) / (top - bottom)],
        [0, 0, -2 / depth, -(far + near) / depth],
        [0, 0, 0, 1],
    ]
    return jnp.stack([jnp.stack([as_float(x) for x in row]) for row in rows])


@jax.jit
def centred_orthographic(extent: Float[Array, "2"], near: Scalar, far: Scalar) -> Mat4:
    """`orthographic` about the axis, of this width and height."""
    half, sides = extent / 2, jnp.array([-1.0, 1.0])
    return orthographic(half[0] * sides, half[1] * sides, near, far)


@jax.jit
def transform_points(matrix: Float[Array, "*m 4 4"], points: Float[Array, "*n 3"]) -> Float[Array, "*k 4"]:
    """Homogeneous image of `points`: `matrix @ [p, 1]`, without the divide. One matrix for all points, or one for
    each."""
    return _linear(matrix[..., :, :3], points) + matrix[..., :, 3]


@jax.jit
def transform_vectors(matrix: Float[Array, "*m 4 4"], vectors: Float[Array, "*n 3"]) -> Float[Array, "*k 3"]:
    """Image of `vectors` under the linear part of `matrix`. One matrix for all vectors, or one for each."""
    return _linear(matrix[..., :3, :3], vectors)


def _linear(m: Float[Array, "*m r 3"], v: Float[Array, "*n 3"]) -> Float[Array, "*k r"]:
    # Written out, because some backends lower the precision of matrix products.
    return v[..., 0:1] * m[..., :, 0] + v[..., 1:2] * m[..., :, 1] + v[..., 2:3] * m[..., :, 2]


@jax.jit
def tangents(unit: Float[Array, "*n 3"]) -> tuple[Float[Array, "*n 3"], Float[Array, "*n 3"]]:
    """Two unit vectors orthogonal to `unit` and to each other.

    Duff et al., "Building an orthonormal basis, revisited", Journal of Computer Graphics Techniques 6(1), 2017.
    """
    x, y, z = jnp.moveaxis(unit, -1, 0)
    sign = jnp.where(z < 0, -1.0, 1.0)
    a = -1 / (sign + z)
    b = x * y * a
    return (
        jnp.stack([1 + sign * x * x * a, sign * b, -sign * x], axis=-1),
        jnp.stack([b, sign + y * y * a, -y], axis=-1),
    )
